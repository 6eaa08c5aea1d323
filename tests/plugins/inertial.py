"""Positioning mode ``inertial``: for some seconds after Doppler, speed by the accelerometer and not by the wheels.

An example: 5 sigma for all risks, and no bound for a satellite fault in the last Doppler velocity.
"""

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import one_record, record
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import step_odometer
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import heading_bias
from lanebound.integrity.navigators.rtk_reckoning.modes import register_mode
from lanebound.integrity.navigators.rtk_reckoning.modes_kernel import move, stand
from lanebound.integrity.positioning.codes_kernel import UNDECIDED

LONGEST_S, SIGMAS = 5.0, 5.0
STATE = record(speed="forward [m/s]", bound="of its error when Doppler gave it [m/s]", age="time since then [s]")


@jit
def advance(first: int, last: int, epoch: Any, own: Any) -> None:
    """Move the position with the speed, and its error growth with the bound of the accelerometer's error."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w, observed = epoch.vehicles[v], epoch.work[v], epoch.observed[v]
        mine, gained = own.state[v], observed.delta_v[0]
        if w.doppler_moves:
            mine.speed, mine.age = math.copysign(w.v_gnss, observed.speed), 0.0
            mine.bound = SIGMAS * math.sqrt(w.q[0, 0] + w.q[1, 1]) + par.doppler.bias
        else:
            mine.speed += gained
            mine.age += par.dt
        if w.mode != UNDECIDED or not vehicle.initialised or mine.age > LONGEST_S:
            continue
        w.mode = own.code
        if w.resting:
            stand(par, w, vehicle)
            continue
        speed, bias = mine.speed - 0.5 * gained, mine.bound + mine.age * par.odometer.watch.allowed
        s, c, b_theta = math.sin(w.middle), math.cos(w.middle), heading_bias(vehicle, par.odometer)
        w.run = par.dt * speed
        move(vehicle, w.run * s, w.run * c)
        for k in range(2):
            growth = vehicle.growth[k]
            step_odometer(w.step, speed, s, c, 0.0, 0.0, b_theta, growth)
            growth.box_e += par.dt * abs(s) * bias  # of either sign: a later turn does not cancel it
            growth.box_n += par.dt * abs(c) * bias


INERTIAL = register_mode("inertial", "inertial", advance, one_record(STATE, speed=0.0, bound=0.0, age=math.inf))
