"""Power of the speed phase of the context-aware monitor: windows of speeds with one fault each, by Monte Carlo.

Doppler has white noise of the size that its covariance says, wheels have noise, a scale error and the fault. Motion is
steady, or brakes unevenly within the window. Wheels that are frozen while the car stands show when it drives off: these
rows are of the whole monitor on a straight road, whose verdict holds at rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.code_fix import VehicleFix
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, Light
from lanebound.integrity.monitoring.context.position_phase import PositionTest
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedPhase, SpeedPhaseConfig
from lanebound.integrity.positioning.map_matching.road_map import RoadMap

__all__ = ["SpeedPowerConfig", "rest_power", "speed_power"]

Array = NDArray[np.float64]

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
