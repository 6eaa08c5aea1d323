"""Rates of warnings against the truth, as S5 section 4.3 counts them, and what those rates hide.

With N points: false alarm rate FAR = f / N, missed detection rate MDR = m / N, OCDR = 1 - (FAR + MDR). All three are
shares of *all* points: where faults are rare, a monitor that never warns has an OCDR near 1. ``per_right`` and
``per_wrong`` are the shares of the points that are right or wrong.

Two applications trust a matched link, with and without the monitor: road tolls, and pay-as-you-speed. A toll is due
once for each passage of a tolled link. A speed charge is due for each second above the limit of the link. Charged is
what the verdicts say: the matched link, the average Doppler speed; *guarded* charges only where the driver is not
warned. A wrong charge was not due; a missed one was due and not charged.

The power of the speed phase is by Monte Carlo of windows of speeds with one fault each: Doppler has white noise of the
size that its covariance says, wheels have noise, a scale error and the fault. Motion is steady, or brakes unevenly
within the window. Wheels that are frozen while the car stands show when it drives off: these rows are of the whole
monitor on a straight road, whose verdict holds at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.code_fix import VehicleFix
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, Light
from lanebound.integrity.monitoring.context.position_phase import PositionTest
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedPhase, SpeedPhaseConfig
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class ChargingConfig(Config):
    """What is charged."""

    every: int = Field(4, ge=1, description="every how many links is tolled, by identity [-]; chosen")
    least_points: int = Field(
        3, ge=1, description="points on a link, one after another, that make a passage [-]; chosen"
    )
    tolerance: float = Field(0.1, ge=0, description="share of the limit by which it may be exceeded [-]; chosen")
    least_mps: float = Field(1.0, ge=0, description="and speed by which it may be exceeded at least [m/s]; chosen")


def passages(link: Ints, seen: Bools, least_points: int) -> list[tuple[int, int, int]]:
    """Runs of one link among the points (T,) that are seen: link, first and last point; short runs are left out."""
    out: list[tuple[int, int, int]] = []
    at = np.flatnonzero(seen & (link != NO_LINK))
    for group in np.split(at, np.flatnonzero(np.diff(link[at]) != 0) + 1) if at.size else []:
        if group.size >= least_points:
            out.append((int(link[group[0]]), int(group[0]), int(group[-1])))
    return out


def toll_counts(
    config: ChargingConfig, link: Ints, charged_at: Bools, true_link: Ints, driving: Bools
) -> dict[str, int]:  # fmt: skip
    """Tolls due, charged, charged wrongly and missed.

    A charge is right if the vehicle passed that link while it was charged, and the first for that passage.
    """
    due = [p for p in passages(true_link, driving, config.least_points) if p[0] % config.every == 0]
    charged = [p for p in passages(link, driving & charged_at, config.least_points) if p[0] % config.every == 0]
    paid: set[int] = set()
    wrong = 0
    for name, first, last in charged:
        fits = [i for i, (own, a, b) in enumerate(due) if own == name and first <= b and last >= a and i not in paid]
        if fits:
            paid.add(fits[0])
        else:
            again = any(own == name and first <= b and last >= a for own, a, b in due)
            wrong += not again  # a passage that was cut in two is charged once
    return {"due": len(due), "charged": len(paid) + wrong, "wrong": wrong, "missed": len(due) - len(paid)}


def charging_counts(
    config: ChargingConfig,
    road_map: RoadMap,
    *,
    link: Ints,
    warn: Bools,
    speed_mps: Array,
    true_link: Ints,
    true_speed_mps: Array,
    driving: Bools,
) -> dict[str, Any]:
    """Tolls and speed charges of one drive of T points, plain and guarded by the warnings; links by identity."""
    limit = np.append(road_map.limit_mps, np.inf)
    row = np.full(int(road_map.identity.max()) + 2, road_map.links)
    row[road_map.identity] = np.arange(road_map.links)

    def over(name: Ints, speed: Array) -> Bools:
        allowed = limit[row[name]]
        return np.asarray(speed > allowed + np.maximum(config.tolerance * allowed, config.least_mps))

    due = over(true_link, true_speed_mps) & driving
    out: dict[str, Any] = {}
    for kind, charged_at in (("plain", np.ones_like(warn)), ("guarded", ~warn)):
        charged = over(link, speed_mps) & driving & charged_at
        out[kind] = {
            "toll": toll_counts(config, link, charged_at, true_link, driving),
            "speed": {
                "due": int(due.sum()), "charged": int(charged.sum()), "wrong": int((charged & ~due).sum()),
                "missed": int((due & ~charged).sum()),
            },
        }  # fmt: skip
    return out


PUBLISHED_COUNTS = {"urban": (14, 8, 1245), "rural": (10, 16, 3335), "mixed": (11, 19, 1105)}
"""False alarms, missed detections, points; S5 Tables 2 and 3."""


@dataclass(frozen=True)
class WarningCounts:
    """Points, of which ``wrong`` need a warning; ``false_alarms`` of the others have one, ``missed`` of them do not."""

    points: int
    wrong: int
    false_alarms: int
    missed: int

    def __post_init__(self) -> None:
        if min(self.missed, self.false_alarms) < 0 or self.false_alarms + self.missed > self.points:
            raise InputError(
                f"false_alarms and missed must be >= 0 and at most points = {self.points} together, got "
                f"{self.false_alarms} and {self.missed}: count each point once"
            )

    @classmethod
    def of(cls, warn: ArrayLike, wrong: ArrayLike, judged: ArrayLike = True) -> Self:
        """Counts of points (...,), of those that are ``judged``."""
        w, bad, take = np.broadcast_arrays(np.asarray(warn, bool), np.asarray(wrong, bool), np.asarray(judged, bool))
        return cls(int(take.sum()), int((bad & take).sum()), int((w & ~bad & take).sum()), int((~w & bad & take).sum()))

    def __add__(self, other: WarningCounts) -> WarningCounts:
        return WarningCounts(
            self.points + other.points, self.wrong + other.wrong, self.false_alarms + other.false_alarms,
            self.missed + other.missed,
        )  # fmt: skip

    @property
    def far(self) -> float | None:
        """False alarms over all points, S5 equation 16; None without points."""
        return self.false_alarms / self.points if self.points else None

    @property
    def mdr(self) -> float | None:
        """Missed detections over all points, S5 equation 17; None without points."""
        return self.missed / self.points if self.points else None

    @property
    def ocdr(self) -> float | None:
        """Overall correct detection rate, S5 equation 15; None without points."""
        return 1.0 - (self.false_alarms + self.missed) / self.points if self.points else None

    @property
    def per_right(self) -> float | None:
        """False alarms over the points that are right; None without one."""
        right = self.points - self.wrong
        return self.false_alarms / right if right > 0 else None

    @property
    def per_wrong(self) -> float | None:
        """Missed detections over the points that are wrong; None without one."""
        return self.missed / self.wrong if self.wrong > 0 else None

    def interval(self, events: int, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson interval of ``events`` over all points: for independent points, which those of a drive are
        not; the spread over drives is wider."""
        return clopper_pearson(events, self.points, confidence) if self.points else (0.0, 1.0)


