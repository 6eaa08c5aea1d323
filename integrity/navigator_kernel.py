"""One navigation epoch of one vehicle: the flow chart of S1 figure 1, stage by stage.

``x`` (NX,) is the vehicle's state, ``out`` (NO,) its solution and ``par`` (NP,) the declared figures, all flat with the
columns named below. Everything here is belief: the measurements are the only inputs.
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.accel import jit, prange
from lanebound.integrity.monitoring.alerts_kernel import alert_step
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import (
    CV_E,
    CV_N,
    levels,
    remember_velocity,
    reset,
    sigma_and_bias,
    step_doppler,
    step_odometer,
    step_still,
)
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import P_EE as G_EE
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import P_EN as G_EN
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import P_NN as G_NN
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED as FDE_EXCLUDED
from lanebound.integrity.monitoring.detection_kernel import NO_REDUNDANCY as FDE_NO_REDUNDANCY
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    AFFORDABLE,
    STATE,
    U_E,
    advance_separations,
    exposure,
    factors,
    separate_velocity,
    share_epoch,
    worst,
)
from lanebound.integrity.monitoring.geometry_kernel import (
    P_EE,
    P_EN,
    P_NN,
    SIGMA0_AT,
    SIGMA0_CT,
    X_E,
    X_N,
    X_U,
    scratch,
)
from lanebound.integrity.monitoring.jump_kernel import (
    ACCEPTED,
    DOUBT_SIZE,
    QUARANTINED,
    REFUSED,
    along_across,
    bounded,
    contradicts,
    in_doubt,
    judge_jump,
    pass_time,
    suspects_signals,
    widen,
)
from lanebound.integrity.monitoring.protection_kernel import (
    budgets_of,
    closed_form,
    closed_form_published,
    pair_risk,
    root,
)
from lanebound.integrity.monitoring.separation_kernel import modes, set_priors
from lanebound.integrity.positioning.heading_kernel import (
    correct,
    doppler_heading_usable,
    doppler_heading_variance,
    predict_heading,
    wrap,
)
from lanebound.integrity.positioning.mode_kernel import (
    DOPPLER,
    NONE,
    RTK,
    bridge_mode,
    doppler_usable,
    rtk_usable,
)
from lanebound.integrity.positioning.odometer_watch_kernel import DOUBT as WATCH_DOUBT
from lanebound.integrity.positioning.odometer_watch_kernel import (
    LIMITS,
    WATCH_SIZE,
    turning_at_rest,
    watch_odometer,
)
from lanebound.integrity.positioning.resolve_kernel import Fixes
from lanebound.integrity.positioning.rtk_kernel import held_risk
from lanebound.integrity.positioning.slip_watch_kernel import Motion
from lanebound.integrity.rtk_stage_kernel import FAULT, FIXED, Fixed, Signals, Tables, rtk, select, test, weigh
from lanebound.integrity.small_matrix_kernel import hdop_of

# state
EAST, NORTH, UP, HEADING, GYRO_BIAS, P_HH, P_HB, P_BB = range(8)
VEL_E, VEL_N, HAS_VEL, SINCE_RTK, SINCE_CAL, REST_S, INITIALISED, FIXED_S = range(8, 16)
UNBOUNDED, CONFLICT_S, REFUSED_S, WITNESS_E, WITNESS_N, WITNESS_S, APART = range(16, 23)
DOUBT = 23  # first of DOUBT_SIZE
WATCH = DOUBT + DOUBT_SIZE  # first of WATCH_SIZE
NX = WATCH + WATCH_SIZE

# solution
O_MODE, O_RTK, O_SATELLITES, O_DOPPLER, O_EXCLUDED, O_AVAILABLE, O_SIGMA_AT, O_SIGMA_CT, O_HDOP, O_WRONG = range(10)
NO = 10
N_WHOLE = 5  # of which are whole numbers
MOVING_MPS = 0.5  # slower, nothing is told of side slip
REACQUIRE_S = 1.0  # of Doppler courses refused for their jump, before the heading filter opens up
CONFLICT_LIMIT_S = 0.5  # of contradiction between Doppler and odometer
TEST_FAILED_CAUSE, INITIALISING_CAUSE = 5, 7  # codes of AlertReason

# declared figures
(
    DT,
    CN0_KNEE,
    REFERENCE_BIAS,
    DOP_SIGMA,
    DOP_TAU,
    DOP_BIAS,
    DOP_SIN_MASK,
    DOP_CN0_MIN,
    ARW,
    BIAS_WALK,
    ODO_SIGMA,
    ODO_TAU,
    ODO_BIAS,
    HEADING_BIAS,
    HEADING_DRIFT,
    LEVER_FORWARD,
    LEVER_RIGHT,
    CONFIRM,
    BIAS_INITIAL,
    ODO_SCALE,
    STILL_SPEED,
    FAULT_DURATION,
    AXLE,
    AFTER_JUMP,
    AFTER_OUTAGE,
    LEVER_K,
    WITNESS_MOST_S,
) = range(27)
WATCH_LIMITS = 27  # first of LIMITS
NP = WATCH_LIMITS + LIMITS

# layers of ``growth``, ``start`` and ``apart``: since the last RTK position; since the one that the witness began at
LATEST, WITNESS = range(2)
# columns of ``start``, what the last RTK position left to each case: a bound beside ``K sigma``, the whole level [m]
START_E, START_N, WHOLE_E, WHOLE_N = range(4)
# columns of ``k_dead``: factors, and the risk that they stand for
K_AT, K_CT, RISK_AT, RISK_CT = range(4)


@jit
def attitude(x, par, delta_theta):  # type: ignore[no-untyped-def]
    """Advance the heading by the gyro; at rest hold it and learn the gyro bias instead (ZUPT, S1 figure 1).

    Returns the mean heading over the epoch [rad].
    """
    dt = par[DT]
    p = x[P_HH : P_BB + 1]
    before = x[HEADING]
    if x[REST_S] > 0.5:
        rate = delta_theta / dt
        x[HEADING], x[GYRO_BIAS] = correct(before, x[GYRO_BIAS], p, rate - x[GYRO_BIAS], 0.0, 1.0, par[ARW] ** 2 / dt)
        return x[HEADING]
    x[HEADING] = predict_heading(before, x[GYRO_BIAS], p, delta_theta, dt, par[ARW], par[BIAS_WALK])
    return wrap(before + 0.5 * wrap(x[HEADING] - before))


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
    jump = wrap(course - slip - x[HEADING])
    allowed = max(limits[3], 3.0 * math.sqrt(x[P_HH]))
    if not doppler_heading_usable(speed, v_ss, hdop, 0.0, limits):
        return False
    variance = doppler_heading_variance(v_e, v_n, q_ee, q_en, q_nn)
    if abs(jump) >= allowed:
        x[REFUSED_S] = x[REFUSED_S] + par[DT] if abs(jump) > allowed + 3.0 * math.sqrt(variance) else 0.0
        if x[REFUSED_S] > REACQUIRE_S:
            x[P_HH], x[P_HB], x[P_BB] = max(x[P_HH], jump * jump), 0.0, par[BIAS_INITIAL] ** 2
        return False
    x[REFUSED_S] = 0.0
    variance *= max(1.0, 2.0 * par[DOP_TAU] / par[DT])
    p = x[P_HH : P_BB + 1]
    x[HEADING], x[GYRO_BIAS] = correct(x[HEADING], x[GYRO_BIAS], p, jump, 1.0, 0.0, variance)
    return True


@jit
def velocity(e, quality, tracked, cn0, range_rate, par, tables, drift_group, used, variance, v, q):  # type: ignore[no-untyped-def]
    """Velocity and clock drift by least squares of the range rates, with fault detection and exclusion (df = m - 4).

    Fills v (3,) [m/s], q (3,3) and ``used``; returns the outcome code, satellites used, excluded, and HDOP.
    """
    select(e, tracked, cn0, quality, par[DOP_SIN_MASK], par[DOP_CN0_MIN], variance, used)
    for s in range(used.shape[0]):
        variance[s] *= par[DOP_SIGMA] ** 2
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
    dt = par[DT]
    conflict = solved and hdop < limits[2] and abs(v_gnss - abs(v_ss)) > limits[1]
    x[CONFLICT_S] = x[CONFLICT_S] + dt if conflict else 0.0
    agrees = solved and hdop < limits[2] and abs(v_gnss - abs(v_ss)) < agreement
    if watch_odometer(
        x[WATCH:NX], par[WATCH_LIMITS:NP], dt, v_ss, delta_v[0], delta_v[1], rate,
        x[CONFLICT_S] > CONFLICT_LIMIT_S, agrees,
    ):  # fmt: skip
        x[UNBOUNDED] = 1.0


@jit
def standstill(x, dt, v_ss, turning, solved, v_gnss, q):  # type: ignore[no-untyped-def]
    """Count how long the vehicle has been at rest: no pulse, no turn, and no Doppler speed beyond its noise."""
    at_rest = abs(v_ss) < 0.02 and not turning and not x[WATCH + WATCH_DOUBT] > 0.0
    at_rest = at_rest and not (solved and v_gnss > max(0.1, 3.0 * math.sqrt(q[0, 0] + q[1, 1])))
    x[REST_S] = x[REST_S] + dt if at_rest else 0.0
    return x[REST_S] > 0.5


@jit
def levels_rtk(  # type: ignore[no-untyped-def]
    n,
    rows,
    rows_group,
    sin_h,
    cos_h,
    risks,
    shares,
    spent,
    priors,
    k_fa,
    k_published,
    reference_bias,
    geo,
    head,
    mode,
    pl,
):
    """Protection levels of the fixed position: cases of the root, of the closed form, and of the published form.

    risks (3, R) holds the risk of each case in the row of its form, 0 elsewhere; ``reference_bias`` [m] bounds the
    common shift
    of a wrong reference, which every mode shares. Published: ``b_E = b_N`` of that length, so ``B = b / sqrt 2``.
    """
    count_cases = risks.shape[1]
    one, budget, found = np.empty(1), np.empty((1, 2)), np.empty((1, 2))
    constellations, split, share0, multiple, tolerate = (
        shares[0] > 0.0,
        shares[1],
        shares[2],
        shares[3] > 0.0,
        shares[4] > 0.0,
    )
    n_modes = 0
    for form in range(3):
        filled = False
        for r in range(count_cases):
            if risks[form, r] <= 0.0:
                continue
            if not filled:
                n_modes = modes(
                    rows_group, rows[0], rows[3], n, sin_h, cos_h, constellations, form == 2, geo, head, mode
                )
                set_priors(rows_group, n, n_modes, priors[0], priors[1], head, mode)
                filled = True
            if form == 2:
                one[0] = k_published[r]
                closed_form_published(n_modes, k_fa[1, n_modes - 1], one, mode, found)
                shift = reference_bias / math.sqrt(2.0)
            else:
                one[0] = risks[form, r]
                lost = spent + (pair_risk(n_modes, mode) if multiple else 0.0)
                budgets_of(one, split, lost, budget)
                if form == 0:
                    root(n_modes, k_fa[0, n_modes - 1], budget, tolerate, head, mode, found)
                else:
                    closed_form(n_modes, k_fa[0, n_modes - 1], budget, share0, tolerate, head, mode, found)
                shift = reference_bias
            pl[r, 0], pl[r, 1] = found[0, 0] + shift, found[0, 1] + shift


@jit
def levels_dead_reckoning(  # type: ignore[no-untyped-def]
    growth, start, apart, system, sin_h, cos_h, k_dead, published, shift, prior, later, split, multiple, pl
):
    """``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19) of every case: k_dead, start (R, 4), published (R,) bool.

    Exact levels also bound each single satellite fault in the Doppler velocities since the fix, by the separation that
    it has caused (:mod:`.doppler_separation_kernel`). ``later`` >= 1 raises the priors by the faults that began since.
    ``shift`` bounds the horizontal length of the error that the reference gave to the last RTK position: exact, that
    much on each axis; published, equal components on E and N.
    """
    total, squares, lost = exposure(system, prior, apart)
    total, squares, lost = later * total, later * later * squares, later * lost
    pair = 0.5 * (total * total - squares) if multiple else 0.0
    axis_sine, axis_cosine = (sin_h, cos_h), (cos_h, -sin_h)
    sigma_bias = sigma_and_bias(sin_h, cos_h, False, growth)
    for r in range(k_dead.shape[0]):
        if not start[r, WHOLE_E] < math.inf:
            pl[r] = math.inf
            continue
        if published[r]:
            levels(sin_h, cos_h, k_dead[r : r + 1], True, growth, pl[r : r + 1])
            pl[r] += shift / math.sqrt(2.0)
            continue
        for q in range(2):
            sine, cosine, share = axis_sine[q], axis_cosine[q], split if q == 0 else 1.0 - split
            k_0, k_f = k_dead[r, q], -math.inf
            if total > 0.0:
                k_0, k_f = factors(k_dead[r, RISK_AT + q], share, pair, total, lost)
            level = k_0 * sigma_bias[q] + abs(sine) * start[r, START_E] + abs(cosine) * start[r, START_N]
            if -math.inf < k_f < math.inf:
                whole = abs(sine) * start[r, WHOLE_E] + abs(cosine) * start[r, WHOLE_N]
                level = max(level, worst(sine, cosine, sigma_bias[q], k_f, apart) + whole)
            pl[r, q] = level + sigma_bias[2 + q] + shift


@jit
def restart(  # type: ignore[no-untyped-def]
    growth, start, apart, x, level, k_dead, shift, published, heading_variance, head, sin_h, cos_h
):
    """Start dead reckoning anew from the RTK position just found, for every case.

    Its initial error must keep what the protection level promised, biases and faults included: what the ``level``
    (R, 2) of a case holds beyond ``K sigma`` of the fault-free solution stays on as a bound on E and N. The published
    form starts from the fault-free covariance alone, as S1 does.
    """
    reset(head[P_EE], head[P_EN], head[P_NN], 0.0, 0.0, heading_variance, growth)
    if x[APART] > 0.0:
        apart[:U_E] = 0.0
        apart[STATE] = 0.0
        x[APART] = 0.0
    for r in range(level.shape[0]):
        start[r] = 0.0
        if not (level[r, 0] < math.inf and level[r, 1] < math.inf):
            start[r, WHOLE_E] = math.inf
        elif not published[r]:
            at, ct = max(level[r, 0] - shift, 0.0), max(level[r, 1] - shift, 0.0)
            start[r, WHOLE_E], start[r, WHOLE_N] = _box(at, ct, sin_h, cos_h)
            at = max(at - k_dead[r, K_AT] * head[SIGMA0_AT], 0.0)
            ct = max(ct - k_dead[r, K_CT] * head[SIGMA0_CT], 0.0)
            start[r, START_E], start[r, START_N] = _box(at, ct, sin_h, cos_h)


@jit
def _box(at, ct, sin_h, cos_h):  # type: ignore[no-untyped-def]
    """Bounds on E and N of what is bounded along and across the track."""
    return abs(sin_h) * at + abs(cos_h) * ct, abs(cos_h) * at + abs(sin_h) * ct


@jit
def advance(x, growth, par, mode, v_e, v_n, q, v_ss, middle, carry, resting):  # type: ignore[no-untyped-def]
    """Carry the position, the witness's, and the errors of both over the epoch by Doppler or by dead reckoning.

    At rest the position stays; the bound grows by what the odometer may not show.
    """
    dt, variance = par[DT], x[P_HH]
    phi_d, phi_o = math.exp(-dt / par[DOP_TAU]), math.exp(-dt / par[ODO_TAU])
    if resting or mode == NONE:
        for g in growth:
            step_still(phi_d, phi_o, variance, carry, g)
            g[CV_E] += dt * par[STILL_SPEED] * math.sin(x[HEADING])
            g[CV_N] += dt * par[STILL_SPEED] * math.cos(x[HEADING])
        return
    if mode == DOPPLER:
        before_e, before_n = (x[VEL_E], x[VEL_N]) if x[HAS_VEL] > 0.0 else (v_e, v_n)
        _move(x, 0.5 * dt * (before_e + v_e), 0.5 * dt * (before_n + v_n))
        for g in growth:
            step_doppler(dt, q[0, 0], q[0, 1], q[1, 1], par[DOP_BIAS], phi_d, phi_o, variance, carry, False, g)
        return
    s, c = math.sin(middle), math.cos(middle)
    _move(x, dt * v_ss * s, dt * v_ss * c)
    b_theta = heading_bias(x, par)
    bias = par[ODO_BIAS] + par[ODO_SCALE] * abs(v_ss)
    for g in growth:
        step_odometer(dt, v_ss, s, c, par[ODO_SIGMA], bias, b_theta, phi_d, phi_o, variance, carry, False, g)


@jit
def _move(x, east, north):  # type: ignore[no-untyped-def]
    x[EAST] += east
    x[NORTH] += north
    x[WITNESS_E] += east
    x[WITNESS_N] += north


@jit
def heading_bias(x, par):  # type: ignore[no-untyped-def]
    """Bound on what no filter knows of the heading's error [rad]; before the first calibration nothing is known."""
    if not x[SINCE_CAL] < math.inf:
        return math.pi
    return min(par[HEADING_BIAS] + par[HEADING_DRIFT] * x[SINCE_CAL], math.pi)


