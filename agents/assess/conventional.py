"""Conventional RTK on simulated signals beside a recorded drive: how often it fixes, and how often wrongly.

The recorded drive is a solution of RTKLIB with its reference trajectory; its observations are not needed. The simulated
receivers drive through streets of several skies, without faults and with a steady link. One observation of each epoch
feeds both the conventional solution, RTK of a single epoch or of a Kalman filter with a ratio test and no bound of its
risk, and the navigator.
The sky whose share of usable satellites comes nearest to the recorded one is compared with the drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.in_the_loop import rate_by_street, rate_cell
from lanebound.agents.assess.rtk_figures import WRONG_M, figures
from lanebound.agents.assess.street_drives import PACKAGES, StreetDrivesConfig, street_of, work_streets
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.integrity.assessment.conventional_rtk import (
    ConventionalRtkConfig,
    ConventionalSolution,
    RtkOutcome,
    solve_epoch,
)
from lanebound.integrity.assessment.double_differences import RtkSignals
from lanebound.integrity.assessment.kinematic_rtk import KinematicConfig, KinematicFilter
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef, track_from_enu_matrix
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.rtklib import FIXED, FLOAT, read_reference, read_rtk_solution
from lanebound.integrity.replay.sensor_checks import require_same_times
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.systems import WAVELENGTH_M

__all__ = ["RtkRealismConfig", "assess_rtk", "navigator_rows", "work_street"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

SOLUTION, REFERENCE = "rover_rtk.pos", "reference.csv"  # files of the folder, as in nagoya_drive_rtk
EVERY_S = 0.2  # between epochs of the conventional solution, as recorded
MATCHED_S = 0.02  # largest time between a solution and its reference


class RtkRealismConfig(StreetDrivesConfig):
    """Streets, receivers that drive through them, and the settings of the conventional solution."""

    skies: tuple[str, ...] = Field(
        ("suburban", "urban", "dense", "skies/plaza"), min_length=1, description="levels of sky that are compared"
    )
    streets: int = Field(6, ge=1, description="streets of each sky")
    vehicles: int = Field(8, ge=1, le=4096, description="vehicles in a street; they share its city and its satellites")
    faults: str | None = Field(None, description="preset of fault rates")
    baseline_km: float = Field(9.4, ge=0, description="distance to the reference station [km]; nagoya_drive_rtk")
    receiver: Literal["epoch", "filtered"] = Field(
        "epoch", description="conventional solution: of each epoch alone, or of a Kalman filter (``kinematic``)"
    )
    solution: ConventionalRtkConfig = ConventionalRtkConfig()
    kinematic: KinematicConfig = KinematicConfig()

    def navigator_in(self, sky: str) -> NavigatorConfig:
        """The navigator of a sky with this baseline and a link without outages: recorded data have all messages."""
        config = super().navigator_in(sky)
        return config.replace(gnss={"baseline_km": self.baseline_km}, corrections={"outage_per_h": 0.0})


def assess_rtk(
    folder: Path, config: RtkRealismConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Compare a recorded drive with simulated ones, and write ``results.json``; returns its data.

    Raises
    ------
    InputError
        The folder holds no solution with its reference, or ``out`` cannot be claimed.
    """
    recorded = recorded_figures(folder)
    ResultFolder(out, "realism of RTK", config.to_dict(), code_digest(*PACKAGES)).claim()
    found = work_streets(config, config.streets, work_street, out, jobs, on_progress)
    skies = {sky: simulated_figures(streets) for sky, streets in found.items()}
    shares = {sky: one["satellites"]["share"] for sky, one in skies.items()}
    nearest = min(shares, key=lambda sky: abs(shares[sky] - recorded["satellites"]["share"]))
    result = {"config": config.to_dict(), "recorded": recorded, "skies": skies, "nearest": nearest}
    write_json(out / "results.json", result)
    return result


