"""Output of commands: tables and JSON, and the progress of long work on standard error.

Progress is a bar in a terminal, and a line for each tenth in a file.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from enum import Enum
from threading import Thread
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import typer

from lanebound.agents.serialization import counted

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from lanebound.agents.checkpointing.runner import RunProgress
    from lanebound.agents.report.pages import Table
    from lanebound.agents.studies.study import Shown

WIDTH_OF_A_FILE = 100  # characters, where COLUMNS gives no other
NARROW = 12  # characters of a column, at which text can still be read
LONG_WORD = 24  # characters; longer ones may be broken


def format_value(value: Any) -> str:
    """A value as text: six digits of a float, ``yes``/``no``, ``-`` for None."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, list | tuple):
        return ", ".join(map(format_value, value))
    return str(value)


def open_console() -> Console:
    """Standard output; a file or a pipe has the width COLUMNS, or one that is easy to read."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        console.width = WIDTH_OF_A_FILE
    return console


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], numbers: Collection[str] = ()
) -> None:
    """Print rows under a title; columns of numbers, and those in ``numbers``, are aligned to the right.

    The table fits the width of the terminal. Long text is wrapped, but the first column and heads are never broken:
    where they leave no room the table is wider.
    """
    from rich.table import Table
    from rich.text import Text

    data = [list(row) for row in rows]
    texts = [[format_value(value) for value in row] for row in data]
    table, console = Table(header_style="bold"), open_console()
    least = [_least_width(c, (row[i] for row in texts), i == 0) for i, c in enumerate(columns)]
    most = [_least_width(c, (row[i] for row in texts), True) for i, c in enumerate(columns)]
    widths = _fitted(least, most, columns, console.width)
    for i, (column, width) in enumerate(zip(columns, widths, strict=True)):
        numeric = column in numbers or any(
            isinstance(row[i], int | float) and not isinstance(row[i], bool) for row in data
        )
        justify: Literal["left", "right"] = "right" if numeric else "left"
        table.add_column(Text(column), justify=justify, overflow="fold", no_wrap=i == 0, width=width)
    for row in texts:
        table.add_row(*map(Text, row))
    console.width = max(console.width, sum(widths) + 3 * len(widths) + 1)
    console.print(Text(title, style="italic"))
    console.print(table)


def _least_width(head: str, texts: Iterable[str], whole: bool = False) -> int:
    """Least width of a column without breaks in its head and its words (but very long ones), or ``whole`` texts."""
    words = (len(word) for text in texts for word in ((text,) if whole else text.split()))
    return max([*map(len, head.split("\n")), *(length for length in words if whole or length <= LONG_WORD)])


def _fitted(least: Sequence[int], most: Sequence[int], columns: Sequence[str], room: int) -> list[int]:
    """Widths of columns that fit.

    Where the least widths do not fit, the widest columns but the first are narrowed down to a readable width. Free
    space goes to the columns with the smallest share of their largest width.
    """
    fitted, spare = list(least), room - sum(least) - 3 * len(least) - 1
    for i in sorted(range(1, len(fitted)), key=lambda i: -fitted[i]):
        given = max(0, min(-spare, fitted[i] - max(_least_width(columns[i], ()), NARROW)))
        fitted[i] -= given
        spare += given
    for _ in range(spare):
        short = [i for i, width in enumerate(fitted) if width < most[i]]
        if not short:
            break
        fitted[min(short, key=lambda i: fitted[i] / most[i])] += 1
    return fitted


def show(found: Any, shown: Iterable[Shown], as_json: bool, written: str = "") -> None:
    """Print lines and tables of a study and what is written where, or its data as JSON; empty tables are left out."""
    if as_json:
        print_json(found)
        return
    for one in (*shown, *filter(None, [written])):
        if isinstance(one, str):
            typer.echo(one)
        elif one[1][1]:
            print_table(one[0], *one[1])


def show_study(found: Any, tables: Mapping[str, Table], out: Path, page: Path | None, as_json: bool) -> None:
    """Write the tables of a study into its page if there is one, and print them, or its data, and where these are."""
    from lanebound.agents.report.pages import fill

    if page is not None:
        fill(page, tables)
    show(found, tables.items(), as_json, f"results.json: {out}")


def print_json(data: Any) -> None:
    """Print plain data as JSON; infinity and NaN are ``null``."""
    from lanebound.agents.serialization import to_json_text

    typer.echo(to_json_text(data))


T = TypeVar("T")
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells count
MOST_S = 5.0  # to start a process
QUIET_S = 10.0  # between lines of a file that report no other part done
LONGEST_S = 30.0  # between lines of a file while parts are done


def wait_for(work: Callable[[], T]) -> T:
    """Run ``work`` in a thread of its own and return its result; this thread stays free for Ctrl-C.

    Python raises KeyboardInterrupt in the main thread only. In the main thread a compilation would delay or lose it.
    """
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    Thread(target=run, daemon=True).start()
    return outcome.result()


@contextmanager
def resumable(kept: Callable[[], str]) -> Iterator[None]:
    """In this context Ctrl-C prints ``kept()`` and ends the process at once.

    A thread that compiles cannot be stopped, and Python may crash when it leaves one behind. So nothing is cleaned up,
    and the files of the work must be complete at any time.
    """
    try:
        yield
    except KeyboardInterrupt:
        from lanebound.agents.checkpointing.runner import STARTING

        typer.echo(f"interrupted: {kept()}", err=True)
        sys.stdout.flush()
        sys.stderr.flush()
        STARTING.acquire(timeout=MOST_S)
        os._exit(EXIT_INTERRUPTED)


def kept_text(out: Path, pattern: str, what: str) -> str:
    """Which finished parts a folder holds, and how to resume; ``pattern`` matches their files."""

    count = sum(1 for _ in out.glob(pattern))
    found = f"{counted(count, f'finished {what}')} {'is' if count == 1 else 'are'} kept in {out}"
    return f"{found if count else f'no {what} was finished'}; run the same command again to resume"


def with_bar(what: str, work: Callable[[Callable[[RunProgress], None]], T]) -> T:
    """The result of ``work``, run as by :func:`wait_for`, with its progress.

    The bar appears with the first progress that is reported: refusals come before it.

    Parameters
    ----------
    what : noun of the parts, in the plural
    work : called with the function to which it reports its progress
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[counts]} {task.fields[rest]}"))
    console = Console(stderr=True)
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    task = bar.add_task(what, total=None, counts="", rest="")
    lines = None if console.is_terminal else _Lines(what)

    def on_progress(progress: RunProgress) -> None:
        if lines is not None:
            lines(progress)
        elif not bar.live.is_started:
            bar.start()
        bar.update(
            task, description=progress.stage or what, completed=progress.done, total=progress.of,
            counts=counts(progress), rest=rest_text(progress),
        )  # fmt: skip

    try:
        return wait_for(lambda: work(on_progress))
    finally:
        if bar.live.is_started:
            bar.stop()


