"""Progress of long work on standard error: a bar in a terminal, a line for each tenth in a file."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from threading import Thread
from typing import TYPE_CHECKING, TypeVar

import typer

if TYPE_CHECKING:
    from pathlib import Path

    from lanebound.agents.checkpointing.runner import RunProgress

__all__ = ["EXIT_INTERRUPTED", "counts", "kept_text", "resumable", "wait_for", "with_bar"]

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
        from lanebound.agents.checkpointing.pool import STARTING

        typer.echo(f"interrupted: {kept()}", err=True)
        sys.stdout.flush()
        sys.stderr.flush()
        STARTING.acquire(timeout=MOST_S)
        os._exit(EXIT_INTERRUPTED)


def kept_text(out: Path, pattern: str, what: str) -> str:
    """Which finished parts a folder holds, and how to resume; ``pattern`` matches their files."""
    from lanebound.agents.serialization import counted

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
