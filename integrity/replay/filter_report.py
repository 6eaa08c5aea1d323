"""Statistics and figure of a recorded drive through a filter: errors, levels, exceedances, what the recording lacks."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.bounding import measure_bounding
from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.assessment.series import series_figure
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.recorded.comma import read_comma
from lanebound.integrity.replay.city_report import read_city
from lanebound.integrity.replay.filter_drive import (
    FilterDrive,
    FilterReplayConfig,
    comma_sensors,
    drive_filter,
    smartloc_sensors,
)
from lanebound.integrity.replay.recording_checks import check_comma, check_smartloc

__all__ = ["filter_summary", "write_filter"]

Array = NDArray[np.float64]
CAUTION = "epochs of one drive are not independent: the exact intervals are too narrow"


def write_filter(
    folder: Path, kind: str, out: Path, navigator: str, changes: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a smartLoc or comma2k19 folder through a filter; writes ``replay.json`` and ``series.png`` into ``out``.

    navigator : name of a preset, or ``filter``; ``changes`` of :class:`FilterReplayConfig`

    Raises
    ------
    InputError
        The folder lacks what the filter needs.
    ConfigError
        The navigator is no filter, or a change is invalid.
    """
    named = {"navigator": NavigatorConfig.data_of(navigator)}
    config = FilterReplayConfig.build(None, deep_merge(named, dict(changes)))
    if kind == "smartloc":
        city = read_city(folder)
        sensors, notes, agreement = smartloc_sensors(city, config), city.notes, check_smartloc(city)
    else:
        segment = read_comma(folder)
        agreement = check_comma(segment)
        sensors, notes = comma_sensors(segment, config), segment.notes
    drive = drive_filter(sensors, config)
    found = {"dataset": "filter", "recording": kind, "navigator": navigator, "stopped": notes}
    found["agreement"] = {name: of.figures() for name, of in agreement.items()}
    found |= filter_summary(drive, config)
    out.mkdir(parents=True, exist_ok=True)
    summary = out / "replay.json"
    summary.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    figure = series_figure(_record(drive, 1), risk=config.risks[0])
    return found, [summary, save(figure, out / "series.png")]


def filter_summary(drive: FilterDrive, config: FilterReplayConfig) -> dict[str, Any]:
    """Statistics as JSON data, over the epochs with a level and a known truth."""
    s, error = drive.sensors, _errors(drive)
    levelled = s.known & np.isfinite(drive.levels_m[:, 0]).all(-1)
    fixed = s.known & s.fix.valid
    off = np.linalg.norm(error, axis=-1)
    fix_off = np.linalg.norm(s.fix.position_m[:, :2] - s.truth_m, axis=-1)
    return {
        "filter": drive.config.filter,
        "epochs": int(s.time_s.size),
        "with_truth": int(s.known.sum()),
        "with_level": int(levelled.sum()),
        "first_level_s": float(s.time_s[np.argmax(levelled)]) if levelled.any() else None,
        "sensors": list(s.instruments),
        "lacking": list(s.lacking),
        "horizontal_m": _spread(off[levelled]),
        "positions_m": _spread(fix_off[fixed]),
        "positions": {
            "valid": int(s.fix.valid.sum()), "used": int(drive.used.sum()), "rejected": int(drive.rejected.sum()),
            "nis_median": float(np.median(drive.nis[drive.nis > 0.0])) if (drive.nis > 0.0).any() else None,
        },
        "curved_mean": float(drive.curved[levelled].mean()) if levelled.any() else None,
        "trust": {
            "median_m": float(np.median(drive.trust_m[levelled])) if levelled.any() else None,
            "exceeded": int((off[levelled] > drive.trust_m[levelled]).sum()),
        },
        "levels": {
            f"{risk:g}": {
                axis: asdict(measure_bounding(np.abs(error[levelled, q]), drive.levels_m[levelled, 1 + k, q]))
                for q, axis in enumerate(("at", "ct"))
            }
            for k, risk in enumerate(config.risks)
            if levelled.any()
        },
        "caution": CAUTION,
    }  # fmt: skip


def _errors(drive: FilterDrive) -> Array:
    """Estimate less truth along and across the estimated heading, (T, 2)."""
    off = drive.position_m - drive.sensors.truth_m
    return np.asarray((track_from_enu_matrix(drive.heading_rad) @ off[..., None])[..., 0])


def _spread(value: Array) -> dict[str, float] | None:
    """RMS, median, 95 % and largest."""
    if not value.size:
        return None
    return {
        "rms": float(np.sqrt(np.square(value).mean())), "median": float(np.median(value)),
        "p95": float(np.quantile(value, 0.95)), "max": float(value.max()),
    }  # fmt: skip


def _record(drive: FilterDrive, case: int) -> Record:
    """Epochs with a truth, with the levels of a case."""
    s, error = drive.sensors, _errors(drive)
    k = s.known
    level = drive.levels_m[k, case]
    return Record(
        s.time_s[k], drive.mode[k], error[k, 0], error[k, 1], level[:, 0], level[:, 1], drive.alert[k],
        drive.available[k],
    )  # fmt: skip
