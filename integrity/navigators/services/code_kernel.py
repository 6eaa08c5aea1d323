"""Corrected ranges of a code service in one epoch.

A corrected range is ``y = sum_b a_b code_b - satellite - F dz``, with the shares of the bands a, F the obliquity of the
ionosphere. Its variance is::

    f (a sigma_code)^2 + sigma_sat^2 + g_sat age + F^2 (sigma_dz^2 + g_dz age_dz) + (m sigma_tropo)^2

sigma_sat and sigma_dz as the provider declares them (UDRE and GIVE of SBAS), or as configured without a provider.

f by elevation and C/N0 as everywhere. A code smoothed by its carrier for T has ``min(1, 2 tau / (tau + T))`` of the
variance of a code, which bounds the mean over T of a Gauss-Markov error, and that of the carrier beside it. PPP is a
code service of a long time constant with precise corrections: the mean of code less carrier is the float ambiguity of a
satellite. Each satellite has its own, and a satellite that was lost converges again by itself. The zenith delay is
common to all: separation does not bound faults of the past in it.

A code that is weak for its elevation is off with the odds of :mod:`~lanebound.integrity.positioning.doubtful_kernel`.
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
from lanebound.integrity.navigators.services.zenith_kernel import CarrierTables, estimate_zenith, map_zenith
from lanebound.integrity.positioning.rtk_kernel import UNUSED, obliquity
from lanebound.integrity.positioning.smoothing_kernel import slips, smooth

__all__ = ["combine", "fill_code_ranges", "smoothed_share"]

GATE_SIGMAS = 5.0  # of a code, beyond which carrier smoothing begins anew
LEAST_ROWS = 5
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
        ranges.due[v] = not state.since[v] < rules.interval - 0.5 * par.dt
        if not ranges.due[v] and not rules.smoothing > 0.0:
            continue
        enough = fill_vehicle(v, epoch, service, inputs, state, ranges, carrier) >= LEAST_ROWS
        in_time = inputs.age[v] <= rules.max_age and inputs.zenith_age[v] <= rules.zenith_max_age
        ranges.due[v] = ranges.due[v] and enough and in_time
        if ranges.due[v]:
            state.since[v] = 0.0
        if ranges.due[v] and carrier.rules[0].zenith:
            estimate_zenith(v, epoch, service, ranges, carrier)


@jit
def fill_vehicle(
    v: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, state: ServiceState, ranges: ServiceRows,
    carrier: CarrierTables,
) -> int:  # fmt: skip
    """The ranges of vehicle v; how many are used."""
    count = 0
    rules, par, doubt, own = service.rules[0], service.parameters[0], service.parameters[0].rtk.doubt, carrier.rules[0]
    measured, quality, los = epoch.measured, epoch.work.quality[v], epoch.measured.los[epoch.measured.sight[v]]
    for s in range(service.allowed.shape[0]):
        ranges.used[v, s], hatch = False, state.hatch[v, s]
        if not (measured.tracked[v, s] and service.allowed[s] and quality[s] < UNUSED):
            hatch.count, hatch.free = 0.0, 0.0
            continue
        sine, cn0 = los[s, 2], measured.cn0[v, s]
        loss = doubt.horizon + (doubt.zenith - doubt.horizon) * sine - cn0
        odds = doubt.most / (1.0 + math.exp((doubt.centre - loss) / doubt.scale))
        code, phase, there, locked = combine(inputs.code[v, s], inputs.phase[v, s], service.share[s])
        factor, smoothed = math.sqrt(quality[s]), 0.0
        sigma, noise = service.noise[s] * rules.code * factor, own.phase * factor
        locked = locked and not measured.lock_lost[v, s] and odds < doubt.single
        if rules.smoothing > 0.0:
            free = inputs.phase[v, s, 0] - inputs.phase[v, s, 1] if locked and rules.combined else 0.0
            locked = locked and not slips(free, 2.0 * FREE_SIGMAS * noise, hatch)
            code = smooth(code, phase, locked, rules.smoothing, GATE_SIGMAS * sigma, hatch)
            smoothed = max(hatch.count - 1.0, 0.0) * par.dt
        used = there and sine > rules.sin_mask and cn0 >= rules.cn0_min and inputs.declared[s] < math.inf
        if not used:
            continue
        count += 1
        ranges.used[v, s], ranges.odds[v, s] = True, odds + par.risk.satellite_prior[service.tables.system[s]]
        y = code - inputs.satellite[v, s]
        variance = sigma * sigma * smoothed_share(own.correlation, smoothed) + (service.noise[s] * noise) ** 2
        variance += inputs.declared[s] ** 2 + rules.satellite_growth * min(inputs.age[v], rules.max_age)
        if not rules.combined:
            slant = obliquity(sine)
            grid = rules.zenith**2 + inputs.zenith_declared**2
            grid += rules.zenith_growth * min(inputs.zenith_age[v], rules.zenith_max_age)
            y -= slant * inputs.zenith[v, s]
            variance += slant * slant * grid
        if not own.zenith:
            variance += (map_zenith(sine) * rules.tropo) ** 2
        ranges.y[v, s], ranges.variance[v, s] = y, variance
    return count


@jit(borrows=True)
def smoothed_share(tau: float, smoothed: float) -> float:
    """Bound of the variance of a mean over ``smoothed`` [s] of a Gauss-Markov error of correlation time tau [s], over
    that of the error: ``2 x (1 - x (1 - exp(-1 / x))) <= 2 x / (1 + x)``, x = tau / T."""
    return min(1.0, 2.0 * tau / (tau + smoothed))


@jit(borrows=True)
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
