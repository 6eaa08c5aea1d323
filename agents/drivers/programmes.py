"""The two programmes of the predictive driver, along and across the track, and their weights.

Symbols: p way made [m], v speed [m/s], a acceleration [m/s2], e offset [m], psi heading less its steady value in the
bend [rad], u steering less that of the bend [rad], T length of a step [s], k = 1 .. N steps, b and B hardest braking of
ego and leader, tau response to spare [s].
"""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.barrier import BarrierConfig
from lanebound.agents.drivers.horizon import CondensedProblem, GrowthConfig, condense
from lanebound.agents.drivers.lateral import LqrConfig
from lanebound.agents.drivers.plans import EGO_LENGTH_M, CruiseConfig
from lanebound.integrity.core.config import Field

__all__ = ["Across", "Along", "FreeRoad", "MpcConfig", "solve"]

Array = NDArray[np.float64]
SOLVED = 1  # daqp: optimal
SPEED_STEP_MPS = 0.5  # speeds nearer than this share matrices
CUT_MPS, CUT_TOP_MPS = 2.0, 40.0  # tangents of the stopping way, at speeds this far apart up to this one


class MpcConfig(CruiseConfig):
    """Horizon, weights and bounds."""

    steps: int = Field(20, ge=2, le=100, description="N, of a decision each; 4 s at 5 Hz, longer than a stop takes")
    lane_steps: int = Field(10, ge=2, le=100, description="N of the lane; 2 s at 5 Hz")
    speed_mps_weight: float = Field(1.0, gt=0, description="deviation of speed that weighs as one of the others")
    weight_mps2: float = Field(1.0, gt=0, description="acceleration that does")
    weight_mps3: float = Field(2.0, gt=0, description="jerk that does; comfort")
    jerk_mps3: float = Field(3.0, gt=0, description="of speeding up at most; braking may come at once")
    slack_weight: float = Field(50.0, gt=0, description="of a metre short of the time gap, squared; chosen")
    lane_slack_weight: float = Field(1e4, gt=0, description="of a metre out of the tightened lane, squared; chosen")
    lane_floor_m: float = Field(0.15, gt=0, description="room for the believed middle at least; a hand's breadth")
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")
    alert_share: float = Field(0.48, gt=0, le=1, description="of the limit where a level is predicted above its limit")
    dead_reckoning_s: float = Field(
        30.0, gt=0, description="without RTK under an alert until it stops; as integrity_aware"
    )
    growth: GrowthConfig = Field(GrowthConfig(), description="of protection levels ahead")
    barrier: BarrierConfig = Field(BarrierConfig(), description="of the first step, from which a stop stays possible")
    lqr: LqrConfig = Field(LqrConfig(), description="weights of the lane")


def solve(H: Array, f: Array, A: Array, upper: Array, lower: Array) -> Array | None:
    """Minimise ``z'Hz/2 + f'z`` within ``lower <= (z, A z) <= upper``; None without a solution."""
    sense = np.zeros(upper.size, dtype=np.int32)
    z, _, flag, _ = daqp.solve(H, f, A, upper, lower, sense)
    return np.asarray(z) if flag == SOLVED else None


class FreeRoad(NamedTuple):
    """Free road for the ego's front bumper: at each step (N,), and beyond the last where the leader may stop [m]."""

    free_m: Array
    stop_m: float


