"""Conventional RTK on simulated signals beside a recorded drive: how often it fixes, and how often wrongly.

The recorded drive is a solution of RTKLIB with its reference trajectory; its observations are not needed. The simulated
receivers drive through streets of several skies, without faults and with a steady link. One observation of each epoch
feeds both the conventional solution, single-epoch RTK with a ratio test and no bound of its risk, and the navigator.
The sky whose share of usable satellites comes nearest to the recorded one is compared with the drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.in_the_loop import rate_by_street
from lanebound.agents.assess.street_drives import PACKAGES, StreetDrivesConfig, street_of, work_streets
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.integrity.assessment.availability import find_outages
from lanebound.integrity.assessment.conventional_rtk import (
    ConventionalRtkConfig,
    RtkOutcome,
    RtkSignals,
    solve_epoch,
)
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef, track_from_enu_matrix
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.rtklib import FIXED, FLOAT, read_reference, read_rtk_solution
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.systems import WAVELENGTH_M

__all__ = ["RtkRealismConfig", "assess_rtk", "navigator_rows", "rtk_rows", "sky_rows", "work_street"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

SOLUTION, REFERENCE = "rover_rtk.pos", "reference.csv"  # files of the folder, as in nagoya_drive_rtk
EVERY_S = 0.2  # between epochs of the conventional solution, as recorded
MATCHED_S = 0.02  # largest time between a solution and its reference
WRONG_M = 0.5  # horizontal error of a fixed position that is called wrong
QUANTILES = (0.5, 0.9, 0.95)
MOVING_MPS = 0.5


class RtkRealismConfig(StreetDrivesConfig):
    """Streets, receivers that drive through them, and the settings of the conventional solution."""

    skies: tuple[str, ...] = Field(
        ("suburban", "urban", "dense", "skies/plaza"), min_length=1, description="levels of sky that are compared"
    )
    streets: int = Field(6, ge=1, description="streets of each sky")
    vehicles: int = Field(8, ge=1, le=4096, description="vehicles in a street; they share its city and its satellites")
    faults: str | None = Field(None, description="preset of fault rates")
    baseline_km: float = Field(9.4, ge=0, description="distance to the reference station [km]; nagoya_drive_rtk")
    solution: ConventionalRtkConfig = ConventionalRtkConfig()

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
    at = np.clip(np.searchsorted(solution.tow_s, truth.tow_s - MATCHED_S), 0, solution.tow_s.size - 1)
    known = np.abs(solution.tow_s[at] - truth.tow_s) <= MATCHED_S
    if not known.any():
        raise InputError(f"{SOLUTION} and {REFERENCE} of {folder} must overlap in time, do not: use files of one drive")
    latitude, longitude, _ = geodetic_from_ecef(truth.position_ecef_m[0])
    axes = ecef_from_enu_matrix(latitude, longitude)
    off = (solution.position_ecef_m[at] - truth.position_ecef_m) @ axes
    quality = np.where(known, solution.quality[at], 0)
    outcome = np.select([quality == FIXED, quality == FLOAT], [int(RtkOutcome.FIXED), int(RtkOutcome.FLOAT)], 0)
    speed = np.linalg.norm(np.gradient(truth.position_ecef_m, truth.tow_s, axis=0), axis=-1)
    satellites = np.where(known, solution.satellites[at], 0)
    return figures(truth.tow_s, outcome[:, None], off[:, None, :2], satellites[:, None], speed[:, None])


def work_street(config: RtkRealismConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Drive one street: conventional solutions (T, B), and counts of the navigator's levels; it depends on no other."""
    navigator, drive = street_of(config, sky, number)
    dt = navigator.config.dt_s
    first, epochs = (round(time_s / dt) for time_s in (config.warm_up_s, config.span_s))
    every, solved = max(round(EVERY_S / dt), 1), []
    counted = {"epochs": 0, "rtk": 0, "beyond": 0, "beyond_rtk": 0, "wrong_rtk": 0}
    for k, truth in zip(range(epochs), drive, strict=False):
        m = navigator.measure(truth)
        s = navigator.locate(m)
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
        if k % every == 0:
            speed = np.linalg.norm(truth.velocity_enu_mps, axis=-1)
            solved.append(
                np.column_stack(
                    [_conventional(config.solution, navigator.config.gnss.bands, m, truth.position_enu_m), speed]
                )
            )
    table = np.round(np.stack(solved), 4)
    names = "outcome", "error_east_m", "error_north_m", "satellites", "speed_mps"
    return {"navigator": counted} | {key: table[..., i].tolist() for i, key in enumerate(names)}


