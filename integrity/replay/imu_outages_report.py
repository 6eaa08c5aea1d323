"""Replay of an inertial log beside a solution of RTKLIB: files of the folder, statistics and a figure."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.integrity.assessment.bounding import measure_bounding
from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.imu_log import read_imu_log
from lanebound.integrity.recorded.rtklib import read_rtk_solution
from lanebound.integrity.recorded.series import notes
from lanebound.integrity.replay.imu_outages import ImuOutageConfig, motion_of_log, run_inertial_outages
from lanebound.integrity.replay.outages_report import by_age, drift_figure

__all__ = ["AGES_S", "imu_files", "write_imu_outages"]

AGES_S = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0)
TAG = ".tag"
CAUTION = (
    "the reference is the solution of the receiver, not a truth; outages overlap and are of one drive: the exact "
    "intervals are too narrow"
)


def imu_files(folder: Path) -> list[Path]:
    """Time tags of inertial logs (``NAME.csv.tag``) in a folder."""
    return sorted(folder.glob(f"*.csv{TAG}"))


def write_imu_outages(
    folder: Path, out: Path, config: ImuOutageConfig | None = None
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a folder with ``NAME.csv``, ``NAME.csv.tag`` and one ``.pos``; writes ``replay.json`` and ``drift.png``.

    Raises
    ------
    InputError
        A file is missing, there are several of a kind, or the drive cannot be used.
    """
    config = config or ImuOutageConfig()
    tag, solution = _only(imu_files(folder), folder, "*.csv.tag"), _only(_solutions(folder), folder, "*.pos")
    plain, zipped = tag.with_suffix(""), tag.with_suffix(".gz")
    path = zipped if zipped.is_file() and not plain.is_file() else plain
    log, track = read_imu_log(path, tag), read_rtk_solution(solution)
    motion, calibration = motion_of_log(log, track, config)
    outages = run_inertial_outages(motion, config)
    ages = (*(age for age in AGES_S if age < config.longest_s), config.longest_s)
    figures = {
        "dataset": "imu_log", "caution": CAUTION, "files": [path.name, solution.name],
        "risk": config.risk.integrity_risk, "rate_hz": log.rate_hz,
        "agreement": calibration.pop("agreement"), "calibration": calibration,
        "outages": len(outages.start_s), "left_out_at_gaps": outages.left_out,
        "speed_mps": [float(v) for v in np.quantile(outages.speed_mps, [0.0, 0.5, 1.0])],
        "by_age": by_age(outages, ages),
        "all_ages": {
            axis: asdict(measure_bounding(outages.error_m[..., q], outages.pl_m[..., q]))
            for q, axis in enumerate(("at", "ct"))
        },
        "stopped": notes((path.name, log.stopped, log.timing), (solution.name, track.stopped, track.timing)),
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    summary = out / "replay.json"
    summary.write_text(json.dumps(figures, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return figures, [summary, save(drift_figure(outages, config.risk.integrity_risk), out / "drift.png")]


def _solutions(folder: Path) -> list[Path]:
    return sorted([*folder.glob("*.pos"), *folder.glob("*.pos.gz")])


def _only(found: list[Path], folder: Path, what: str) -> Path:
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise InputError(f"{folder} must have one {what} beside its inertial log, has {names}: leave one there")
    return found[0]
