"""Replay of a stored episode: its outcome must be the same to the last bit. It can be filmed."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.work import FilmedEpisodes
from lanebound.agents.checkpointing.runner import Pool
from lanebound.integrity.core.errors import InputError

__all__ = ["differences", "find_task", "replay"]


def find_task(store: EpisodeStore, ident: str) -> Task:
    """The stored episode of an id, ``env/sky-faults/agent/seed``; ``lanebound/`` and the version may be left out.

    Raises
    ------
    InputError
        There is none; the message names the nearest.
    """
    tasks = {task.id: task for task in store.suite().tasks()}
    env, slash, rest = ident.removeprefix("lanebound/").partition("/")
    found = tasks.get(f"{env}{slash}{rest}") or tasks.get(f"{env}-v0{slash}{rest}")
    if found is None:
        (closest,) = get_close_matches(ident, tasks, n=1, cutoff=0.0)  # of thousands
        raise InputError(f"episode '{ident}' is not in {store.folder}: did you mean '{closest}'?")
    if not store.has(found):
        raise InputError(
            f"episode '{found.id}' must have been driven, got none in {store.folder}: resume the benchmark"
        )
    return found


def replay(folder: Path, ident: str, film: Path | None = None, fps: int = 10) -> tuple[Outcome, Outcome]:
    """Drive a stored episode again in a worker process; returns the stored outcome and the new one.

    Raises
    ------
    InputError
        No stored episode has that id, or the film is refused.
    """
    store = EpisodeStore(folder)
    task = find_task(store, ident)
    work = FilmedEpisodes(store.suite(), film, fps)
    work.check(task)
    ((_, now),) = Pool(work, 1).run([task])
    return store.outcome(task), now


def differences(stored: Outcome, now: Outcome) -> list[str]:
    """Attributes in which two outcomes differ, wall-clock times excepted."""
    ours, theirs = stored.lasting(), now.lasting()
    return [key for key in ours if ours[key] != theirs[key]]