def _conventional(config: ConventionalRtkConfig, bands: tuple[int, ...], m: Measurements, position_m: Array) -> Array:
    """Outcome, error East and North [m] and number of satellites of each vehicle, (B, 4)."""
    sky, g, width = m.sky, m.gnss, len(bands)
    rows = []
    for v, at in enumerate(sky.index):
        found = solve_epoch(
            config,
            RtkSignals(
                sky.los_enu[at], sky.elevation_rad[at], sky.system, g.cn0_dbhz[v], g.tracked[v],
                g.code_m[v, :, : width], g.phase_m[v, :, : width], WAVELENGTH_M[sky.system][:, list(bands)],
            ),
        )  # fmt: skip
        off = found.position_m[:2] - position_m[v, :2]
        rows.append((int(found.outcome), *off, found.satellites))
    return np.array(rows, dtype=np.float64)


def simulated_figures(streets: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The figures of all vehicles of a sky together, and those of the navigator."""
    outcome, east, north, satellites, speed = (
        np.concatenate([np.asarray(street[key], dtype=np.float64) for street in streets], 1)
        for key in ("outcome", "error_east_m", "error_north_m", "satellites", "speed_mps")
    )
    found = figures(
        EVERY_S * np.arange(len(outcome), dtype=np.float64),
        outcome.astype(np.int64),
        np.stack([east, north], -1),
        satellites,
        speed,
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


def figures(time_s: Array, outcome: Ints, error_en_m: Array, satellites: Array, speed_mps: Array) -> dict[str, Any]:
    """What describes solutions of B vehicles at T epochs, all (T, B) but the time, and the errors, (T, B, 2).

    Shares are of all epochs, ``satellites.share`` is the median number over the greatest one. Errors are horizontal;
    those of fixed positions also without their median vector, which a recording has from the coordinates of its base.
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
        "float_error_m": _quantiles(error_m[floated]),
        "outage_s": {
            "count": int(outages.size),
            "median": float(np.median(outages)) if outages.size else None,
            "high": float(np.quantile(outages, 0.9)) if outages.size else None,
            "longest": float(outages.max()) if outages.size else None,
        },
    }  # fmt: skip


def _quantiles(values: Array) -> list[float] | None:
    return [float(q) for q in np.quantile(values, QUANTILES)] if values.size else None


def _quantile(found: Mapping[str, Any], key: str, index: int) -> float | None:
    return found[key] and float(found[key][index])


ERRORS = {
    "fixed_error_m": "error of fixed positions",
    "fixed_spread_m": "the same less their median vector",
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


def navigator_rows(result: Mapping[str, Any]) -> Table:
    """Errors of the navigator beyond its levels on the same signals, over its risk."""
    risk, rows = result["config"]["navigator"]["risk"]["integrity_risk"], []
    for sky, f in result["skies"].items():
        n = f["navigator"]
        cells = []
        for rate in (n["beyond"], n["beyond_rtk"]):
            band = "" if rate["low"] is None else f" [{rate['low'] / risk:.3g}, {rate['high'] / risk:.3g}]"
            cells.append(f"{rate['rate'] / risk:.3g}{band} in {rate['streets']} streets")
        rows.append((sky, f"{n['epochs']:,}", f"{100.0 * n['rtk_share']:.1f} %", str(n["wrong_rtk"]), *cells))
    return ("sky", "epochs", "RTK", f"RTK {WRONG_M:g} m off", "beyond over risk", "the same of RTK"), rows