@jit
def reference_point(head, par, sin_h, cos_h):  # type: ignore[no-untyped-def]
    """East and North of the vehicle, of whose antenna ``head`` tells [m]."""
    forward, right = par[LEVER_FORWARD], par[LEVER_RIGHT]
    return head[X_E] - sin_h * forward - cos_h * right, head[X_N] - cos_h * forward + sin_h * right


@jit
def lever_bounds(x, par):  # type: ignore[no-untyped-def]
    """Bounds on what a wrong heading does to the reference point, told from the antenna, along and across [m].

    A lever (f, r) turned by theta moves ``f (cos theta - 1) - r sin theta`` along, ``f sin theta + r (cos theta - 1)``
    across, and by twice its length at most.
    """
    theta = min(par[LEVER_K] * math.sqrt(x[P_HH]) + heading_bias(x, par), math.pi)
    f, r = abs(par[LEVER_FORWARD]), abs(par[LEVER_RIGHT])
    most, turned = 2.0 * math.hypot(f, r), 0.5 * theta * theta
    return min(r * theta + f * turned, most), min(f * theta + r * turned, most)


@jit
def later_by(since, par):  # type: ignore[no-untyped-def]
    """By how much faults are likelier than at one moment, since some time [s] ago."""
    return 1.0 + since / par[FAULT_DURATION] if since < math.inf else 1.0


