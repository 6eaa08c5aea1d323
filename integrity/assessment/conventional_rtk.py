"""Conventional RTK of one epoch: float solution by code, integer least squares, ratio test, and no bound of its risk.

It is what a common receiver computes with ``ambiguity resolution: instantaneous`` (RTKLIB manual 2.4.2, appendix E.7),
without a model of motion: assessments compare its failures on simulated signals with recorded ones. Letters: G design
matrix of double differences, ``y_c = G x + e_c``, ``y_p = G x + lambda N + e_p``; with ``x^ = Q_x G' W y_c``

    N^ = (y_p - G x^) / lambda,   Q_N = (Q_p + G Q_x G') / lambda^2,   Q_xN = -Q_x G' / lambda,
    x~ = x^ - Q_xN Q_N^-1 (N^ - N).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.double_differences import DifferenceRows, RtkSignals, double_differences
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.positioning.ambiguity import resolve
from lanebound.integrity.sky.systems import FIXABLE

__all__ = [
    "ConventionalRtkConfig",
    "ConventionalSolution",
    "RtkOutcome",
    "code_position",
    "solve_epoch",
    "usable_signals",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

UNKNOWNS = 3
MOST_CONDITION = 1e10  # of a normal matrix that is inverted
NODES = 20_000  # of a search; beyond it the solution stays a float one


class ConventionalRtkConfig(Config):
    """Settings of the conventional solution; the defaults are those of RTKLIB, or of ``nagoya_drive_rtk``."""

    elevation_mask_deg: float = Field(30.0, ge=0, lt=90, description="lowest elevation [deg]; nagoya_drive_rtk")
    cn0_min_dbhz: tuple[float, float] = Field(
        (35.0, 30.0), description="lowest C/N0 of each band [dB-Hz]; nagoya_drive_rtk"
    )
    ratio_min: float = Field(2.5, ge=1, description="lowest ratio of second to best norm [-]; nagoya_drive_rtk")
    phase_sigma_m: float = Field(0.003, gt=0, description="phase of one receiver, constant and over sine [m]; RTKLIB")
    code_ratio: float = Field(100.0, gt=0, description="code over phase [-]; RTKLIB")
    most_innovation_m: float = Field(30.0, gt=0, description="code residual that excludes a satellite [m]; RTKLIB")


class RtkOutcome(IntEnum):
    """Result of an epoch."""

    NONE = 0
    FIXED = 1
    FLOAT = 2


@dataclass(frozen=True)
class ConventionalSolution:
    """Outcome, position (3,) [m] (the float one unless fixed), ratio [-] and satellites of an epoch."""

    outcome: RtkOutcome
    position_m: Array
    ratio: float
    satellites: int


def solve_epoch(config: ConventionalRtkConfig, signals: RtkSignals) -> ConventionalSolution:
    """Solve one epoch; without four satellites, or with a singular geometry, the outcome is NONE."""
    s = signals
    usable, variance = usable_signals(config, s)
    found = code_position(config, s, usable, config.code_ratio**2 * variance)
    if found is None:
        return ConventionalSolution(RtkOutcome.NONE, np.zeros(UNKNOWNS), 0.0, int(usable.any(1).sum()))
    position, cofactor, usable = found
    count = int(usable.any(1).sum())
    phases = double_differences(s, s.phase, usable & (s.phase != 0.0) & FIXABLE[s.system][:, None], variance)
    if not phases.y.size:
        return ConventionalSolution(RtkOutcome.FLOAT, position, 0.0, count)
    fixed, ratio = _fix(phases, position, cofactor)
    if ratio < config.ratio_min:
        return ConventionalSolution(RtkOutcome.FLOAT, position, ratio, count)
    return ConventionalSolution(RtkOutcome.FIXED, fixed, ratio, count)


def usable_signals(config: ConventionalRtkConfig, s: RtkSignals) -> tuple[Bools, Array]:
    """Signals (S, F) that pass the masks, and the variance (S,) of the single difference of a phase [m^2]."""
    high = s.tracked & (s.elevation >= np.deg2rad(config.elevation_mask_deg))
    strong = high[:, None] & (s.cn0[:, None] >= np.asarray(config.cn0_min_dbhz)[: s.code.shape[1]])
    variance = 2.0 * config.phase_sigma_m**2 * (1.0 + 1.0 / np.sin(np.maximum(s.elevation, 0.01)) ** 2)
    return strong & (s.code != 0.0), variance


def code_position(
    config: ConventionalRtkConfig, s: RtkSignals, usable: Bools, variance: Array
) -> tuple[Array, Array, Bools] | None:
    """Position (3,) by code, its covariance, and the signals left; the worst satellite goes while it is far off."""
    usable = usable.copy()
    while usable.any(1).sum() > UNKNOWNS:
        rows = double_differences(s, s.code, usable, variance)
        if rows.y.size < UNKNOWNS:
            return None
        weight = np.linalg.inv(rows.covariance)
        normal = rows.design.T @ weight @ rows.design
        if np.linalg.cond(normal) > MOST_CONDITION:
            return None
        cofactor = np.linalg.inv(normal)
        position = cofactor @ rows.design.T @ weight @ rows.y
        left = np.abs(rows.y - rows.design @ position)
        if left.max() <= config.most_innovation_m:
            return position, np.asarray(cofactor, dtype=np.float64), usable
        usable[rows.satellite[left.argmax()]] = False
    return None


def _fix(rows: DifferenceRows, position: Array, cofactor: Array) -> tuple[Array, float]:
    """Position with the best integers, and the ratio of the second best norm to theirs; 0 without a proven search."""
    scale = 1.0 / rows.wavelength
    floated = scale * (rows.y - rows.design @ position)
    spread = rows.design @ cofactor
    covariance = scale[:, None] * (rows.covariance + spread @ rows.design.T) * scale
    found = resolve(floated, covariance, node_limit=NODES)
    if int(found.status) != 0:
        return position, 0.0
    left = floated - found.candidates[0]
    correction = -(spread.T * scale) @ np.linalg.solve(covariance, left)
    return position - correction, float(found.ratio)
