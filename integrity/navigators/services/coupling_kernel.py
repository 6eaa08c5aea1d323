"""A code position or its ranges combined with the position reckoned on, with a level for errors of unknown correlation.

With the error e of the position reckoned on, the coupled error is ``e' = A e + G (c + f)``: loose ``A = (1 - a) I`` and
G c = a times the error of the service's position, tight A and G of :mod:`.tight_kernel`. Dead reckoning adds errors of
its own, which stay Gauss-Markov and separated by fault mode: A acts on all of them. Code errors are

- fast (noise, multipath), correlated for ``tau`` at most. Two bounds of their variance hold side by side. Whatever the
  correlation, ``sd(x + y) <= sd(x) + sd(y)``. And by Gershgorin's theorem a correlation matrix of samples ``dt`` apart,
  below ``exp(-t / tau)``, has no eigenvalue above ``1 + 2 tau / dt``: a white error of that much more variance bounds
  them under any weights. The smaller one counts.
- slow (satellites, atmosphere, height): whatever the correlation.
- faults f of satellites and systems in any epoch whose ranges are in the position. Mode i of prior p_i moves the
  position of one epoch by ``F_i`` with ``abs(F_i) <= abs(d_i) + abs(N)``, d_i the separation that is observed and N
  normal of its variance, so that ``Y = abs(F) - X`` with ``X = max_i (abs(d_i) + K_i sigma_di)`` has
  ``E[Y+] <= sum_i p_i sigma_di 2 (phi(K_i) - K_i Q(K_i)) = r D``. With weights w of a sum of at most 1, Markov's
  inequality gives ``P(sum w abs(F) > sum w (X + D)) <= r``, whatever the dependence of epochs: ``X + D`` adds up by its
  weights, and the risk r does not.

Time at rest brings nothing new, so it does not count between two samples, and below ``creep`` it counts less.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import remember_velocity, sigma_and_bias
from lanebound.integrity.monitoring.protection_kernel import q_inverse
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import (
    along_axes,
    later_by,
    levels_since_fix,
)
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import copy_reckoning
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Epoch
from lanebound.integrity.navigators.services.coupling_records_kernel import (
    NO_PROPOSAL,
    WHOLE,
    WITH_RECKONED,
    Coupling,
    Part,
)
from lanebound.integrity.positioning.codes_kernel import DOPPLER

__all__ = [
    "begin_coupling",
    "cost_of",
    "fault_bound",
    "lengthen",
    "on_axis",
    "propose",
    "propose_whole",
    "settle",
    "transform",
]

Array = NDArray[np.float64]

INV_SQRT_2PI = 1.0 / math.sqrt(2.0 * math.pi)
TURNED = 0.17  # sine of a turn of 10 degrees
MODE_SHARE = 0.5  # of the risk of faults, to which the tails of all modes together are aimed


@jit
def begin_coupling(first: int, last: int, epoch: Epoch, coupling: Coupling) -> None:
    """Nothing is proposed yet; time in motion goes on."""
    rules, dt = coupling.rules[0], epoch.parameters[0].dt
    for v in range(first, last):
        c = coupling.coupled[v]
        coupling.proposals[v].kind = NO_PROPOSAL
        c.age += dt
        if abs(epoch.observed[v].speed) > epoch.parameters[0].odometer.still_speed:
            c.since += dt * min(1.0, abs(epoch.observed[v].speed) / rules.creep)
        if not epoch.vehicles[v].initialised:
            c.active = False


@jit
def lengthen(first: int, last: int, epoch: Epoch, coupling: Coupling) -> None:
    """A coupled position remembers the velocities from before its last ranges: faults had as long to begin."""
    duration = epoch.parameters[0].risk.fault_duration
    for v in range(first, last):
        if coupling.coupled[v].active:
            later = later_by(coupling.coupled[v].age, epoch.vehicles[v].memory_s, duration)
            epoch.work[v].later = max(epoch.work[v].later, later)


@jit
def settle(first: int, last: int, epoch: Epoch, coupling: Coupling) -> None:
    """After the position was taken: growth, starts and separations of a coupled position in place of a restart."""
    for v in range(first, last):
        vehicle, w, proposal = epoch.vehicles[v], epoch.work[v], coupling.proposals[v]
        starts, faults = epoch.starts[v], epoch.faults[v]
        if not w.accepted:
            continue
        if proposal.kind == NO_PROPOSAL:
            coupling.coupled[v].active = False
            continue
        coupling.coupled[v] = proposal.after
        for r in range(coupling.extra.shape[1]):
            coupling.extra[v, r] = coupling.extra_after[v, r]
        if proposal.kind != WITH_RECKONED:
            continue
        vehicle.growth[LATEST] = proposal.growth
        for r in range(starts.shape[1]):
            starts[LATEST, r] = coupling.starts[v, r]
        for k in range(faults.shape[0]):
            faults[k].latest = coupling.separations[v, k]
        vehicle.separated = proposal.separated
        if w.doppler_moves and not proposal.by_doppler:
            remember_velocity(w.q[0, 0], w.q[0, 1], w.q[1, 1], vehicle.growth[LATEST])
        copy_reckoning(LATEST, BACKUP, vehicle, starts, faults)


@jit
def propose_whole(v: int, rules: Any, part: Part, w: Any, coupling: Coupling) -> None:
    """The position of a service is offered as it is; what its errors are when it is reckoned on."""
    after = coupling.proposals[v].after
    coupling.proposals[v].kind = WHOLE
    after.active, after.since, after.age = True, 0.0, 0.0
    after.any_ee, after.any_en, after.any_nn = part.fast[0], part.fast[1], part.fast[2]
    after.white_ee, after.white_en, after.white_nn = (
        rules.white * part.fast[0],
        rules.white * part.fast[1],
        rules.white * part.fast[2],
    )
    after.slow_ee, after.slow_en, after.slow_nn = part.slow[0], part.slow[1], part.slow[2]
    after.held_ee, after.held_en = part.fast[0] + part.slow[0], part.fast[1] + part.slow[1]
    after.held_nn = part.fast[2] + part.slow[2]
    for r in range(coupling.extra_after.shape[1]):  # the starts of a service lie along and across the track
        coupling.extra_after[v, r].first, coupling.extra_after[v, r].second = part.extra[r, 0], part.extra[r, 1]


@jit
def begin_from(v: int, epoch: Epoch, coupling: Coupling) -> None:
    """Code errors of a position that no service has given: none; what its start left is a bound of its own."""
    c, starts = coupling.coupled[v], epoch.starts
    c.any_ee, c.any_en, c.any_nn, c.white_ee, c.white_en, c.white_nn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c.slow_ee, c.slow_en, c.slow_nn, c.held_ee, c.held_en, c.held_nn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c.age = epoch.vehicles[v].since_rtk
    for r in range(coupling.extra.shape[1]):
        start, extra = starts[v, LATEST, r], coupling.extra[v, r]
        extra.first, extra.second = start.bias_first, start.bias_second


@jit
def on_axis(ee: float, en: float, nn: float, s: float, c: float) -> float:
    """Variance on the axis (s, c) of East and North."""
    return max(s * s * ee + 2.0 * s * c * en + c * c * nn, 0.0)


@jit
def rotated(a: Array, ee: float, en: float, nn: float) -> tuple[float, float, float]:
    """``A P A'`` of a covariance EE, EN, NN; a (2, 2)."""
    p, q = a[0, 0] * ee + a[0, 1] * en, a[0, 0] * en + a[0, 1] * nn
    r, s = a[1, 0] * ee + a[1, 1] * en, a[1, 0] * en + a[1, 1] * nn
    return p * a[0, 0] + q * a[0, 1], p * a[1, 0] + q * a[1, 1], r * a[1, 0] + s * a[1, 1]


