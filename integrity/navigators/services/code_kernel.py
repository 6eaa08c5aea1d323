"""Corrected ranges of a code service in one epoch.

A corrected range is ``y = sum_b a_b code_b - satellite - F dz``, with the shares of the bands a, F the obliquity of the
ionosphere. Its variance is that of the budget of all code positions
(:mod:`~lanebound.integrity.positioning.code_errors_kernel`), with the sigmas of satellite and ionosphere as the
provider declares them (UDRE and GIVE of SBAS), or as configured without a provider, and with their ages.

A code smoothed by its carrier has the shares of the variance that the mean leaves, and the variance of the carrier
beside it. PPP is a code service of a long time constant with precise corrections: the mean of code less carrier is the
float ambiguity of a satellite. Each satellite has its own, and a satellite that was lost converges again by itself. The
zenith delay is common to all: separation does not bound faults of the past in it.

A code that is weak for its elevation is off with the odds of
:mod:`~lanebound.integrity.positioning.reflection_odds_kernel`.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.services.records_kernel import (
    ServiceInputs,
    ServiceRows,
    ServiceState,
    ServiceTables,
)
from lanebound.integrity.navigators.services.zenith_kernel import CarrierTables, predict_zenith
from lanebound.integrity.positioning.code_errors_kernel import (
    ionosphere_slant,
    ionosphere_variance,
    multipath_time,
    receiver_variance,
    satellite_variance,
    troposphere_slant,
    troposphere_variance,
)
from lanebound.integrity.positioning.reflection_odds_kernel import odds_of
from lanebound.integrity.positioning.rtk_kernel import UNUSED
from lanebound.integrity.positioning.smoothing_kernel import slips, smooth

__all__ = ["combine", "fill_code_ranges", "largest_mean"]

GATE_SIGMAS = 5.0  # of a code, beyond which carrier smoothing begins anew
FREE_SIGMAS = 4.0  # of a carrier's noise, of the change of the difference of both carriers


@jit
def fill_code_ranges(
    first: int, last: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, state: ServiceState,
    ranges: ServiceRows, carrier: CarrierTables,
) -> None:  # fmt: skip
    """Fill y, variance, used and odds of all satellites, and ``due``: whether a position is to be found."""
    rules, par = service.rules[0], service.parameters[0]
    for v in range(first, last):
        state.since[v] += par.dt
        ranges.work[v].consistent, ranges.work[v].few, ranges.work[v].excluded = False, False, 0
        ranges.work[v].due = not state.since[v] < rules.interval - 0.5 * par.dt
        if not ranges.work[v].due and not rules.smoothing > 0.0:
            continue
        enough = fill_vehicle(v, epoch, service, inputs, state, ranges, carrier) >= rules.least
        in_time = inputs.vehicles[v].age <= rules.max_age and inputs.vehicles[v].zenith_age <= rules.zenith_max_age
        ranges.work[v].due = ranges.work[v].due and enough and in_time
        if ranges.work[v].due:
            state.since[v] = 0.0
        if ranges.work[v].due and carrier.rules[0].zenith:
            predict_zenith(v, epoch, service, ranges, carrier)


@jit
def fill_vehicle(
    v: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, state: ServiceState, ranges: ServiceRows,
    carrier: CarrierTables,
) -> int:  # fmt: skip
    """The ranges of vehicle v; how many are used."""
    count = 0
    rules, par, reflections, budget = (
        service.rules[0],
        service.parameters[0],
        service.parameters[0].rtk.reflections,
        service.rules[0].errors,
    )
    vehicle, speed = inputs.vehicles[v], epoch.observed[v].speed
    decay = math.exp(-par.dt / multipath_time(budget, speed, par.odometer.still_speed))
    for s in range(service.satellites.shape[0]):
        row, part, hatch, own = ranges.rows[v, s], ranges.parts[v, s], state.hatch[v, s], service.satellites[s]
        signal, given, quality = epoch.signals[v, s], inputs.signals[v, s], epoch.marks[v, s].quality
        row.used = False
        if not (signal.tracked and own.allowed and quality < UNUSED):
            hatch.count, hatch.free = 0.0, 0.0
            continue
        sine, cn0 = signal.e[2], signal.cn0
        odds = odds_of(reflections, sine, cn0)
        code, phase, there, locked = combine(given.code, given.phase, own.share)
        noise = budget.phase * math.sqrt(quality)
        locked = locked and not signal.lock_lost and odds < reflections.single
        white, lasting, of_carrier = 1.0, 1.0, 0.0
        if rules.smoothing > 0.0:
            free = given.phase[0] - given.phase[1] if locked and rules.combined else 0.0
            locked = locked and not slips(free, 2.0 * FREE_SIGMAS * noise, hatch)
            gate = GATE_SIGMAS * own.noise * math.sqrt(receiver_variance(budget, quality, 1.0, 1.0))
            diverges = 0.0 if rules.combined else 2.0 * budget.iono_rate * ionosphere_slant(sine) * par.dt
            most = largest_mean(rules.smoothing, diverges, receiver_variance(budget, quality, 1.0, 1.0))
            code = smooth(code, phase, locked, most, gate, decay, hatch)
            white, lasting, of_carrier = hatch.white, hatch.lasting, noise * noise + (diverges * hatch.age) ** 2
        used = there and sine > rules.sin_mask and cn0 >= rules.cn0_min and given.declared < math.inf
        if not (used and math.isfinite(given.satellite + given.zenith)):
            continue
        count += 1
        row.used, row.system = True, service.tables.satellites[s].system
        row.group = row.system
        for k in range(3):
            row.e[k] = signal.e[k]
        part.odds = odds + par.risk.satellite_prior[row.system]
        y = code - given.satellite
        variance = receiver_variance(budget, quality, white, lasting) + of_carrier
        variance *= own.noise**2
        part.fast = variance
        variance += satellite_variance(budget, given.declared, min(vehicle.age, rules.max_age))
        if not rules.combined:
            slant = ionosphere_slant(sine)
            age = min(vehicle.zenith_age, rules.zenith_max_age)
            own, common = ionosphere_variance(budget, slant, vehicle.zenith_declared, age)
            y -= slant * given.zenith
            variance += own + common * common
        if not carrier.rules[0].zenith:
            variance += troposphere_variance(budget, troposphere_slant(sine))
        row.y, row.variance = y, variance
    return count


@jit
def largest_mean(most: float, diverges: float, variance: float) -> float:
    """Epochs in the mean of code less carrier: at most those after which the ionosphere lags by 1 sigma.

    diverges : rate of code less carrier, 1 sigma [m/epoch]; variance of the code [m^2]
    """
    if not diverges > 0.0:
        return most
    return max(min(most, math.sqrt(variance) / diverges), 1.0)


@jit
def combine(code: Any, phase: Any, share: Any) -> tuple[float, float, bool, bool]:
    """Code and phase of a satellite (2,) combined by the shares of the bands, and whether each of them is there."""
    y, carrier, there, locked = 0.0, 0.0, True, True
    for b in range(share.shape[0]):
        if share[b] != 0.0:
            y += share[b] * code[b]
            carrier += share[b] * phase[b]
            there = there and code[b] != 0.0
            locked = locked and phase[b] != 0.0
    return y, carrier, there, there and locked