@jit
def hear_witness(  # type: ignore[no-untyped-def]
    x, par, growth, start, apart, system, sin_h, cos_h, k_dead, published, shift, prior, shares, rtk_en, found, pl
):
    """Where the witness contradicts an RTK position that lasts, go back to the one that he began at, and on with him.

    ``found`` (R, 2) are the levels of RTK; ``pl`` (R, 2) become those of the witness, if he is believed [m].
    """
    east, north = rtk_en[0] - x[WITNESS_E], rtk_en[1] - x[WITNESS_N]
    at, ct = along_across(east, north, sin_h, cos_h)
    if not (x[WITNESS_S] < math.inf and x[SINCE_CAL] < math.inf and (at > found[0, 0] or ct > found[0, 1])):
        return
    levels = np.empty_like(pl)
    levels_dead_reckoning(
        growth[WITNESS], start[WITNESS], apart[WITNESS], system, sin_h, cos_h, k_dead, published, shift, prior,
        later_by(x[WITNESS_S], par), shares[1], shares[3] > 0.0, levels,
    )  # fmt: skip
    if contradicts(east, north, sin_h, cos_h, levels[0], found[0]):
        x[EAST], x[NORTH], x[SINCE_RTK], x[APART] = x[WITNESS_E], x[WITNESS_N], x[WITNESS_S], 1.0
        growth[LATEST], start[LATEST], apart[LATEST] = growth[WITNESS], start[WITNESS], apart[WITNESS]
        pl[:] = levels