class Along:
    """The programme along the track, its matrices made once; z holds N accelerations and the slack.

    The last state can stop: ``p(N) + tau v(N) + v(N)^2 / 2b <= stop``. The square is convex; it is bounded by its
    tangents at speeds d apart, of which the largest lies no more than ``(d / 2)^2 / 2b`` below it, which is taken off.
    """

    def __init__(self, c: MpcConfig, dt_s: float) -> None:
        n, self.config, self.dt_s = c.steps, c, dt_s
        self.time_s = dt_s * np.arange(1.0, n + 1.0)
        self.speed = dt_s * np.tri(n)
        self.way = 0.5 * dt_s**2 * (2.0 * np.maximum(np.subtract.outer(np.arange(n), np.arange(n)), 0.0) + np.tri(n))
        self.change = np.eye(n) - np.eye(n, k=-1)
        self.H = np.zeros((n + 1, n + 1))
        jerk = c.weight_mps3 * dt_s
        self.H[:n, :n] = self.speed.T @ self.speed / c.speed_mps_weight**2 + np.eye(n) / c.weight_mps2**2
        self.H[:n, :n] += self.change.T @ self.change / jerk**2
        self.H[n, n] = c.slack_weight * n
        none, one = np.zeros((n, 1)), np.ones((n, 1))
        headway = self.way + c.time_gap_s * self.speed
        self._at = np.arange(0.0, CUT_TOP_MPS + CUT_MPS, CUT_MPS)
        self._per = c.barrier.response_s + self._at / c.barrier.brake_mps2
        stop = self.way[-1] + np.outer(self._per, self.speed[-1])
        blocks = ((self.change, none), (self.speed, none), (self.way, none), (headway, -one))
        rows = [*(np.hstack(block) for block in blocks), np.hstack([stop, np.zeros((self._at.size, 1))])]
        self.A = np.ascontiguousarray(np.vstack(rows))

    def plan(self, v: float, before: float, wanted: Array, road: FreeRoad, bound: float) -> float | None:
        """The first acceleration, ``bound`` at most; None when nothing satisfies the bounds.

        A bound that asks for more than standing at the end of the step asks for that.
        """
        c, n, straight = self.config, self.config.steps, v * self.time_s
        f = np.zeros(n + 1)
        f[:n] = self.speed.T @ (v - wanted) / c.speed_mps_weight**2
        f[0] -= before / (c.weight_mps3 * self.dt_s) ** 2
        most = np.full(n, c.accelerate_mps2)
        most[0] = min(most[0], max(bound, -c.barrier.brake_mps2, -v / self.dt_s))
        rise = np.full(n, c.jerk_mps3 * self.dt_s)
        rise[0] += max(before, 0.0)
        free = road.free_m - c.standstill_m - straight
        spare = c.barrier.standstill_m + (0.5 * CUT_MPS) ** 2 / (2.0 * c.barrier.brake_mps2)
        stop = road.stop_m - spare - straight[-1] - self._per * v + 0.5 * self._at**2 / c.barrier.brake_mps2
        upper = np.concatenate([most, [np.inf], rise, np.full(n, np.inf), free, free - c.time_gap_s * v, stop])
        lower = np.full(upper.size, -np.inf)
        lower[: n + 1] = -c.barrier.brake_mps2
        lower[n] = 0.0
        lower[2 * n + 1 : 3 * n + 1] = -v
        z = solve(self.H, f, self.A, upper, lower)
        return None if z is None else float(z[0])


class Across:
    """The programme across the track, its matrices made once for each speed; z holds N angles and the slack."""

    def __init__(self, c: MpcConfig, dt_s: float) -> None:
        self.config, self.dt_s = c, dt_s
        self._weights = np.diag([c.lqr.offset_m**-2, c.lqr.heading_rad**-2])
        self._known: dict[int, tuple[CondensedProblem, Array, Array]] = {}

    def matrices(self, v: float) -> tuple[CondensedProblem, Array, Array]:
        """Dynamics, H and rows of the constraints at the nearest tabulated speed."""
        key = max(round(v / SPEED_STEP_MPS), 1)
        if key not in self._known:
            self._known[key] = self._make(key * SPEED_STEP_MPS * self.dt_s)
        return self._known[key]

    def _make(self, way_m: float) -> tuple[CondensedProblem, Array, Array]:
        c, n = self.config, self.config.lane_steps
        A = np.array([[1.0, way_m], [0.0, 1.0]])
        B = np.array([[0.5 * way_m + 0.5 * way_m**2 / EGO_LENGTH_M], [way_m / EGO_LENGTH_M]])
        found = condense(A, B, self._weights, c.lqr.steering_rad**-2, n)
        H, offset, one = np.zeros((n + 1, n + 1)), found.forced[::2], np.ones((n, 1))
        H[:n, :n], H[n, n] = found.H, c.lane_slack_weight
        rows = np.ascontiguousarray(np.vstack([np.hstack([offset, -one]), np.hstack([-offset, -one])]))
        return found, H, rows

    def plan(self, v: float, x: Array, room: Array, reach: tuple[float, float]) -> tuple[float, float] | None:
        """The first steering angle beyond the bend's [rad] and the slack [m].

        Parameters
        ----------
        x : (2,) offset and heading
        room : (N,) on each side for the believed middle
        reach : least and largest of the first angle
        """
        if reach[0] > reach[1]:
            return None
        n = room.size
        found, H, rows = self.matrices(v)
        drift, f = found.free[::2] @ x, np.append(found.F @ x, 0.0)
        upper = np.concatenate([np.full(n, np.pi), [np.inf], room - drift, room + drift])
        lower = np.full(upper.size, -np.inf)
        lower[:n], lower[n], lower[0], upper[0] = -np.pi, 0.0, reach[0], reach[1]
        z = solve(H, f, rows, upper, lower)
        return None if z is None else (float(z[0]), float(z[n]))