def carry_out(out: Path, part: str, work: Callable[[Callable[[RunProgress], None]], T], parts: str = "") -> T:
    """The result of resumable work, as by :func:`with_bar`; Ctrl-C says which finished parts its folder keeps.

    Parameters
    ----------
    part, parts : nouns of what is kept, and of what the progress counts: by default the plural of the first
    """
    with resumable(lambda: kept_text(out, "parts/*.json", part)):
        return with_bar(parts or f"{part}s", work)


class _Lines:
    """Progress in a file: a line for each tenth or half a minute, and one when kernels are compiled.

    A line without another part done follows at least ten seconds after the last one.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._tenths: int | None = None
        self._compiling = False
        self._shown, self._at = "", time.monotonic()

    def __call__(self, progress: RunProgress) -> None:
        if progress.compiling and not self._compiling:
            self._compiling = True
            typer.echo("compiling kernels, once: this takes some minutes", err=True)
        tenths = int(10.0 * progress.done / progress.of) if progress.of else 10
        now, done = time.monotonic(), counts(progress)
        late = now > self._at + LONGEST_S and done != self._shown
        further = self._tenths is not None and tenths > self._tenths
        if late or (further and (done != self._shown or now > self._at + QUIET_S)):
            self._shown, self._at = done, now
            typer.echo(f"{done} {progress.stage or self._what}, {rest_text(progress)}", err=True)
        self._tenths = max(tenths, self._tenths or 0)


def counts(progress: RunProgress) -> str:
    """Parts done and their number.

    >>> from lanebound.agents.checkpointing.runner import RunProgress
    >>> counts(RunProgress(of=1200, done=3.5))
    '3 of 1,200'
    """
    return f"{int(progress.done):,} of {int(progress.of):,}"


def rest_text(progress: RunProgress) -> str:
    """The time left, once it is known, and compilations and failures."""
    texts = ["starting" if progress.left_s is None else f"{_clock(progress.left_s)} left"]
    if progress.compiling:
        texts = [*(texts if progress.left_s is not None else []), "compiling kernels, once"]
    return ", ".join([*texts, *([f"{progress.failed} failed"] if progress.failed else [])])


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
