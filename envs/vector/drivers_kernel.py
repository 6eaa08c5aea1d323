"""The vehicles of compiled traffic beyond their poses, and how cars move, as highway-env has it.

Vehicle 0 is the ego, which the others see as it truly is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.ego_kernel import actuate, follow_road, intend, steering_rad
from lanebound.envs.batch.lane_sensor_kernel import body_of
from lanebound.envs.batch.lanes_kernel import NONE, nearest
from lanebound.envs.batch.next_lane_kernel import beyond, route_onward
from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M, WANDER_SHAPES, WANDER_SLOPE
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["DRIVER", "NUMBERS", "SPEED_MOST_MPS", "WHOLES", "Vehicles", "clear", "command_ego", "fill_onward", "load",
           "move_ego", "move_line", "place_objects", "roll", "seat", "show", "steer_along", "store", "take_effect",
           "vehicles_in",
           "wander_all"]  # fmt: skip

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

SPEED_MOST_MPS = 40.0  # Vehicle.MAX_SPEED of highway-env

DRIVER = record(
    cos="of the heading",
    sin="of the heading",
    target_speed="[m/s]",
    timer="since a lane change was last considered [s]; STAYS for a driver that considers none",
    delta="exponent of the acceleration",
    impact_x="displacement by a crash [m]",
    impact_y="displacement by a crash [m]",
    aside="line of the vehicle in its lane, to the right of the middle [m]",
    target=("i8", "row of the target lane"),
    struck=("i8", "1 from a crash to the next step"),
    order=("i8", "the vehicle in this place along the road, which need not be this one"),
    route=("i8", "row of the first step that is left of its route, 0 for none"),
    way=("i8", "row of its way through a crossing, NONE for none"),
    may_enter=("i8", "1 where it goes through"),
    entered=("i8", "simulation step of the episode at which it entered"),
    lag_s="time constant with which its decisions on acceleration take effect, 0 for at once",
    brake_mps2="braking at most, of a driver with a lag",
    felt_mps2="acceleration that has taken effect, with a lag",
    wander=("f8", (WANDER_SHAPES,), "weights of the shapes of its line over time, see :mod:`..worlds.wander`"),
)
"""State of the control of a vehicle of compiled traffic."""


class Vehicles(NamedTuple):
    """The vehicles of one environment while they drive, (v,) plain arrays, wander (K, V).

    Fields of CAR and DRIVER, and of a step: acceleration [m/s2]; rank: place along the road; front: vehicle in front in
    the own lane, -1 for none. In plain arrays the compiler takes several vehicles at once; on records a step of a
    motorway took a third longer.
    """

    x: Array
    y: Array
    heading: Array
    speed: Array
    length: Array
    width: Array
    cos: Array
    sin: Array
    target_speed: Array
    timer: Array
    delta: Array
    impact_x: Array
    impact_y: Array
    aside: Array
    acceleration: Array
    wander: Array
    lane: Rows
    crashed: Rows
    target: Rows
    struck: Rows
    order: Rows
    rank: Rows
    front: Rows


NUMBERS, WHOLES = 15 + WANDER_SHAPES, 7
"""Rows of the memory of Vehicles: of numbers, and of whole numbers."""


@jit(inline=True)
def vehicles_in(numbers, wholes, count):  # type: ignore[no-untyped-def]
    """The Vehicles in the first places of numbers (NUMBERS, V) and wholes (WHOLES, V)."""
    n, w, k = numbers, wholes, count  # slices of single rows are contiguous for the compiler
    return Vehicles(
        n[0, :k], n[1, :k], n[2, :k], n[3, :k], n[4, :k], n[5, :k], n[6, :k], n[7, :k], n[8, :k], n[9, :k], n[10, :k],
        n[11, :k], n[12, :k], n[13, :k], n[14, :k], n[15:],
        w[0, :k], w[1, :k], w[2, :k], w[3, :k], w[4, :k], w[5, :k], w[6, :k],
    )  # fmt: skip


@jit(borrows=True)
def load(cars, drivers, v):  # type: ignore[no-untyped-def]
    """Take the vehicles from their records."""
    for i in range(cars.shape[0]):
        car, driver = cars[i], drivers[i]
        v.x[i], v.y[i], v.heading[i], v.speed[i] = car.x, car.y, car.heading, car.speed
        v.length[i], v.width[i], v.lane[i], v.crashed[i] = car.length, car.width, car.lane, car.crashed
        v.cos[i], v.sin[i], v.target_speed[i], v.timer[i] = driver.cos, driver.sin, driver.target_speed, driver.timer
        v.delta[i], v.impact_x[i], v.impact_y[i] = driver.delta, driver.impact_x, driver.impact_y
        v.aside[i], v.target[i], v.struck[i], v.order[i] = driver.aside, driver.target, driver.struck, driver.order
        for k in range(WANDER_SHAPES):
            v.wander[k, i] = driver.wander[k]


@jit(borrows=True)
def place_objects(v, count, objects):  # type: ignore[no-untyped-def]
    """Put what stands on the road (O,) CAR behind the first ``count`` vehicles."""
    for k in range(objects.shape[0]):
        i, thing = count + k, objects[k]
        v.x[i], v.y[i], v.heading[i], v.speed[i], v.aside[i] = thing.x, thing.y, thing.heading, 0.0, 0.0
        v.length[i], v.width[i], v.lane[i] = thing.length, thing.width, thing.lane
        v.cos[i], v.sin[i] = math.cos(thing.heading), math.sin(thing.heading)


@jit(borrows=True)
def fill_onward(cars, drivers, ego, lanes, routes):  # type: ignore[no-untyped-def]
    """The lanes that vehicles go on to by what is left of their routes."""
    for i in range(cars.shape[0]):
        cars[i].onward = route_onward(lanes, routes, ego.route if i == 0 else drivers[i].route, cars[i].lane)


@jit(borrows=True)
def show(v, cars):  # type: ignore[no-untyped-def]
    """Write what may be seen of vehicles into their records."""
    for i in range(cars.shape[0]):
        car = cars[i]
        car.x, car.y, car.heading, car.speed = v.x[i], v.y[i], v.heading[i], v.speed[i]
        car.lane, car.crashed = v.lane[i], v.crashed[i]


@jit(borrows=True)
def store(v, cars, drivers):  # type: ignore[no-untyped-def]
    """Write all that lasts into the records."""
    show(v, cars)
    for i in range(cars.shape[0]):
        driver = drivers[i]
        driver.cos, driver.sin, driver.target_speed, driver.timer = v.cos[i], v.sin[i], v.target_speed[i], v.timer[i]
        driver.impact_x, driver.impact_y, driver.aside = v.impact_x[i], v.impact_y[i], v.aside[i]
        driver.target, driver.struck, driver.order = v.target[i], v.struck[i], v.order[i]


@jit(borrows=True)
def clear(cars, drivers, length, width):  # type: ignore[no-untyped-def]
    """Empty places, for vehicles of one size."""
    for i in range(cars.shape[0]):
        car, driver = cars[i], drivers[i]
        car.x = car.y = car.heading = car.speed = 0.0
        car.length, car.width = length, width
        car.lane = car.crashed = 0
        driver.target_speed = driver.timer = driver.delta = 0.0
        driver.impact_x = driver.impact_y = driver.aside = driver.lag_s = driver.brake_mps2 = driver.felt_mps2 = 0.0
        driver.target = driver.struck = driver.order = driver.route = driver.may_enter = driver.entered = 0
        driver.way = NONE


@jit(borrows=True)
def seat(cars, drivers, count):  # type: ignore[no-untyped-def]
    """What follows from the poses of ``count`` vehicles at a start: slots, order, cosines and sines."""
    for i in range(cars.shape[0]):
        cars[i].slot = i - 1 if i < count else -1
        drivers[i].order = i
        drivers[i].cos, drivers[i].sin = math.cos(cars[i].heading), math.sin(cars[i].heading)
    for a in range(1, count):  # followers come last in the list of vehicles, and first along a motorway
        at, x = a, cars[a].x
        while at > 0 and cars[drivers[at - 1].order].x > x:
            drivers[at].order = drivers[at - 1].order
            at -= 1
        drivers[at].order = a


@jit(inline=True)
def take_effect(v, count, drivers, dt):  # type: ignore[no-untyped-def]
    """The accelerations of drivers that react late: as ``LateDriver.act``."""
    for i in range(1, count):
        driver = drivers[i]
        if driver.lag_s > 0.0 and v.crashed[i] == 0:
            decided = max(v.acceleration[i], -driver.brake_mps2)
            driver.felt_mps2 += (decided - driver.felt_mps2) * min(dt / driver.lag_s, 1.0)
            v.acceleration[i] = driver.felt_mps2


@jit(inline=True)
def command_ego(ego, v, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Steering, acceleration and holding brake of the ego in this step; the others read off what it intends.

    A car that is commanded directly has no intent: the lane it wants is its own, the speed it wants 0.
    """
    b, command, length = body_of(ego, rules), ego.command, v.length[0]
    if rules.meta != 0:
        follow_road(ego, lanes, routes, rules)
        onward = beyond(lanes, routes, ego.route, b.target_lane) if rules.pursues != 0 else NONE
        steering, acceleration = intend(b, lanes, onward, rules, length)
        v.target[0], v.target_speed[0] = b.target_lane, b.target_speed_mps
    else:
        steering, acceleration = command.steering_rad, command.acceleration_mps2
        v.target[0], v.target_speed[0] = v.lane[0], 0.0
    steering, hold = actuate(ego.belief, command, steering, acceleration, length, rules)
    return steering, acceleration, hold


