"""The urban drive for all its seeds, batch by batch, and its tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.serialization import finite_or_none
from lanebound.agents.studies.urban_drive import (
    CELLS,
    Drives,
    PrintedFigure,
    UrbanDriveConfig,
    drive,
    seed_statistics,
    street,
)
from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.assessment.series import map_figure, series_figure
from lanebound.integrity.assessment.stanford import stanford_figure
from lanebound.integrity.motion.drive import CityDrive
from lanebound.integrity.sky.city import City

__all__ = ["check", "check_drive", "is_short", "lookup", "rows_against_paper", "run_study", "summarise", "verdict"]

PACKAGES = ("lanebound.integrity", "lanebound.agents.studies")
ALERT_LIMIT_M = 1.0  # S1 section 5
FIGURE_RISKS = {"1e-4": 1, "1e-6": 3}  # S1 figures 3 and 4


def run_study(
    config: UrbanDriveConfig, out: Path, on_progress: OnProgress = ignore, masks: Path | None = None
) -> dict[str, Any]:
    """Drive the missing batches, and write ``tables.json`` and the figures into ``out``; returns the tables.

    Parameters
    ----------
    on_progress : called with the number of epochs
    masks : folder of cached sky masks; by default that of the parts

    Raises
    ------
    InputError
        As :func:`check`.
    """
    check(config, out)
    batches = _batches(config)
    epochs = round(60.0 * config.minutes / config.navigator.dt_s)
    found = run_parts(
        out, list(batches), partial(_drive_batch, config, out, masks or out / "parts"), 1, on_progress,
        size=lambda name: len(batches[name]) * epochs, infinite=True,
    )  # fmt: skip
    statistics = [drive_ for part in found.values() for drive_ in part]
    tables = {"seeds": config.seeds, "minutes": config.minutes, **summarise(statistics)}
    tables = finite_or_none(tables)
    write_json(out / "tables.json", tables)
    return dict(tables)


def _batches(config: UrbanDriveConfig) -> dict[str, list[int]]:
    """Seeds of each part by its name."""
    last = config.first_seed + config.seeds
    seeds = (range(first, min(first + config.batch, last)) for first in range(config.first_seed, last, config.batch))
    return {f"seeds-{batch[0]}-{batch[-1]}": list(batch) for batch in seeds}


def _drive_batch(config: UrbanDriveConfig, out: Path, masks: Path, name: str, advance: Advance) -> list[dict[str, Any]]:
    """Statistics of the drives of a part; the figures are of the first drive."""
    seeds = _batches(config)[name]
    road, city, mask = street(config, masks)
    drives = drive(config, road, mask, seeds, advance)
    if seeds[0] == config.first_seed:
        _figures(drives, city, out)
    return seed_statistics(drives, config.navigator.dt_s)


def check(config: UrbanDriveConfig, out: Path) -> None:
    """Refuse a configuration that cannot be driven, and claim the folder.

    Raises
    ------
    InputError
        The road cannot be driven, there is no satellite, or ``out`` cannot be claimed.
    """
    check_drive(config)
    ResultFolder(out, "urban drive study", config.to_dict(), code_digest(*PACKAGES)).claim()


def check_drive(config: UrbanDriveConfig) -> None:
    """Refuse a configuration that cannot be driven.

    Raises
    ------
    InputError
        The road cannot be driven, or there is no satellite.
    """
    CityDrive(config.road(), config.drive, config.navigator.dt_s)
    config.navigator.sky.satellites()


def _leaves(tree: dict[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key), value


def lookup(tree: dict[str, Any], path: tuple[str, ...]) -> Any:
    """The value at a path, or None."""
    found: Any = tree
    for key in path:
        if not isinstance(found, dict) or key not in found:
            return None
        found = found[key]
    return found


def summarise(statistics: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the drives of every figure, under its own names, and the 5 % and 95 % quantiles under ``spread``.

    ``epochs`` are sums over the drives, and ``exceedance`` the share of those epochs: medians hide rare events.
    """
    paths = sorted({path for drive_ in statistics for path, _ in _leaves(drive_)})
    tables: dict[str, Any] = {"spread": {}}
    for path in paths:
        values = [v for s in statistics if (v := lookup(s, path)) is not None]
        middle, low, high = _quantiles(values)
        if path[0] == "exceedance":
            middle = _pooled(statistics, path)
        elif path[0] == "epochs":
            middle = sum(values)
        for target, leaf in ((tables, middle), (tables["spread"], [low, high])):
            for key in path[:-1]:
                target = target.setdefault(key, {})
            target[path[-1]] = leaf
    tables["pl_bounds_error"] = {
        mode: {risk: rate == 0.0 for risk, rate in kinds["published"].items()}
        for mode, kinds in tables.get("exceedance", {}).items()
    }
    return tables