@jit
def call_witness(x, growth, start, apart):  # type: ignore[no-untyped-def]
    """A new witness begins at the RTK position just found."""
    x[WITNESS_E], x[WITNESS_N], x[WITNESS_S] = x[EAST], x[NORTH], 0.0
    growth[WITNESS], start[WITNESS], apart[WITNESS] = growth[LATEST], start[LATEST], apart[LATEST]


@jit
def judge_rtk(x, par, east, north, sin_h, cos_h, expected, found, lasting):  # type: ignore[no-untyped-def]
    """ACCEPTED, REFUSED or QUARANTINED: a confirmed RTK position beside the one expected; levels of both (R, 2) [m].

    One without a level is not taken in place of one that has one.
    """
    if bounded(expected[0]) and not bounded(found[0]):
        return QUARANTINED
    if not x[INITIALISED] > 0.0:
        return ACCEPTED
    return judge_jump(
        east - x[EAST], north - x[NORTH], sin_h, cos_h, expected[0], found[0], lasting,
        x[CONFLICT_S] > CONFLICT_LIMIT_S, (par[AFTER_JUMP], par[AFTER_OUTAGE]), x[DOUBT:WATCH],
    )  # fmt: skip


@jit
def _epoch(  # type: ignore[no-untyped-def]
    e, system, tracked, cn0, code, phase, range_rate, lock_lost, age,
    delta_theta, delta_v, v_ss,
    par, tables, mode_limits, heading_limits, risks, shares, spent,
    priors, k_fa, k_published, k_dead, published, operative_published, alert_limits, drift_group,
    x, rtk_x, last_phase, growth, start, apart, held, integers, fix_id, fix_risk, v, alert, reason, onset, clear,
    fixed, columns, found, out, pl, covariance,
):  # fmt: skip
    """The whole epoch of vehicle v; x to fix_risk and the alert arrays are its state."""
    dt, n_sat, doubt = par[DT], e.shape[0], x[DOUBT:WATCH]
    pl[:] = math.inf
    pass_time(dt, doubt)
    suspect = suspects_signals(doubt)
    x[SINCE_RTK] += dt
    x[SINCE_CAL] += dt
    x[WITNESS_S] += dt

    used, velocity_enu, q_v = np.empty(n_sat, dtype=np.bool_), np.empty(3), np.empty((3, 3))
    quality, variance = np.empty(n_sat), np.empty(n_sat)
    weigh(e, tracked, cn0, par[CN0_KNEE], quality)
    outcome, n_doppler, excluded_doppler, hdop_doppler = velocity(
        e, quality, tracked, cn0, range_rate, par, tables, drift_group, used, variance, velocity_enu, q_v
    )
    solved = outcome <= FDE_EXCLUDED or outcome == FDE_NO_REDUNDANCY
    lost = separate_velocity(
        e, used, variance, range_rate, velocity_enu, q_v, solved, system, priors[0], apart[LATEST]
    )  # fmt: skip
    share_epoch(apart[LATEST], apart[WITNESS])
    later = later_by(x[SINCE_RTK], par)
    checked = (
        solved
        and not suspect
        and (operative_published or later * lost <= AFFORDABLE * (k_dead[0, RISK_AT] + k_dead[0, RISK_CT]))
    )
    turning, s_0, c_0 = delta_theta[2] / dt - x[GYRO_BIAS], math.sin(x[HEADING]), math.cos(x[HEADING])
    v_e = velocity_enu[0] - turning * (c_0 * par[LEVER_FORWARD] - s_0 * par[LEVER_RIGHT])  # antenna to reference point
    v_n = velocity_enu[1] + turning * (s_0 * par[LEVER_FORWARD] + c_0 * par[LEVER_RIGHT])
    v_gnss = math.hypot(v_e, v_n)
    spinning = turning_at_rest(x[WATCH:NX], par[WATCH_LIMITS:NP], dt, v_ss, turning)
    resting = standstill(x, dt, v_ss, spinning, solved, v_gnss, q_v)
    p_before = x[P_HH]
    slip = side_slip(par[AXLE], turning, v_ss)
    middle = wrap(attitude(x, par, delta_theta[2]) + slip)  # the way that the reference point takes
    carry, p_hh = math.sqrt(x[P_HH] / p_before), x[P_HH]  # growth as one error: the bound of its effect on the position
    if solved and not resting and not suspect:
        if calibrate(x, par, heading_limits, v_e, v_n, q_v[0, 0], q_v[0, 1], q_v[1, 1], v_ss, slip, hdop_doppler):
            carry *= x[P_HH] / p_hh
            x[SINCE_CAL] = 0.0
    sin_h, cos_h = math.sin(x[HEADING]), math.cos(x[HEADING])

    status, n_rtk, excluded_rtk, hdop_rtk = rtk(
        Signals(e, system, quality, tracked, cn0, code, phase, lock_lost, age),
        tables, Fixes(held, integers, fix_id, fix_risk), rtk_x, last_phase,
        Motion(dt, solved and x[INITIALISED] > 0.0, velocity_enu, q_v, x[EAST : UP + 1]), sin_h, cos_h, fixed,
    )  # fmt: skip
    head = fixed.head
    wrong = held_risk(held, fix_id, fix_risk)
    x[FIXED_S] = x[FIXED_S] + dt if status == FIXED else 0.0
    lasting = x[SINCE_RTK] < 1.5 * dt
    confirmed = status == FIXED and (lasting or x[FIXED_S] > par[CONFIRM])
    initialised = x[INITIALISED] > 0.0
    mode = bridge_mode(checked, v_gnss, v_ss, hdop_doppler, x[SINCE_RTK], initialised, mode_limits)
    advance(x, growth, par, mode, v_e, v_n, q_v, v_ss, middle, carry, resting)
    measured = doppler_usable(checked, v_gnss, v_ss, hdop_doppler, mode_limits)
    integrates = mode == DOPPLER and not resting
    for a in apart:
        advance_separations(dt, integrates, x[HAS_VEL] > 0.0, measured, math.exp(-dt / par[DOP_TAU]), a)
    x[APART] = 1.0 if integrates else x[APART]
    watch_speeds(x, par, solved, v_gnss, v_ss, hdop_doppler, heading_limits, mode_limits[1], delta_v, turning)
    if x[UNBOUNDED] > 0.0:
        x[WITNESS_S] = math.inf
    shift = par[REFERENCE_BIAS]
    if initialised and x[UNBOUNDED] == 0.0 and x[SINCE_CAL] < math.inf:
        levels_dead_reckoning(
            growth[LATEST], start[LATEST], apart[LATEST], system, sin_h, cos_h, k_dead, published, shift, priors[0],
            later, shares[1], shares[3] > 0.0, pl,
        )  # fmt: skip
    found[:] = 0.0
    if confirmed and rtk_usable(hdop_rtk, mode_limits):
        levels_rtk(n_rtk, fixed.rows, fixed.group, sin_h, cos_h, risks, shares, spent + wrong, priors, k_fa,
                   k_published, shift, fixed.geo, head, columns, found)  # fmt: skip
        lever_at, lever_ct = lever_bounds(x, par)
        found[:, 0] += lever_at
        found[:, 1] += lever_ct
        east, north = reference_point(head, par, sin_h, cos_h)
        if lasting:
            hear_witness(
                x, par, growth, start, apart, system, sin_h, cos_h, k_dead, published, shift, priors[0], shares,
                (east, north), found, pl,
            )  # fmt: skip
        verdict = judge_rtk(x, par, east, north, sin_h, cos_h, pl, found, lasting)
        if verdict == ACCEPTED:
            mode, pl[:] = RTK, found
            x[EAST], x[NORTH], x[UP] = east, north, head[X_U]
            x[SINCE_RTK], x[INITIALISED], x[UNBOUNDED] = 0.0, 1.0, 0.0
            restart(
                growth[LATEST], start[LATEST], apart[LATEST], x, pl, k_dead, shift, published, x[P_HH], head, sin_h,
                cos_h,
            )  # fmt: skip
            if not (lasting and x[WITNESS_S] < par[WITNESS_MOST_S]):
                call_witness(x, growth, start, apart)
        else:
            status = FAULT
        if verdict == REFUSED:
            x[FIXED_S], held[:] = 0.0, False
    doubted = in_doubt(doubt)
    if doubted:
        widen(sin_h, cos_h, found, doubt, pl)
    x[HAS_VEL] = 1.0 if measured else 0.0
    if mode == RTK and measured:
        for g in growth:
            remember_velocity(q_v[0, 0], q_v[0, 1], q_v[1, 1], g)
    x[VEL_E], x[VEL_N] = v_e, v_n
    if not measured:
        x[VEL_E], x[VEL_N] = v_ss * math.sin(x[HEADING] + slip), v_ss * math.cos(x[HEADING] + slip)

    _tell(
        v, mode, status, doubted, x, par, sin_h, cos_h, growth[LATEST], fixed.head, (hdop_rtk, hdop_doppler), pl,
        alert_limits, alert, reason, onset, clear, out, covariance,
    )  # fmt: skip
    out[O_SATELLITES], out[O_DOPPLER], out[O_EXCLUDED] = n_rtk, n_doppler, excluded_rtk + excluded_doppler
    out[O_WRONG] = wrong


