"""A study in a folder: parts that are kept as they are done, so that an interrupted run goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from lanebound.agents.plain import finite_or_none
from lanebound.agents.reproduce.study import source_digest, write_whole
from lanebound.integrity.config import Config
from lanebound.integrity.errors import InputError

__all__ = ["claim", "parts_kept", "run_parts"]

Progress = Callable[[int, int], None]
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def claim(study: str, config: Config, out: Path) -> None:
    """Mark the folder with the study and its configuration, or refuse one that is marked otherwise.

    Raises
    ------
    InputError
        ``out`` holds another study, or cannot be written.
    """
    text = study + config.to_json() + source_digest() + _own_digest()
    digest = hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
    mark = out / "config.json"
    try:
        found = json.loads(mark.read_text(encoding="utf-8")).get("digest") if mark.exists() else digest
        if found == digest:
            write_whole(mark, {"digest": digest, "study": study, "config": config.to_dict()})
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"out must be a folder that can be written, got {out} ({error}): choose another") from error
    if found != digest:
        raise InputError(
            f"out must be empty or hold the same study, got {out} of another configuration or version: "
            "choose a new folder"
        )


def _own_digest() -> str:
    """A name for the code of the studies themselves."""
    found = hashlib.blake2b(digest_size=8)
    for source in sorted(Path(__file__).parent.glob("*.py")):
        found.update(source.read_bytes())
    return found.hexdigest()


def parts_kept(out: Path) -> int:
    """Number of finished parts in a folder."""
    return len(list((out / "parts").glob("*.json")))


def run_parts(
    out: Path,
    names: Sequence[str],
    work: Callable[[str], dict[str, Any]],
    jobs: int = 1,
    progress: Progress = lambda done, of: None,
) -> list[dict[str, Any]]:
    """Results of all parts in order: those in the folder, and ``work(name)`` of the others, each kept when it is done.

    With more than one job ``work`` must be something that can be pickled; each process computes on one thread.
    """
    missing = [name for name in names if not _path(out, name).exists()]
    done = len(names) - len(missing)
    progress(done, len(names))
    for name, found in _worked(missing, work, jobs):
        write_whole(_path(out, name), finite_or_none(found))
        done += 1
        progress(done, len(names))
    return [json.loads(_path(out, name).read_text(encoding="utf-8")) for name in names]


def _path(out: Path, name: str) -> Path:
    return out / "parts" / f"{name}.json"


def _worked(
    names: Sequence[str], work: Callable[[str], dict[str, Any]], jobs: int
) -> Iterator[tuple[str, dict[str, Any]]]:
    if jobs == 1 or len(names) < 2:
        for name in names:
            yield name, work(name)
        return
    with _one_thread(), ProcessPoolExecutor(min(jobs, len(names)), mp_context=get_context("spawn")) as pool:
        running = {pool.submit(work, name): name for name in names}
        for finished in as_completed(running):
            yield running[finished], finished.result()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started within compute on one thread: libraries ask once, when they are loaded."""
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
