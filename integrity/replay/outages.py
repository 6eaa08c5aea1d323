"""Dead reckoning in artificial outages of a recorded drive: drift and protection level against the reference.

An outage starts at the reference solution: its position, and its track rotated by ``heading_error_deg`` with both
signs. During the outage the position is propagated with speed and gyro (:func:`.reckoning.reckon`), and the level grows
from the level of a fix (:mod:`lanebound.integrity.monitoring.dead_reckoning_pl`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.accuracy import bounding_by_axis, doubt
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, risk_text, save, tidy
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import enu_axes, track_from_enu_matrix
from lanebound.integrity.monitoring.dead_reckoning_pl import missed_detection_factors
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.recorded.comma import Comma, read_comma
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.reckoning import Bridge, BridgeConfig, integral, reckon, turned
from lanebound.integrity.replay.sensor_checks import aligned_comma

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

AXES_OF_GYRO = 2  # z, down: positive to the right
SLOWEST_MPS = 0.5  # the direction of a smaller velocity is not defined


class OutageConfig(Config):
    """Parameters of the outages and assumed errors of the sensors."""

    rate_hz: float = Field(10.0, gt=0.0, le=100.0, description="epochs in a second [Hz]")
    longest_s: float = Field(20.0, gt=0.0, description="length of an outage [s]; S1 section 5, IMU and odometer")
    every_s: float = Field(0.5, gt=0.0, description="time between the starts of outages [s]")
    calibration_s: float = Field(
        15.0, gt=0.0, description="first part, used only to calibrate wheel scale and gyro bias [s]"
    )
    heading_error_deg: float = Field(0.0, ge=0.0, description="heading error at the start, with both signs [deg]")
    axle_m: float = Field(
        0.0, ge=0.0, le=20.0, description="reference point ahead of the rear axle [m]; unknown for comma2k19"
    )
    fix_sigma_m: float = Field(0.02, gt=0.0, description="position of the fix, 1 sigma on each axis [m]")
    risk: RiskConfig = RiskConfig(integrity_risk=1e-3)
    bridge: BridgeConfig = BridgeConfig(
        speed_scale=0.005, heading_sigma_deg=0.5, heading_bias_deg=0.2, heading_drift_degps=0.05
    )


@dataclass(frozen=True)
class Motion:
    """Epochs (T,): time from the start [s], reference position (T, 2) E, N [m], track of the rear axle [rad], true
    speed [m/s]; measured speed [m/s] and yaw rate, positive to the right [rad/s], calibrated; epochs at a gap of
    reference or sensors, None without."""

    time_s: Array
    position_m: Array
    track_rad: Array
    true_speed_mps: Array
    speed_mps: Array
    yaw_rate_radps: Array
    bridged: Bools | None = None


@dataclass(frozen=True)
class OutageErrors:
    """N outages with M ages (M,) [s]: signed error (N, M, 2) along and across the track [m], level (N, M, 2) [m], speed
    at the start (N,) [m/s] and start time (N,) [s]; ``left_out`` is the number of those at a gap of a sensor."""

    age_s: Array
    error_m: Array
    pl_m: Array
    speed_mps: Array
    start_s: Array
    left_out: int = 0

    def figures(self, risk: float, ages_s: tuple[float, ...]) -> dict[str, Any]:
        """Statistics as JSON data, of all ages and of some."""
        return {
            "risk": risk, "doubt": doubt(risk, self.error_m, self.pl_m, "outages"),
            "outages": len(self.start_s), "left_out_at_gaps": self.left_out,
            "speed_mps": [float(v) for v in np.quantile(self.speed_mps, [0.0, 0.5, 1.0])],
            "by_age": by_age(self, ages_s), "all_ages": bounding_by_axis(self.error_m, self.pl_m),
        }  # fmt: skip


def motion_of(segment: Comma, config: OutageConfig) -> tuple[Motion, dict[str, float]]:
    """Resample reference and sensors to common times, and calibrate with the first ``calibration_s`` only.

    Raises
    ------
    InputError
        The segment is too short, or the vehicle is at rest during the calibration, which must be without gaps.
    """
    r = segment.reference
    start = max(float(s[0]) for s in (r.time_s, segment.speed.time_s, segment.rotation_rate.time_s))
    end = min(float(s[-1]) for s in (r.time_s, segment.speed.time_s, segment.rotation_rate.time_s))
    if end - start < config.calibration_s + config.longest_s:
        raise InputError(
            f"segment must last {config.calibration_s + config.longest_s:g} s, lasts {end - start:.1f} s: lower "
            "calibration_s or longest_s"
        )
    time = np.arange(0.0, end - start, 1.0 / config.rate_hz)
    axes = enu_axes(r.position_ecef_m[0])
    enu, velocity = (r.position_ecef_m - r.position_ecef_m[0]) @ axes, r.velocity_ecef_mps @ axes
    at = start + time
    place = interpolated(at, r.time_s, enu[:, :2])
    moving = interpolated(at, r.time_s, velocity[:, :2])
    rate = averaged(segment.rotation_rate.time_s, segment.rotation_rate.value[:, AXES_OF_GYRO], at, config.rate_hz)
    speed = np.hypot(*moving.T)
    # the rear axle moves in the direction of the heading, the reference point at an angle to it
    slip = np.arcsin(np.clip(config.axle_m * rate / np.maximum(speed, SLOWEST_MPS), -1.0, 1.0))
    track = np.unwrap(np.arctan2(moving[:, 0], moving[:, 1])) - slip
    step = 1.0 / config.rate_hz
    bridged = segment.bridged(at, step, step)
    if bridged[time < config.calibration_s].any():
        raise InputError(
            f"the first {config.calibration_s:g} s must be without gaps, {'; '.join(segment.notes.values())}: lower "
            "calibration_s, or cut the segment after the gap"
        )
    motion = Motion(time, place, track, speed, segment.speed.at(at), rate, bridged)
    return calibrate(motion, config.calibration_s)


def averaged(time_s: Array, value: Array, at_s: Array, rate_hz: float) -> Array:
    """Mean of a signal over an interval around each time, computed as slope of the integral."""
    total, half = integral(time_s, value), 0.5 / rate_hz
    low, high = np.maximum(at_s - half, time_s[0]), np.minimum(at_s + half, time_s[-1])
    return np.asarray((np.interp(high, time_s, total) - np.interp(low, time_s, total)) / np.maximum(high - low, 1e-6))


def calibrate(motion: Motion, seconds: float) -> tuple[Motion, dict[str, float]]:
    """Calibrate wheel scale and gyro bias with the first seconds, as RTK would, and apply them to the whole drive.

    Raises
    ------
    InputError
        The vehicle does not move in these seconds.
    """
    first = motion.time_s < seconds
    travelled = float((motion.speed_mps[first] ** 2).sum())
    if travelled < 1.0:
        raise InputError(f"the segment must move in its first {seconds:g} s, is at rest: choose another segment")
    scale = float((motion.speed_mps[first] * motion.true_speed_mps[first]).sum()) / travelled
    turned = float(motion.track_rad[first][-1] - motion.track_rad[first][0])
    span = float(motion.time_s[first][-1] - motion.time_s[first][0])
    bias = float(np.trapezoid(motion.yaw_rate_radps[first], motion.time_s[first]) - turned) / span
    calibrated = Motion(
        motion.time_s, motion.position_m, motion.track_rad, motion.true_speed_mps, scale * motion.speed_mps,
        motion.yaw_rate_radps - bias, motion.bridged,
    )  # fmt: skip
    return calibrated, {"speed_scale": scale, "gyro_bias_degps": math.degrees(bias)}


def run_outages(motion: Motion, config: OutageConfig) -> OutageErrors:
    """Simulate all outages that start after the calibration, end before the end of the drive and touch no gap.

    Raises
    ------
    InputError
        There is none.
    """
    n = round(config.longest_s * config.rate_hz)
    first = math.ceil(config.calibration_s * config.rate_hz)
    step = max(round(config.every_s * config.rate_hz), 1)
    starts = np.arange(first, motion.time_s.size - n, step)
    clear = np.array([_is_clear(motion, s, n) for s in starts.tolist()], dtype=np.bool_)
    if starts.size and not clear.any():
        raise InputError(
            f"the drive must have {config.longest_s:g} s without gaps after its calibration, has none: lower longest_s"
        )
    left_out, starts = int((~clear).sum()), starts[clear]
    given = math.radians(config.heading_error_deg)
    signs = (1.0, -1.0) if given > 0.0 else (0.0,)
    cases = [(int(s), sign * given) for s in starts for sign in signs]
    starts, errors = np.array([s for s, _ in cases]), np.array([e for _, e in cases], dtype=np.float64)
    off, levels = _dead_reckoned(motion, starts, errors, n, config)
    age = np.asarray((np.arange(n) + 1.0) / config.rate_hz, dtype=np.float64)
    return OutageErrors(age, off, levels, motion.true_speed_mps[starts], motion.time_s[starts], left_out)


def _is_clear(motion: Motion, start: int, epochs: int) -> bool:
    """Whether no gap lies in the epochs after a start."""
    return motion.bridged is None or not motion.bridged[start : start + epochs + 1].any()


def _dead_reckoned(
    motion: Motion, starts: Ints, heading_error: Array, n: int, config: OutageConfig
) -> tuple[Array, Array]:
    """Errors and levels (N, n, 2) of outages that start at epochs ``starts`` (N,)."""
    estimated, heading = np.zeros((starts.size, n, 2)), np.zeros((starts.size, n))
    for i, s in enumerate(starts):
        part = slice(s, s + n + 1)
        path = reckon(motion.time_s[part], motion.speed_mps[part], motion.yaw_rate_radps[part], config.axle_m)
        initial = float(motion.track_rad[s] + heading_error[i])
        estimated[i] = motion.position_m[s] + turned(path.position_m[1:], initial)
        heading[i] = initial + path.heading_rad[1:]
    speed = motion.speed_mps[starts[:, None] + np.arange(1, n + 1)]
    levels = levels_from_fix(config.bridge, config.risk, config.fix_sigma_m, 1.0 / config.rate_hz, speed, heading)
    return errors_on_track(motion.position_m, starts, estimated, heading), levels


def errors_on_track(position_m: Array, starts: Ints, estimated_m: Array, heading_rad: Array) -> Array:
    """Errors (N, n, 2) along and across the track of what is estimated after epochs ``starts`` (N,) of positions."""
    off = estimated_m - position_m[starts[:, None] + np.arange(1, estimated_m.shape[1] + 1)]
    return np.asarray((track_from_enu_matrix(heading_rad) @ off[..., None])[..., 0])


def levels_from_fix(
    bridge: BridgeConfig, risk: RiskConfig, fix_sigma_m: float, dt_s: float, speed_mps: Array, heading_rad: Array
) -> Array:
    """Levels (N, n, 2) [m] of outages with speeds and headings (N, n)."""
    fix = np.broadcast_to(np.eye(2) * fix_sigma_m**2, (len(speed_mps), 2, 2))
    sigma = np.full((len(speed_mps), 2), fix_sigma_m)
    grown = Bridge(bridge, risk, fix, np.zeros_like(sigma), sigma, heading_rad[:, 0])
    steps = zip(speed_mps.T, heading_rad.T, strict=True)
    return np.stack([grown.step(dt_s, speed, heading)[0] for speed, heading in steps], 1)


def sawtooth(motion: Motion, config: OutageConfig, fixed_s: float = 5.0) -> dict[str, Array]:
    """One drive with alternating fixes and outages: time (K,), error and level (K, 2), and whether there is a fix (K,).

    The error of a fix is 0, because the reference is used as fix.
    """
    n = round(config.longest_s * config.rate_hz)
    gap = max(round(fixed_s * config.rate_hz), 1)
    at, parts = math.ceil(config.calibration_s * config.rate_hz), []
    fix = np.tile(missed_detection_factors(config.risk)[0] * config.fix_sigma_m, (gap, 1))
    while at + n < motion.time_s.size:
        if not _is_clear(motion, at - gap + 1, n + gap):
            at += 1
            continue
        fixed = np.arange(at - gap + 1, at + 1)
        parts.append((motion.time_s[fixed], np.zeros((gap, 2)), fix, np.ones(gap, np.bool_)))
        error, level = _dead_reckoned(motion, np.array([at]), np.radians([config.heading_error_deg]), n, config)
        parts.append((motion.time_s[at + 1 : at + n + 1], error[0], level[0], np.zeros(n, np.bool_)))
        at += n + gap
    return {
        name: np.concatenate([p[i] for p in parts]) for i, name in enumerate(("time_s", "error_m", "pl_m", "fixed"))
    }


AGES_S = (1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 20.0)
TOOTH_S, FIXED_S = 8.0, 3.0  # duration of outages and fixes in the sawtooth figure
S1_DRIFT_M, S1_AGE_S = 0.53, 4.0  # S1 section 5, largest error of IMU and odometer after 4 s
S1_SPEED_MPS = 10.0  # assumed for an urban drive; S1 does not give the speed
S1_HEADING_DEG = math.degrees(math.asin(S1_DRIFT_M / (S1_SPEED_MPS * S1_AGE_S)))  # explains the drift; 0.76 deg
CAUTION = "outages overlap and are from one minute of one drive: the exact intervals are too narrow"


def by_age(outages: OutageErrors, ages_s: tuple[float, ...]) -> list[dict[str, Any]]:
    """Errors, levels and exceedances at some ages as JSON data."""
    rows = []
    for age in ages_s:
        k = int(np.argmin(np.abs(outages.age_s - age)))
        error, pl = np.abs(outages.error_m[:, k]), outages.pl_m[:, k]
        row: dict[str, Any] = {"age_s": float(outages.age_s[k]), "outages": len(error)}
        for q, axis in enumerate(("at", "ct")):
            row[axis] = {
                "median_m": float(np.median(error[:, q])), "p95_m": float(np.quantile(error[:, q], 0.95)),
                "max_m": float(error[:, q].max()), "pl_median_m": float(np.median(pl[:, q])),
                "exceeded": int((error[:, q] > pl[:, q]).sum()),
            }  # fmt: skip
        rows.append(row)
    return rows


def _against_s1(motion: Motion, config: OutageConfig) -> dict[str, Any]:
    """Cross-track error after 4 s with the heading error of S1, compared with S1's error scaled by the distance."""
    given = config.replace(heading_error_deg=S1_HEADING_DEG)
    outages = run_outages(motion, given)
    k = int(np.argmin(np.abs(outages.age_s - S1_AGE_S)))
    reached = np.abs(outages.error_m[:, k, 1])
    expected = S1_DRIFT_M * outages.speed_mps / S1_SPEED_MPS
    last = np.abs(outages.error_m[:, -1, 1])
    return {
        "heading_error_deg": S1_HEADING_DEG, "age_s": S1_AGE_S, "outages": len(reached),
        "ct_median_m": float(np.median(reached)), "s1_scaled_median_m": float(np.median(expected)),
        "ratio_median": float(np.median(reached / expected)),
        "ratio_5_95": [float(v) for v in np.quantile(reached / expected, [0.05, 0.95])],
        "ct_median_at_the_end_m": float(np.median(last)),
        "exceeded": bounding_by_axis(outages.error_m, outages.pl_m),
    }  # fmt: skip


