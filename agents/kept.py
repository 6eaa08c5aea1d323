"""Folders of long work: its parts are kept as they are done, so that an interrupted run goes on where it was.

::

    config.json   which study, of which configuration, by which version of the code
    parts/        one file for each finished part

What ends in such a folder is what an unbroken run would have ended in.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from importlib import resources
from multiprocessing import get_context
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from lanebound.agents.plain import finite_or_none
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.progress import Progress

__all__ = [
    "MARKS", "STARTING", "Progress", "claim", "code_digest", "make_folder", "one_thread", "parts_kept", "read_kept",
    "replace_file", "require_own", "run_parts", "write_whole",
]  # fmt: skip

T = TypeVar("T")
JSON_NAMES: dict[type, str] = {dict: "object", list: "array"}
STARTING = Lock()
"""Held while a process is started: who ends this one at once waits for it, so that none is left half begun."""
MARKS: dict[str, tuple[str | None, str]] = {
    "config.json": ("digest", "a study or an assessment"),
    "experiment.json": ("algorithm", "a training"),
    "suite.json": ("suite", "a benchmark"),
    "replay.json": ("dataset", "a replayed drive"),
    "rtk.json": ("epochs", "an RTK solution"),
    "columns.md": (None, "drives"),
}
"""Files by which folders of work are known: a key that they hold, if they hold any, and what they are of."""
SHOWN = 3  # values that a refusal names
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def claim(out: Path, study: str, config: Config, packages: Sequence[str]) -> None:
    """Mark a folder with a study, its configuration and its code, or refuse one that is marked otherwise.

    Parameters
    ----------
    packages : those that its parts follow from, as ``lanebound.integrity``

    Raises
    ------
    InputError
        ``out`` holds another study, or cannot be written.
    """
    text = study + config.to_json() + code_digest(*packages)
    digest = hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
    mark = out / "config.json"
    require_own(mark)
    try:
        out.mkdir(parents=True, exist_ok=True)
        found = _value_in(mark, "digest") if mark.exists() else digest
        if found == digest:
            write_whole(mark, {"digest": digest, "study": study, "config": config.to_dict()})
    except OSError as error:
        raise InputError(
            f"out must be a folder that can be written, got {out} ({error}): choose another one"
        ) from error
    if found != digest:
        what = _differing(mark, study, config)
        raise InputError(f"out must be empty or hold the same study, got {out} {what}: choose a new folder")


def make_folder(out: Path) -> None:
    """Make the folder that results go to, before time is spent on them.

    Raises
    ------
    InputError
        It cannot be made or written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".{os.getpid()}.probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"out must be a folder that can be written, got {out} ({error}): choose another") from error


def require_own(mark: Path) -> None:
    """Refuse a folder that holds work of another kind than the one that is known by ``mark``.

    Raises
    ------
    InputError
        It does.
    """
    for name, (key, kind) in MARKS.items():
        other = mark.with_name(name)
        if name != mark.name and (other.is_file() if key is None else _value_in(other, key) is not None):
            raise InputError(
                f"out must be empty or hold work of its own kind, got {mark.parent} with {kind}: choose a new folder"
            )


def _differing(mark: Path, study: str, config: Config) -> str:
    """What of a folder's mark is not as it would be now."""
    before, kind = _value_in(mark, "config"), _value_in(mark, "study")
    if not isinstance(before, Mapping) or kind is None:
        return f"with a {mark.name} that is none of ours"
    if kind != study:
        return f"with the study '{kind}'"
    then, now = dict(_leaves(before)), dict(_leaves(config.to_dict()))
    changed = sorted(key for key in then | now if then.get(key) != now.get(key))
    if not changed:
        return "of another version of the code"
    shown = ", ".join(f"{key} ({_short(then, key)} there, now {_short(now, key)})" for key in changed[:SHOWN])
    return f"which differs in {shown}{f' and {len(changed) - SHOWN} more' if len(changed) > SHOWN else ''}"


def _short(values: Mapping[str, Any], key: str) -> str:
    text = str(values.get(key, "nothing"))
    return text if len(text) <= 40 else f"{text[:37]}..."


