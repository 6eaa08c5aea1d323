"""Finds the benchmarks and runs them one after another; one that fails does not stop the others."""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from lanebound.agents.bench.rows import Row
from lanebound.agents.serialization import to_json_text
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["Report", "benchmark_names", "claim", "run", "select", "write"]

BENCH_PACKAGE = "lanebound.agents.bench"
SUPPORT = {"rows", "runner"}
ON_REQUEST = {"cold"}
"""Benchmarks of several minutes, which run only when they are named."""


@dataclass
class Report:
    """The measured rows, and the reasons of failure by benchmark."""

    rows: list[Row] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)


def benchmark_names() -> list[str]:
    """Modules of this package other than the support modules and those that begin with an underscore, sorted."""
    found = pkgutil.iter_modules(import_module(BENCH_PACKAGE).__path__)
    return sorted(item.name for item in found if item.name not in SUPPORT and not item.name.startswith("_"))


def select(only: Sequence[str]) -> list[str]:
    """The named benchmarks; without a name, all but those of ``ON_REQUEST``.

    Raises
    ------
    InputError
        A name is unknown; the message offers the nearest.
    """
    known = benchmark_names()
    for name in only:
        if name not in known:
            raise InputError(f"benchmark '{name}' is unknown: {nearest(name, known)}")
    return [name for name in known if name in only] if only else [name for name in known if name not in ON_REQUEST]


def run(names: Sequence[str], rounds: int = 5, progress: Callable[[str], None] | None = None) -> Report:
    """Run benchmarks by name; ``progress`` is called with each name before it runs.

    A module without ``measure`` is a helper of the others and is skipped.
    """
    report = Report()
    for name in names:
        if progress is not None:
            progress(name)
        try:
            measure = getattr(import_module(f"{BENCH_PACKAGE}.{name}"), "measure", None)
            if measure is not None:
                report.rows.extend(measure(rounds))
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