def write_outages(folder: Path, out: Path, config: OutageConfig | None = None) -> tuple[dict[str, Any], list[Path]]:
    """Replay a comma2k19 segment with outages; writes ``replay.json``, ``drift.png`` and ``sawtooth.png`` into ``out``.

    Raises
    ------
    InputError
        The folder is not a comma2k19 segment, or the segment is too short.
    """
    config = config or OutageConfig()
    segment, agreement = aligned_comma(read_comma(folder))
    motion, calibration = motion_of(segment, config)
    outages = run_outages(motion, config)
    figures = {
        "dataset": "comma2k19", "caution": CAUTION, "calibration": calibration,
        **outages.figures(config.risk.integrity_risk, AGES_S),
        "agreement": {name: found.figures() for name, found in agreement.items()}, "stopped": segment.notes,
        "with_heading_error_of_s1": _against_s1(motion, config),
    }  # fmt: skip
    summary = write_summary(out / "replay.json", figures)
    drift = save(drift_figure(outages, config.risk.integrity_risk), out / "drift.png")
    return figures, [summary, drift, save(_sawtooth_figure(motion, config), out / "sawtooth.png")]


def drift_figure(outages: OutageErrors, risk: float) -> Figure:
    """Error of every outage and median level against the age of the outage."""
    figure = new_figure(11.0, 4.4)
    figure.suptitle("Dead reckoning in artificial outages" + risk_text(risk), fontsize=12, color=INK)
    for q, name in enumerate(("along track", "cross track")):
        axes = figure.add_subplot(1, 2, q + 1)
        lines = axes.plot(outages.age_s, np.abs(outages.error_m[..., q]).T, color=INK, alpha=0.25, linewidth=0.6)
        lines[0].set_label("error of each outage")
        axes.plot(outages.age_s, np.median(outages.pl_m[..., q], 0), color=PL_COLOUR, label="median PL")
        tidy(axes, xlabel="age of the outage (s)", ylabel=f"{name} error and PL (m)")
        legend(axes, loc="upper left")
    return figure


def _sawtooth_figure(motion: Motion, config: OutageConfig) -> Figure:
    """Errors and levels of a drive with alternating fixes and outages."""
    found = sawtooth(motion, config.replace(longest_s=min(TOOTH_S, config.longest_s)), FIXED_S)
    figure = new_figure(11.0, 4.4)
    figure.suptitle("Alternating fixes and outages" + risk_text(config.risk.integrity_risk), fontsize=12, color=INK)
    for q, name in enumerate(("along track", "cross track")):
        axes = figure.add_subplot(1, 2, q + 1)
        axes.plot(found["time_s"], found["pl_m"][:, q], color=PL_COLOUR, label="PL")
        axes.fill_between(found["time_s"], np.abs(found["error_m"][:, q]), color=INK, alpha=0.35, label="error")
        tidy(axes, xlabel="time (s)", ylabel=f"{name} (m)")
        legend(axes, loc="upper left")
    return figure
