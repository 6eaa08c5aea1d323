"""Stage 3a, with a sequential float solution: the epoch goes into the filter of the float ambiguities.

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
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import find_code_position
from lanebound.integrity.positioning.float_filter_kernel import (
    FilterRow,
    add_epoch,
    assign_slots,
    drop_slot,
    fade,
    filter_of,
    follows,
)
from lanebound.integrity.positioning.rows_kernel import Rows
from lanebound.integrity.positioning.rtk_kernel import Carriers, order_by_variance, owner_of

__all__ = ["add_to_filter"]

LONGEST_GAP_S = 60.0  # after it the filter starts anew: slips are not tested over longer times


@jit
def add_to_filter(first: int, last: int, epoch: Epoch) -> None:
    """Add the epoch to the filters whose vehicles have carriers that are not held, each ``interval``."""
    par, state, measured, work = epoch.parameters[0], epoch.state, epoch.measured, epoch.work
    satellites, rules, thresholds = epoch.tables.satellites, par.rtk, epoch.tables.thresholds
    n = satellites.shape[0]
    usable, system = np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.int64)
    for s in range(n):
        system[s] = satellites[s].system
    for v in range(first, last):
        vehicle, row, own = state.vehicles[v], state.filtered.rows[v], filter_of(state.filtered, v)
        ambiguities, age, factor = state.ambiguities[v], measured.age[v], work.factor[v]
        phase_ok, code = work.phase_ok[v], measured.code[v]
        row.added, row.since_s = False, row.since_s + par.dt
        followed = note_breaks(own.slots, ambiguities, phase_ok, measured.lock_lost[v])
        new = False
        for s in range(n):
            usable[s] = work.used[v, s] and phase_ok[s] and satellites[s].fixable
            new = new or (usable[s] and not ambiguities[s].held)
        due = not followed or row.since_s > rules.filter.interval - 0.5 * par.dt
        if not (new and due and age <= rules.fix_max_age):
            continue
        los = measured.los[measured.sight[v]]
        carriers = Carriers(los, satellites, measured.phase[v], np.empty(n))
        rows, tests = Rows(los, system, np.empty(n), np.empty(n), work.used[v].copy()), (thresholds, par, vehicle)
        position, q = np.empty(3), np.empty((3, 3))
        drop_broken(own, satellites, row.since_s > LONGEST_GAP_S, rules)
        if not find_code_position(rows, code, factor, tests, position, q):
            continue
        variance_code, aged = np.empty(n), (rules.age_sigma * age) ** 2
        for s in range(n):
            carriers.variance[s] = factor[s] * rules.sigma_phase**2 + aged
            variance_code[s] = factor[s] * rules.sigma_code**2 + aged
        coded = rows.used.copy()
        find_slips(own.slots, carriers, factor, usable, rows, row, age, tests)
        drop_broken(own, satellites, False, rules)
        most = own.slots.shape[0]
        order = np.empty(most, dtype=np.int64)
        count = order_by_variance(usable, carriers.variance, most, order)
        fade(own, row.since_s, rules)
        assign_slots(own, carriers, code, order, count, ambiguities, rules)
        row.added = add_epoch(own, carriers, code, variance_code, coded, usable, rules)
        row.since_s, row.age_s = 0.0, age
        store_phases(own.slots, carriers, usable, vehicle.position, rules.bands)


@jit
def note_breaks(slots: Records, ambiguities: Records, phase_ok: Bools, lost: Bools) -> bool:
    """Mark satellites that lost their lock or whose integers were released; returns whether any is followed."""
    followed = False
    for k in range(slots.shape[0]):
        slot = slots[k]
        if not slot.followed:
            continue
        followed = True
        now = ambiguities[slot.satellite]
        released = not now.held and (slot.held or now.fix_id != slot.fix_id)
        if released or lost[slot.satellite] or not phase_ok[slot.satellite]:
            slot.broken = True
        slot.held, slot.fix_id = now.held, now.fix_id
    return followed


@jit
def drop_broken(own: FilterRow, satellites: Records, everything: bool, rules: Any) -> None:
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
    slots: Records, carriers: Carriers, factor: Any, usable: Bools, rows: Rows, row: Any, age: float,
    tests: tuple[Thresholds, Any, Any],
) -> None:  # fmt: skip
    """Mark satellites whose phases changed since the last epoch of the filter in a way that no motion explains.

    tests : thresholds, parameters and vehicle; ``rows`` is overwritten. The change of the mean phase of the bands has
    the variance ``2 sigma^2 / bands``, that of their difference ``4 sigma^2`` and the rate of the ionosphere.
    """
    thresholds, par, vehicle = tests
    rules, los, anchor = par.rtk, carriers.los, vehicle.position
    drift = (rules.age_sigma * (age - row.age_s)) ** 2
    ionosphere, x, q = (par.slips.ionosphere * row.since_s) ** 2, np.empty(3), np.empty((3, 3))
    rows.used[:] = False
    for k in range(slots.shape[0]):
        slot, s = slots[k], slots[k].satellite
        if not slot.followed:
            continue
        if not usable[s]:
            slot.broken = slot.broken or rules.bands == 1  # a slip of one band would go unnoticed
            continue
        if slot.last_phase[0] == 0.0:
            continue
        along, variance = los[s, 0] * anchor[0] + los[s, 1] * anchor[1] + los[s, 2] * anchor[2], 0.0
        change = np.zeros(2)
        for b in range(rules.bands):
            change[b] = carriers.phase[s, b] + along - slot.last_phase[b]
        variance = factor[s] * rules.sigma_phase**2
        if rules.bands == 2 and abs(change[0] - change[1]) > par.slips.k * math.sqrt(4.0 * variance + ionosphere):
            slot.broken = True
            continue
        rows.used[s] = True
        rows.y[s] = change[0] if rules.bands == 1 else 0.5 * (change[0] + change[1])
        rows.variance[s] = 2.0 * variance / rules.bands + drift
    outcome, _, _, _, _ = detect_and_exclude(rows, rows.group, vehicle.heading.angle, thresholds, par.fde, x, q)
    for k in range(slots.shape[0]):
        slot, s = slots[k], slots[k].satellite
        if slot.followed and usable[s] and slot.last_phase[0] != 0.0:
            excluded = outcome == EXCLUDED and not rows.used[s]
            slot.broken = slot.broken or excluded or outcome == UNRESOLVED


@jit
def store_phases(slots: Records, carriers: Carriers, usable: Bools, anchor: Any, bands: int) -> None:
    """Store the phases of this epoch for the next slip test, relative to the point ``anchor`` (3,)."""
    los, phase = carriers.los, carriers.phase
    for k in range(slots.shape[0]):
        slot, s = slots[k], slots[k].satellite
        for b in range(2):
            slot.last_phase[b] = 0.0
            if slot.followed and usable[s] and b < bands:
                along = los[s, 0] * anchor[0] + los[s, 1] * anchor[1] + los[s, 2] * anchor[2]
                slot.last_phase[b] = phase[s, b] + along
