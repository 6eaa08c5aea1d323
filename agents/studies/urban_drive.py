"""A Tokyo-like urban drive, and the tables of S1 that come out of it (sections 4 and 5, tables 2, 4 and 5).

Many seeds drive the same loop for the same time: each has its own traffic lights, signals, instruments and outages.
Figures are medians over the seeds of the statistic of one drive, with their spread: one drive alone passes or fails by
luck.

Figures printed by the source papers, as data, and the bands within which ours should fall.

S1: El-Mowafy and Kubo, integrated RTK, IMU and odometer positioning (tables 2, 4, 5 and the text of section 5).
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.monitoring.risk import Variant
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import LevelForm, Navigator, NavigatorConfig, PlCase
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.city import City, CityConfig, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["CELLS", "MODES", "RISKS", "Drives", "PrintedFigure", "UrbanDriveConfig", "drive", "seed_statistics"]


MODES = ("rtk", "doppler", "imu_odometer")
RISKS = (1e-3, 1e-4, 1e-5, 1e-6)

MODE_SHARE = {"rtk": 0.722, "doppler": 0.258, "imu_odometer": 0.02}  # S1 section 5
ERROR_M = {  # S1 table 2
    "rtk": {"median_at_m": 0.058, "median_ct_m": 0.054, "rmse_at_m": 0.077, "rmse_ct_m": 0.105},
    "doppler": {"median_at_m": 0.163, "median_ct_m": 0.172, "rmse_at_m": 0.332, "rmse_ct_m": 0.442},
    "imu_odometer": {"median_at_m": 0.150, "median_ct_m": 0.321, "rmse_at_m": 0.249, "rmse_ct_m": 0.206},
}
PL_AT_M = {  # S1 table 4, by risk 1e-3 .. 1e-6
    "rtk": (0.176, 0.197, 0.215, 0.232),
    "doppler": (1.355, 1.621, 1.851, 2.057),
    "imu_odometer": (1.208, 1.368, 1.506, 1.601),
}
PL_CT_M = {  # S1 table 5
    "rtk": (0.148, 0.164, 0.177, 0.188),
    "doppler": (1.802, 2.159, 2.468, 2.623),
    "imu_odometer": (0.884, 1.101, 1.150, 1.191),
}
IMPOSSIBLE = {("error", "imu_odometer", "rmse_ct_m"), ("error", "imu_odometer", "median_ct_m")}


@dataclass(frozen=True)
class PrintedFigure:
    """One printed figure: ``path`` in tables.json, its value, the band we aim at and a remark."""

    path: tuple[str, ...]
    published: float
    low: float
    high: float
    remark: str = ""


def risk_key(risk: float) -> str:
    """``1e-3`` for 0.001."""
    return f"1e-{round(-math.log10(risk))}"


def _cells() -> list[PrintedFigure]:
    share_band = {"rtk": (0.672, 0.772), "doppler": (0.208, 0.308), "imu_odometer": (0.01, 0.04)}
    cells = [PrintedFigure(("mode_share", m), MODE_SHARE[m], *share_band[m]) for m in MODES]
    for mode in MODES:
        tolerance = 0.6 if mode == "imu_odometer" else 0.3
        for key, value in ERROR_M[mode].items():
            remark = (
                "printed RMSE is below the printed median over sqrt 2" if ("error", mode, key) in IMPOSSIBLE else ""
            )
            cells.append(
                PrintedFigure(("error", mode, key), value, value * (1 - tolerance), value * (1 + tolerance), remark)
            )
    for mode in MODES:
        tolerance = 0.4 if mode == "imu_odometer" else 0.25
        for axis, table in (("at", PL_AT_M), ("ct", PL_CT_M)):
            for risk, value in zip(RISKS, table[mode], strict=True):
                path = ("pl_median", mode, f"{axis}_m", risk_key(risk))
                remark = "0.567 K + 0.050 gives 2.745" if (mode, axis, risk) == ("doppler", "ct", 1e-6) else ""
                cells.append(PrintedFigure(path, value, value * (1 - tolerance), value * (1 + tolerance), remark))
    return cells


CELLS = _cells()


Array = NDArray[np.float64]

MODE_CODES = {"rtk": Mode.RTK, "doppler": Mode.DOPPLER, "imu_odometer": Mode.IMU_ODOMETER}
LOOP_M = (
    (0.0, 0.0), (700.0, 150.0), (1100.0, -100.0), (1500.0, 300.0), (1400.0, 900.0), (800.0, 1100.0), (300.0, 900.0),
    (-200.0, 1000.0), (-350.0, 400.0),
)  # fmt: skip


class UrbanDriveConfig(Config):
    """Everything the study depends on."""

    seeds: int = Field(100, ge=1, description="drives [-]; each is one seed")
    first_seed: int = Field(1000, ge=0, description="seed of the first drive [-]")
    minutes: float = Field(26.0, gt=0, description="length of one drive [min]; S1 drove about 25")
    batch: int = Field(25, ge=1, description="drives run together, and lost together by an interruption [-]")
    city_seed: int = Field(7, ge=0, description="seed of the street's buildings [-]")
    loop_m: tuple[tuple[float, float], ...] = Field(
        LOOP_M, min_length=3, description="corners of the loop, East, North [m]"
    )
    lane_width_m: float = Field(3.25, gt=0, description="lane width [m]; Road Structure Order of Japan, urban roads")
    lanes: int = Field(2, ge=1, description="lanes of the carriageway [-]; S2: 2 to 3 lanes on each side")
    city: CityConfig = CityConfig()
    drive: DriveConfig = DriveConfig()
    navigator: NavigatorConfig = NavigatorConfig()

    def road(self) -> Road:
        """The loop."""
        return Road.through(
            np.array(self.loop_m),
            corner_radius_m=25.0,
            closed=True,
            lane_count=self.lanes,
            lane_width_m=self.lane_width_m,
        )

    def with_levels(self) -> NavigatorConfig:
        """The navigator with the eight reported levels behind its operative one: four published, then four exact."""
        cases = [
            PlCase(
                integrity_risk=risk,
                variant=variant,
                form=LevelForm.CLOSED if variant is Variant.PUBLISHED else LevelForm.ROOT,
            )
            for variant in (Variant.PUBLISHED, Variant.EXACT)
            for risk in RISKS
        ]
        return self.navigator.replace(more_levels=[case.to_dict() for case in cases])


@dataclass(frozen=True)
class Drives:
    """Time series of a batch of drives: (T, B) each, levels (T, B, 8, 2) behind the operative one."""

    time_s: Array
    mode: NDArray[np.int8]
    rtk: NDArray[np.int8]
    error_m: NDArray[np.float32]
    level_m: NDArray[np.float32]
    position_en_m: NDArray[np.float32]
    satellites: NDArray[np.int16]


def street(config: UrbanDriveConfig, cache: Path | None = None) -> tuple[Road, City, SkyMask]:
    """The loop, the city along it, and its sky mask, which is cached in the folder ``cache``."""
    road = config.road()
    city = build_city(road, config.city, named_generator(config.city_seed, "city"))
    digest = SkyMask.digest_of(road, city)
    path = None if cache is None else cache / f"mask-{digest[:16]}.npz"
    if path is not None and path.exists():
        return road, city, SkyMask.load(path, digest)
    mask = SkyMask.build(road, city)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f"draft-{path.name}")  # NumPy wants the suffix .npz
        mask.save(draft)
        os.replace(draft, path)
    return road, city, mask


def drive(
    config: UrbanDriveConfig,
    road: Road,
    mask: SkyMask,
    seeds: list[int],
    advance: Advance = ignore,
) -> Drives:
    """Drive the loop with each seed; ``advance`` is called with the share of the epochs that is done."""
    navigation = config.with_levels()
    dt, epochs = navigation.dt_s, round(60.0 * config.minutes / navigation.dt_s)
    horizon_s = 3600.0 * np.ceil(
        (60.0 * config.minutes + 60.0) / 3600.0
    )  # whole hours: short drives begin as long ones
    track = SkyTrack.from_config(navigation.sky, horizon_s)
    navigator = Navigator(navigation, track, mask, seeds)
    car, traffic = CityDrive(road, config.drive, dt), Streams(seeds)
    state = car.start(traffic, spread_m=road.length_m)
    batch = len(seeds)
    out = Drives(
        time_s=np.asarray(dt * np.arange(1, epochs + 1), dtype=np.float64),
        mode=np.zeros((epochs, batch), dtype=np.int8),
        rtk=np.zeros((epochs, batch), dtype=np.int8),
        error_m=np.zeros((epochs, batch, 2), dtype=np.float32),
        level_m=np.zeros((epochs, batch, 2 * len(RISKS), 2), dtype=np.float32),
        position_en_m=np.zeros((epochs, batch, 2), dtype=np.float32),
        satellites=np.zeros((epochs, batch), dtype=np.int16),
    )
    for k in range(epochs):
        truth = car.step(state, traffic)
        s = navigator.step(truth)
        d = s.position_en_m - truth.position_enu_m[:, :2]
        sin_h, cos_h = np.sin(truth.heading_rad), np.cos(truth.heading_rad)
        out.error_m[k, :, 0] = sin_h * d[:, 0] + cos_h * d[:, 1]
        out.error_m[k, :, 1] = cos_h * d[:, 0] - sin_h * d[:, 1]
        out.mode[k], out.rtk[k], out.level_m[k] = s.mode, s.rtk, s.pl_cases_m[:, 1:]
        out.position_en_m[k], out.satellites[k] = truth.position_enu_m[:, :2], s.satellites_doppler
        if k % 100 == 99:
            advance((k + 1) / epochs)
    return out


def outage_lengths_s(rtk: NDArray[np.bool_], dt_s: float) -> Array:
    """Lengths of the runs without RTK between two RTK epochs.  rtk (T,) -> (n,) [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], rtk.astype(np.int8), [1]])))
    return np.asarray((edges[1::2] - edges[::2]) * dt_s)


