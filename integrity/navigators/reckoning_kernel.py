"""Dead reckoning since an RTK position, by Doppler or by wheels and gyro, and the witness beside it.

Two reckonings go side by side, each a layer of ``growth``, ``start`` and ``apart``: since the last RTK position, and
that of the witness, who does not listen to RTK and begins anew every ``witness_s`` seconds.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import (
    CV_E,
    CV_N,
    levels,
    reset,
    sigma_and_bias,
    step_doppler,
    step_odometer,
    step_still,
)
from lanebound.integrity.monitoring.doppler_separation_kernel import STATE, U_E, exposure, factors, worst
from lanebound.integrity.monitoring.jump_kernel import along_across, contradicts
from lanebound.integrity.navigators import navigator_columns_kernel as col
from lanebound.integrity.positioning.mode_kernel import DOPPLER, NONE


class Reckoning(NamedTuple):
    """What has come to an RTK position: the growth of its errors, what it left, the separations by satellite faults.

    The columns of ``growth`` are those of :mod:`.dead_reckoning_pl_kernel`, those of ``start`` (R, 4) are in
    :mod:`.navigator_columns_kernel`, the rows of ``apart`` in :mod:`.doppler_separation_kernel`.
    """

    growth: Any
    start: Any
    apart: Any


class Terms(NamedTuple):
    """What levels go by: system (S,) and prior of satellites, factors k_dead (R, 4) and published (R,) of the cases.

    ``shift`` bounds the horizontal length of the error that the reference gave to the RTK position [m], ``split`` is
    the share of the risk along the track, and ``multiple`` whether two faults at once count.
    """

    system: Any
    prior: Any
    k_dead: Any
    published: Any
    shift: Any
    split: Any
    multiple: Any


@jit
def advance(x, growth, par, mode, v_e, v_n, q, v_ss, middle, carry, resting):  # type: ignore[no-untyped-def]
    """Carry the position, the witness's, and the errors of both over the epoch by Doppler or by dead reckoning.

    At rest the position stays; the bound grows by what the odometer may not show.
    """
    dt, variance = par[col.DT], x[col.P_HH]
    phi_d, phi_o = math.exp(-dt / par[col.DOP_TAU]), math.exp(-dt / par[col.ODO_TAU])
    if resting or mode == NONE:
        for g in growth:
            step_still(phi_d, phi_o, variance, carry, g)
            g[CV_E] += dt * par[col.STILL_SPEED] * math.sin(x[col.HEADING])
            g[CV_N] += dt * par[col.STILL_SPEED] * math.cos(x[col.HEADING])
        return
    if mode == DOPPLER:
        before_e, before_n = (x[col.VEL_E], x[col.VEL_N]) if x[col.HAS_VEL] > 0.0 else (v_e, v_n)
        _move(x, 0.5 * dt * (before_e + v_e), 0.5 * dt * (before_n + v_n))
        for g in growth:
            step_doppler(dt, q[0, 0], q[0, 1], q[1, 1], par[col.DOP_BIAS], phi_d, phi_o, variance, carry, False, g)
        return
    s, c = math.sin(middle), math.cos(middle)
    _move(x, dt * v_ss * s, dt * v_ss * c)
    b_theta = heading_bias(x, par)
    bias = par[col.ODO_BIAS] + par[col.ODO_SCALE] * abs(v_ss)
    for g in growth:
        step_odometer(dt, v_ss, s, c, par[col.ODO_SIGMA], bias, b_theta, phi_d, phi_o, variance, carry, False, g)


@jit
def _move(x, east, north):  # type: ignore[no-untyped-def]
    x[col.EAST] += east
    x[col.NORTH] += north
    x[col.WITNESS_E] += east
    x[col.WITNESS_N] += north


@jit
def heading_bias(x, par):  # type: ignore[no-untyped-def]
    """Bound on what no filter knows of the heading's error [rad]; before the first calibration nothing is known."""
    if not x[col.SINCE_CAL] < math.inf:
        return math.pi
    return min(par[col.HEADING_BIAS] + par[col.HEADING_DRIFT] * x[col.SINCE_CAL], math.pi)


@jit
def later_by(since, par):  # type: ignore[no-untyped-def]
    """By how much faults are likelier than at one moment, since some time [s] ago."""
    return 1.0 + since / par[col.FAULT_DURATION] if since < math.inf else 1.0


