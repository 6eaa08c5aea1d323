"""The benchmarks by name, the figures that they measure, and the loop that times both sides of a ratio.

One that fails does not stop the others.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lanebound.agents.serialization import finite_or_none, to_json_text
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

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


def plain_form(module: str) -> Any:
    """A module of plain forms, in ``tests/reference`` of the checkout that this package lies in; None without one."""
    folder = Path(__file__).resolve().parents[2] / "tests" / "reference"
    if folder.is_dir() and str(folder) not in sys.path:
        sys.path.append(str(folder))
    return import_module(module) if find_spec(module) is not None else None


BENCH_PACKAGE = "lanebound.agents.bench"
BENCHES = {
    "ambiguity": "positioning", "busy": "environments", "cold": "environments", "context": "navigation",
    "engine": "environments", "environments": "environments", "fleets": "fleets", "independent": "positioning",
    "learning": "environments",
    "monitors": "positioning", "navigator": "navigation", "presets": "environments", "protection": "positioning",
    "sensors": "navigation", "shares": "environments", "sky": "navigation", "startup": "environments",
}  # fmt: skip
"""Modules of the benchmarks: the function of a name is ``measure_NAME(rounds) -> list[Row]``."""
ON_REQUEST = {"cold"}
"""Benchmarks of several minutes, which run only when they are named."""


@dataclass
class Report:
    """The measured rows, and the reasons of failure by benchmark."""

    rows: list[Row] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)


def select(only: Sequence[str]) -> list[str]:
    """The named benchmarks; without a name, all but those of ``ON_REQUEST``.

    Raises
    ------
    InputError
        A name is unknown; the message offers the nearest.
    """
    for name in only:
        if name not in BENCHES:
            raise InputError(f"benchmark '{name}' is unknown: {nearest(name, BENCHES)}")
    return [name for name in sorted(BENCHES) if (name in only if only else name not in ON_REQUEST)]


def run(names: Sequence[str], rounds: int = 5, progress: Callable[[str], None] | None = None) -> Report:
    """Run benchmarks by name; ``progress`` is called with each name before it runs."""
    report = Report()
    for name in names:
        if progress is not None:
            progress(name)
        try:
            module = import_module(f"{BENCH_PACKAGE}.{BENCHES[name]}")
            report.rows.extend(getattr(module, f"measure_{name}")(rounds))
        except Exception as error:
            report.failures[name] = f"{type(error).__name__}: {error}"
    return report


def write(rows: Sequence[Row], path: Path) -> None:
    """Write the rows as a JSON list, making the folder when needed."""
    claim(path)
    path.write_text(to_json_text([row.to_json() for row in rows]) + "\n", encoding="utf-8")


def claim(path: Path) -> None:
    """Check that ``path`` can be written, before anything is measured.

    Raises
    ------
    InputError
        It is a folder, or lies where nothing can be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"out must be a file that can be written, got {path} ({error}): choose another one") from error
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"out must be a file that can be written, got {path}: choose another one")
