"""Where each ego believes to be: the solution carried on between epochs, and how far to trust it.

A correction longer than ``jump_m`` (a re-fix after an outage) goes into a residual, which then fades: the pose stays
continuous, and its protection level is the solution's plus what has not yet faded, plus the bound of the map's error.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import local, nearest, width_at
from lanebound.envs.batch.records_kernel import SENSED
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import remainder, wrap
from lanebound.integrity.core.records import record

__all__ = ["FIX", "adopt", "begin", "coast", "locate", "rates", "settle", "take", "take_given", "trust_anew"]

ACCELERATION_S = 0.3  # time constant of the acceleration shown: ten odometer pulses at 10 m/s
STANDSTILL_MPS = 0.05
EPS_S = 1e-6  # a second of 0.05 s steps is over after twenty, whatever they sum to


FIX = record(
    position_en_m=("f8", (2,), "East, North"),
    heading_rad="azimuth",
    velocity_en_mps=("f8", (2,), "East, North"),
    speed_mps="odometer, signed",
    pl_at_m="inf without a level",
    pl_ct_m="inf without a level",
    alert=("?", "an alert is on"),
    available=("?", "no level exceeds its limit"),
    reason=("i8", "code of AlertReason"),
    mode=("i8", "code of Mode"),
    rtk=("i8", "code of RtkStatus"),
    hdop="[-]",
    satellites=("i8", "used by RTK"),
    satellites_doppler=("i8", "used by the velocity"),
    excluded=("i8", "by fault detection"),
    since_rtk_s="inf before the first RTK position",
    since_calibration_s="inf before the first calibration of the heading",
    corrections_age_s="inf without data",
    context_warning=("?", "the context monitor warns"),
    context_phases=("i8", "phases passed, 0 to 3"),
    context_score="0 to 100",
    link_probability="of the matched link",
    model_curved="of a filter",
    nis_position="of a filter",
    nis_wheels="of a filter",
    nis_gyro="of a filter",
    nis_steering="of a filter",
    nis_slip="of a filter",
    nis_compass="of a filter",
    trust_m="of a filter",
    sdop="[-]",
)
"""What the tracks take of a solution and of its context: fields of ``Solution`` and of ``ContextReport``."""


@jit(borrows=True)
def adopt(t, b, fix):  # type: ignore[no-untyped-def]
    """Take over a solution, position and heading in the plane, into a track and a belief."""
    t.x_m, t.y_m = fix.position_en_m[0], -fix.position_en_m[1]
    t.fix_heading_rad = wrap(fix.heading_rad - 0.5 * math.pi)
    t.fix_speed_mps, t.pl_at_m, t.pl_ct_m = fix.speed_mps, fix.pl_at_m, fix.pl_ct_m
    t.alert, t.available, t.reason = fix.alert, fix.available, fix.reason
    b.mode, b.rtk, b.hdop = fix.mode, fix.rtk, fix.hdop
    b.satellites, b.satellites_doppler = fix.satellites, fix.satellites_doppler
    b.excluded, b.since_rtk_s = fix.excluded, fix.since_rtk_s
    b.since_calibration_s, b.corrections_age_s = fix.since_calibration_s, fix.corrections_age_s
    b.context_warning, b.context_phases = fix.context_warning, fix.context_phases
    b.context_score, b.link_probability = fix.context_score, fix.link_probability
    b.model_curved, b.trust_m, b.sdop = fix.model_curved, fix.trust_m, fix.sdop
    b.nis_position, b.nis_wheels, b.nis_gyro = fix.nis_position, fix.nis_wheels, fix.nis_gyro
    b.nis_steering, b.nis_slip, b.nis_compass = fix.nis_steering, fix.nis_slip, fix.nis_compass


@jit(borrows=True)
def begin(t, b, fix, shift_x, shift_y):  # type: ignore[no-untyped-def]
    """Start a track at a first solution; ``shift`` [m] is the error of the ego's map."""
    t.residual_x_m = t.residual_y_m = t.yaw_rate_radps = t.acceleration_mps2 = 0.0
    t.map_x_m, t.map_y_m = shift_x, shift_y
    adopt(t, b, fix)
    t.heading_rad = t.fix_heading_rad


@jit(borrows=True)
def coast(t, dt):  # type: ignore[no-untyped-def]
    """Carry the pose on by the last speed and turn rate."""
    turned = dt * t.yaw_rate_radps
    middle = t.heading_rad + 0.5 * turned
    t.x_m += dt * t.fix_speed_mps * math.cos(middle)
    t.y_m += dt * t.fix_speed_mps * math.sin(middle)
    t.heading_rad += turned


@jit(inline=True)
def rates(turned, speed, speed_before, acceleration, dt):  # type: ignore[no-untyped-def]
    """Yaw rate and smoothed acceleration of an estimate that has turned by an angle in ``dt``."""
    yaw_rate = remainder(turned) / dt if abs(speed) > STANDSTILL_MPS else 0.0
    share = 1.0 - math.exp(-dt / ACCELERATION_S)
    return yaw_rate, acceleration + share * ((speed - speed_before) / dt - acceleration)