@dataclass(frozen=True)
class WarningSweep:
    """False alarms and missed detections of each threshold, S5 figure 8: arrays (T,) and the number of points."""

    threshold: Array
    false_alarms: NDArray[np.int64]
    missed: NDArray[np.int64]
    points: int

    def __add__(self, other: WarningSweep) -> WarningSweep:
        return WarningSweep(
            self.threshold, self.false_alarms + other.false_alarms, self.missed + other.missed,
            self.points + other.points,
        )  # fmt: skip

    def crossing(self) -> float | None:
        """Least threshold at which there are at least as many false alarms as missed detections; None without one.

        False alarms grow and missed detections fall with the threshold.
        """
        over = np.flatnonzero(self.false_alarms >= self.missed)
        return float(self.threshold[over[0]]) if over.size else None

    def best(self) -> tuple[float, float]:
        """The threshold of the largest OCDR, and that OCDR."""
        total = self.false_alarms + self.missed
        k = int(np.argmin(total))
        return float(self.threshold[k]), 1.0 - float(total[k]) / max(self.points, 1)


def sweep_thresholds(
    score: ArrayLike, wrong: ArrayLike, threshold: ArrayLike, judged: ArrayLike = True
) -> WarningSweep:
    """Counts when points with a score below each threshold (T,) are warned of."""
    s, bad, take = np.broadcast_arrays(np.asarray(score, float), np.asarray(wrong, bool), np.asarray(judged, bool))
    at = np.asarray(threshold, np.float64)
    right, fault = np.sort(s[take & ~bad]), np.sort(s[take & bad])
    warned, caught = (np.searchsorted(values, at, side="left") for values in (right, fault))
    return WarningSweep(at, warned.astype(np.int64), (fault.size - caught).astype(np.int64), int(take.sum()))