def _leaves(tree: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested mappings by their dotted paths."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _value_in(mark: Path, key: str) -> Any:
    """What a folder is marked with under a key; None where the mark is none of ours, or there is none."""
    try:
        return json.loads(mark.read_text(encoding="utf-8")).get(key)
    except (OSError, ValueError, AttributeError):
        return None


def read_kept(path: Path, kind: type[T]) -> T:
    """What a file that was written whole holds, of the ``kind`` that was written.

    Raises
    ------
    InputError
        It was damaged since; OSError where it cannot be read.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path} is not JSON ({error}): restore it or choose a new folder") from None
    if not isinstance(found, kind):
        raise InputError(
            f"{path} must hold a JSON {JSON_NAMES[kind]}, got {type(found).__name__}: restore it or choose a new folder"
        )
    return found


@cache
def code_digest(*packages: str) -> str:
    """A name for the code of packages, as it was first asked for: parts made by other code must not be mixed in."""
    found = hashlib.blake2b(digest_size=8)
    for package in packages:
        for source in sorted(Path(str(resources.files(package))).rglob("*.py")):
            found.update(source.read_bytes())
    return found.hexdigest()


def write_whole(path: Path, data: Any) -> None:
    """Write JSON so that the file is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as draft:
        draft.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


class replace_file:  # noqa: N801 - used as a function
    """Within it, a draft may be written that takes the place of ``path`` at the end, whole or not at all."""

    def __init__(self, path: Path) -> None:
        self.path, self.draft = path, path.with_name(f"{path.name}.{os.getpid()}.part")

    def __enter__(self) -> Path:
        return self.draft

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            os.replace(self.draft, self.path)
        else:
            self.draft.unlink(missing_ok=True)


def parts_kept(out: Path) -> int:
    """Number of finished parts in a folder."""
    return len(list((out / "parts").glob("*.json")))


def run_parts(
    out: Path,
    names: Sequence[str],
    work: Callable[[str], dict[str, Any]],
    jobs: int = 1,
    progress: Progress = lambda done, of: None,
    size: Callable[[str], int] = lambda name: 1,
    may_start: Callable[[], bool] = lambda: True,
) -> dict[str, dict[str, Any]]:
    """Results of the parts by name, in order: those in the folder, and ``work(name)`` of the others, kept when done.

    With more than one job ``work`` must be something that can be pickled; each process computes on one thread.

    Parameters
    ----------
    progress : called with how much is done and how much there is, in the unit of ``size``
    size : how much a part is
    may_start : asked before every part; after a no those under way are finished, and the rest is missing
    """
    missing = [name for name in names if not _path(out, name).exists()]
    of = sum(map(size, names))
    done = of - sum(map(size, missing))
    progress(done, of)
    for name, found in _worked(missing, work, jobs, may_start):
        write_whole(_path(out, name), finite_or_none(found))
        done += size(name)
        progress(done, of)
    there = [name for name in names if _path(out, name).exists()]
    return {name: json.loads(_path(out, name).read_text(encoding="utf-8")) for name in there}


def _path(out: Path, name: str) -> Path:
    return out / "parts" / f"{name}.json"


def _worked(
    names: Sequence[str], work: Callable[[str], dict[str, Any]], jobs: int, may_start: Callable[[], bool]
) -> Iterator[tuple[str, dict[str, Any]]]:
    if jobs == 1 or len(names) < 2:
        for name in names:
            if not may_start():
                return
            yield name, work(name)
        return
    waiting = deque(names)
    with one_thread(), ProcessPoolExecutor(min(jobs, len(names)), mp_context=get_context("spawn")) as pool:
        running: dict[Future[dict[str, Any]], str] = {}
        while True:
            while waiting and len(running) < jobs and may_start():
                name = waiting.popleft()
                running[pool.submit(work, name)] = name
            if not running:
                return
            for finished in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(finished), finished.result()


@contextmanager
def one_thread() -> Iterator[None]:
    """Processes that are started within compute on one thread: libraries ask once, when they are loaded."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
