"""Response of a navigator to a fault: vehicles with the fault against the same vehicles without it, by epoch.

Both runs draw the same noise: all differences are effects of the fault. Detectable biases of one satellite are compared
with theory. Geometries, noise and faulty satellites are drawn at
random. A bias is so many times the minimal detectable one of its satellite, ``sqrt(lambda_0 / c'MC)`` (Baarda 1968): at
1 the test of the faulty satellite alone has the power that lambda_0 was computed for, else that of a non-central
chi-square. Detection sees more (the other tests and the global one), exclusion less (it must name the right satellite).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, chndtr

from lanebound.agents.studies.bounding import rate_of
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.monitoring.detection import adjust, diagonal_covariance, minimal_detectable_bias, w_test
from lanebound.integrity.monitoring.exclusion import FdeConfig, FdeOutcome, detect_and_exclude
from lanebound.integrity.monitoring.significance import noncentrality
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.least_squares import design_matrix
from lanebound.integrity.sensors.faults import ROUNDING_S, Fault, FaultSchedule
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

FACTORS = (0.0, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
GEOMETRIES = 40
LOWEST_RAD = np.deg2rad(10.0)
SYSTEMS = 2
FREE_DRAWS = 4  # so many times more without a fault: false alarms are rare
UNSOLVED = 1e-6  # of the largest redundancy; a satellite below has no redundancy


def detectability(fde: FdeConfig, satellites: int, draws: int, seed: int = 1) -> dict[str, Any]:
    """Rates by the size of the bias for geometries of so many satellites.

    Returns
    -------
    ``satellites`` and ``by_factor``, a row for each size: ``factor`` of the minimal detectable bias; ``theory``, the
    power of the faulty satellite's own test; ``own`` that power measured; ``noticed``, anything detected; ``right``,
    that satellite excluded and no other. At factor 0 ``noticed`` is the false alarm.
    """
    rng = named_generator([seed, satellites], "detectability")
    design, variance = _geometries(rng, satellites)
    silent = adjust(design, diagonal_covariance(variance), np.zeros((GEOMETRIES, satellites)))
    size = float(fde.tables(satellites).local_significance[int(silent.df[0]), satellites])
    lambda0 = noncentrality(size, fde.power)
    least = minimal_detectable_bias(silent, np.full(GEOMETRIES, lambda0))
    each = max(1, draws // GEOMETRIES)
    rows = []
    for factor in FACTORS:
        count = each * (1 if factor else FREE_DRAWS)
        faulty, observed = _observed(rng, variance, factor * least, count)
        rows.append(_row(fde, (design, variance), faulty, observed, size, factor))
        rows[-1]["theory"] = float(1.0 - chndtr(float(chdtri(1, size)), 1, factor * factor * lambda0))
    return {"satellites": satellites, "redundancy": int(silent.df[0]), "alpha": fde.alpha, "by_factor": rows}


def _geometries(rng: np.random.Generator, satellites: int) -> tuple[Array, Array]:
    """Designs (K, n, 5) and variances (K, n) [of the zenith's], with redundancy of every satellite."""
    designs: list[Array] = []
    variances: list[Array] = []
    while len(designs) < GEOMETRIES:
        sine = rng.uniform(np.sin(LOWEST_RAD), 1.0, satellites)
        azimuth, flat = rng.uniform(0.0, 2.0 * np.pi, satellites), np.sqrt(1.0 - sine * sine)
        los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1)
        design = design_matrix(los, np.arange(satellites) % SYSTEMS, SYSTEMS)
        variance = 0.5 * (1.0 + 1.0 / sine**2)
        state = adjust(design, diagonal_covariance(variance), np.zeros(satellites))
        share = np.diagonal(state.reliability) * variance
        if state.solvable and share.min() > UNSOLVED:
            designs.append(design)
            variances.append(variance)
    return np.array(designs), np.array(variances)


