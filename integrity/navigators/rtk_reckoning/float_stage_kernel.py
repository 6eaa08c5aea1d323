"""With a sequential float solution the epoch goes into the filter of the float ambiguities.

A satellite is followed until it loses its lock, slips, or has its integers released. Slips between two epochs of the
filter are found without a velocity: the changes of the phases must fit a change of position and clocks (the fault test
of the codes, on phases), and with two bands the geometry-free combination must not jump.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, UNRESOLVED, Thresholds, detect_and_exclude
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Bools, Epoch
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import fill_rows, find_code_position
from lanebound.integrity.positioning.float_filter_kernel import (
    FloatFilters,
    add_epoch,
    assign_slots,
    drop_slot,
    fade,
    filter_of,
    follows,
)
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import Carriers, order_by_variance, owner_of

__all__ = ["add_to_filter"]

LONGEST_GAP_S = 60.0  # after it the filter starts anew: slips are not tested over longer times


@jit
def add_to_filter(first: int, last: int, epoch: Epoch) -> None:
    """Add the epoch to the filters whose vehicles have carriers that are not held, each ``interval``."""
    par, satellites, thresholds = epoch.parameters[0], epoch.tables.satellites, epoch.tables.thresholds
    rules, n = par.rtk, satellites.shape[0]
    usable, coded, rows = np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.bool_), np.zeros(n, ROW)
    for v in range(first, last):
        vehicle, own, age = epoch.vehicles[v], filter_of(epoch.filters, v), epoch.observed[v].age
        row, ambiguities, signals, marks = vehicle.filter, epoch.ambiguities[v], epoch.signals[v], epoch.marks[v]
        row.added, row.since_s = False, row.since_s + par.dt
        followed = note_breaks(own.slots, ambiguities, marks, signals)
        new = False
        for s in range(n):
            usable[s] = marks[s].used and marks[s].phase_ok and satellites[s].fixable
            new = new or (usable[s] and not ambiguities[s].held)
        due = not followed or row.since_s > rules.filter.interval - 0.5 * par.dt
        if not (new and due and age <= rules.fix_max_age):
            continue
        carriers, tests = Carriers(satellites, signals, np.empty(n)), (thresholds, par, vehicle)
        fill_rows(carriers, marks, rows)
        position, q = np.empty(3), np.empty((3, 3))
        drop_broken(own, satellites, row.since_s > LONGEST_GAP_S, rules)
        if not find_code_position(rows, signals, marks, tests, position, q):
            continue
        variance_code, aged = np.empty(n), (rules.age_sigma * age) ** 2
        for s in range(n):
            carriers.variance[s] = marks[s].factor * rules.sigma_phase**2 + aged
            variance_code[s] = marks[s].factor * rules.sigma_code**2 + aged
            coded[s] = rows[s].used
        find_slips(own.slots, carriers, marks, usable, rows, row, age, tests)
        drop_broken(own, satellites, False, rules)
        most = own.slots.shape[0]
        order = np.empty(most, dtype=np.int64)
        count = order_by_variance(usable, carriers.variance, most, order)
        fade(own, row.since_s, rules)
        assign_slots(own, carriers, order, count, ambiguities, rules)
        row.added = add_epoch(own, carriers, variance_code, coded, usable, rules)
        row.since_s, row.age_s = 0.0, age
        store_phases(own.slots, carriers, usable, vehicle.position, rules.bands)


@jit
def note_breaks(slots: Records, ambiguities: Records, marks: Records, signals: Records) -> bool:
    """Mark satellites that lost their lock or whose integers were released; returns whether any is followed."""
    followed = False
    for k in range(slots.shape[0]):
        slot = slots[k]
        if not slot.followed:
            continue
        followed = True
        now = ambiguities[slot.satellite]
        released = not now.held and (slot.held or now.fix_id != slot.fix_id)
        if released or signals[slot.satellite].lock_lost or not marks[slot.satellite].phase_ok:
            slot.broken = True
        slot.held, slot.fix_id = now.held, now.fix_id
    return followed


@jit
def drop_broken(own: FloatFilters, satellites: Records, everything: bool, rules: Any) -> None:
    """Take marked satellites, or all, out of the filter: before them their further signals."""
    slots = own.slots
    for k in range(slots.shape[0]):
        if slots[k].followed and satellites[slots[k].satellite].further:
            host = follows(slots, owner_of(satellites, slots[k].satellite))
            if slots[k].broken or everything or host < 0 or slots[host].broken:
                drop_slot(own, k, rules)
    for k in range(slots.shape[0]):
        if slots[k].followed and (slots[k].broken or everything):
            drop_slot(own, k, rules)


@jit
def find_slips(
    slots: Records, carriers: Carriers, marks: Records, usable: Bools, rows: Records, row: Any, age: float,
    tests: tuple[Thresholds, Any, Any],
) -> None:  # fmt: skip
    """Mark satellites whose phases changed since the last epoch of the filter in a way that no motion explains.

    tests : thresholds, parameters and vehicle; ``rows`` is overwritten. The change of the mean phase of the bands has
    the variance ``2 sigma^2 / bands``, that of their difference ``4 sigma^2`` and the rate of the ionosphere.
    """
    thresholds, par, vehicle = tests
    rules, anchor = par.rtk, vehicle.position
    drift = (rules.age_sigma * (age - row.age_s)) ** 2
    ionosphere, x, q = (par.slips.ionosphere * row.since_s) ** 2, np.empty(3), np.empty((3, 3))
    for s in range(rows.shape[0]):
        rows[s].used = False
    for k in range(slots.shape[0]):
        slot, s = slots[k], slots[k].satellite
        if not slot.followed:
            continue
        if not usable[s]:
            slot.broken = slot.broken or rules.bands == 1  # a slip of one band would go unnoticed
            continue
        if slot.last_phase[0] == 0.0:
            continue
        signal, change = carriers.signals[s], np.zeros(2)
        along = signal.e[0] * anchor[0] + signal.e[1] * anchor[1] + signal.e[2] * anchor[2]
        for b in range(rules.bands):
            change[b] = signal.phase[b] + along - slot.last_phase[b]
        variance = marks[s].factor * rules.sigma_phase**2
        if rules.bands == 2 and abs(change[0] - change[1]) > par.slips.k * math.sqrt(4.0 * variance + ionosphere):
            slot.broken = True
            continue
        rows[s].used = True
        rows[s].y = change[0] if rules.bands == 1 else 0.5 * (change[0] + change[1])
        rows[s].variance = 2.0 * variance / rules.bands + drift
    outcome, _, _, _, _ = detect_and_exclude(rows, vehicle.heading.angle, thresholds, par.fde, x, q)
    for k in range(slots.shape[0]):
        slot, s = slots[k], slots[k].satellite
        if slot.followed and usable[s] and slot.last_phase[0] != 0.0:
            excluded = outcome == EXCLUDED and not rows[s].used
            slot.broken = slot.broken or excluded or outcome == UNRESOLVED


@jit
def store_phases(slots: Records, carriers: Carriers, usable: Bools, anchor: Any, bands: int) -> None:
    """Store the phases of this epoch for the next slip test, relative to the point ``anchor`` (3,)."""
    for k in range(slots.shape[0]):
        slot, s, signal = slots[k], slots[k].satellite, carriers.signals[slots[k].satellite]
        for b in range(2):
            slot.last_phase[b] = 0.0
            if slot.followed and usable[s] and b < bands:
                along = signal.e[0] * anchor[0] + signal.e[1] * anchor[1] + signal.e[2] * anchor[2]
                slot.last_phase[b] = signal.phase[b] + along
