"""The vehicles of compiled traffic beyond their poses, and how cars move, as highway-env has it.

Vehicle 0 is the ego, which the others see as it truly is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.ego_kernel import actuate, intend, steering_rad
from lanebound.envs.batch.lanes_kernel import following, nearest
from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M, WANDER_SHAPES, WANDER_SLOPE
from lanebound.integrity.core.accel import jit

__all__ = ["SPEED_MOST_MPS", "Drivers", "clear", "command_ego", "drivers_of", "move_ego", "roll", "seat", "steer_along",
           "wander_all"]  # fmt: skip

SPEED_MOST_MPS = 40.0  # Vehicle.MAX_SPEED of highway-env

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


class Drivers(NamedTuple):
    """State of the vehicles' control, of N environments (N, V), of one (V,).

    aside [m]: the line of a vehicle in its lane, to the right of the middle; wander (N, K, V) [-]: its weights
    of the rows of ``TrafficBatch.wander``, see :mod:`..worlds.wander`.

    cos, sin: of the heading; target_speed [m/s]; timer [s]: since a lane change was last considered; delta: exponent of
    the acceleration; acceleration [m/s2]: command; impact_x, impact_y [m]: displacement by a crash; target: row of the
    target lane; struck: 1 from a crash to the next step; order: vehicles sorted along the road; rank: place in it;
    front: vehicle in front in the own lane, -1 for none.
    """

    cos: Array
    sin: Array
    target_speed: Array
    timer: Array
    delta: Array
    acceleration: Array
    impact_x: Array
    impact_y: Array
    aside: Array
    target: Rows
    struck: Rows
    order: Rows
    rank: Rows
    front: Rows
    wander: Array


@jit(inline=True)
def drivers_of(drivers, e):  # type: ignore[no-untyped-def]
    """The vehicles of environment e."""
    return Drivers(
        drivers.cos[e], drivers.sin[e], drivers.target_speed[e], drivers.timer[e], drivers.delta[e],
        drivers.acceleration[e], drivers.impact_x[e], drivers.impact_y[e], drivers.aside[e], drivers.target[e],
        drivers.struck[e], drivers.order[e], drivers.rank[e], drivers.front[e], drivers.wander[e],
    )  # fmt: skip


@jit(borrows=True)
def clear(car, drv, length, width):  # type: ignore[no-untyped-def]
    """Empty places, for vehicles of one size."""
    for i in range(car.x.shape[0]):
        car.x[i] = car.y[i] = car.heading[i] = car.speed[i] = 0.0
        car.length[i], car.width[i] = length, width
        car.lane[i] = car.crashed[i] = 0
        drv.target_speed[i] = drv.timer[i] = drv.delta[i] = drv.acceleration[i] = 0.0
        drv.impact_x[i] = drv.impact_y[i] = drv.aside[i] = 0.0
        drv.target[i] = drv.struck[i] = drv.rank[i] = drv.front[i] = 0


@jit(borrows=True)
def seat(car, drv, count):  # type: ignore[no-untyped-def]
    """What follows from the poses of ``count`` vehicles at a start: slots, order, cosines and sines."""
    for i in range(car.x.shape[0]):
        car.slot[i] = i - 1 if i < count else -1
        drv.order[i] = i
        drv.cos[i], drv.sin[i] = math.cos(car.heading[i]), math.sin(car.heading[i])


@jit(inline=True)
def command_ego(b, command, car, drv, lanes, rules):  # type: ignore[no-untyped-def]
    """Steering, acceleration and holding brake of the ego in this step; the others read off what it intends.

    A car that is commanded directly has no intent: the lane it wants is its own, the speed it wants 0.
    """
    if rules.meta != 0:
        b.target_lane = following(lanes, b.target_lane, b.x_m, b.y_m)
        onward = lanes.table[b.target_lane].onward
        steering, acceleration = intend(b, lanes, onward, rules, car.length[0])
        drv.target[0], drv.target_speed[0] = b.target_lane, b.target_speed_mps
    else:
        steering, acceleration = command.steering_rad, command.acceleration_mps2
        drv.target[0], drv.target_speed[0] = car.lane[0], 0.0
    steering, hold = actuate(b, command, steering, acceleration, car.length[0], rules)
    return steering, acceleration, hold


@jit(inline=True)
def move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of the physical ego; the holding brake works against the true motion of the wheels."""
    if hold > 0.0:
        acceleration = min(max(-car.speed[0] / dt, -hold), hold)
    roll(car, drv, 0, steering, acceleration, slowest, fastest, lanes, dt)


@jit(borrows=True)
def roll(car, drv, i, steering, acceleration, slowest, fastest, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of a car by highway-env's bicycle model, held between two speeds; a wreck brakes.

    A vehicle that was struck is thrown as well, and has crashed.
    """
    speed = car.speed[i]
    if car.crashed[i] != 0:
        steering, acceleration = 0.0, -speed
    if speed > fastest:
        acceleration = min(acceleration, fastest - speed)
    elif speed < slowest:
        acceleration = max(acceleration, slowest - speed)
    slip = math.atan(0.5 * math.tan(steering))
    cosine, sine = math.cos(slip), math.sin(slip)
    car.x[i] += speed * (drv.cos[i] * cosine - drv.sin[i] * sine) * dt
    car.y[i] += speed * (drv.sin[i] * cosine + drv.cos[i] * sine) * dt
    if drv.struck[i] != 0:
        car.x[i] += drv.impact_x[i]
        car.y[i] += drv.impact_y[i]
        car.crashed[i], drv.struck[i] = 1, 0
    heading = car.heading[i] + speed * sine / (0.5 * car.length[i]) * dt
    car.speed[i] = speed + acceleration * dt
    if heading != car.heading[i]:
        car.heading[i] = heading
        drv.cos[i], drv.sin[i] = math.cos(heading), math.sin(heading)
    car.lane[i] = nearest(lanes, car.x[i], car.y[i], heading)


@jit(inline=True)
def steer_along(car, drv, lanes, i):  # type: ignore[no-untyped-def]
    """highway-env's steering angle of vehicle i to its line in the lane that it wants."""
    return steering_rad(
        lanes, drv.target[i], car.x[i], car.y[i], car.heading[i], car.speed[i], car.length[i], drv.aside[i]
    )


@jit(inline=True)
def wander_all(car, drv, shape, dt):  # type: ignore[no-untyped-def]
    """Move the lines of all others in their lanes towards ``shape . weights``, as fast as their cars may move aside.

    shape (K,): the row of ``TrafficBatch.wander`` of the end of this step.
    """
    for i in range(1, car.present):
        line = 0.0
        for k in range(WANDER_SHAPES):  # a constant, so that the compiler takes several vehicles at once
            line += shape[k] * drv.wander[k, i]
        most = WANDER_SLOPE * max(car.speed[i], 0.0) * dt
        wanted = min(max(line, -WANDER_MOST_M), WANDER_MOST_M) - drv.aside[i]
        drv.aside[i] += min(max(wanted, -most), most)