def _observed(rng: np.random.Generator, variance: Array, bias: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    """The faulty satellite (K, D) and observations (K, D, n) with its bias, of either sign."""
    shape = (GEOMETRIES, count, variance.shape[-1])
    faulty = rng.integers(shape[-1], size=shape[:2])
    noise = rng.standard_normal(shape) * np.sqrt(variance)[:, None]
    size = np.take_along_axis(bias[:, None].repeat(count, 1), faulty[..., None], -1)
    sign = rng.choice([-1.0, 1.0], shape[:2])[..., None]
    return faulty, noise + sign * size * (np.arange(shape[-1]) == faulty[..., None])


def _row(
    fde: FdeConfig, model: tuple[Array, Array], faulty: NDArray[np.int64], observed: Array, size: float, factor: float
) -> dict[str, Any]:
    """Counts of one size of bias."""
    design, covariance = model[0][:, None], diagonal_covariance(model[1])[:, None]
    found = detect_and_exclude(fde, design, covariance, observed)
    own = w_test(adjust(design, covariance, observed), size).failed
    own = np.take_along_axis(own, faulty[..., None], -1)[..., 0]
    noticed = (found.outcome == FdeOutcome.EXCLUDED.code) | (found.outcome == FdeOutcome.UNRESOLVED.code)
    right = (found.excluded == (np.arange(observed.shape[-1]) == faulty[..., None])).all(-1)
    n = noticed.size
    return {
        "factor": factor,
        "own": rate_of(int(own.sum()), n),
        "noticed": rate_of(int(noticed.sum()), n),
        "right": rate_of(int(right.sum()), n),
    }


LOOP_M = ((0.0, 0.0), (600.0, 100.0), (900.0, 700.0), (200.0, 800.0), (-200.0, 400.0))


@dataclass(frozen=True)
class Run:
    """Estimates and errors of B vehicles: error_m and level_m (T, B, 2) along and across the track, the rest (T, B).

    ``heading_rad`` is the true heading, which defines along and across.
    ``squared`` is the normalised estimation error squared ``d' Q^-1 d`` of the position in the plane.
    """

    time_s: Array
    heading_rad: Array
    error_m: Array
    level_m: Array
    squared: Array
    mode: Ints
    excluded: Ints
    held: Ints
    alert: Bools
    available: Bools


@dataclass(frozen=True)
class Response:
    """Response of each vehicle to a fault, (B,) each.

    Attributes
    ----------
    noticed_s : time from the onset until a satellite is excluded, an ambiguity is released as slipped, the mode changes
        or an alert is raised, other than without the fault; inf if this does not occur during the fault
    noticed_after : noticed in this sense, but only after the end of the fault
    excluded : a satellite was excluded that the vehicle without the fault used
    given_up : ambiguities were released that the vehicle without the fault held
    alerted : an alert was raised that the vehicle without the fault did not raise
    failed : the error exceeded the alert limit on an axis
    late_s : longest time that the error exceeded the limit without an alert, 0 if it did not
    hazardous : epochs in which the error exceeds the limit and the position is declared usable
    misleading : epochs in which the error exceeds its level and the position is declared usable
    epochs : number of epochs from the onset to the end of the run; this and all other entries but ``noticed_s`` refer
        to these epochs
    worst_m : largest error on an axis while the position is declared usable
    lost : no position is usable at the end of the run, where the vehicle without the fault has one
    """

    noticed_s: Array
    noticed_after: Bools
    excluded: Bools
    given_up: Bools
    alerted: Bools
    failed: Bools
    late_s: Array
    hazardous: Ints
    misleading: Ints
    epochs: Ints
    worst_m: Array
    lost: Bools


def drive_run(
    config: NavigatorConfig,
    seeds: Sequence[int],
    duration_s: float,
    faults: Sequence[Fault] | Callable[[SkyTrack], Sequence[Fault]] = (),
) -> Run:
    """Drive a loop of city streets, one vehicle for each seed; ``faults`` may be a function of the sky."""
    track = SkyTrack.from_config(config.sky, duration_s + 60.0)
    schedule = FaultSchedule(faults(track) if callable(faults) else faults)
    navigator = Navigator(config, track, SkyMask.open(), list(seeds), faults=schedule)
    road = Road.through(np.array(LOOP_M), corner_radius_m=25.0, closed=True, lane_count=2, lane_width_m=3.25)
    car, traffic = CityDrive(road, DriveConfig(), config.dt_s), Streams(list(seeds))
    state = car.start(traffic, spread_m=road.length_m)
    epochs, batch = round(duration_s / config.dt_s), len(seeds)
    time = np.linspace(config.dt_s, config.dt_s * epochs, epochs)
    run = Run(
        time, np.zeros((epochs, batch)), np.zeros((epochs, batch, 2)), np.zeros((epochs, batch, 2)),
        np.zeros((epochs, batch)), np.zeros((epochs, batch), np.int64), np.zeros((epochs, batch), np.int64),
        np.zeros((epochs, batch), np.int64), np.zeros((epochs, batch), np.bool_), np.zeros((epochs, batch), np.bool_),
    )  # fmt: skip
    for k in range(epochs):
        truth = car.step(state, traffic)
        s = navigator.step(truth)
        away = s.position_en_m - truth.position_enu_m[:, :2]
        run.heading_rad[k] = truth.heading_rad
        run.error_m[k] = (track_from_enu_matrix(truth.heading_rad) @ away[..., None])[..., 0]
        run.level_m[k, :, 0], run.level_m[k, :, 1] = s.pl_at_m, s.pl_ct_m
        run.squared[k] = _normalised(away, s.covariance_en_m2)
        run.mode[k], run.excluded[k], run.alert[k], run.available[k] = s.mode, s.excluded, s.alert, s.available
        run.held[k] = s.held.sum(-1)
    return run


def as_broadcast(run: Run, config: NavigatorConfig, faults: Sequence[Fault]) -> Run:
    """The run as receivers of the vehicles' broadcasts see it, with the broadcast faults among ``faults``.

    Receivers cannot test a broadcast: the sender decides whether its position is usable.
    """
    schedule, batch = FaultSchedule(faults), run.error_m.shape[1]
    track = SkyTrack.from_config(config.sky, config.dt_s)
    sky = track.at(track.start_s, np.zeros(batch, dtype=np.int64))
    error, level = run.error_m.copy(), run.level_m.copy()
    for k, time in enumerate(run.time_s):
        effects = schedule.effects(float(time), config.dt_s, sky, batch)
        shift = effects.v2v_offset_enu_m[:, :2, None]
        error[k] += (track_from_enu_matrix(run.heading_rad[k]) @ shift)[..., 0]
        level[k] *= effects.v2v_pl_scale[:, None]
    return replace(run, error_m=error, level_m=level)


def _normalised(away: Array, covariance: Array) -> Array:
    """``d' Q^-1 d``, 0 where there is no covariance yet.  (B, 2), (B, 2, 2) -> (B,)."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = a * c - b * b
    known = np.isfinite(determinant) & (determinant > 0.0)
    e, n = away[:, 0], away[:, 1]
    with np.errstate(invalid="ignore", over="ignore"):
        square = c * e * e - 2.0 * b * e * n + a * n * n
    return np.where(known, square / np.where(known, determinant, 1.0), 0.0)


def measure_response(
    faulty: Run, sound: Run, onset_s: Array, duration_s: float, limits_m: tuple[float, float]
) -> Response:
    """Compare a run with faults from ``onset_s`` (B,) on, for ``duration_s``, with the same run without them.

    limits_m : alert limits along and across the track.
    """
    time = faulty.time_s[:, None]
    after, over = time > onset_s + ROUNDING_S, time > onset_s + duration_s + ROUNDING_S
    fresh = (faulty.alert & ~sound.alert) & after
    excluded = (faulty.excluded > sound.excluded) & after
    given_up = (faulty.held < sound.held) & after
    noticed = fresh | excluded | given_up | ((faulty.mode != sound.mode) & after)
    size = np.abs(faulty.error_m)
    beyond = (size > np.array(limits_m)).any(-1) & after
    usable = faulty.available & ~faulty.alert & after
    noticed_s = _first(noticed & ~over, time - onset_s)
    return Response(
        noticed_s=noticed_s,
        noticed_after=np.asarray(noticed.any(0) & np.isinf(noticed_s)),
        excluded=np.asarray(excluded.any(0)),
        given_up=np.asarray(given_up.any(0)),
        alerted=np.asarray(fresh.any(0)),
        failed=np.asarray(beyond.any(0)),
        late_s=_longest(beyond & ~faulty.alert) * float(faulty.time_s[1] - faulty.time_s[0]),
        hazardous=(beyond & usable).sum(0),
        misleading=((size > faulty.level_m).any(-1) & usable).sum(0),
        epochs=after.sum(0),
        worst_m=np.where(usable[..., None], size, 0.0).max((0, 2)),
        lost=np.asarray((sound.available & ~faulty.available)[-1]),
    )


def _first(flag: Bools, since_s: Array) -> Array:
    """Time of the first flag in each column, inf without any."""
    return np.asarray(np.where(flag, since_s, np.inf).min(0))


def _longest(flag: Bools) -> Array:
    """Length in epochs of the longest run of flags in each column."""
    length = best = np.zeros(flag.shape[1])
    for row in flag:
        length = (length + 1.0) * row
        best = np.maximum(best, length)
    return best