def _pooled(statistics: list[dict[str, Any]], path: tuple[str, ...]) -> float:
    """A share of the epochs of one mode, of all drives together."""
    pairs = [(rate, lookup(one, ("epochs", path[1]))) for one in statistics if (rate := lookup(one, path)) is not None]
    return float(sum(rate * epochs for rate, epochs in pairs) / sum(epochs for _, epochs in pairs))


def _quantiles(values: list[float]) -> tuple[float, float, float]:
    """Median, 5 % and 95 % quantile; no interpolation towards a level that is infinite."""
    found = np.quantile(values, [0.5, 0.05, 0.95], method="linear" if np.isfinite(values).all() else "higher")
    return float(found[0]), float(found[1]), float(found[2])


def rows_against_paper(tables: dict[str, Any]) -> list[dict[str, Any]]:
    """Each printed figure of S1 next to ours: paper, ours, 5 and 95 % of the drives, the band aimed at, whether met."""
    return [_row(cell, tables) for cell in CELLS]


def _row(cell: PrintedFigure, tables: dict[str, Any]) -> dict[str, Any]:
    ours, spread = lookup(tables, cell.path), lookup(tables["spread"], cell.path)
    return {
        "figure": ".".join(cell.path),
        "paper": cell.published,
        "ours": ours,
        "low": spread[0] if spread else None,
        "high": spread[1] if spread else None,
        "band": [cell.low, cell.high],
        "met": ours is not None and cell.low <= ours <= cell.high,
        "remark": cell.remark,
    }


def is_short(tables: dict[str, Any]) -> bool:
    """Whether a run has fewer or shorter drives than the study, for which the bands are meant."""
    full = UrbanDriveConfig()
    return bool(tables["seeds"] < full.seeds or tables["minutes"] < full.minutes)


def verdict(row: dict[str, Any], short: bool) -> str:
    """Where our value lies; a short run is named as such."""
    if row["ours"] is None:
        return "none"
    if row["met"]:
        return "inside"
    return "outside (short run)" if short else "outside"


def _record(drives: Drives, b: int, level: int) -> Record:
    start = int(np.argmax(drives.mode[:, b] > 0))
    pl = drives.level_m[start:, b, level].astype(float)
    over = np.asarray((pl > ALERT_LIMIT_M).any(-1), dtype=np.bool_)
    return Record(
        time_s=drives.time_s[start:],
        mode=drives.mode[start:, b],
        error_at_m=drives.error_m[start:, b, 0].astype(float),
        error_ct_m=drives.error_m[start:, b, 1].astype(float),
        pl_at_m=pl[:, 0],
        pl_ct_m=pl[:, 1],
        alert=over,
        available=~over,
    )


def _figures(drives: Drives, city: City, out: Path) -> None:
    """The first drive: S1 figures 3 and 4, Stanford diagrams, and a map."""
    for risk, level in FIGURE_RISKS.items():
        record = _record(drives, 0, level)
        save(
            series_figure(record, risk=float(risk), al_at_m=ALERT_LIMIT_M, al_ct_m=ALERT_LIMIT_M),
            out / f"series-{risk}.png",
        )
        save(stanford_figure(record, ALERT_LIMIT_M, ALERT_LIMIT_M, risk=float(risk)), out / f"stanford-{risk}.png")
    start = int(np.argmax(drives.mode[:, 0] > 0))  # as the series
    position, mode = drives.position_en_m[start:, 0].astype(float), drives.mode[start:, 0]
    title = f"First drive, {drives.time_s[-1] / 60.0:.0f} min, by mode of positioning"
    save(map_figure(position, mode, title=title, obstacles=_outlines(city)), out / "map.png")


def _outlines(city: City) -> NDArray[np.float64]:
    """Level triangles of all that is solid, as a map shows them: roofs and overpasses.  (n, 3, 2) [m]."""
    triangles = city.triangles_enu_m[~city.foliage]
    level = np.ptp(triangles[:, :, 2], axis=1) < 1e-6
    return np.asarray(triangles[level, :, :2])