@jit(inline=True)
def move_ego(v, steering, acceleration, hold, world, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of the physical ego; the holding brake works against the true motion of the wheels."""
    if hold > 0.0:
        acceleration = min(max(-v.speed[0] / dt, -hold), hold)
    roll(v, 0, steering, acceleration, world.speed_least_mps, world.speed_most_mps, lanes, dt)


@jit(borrows=True)
def roll(v, i, steering, acceleration, slowest, fastest, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of a car by highway-env's bicycle model, held between two speeds; a wreck brakes.

    A vehicle that was struck is thrown as well, and has crashed.
    """
    speed = v.speed[i]
    if v.crashed[i] != 0:
        steering, acceleration = 0.0, -speed
    if speed > fastest:
        acceleration = min(acceleration, fastest - speed)
    elif speed < slowest:
        acceleration = max(acceleration, slowest - speed)
    slip = math.atan(0.5 * math.tan(steering))
    cosine, sine = math.cos(slip), math.sin(slip)
    v.x[i] += speed * (v.cos[i] * cosine - v.sin[i] * sine) * dt
    v.y[i] += speed * (v.sin[i] * cosine + v.cos[i] * sine) * dt
    if v.struck[i] != 0:
        v.x[i] += v.impact_x[i]
        v.y[i] += v.impact_y[i]
        v.crashed[i], v.struck[i] = 1, 0
    heading = v.heading[i] + speed * sine / (0.5 * v.length[i]) * dt
    v.speed[i] = speed + acceleration * dt
    if heading != v.heading[i]:
        v.heading[i] = heading
        v.cos[i], v.sin[i] = math.cos(heading), math.sin(heading)
    v.lane[i] = nearest(lanes, v.x[i], v.y[i], heading)


@jit(inline=True)
def steer_along(v, lanes, i):  # type: ignore[no-untyped-def]
    """highway-env's steering angle of vehicle i to its line in the lane that it wants."""
    return steering_rad(lanes, v.target[i], v.x[i], v.y[i], v.heading[i], v.speed[i], v.length[i], v.aside[i])


@jit(inline=True)
def wander_all(v, shape, dt):  # type: ignore[no-untyped-def]
    """Move the lines of all others in their lanes towards ``shape . weights``, as fast as their cars may move aside.

    shape (K,): the row of ``TrafficFigures.wander`` of the end of this step.
    """
    for i in range(1, v.x.shape[0]):
        line = 0.0
        for k in range(WANDER_SHAPES):  # a constant, so that the compiler takes several vehicles at once
            line += shape[k] * v.wander[k, i]
        move_line(v, i, line, dt)


@jit(inline=True)
def move_line(v, i, line, dt):  # type: ignore[no-untyped-def]
    """Move the line of vehicle i in its lane towards ``line`` [m], as fast as the car may move aside."""
    most = WANDER_SLOPE * max(v.speed[i], 0.0) * dt
    wanted = min(max(line, -WANDER_MOST_M), WANDER_MOST_M) - v.aside[i]
    v.aside[i] += min(max(wanted, -most), most)