@jit
def shares_of(one: float, other: float) -> tuple[float, float]:
    """Factors on two covariances of these traces whose sum bounds that of x + y, whatever their correlation."""
    if not (one > 0.0 and other > 0.0):
        return 1.0, 1.0
    t = math.sqrt(other / one)
    return 1.0 + t, 1.0 + 1.0 / t


@jit
def cost_of(
    v: int, epoch: Epoch, coupling: Coupling, a: Array, fast: Array, slow: Array, extra: Array, moved: bool
) -> float:
    """Sum of the squared bounds along and across of the operative case, with fast errors as a white one.

    a (2, 2); fast, slow (3,) of the share of the ranges; extra (2,) along and across [m]. Nothing of the measurements
    enters but separations. ``moved`` False: the position reckoned on by itself.
    """
    w, g, c, e = epoch.work[v], epoch.vehicles[v].growth[LATEST], coupling.coupled[v], coupling.extra[v, 0]
    start = epoch.starts[v, LATEST, 0]
    k, white, cost = epoch.tables.cases[0].k_dead, coupling.rules[0].white, 0.0
    _, _, b_at, b_ct = sigma_and_bias(w.sin_h, w.cos_h, False, g)
    for q in range(2):
        s, n = (w.sin_h, w.cos_h) if q == 0 else (w.cos_h, -w.sin_h)
        x, y = (s * a[0, 0] + n * a[1, 0], s * a[0, 1] + n * a[1, 1]) if moved else (s, n)
        variance = on_axis(g.p_ee - c.held_ee, g.p_en - c.held_en, g.p_nn - c.held_nn, x, y)
        variance += on_axis(c.white_ee, c.white_en, c.white_nn, x, y)
        lasting = math.sqrt(on_axis(c.slow_ee, c.slow_en, c.slow_nn, x, y))
        first, second = along_axes(x, y, start)
        bound = (b_at if q == 0 else b_ct) * math.hypot(x, y) + abs(first) * e.first + abs(second) * e.second
        if moved:
            variance += white * on_axis(fast[0], fast[1], fast[2], s, n)
            lasting += math.sqrt(on_axis(slow[0], slow[1], slow[2], s, n))
            bound += extra[q]
        cost += (k[q] * math.sqrt(variance + lasting * lasting) + bound) ** 2
    return cost