BRAKING_MPS2 = 1.8
DRIVEN_S, STOOD_S, OFF_S = 20, 30, 10  # of a drive that stops and drives off again
POSITION_M = 1.0


class SpeedPowerConfig(Config):
    """Sizes of noise and faults."""

    runs: int = Field(2000, ge=1, description="windows of each case [-]")
    seed: int = Field(1, ge=0, description="of the draws [-]")
    speed_mps: float = Field(12.0, gt=2, description="speed at the start of a window [m/s]")
    doppler_mps: float = Field(0.06, gt=0, description="noise of Doppler on each axis [m/s]; S1 in streets")
    wheel_mps: float = Field(0.05, ge=0, description="noise of the wheels [m/s]; S1 section 4")
    wheel_scale: float = Field(0.006, ge=0, description="scale error of the wheels, 1 sigma [-]; skies/urban")
    slips: tuple[float, ...] = Field((0.02, 0.05, 0.1), description="shares by which wheels turn too fast [-]")
    spoofs_mps: tuple[float, ...] = Field((0.25, 0.5, 1.0), description="steady errors of the Doppler speed [m/s]")
    frozen_mps2: tuple[float, ...] = Field((0.1, 0.25, 0.5), description="deceleration with frozen wheels [m/s^2]")
    off_mps2: tuple[float, ...] = Field((0.5, 1.0, 2.0), description="acceleration from rest, frozen wheels [m/s^2]")


def speed_power(config: SpeedPowerConfig, phase: SpeedPhaseConfig) -> dict[str, dict[str, float]]:
    """Share of windows that fail, by case and form; without a fault those are false alarms."""
    n = phase.intervals
    t = np.arange(n + 1.0)
    steady = np.full(n + 1, config.speed_mps)
    uneven = np.maximum(config.speed_mps - BRAKING_MPS2 * np.maximum(t - 0.5 * n, 0.0), phase.least_mps + 0.5)
    cases: dict[str, tuple[Array, Array]] = {
        "no fault, steady": (steady, _epochs(steady)),
        "no fault, uneven braking": (uneven, _epochs(uneven)),
    }
    for share in config.slips:
        cases[f"slip of {100 * share:g} %"] = steady, (1.0 + share) * steady
    for error in config.spoofs_mps:
        cases[f"Doppler {error:g} m/s too fast"] = steady + error, steady
    for rate in config.frozen_mps2:
        cases[f"frozen wheels, braking {rate:g} m/s2"] = steady - rate * t, steady
    return {
        name: {str(form): _failing(config, phase.replace(form=form), *speeds) for form in SpeedForm}
        for name, speeds in cases.items()
    }


def _epochs(speed: Array) -> Array:
    """Mean speed of the epoch that ends at each sample."""
    return np.concatenate([speed[:1], 0.5 * (speed[1:] + speed[:-1])])