def recorded_figures(folder: Path) -> dict[str, Any]:
    """The figures of a recorded drive; epochs of the reference without a solution count as epochs without a position.

    Raises
    ------
    InputError
        A file is missing or malformed, or solution and reference have no epoch in common.
    """
    for name in (SOLUTION, REFERENCE):
        if not (folder / name).is_file():
            raise InputError(
                f"{folder} must hold {SOLUTION} and {REFERENCE}, has no {name}: name the folder of a drive"
            )
    solution, truth = read_rtk_solution(folder / SOLUTION), read_reference(folder / REFERENCE)
    time_s = truth.since_start(solution.gps_time_s)
    at = np.clip(np.searchsorted(time_s, truth.tow_s - MATCHED_S), 0, time_s.size - 1)
    known = np.abs(time_s[at] - truth.tow_s) <= MATCHED_S
    if not known.any():
        raise InputError(f"{SOLUTION} and {REFERENCE} of {folder} must overlap in time, do not: use files of one drive")
    require_same_times(SOLUTION, time_s, solution.position_ecef_m, truth.tow_s, truth.position_ecef_m)
    latitude, longitude, _ = geodetic_from_ecef(truth.position_ecef_m[0])
    axes = ecef_from_enu_matrix(latitude, longitude)
    off = (solution.position_ecef_m[at] - truth.position_ecef_m) @ axes
    quality = np.where(known, solution.quality[at], 0)
    outcome = np.select([quality == FIXED, quality == FLOAT], [int(RtkOutcome.FIXED), int(RtkOutcome.FLOAT)], 0)
    speed = np.linalg.norm(np.gradient(truth.position_ecef_m, truth.tow_s, axis=0), axis=-1)
    satellites = np.where(known, solution.satellites[at], 0)
    heading = truth.heading_rad[:, None]
    return figures(truth.tow_s, outcome[:, None], off[:, None, :2], satellites[:, None], speed[:, None], heading)


