"""One navigation epoch of one vehicle: the flow chart of S1 figure 1, stage by stage.

``x`` (NX,) is the vehicle's state, ``out`` (NO,) its solution and ``par`` (NP,) the declared figures, all flat with the
columns of :mod:`.navigator_columns_kernel`. Everything here is belief: the measurements are the only inputs.
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.small_matrix_kernel import hdop_of
from lanebound.integrity.monitoring.alerts_kernel import alert_step
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import P_EE as G_EE
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import P_EN as G_EN
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import P_NN as G_NN
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import remember_velocity, sigma_and_bias
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED as FDE_EXCLUDED
from lanebound.integrity.monitoring.detection_kernel import NO_REDUNDANCY as FDE_NO_REDUNDANCY
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    AFFORDABLE,
    advance_separations,
    separate_velocity,
    share_epoch,
)
from lanebound.integrity.monitoring.jump_kernel import (
    ACCEPTED,
    QUARANTINED,
    REFUSED,
    bounded,
    in_doubt,
    judge_jump,
    pass_time,
    suspects_signals,
    widen,
)
from lanebound.integrity.monitoring.protection_kernel import (
    closed_form,
    closed_form_published,
    multi_hypothesis_pl,
    pair_risk,
    split_budgets,
)
from lanebound.integrity.monitoring.separation_kernel import find_modes, set_priors
from lanebound.integrity.navigators import navigator_columns_kernel as col
from lanebound.integrity.navigators.reckoning_kernel import (
    Reckoning,
    Terms,
    advance,
    call_witness,
    heading_bias,
    hear_witness,
    later_by,
    levels_dead_reckoning,
    restart,
)
from lanebound.integrity.navigators.rtk_stage_kernel import (
    FAULT,
    FIXED,
    Signals,
    Tables,
    fixed_scratch,
    rtk,
    select,
    test,
    weigh,
)
from lanebound.integrity.positioning.heading_kernel import (
    correct,
    doppler_heading_usable,
    doppler_heading_variance,
    predict_heading,
    wrap,
)
from lanebound.integrity.positioning.mode_kernel import DOPPLER, NONE, RTK, bridge_mode, doppler_usable, rtk_usable
from lanebound.integrity.positioning.odometer_watch_kernel import DOUBT as WATCH_DOUBT
from lanebound.integrity.positioning.odometer_watch_kernel import turning_at_rest, watch_odometer
from lanebound.integrity.positioning.resolve_kernel import Fixes
from lanebound.integrity.positioning.rtk_kernel import held_risk
from lanebound.integrity.positioning.slip_watch_kernel import Motion

MOVING_MPS = 0.5  # slower, nothing is told of side slip
REACQUIRE_S = 1.0  # of Doppler courses refused for their jump, before the heading filter opens up
CONFLICT_LIMIT_S = 0.5  # of contradiction between Doppler and odometer
TEST_FAILED_CAUSE, INITIALISING_CAUSE = 5, 7  # codes of AlertReason


@jit
def attitude(x, par, delta_theta):  # type: ignore[no-untyped-def]
    """Advance the heading by the gyro; at rest hold it and learn the gyro bias instead (ZUPT, S1 figure 1).

    Returns the mean heading over the epoch [rad].
    """
    dt = par[col.DT]
    p = x[col.P_HH : col.P_BB + 1]
    before = x[col.HEADING]
    if x[col.REST_S] > 0.5:
        rate = delta_theta / dt
        x[col.HEADING], x[col.GYRO_BIAS] = correct(
            before, x[col.GYRO_BIAS], p, rate - x[col.GYRO_BIAS], 0.0, 1.0, par[col.ARW] ** 2 / dt
        )
        return x[col.HEADING]
    x[col.HEADING] = predict_heading(before, x[col.GYRO_BIAS], p, delta_theta, dt, par[col.ARW], par[col.BIAS_WALK])
    return wrap(before + 0.5 * wrap(x[col.HEADING] - before))


@jit
def side_slip(axle, turning, v_ss):  # type: ignore[no-untyped-def]
    """Angle from the heading to the way of the reference point, ``axle`` [m] ahead of the rear axle, in a turn [rad].

    The rear axle goes where the car points, so that the point moves sideways at ``axle`` times the yaw rate.
    """
    sine = axle * turning / v_ss if abs(v_ss) > MOVING_MPS else 0.0
    return math.asin(min(max(sine, -1.0), 1.0))


@jit
def calibrate(x, par, limits, v_e, v_n, q_ee, q_en, q_nn, v_ss, slip, hdop):  # type: ignore[no-untyped-def]
    """Calibrate heading and gyro bias by the Doppler course where S1 table 1 allows it; True when done.

    ``slip`` is by how much the course differs from the heading in a turn, see :func:`side_slip`.
    The jump limit is widened to 3 sigma while the filter itself is less certain than the limit. A course refused for
    REACQUIRE_S for its jump alone means that the filter is wrong, not the course: it opens up to learn anew.
    """
    speed = math.hypot(v_e, v_n)
    if not speed > 0.0:
        return False
    course = math.atan2(v_e, v_n) if v_ss >= 0.0 else math.atan2(-v_e, -v_n)
    jump = wrap(course - slip - x[col.HEADING])
    allowed = max(limits[3], 3.0 * math.sqrt(x[col.P_HH]))
    if not doppler_heading_usable(speed, v_ss, hdop, 0.0, limits):
        return False
    variance = doppler_heading_variance(v_e, v_n, q_ee, q_en, q_nn)
    if abs(jump) >= allowed:
        x[col.REFUSED_S] = x[col.REFUSED_S] + par[col.DT] if abs(jump) > allowed + 3.0 * math.sqrt(variance) else 0.0
        if x[col.REFUSED_S] > REACQUIRE_S:
            x[col.P_HH], x[col.P_HB], x[col.P_BB] = max(x[col.P_HH], jump * jump), 0.0, par[col.BIAS_INITIAL] ** 2
        return False
    x[col.REFUSED_S] = 0.0
    variance *= max(1.0, 2.0 * par[col.DOP_TAU] / par[col.DT])
    p = x[col.P_HH : col.P_BB + 1]
    x[col.HEADING], x[col.GYRO_BIAS] = correct(x[col.HEADING], x[col.GYRO_BIAS], p, jump, 1.0, 0.0, variance)
    return True


@jit
def velocity(e, quality, tracked, cn0, range_rate, par, tables, drift_group, used, variance, v, q):  # type: ignore[no-untyped-def]
    """Velocity and clock drift by least squares of the range rates, with fault detection and exclusion (df = m - 4).

    Fills v (3,) [m/s], q (3,3) and ``used``; returns the outcome code, satellites used, excluded, and HDOP.
    """
    select(e, tracked, cn0, quality, par[col.DOP_SIN_MASK], par[col.DOP_CN0_MIN], variance, used)
    for s in range(used.shape[0]):
        variance[s] *= par[col.DOP_SIGMA] ** 2
    outcome, excluded = test(e, drift_group, variance, range_rate, used, tables, v, q)
    n = 0
    for s in range(used.shape[0]):
        n += used[s]
    return outcome, n, excluded, hdop_of(e, drift_group, used)


@jit
def watch_speeds(x, par, solved, v_gnss, v_ss, hdop, limits, agreement, delta_v, rate):  # type: ignore[no-untyped-def]
    """An odometer in doubt, or contradicted by a tested Doppler speed for CONFLICT_LIMIT_S: no level holds without RTK.

    Where Doppler contradicts, one of them lies. ``limits`` are those of the heading, ``agreement`` [m/s] that of the
    Doppler mode, ``delta_v`` (3,) the increments of velocity forward and to the right [m/s].
    """
    dt = par[col.DT]
    conflict = solved and hdop < limits[2] and abs(v_gnss - abs(v_ss)) > limits[1]
    x[col.CONFLICT_S] = x[col.CONFLICT_S] + dt if conflict else 0.0
    agrees = solved and hdop < limits[2] and abs(v_gnss - abs(v_ss)) < agreement
    if watch_odometer(
        x[col.WATCH:col.NX], par[col.WATCH_LIMITS:col.NP], dt, v_ss, delta_v[0], delta_v[1], rate,
        x[col.CONFLICT_S] > CONFLICT_LIMIT_S, agrees,
    ):  # fmt: skip
        x[col.UNBOUNDED] = 1.0


@jit
def standstill(x, dt, v_ss, turning, solved, v_gnss, q):  # type: ignore[no-untyped-def]
    """Count how long the vehicle has been at rest: no pulse, no turn, and no Doppler speed beyond its noise."""
    at_rest = abs(v_ss) < 0.02 and not turning and not x[col.WATCH + WATCH_DOUBT] > 0.0
    at_rest = at_rest and not (solved and v_gnss > max(0.1, 3.0 * math.sqrt(q[0, 0] + q[1, 1])))
    x[col.REST_S] = x[col.REST_S] + dt if at_rest else 0.0
    return x[col.REST_S] > 0.5


@jit
def levels_rtk(  # type: ignore[no-untyped-def]
    n, fixed, sin_h, cos_h, risks, shares, spent, priors, k_fa, k_published, reference_bias, pl,
):  # fmt: skip
    """Protection levels of the fixed position: cases of the root, of the closed form, and of the published form.

    risks (3, R) holds the risk of each case in the row of its form, 0 elsewhere; ``reference_bias`` [m] bounds the
    common shift
    of a wrong reference, which every mode shares. Published: ``b_E = b_N`` of that length, so ``B = b / sqrt 2``.
    """
    rows, group, geo, moments, modes = fixed.rows, fixed.group, fixed.geo, fixed.moments, fixed.modes
    count_cases = risks.shape[1]
    one, budget, found = np.empty(1), np.empty((1, 2)), np.empty((1, 2))
    constellations, split, share0, multiple, tolerate = (
        shares[0] > 0.0,
        shares[1],
        shares[2],
        shares[3] > 0.0,
        shares[4] > 0.0,
    )
    n_modes, lost = 0, 0.0
    for form in range(3):
        filled = False
        for r in range(count_cases):
            if risks[form, r] <= 0.0:
                continue
            if not filled:
                n_modes = find_modes(group, rows[3], n, sin_h, cos_h, constellations, form == 2, geo, moments, modes)
                lost = set_priors(group, n, n_modes, priors[0], priors[1], geo.clocks, modes)
                filled = True
            if form == 2:
                one[0] = k_published[r]
                closed_form_published(n_modes, k_fa[1, n_modes - 1], one, modes, found)
                shift = reference_bias / math.sqrt(2.0)
            else:
                one[0] = risks[form, r]
                spent_here = spent + (pair_risk(n_modes, modes.prior) if multiple else 0.0)
                split_budgets(one, split, spent_here, budget)
                if form == 0:
                    multi_hypothesis_pl(n_modes, k_fa[0, n_modes - 1], budget, lost, tolerate, modes, found)
                else:
                    closed_form(n_modes, k_fa[0, n_modes - 1], budget, share0, lost, tolerate, modes, found)
                shift = reference_bias
            pl[r, 0], pl[r, 1] = found[0, 0] + shift, found[0, 1] + shift


@jit
def reference_point(head, par, sin_h, cos_h):  # type: ignore[no-untyped-def]
    """East and North of the vehicle, of whose antenna ``head`` tells [m]."""
    forward, right = par[col.LEVER_FORWARD], par[col.LEVER_RIGHT]
    x = head.position
    return x[0] - sin_h * forward - cos_h * right, x[1] - cos_h * forward + sin_h * right


@jit
def reference_velocity(antenna, par, turning, sin_h, cos_h):  # type: ignore[no-untyped-def]
    """East and North velocity of the vehicle, from that of its ``antenna`` [m/s] and its yaw rate [rad/s]."""
    forward, right = par[col.LEVER_FORWARD], par[col.LEVER_RIGHT]
    return (
        antenna[0] - turning * (cos_h * forward - sin_h * right),
        antenna[1] + turning * (sin_h * forward + cos_h * right),
    )


@jit
def lever_bounds(x, par):  # type: ignore[no-untyped-def]
    """Bounds on what a wrong heading does to the reference point, told from the antenna, along and across [m].

    A lever (f, r) turned by theta moves ``f (cos theta - 1) - r sin theta`` along, ``f sin theta + r (cos theta - 1)``
    across, and by twice its length at most.
    """
    theta = min(par[col.LEVER_K] * math.sqrt(x[col.P_HH]) + heading_bias(x, par), math.pi)
    f, r = abs(par[col.LEVER_FORWARD]), abs(par[col.LEVER_RIGHT])
    most, turned = 2.0 * math.hypot(f, r), 0.5 * theta * theta
    return min(r * theta + f * turned, most), min(f * theta + r * turned, most)


@jit
def judge_rtk(x, par, east, north, sin_h, cos_h, expected, found, lasting):  # type: ignore[no-untyped-def]
    """ACCEPTED, REFUSED or QUARANTINED: a confirmed RTK position beside the one expected; levels of both (R, 2) [m].

    One without a level is not taken in place of one that has one.
    """
    if bounded(expected[0]) and not bounded(found[0]):
        return QUARANTINED
    if not x[col.INITIALISED] > 0.0:
        return ACCEPTED
    return judge_jump(
        east - x[col.EAST], north - x[col.NORTH], sin_h, cos_h, expected[0], found[0], lasting,
        x[col.CONFLICT_S] > CONFLICT_LIMIT_S, (par[col.AFTER_JUMP], par[col.AFTER_OUTAGE]), x[col.DOUBT:col.WATCH],
    )  # fmt: skip


@jit
def take_rtk(  # type: ignore[no-untyped-def]
    x, par, latest, witness, terms, east, north, head, sin_h, cos_h, lasting, level
):
    """The position is the one of RTK, of the ``level`` (R, 2) [m]; what reckons since then begins anew."""
    x[col.EAST], x[col.NORTH], x[col.UP] = east, north, head.position[2]
    x[col.SINCE_RTK], x[col.INITIALISED], x[col.UNBOUNDED] = 0.0, 1.0, 0.0
    restart(latest, terms, x, level, head, sin_h, cos_h)
    if not (lasting and x[col.WITNESS_S] < par[col.WITNESS_MOST_S]):
        call_witness(x, latest, witness)


@jit
def _epoch(  # type: ignore[no-untyped-def]
    e, system, tracked, cn0, code, phase, range_rate, lock_lost, age,
    delta_theta, delta_v, v_ss,
    par, tables, mode_limits, heading_limits, risks, shares, spent,
    priors, k_fa, k_published, k_dead, published, operative_published, alert_limits, drift_group,
    x, rtk_x, last_phase, growth, start, apart, held, integers, fix_id, fix_risk, v, alert, reason, onset, clear,
    fixed, found, out, pl, covariance,
):  # fmt: skip
    """The whole epoch of vehicle v; x to fix_risk and the alert arrays are its state."""
    dt, n_sat, doubt = par[col.DT], e.shape[0], x[col.DOUBT : col.WATCH]
    latest = Reckoning(growth[col.LATEST], start[col.LATEST], apart[col.LATEST])
    witness = Reckoning(growth[col.WITNESS], start[col.WITNESS], apart[col.WITNESS])
    terms = Terms(system, priors[0], k_dead, published, par[col.REFERENCE_BIAS], shares[1], shares[3] > 0.0)
    pl[:] = math.inf
    pass_time(dt, doubt)
    suspect = suspects_signals(doubt)
    x[col.SINCE_RTK] += dt
    x[col.SINCE_CAL] += dt
    x[col.WITNESS_S] += dt

    used, velocity_enu, q_v = np.empty(n_sat, dtype=np.bool_), np.empty(3), np.empty((3, 3))
    quality, variance = np.empty(n_sat), np.empty(n_sat)
    weigh(e, tracked, cn0, par[col.CN0_KNEE], quality)
    outcome, n_doppler, excluded_doppler, hdop_doppler = velocity(
        e, quality, tracked, cn0, range_rate, par, tables, drift_group, used, variance, velocity_enu, q_v
    )
    solved = outcome <= FDE_EXCLUDED or outcome == FDE_NO_REDUNDANCY
    lost = separate_velocity(e, used, variance, range_rate, velocity_enu, q_v, solved, system, priors[0], latest.apart)
    share_epoch(latest.apart, witness.apart)
    later = later_by(x[col.SINCE_RTK], par)
    checked = (
        solved
        and not suspect
        and (operative_published or later * lost <= AFFORDABLE * (k_dead[0, col.RISK_AT] + k_dead[0, col.RISK_CT]))
    )
    turning = delta_theta[2] / dt - x[col.GYRO_BIAS]
    v_e, v_n = reference_velocity(velocity_enu, par, turning, math.sin(x[col.HEADING]), math.cos(x[col.HEADING]))
    v_gnss = math.hypot(v_e, v_n)
    spinning = turning_at_rest(x[col.WATCH : col.NX], par[col.WATCH_LIMITS : col.NP], dt, v_ss, turning)
    resting = standstill(x, dt, v_ss, spinning, solved, v_gnss, q_v)
    p_before = x[col.P_HH]
    slip = side_slip(par[col.AXLE], turning, v_ss)
    middle = wrap(attitude(x, par, delta_theta[2]) + slip)  # the way that the reference point takes
    p_hh = x[col.P_HH]
    carry = math.sqrt(p_hh / p_before)  # growth as one error: the bound of its effect on the position
    if solved and not resting and not suspect:
        if calibrate(x, par, heading_limits, v_e, v_n, q_v[0, 0], q_v[0, 1], q_v[1, 1], v_ss, slip, hdop_doppler):
            carry *= x[col.P_HH] / p_hh
            x[col.SINCE_CAL] = 0.0
    sin_h, cos_h = math.sin(x[col.HEADING]), math.cos(x[col.HEADING])

    status, n_rtk, excluded_rtk, hdop_rtk = rtk(
        Signals(e, system, quality, tracked, cn0, code, phase, lock_lost, age),
        tables, Fixes(held, integers, fix_id, fix_risk), rtk_x, last_phase,
        Motion(dt, solved and x[col.INITIALISED] > 0.0, velocity_enu, q_v, x[col.EAST : col.UP + 1]),
        sin_h, cos_h, fixed,
    )  # fmt: skip
    head = fixed.geo.fix[0]
    wrong = held_risk(held, fix_id, fix_risk)
    x[col.FIXED_S] = x[col.FIXED_S] + dt if status == FIXED else 0.0
    lasting = x[col.SINCE_RTK] < 1.5 * dt
    confirmed = status == FIXED and (lasting or x[col.FIXED_S] > par[col.CONFIRM])
    initialised = x[col.INITIALISED] > 0.0
    mode = bridge_mode(checked, v_gnss, v_ss, hdop_doppler, x[col.SINCE_RTK], initialised, mode_limits)
    advance(x, growth, par, mode, v_e, v_n, q_v, v_ss, middle, carry, resting)
    measured = doppler_usable(checked, v_gnss, v_ss, hdop_doppler, mode_limits)
    integrates = mode == DOPPLER and not resting
    for a in apart:
        advance_separations(dt, integrates, x[col.HAS_VEL] > 0.0, measured, math.exp(-dt / par[col.DOP_TAU]), a)
    x[col.APART] = 1.0 if integrates else x[col.APART]
    watch_speeds(x, par, solved, v_gnss, v_ss, hdop_doppler, heading_limits, mode_limits[1], delta_v, turning)
    if x[col.UNBOUNDED] > 0.0:
        x[col.WITNESS_S] = math.inf
    if initialised and x[col.UNBOUNDED] == 0.0 and x[col.SINCE_CAL] < math.inf:
        levels_dead_reckoning(latest, terms, sin_h, cos_h, later, pl)
    found[:] = 0.0
    if confirmed and rtk_usable(hdop_rtk, mode_limits):
        levels_rtk(n_rtk, fixed, sin_h, cos_h, risks, shares, spent + wrong, priors, k_fa, k_published, terms.shift,
                   found)  # fmt: skip
        lever_at, lever_ct = lever_bounds(x, par)
        found[:, 0] += lever_at
        found[:, 1] += lever_ct
        east, north = reference_point(head, par, sin_h, cos_h)
        if lasting:
            hear_witness(x, par, latest, witness, terms, east, north, sin_h, cos_h, found, pl)
        verdict = judge_rtk(x, par, east, north, sin_h, cos_h, pl, found, lasting)
        if verdict == ACCEPTED:
            mode, pl[:] = RTK, found
            take_rtk(x, par, latest, witness, terms, east, north, head, sin_h, cos_h, lasting, pl)
        else:
            status = FAULT
        if verdict == REFUSED:
            x[col.FIXED_S], held[:] = 0.0, False
    doubted = in_doubt(doubt)
    if doubted:
        widen(sin_h, cos_h, found, doubt, pl)
    x[col.HAS_VEL] = 1.0 if measured else 0.0
    if mode == RTK and measured:
        for g in growth:
            remember_velocity(q_v[0, 0], q_v[0, 1], q_v[1, 1], g)
    x[col.VEL_E], x[col.VEL_N] = v_e, v_n
    if not measured:
        x[col.VEL_E], x[col.VEL_N] = v_ss * math.sin(x[col.HEADING] + slip), v_ss * math.cos(x[col.HEADING] + slip)

    _tell(
        v, mode, status, doubted, x, par, sin_h, cos_h, latest.growth, head, (hdop_rtk, hdop_doppler), pl,
        alert_limits, alert, reason, onset, clear, out, covariance,
    )  # fmt: skip
    out[col.O_SATELLITES], out[col.O_DOPPLER], out[col.O_EXCLUDED] = n_rtk, n_doppler, excluded_rtk + excluded_doppler
    out[col.O_WRONG] = wrong


@jit
def _tell(  # type: ignore[no-untyped-def]
    v, mode, status, doubted, x, par, sin_h, cos_h, growth, head, hdop, pl, alert_limits, alert, reason, onset, clear,
    out, covariance,
):  # fmt: skip
    """What vehicle v makes known of its state, and whether it alerts."""
    forward, right, variance = par[col.LEVER_FORWARD], par[col.LEVER_RIGHT], x[col.P_HH]
    turned_e, turned_n = sin_h * right - cos_h * forward, cos_h * right + sin_h * forward  # of a radian of heading
    sigma_at, sigma_ct, _, _ = sigma_and_bias(sin_h, cos_h, False, growth)
    if mode == RTK:
        sigma_h = math.sqrt(variance)
        sigma_at, sigma_ct = (
            math.hypot(head.sigma[0], right * sigma_h),
            math.hypot(head.sigma[1], forward * sigma_h),
        )
    cause = INITIALISING_CAUSE if mode == NONE else 0
    if doubted or (x[col.UNBOUNDED] > 0.0 and mode != RTK and mode != NONE):
        cause = TEST_FAILED_CAUSE
    available = alert_step(
        v, cause, pl[0, 0], pl[0, 1], sigma_at, sigma_ct, par[col.DT], alert_limits, alert, reason, onset, clear
    )
    out[col.O_MODE], out[col.O_RTK], out[col.O_AVAILABLE] = mode, status, available
    out[col.O_SIGMA_AT], out[col.O_SIGMA_CT] = sigma_at, sigma_ct
    out[col.O_HDOP] = hdop[0] if mode == RTK else hdop[1]
    covariance[0, 0] = growth[G_EE] + turned_e * turned_e * variance
    covariance[1, 1] = growth[G_NN] + turned_n * turned_n * variance
    covariance[0, 1] = covariance[1, 0] = growth[G_EN] + turned_e * turned_n * variance


@jit
def run_some(  # type: ignore[no-untyped-def]
    first, last, los, system, index, tracked, cn0, code, phase, range_rate, lock_lost, age,
    delta_theta, delta_v, v_ss,
    par, rtk_par, mode_limits, heading_limits, wavelength, fixable, fit, chi2, normal, fde, risks, shares, spent,
    priors, k_fa, k_published, k_dead, published, operative_published, alert_limits, drift_group,
    x, rtk_x, last_phase, growth, start, apart, held, integers, fix_id, fix_risk, alert, reason, onset, clear,
    out, pl, covariance,
):  # fmt: skip
    """One epoch of the vehicles ``first`` to ``last - 1``, which share their scratch."""
    found = np.zeros((pl.shape[1], 2))
    fixed = fixed_scratch(system.shape[0])
    tables = Tables(rtk_par, wavelength, fixable, fit, chi2, normal, fde)
    for v in range(first, last):
        k = index[v]
        _epoch(
            los[k], system, tracked[v], cn0[v], code[v], phase[v], range_rate[v], lock_lost[v], age[v],
            delta_theta[v], delta_v[v], v_ss[v], par, tables, mode_limits, heading_limits,
            risks, shares, spent, priors, k_fa, k_published, k_dead, published, operative_published, alert_limits,
            drift_group,
            x[v], rtk_x[v], last_phase[v], growth[v], start[v], apart[v], held[v], integers[v], fix_id[v], fix_risk[v],
            v, alert, reason, onset, clear, fixed, found, out[v], pl[v], covariance[v],
        )  # fmt: skip