@jit
def _tell(  # type: ignore[no-untyped-def]
    v, mode, status, doubted, x, par, sin_h, cos_h, growth, head, hdop, pl, alert_limits, alert, reason, onset, clear,
    out, covariance,
):  # fmt: skip
    """What vehicle v makes known of its state, and whether it alerts."""
    forward, right, variance = par[LEVER_FORWARD], par[LEVER_RIGHT], x[P_HH]
    turned_e, turned_n = sin_h * right - cos_h * forward, cos_h * right + sin_h * forward  # of a radian of heading
    sigma_at, sigma_ct, _, _ = sigma_and_bias(sin_h, cos_h, False, growth)
    if mode == RTK:
        sigma_h = math.sqrt(variance)
        sigma_at, sigma_ct = (
            math.hypot(head[SIGMA0_AT], right * sigma_h),
            math.hypot(head[SIGMA0_CT], forward * sigma_h),
        )
    cause = INITIALISING_CAUSE if mode == NONE else 0
    if doubted or (x[UNBOUNDED] > 0.0 and mode != RTK and mode != NONE):
        cause = TEST_FAILED_CAUSE
    available = alert_step(
        v, cause, pl[0, 0], pl[0, 1], sigma_at, sigma_ct, par[DT], alert_limits, alert, reason, onset, clear
    )
    out[O_MODE], out[O_RTK], out[O_AVAILABLE] = mode, status, available
    out[O_SIGMA_AT], out[O_SIGMA_CT] = sigma_at, sigma_ct
    out[O_HDOP] = hdop[0] if mode == RTK else hdop[1]
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
    geo, head, columns = scratch(system.shape[0])
    wide, found = geo.shape[1], np.zeros((pl.shape[1], 2))
    fixed = Fixed(geo, head, np.zeros((4, wide)), np.zeros((wide, 3)), np.zeros(wide, dtype=np.int64))
    tables = Tables(rtk_par, wavelength, fixable, fit, chi2, normal, fde)
    for v in range(first, last):
        k = index[v]
        _epoch(
            los[k], system, tracked[v], cn0[v], code[v], phase[v], range_rate[v], lock_lost[v], age[v],
            delta_theta[v], delta_v[v], v_ss[v], par, tables, mode_limits, heading_limits,
            risks, shares, spent, priors, k_fa, k_published, k_dead, published, operative_published, alert_limits,
            drift_group,
            x[v], rtk_x[v], last_phase[v], growth[v], start[v], apart[v], held[v], integers[v], fix_id[v], fix_risk[v],
            v, alert, reason, onset, clear, fixed, columns, found, out[v], pl[v], covariance[v],
        )  # fmt: skip


