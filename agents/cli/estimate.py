"""How long work of many parts will take, told from the parts that are done."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Estimate"]

FIRST = 3  # parts until the first word: of the first one most may be compilation
APART = 0.1  # of all parts between one word and the next


class Estimate:
    """Says now and then how many parts are done and how long the rest takes at the pace since the first of them.

    >>> clock = iter([0.0, 60.0, 70.0, 80.0, 90.0])
    >>> pace = Estimate(lambda: next(clock))
    >>> [pace.line(done, 40) for done in (0, 1, 2, 3, 4)]
    [None, None, None, '3 of 40 parts done, about 6 min left', None]
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._before: int | None = None
        self._start: tuple[int, float] | None = None
        self._told = 0.0

    def line(self, done: int, of: int) -> str | None:
        """What to say when ``done`` of ``of`` are done; None for nothing."""
        now = self._clock()
        if self._before is None:
            self._before = done  # parts of an earlier run say nothing of the pace
            return None
        if self._start is None:
            self._start = (done, now)
        first, since = self._start
        if done - self._before < FIRST or done == first or done >= of or done < self._told:
            return None
        self._told = done + APART * of
        left_s = (of - done) * (now - since) / (done - first)
        return f"{done} of {of} parts done, about {_span(left_s)} left"


def _span(seconds: float) -> str:
    """A time as a person says it.

    >>> _span(20.0), _span(200.0), _span(9000.0)
    ('20 s', '3 min', '2.5 h')
    """
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
