"""A safety filter over any driver: control barrier functions with protection levels as the bound of the state's error.

Discrete-time barriers (Agrawal and Sreenath 2017), ``h(next) >= (1 - gamma) h(now)``, that hold for every state within
the bound (measurement-robust: Dean et al. 2020, Cosner et al. 2021), with the command that is nearest to the driver's.
Acceleration and steering each stand in one pair of bounds, so that the quadratic programme is solved by clipping.

Symbols: v and u speed now and next [m/s], s gap [m], T length of a policy step [s], b and B braking of ego and leader,
e offset [m], psi heading less its steady value in the bend, beta angle of the velocity less that value, L wheelbase.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Driver, Observation, Reader
from lanebound.agents.drivers.lateral import errors
from lanebound.agents.drivers.nominal import make_nominal
from lanebound.agents.drivers.plans import EGO_LENGTH_M
from lanebound.agents.drivers.shares import share_of, value_of
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.config import Config, Field
from lanebound.integrity.errors import InputError

__all__ = ["BarrierConfig", "BarrierFilter", "make_cbf"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
States = tuple[NDArray[Any], ...] | None
NEEDED = ("ego.speed", "ego.lateral_offset", "road.speed_limit", "integrity.pl_ct", "integrity.alert")
EPS = 1e-6


class BarrierConfig(Config):
    """What the filter's promise rests on, and how early it acts."""

    gamma: float = Field(0.3, gt=0, le=1, description="share of the barrier that a step may use up [-]; argued")
    brake_mps2: float = Field(5.0, gt=0, description="b, braking that the ego is sure to reach; dry road")
    lead_brake_mps2: float = Field(6.0, gt=0, description="B >= b, hardest braking of the leader; RSS, dry road")
    standstill_m: float = Field(1.0, ge=0, description="gap that is left when both stand; argued")
    response_s: float = Field(0.3, ge=0, description="tau, age of what is known of the leader at most; V2V at 10 Hz")
    speed_error_mps: float = Field(0.3, ge=0, description="error of the leader's speed; argued")
    growth_mps: float = Field(1.5, ge=0, description="growth of PL_AT of both together; two cars in an outage")
    lane_extra_m: float = Field(1.0, ge=0, description="the lane is widened by PL_CT, by this at most; half a car")
    preview_s: float = Field(1.0, gt=0, description="over which the lane barrier looks ahead; argued")
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")
    slow_share: float = Field(0.48, gt=0, le=1, description="of the limit, when no steering is safe enough")
    slow_mps2: float = Field(2.0, gt=0, description="braking down to that; comfortable")
    speed_mps: float = Field(14.0, gt=0, description="taken for the limit where the map gives none; 50 km/h")


