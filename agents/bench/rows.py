"""One measured figure of the benchmark, and the timing loop that both sides of a ratio share."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from lanebound.agents.serialization import finite_or_none
from lanebound.integrity.core.errors import InputError

__all__ = ["Row", "alternate", "median_ratio"]


CLOCK_TICK_S = 1e-9  # the unit of perf_counter_ns: no turn is shorter


@dataclass(frozen=True)
class Row:
    """A figure with its gate and stretch; ``higher_is_better`` says which side of the gate is good."""

    name: str
    value: float
    unit: str
    gate: float | None = None
    stretch: float | None = None
    higher_is_better: bool = True

    @property
    def met(self) -> bool | None:
        """Whether the gate is met; None where there is no gate."""
        if self.gate is None:
            return None
        return self.value >= self.gate if self.higher_is_better else self.value <= self.gate

    def to_json(self) -> dict[str, Any]:
        """The row as plain data, with ``met``; a figure that is infinite or NaN is None, as JSON has neither."""
        return {**finite_or_none(asdict(self)), "met": self.met}


def alternate(sides: dict[str, Callable[[], int]], rounds: int = 5, seconds: float = 0.4) -> dict[str, list[float]]:
    """Rates [items/s] of each side, measured in turn within each round so that both see the same machine.

    Each callable does one piece of work and returns how many items it did. It is called once before timing.

    Raises
    ------
    InputError
        A side did no item in a whole turn: it has no rate.
    """
    for work in sides.values():
        work()
    rates: dict[str, list[float]] = {name: [] for name in sides}
    for _ in range(rounds):
        for name, work in sides.items():
            rates[name].append(_rate(name, work, seconds))
    return rates


def _rate(name: str, work: Callable[[], int], seconds: float) -> float:
    """Items per second of one side's turn: one call at least, then as many as begin within ``seconds``."""
    start = time.perf_counter()
    items = work()
    while (elapsed := time.perf_counter() - start) < seconds:
        items += work()
    if not items > 0:
        raise InputError(f"side '{name}' must do at least one item in a turn, got {items}: return the number of items")
    return items / max(elapsed, CLOCK_TICK_S)


def median_ratio(rates: dict[str, list[float]], fast: str, slow: str) -> float:
    """Median over rounds of the ratio of two sides."""
    return statistics.median(a / b for a, b in zip(rates[fast], rates[slow], strict=True))
