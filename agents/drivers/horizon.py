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
from lanebound.integrity.config import Config, Field

__all__ = ["Condensed", "GrowthConfig", "condense", "predicted_levels", "sky_ahead"]

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

    def gained_m(self, since_s: float, for_s: float) -> tuple[float, float]:
        """Growth along and across, ``g (t + T)^p - g t^p``, within T from ``since_s`` without RTK on."""
        rise = (since_s + for_s) ** self.growth_power - since_s**self.growth_power
        return self.growth_at_m * rise, self.growth_ct_m * rise


@dataclass(frozen=True)
class Condensed:
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


def condense(A: Array, B: Array, Q: Array, R: float, steps: int) -> Condensed:
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
    return Condensed(free, forced, 0.5 * (H + H.T), forced.T @ weight @ free)


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