@jit(borrows=True)
def take(t, b, fix, rules):  # type: ignore[no-untyped-def]
    """A new solution, a simulation step after the pose was last carried on and an epoch after the last solution."""
    dt, start, heading, speed = rules.epoch_s, t.heading_rad, t.fix_heading_rad, t.fix_speed_mps
    coast(t, rules.step_s)
    x, y = t.x_m, t.y_m
    adopt(t, b, fix)
    jump_x, jump_y = t.x_m - x, t.y_m - y
    fade = math.exp(-dt / rules.smoothing_s) if rules.smoothing_s > 0.0 else 0.0
    if math.hypot(jump_x, jump_y) > rules.jump_m:
        t.residual_x_m -= jump_x
        t.residual_y_m -= jump_y
    t.residual_x_m *= fade
    t.residual_y_m *= fade
    turned = t.fix_heading_rad - heading
    t.yaw_rate_radps, t.acceleration_mps2 = rates(turned, t.fix_speed_mps, speed, t.acceleration_mps2, dt)
    t.heading_rad = start + remainder(t.fix_heading_rad - start)


@jit(borrows=True)
def settle(t, b, lanes, passed, rules):  # type: ignore[no-untyped-def]
    """Place the belief on the map and bring levels and alert up to date, ``passed`` [s] after they last were.

    Levels along and across the heading: the solution's, ``|residual|`` turned onto the axes, and the map's bound.
    """
    b.x_m, b.y_m = t.x_m + t.residual_x_m + t.map_x_m, t.y_m + t.residual_y_m + t.map_y_m
    b.heading_rad, b.speed_mps = t.heading_rad, t.fix_speed_mps
    b.yaw_rate_radps, b.acceleration_mps2 = t.yaw_rate_radps, t.acceleration_mps2
    b.fix_x_m, b.fix_y_m = b.x_m, b.y_m
    b.lane = nearest(lanes, b.x_m, b.y_m, b.heading_rad)
    s, c = math.sin(t.heading_rad), math.cos(t.heading_rad)
    b.pl_at_m = t.pl_at_m + (abs(c * t.residual_x_m + s * t.residual_y_m) + rules.map_bound_m)
    b.pl_ct_m = t.pl_ct_m + (abs(c * t.residual_y_m - s * t.residual_x_m) + rules.map_bound_m)
    _trust(b, t, rules, t.alert != 0, t.available != 0, t.reason, passed)


@jit(borrows=True)
def _trust(b, t, rules, alert, available, reason, passed):  # type: ignore[no-untyped-def]
    """Whether the position is available, and the alert: the solution's own, and that of levels beyond their limits.

    Limits from a budget change with every decision, so an alert of theirs is held for a while.
    """
    if rules.budgets == 0 or b.al_ct_m == 0.0:  # fixed, or before the first decision
        b.al_at_m, b.al_ct_m = rules.al_at_m, rules.al_ct_m
    along, across = b.pl_at_m > b.al_at_m, b.pl_ct_m > b.al_ct_m
    b.reason = reason
    if (along or across) and not alert:
        b.reason = rules.reason_both if along and across else rules.reason_at if along else rules.reason_ct
    over = along or across
    t.hold_s = rules.budget.hold_s if over and rules.budgets != 0 else max(t.hold_s - passed, 0.0)
    held = t.hold_s > EPS_S
    if held and not (over or alert):
        b.reason = rules.reason_holding
    b.available = 1 if available and not over else 0
    b.alert = 1 if alert or over or held else 0
    b.alert_age_s = b.alert_age_s + passed if b.alert != 0 else 0.0
    b.time_s += passed


@jit(borrows=True)
def trust_anew(b, t, rules):  # type: ignore[no-untyped-def]
    """Bring alert and availability up to date after the limits have changed; no time passes."""
    sensed = rules.source == SENSED
    alert, available = sensed and t.alert != 0, not sensed or t.available != 0
    _trust(b, t, rules, alert, available, t.reason if sensed else rules.reason_none, 0.0)


@jit(borrows=True)
def take_given(b, t, car, lanes, passed, rules):  # type: ignore[no-untyped-def]
    """A position that is given: the true pose, displaced by the constant offset, whose size is the level.

    Without an offset the believed pose and lane are the true ones, bit for bit. At a start ``passed`` is 0.
    """
    at, ct, heading, speed = rules.offset_at_m, rules.offset_ct_m, b.heading_rad, b.speed_mps
    b.heading_rad, b.speed_mps = car.heading, car.speed
    if passed > 0.0:
        turned = b.heading_rad - heading
        b.yaw_rate_radps, b.acceleration_mps2 = rates(turned, b.speed_mps, speed, b.acceleration_mps2, passed)
    b.x_m, b.y_m, b.lane = car.x, car.y, car.lane
    if at != 0.0 or ct != 0.0:
        cosine, sine = math.cos(b.heading_rad), math.sin(b.heading_rad)
        b.x_m += at * cosine - ct * sine
        b.y_m += at * sine + ct * cosine
        b.lane = nearest(lanes, b.x_m, b.y_m, b.heading_rad)
    b.fix_x_m, b.fix_y_m = b.x_m, b.y_m
    b.pl_at_m, b.pl_ct_m, b.mode, b.rtk = abs(at), abs(ct), rules.mode_given, rules.rtk_given
    _trust(b, t, rules, False, True, rules.reason_none, passed)


@jit(borrows=True)
def locate(b, lanes, path_of, rules):  # type: ignore[no-untyped-def]
    """Where the believed pose is on the ego's own map; without meta-actions the lane itself is the target."""
    s, r, direction = local(lanes, b.lane, b.x_m, b.y_m)
    b.longitudinal_m, b.lateral_m, b.path = s, r, path_of[b.lane]
    b.angle_rad, b.lane_width_m = wrap(b.heading_rad - direction), width_at(lanes, b.lane, s)
    if rules.meta == 0:
        b.target_lane, b.target_speed_mps = b.lane, b.speed_mps
