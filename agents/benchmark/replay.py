"""A stored episode driven again: it must end as it did, and can be filmed."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.pool import Pool
from lanebound.agents.benchmark.store import Store
from lanebound.agents.benchmark.work import FilmedWork
from lanebound.integrity.core.errors import InputError

__all__ = ["differences", "find_task", "replay"]


def find_task(store: Store, ident: str) -> Task:
    """The stored episode of a name, ``env/sky-faults/agent/seed``; ids may leave out ``lanebound/`` and version.

    Raises
    ------
    InputError
        There is none, with the nearest.
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
    """Drive a stored episode again, in a process of its own as before; returns the stored outcome and that of now.

    Raises
    ------
    InputError
        No stored episode has that name, or the film is refused.
    """
    store = Store(folder)
    task = find_task(store, ident)
    work = FilmedWork(store.suite(), film, fps)
    work.check(task)
    (now,) = Pool(work, 1).run([task])
    return store.outcome(task), now


def differences(stored: Outcome, now: Outcome) -> list[str]:
    """Attributes in which two outcomes do not agree to the last bit; times on the wall do not count."""
    ours, theirs = stored.lasting(), now.lasting()
    return [key for key in ours if ours[key] != theirs[key]]