@jit(parallel=True)
def run_parallel(  # type: ignore[no-untyped-def]
    chunks, last, los, system, index, tracked, cn0, code, phase, range_rate, lock_lost, age,
    delta_theta, delta_v, v_ss,
    par, rtk_par, mode_limits, heading_limits, wavelength, fixable, fit, chi2, normal, fde, risks, shares, spent,
    priors, k_fa, k_published, k_dead, published, operative_published, alert_limits, drift_group,
    x, rtk_x, last_phase, growth, start, apart, held, integers, fix_id, fix_risk, alert, reason, onset, clear,
    out, pl, covariance,
):  # fmt: skip
    """:func:`run_some` for all ``last`` vehicles, in ``chunks`` runs side by side."""
    for chunk in prange(chunks):
        run_some(
            chunk * last // chunks, (chunk + 1) * last // chunks, los, system, index, tracked, cn0,
            code, phase, range_rate, lock_lost, age, delta_theta, delta_v, v_ss, par, rtk_par, mode_limits,
            heading_limits, wavelength, fixable, fit, chi2, normal, fde, risks, shares, spent, priors, k_fa,
            k_published, k_dead, published, operative_published, alert_limits, drift_group, x, rtk_x, last_phase,
            growth, start, apart, held, integers, fix_id, fix_risk, alert, reason, onset, clear, out, pl, covariance,
        )  # fmt: skip
