"""Prediction for a predictive controller: condensed linear dynamics, and protection levels that grow in outages.

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
    "GROWTH_SPEED_MPS",
    "CondensedProblem",
    "GrowthConfig",
    "condense",
    "predicted_levels",
    "sky_ahead",
    "upper_broadcast",
    "upper_levels",
]

Array = NDArray[np.float64]

GROWTH_SPEED_MPS = 10.0  # at which the law of PL_CT is stated


class GrowthConfig(Config):
    """Growth of protection levels without RTK, and where RTK is expected.

    Fitted by ``lanebound tune growth CarFollowing LaneKeeping --seeds 20`` on training seeds under ``urban`` and
    ``dense`` skies.
    """

    satellites_needed: int = Field(17, ge=0, description="predicted, below which RTK is out in 3 of 5 cases")
    growth_at_m: float = Field(0.52, ge=0, description="PL_AT gained by 1 s without RTK; median")
    growth_ct_m: float = Field(0.54, ge=0, description="PL_CT likewise, at 10 m/s")
    growth_power: float = Field(
        0.93,
        gt=0,
        le=1,
        description="of time, for both; between a random walk's 1/2 and 1 of a constant error",
    )
    reset_at_m: float = Field(0.2, ge=0, description="PL_AT on RTK; median")
    reset_ct_m: float = Field(0.21, ge=0, description="PL_CT on RTK likewise")
    refix_s: float = Field(2.0, ge=0, description="under an open sky until RTK holds again; chosen")
    rtk_s: float = Field(0.05, ge=0, description="RTK is present when it was so within this time; half an epoch")
    link_age_s: float = Field(
        1.5, gt=0, description="age of reference data from which the link counts as out; 1.1 s at most while it holds"
    )

    upper_at_m: float = Field(0.81, ge=0, description="upper gain of PL_AT in 1 s without RTK; 9 of 10 lie below")
    upper_ct_m: float = Field(1.21, ge=0, description="that of PL_CT likewise")
    upper_broadcast_m: float = Field(0.81, ge=0, description="that of a leader's level as broadcast: of its PL_AT")
    spare_m: float = Field(0.02, ge=0, description="rise of levels within 4 s on RTK; 9 of 10")
    broadcast_spare_m: float = Field(
        0.15, ge=0, description="variation of a leader's level, broadcast in steps; 9 of 10"
    )
    broadcast_rtk_m: float = Field(0.35, ge=0, description="level of a leader up to which it has RTK; chosen")

    def gained_m(self, since_s: float, for_s: float, speed_mps: float) -> tuple[float, float]:
        """Growth along and across, ``g (t + T)^p - g t^p``, within T from ``since_s`` without RTK on.

        Across it is proportional to the speed: an error of the heading moves the car sideways.
        """
        rise = (since_s + for_s) ** self.growth_power - since_s**self.growth_power
        return self.growth_at_m * rise, self.growth_ct_m * rise * speed_mps / GROWTH_SPEED_MPS


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
    """Where RTK is not expected: too few satellites at the nearest predicted point behind each distance.  (D,)."""
    points = reader.config.satellites_m
    if not points:
        return np.zeros(distance_m.shape, dtype=np.bool_)
    seen = np.array([float(reader.value(observation, f"road.sky_{d:g}m_own")) for d in points])
    dark = (seen >= 0.0) & (seen < needed - 0.5)
    both = np.array([*(a and b for a, b in pairwise(dark)), dark[-1]])  # a single dark point is a short shadow
    place = np.clip(np.searchsorted(points, distance_m, side="right") - 1, 0, len(points) - 1)
    return np.asarray(both[place])


def predicted_levels(
    reader: Reader, observation: Observation, way_m: Array, dt_s: float, c: GrowthConfig
) -> tuple[Array, Array]:
    """Protection levels along and across at the steps ahead: the sawtooth of outages and their ends.

    Without RTK a level grows from its present value, fast at first and slower with time; where enough satellites are
    predicted for long enough it falls to that of RTK. A link that is out now stays out. The recent
    growth predicts levels worse than this law, because growth falls and a jump is not repeated.

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
    speed = np.diff(way_m, prepend=0.0) / dt_s
    rtk, least = since_s <= c.rtk_s, (c.reset_at_m, c.reset_ct_m)
    open_s, since_s = (c.refix_s, 0.0) if rtk else (0.0, since_s)
    for k in range(way_m.size):
        open_s = 0.0 if dark[k] else open_s + dt_s
        if linked and ((rtk and not dark[k]) or open_s > c.refix_s):
            level = [min(now, low) if not rtk else now for now, low in zip(level, least, strict=True)]
            rtk, since_s = True, 0.0
        else:
            gains = c.gained_m(since_s, dt_s, speed[k])
            level = [now + gain for now, gain in zip(level, gains, strict=True)]
            rtk, since_s = False, since_s + dt_s
        at[k], ct[k] = level
    return at, ct


def upper_levels(
    reader: Reader, observation: Observation, way_m: Array, dt_s: float, c: GrowthConfig
) -> tuple[Array, Array]:
    """Upper protection levels along and across at the steps ahead: nine of ten lie below, at each step by itself.

    They grow from now on wherever RTK may be lost within the horizon: it is out already, the link is, or any point of
    the predicted sky on the way is dark, because RTK is also lost before or behind such a point. A later return of RTK
    is not assumed.

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


def upper_broadcast(
    reader: Reader, observation: Observation, broadcast_m: float, way_m: Array, dt_s: float, c: GrowthConfig
) -> Array:
    """Upper level of a leader at the steps ahead, (N,); its time without RTK follows from its level.

    Its sky is that of the ego's lane at its predicted place, and its link is the ego's.

    Parameters
    ----------
    broadcast_m : its level as broadcast
    way_m : (N,) its place at each step, from the ego
    """
    level = broadcast_m + c.broadcast_spare_m
    if broadcast_m > c.broadcast_rtk_m:
        since_s = ((broadcast_m - c.reset_at_m) / max(c.growth_at_m, 1e-3)) ** (1.0 / c.growth_power)
        return level + c.upper_broadcast_m * _rise(max(since_s, 0.0), way_m.size, dt_s, c)
    lost = _may_be_lost(reader, observation, way_m, c)
    return level + c.upper_broadcast_m * (_rise(0.0, way_m.size, dt_s, c) if lost else np.zeros(way_m.size))


def _may_be_lost(reader: Reader, observation: Observation, way_m: Array, c: GrowthConfig) -> bool:
    """Whether the link is out, or too few satellites are predicted at a point along the way or next to it."""
    if float(reader.value(observation, "integrity.corrections_age")) >= c.link_age_s:
        return True
    points = np.asarray(reader.config.satellites_m)
    first, last = np.searchsorted(points, [way_m[0], way_m[-1]], side="right")
    seen = [float(reader.value(observation, f"road.sky_{d:g}m_own")) for d in points[max(first - 1, 0) : last + 1]]
    return any(0.0 <= count < c.satellites_needed - 0.5 for count in seen)


def _rise(since_s: float, steps: int, dt_s: float, c: GrowthConfig) -> Array:
    """Growth at each step ahead, 1 in the first second of an outage, after ``since_s`` without RTK, (N,)."""
    out_s = since_s + dt_s * np.arange(1.0, steps + 1.0)
    return np.asarray(out_s**c.growth_power - since_s**c.growth_power)