class BarrierFilter:
    """Passes on what a driver commands, or the nearest command that is safe.

    Where no command is safe it carries out a stated manoeuvre: full braking ``-b`` for the following distance; for the
    lane, the driver's own steering and slowing to a share of the limit.

    Parameters
    ----------
    env : of continuous actions that include acceleration
    driver : any policy

    Attributes
    ----------
    counts : decisions, and in how many ``following`` and ``lane`` changed the command or had none that is safe

    Raises
    ------
    InputError
        The actions are not continuous, or the observation shows no protection levels.
    """

    def __init__(self, env: DrivingEnv, driver: Driver, config: BarrierConfig | None = None) -> None:
        self.config = BarrierConfig() if config is None else config
        self.driver, self.reader, self._dt_s = driver, Reader(env.config.observation), env.dt_s
        if not (isinstance(env.action_space, spaces.Box) and env.world.action_type.longitudinal):
            raise InputError("action must be continuous with acceleration for a barrier, got others: choose another id")
        self.reader.require(NEEDED)
        if not self.reader.previews_m:
            raise InputError("observation.preview_m must name a distance for this agent, got none: add one")
        self._inner = env.world.action_type
        self.counts: Counter[str] = Counter()

    def predict(
        self,
        observation: Any,
        state: States = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], States]:
        """The filtered action, and the driver's own state."""
        action, after = self.driver.predict(observation, state, episode_start, deterministic)
        shares = np.array(action, dtype=np.float64)
        bounds = self._inner.acceleration_range
        wanted = value_of(shares[..., 0], bounds)
        top, stuck = self.acceleration_bound(observation)
        lane_top, lost = self._slowing(observation)
        self.counts["decisions"] += wanted.size
        self._count("following", top < wanted - EPS, stuck)
        shares[..., 0] = share_of(np.minimum(np.minimum(wanted, top), lane_top), bounds)
        if self._inner.lateral:
            shares[..., 1] = self._steered(observation, shares[..., 1], lost)
        return shares.astype(np.float32), after

    def acceleration_bound(self, observation: Observation) -> tuple[Array, Bools]:
        """Largest safe acceleration [m/s2], and where even full braking does not keep the barrier.

        ``h = s - PL + v_lead^2 / 2B - s0 - v tau - v^2 / 2b`` with a leader that brakes with B from now on (then ``s +
        v_lead^2 / 2B`` shrinks by the ego's way alone) becomes in a step ``h(u) = s - PL - dPL + v_lead^2 / 2B - s0 -
        (v + u) T / 2 - u tau - u^2 / 2b``; the largest u with ``h(u) >= (1 - gamma) h``, h counted as 0 at least.
        """
        c, dt, reader = self.config, self._dt_s, self.reader
        v = np.maximum(reader.value(observation, "ego.speed"), 0.0)[..., None]
        if not reader.config.vehicles:
            return np.full(v.shape[:-1], np.inf), np.zeros(v.shape[:-1], dtype=np.bool_)
        gap = reader.rows(observation, "lane_gap")
        there = (reader.rows(observation, "present") > 0.5) & self._in_way(observation) & (gap > 0.0)
        s = gap - 0.5 * (reader.rows(observation, "length") + EGO_LENGTH_M) - reader.rows(observation, "pl_at")
        lead = np.maximum(v + reader.rows(observation, "velocity_ahead") - c.speed_error_mps, 0.0)
        room = s + 0.5 * lead**2 / c.lead_brake_mps2 - c.standstill_m
        h = np.maximum(room - v * c.response_s - 0.5 * v * v / c.brake_mps2, 0.0)
        rest = room - c.growth_mps * dt - 0.5 * v * dt - (1.0 - c.gamma) * h
        p = c.brake_mps2 * (c.response_s + 0.5 * dt)
        u = np.sqrt(p * p + 2.0 * c.brake_mps2 * np.maximum(rest, 0.0)) - p
        bound = np.where(there, (u - v) / dt, np.inf).min(axis=-1)
        stuck = bound < np.maximum(-c.brake_mps2, -v[..., 0] / dt) - EPS
        stuck |= (there & (rest < 0.0)).any(axis=-1) & (v[..., 0] > EPS)
        return np.where(stuck, -c.brake_mps2, bound), stuck

    def _in_way(self, observation: Observation) -> Bools:
        """Which vehicles may be in the ego's lane, by their levels across the track, (..., K)."""
        reader, c = self.reader, self.config
        half = 0.5 * reader.value(observation, "ego.lane_width")[..., None]
        extra = np.minimum(reader.rows(observation, "pl_ct"), c.lane_extra_m)
        near = np.abs(reader.rows(observation, "lane_offset")) <= half + extra
        return near | (reader.rows(observation, "own_lane") > 0.5)

    def angle_bounds(self, observation: Observation) -> tuple[Array, Array, Bools]:
        """Bounds of the steering angle [rad] that keep the car in its lane, and where there are none.

        ``q = e + v t psi``, where the car would be after the preview t, stays within ``M = (w - W) / 2 - PL_CT``:
        ``-gamma M + (1 - gamma) q <= q(next) <= gamma M + (1 - gamma) q``, ``q(next) = q + v T psi + G beta``,
        ``G = v T + (v T)^2 / L + 2 T v^2 t / L``. None for M < 0, nor at walking pace, where steering moves nothing.
        """
        c, dt, reader = self.config, self._dt_s, self.reader
        v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
        e, psi, beta, _ = errors(reader, observation)
        width = reader.value(observation, "ego.lane_width")
        m = 0.5 * (width - c.car_width_m) - reader.value(observation, "integrity.pl_ct")
        way = v * dt
        reach = way + way**2 / EGO_LENGTH_M + 2.0 * way * v * c.preview_s / EGO_LENGTH_M
        q = e + v * c.preview_s * psi
        middle = -c.gamma * q - way * psi
        per = np.maximum(reach, 0.1)
        low, high = (
            np.arctan(2.0 * np.tan(np.clip(beta + (middle + side * c.gamma * m) / per, -1.0, 1.0))) for side in (-1, 1)
        )
        return low, high, (m < 0.0) | (v < 1.0)

    def _steered(self, observation: Observation, share: Array, lost: Bools) -> Array:
        bounds = self._inner.steering_range
        wanted = value_of(share, bounds)
        right, left, none = self.angle_bounds(observation)
        safe = np.where(none, wanted, np.clip(wanted, np.minimum(right, left), left))
        self._count("lane", np.abs(safe - wanted) > EPS, lost)
        return np.where(safe == wanted, share, share_of(safe, bounds))

    def _slowing(self, observation: Observation) -> tuple[Array, Bools]:
        """Acceleration at most when no steering is safe enough, and where that is."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        limit = self.reader.value(observation, "road.speed_limit")
        slow = c.slow_share * np.where(limit < self.reader.scale("road.speed_limit"), limit, c.speed_mps)
        _, _, none = self.angle_bounds(observation)
        lost = none & (v >= 1.0)
        return np.where(lost, np.maximum((slow - v) / self._dt_s, -c.slow_mps2), np.inf), lost

    def _count(self, name: str, changed: Bools, none: Bools) -> None:
        self.counts[f"{name} changed"] += int(np.sum(changed))
        self.counts[f"{name} infeasible"] += int(np.sum(none))


def make_cbf(env: DrivingEnv, driver: Driver | None = None, config: BarrierConfig | None = None) -> BarrierFilter:
    """The filter over a driver, the nominal one when none is given."""
    return BarrierFilter(env, make_nominal(env) if driver is None else driver, config)
