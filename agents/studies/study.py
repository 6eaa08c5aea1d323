"""The skeleton of a study: it claims its folder, computes the parts that are missing there, and stores its results.

What a command shows of a study are lines and tables in the order of :data:`Shown`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.report.pages import Table
from lanebound.integrity.core.config import Config

C = TypeVar("C", bound=Config)

Shown = str | tuple[str, Table]
"""A line, or a table under its title; a table without rows is left out."""


def claim(
    out: Path, kind: str, config: Config, packages: Sequence[str], growing: str = "", names: Sequence[str] = ()
) -> None:
    """Claim the folder of a study of a kind; its results follow from ``config`` and the code of ``packages``.

    Parameters
    ----------
    growing, names : what the parts are of, such as ids, and their names, where further ones may be added later; the
        keys of ``config`` that list them are then not compared (``envs``, ``skies``)

    Raises
    ------
    InputError
        ``out`` holds other work, results of another version or foreign files.
    """
    values, fixed, source = config.to_dict(), None, code_digest(*packages)
    if growing:
        fixed = {**values, growing: dict.fromkeys(names, True)}
        fixed.update((key, None) for key in ("envs", "skies") if key in values)
    ResultFolder(out, kind, values, source, fixed=fixed, growing=(growing,) if growing else ()).claim()


def parts_of(
    config: C,
    work: Callable[[C, str, Advance], Any],
    names: Sequence[str],
    out: Path,
    jobs: int = 1,
    on_progress: OnProgress = ignore,
    **more: Any,
) -> dict[str, Any]:
    """Data of parts by name: those in the claimed folder, and ``work(config, name, advance)`` of the others.

    ``work`` must be picklable with more than one job; ``more`` are those of
    :func:`~lanebound.agents.checkpointing.runner.run_parts`.
    """
    return run_parts(out, names, partial(work, config), jobs, on_progress, **more)


def seed_batches(first: int, count: int, size: int) -> list[list[int]]:
    """Seeds from the first one on in batches of at most ``size``."""
    last = first + count
    return [list(range(begin, min(begin + size, last))) for begin in range(first, last, size)]


def spread(values: Iterable[float]) -> list[float]:
    """Median, 5 % and 95 % quantile; no interpolation towards a value that is infinite."""
    found = np.array(list(values), dtype=np.float64)
    method: Any = "linear" if np.isfinite(found).all() else "higher"
    return [float(q) for q in np.quantile(found, [0.5, 0.05, 0.95], method=method)]


def stored(result: Mapping[str, Any], out: Path, name: str = "results.json") -> dict[str, Any]:
    """Write the results of a study as JSON into its folder, and return them."""
    write_json(out / name, result)
    return dict(result)
