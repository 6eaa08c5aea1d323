"""Kernels being compiled: how long a process has spent on it, as another process sees it, and whether any are kept.

Numba tells of its compiler's lock; what is loaded from its cache counts too, so that the rest of an episode's time is
that of driving.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

__all__ = ["CompileClock", "kernels_are_cached"]

EVENT = "numba:compiler_lock"
NOTICED_S = 1.0  # shorter, a kernel was loaded rather than compiled
KEPT_AT_LEAST = 100  # indices in the cache; a drive leaves about 200


class CompileClock:
    """Time that a process has compiled.

    Parameters
    ----------
    shared : array of two numbers that both processes see, all zeros: the time until now, and when it began if it does
    """

    def __init__(self, shared: Any) -> None:
        self._shared, self._depth = shared, 0

    def watch(self) -> None:
        """Take the time from now on, in the process that compiles."""
        from numba.core import event

        class Listener(event.Listener):
            """Numba's side; kernels that call kernels are compiled within each other."""

            def on_start(listener, event: Any) -> None:  # noqa: N805 - self is the clock
                self.begin()

            def on_end(listener, event: Any) -> None:  # noqa: N805
                self.end()

        event.register(EVENT, Listener())  # type: ignore[no-untyped-call]

    def begin(self) -> None:
        """A kernel begins."""
        self._depth += 1
        if self._depth == 1:
            self._shared[1] = time.monotonic()

    def end(self) -> None:
        """A kernel is done."""
        self._depth -= 1
        if self._depth == 0:
            begun, self._shared[1] = self._shared[1], 0.0
            self._shared[0] += time.monotonic() - begun

    @property
    def spent_s(self) -> float:
        """Its time, without what is under way."""
        return float(self._shared[0])

    @property
    def at_work(self) -> bool:
        """Whether a kernel is being compiled, and not just loaded."""
        begun = self._shared[1]
        return bool(begun > 0.0 and time.monotonic() - begun > NOTICED_S)


def kernels_are_cached() -> bool:
    """Whether kernels of this version were compiled before, so that a run begins at once."""
    from lanebound.integrity.core.accel import cache_directory

    directory = cache_directory()
    return directory is not None and sum(1 for _ in Path(directory).glob("*/*.nbi")) >= KEPT_AT_LEAST