@jit
def propose(v: int, epoch: Epoch, service_cases: Any, coupling: Coupling, a: Array, part: Part, levels: Array) -> None:
    """The coupled position's growth, starts and separations, and its levels (R, 2) [m]; ``part`` holds its share."""
    rules, faults = coupling.rules[0], epoch.faults[v]
    vehicle, w, g = epoch.vehicles[v], epoch.work[v], coupling.proposals[v].growth
    c, after = coupling.coupled[v], coupling.proposals[v].after
    coupling.proposals[v].kind, coupling.proposals[v].by_doppler = WITH_RECKONED, w.mode == DOPPLER
    coupling.proposals[v].separated = vehicle.separated
    coupling.proposals[v].growth = vehicle.growth[LATEST]
    separations = coupling.separations[v]
    for k in range(faults.shape[0]):
        separations[k] = faults[k].latest
    transform(a, g, separations)
    after.active, after.since, after.age = True, 0.0, c.age
    old = rotated(a, c.any_ee, c.any_en, c.any_nn)
    one, other = shares_of(old[0] + old[2], part.fast[0] + part.fast[2])
    after.any_ee, after.any_en = one * old[0] + other * part.fast[0], one * old[1] + other * part.fast[1]
    after.any_nn = one * old[2] + other * part.fast[2]
    old = rotated(a, c.white_ee, c.white_en, c.white_nn)
    after.white_ee, after.white_en = old[0] + rules.white * part.fast[0], old[1] + rules.white * part.fast[1]
    after.white_nn = old[2] + rules.white * part.fast[2]
    old = rotated(a, c.slow_ee, c.slow_en, c.slow_nn)
    one, other = shares_of(old[0] + old[2], part.slow[0] + part.slow[2])
    after.slow_ee, after.slow_en = one * old[0] + other * part.slow[0], one * old[1] + other * part.slow[1]
    after.slow_nn = one * old[2] + other * part.slow[2]
    after.held_ee, after.held_en, after.held_nn = after.white_ee, after.white_en, after.white_nn
    if after.any_ee + after.any_nn < after.white_ee + after.white_nn:
        after.held_ee, after.held_en, after.held_nn = after.any_ee, after.any_en, after.any_nn
    after.held_ee += after.slow_ee
    after.held_en += after.slow_en
    after.held_nn += after.slow_nn
    p = vehicle.growth[LATEST]
    old = rotated(a, p.p_ee - c.held_ee, p.p_en - c.held_en, p.p_nn - c.held_nn)
    g.p_ee, g.p_en, g.p_nn = old[0] + after.held_ee, old[1] + after.held_en, old[2] + after.held_nn
    for r in range(levels.shape[0]):
        start_levels(v, r, epoch, service_cases, coupling, a, part)
    risk = epoch.parameters[0].risk
    levels_since_fix(g, coupling.starts[v], separations, epoch.tables, risk, w.sin_h, w.cos_h, w.later, levels)