def _failing(config: SpeedPowerConfig, phase: SpeedPhaseConfig, doppler: Array, wheels: Array) -> float:
    """Share of windows (N + 1,) of Doppler and wheel speed whose test fails."""
    rng, runs = named_generator(config.seed, "gnss"), config.runs
    test, scale = SpeedPhase(phase, runs), 1.0 + config.wheel_scale * rng.standard_normal(runs)
    covariance: Any = np.broadcast_to(config.doppler_mps**2 * np.eye(2), (runs, 2, 2))
    for speed, wheel in zip(doppler, wheels, strict=True):
        velocity = np.array([0.0, speed]) + config.doppler_mps * rng.standard_normal((runs, 2))
        measured = scale * wheel + config.wheel_mps * rng.standard_normal(runs)
        found = test.step(velocity, covariance, measured, np.ones(runs, np.bool_))
    return float((~found.consistent).mean())


def rest_power(config: SpeedPowerConfig, monitor: ContextConfig) -> dict[str, dict[str, float]]:
    """Share of drives with a red light of the whole monitor, by case and form.

    Without a fault: at any epoch of a stop. With wheels frozen at a stop: ten seconds after the car drives off.
    """
    forms = {form: monitor.replace(speed={"form": form}) for form in SpeedForm}
    stop, off = slice(DRIVEN_S, DRIVEN_S + STOOD_S), slice(-1, None)
    cases = {"at rest, no fault": (0.0, stop)} | {
        f"frozen at rest, driving off with {rate:g} m/s2": (rate, off) for rate in config.off_mps2
    }
    return {
        f"whole monitor: {name}": {
            str(form): float((_lights(config, own, rate)[at] == Light.RED).any(0).mean()) for form, own in forms.items()
        }
        for name, (rate, at) in cases.items()
    }  # fmt: skip


def _lights(config: SpeedPowerConfig, monitor: ContextConfig, off_mps2: float) -> NDArray[np.int64]:
    """Lights (T, runs) of drives that brake to a stop, and drive off with wheels that have frozen meanwhile."""
    rng, runs = named_generator(config.seed, "gnss"), config.runs
    speed = np.concatenate([
        np.full(DRIVEN_S - 4, config.speed_mps), np.linspace(config.speed_mps, 0.0, 5)[1:], np.zeros(STOOD_S),
        np.minimum(off_mps2 * np.arange(1.0, OFF_S + 1.0), config.speed_mps),
    ])  # fmt: skip
    wheel = _epochs(speed)
    wheel[-OFF_S:] = 0.0
    north = np.cumsum(np.concatenate([[0.0], 0.5 * (speed[1:] + speed[:-1])]))
    ends = np.array([[0.0, -50.0], [0.0, north[-1] + 50.0]])
    watch = ContextMonitor(monitor, RoadMap.of_lines(ends, [(0, 1)], [ends]), runs, 1.0)
    sure, none = np.ones(runs, np.bool_), np.full(runs, np.inf)
    passed = PositionTest(np.full(runs, 5.0), np.zeros(runs), none, sure, sure)
    covariance = [np.broadcast_to(sigma**2 * np.eye(2), (runs, 2, 2)) for sigma in (POSITION_M, config.doppler_mps)]
    scale, lights = 1.0 + config.wheel_scale * rng.standard_normal(runs), []
    for place, truth, turned in zip(north, speed, wheel, strict=True):
        position = np.array([0.0, place]) + POSITION_M * rng.standard_normal((runs, 2))
        velocity = np.array([0.0, truth]) + config.doppler_mps * rng.standard_normal((runs, 2))
        noise = config.wheel_mps * rng.standard_normal(runs) if turned else np.zeros(runs)
        fix = VehicleFix(sure, position, covariance[0], sure, velocity, covariance[1])
        lights.append(watch.step(fix, scale * turned + noise, passed).light)
    return np.array(lights)
