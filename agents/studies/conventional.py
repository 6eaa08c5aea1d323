"""Conventional RTK on simulated signals next to a recorded drive: how often it fixes, and how often wrongly.

The recorded drive is a solution of RTKLIB with its reference trajectory; its observations are not needed. The simulated
receivers drive through streets of several skies, without faults and with a steady link. One observation of each epoch
feeds both the conventional solution, RTK of a single epoch or of a Kalman filter with a ratio test and no bound of its
risk, and the navigator.
The sky whose share of usable satellites comes nearest to the recorded one is compared with the drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.in_the_loop import rate_by_street, rate_cell
from lanebound.agents.studies.street_drives import StreetDrivesConfig, street_of, work_streets
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.assessment.accuracy import find_outages
from lanebound.integrity.assessment.conventional_rtk import (
    ConventionalRtkConfig,
    ConventionalSolution,
    KinematicConfig,
    KinematicFilter,
    RtkOutcome,
    RtkSignals,
    solve_epoch,
)
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import enu_axes, track_from_enu_matrix
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.rtklib import FIXED, FLOAT, MATCHED_S, read_reference, read_rtk_solution
from lanebound.integrity.replay.sensor_checks import require_same_times
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.systems import WAVELENGTH_M

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

Bools = NDArray[np.bool_]

WRONG_M = 0.5  # horizontal error of a fixed position that is called wrong
QUANTILES = (0.5, 0.9, 0.95)
MOVING_MPS = 0.5
CHANGE_S = 1.0  # over which errors of fixed positions are compared
ROUNDS, LEAST_LENGTH_M = 30, 1e-3  # of re-weighting


def figures(
    time_s: Array, outcome: Ints, error_en_m: Array, satellites: Array, speed_mps: Array, heading_rad: Array
) -> dict[str, Any]:
    """What describes solutions of B vehicles at T epochs, all (T, B) but the time, and the errors, (T, B, 2).

    Shares are of all epochs, ``satellites.share`` is the median number over the greatest one. Errors are horizontal;
    those of fixed positions also without what a recording adds: their median vector, which comes from the coordinates
    of its base; and with it an offset that turns with the vehicle, of its lever arm (:func:`without_offsets`).
    """
    fixed, floated = outcome == RtkOutcome.FIXED, outcome == RtkOutcome.FLOAT
    outages = find_outages(fixed, time_s).length_s
    most = float(satellites.max())
    error_m = np.hypot(error_en_m[..., 0], error_en_m[..., 1])
    centre = np.median(error_en_m[fixed], 0) if fixed.any() else np.zeros(2)
    low, middle, high = np.quantile(satellites, (0.1, 0.5, 0.9))
    wrong, count = int((error_m[fixed] > WRONG_M).sum()), int(fixed.sum())
    return {
        "epochs": int(outcome.size),
        "vehicles": int(outcome.shape[1]),
        "moving": float((speed_mps > MOVING_MPS).mean()),
        "satellites": {"low": float(low), "median": float(middle), "high": float(high), "most": most,
                       "share": float(middle / most) if most else 0.0},
        "fixed": float(fixed.mean()),
        "float": float(floated.mean()),
        "wrong": wrong / count if count else None,
        "fixed_error_m": _quantiles(error_m[fixed]),
        "fixed_spread_m": _quantiles(np.hypot(*(error_en_m[fixed] - centre).T)),
        "fixed_mounted_m": _quantiles(without_offsets(error_en_m[fixed], heading_rad[fixed])),
        "fixed_change_m": _quantiles(changes(time_s, fixed, error_en_m)),
        "float_error_m": _quantiles(error_m[floated]),
        "outage_s": {
            "count": int(outages.size),
            "median": float(np.median(outages)) if outages.size else None,
            "high": float(np.quantile(outages, 0.9)) if outages.size else None,
            "longest": float(outages.max()) if outages.size else None,
        },
    }  # fmt: skip


def without_offsets(error_en_m: Array, heading_rad: Array) -> Array:
    """Length (n,) of errors (n, 2) less one offset fixed to the ground and one fixed to the vehicle [m].

    The four numbers make the sum of the lengths least (re-weighted least squares). Empty without headings.
    """
    if not len(error_en_m) or not np.isfinite(heading_rad).all():
        return np.zeros(0)
    sine, cosine, one, none = np.sin(heading_rad), np.cos(heading_rad), *np.eye(2)[:, :1].repeat(len(heading_rad), 1)
    east, north = np.stack([one, none, sine, cosine], -1), np.stack([none, one, cosine, -sine], -1)
    left = np.hypot(*error_en_m.T)
    for _ in range(ROUNDS):
        root = 1.0 / np.sqrt(np.maximum(left, LEAST_LENGTH_M))[:, None]
        design, y = np.concatenate([east * root, north * root]), np.concatenate((error_en_m * root).T)
        offsets = np.linalg.lstsq(design, y, rcond=None)[0]
        left = np.hypot(error_en_m[:, 0] - east @ offsets, error_en_m[:, 1] - north @ offsets)
    return np.asarray(left)


def changes(time_s: Array, fixed: Bools, error_en_m: Array) -> Array:
    """Length (n,) of the change of the error over CHANGE_S, between epochs fixed throughout [m].

    Offsets of base and lever arm are not in it, but for turns; noise is, and what multipath changes in a second.
    """
    step = max(round(CHANGE_S / float(np.median(np.diff(time_s)))), 1) if len(time_s) > 1 else 1
    if len(time_s) <= step:
        return np.zeros(0)
    whole = np.abs(time_s[step:] - time_s[:-step] - CHANGE_S) < 0.5 * CHANGE_S / step
    count = np.cumsum(np.concatenate([np.zeros((1, fixed.shape[1])), fixed]), 0)
    throughout = (count[step + 1 :] - count[: -step - 1] == step + 1) & whole[:, None]
    change = error_en_m[step:] - error_en_m[:-step]
    return np.asarray(np.hypot(change[..., 0], change[..., 1])[throughout])


def _quantiles(values: Array) -> list[float] | None:
    return [float(q) for q in np.quantile(values, QUANTILES)] if values.size else None


def _quantile(found: Mapping[str, Any], key: str, index: int) -> float | None:
    return found[key] and float(found[key][index])


ERRORS = {
    "fixed_error_m": "error of fixed positions",
    "fixed_spread_m": "the same less their median vector",
    "fixed_mounted_m": "the same less offsets of ground and vehicle",
    "fixed_change_m": "its change over 1 s of fixes",
    "float_error_m": "error of float positions",
}
ROWS: dict[str, tuple[str, str, Callable[[Mapping[str, Any]], float | None]]] = {
    "fixed": ("fixed, share of epochs", "%", lambda f: f["fixed"]),
    "float": ("float, share of epochs", "%", lambda f: f["float"]),
    "wrong": (f"fixed more than {WRONG_M:g} m off, share of fixed", "%", lambda f: f["wrong"]),
    **{
        f"{key} {q:g}": (f"{text}, {100 * q:g} %", "m", partial(_quantile, key=key, index=i))
        for key, text in ERRORS.items()
        for i, q in enumerate(QUANTILES)
    },
    "outage median": ("time without a fix, median", "s", lambda f: f["outage_s"]["median"]),
    "outage 90": ("time without a fix, 90 %", "s", lambda f: f["outage_s"]["high"]),
    "outage longest": ("time without a fix, longest", "s", lambda f: f["outage_s"]["longest"]),
}  # fmt: skip
"""Quantities that are compared: text, unit, and how they follow from figures."""


def rtk_rows(result: Mapping[str, Any]) -> Table:
    """Each quantity of the recorded drive and of the sky that comes nearest, with the factor between them."""
    recorded, simulated, rows = result["recorded"], result["skies"][result["nearest"]], []
    for text, unit, get in ROWS.values():
        pair = get(recorded), get(simulated)
        factor = pair[1] / pair[0] if pair[0] and pair[1] is not None else None
        within = "" if factor is None else "yes" if 0.5 <= factor <= 2.0 else "no"
        cells = ["-" if v is None else f"{100.0 * v:.1f} %" if unit == "%" else f"{v:.3g} {unit}" for v in pair]
        rows.append((text, *cells, "-" if factor is None else f"{factor:.2g}", within))
    return ("quantity", "recorded", result["nearest"], "factor", "within 2"), rows


def sky_rows(result: Mapping[str, Any]) -> Table:
    """Usable satellites, share of them, and failures of the recorded drive and of every sky."""
    rows: list[tuple[str, ...]] = []
    for name, f in ({"recorded": result["recorded"]} | result["skies"]).items():
        s = f["satellites"]
        wrong = "-" if f["wrong"] is None else f"{100.0 * f['wrong']:.1f} %"
        rows.append((
            name, f"{f['epochs']:,}", f"{100.0 * f['moving']:.0f} %",
            f"{s['median']:.0f} ({s['low']:.0f} to {s['high']:.0f}) of {s['most']:.0f}", f"{s['share']:.2f}",
            f"{100.0 * f['fixed']:.1f} %", wrong,
        ))  # fmt: skip
    return ("sky", "epochs", "moving", "satellites (10 to 90 %)", "share", "fixed", "wrong of fixed"), rows


SOLUTION, REFERENCE = "rover_rtk.pos", "reference.csv"  # files of the folder, as in nagoya_drive_rtk
EVERY_S = 0.2  # between epochs of the conventional solution, as recorded


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
    found = work_streets(config, "realism of RTK", config.streets, work_street, out, jobs, on_progress)
    skies = {sky: simulated_figures(streets) for sky, streets in found.items()}
    shares = {sky: one["satellites"]["share"] for sky, one in skies.items()}
    nearest = min(shares, key=lambda sky: abs(shares[sky] - recorded["satellites"]["share"]))
    return stored({"config": config.to_dict(), "recorded": recorded, "skies": skies, "nearest": nearest}, out)


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
    axes = enu_axes(truth.position_ecef_m[0])
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


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All skies, the nearest next to the recording, and the navigator on the same signals."""
    yield "Satellites that conventional RTK can use, by sky", sky_rows(result)
    title = f"The sky nearest in usable satellites ({result['nearest']}) next to the recording"
    yield title, rtk_rows(result)
    yield "The navigator on the same signals: epochs beyond a level, 95 % by street", navigator_rows(result)