@jit
def start_levels(v: int, r: int, epoch: Epoch, service_cases: Any, coupling: Coupling, a: Array, part: Part) -> None:
    """What the coupled position leaves to case r: bounds in addition to K sigma, and of its whole code error.

    The risk of code faults is that of the service. K sigma has the rest: K of the whole risk is raised by a bound. The
    axes of the bounds follow the heading when it has turned by more than TURNED.
    """
    case, w, after = epoch.tables.cases[r], epoch.work[v], coupling.proposals[v].after
    start, before, e = coupling.starts[v, r], epoch.starts[v, LATEST, r], coupling.extra_after[v, r]
    old, m = coupling.extra[v, r], np.empty((2, 2))
    if not part.extra[r, 0] + part.extra[r, 1] + old.first + old.second < math.inf:
        e.first, e.second, start.whole_first = math.inf, math.inf, math.inf
        return
    start.axis_e, start.axis_n = before.axis_e, before.axis_n
    if abs(along_axes(w.sin_h, w.cos_h, before)[1]) > TURNED or before.axis_e == before.axis_n == 0.0:
        start.axis_e, start.axis_n = w.sin_h, w.cos_h
    between_axes(a, before, start, m)
    t_first, t_second = along_axes(w.sin_h, w.cos_h, start)
    c_first, c_second = along_axes(w.cos_h, -w.sin_h, start)
    at, ct = part.extra[r, 0], part.extra[r, 1]
    e.first = abs(m[0, 0]) * old.first + abs(m[0, 1]) * old.second + abs(t_first) * at + abs(c_first) * ct
    e.second = abs(m[1, 0]) * old.first + abs(m[1, 1]) * old.second + abs(t_second) * at + abs(c_second) * ct
    start.bias_first, start.bias_second, start.whole_first, start.whole_second = 0.0, 0.0, 0.0, 0.0
    if case.published:
        return
    fast, slow, raised, whole = part.fast, part.slow, np.empty(2), np.empty(2)
    for q in range(2):
        s, n = (w.sin_h, w.cos_h) if q == 0 else (w.cos_h, -w.sin_h)
        k = q_inverse(0.5 * (case.budget[q] - service_cases[r].budget[q]))
        held = math.sqrt(on_axis(after.held_ee, after.held_en, after.held_nn, s, n))
        raised[q] = max(k - case.k_dead[q], 0.0) * held
        own = math.sqrt(on_axis(fast[0], fast[1], fast[2], s, n)) + math.sqrt(on_axis(slow[0], slow[1], slow[2], s, n))
        whole[q] = k * own + part.extra[r, q]
    start.bias_first = e.first + abs(t_first) * raised[0] + abs(c_first) * raised[1]
    start.bias_second = e.second + abs(t_second) * raised[0] + abs(c_second) * raised[1]
    start.whole_first = abs(m[0, 0]) * before.whole_first + abs(m[0, 1]) * before.whole_second
    start.whole_second = abs(m[1, 0]) * before.whole_first + abs(m[1, 1]) * before.whole_second
    start.whole_first += abs(t_first) * whole[0] + abs(c_first) * whole[1]
    start.whole_second += abs(t_second) * whole[0] + abs(c_second) * whole[1]


@jit
def between_axes(a: Array, old: Any, new: Any, m: Array) -> None:
    """``F_new A F_old'`` (2, 2), F with the axes of a start as rows."""
    m[0, 0], m[1, 0] = along_axes(
        a[0, 0] * old.axis_e + a[0, 1] * old.axis_n, a[1, 0] * old.axis_e + a[1, 1] * old.axis_n, new
    )
    m[0, 1], m[1, 1] = along_axes(
        a[0, 1] * old.axis_e - a[0, 0] * old.axis_n, a[1, 1] * old.axis_e - a[1, 0] * old.axis_n, new
    )


