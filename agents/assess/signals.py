"""Code errors of a recorded drive beside those of a simulated receiver, by C/N0 and elevation.

Both are treated alike. The receiver's clock at an epoch is the median residual of its GPS codes of 40 dB-Hz and more;
from the residuals of every other system their median at 42 dB-Hz and more is taken. The recorded drive is shown in two
halves: figures may be chosen by the first, and are judged by the second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.street_drives import StreetDrivesConfig, street_of
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.runner import Counter, OnProgress, RunProgress, ignore
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.recorded.smartloc import read_smartloc
from lanebound.integrity.replay.sagnac import ranges_and_sights
from lanebound.integrity.replay.signal_choice import LETTERS
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.systems import System

__all__ = ["SignalsConfig", "assess_signals", "signal_rows"]

Array = NDArray[np.float64]
CLOCK_DBHZ, OFFSET_DBHZ = 40.0, 42.0
LEAST_GPS = 3  # codes for the clock of an epoch
LEAST_CODES = 20  # of a class that is shown
CN0_DBHZ = (0.0, 25.0, 32.0, 38.0, 43.0, 60.0)
ELEVATION_DEG = (0.0, 30.0, 60.0, 90.0)
QUANTILES = (0.5, 0.75, 0.9, 0.95)
EVERY = 5  # epochs of the simulation between those that count
SYSTEMS = {**LETTERS, "R": System.GLONASS}
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


class SignalsConfig(StreetDrivesConfig):
    """Streets and the receiver that drives through them, as nearly as is known those of the recording."""

    skies: tuple[str, ...] = Field(("skies/plaza",), min_length=1, max_length=1, description="sky of the streets")
    streets: int = Field(4, ge=1, description="number of streets")
    receiver: str = Field("sensors/gnss_consumer", description="preset of the receiver")
    faults: str | None = Field(None, description="preset of fault rates")
    duration_s: float = Field(60.0, gt=0, description="length of a drive after the warm-up [s]")

    def navigator_in(self, sky: str) -> NavigatorConfig:
        """The navigator with the receiver, whose signals arrive by paths unless ``propagation`` says otherwise."""
        receiver = GnssConfig.preset(self.receiver).replace(propagation=self.propagation or "paths")
        return super().navigator_in(sky).replace(gnss=receiver.to_dict())


def assess_signals(folder: Path, config: SignalsConfig, out: Path, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Compare a recorded drive with simulated ones, and write ``signals.json``; returns its data.

    Raises
    ------
    InputError
        The folder has no drive of smartLoc with its ground truth, or no epoch has enough GPS codes.
    """
    recorded = _recorded(folder)
    half = recorded[:, 0] < 0.5 * (recorded[0, 0] + recorded[-1, 0])
    seen = sorted({int(system) for system in np.unique(recorded[:, 1])})
    simulated = _simulated(config, seen, on_progress)
    halves = {"first half": _without_clock(recorded[half]), "second half": _without_clock(recorded[~half])}
    sides = {**halves, "simulated": simulated}
    result = {"config": config.to_dict(), "codes": {name: len(rows) for name, rows in sides.items()}} | {
        "classes": [
            {"cn0_dbhz": list(cn0), "elevation_deg": list(elevation)}
            | {name: _quantiles(rows, cn0, elevation) for name, rows in sides.items()}
            for cn0 in pairwise(CN0_DBHZ)
            for elevation in pairwise(ELEVATION_DEG)
        ]
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "signals.json", result)
    return result