def seed_statistics(drives: Drives, dt_s: float) -> list[dict[str, Any]]:
    """Statistics of each drive, from its first position on: the cells of S1's tables and what goes with them.

    Published and exact levels stand next to each other, each begun from its own level at the last fix.
    """
    return [_one_drive(drives, b, dt_s) for b in range(drives.mode.shape[1])]


def _one_drive(drives: Drives, b: int, dt_s: float) -> dict[str, Any]:
    start = int(np.argmax(drives.mode[:, b] != Mode.NONE))
    mode = drives.mode[start:, b]
    error, level = np.abs(drives.error_m[start:, b]), drives.level_m[start:, b]
    kinds = ("mode_share", "epochs", "error", "pl_median", "pl_median_exact", "exceedance")
    found: dict[str, Any] = {kind: {} for kind in kinds}
    for name in MODES:
        here = mode == MODE_CODES[name]
        found["mode_share"][name] = float(here.mean())
        if here.any():
            e, pl = error[here], level[here]
            found["error"][name] = _accuracy(e)
            found["pl_median"][name] = _medians(pl[:, :4])
            found["pl_median_exact"][name] = _medians(pl[:, 4:])
            found["epochs"][name] = int(here.sum())
            found["exceedance"][name] = {
                kind: {risk_key(r): float((e > pl[:, first + i]).any(-1).mean()) for i, r in enumerate(RISKS)}
                for kind, first in (("published", 0), ("exact", 4))
            }
    rtk = mode == Mode.RTK
    found["availability"] = {
        "rtk_1m": float((level[rtk][:, 3] <= 1.0).all(-1).mean()) if rtk.any() else 0.0,
        "rtk_1m_exact": float((level[rtk][:, 7] <= 1.0).all(-1).mean()) if rtk.any() else 0.0,
        "all_1m": float((level[:, 3] <= 1.0).all(-1).mean()),
        "all_1m5": float((level[:, 2] <= 1.5).all(-1).mean()),
    }
    lengths = outage_lengths_s(rtk, dt_s)
    found["outages"] = {
        "count": len(lengths),
        "shortest_s": float(lengths.min()) if len(lengths) else 0.0,
        "longest_s": float(lengths.max(initial=0.0)),
        "median_s": float(np.median(lengths)) if len(lengths) else 0.0,
    }
    return found


def _accuracy(error: NDArray[np.float32]) -> dict[str, float]:
    return {
        f"{what}_{axis}_m": float(value)
        for i, axis in enumerate(("at", "ct"))
        for what, value in (("median", np.median(error[:, i])), ("rmse", np.sqrt((error[:, i] ** 2).mean())))
    }


def _medians(level: NDArray[np.float32]) -> dict[str, dict[str, float]]:
    return {
        f"{axis}_m": {risk_key(r): float(np.median(level[:, i, q])) for i, r in enumerate(RISKS)}
        for q, axis in enumerate(("at", "ct"))
    }