def work_street(config: RtkRealismConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Drive one street: conventional solutions (T, B), and counts of the navigator's levels; it depends on no other."""
    navigator, drive = street_of(config, sky, number)
    dt = navigator.config.dt_s
    first, epochs = (round(time_s / dt) for time_s in (config.warm_up_s, config.span_s))
    every, solved = max(round(EVERY_S / dt), 1), []
    receivers = ConventionalReceivers(
        config, config.vehicles, len(navigator.track.system), navigator.config.gnss.bands, every * dt
    )
    counted = {"epochs": 0, "rtk": 0, "beyond": 0, "beyond_rtk": 0, "wrong_rtk": 0}
    for k, truth in zip(range(epochs), drive, strict=False):
        m = navigator.measure(truth)
        s = navigator.locate(m)
        receivers.notice(m)
        found = receivers.solve(m, truth.position_enu_m) if k % every == 0 else None
        advance((k + 1) / epochs)
        if k < first:
            continue
        error = s.position_en_m - truth.position_enu_m[:, :2]
        turned = np.einsum("bij,bj->bi", track_from_enu_matrix(truth.heading_rad), error)
        beyond, fixed = (np.abs(turned) > s.pl_cases_m[:, 0]).any(-1), s.mode == Mode.RTK
        wrong = fixed & (np.hypot(error[:, 0], error[:, 1]) > WRONG_M)
        for key, which in (
            ("epochs", s.mode != Mode.NONE), ("rtk", fixed), ("beyond", beyond), ("beyond_rtk", beyond & fixed),
            ("wrong_rtk", wrong),
        ):  # fmt: skip
            counted[key] += int(which.sum())
        if found is not None:
            speed = np.linalg.norm(truth.velocity_enu_mps, axis=-1)
            solved.append(np.column_stack([found, speed, truth.heading_rad]))
    table = np.round(np.stack(solved), 4)
    names = "outcome", "error_east_m", "error_north_m", "satellites", "speed_mps", "heading_rad"
    return {"navigator": counted} | {key: table[..., i].tolist() for i, key in enumerate(names)}


class ConventionalReceivers:
    """The conventional receivers of B vehicles, which solve an epoch every ``every_s`` [s]."""

    def __init__(
        self, config: RtkRealismConfig, vehicles: int, satellites: int, bands: tuple[int, ...], every_s: float
    ) -> None:
        self._solution, self._bands, self._every_s = config.solution, list(bands), every_s
        self._lost = np.zeros((vehicles, satellites), np.bool_)
        self._filters = [
            KinematicFilter(config.kinematic, config.solution, satellites, len(bands))
            for _ in range(vehicles if config.receiver == "filtered" else 0)
        ]

    def notice(self, m: Measurements) -> None:
        """Keep the losses of lock of an epoch for the next solution."""
        self._lost |= m.gnss.lock_lost

    def solve(self, m: Measurements, position_m: Array) -> Array:
        """Outcome, error East and North [m] and number of satellites of each vehicle, (B, 4)."""
        rows = []
        for v, at in enumerate(m.sky.index):
            found = self._solve(v, _signals(m, v, int(at), self._bands))
            rows.append((int(found.outcome), *(found.position_m[:2] - position_m[v, :2]), found.satellites))
        self._lost[:] = False
        return np.array(rows, dtype=np.float64)

    def _solve(self, v: int, signals: RtkSignals) -> ConventionalSolution:
        if self._filters:
            return self._filters[v].step(signals, self._lost[v], self._every_s)
        return solve_epoch(self._solution, signals)


def _signals(m: Measurements, v: int, at: int, bands: list[int]) -> RtkSignals:
    """The signals of a vehicle, whose sky is row ``at``."""
    sky, g, width = m.sky, m.gnss, len(bands)
    return RtkSignals(
        sky.los_enu[at], sky.elevation_rad[at], sky.system, g.cn0_dbhz[v], g.tracked[v], g.code_m[v, :, :width],
        g.phase_m[v, :, :width], WAVELENGTH_M[sky.system][:, bands],
    )  # fmt: skip


def simulated_figures(streets: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The figures of all vehicles of a sky together, and those of the navigator."""
    outcome, east, north, satellites, speed, heading = (
        np.concatenate([np.asarray(street[key], dtype=np.float64) for street in streets], 1)
        for key in ("outcome", "error_east_m", "error_north_m", "satellites", "speed_mps", "heading_rad")
    )
    found = figures(
        EVERY_S * np.arange(len(outcome), dtype=np.float64),
        outcome.astype(np.int64),
        np.stack([east, north], -1),
        satellites,
        speed,
        heading,
    )
    counts = {key: np.array([street["navigator"][key] for street in streets]) for key in streets[0]["navigator"]}
    return found | {
        "navigator": {
            "epochs": int(counts["epochs"].sum()),
            "rtk_share": float(counts["rtk"].sum() / max(counts["epochs"].sum(), 1)),
            "wrong_rtk": int(counts["wrong_rtk"].sum()),
            "beyond": rate_by_street(counts["beyond"], counts["epochs"]),
            "beyond_rtk": rate_by_street(counts["beyond_rtk"], counts["rtk"]),
        }
    }


def navigator_rows(result: Mapping[str, Any]) -> Table:
    """Errors of the navigator beyond its levels on the same signals, over its risk."""
    risk, streets = result["config"]["navigator"]["risk"]["integrity_risk"], result["config"]["streets"]
    rows = []
    for sky, f in result["skies"].items():
        n = f["navigator"]
        cells = [rate_cell(n["beyond"], risk, streets), rate_cell(n["beyond_rtk"], risk, streets)]
        if not n["rtk_share"]:
            cells[1] = "-"
        rows.append((sky, f"{n['epochs']:,}", f"{100.0 * n['rtk_share']:.1f} %", str(n["wrong_rtk"]), *cells))
    return ("sky", "epochs", "RTK", f"RTK {WRONG_M:g} m off", "beyond over risk", "the same of RTK"), rows