@jit
def transform(a: Array, g: Any, separations: Records) -> None:
    """Apply A (2, 2) to all parts of the position error in dead reckoning but its covariance."""
    xx, xy, yx, yy = a[0, 0], a[0, 1], a[1, 0], a[1, 1]
    size = math.sqrt(xx * xx + xy * xy + yx * yx + yy * yy) if xy != 0.0 or yx != 0.0 or xx != yy else abs(xx)
    g.ne_e, g.nn_e = xx * g.ne_e + xy * g.nn_e, yx * g.ne_e + yy * g.nn_e
    g.ne_n, g.nn_n = xx * g.ne_n + xy * g.nn_n, yx * g.ne_n + yy * g.nn_n
    g.od_e, g.od_n = xx * g.od_e + xy * g.od_n, yx * g.od_e + yy * g.od_n
    g.th_e, g.th_n = xx * g.th_e + xy * g.th_n, yx * g.th_e + yy * g.th_n
    g.gb_e, g.gb_n = xx * g.gb_e + xy * g.gb_n, yx * g.gb_e + yy * g.gb_n
    g.gs_e, g.gs_n = xx * g.gs_e + xy * g.gs_n, yx * g.gs_e + yy * g.gs_n
    g.cth_e, g.cth_n = xx * g.cth_e + xy * g.cth_n, yx * g.cth_e + yy * g.cth_n
    g.cv_e, g.cv_n = xx * g.cv_e + xy * g.cv_n, yx * g.cv_e + yy * g.cv_n
    g.axle_e, g.axle_n = xx * g.axle_e + xy * g.axle_n, yx * g.axle_e + yy * g.axle_n
    g.box_e, g.box_n = abs(xx) * g.box_e + abs(xy) * g.box_n, abs(yx) * g.box_e + abs(yy) * g.box_n
    g.run_e, g.run_n = abs(xx) * g.run_e + abs(xy) * g.run_n, abs(yx) * g.run_e + abs(yy) * g.run_n
    e, n = g.bow_ss_e, g.bow_ss_n
    g.bow_ss_e, g.bow_ss_n = abs(xx) * e + abs(xy) * n, abs(yx) * e + abs(yy) * n
    e, n = g.bow_sb_e, g.bow_sb_n
    g.bow_sb_e, g.bow_sb_n = abs(xx) * e + abs(xy) * n, abs(yx) * e + abs(yy) * n
    e, n = g.bow_bb_e, g.bow_bb_n
    g.bow_bb_e, g.bow_bb_n = abs(xx) * e + abs(xy) * n, abs(yx) * e + abs(yy) * n
    g.fh_e, g.fh_n = xx * g.fh_e + xy * g.fh_n, yx * g.fh_e + yy * g.fh_n
    g.fb_e, g.fb_n = xx * g.fb_e + xy * g.fb_n, yx * g.fb_e + yy * g.fb_n
    g.fs_e, g.fs_n = xx * g.fs_e + xy * g.fs_n, yx * g.fs_e + yy * g.fs_n
    g.f_ee, g.f_en, g.f_nn = rotated(a, g.f_ee, g.f_en, g.f_nn)
    g.l_s, g.apart_s = size * g.l_s, size * g.apart_s
    for k in range(separations.shape[0]):
        s = separations[k]
        s.d_e, s.d_n = xx * s.d_e + xy * s.d_n, yx * s.d_e + yy * s.d_n
        s.ne_e, s.nn_e = xx * s.ne_e + xy * s.nn_e, yx * s.ne_e + yy * s.nn_e
        s.ne_n, s.nn_n = xx * s.ne_n + xy * s.nn_n, yx * s.ne_n + yy * s.nn_n
        s.s_ee, s.s_en, s.s_nn = rotated(a, s.s_ee, s.s_en, s.s_nn)


@jit
def fault_bound(
    count: int, prior: Array, separation: Array, sigma: Array, risk: float, gone: float, memory: float
) -> float:
    """``X + D`` [m] on one axis: what faults in the ranges of an epoch do to the position, at a risk.

    count : fault modes; prior, separation, sigma : (>= count,) of each, and 1 sigma of its separation [m]
    risk : of the axis; half is for the modes, half for what they do not cover
    gone : probability of faults that no mode covers [-], ``memory`` times as large for the time that they stay
    """
    if not memory * gone <= 0.5 * risk:
        return math.inf
    of_modes, most, tails = 0.5 * risk, 0.0, 0.0
    for i in range(count):
        p = prior[i]
        if p <= 0.0:
            continue
        share = MODE_SHARE * of_modes / (count * p)
        k = q_inverse(share) if share < 0.5 else 0.0
        most = max(most, abs(separation[i]) + k * sigma[i])
        tail = INV_SQRT_2PI * math.exp(-0.5 * k * k) - 0.5 * k * math.erfc(k / math.sqrt(2.0))
        tails += 2.0 * p * sigma[i] * max(tail, 0.0)
    return most + tails / of_modes