@jit
def levels_dead_reckoning(reckoning, terms, sin_h, cos_h, later, pl):  # type: ignore[no-untyped-def]
    """``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19) of every case, into pl (R, 2) [m].

    Exact levels also bound each single satellite fault in the Doppler velocities since the fix, by the separation that
    it has caused (:mod:`.doppler_separation_kernel`). ``later`` >= 1 raises the priors by the faults that began since.
    Of the error that the reference gave to the RTK position exact levels take the bound on each axis, published ones
    equal components on E and N.
    """
    growth, start, k_dead = reckoning.growth, reckoning.start, terms.k_dead
    total, squares, lost = exposure(terms.system, terms.prior, reckoning.apart)
    total, squares, lost = later * total, later * later * squares, later * lost
    pair = 0.5 * (total * total - squares) if terms.multiple else 0.0
    axis_sine, axis_cosine = (sin_h, cos_h), (cos_h, -sin_h)
    sigma_bias = sigma_and_bias(sin_h, cos_h, False, growth)
    for r in range(k_dead.shape[0]):
        if not start[r, col.WHOLE_E] < math.inf:
            pl[r] = math.inf
            continue
        if terms.published[r]:
            levels(sin_h, cos_h, k_dead[r : r + 1], True, growth, pl[r : r + 1])
            pl[r] += terms.shift / math.sqrt(2.0)
            continue
        for q in range(2):
            sine, cosine, share = axis_sine[q], axis_cosine[q], terms.split if q == 0 else 1.0 - terms.split
            k_0, k_f = k_dead[r, q], -math.inf
            if total > 0.0:
                k_0, k_f = factors(k_dead[r, col.RISK_AT + q], share, pair, total, lost)
            level = k_0 * sigma_bias[q] + abs(sine) * start[r, col.START_E] + abs(cosine) * start[r, col.START_N]
            if -math.inf < k_f < math.inf:
                whole = abs(sine) * start[r, col.WHOLE_E] + abs(cosine) * start[r, col.WHOLE_N]
                level = max(level, worst(sine, cosine, sigma_bias[q], k_f, reckoning.apart) + whole)
            pl[r, q] = level + sigma_bias[2 + q] + terms.shift


@jit
def restart(reckoning, terms, x, level, head, sin_h, cos_h):  # type: ignore[no-untyped-def]
    """Start dead reckoning anew from the RTK position just found, for every case.

    Its initial error must keep what the protection level promised, biases and faults included: what the ``level``
    (R, 2) of a case holds beyond ``K sigma`` of the fault-free solution stays on as a bound on E and N. The published
    form starts from the fault-free covariance alone, as S1 does.
    """
    start, k_dead = reckoning.start, terms.k_dead
    reset(head.p_ee, head.p_en, head.p_nn, 0.0, 0.0, x[col.P_HH], reckoning.growth)
    if x[col.APART] > 0.0:
        reckoning.apart[:U_E] = 0.0
        reckoning.apart[STATE] = 0.0
        x[col.APART] = 0.0
    for r in range(level.shape[0]):
        start[r] = 0.0
        if not (level[r, 0] < math.inf and level[r, 1] < math.inf):
            start[r, col.WHOLE_E] = math.inf
        elif not terms.published[r]:
            at, ct = max(level[r, 0] - terms.shift, 0.0), max(level[r, 1] - terms.shift, 0.0)
            start[r, col.WHOLE_E], start[r, col.WHOLE_N] = _box(at, ct, sin_h, cos_h)
            at = max(at - k_dead[r, col.K_AT] * head.sigma[0], 0.0)
            ct = max(ct - k_dead[r, col.K_CT] * head.sigma[1], 0.0)
            start[r, col.START_E], start[r, col.START_N] = _box(at, ct, sin_h, cos_h)


@jit
def _box(at, ct, sin_h, cos_h):  # type: ignore[no-untyped-def]
    """Bounds on E and N of what is bounded along and across the track."""
    return abs(sin_h) * at + abs(cos_h) * ct, abs(cos_h) * at + abs(sin_h) * ct


@jit
def hear_witness(x, par, latest, witness, terms, east, north, sin_h, cos_h, found, pl):  # type: ignore[no-untyped-def]
    """Where the witness contradicts an RTK position that lasts, go back to the one that he began at, and on with him.

    ``found`` (R, 2) are the levels of RTK; ``pl`` (R, 2) become those of the witness, if he is believed [m].
    """
    east, north = east - x[col.WITNESS_E], north - x[col.WITNESS_N]
    at, ct = along_across(east, north, sin_h, cos_h)
    if not (x[col.WITNESS_S] < math.inf and x[col.SINCE_CAL] < math.inf and (at > found[0, 0] or ct > found[0, 1])):
        return
    his = np.empty_like(pl)
    levels_dead_reckoning(witness, terms, sin_h, cos_h, later_by(x[col.WITNESS_S], par), his)
    if contradicts(east, north, sin_h, cos_h, his[0], found[0]):
        x[col.EAST], x[col.NORTH], x[col.SINCE_RTK] = x[col.WITNESS_E], x[col.WITNESS_N], x[col.WITNESS_S]
        x[col.APART], pl[:] = 1.0, his
        _copy(witness, latest)


@jit
def call_witness(x, latest, witness):  # type: ignore[no-untyped-def]
    """A new witness begins at the RTK position just found."""
    x[col.WITNESS_E], x[col.WITNESS_N], x[col.WITNESS_S] = x[col.EAST], x[col.NORTH], 0.0
    _copy(latest, witness)


@jit
def _copy(source, to):  # type: ignore[no-untyped-def]
    to.growth[:], to.start[:], to.apart[:] = source.growth, source.start, source.apart
