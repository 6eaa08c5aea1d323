"""Errors of code and Doppler of a recorded drive beside those of a simulated receiver.

Codes are compared by C/N0 and elevation (:mod:`.signal_residuals` says how clocks are taken out). The recorded drive is
shown in two halves: figures may be chosen by the first, and are judged by the second. A raw table of a part of the
drive, with a label for each signal whose direct ray is blocked, adds code and Doppler errors by path.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.assess.labelled_signals import compare_paths, paths_figure
from lanebound.agents.assess.signal_residuals import SignalResiduals, labelled, recorded, simulated, without_clock
from lanebound.agents.assess.street_drives import StreetDrivesConfig
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.runner import OnProgress, ignore
from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.recorded.smartloc import read_smartloc
from lanebound.integrity.recorded.smartloc_raw import read_smartloc_raw
from lanebound.integrity.sensors.gnss import GnssConfig

__all__ = ["SignalsConfig", "assess_signals", "signal_rows"]

LEAST_CODES = 20  # of a class that is shown
CN0_DBHZ = (0.0, 25.0, 32.0, 38.0, 43.0, 60.0)
ELEVATION_DEG = (0.0, 30.0, 60.0, 90.0)
QUANTILES = (0.5, 0.75, 0.9, 0.95)
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


class SignalsConfig(StreetDrivesConfig):
    """Streets and the receiver that drives through them, as nearly as is known those of the recording."""

    skies: tuple[str, ...] = Field(("skies/plaza",), min_length=1, max_length=1, description="sky of the streets")
    streets: int = Field(4, ge=1, description="number of streets")
    receiver: str = Field("sensors/gnss_consumer", description="preset of the receiver")
    faults: str | None = Field(None, description="preset of fault rates")
    duration_s: float = Field(60.0, gt=0, description="length of a drive after the warm-up [s]")

    def navigator_in(self, sky: str) -> NavigatorConfig:
        """The navigator with the receiver."""
        return super().navigator_in(sky).replace(gnss=GnssConfig.preset(self.receiver).to_dict())


def assess_signals(
    folder: Path, config: SignalsConfig, out: Path, on_progress: OnProgress = ignore, labels: Path | None = None
) -> dict[str, Any]:
    """Compare a recorded drive with simulated ones, and write ``signals.json``; returns its data.

    ``labels`` is a raw table of a part of the drive; with it the result has code and Doppler errors by path, and
    ``signals.svg`` is written.

    Raises
    ------
    InputError
        The folder has no drive of smartLoc with its ground truth, no epoch has enough GPS codes, or the labels are of
        another drive.
    """
    inputs, truths = sorted(folder.glob("*_Input.txt*")), sorted(folder.glob("*_GT.txt"))
    if not inputs or not truths:
        raise InputError(f"{folder} must hold *_Input.txt(.gz) and *_GT.txt of smartLoc: name the folder of a drive")
    drive = read_smartloc(inputs[0], truths[0])
    codes = recorded(drive)
    excerpt = None if labels is None else without_clock(labelled(drive, read_smartloc_raw(labels)))
    half = codes.time_s < 0.5 * (codes.time_s[0] + codes.time_s[-1])
    seen = sorted({int(system) for system in np.unique(codes.system)})
    ours = simulated(config, config.streets, seen, on_progress)
    halves = {"first half": without_clock(codes.take(half)), "second half": without_clock(codes.take(~half))}
    sides = {**halves, "simulated": ours}
    result = {"config": config.to_dict(), "codes": {name: len(s.code_m) for name, s in sides.items()}} | {
        "classes": [
            {"cn0_dbhz": list(cn0), "elevation_deg": list(elevation)}
            | {name: _quantiles(s, cn0, elevation) for name, s in sides.items()}
            for cn0 in pairwise(CN0_DBHZ)
            for elevation in pairwise(ELEVATION_DEG)
        ]
    }
    out.mkdir(parents=True, exist_ok=True)
    if excerpt is not None:
        result["paths"] = compare_paths(excerpt, ours)
        save(paths_figure(excerpt, ours), out / "signals.svg")
    write_json(out / "signals.json", result)
    return result


def _quantiles(
    signals: SignalResiduals, cn0: tuple[float, float], elevation: tuple[float, float]
) -> dict[str, Any] | None:
    """Share of a class and quantiles of its absolute residuals [m], None for a class with few codes."""
    here = (signals.cn0_dbhz >= cn0[0]) & (signals.cn0_dbhz < cn0[1]) & (signals.elevation_deg >= elevation[0])
    here &= (signals.elevation_deg < elevation[1]) | (elevation[1] == ELEVATION_DEG[-1])
    if here.sum() < LEAST_CODES:
        return None
    return {"share": float(here.mean()), "quantiles_m": np.quantile(np.abs(signals.code_m[here]), QUANTILES).tolist()}


def signal_rows(result: Mapping[str, Any]) -> Table:
    """Share of each class, and quantiles of its absolute code errors, on both halves and simulated."""
    sides = list(result["codes"])

    def cell(found: Mapping[str, Any] | None) -> str:
        if found is None:
            return "-"
        return f"{100.0 * found['share']:.1f} %: " + " / ".join(f"{q:.1f}" for q in found["quantiles_m"])

    rows = [
        (
            "{:g} to {:g}".format(*one["cn0_dbhz"]),
            "{:g} to {:g}".format(*one["elevation_deg"]),
            *(cell(one[s]) for s in sides),
        )
        for one in result["classes"]
        if any(one[s] is not None for s in sides)
    ]
    return ("C/N0", "elevation", *sides), rows
