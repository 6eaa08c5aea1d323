"""Velocity from changes of carriers, and what finds those that a facade mirrors: tests over windows of seconds.

A mirrored carrier drifts by centimetres in an epoch, within the noise of its change. Over a window its drift adds up,
and the noise stays that of two phases. The windows begin at BASES points in time, the newest first.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, UNRESOLVED, detect_and_exclude
from lanebound.integrity.navigators.rtk_reckoning.attitude_kernel import side_slip
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Array, Epoch
from lanebound.integrity.positioning.rtk_kernel import BASES, UNUSED, is_strong

__all__ = ["bring_to_end", "take_carriers"]

CARRIERS = 6  # of a velocity: two more than unknowns, so that one can be found to be wrong and excluded
LEAST_SPEED_MPS = 0.5  # at which the velocity has a course; heading.min_speed_mps


@jit
def take_carriers(v: int, epoch: Epoch, rows: Records) -> bool:
    """Fill the rows with changes of carriers since the last epoch, if enough pass their tests; else rows are undefined.

    The last phases are relative to the anchor of SLIP_WATCH. Errors of a carrier telescope: over any time they add up
    to those of two phases, of which independent errors in every epoch are a bound.
    """
    par, vehicle, w = epoch.parameters[0], epoch.vehicles[v], epoch.work[v]
    signals, ambiguities, marks, age = epoch.signals[v], epoch.ambiguities[v], epoch.marks[v], epoch.observed[v].age
    last = vehicle.rtk.slips
    for s in range(rows.shape[0]):
        if not (age < math.inf and last.age < math.inf and _is_followed(signals[s], ambiguities[s])):
            _begin_again(ambiguities[s])
    _advance_paths(vehicle, epoch.observed[v], par)
    consistent = True
    for b in range(BASES - 1, 0, -1):
        _fill_window(b, vehicle.bases[b], age, par, signals, marks, ambiguities, rows)
        outcome, _, _, _, _ = detect_and_exclude(
            rows, vehicle.heading.angle, epoch.tables.thresholds, par.doppler.fde, w.velocity, w.q
        )
        # Carriers that contradict each other without showing which ones are wrong give no velocity in this epoch.
        consistent = consistent and outcome != UNRESOLVED
        if outcome <= EXCLUDED:
            consistent = consistent and _agrees(vehicle, b, epoch.tables.thresholds.limits[1].local, w)
        for s in range(rows.shape[0]):
            # It has drifted against the others: a facade mirrors it, or a ray bends round an edge.
            if not rows[s].used and _is_tested(b, signals[s], ambiguities[s], par.doppler):
                _begin_again(ambiguities[s])
    count = 0
    for s in range(rows.shape[0]):
        count += _is_tested(1, signals[s], ambiguities[s], par.doppler)
    enough = consistent and count >= CARRIERS
    if enough:
        _fill_changes(last, age, par, signals, marks, ambiguities, rows)
    _renew_bases(vehicle, age, par, signals, ambiguities)
    return enough


@jit
def _begin_again(ambiguity: Any) -> None:
    """A carrier has not been followed, or has drifted: a new window begins for it."""
    for b in range(BASES):
        ambiguity.bases[b] = 0.0


@jit
def _is_tested(b: int, signal: Any, ambiguity: Any, rules: Any) -> bool:
    """Whether a carrier takes part in the test over window b."""
    return bool(ambiguity.bases[b] != 0.0 and is_strong(signal, rules.sin_mask, rules.cn0_min))


@jit(borrows=True)
def _fill_window(
    b: int, base: Any, age: float, par: Any, signals: Records, marks: Records, ambiguities: Records, rows: Records
) -> None:  # fmt: skip
    """Rows of the displacement since a base: noise of two phases, however long ago it is."""
    drift = par.rtk.age_sigma * (age - base.age)
    for s in range(rows.shape[0]):
        row, signal = rows[s], signals[s]
        row.used, row.variance = _is_tested(b, signal, ambiguities[s], par.doppler), UNUSED
        if row.used:
            row.y = _relative_to(base.anchor, signal) - ambiguities[s].bases[b]
            row.variance = marks[s].quality * (par.doppler.carrier_sigma * par.dt) ** 2 + drift * drift


@jit(borrows=True)
def _fill_changes(
    last: Any, age: float, par: Any, signals: Records, marks: Records, ambiguities: Records, rows: Records
) -> None:
    """Rows of the mean velocity since the last epoch."""
    drift = par.rtk.age_sigma * (age - last.age) / par.dt
    for s in range(rows.shape[0]):
        row, signal = rows[s], signals[s]
        row.used, row.variance = _is_tested(1, signal, ambiguities[s], par.doppler), UNUSED
        if row.used:
            row.y = (_relative_to(last.anchor, signal) - ambiguities[s].last_phase[0]) / par.dt
            row.variance = marks[s].quality * par.doppler.carrier_sigma**2 + drift * drift


@jit(borrows=True)
def _advance_paths(vehicle: Any, observed: Any, par: Any) -> None:
    """Advance the displacements of the antenna by gyro and odometer since each base."""
    heading, lever = vehicle.heading, par.lever
    turning = observed.turn[2] * (1.0 - heading.gyro_scale) / par.dt - heading.gyro_bias
    before, after = heading.angle, heading.angle + turning * par.dt
    course, run = 0.5 * (before + after) + side_slip(lever.axle, turning, observed.speed), observed.speed * par.dt
    sine, cosine = math.sin(after) - math.sin(before), math.cos(after) - math.cos(before)
    for b in range(BASES):
        base = vehicle.bases[b]
        base.path_e += run * math.sin(course) + lever.forward * sine + lever.right * cosine
        base.path_n += run * math.cos(course) + lever.forward * cosine - lever.right * sine


@jit(borrows=True)
def _agrees(vehicle: Any, b: int, k: float, w: Any) -> bool:
    """Whether the displacement by carriers since a base goes where gyro and odometer do, within k sigma across.

    A facade may mirror all carriers of low satellites, on which the velocity across the street rests: they then agree
    with each other.
    """
    e, n = vehicle.bases[b].path_e, vehicle.bases[b].path_n
    across = n * w.velocity[0] - e * w.velocity[1]
    variance = n * n * w.q[0, 0] - 2.0 * n * e * w.q[0, 1] + e * e * w.q[1, 1]
    return bool(across * across <= k * k * (variance + (e * e + n * n) ** 2 * vehicle.heading.p_hh))


@jit(borrows=True)
def _renew_bases(vehicle: Any, age: float, par: Any, signals: Records, ambiguities: Records) -> None:
    """Once in a window the oldest base ends and this epoch becomes the newest."""
    vehicle.since_base += par.dt
    if vehicle.since_base < par.doppler.window - 0.5 * par.dt:
        return
    vehicle.since_base = 0.0
    for b in range(BASES - 1, 0, -1):
        vehicle.bases[b] = vehicle.bases[b - 1]
        for s in range(signals.shape[0]):
            ambiguities[s].bases[b] = ambiguities[s].bases[b - 1]
    newest = vehicle.bases[0]
    newest.age, newest.path_e, newest.path_n = age, 0.0, 0.0
    for k in range(3):
        newest.anchor[k] = vehicle.position[k]
    for s in range(signals.shape[0]):
        locked = age < math.inf and signals[s].tracked and signals[s].phase[0] != 0.0
        ambiguities[s].bases[0] = _relative_to(newest.anchor, signals[s]) if locked else 0.0


@jit(borrows=True)
def _relative_to(anchor: Array, signal: Any) -> float:
    """The first phase relative to a point near the vehicle, so that turning lines of sight leave little [m]."""
    return float(signal.phase[0] + signal.e[0] * anchor[0] + signal.e[1] * anchor[1] + signal.e[2] * anchor[2])


@jit
def _is_followed(signal: Any, ambiguity: Any) -> bool:
    """Whether a carrier has been locked since the last epoch."""
    return bool(signal.phase[0] != 0.0 and ambiguity.last_phase[0] != 0.0 and not signal.lock_lost)


@jit
def bring_to_end(observed: Any, w: Any) -> None:
    """Keep the mean velocity of the epoch, and turn and stretch it by gyro and accelerometer to that at its end."""
    w.mean_e, w.mean_n = w.velocity[0], w.velocity[1]
    speed, half = math.hypot(w.mean_e, w.mean_n), 0.5 * observed.turn[2]
    if speed > LEAST_SPEED_MPS:
        forward = math.copysign(
            1.0, observed.speed
        )  # the force is along the body, the velocity of a reversing car is not
        stretch = max(1.0 + 0.5 * forward * observed.delta_v[0] / speed, 0.0)
        w.velocity[0] = stretch * (math.cos(half) * w.mean_e + math.sin(half) * w.mean_n)
        w.velocity[1] = stretch * (math.cos(half) * w.mean_n - math.sin(half) * w.mean_e)