def _recorded(folder: Path) -> Array:
    """Time, system, residual with clock [m], elevation [deg] and C/N0 of the codes of a drive, (N, 5), by time."""
    inputs, truths = sorted(folder.glob("*_Input.txt*")), sorted(folder.glob("*_GT.txt"))
    if not inputs or not truths:
        raise InputError(f"{folder} must hold *_Input.txt(.gz) and *_GT.txt of smartLoc: name the folder of a drive")
    drive = read_smartloc(inputs[0], truths[0])
    codes, truth = drive.ranges, drive.truth
    if truth is None:
        raise InputError(f"{truths[0]} must hold true positions, got none: use the *_GT file of the drive")
    position, known = truth.at(codes.time_s)
    system = np.array([SYSTEMS.get(str(letter), -1) for letter in codes.system])
    residual = codes.range_m - ranges_and_sights(codes.satellite_ecef_m, position)[0]
    columns = codes.time_s, system, residual, np.degrees(codes.elevation_rad), codes.cn0_dbhz
    rows = np.column_stack(columns)[known & (system >= 0)]
    return np.asarray(rows[np.argsort(rows[:, 0], kind="stable")])


def _simulated(config: SignalsConfig, systems: Sequence[int], on_progress: OnProgress) -> Array:
    """The same of simulated drives, of the same systems."""
    found, counter = [], Counter(on_progress, RunProgress(float(config.streets)))
    for number in range(config.streets):
        navigator, drive = street_of(config, config.skies[0], number)
        first, epochs = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, config.span_s))
        each: list[list[Array]] = [[] for _ in range(config.vehicles)]
        for k, truth in zip(range(epochs), drive, strict=False):
            m = navigator.measure(truth)
            if k < first or k % EVERY:
                continue
            wanted = np.isin(m.sky.system, systems)
            e = m.sky.los_enu[m.sky.index]
            residual = m.gnss.code_m[:, :, 0] + np.einsum("bsi,bi->bs", e, truth.position_enu_m)
            elevation = np.degrees(m.sky.elevation_rad[m.sky.index])
            for v, rows in enumerate(each):
                s = np.flatnonzero(m.gnss.tracked[v] & wanted)
                time = np.full(s.size, truth.time_s)
                rows.append(
                    np.column_stack([time, m.sky.system[s], residual[v, s], elevation[v, s], m.gnss.cn0_dbhz[v, s]])
                )
        found += [_without_clock(np.concatenate(rows)) for rows in each]
        counter(number + 1.0)
    return np.concatenate(found)


def _without_clock(rows: Array) -> Array:
    """Residuals without the clock of each epoch and the offset of each system; epochs with few GPS codes go."""
    rows = rows.copy()
    _, epoch = np.unique(rows[:, 0], return_inverse=True)
    strong = (rows[:, 1] == System.GPS) & (rows[:, 4] >= CLOCK_DBHZ)
    clock = np.full(int(epoch.max(initial=-1)) + 1, np.nan)
    for k in np.unique(epoch[strong]):
        codes = rows[strong & (epoch == k), 2]
        clock[k] = np.median(codes) if codes.size >= LEAST_GPS else np.nan
    rows[:, 2] -= clock[epoch]
    rows = rows[np.isfinite(rows[:, 2])]
    if not rows.size:
        raise InputError(f"codes must have an epoch with {LEAST_GPS} GPS codes of {CLOCK_DBHZ:g} dB-Hz, got none")
    for system in np.unique(rows[:, 1]):
        own = rows[:, 1] == system
        good = own & (rows[:, 4] >= OFFSET_DBHZ)
        if system != System.GPS and good.any():
            rows[own, 2] -= np.median(rows[good, 2])
    return rows


def _quantiles(rows: Array, cn0: tuple[float, float], elevation: tuple[float, float]) -> dict[str, Any] | None:
    """Share of a class and quantiles of its absolute residuals [m], None for a class with few codes."""
    here = (rows[:, 4] >= cn0[0]) & (rows[:, 4] < cn0[1])
    here &= (rows[:, 3] >= elevation[0]) & ((rows[:, 3] < elevation[1]) | (elevation[1] == ELEVATION_DEG[-1]))
    if here.sum() < LEAST_CODES:
        return None
    return {"share": float(here.mean()), "quantiles_m": np.quantile(np.abs(rows[here, 2]), QUANTILES).tolist()}


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
