"""What a predictive controller looks ahead with: condensed linear dynamics, and protection levels that grow in outages.

Symbols: x state, u input, z inputs of a horizon stacked, A and B of ``x(k+1) = A x(k) + B u(k)``, T length of a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.integrity.core.config import Config, Field

__all__ = [
    "CondensedProblem",
    "GrowthConfig",
    "condense",
    "predicted_levels",
    "sky_ahead",
    "upper_levels",
    "upper_told",
]

Array = NDArray[np.float64]


class GrowthConfig(Config):
    """How protection levels grow without RTK, and where RTK is expected to hold."""

    satellites_needed: int = Field(17, ge=0, description="predicted, below which RTK is out in 3 of 5 cases")
    growth_at_m: float = Field(
        0.8, ge=0, description="PL_AT gained by 1 s without RTK; median of training seeds 1000-1211, urban and dense"
    )
    growth_ct_m: float = Field(0.95, ge=0, description="PL_CT likewise")
    growth_power: float = Field(
        0.7,
        gt=0,
        le=1,
        description="of time, for both; between a random walk's 1/2 and 1 of a constant error; likewise",
    )
    reset_at_m: float = Field(0.2, ge=0, description="PL_AT on RTK, likewise")
    reset_ct_m: float = Field(0.21, ge=0, description="PL_CT on RTK, likewise")
    refix_s: float = Field(2.0, ge=0, description="under an open sky until RTK holds again; argued")
    rtk_s: float = Field(0.05, ge=0, description="RTK counts as held when it was last so lately; half an epoch")
    link_age_s: float = Field(
        1.5, gt=0, description="age of reference data from which the link counts as out; 1.1 s at most while it holds"
    )

    upper_at_m: float = Field(
        1.3, ge=0, description="upper gain of PL_AT in 1 s without RTK; 9 of 10 keep to it, seeds 1004-1007 likewise"
    )
    upper_ct_m: float = Field(1.25, ge=0, description="that of PL_CT likewise")
    upper_told_m: float = Field(1.3, ge=0, description="that of the level that a leader tells likewise")
    spare_m: float = Field(0.03, ge=0, description="by which levels on RTK vary, 9 of 10; likewise")
    told_spare_m: float = Field(0.15, ge=0, description="by which a leader's vary, told in steps; likewise")
    told_rtk_m: float = Field(0.35, ge=0, description="level up to which a leader is taken to have RTK; likewise")

    def gained_m(self, since_s: float, for_s: float) -> tuple[float, float]:
        """Growth along and across, ``g (t + T)^p - g t^p``, within T from ``since_s`` without RTK on."""
        rise = (since_s + for_s) ** self.growth_power - since_s**self.growth_power
        return self.growth_at_m * rise, self.growth_ct_m * rise


@dataclass(frozen=True)
class CondensedProblem:
    """States of a horizon by its inputs, ``x = free x0 + forced z``, and the cost ``z' H z / 2 + (F x0)' z``.

    Attributes
    ----------
    free, forced : (N n, n), (N n, N), states 1 to N
    H, F : (N, N), (N, n)
    """

    free: Array
    forced: Array
    H: Array
    F: Array


def condense(A: Array, B: Array, Q: Array, R: float, steps: int) -> CondensedProblem:
    """Eliminate the states of ``sum x'Qx + R u^2`` with the tail of the infinite horizon: unconstrained it is the LQR.

    The terminal weight solves the discrete Riccati equation (Rawlings, Mayne and Diehl 2017, section 1.3).
    """
    n = A.shape[0]
    P = np.asarray(solve_discrete_are(A, B, Q, np.array([[R]])))
    free, forced = np.zeros((steps * n, n)), np.zeros((steps * n, steps))
    power = np.eye(n)
    for k in range(steps):
        row = slice(k * n, k * n + n)
        if k:
            forced[row] = A @ forced[(k - 1) * n : k * n]
        forced[row, k] = B[:, 0]
        power = A @ power
        free[row] = power
    weight = np.kron(np.eye(steps), Q)
    weight[-n:, -n:] = P
    H = forced.T @ weight @ forced + R * np.eye(steps)
    return CondensedProblem(free, forced, 0.5 * (H + H.T), forced.T @ weight @ free)


def sky_ahead(reader: Reader, observation: Observation, distance_m: Array, needed: int) -> NDArray[np.bool_]:
    """Where RTK is expected not to hold: the nearest predicted sky behind each distance sees too few.  (D,) -> (D,)."""
    points = reader.config.satellites_m
    if not points:
        return np.zeros(distance_m.shape, dtype=np.bool_)
    seen = np.array([float(reader.value(observation, f"road.sky_{d:g}m_own")) for d in points])
    dark = (seen >= 0.0) & (seen < needed - 0.5)
    both = np.array([*(a and b for a, b in pairwise(dark)), dark[-1]])  # one dark point alone is a shadow passed
    place = np.clip(np.searchsorted(points, distance_m, side="right") - 1, 0, len(points) - 1)
    return np.asarray(both[place])


def predicted_levels(
    reader: Reader, observation: Observation, way_m: Array, dt_s: float, c: GrowthConfig
) -> tuple[Array, Array]:
    """Protection levels along and across at the steps ahead: the sawtooth of outages and their ends.

    Without RTK a level grows from what it is now, fast at first and slower with the time that has passed since; where
    the sky sees enough for long enough it falls to that of RTK. A link that is out now stays out. Measured levels of
    an outage's first 4 s lie at 0.8 to 1.7 times the law, 8 of 10; how fast they grew lately foretells them worse, as
    the growth falls and a jump does not come again.

    Parameters
    ----------
    observation : a single one
    way_m : (N,) made until each step, ascending
    """
    since_s = float(reader.value(observation, "integrity.since_rtk"))
    linked = float(reader.value(observation, "integrity.corrections_age")) < c.link_age_s
    dark = sky_ahead(reader, observation, way_m, c.satellites_needed)
    at, ct = (np.empty(way_m.size) for _ in range(2))
    level = [float(reader.value(observation, f"integrity.pl_{axis}")) for axis in ("at", "ct")]
    rtk, least = since_s <= c.rtk_s, (c.reset_at_m, c.reset_ct_m)
    open_s, since_s = (c.refix_s, 0.0) if rtk else (0.0, since_s)
    for k in range(way_m.size):
        open_s = 0.0 if dark[k] else open_s + dt_s
        if linked and ((rtk and not dark[k]) or open_s > c.refix_s):
            level = [min(now, low) if not rtk else now for now, low in zip(level, least, strict=True)]
            rtk, since_s = True, 0.0
        else:
            level = [now + gain for now, gain in zip(level, c.gained_m(since_s, dt_s), strict=True)]
            rtk, since_s = False, since_s + dt_s
        at[k], ct[k] = level
    return at, ct


def upper_levels(
    reader: Reader, observation: Observation, way_m: Array, dt_s: float, c: GrowthConfig
) -> tuple[Array, Array]:
    """Protection levels along and across at the steps ahead that nine of ten keep to, at each step by itself.

    From now on they grow wherever RTK may be lost within the horizon: it is out already, the link is, or any point of
    the predicted sky on the way is dark, for RTK is lost before or behind such a point as well. That RTK may come back
    is not counted on.

    Parameters
    ----------
    observation : a single one
    way_m : (N,) made until each step, ascending
    """
    since_s = float(reader.value(observation, "integrity.since_rtk"))
    held = since_s <= c.rtk_s
    lost = not held or _may_be_lost(reader, observation, way_m, c)
    rise = _rise(0.0 if held else since_s, way_m.size, dt_s, c) if lost else np.zeros(way_m.size)
    at, ct = (float(reader.value(observation, f"integrity.pl_{axis}")) + c.spare_m for axis in ("at", "ct"))
    return at + c.upper_at_m * rise, ct + c.upper_ct_m * rise


def upper_told(
    reader: Reader, observation: Observation, told_m: float, way_m: Array, dt_s: float, c: GrowthConfig
) -> Array:
    """The same of the level of a leader, (N,): for how long RTK has been out for it is told by its level alone.

    Its sky is that of the ego's lane where it will be, and its link the ego's.

    Parameters
    ----------
    told_m : its level as told
    way_m : (N,) where it is at each step, from the ego
    """
    told = told_m + c.told_spare_m
    if told_m > c.told_rtk_m:
        since_s = ((told_m - c.reset_at_m) / max(c.growth_at_m, 1e-3)) ** (1.0 / c.growth_power)
        return told + c.upper_told_m * _rise(max(since_s, 0.0), way_m.size, dt_s, c)
    lost = _may_be_lost(reader, observation, way_m, c)
    return told + c.upper_told_m * (_rise(0.0, way_m.size, dt_s, c) if lost else np.zeros(way_m.size))


def _may_be_lost(reader: Reader, observation: Observation, way_m: Array, c: GrowthConfig) -> bool:
    """Whether the link is out, or too few satellites are predicted at any point between which the way lies."""
    if float(reader.value(observation, "integrity.corrections_age")) >= c.link_age_s:
        return True
    points = np.asarray(reader.config.satellites_m)
    first, last = np.searchsorted(points, [way_m[0], way_m[-1]], side="right")
    seen = [float(reader.value(observation, f"road.sky_{d:g}m_own")) for d in points[max(first - 1, 0) : last + 1]]
    return any(0.0 <= count < c.satellites_needed - 0.5 for count in seen)


def _rise(since_s: float, steps: int, dt_s: float, c: GrowthConfig) -> Array:
    """Growth at each step ahead of what grows by 1 in the first second, from ``since_s`` without RTK on, (N,)."""
    out_s = since_s + dt_s * np.arange(1.0, steps + 1.0)
    return np.asarray(out_s**c.growth_power - since_s**c.growth_power)
