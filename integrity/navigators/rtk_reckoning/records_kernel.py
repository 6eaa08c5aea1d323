"""What the stages of an epoch of ``rtk_reckoning`` work on: parameters, state, measurements, work and outputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.monitoring.alerts_kernel import ALERT, ALERT_RULES
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import GROWTH, STEP
from lanebound.integrity.monitoring.detection_kernel import FDE_RULES, Thresholds
from lanebound.integrity.monitoring.doppler_separation_kernel import INFLUENCE, SEPARATION
from lanebound.integrity.monitoring.heading_doubt_kernel import HEADING_DOUBT
from lanebound.integrity.monitoring.heading_separation_kernel import COURSE, SPREAD
from lanebound.integrity.monitoring.jump_kernel import JUMP
from lanebound.integrity.positioning.drift_watch_kernel import DRIFT, DRIFT_RULES
from lanebound.integrity.positioning.float_filter_kernel import FILTER_ROW, FloatFilters
from lanebound.integrity.positioning.heading_kernel import CALIBRATION, HEADING
from lanebound.integrity.positioning.mode_kernel import MODE_LIMITS
from lanebound.integrity.positioning.odometer_watch_kernel import ODOMETER_WATCH, WATCH_LIMITS
from lanebound.integrity.positioning.rtk_kernel import BASES, RTK_RULES
from lanebound.integrity.positioning.slip_watch_kernel import SLIP_RULES, SLIP_WATCH

__all__ = [
    "CASE",
    "FAULT",
    "MARK",
    "OUT",
    "PARAMETERS",
    "START",
    "VEHICLE",
    "WORK",
    "Epoch",
    "Own",
    "State",
    "Tables",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LATEST, BACKUP = 0, 1  # the two dead reckonings: since the last RTK position, and that of the backup solution
MULTI_HYPOTHESIS, CLOSED, PUBLISHED = 0, 1, 2  # forms of a protection level

# Parameters

DOPPLER_RULES = record(
    sigma="range rate, zenith [m/s]",
    decay="of the correlated part of a unit error over an epoch [-]",
    white="variance of the white part of it [-]",
    course="variance of a white error that bounds both [-]",
    bias="bound of a constant velocity bias in E and in N [m/s]",
    carriers=("?", "carriers give the velocity where enough are locked"),
    carrier_sigma="change of a carrier over an epoch, zenith [m/s]",
    window="time between the bases of the windows over which carriers are tested [s]",
    fde=(FDE_RULES, "of these tests"),
    sin_mask="sine of the lowest elevation used",
    cn0_min="lowest C/N0 used [dB-Hz]",
)
HEADING_RULES = record(
    angle_random_walk="[rad/sqrt(s)]",
    bias_walk="random walk of the gyro bias [rad/s/sqrt(s)]",
    bias_initial="gyro bias at turn-on, 1 sigma [rad/s]",
    gyro_scale="error of the gyro's scale, 1 sigma [-]",
    calibration=(CALIBRATION, "when Doppler calibrates"),
)
ODOMETER_RULES = record(
    sigma="odometer speed, 1 sigma [m/s]",
    tau="correlation time of its error [s]",
    bias="bound of a constant error [m/s]",
    scale="bound of the scale error [-]",
    still_speed="speed that the odometer may show as rest [m/s]",
    heading_bias="bound of the heading's error after calibration [rad]",
    heading_drift="growth of that bound [rad/s]",
    watch=(WATCH_LIMITS, "what a healthy odometer may differ by"),
)
LEVER = record(
    forward="antenna ahead of the reference point [m]",
    right="antenna to the right of it [m]",
    k="factor on the heading's sigma in the bound of the lever arm [-]",
    axle="reference point ahead of the rear axle [m]",
    axle_bound="bound of the error of that distance [m]",
)
JUMP_RULES = record(
    after_jump="quarantine after a jump [s]",
    after_outage="quarantine after an outage [s]",
    backup="longest time since the restart of the backup solution [s]",
)
RISK_RULES = record(
    at_share="share of the risk along track [-]",
    fault_free_share="share of the fault-free mode in the closed form, 0: equal shares [-]",
    spent="risk spent on events outside the fault modes [-]",
    fault_duration="mean time that a fault lasts [s]",
    reference_bias="bound of the horizontal error of the reference coordinates [m]",
    constellations=("?", "a constellation may fail as a whole"),
    multiple=("?", "spend risk on two or more faults at once"),
    tolerate=("?", "spend the prior of modes without a solution"),
    published=("?", "the operative level is of the published form"),
    satellite_prior=("f8", (MAX_GROUPS,), "fault probability of one satellite, by system [-]"),
    constellation_prior=("f8", (MAX_GROUPS,), "fault probability of a whole system, in the RTK position [-]"),
    spendable="prior of a system that is spent where its separation is poor [-]",
)
PARAMETERS = record(
    dt="length of an epoch [s]",
    cold=("?", "position from codes before the first fix, and no level before the heading is known"),
    confirm="how long a regained fix must pass its tests [s]",
    rtk=(RTK_RULES, "RTK"),
    slips=(SLIP_RULES, "cycle slips"),
    doppler=(DOPPLER_RULES, "Doppler velocity"),
    heading=(HEADING_RULES, "heading filter"),
    odometer=(ODOMETER_RULES, "odometer and dead reckoning"),
    modes=(MODE_LIMITS, "conditions of the positioning modes"),
    lever=(LEVER, "antenna and axle"),
    jump=(JUMP_RULES, "jump monitor"),
    drift=(DRIFT_RULES, "drift watch"),
    risk=(RISK_RULES, "risk and its allocation"),
    fde=(FDE_RULES, "fault detection and exclusion"),
    alert=(ALERT_RULES, "alert limits and times"),
)
"""The declared figures of a navigator."""

CASE = record(
    risk="total horizontal risk [-]",
    form=("i8", "MULTI_HYPOTHESIS, CLOSED or PUBLISHED, of the RTK level"),
    published=("?", "published factors and biases"),
    k_published="Qinv(risk)",
    k_dead=("f8", (2,), "K_md of dead reckoning by axis"),
    budget=("f8", (2,), "the risk that it stands for, by axis [-]"),
)
"""A protection level to report."""


class Tables(NamedTuple):
    """Parameters in arrays.

    satellites (S,) of SATELLITE; prior (M,) of each fault mode of Doppler, satellites first, then systems; cases (R,)
    of CASE, the operative one first; thresholds of the fault tests; counted (N + 1, K) the factors that the levels
    count on, of the same tests, as ``Thresholds.factor``.
    """

    satellites: Records
    prior: Array
    cases: Records
    thresholds: Thresholds
    counted: Array


# State

RTK_STATE = record(
    rejected=("i8", "rejected epochs in a row"),
    fixes=("i8", "number of fixes so far"),
    refused_s="time until the next attempt after a refusal [s]",
    slips=(SLIP_WATCH, "of the slip test"),
)
BACKUP_STATE = record(position=("f8", (2,), "East, North [m]"), age="time since its restart, inf: none [s]")
BASE = record(
    anchor=("f8", (3,), "point to which its phases are relative [m]"),
    age="age of the corrections [s]",
    path_e="displacement of the antenna since by gyro and odometer, East [m]",
    path_n="the same, North [m]",
)
"""The begin of a window over which carriers are tested."""

VEHICLE = record(
    position=("f8", (3,), "East, North, Up of the reference point [m]"),
    heading=(HEADING, "heading filter"),
    since_calibration="time since the heading was last calibrated [s]",
    memory_s="mean age of the courses in the heading [s]",
    spread=(SPREAD, "covariance of what one satellite or system did to the heading"),
    doubt=(HEADING_DOUBT, "the other heading, while gyro and Doppler courses contradict each other"),
    rest_s="how long the vehicle has been at rest [s]",
    velocity=("f8", (2,), "East, North at the end of the last epoch [m/s]"),
    has_velocity=("?", "the velocity begins a trapezoid"),
    initialised=("?", "there has been a position"),
    bases=(BASE, (BASES,), "of the windows over which carriers are tested, the newest first"),
    since_base="time since the newest base [s]",
    since_rtk="time since the last RTK position [s]",
    fixed_s="how long RTK has passed its tests [s]",
    conflict_s="how long Doppler and odometer have contradicted each other [s]",
    unbounded=("?", "no level holds before the next RTK position"),
    separated=("?", "a separation has grown since the last RTK position"),
    rtk=(RTK_STATE, "RTK"),
    backup=(BACKUP_STATE, "backup solution"),
    jump=(JUMP, "jump monitor"),
    watch=(ODOMETER_WATCH, "odometer watch"),
    alert=(ALERT, "alert"),
    growth=(GROWTH, (2,), "of the errors of dead reckoning, LATEST and BACKUP"),
    drift=(DRIFT, "drift watch"),
    filter=(FILTER_ROW, "filter of the float ambiguities"),
)
"""What lasts of a vehicle from epoch to epoch."""

START = record(
    axis_e="first axis of the bounds, East; the second one is (-axis_n, axis_e) [-]",
    axis_n="the same, North",
    bias_first="bound in addition to K sigma, first axis [m]",
    bias_second="the same, second axis [m]",
    whole_first="bound of the whole error, first axis; inf without a level [m]",
    whole_second="the same, second axis [m]",
)
"""What the last RTK position left to the levels of one case."""


FAULT = record(
    now=(INFLUENCE, "on the velocity of this epoch"),
    last=(INFLUENCE, "on the velocity in which the last epoch ended"),
    course=(COURSE, "on the heading"),
    latest=(SEPARATION, "of the position since the last RTK position"),
    backup=(SEPARATION, "of the backup solution"),
)
"""What the fault of one satellite or system would have done."""


class State(NamedTuple):
    """What lasts of B vehicles.

    vehicles (B,) of VEHICLE; ambiguities (B, S) of AMBIGUITY; faults (B, M) of FAULT; starts (B, 2, R) of START, for
    LATEST and BACKUP; anchors (B, A) of ANCHOR, of the drift watch; filters of the float ambiguities, None where
    they come from single epochs.
    """

    vehicles: Records
    ambiguities: Records
    faults: Records
    starts: Records
    anchors: Records
    filters: FloatFilters | None


# Work and outputs

FIXED_SOLUTION = record(
    status=("i8", "code of RtkStatus"),
    coded=("?", "the codes give a tested position, in a cold start"),
    satellites=("i8", "in the solution"),
    excluded=("i8", "by its fault test"),
    hdop="[-]",
    position=("f8", (3,), "East, North, Up of the antenna, by phases or, in a cold start, by codes [m]"),
    p_ee="covariance, East East [m^2]",
    p_en="East North [m^2]",
    p_nn="North North [m^2]",
    sigma=("f8", (2,), "standard deviation along and across track [m]"),
    wrong="probability that the held integers are wrong [-]",
    searched=("i8", "satellites whose integers were sought"),
    failure="failure rate of their integers: of the set that was tried, or of all where none is precise enough [-]",
    lasting=("?", "the epoch before had an RTK position"),
    usable=("?", "confirmed, and of good geometry: levels are filled"),
    turned=("?", "dead reckoning takes its start bounds along and across the track, not East and North"),
)
WORK = record(
    suspect=("?", "Doppler must not be used"),
    solved=("?", "there is a tested Doppler velocity"),
    checked=("?", "it may move the position"),
    doppler_moves=("?", "it agrees with the odometer, has good geometry and no doubt of the heading refuses it"),
    by_carriers=("?", "it is of changes of carriers"),
    velocity=("f8", (3,), "Doppler velocity of the antenna, East North Up [m/s]"),
    mean_e="by carriers: mean velocity of the epoch, East, of the antenna, then of the reference point [m/s]",
    mean_n="the same, North [m/s]",
    q=("f8", (3, 3), "its covariance [m^2/s^2]"),
    v_e="Doppler velocity of the reference point, East [m/s]",
    v_n="the same, North [m/s]",
    v_gnss="its magnitude [m/s]",
    hdop_doppler="[-]",
    sdop="1 sigma of the Doppler speed over that of one range rate, inf without a velocity [-]",
    satellites_doppler=("i8", "in the velocity"),
    excluded_doppler=("i8", "by its fault test"),
    later="factor on the priors for faults that began since the last RTK position",
    turning="yaw rate less its bias [rad/s]",
    resting=("?", "the vehicle is at rest"),
    slip="side slip angle of the reference point [rad]",
    middle="course of the reference point in the middle of the epoch [rad]",
    sin_h="sine of the heading",
    cos_h="cosine of the heading",
    step=(STEP, "what the epoch does to the error processes"),
    reckoned="heading at the end of the epoch, before Doppler calibrates it [rad]",
    turned="turn of the epoch [rad]",
    before_e="position before it moves, East [m]",
    before_n="the same, North [m]",
    run="distance that the position moved along the heading in this epoch, else 0 [m]",
    backup_run="the same of the backup solution, where carriers moved the position [m]",
    mode=("i8", "code of the positioning mode, UNDECIDED before one is found"),
    integrates=("?", "the position moved by the Doppler velocity"),
    accepted=("?", "the RTK position is accepted"),
    fixed=(FIXED_SOLUTION, "RTK solution"),
    excluded=("i8", "satellites excluded by plug-in stages"),
    cause=("i8", "code of AlertReason that a plug-in stage raises, 0 for none"),
)
"""What stages hand on to later stages of the same epoch."""


MARK = record(
    quality="variance factor of any use [-]",
    factor="the same in RTK, UNUSED of those that are not used [-]",
    used=("?", "in RTK"),
    phase_ok=("?", "the carrier is locked on every band"),
)
"""What is found of a satellite's signal in an epoch."""

OUT = record(
    position=("f8", (2,), "East, North [m]"),
    heading="[rad]",
    velocity=("f8", (2,), "East, North [m/s]"),
    covariance=("f8", (2, 2), "of the position [m^2]"),
    sigma_at="[m]",
    sigma_ct="[m]",
    mode=("i8", "code of Mode"),
    rtk=("i8", "code of RtkStatus"),
    alert=("?", "an alert is on"),
    available=("?", "no level exceeds its limit"),
    reason=("i8", "code of AlertReason"),
    hdop="[-]",
    satellites=("i8", "in the RTK position"),
    satellites_doppler=("i8", "in the velocity"),
    excluded=("i8", "by fault detection"),
    since_rtk="[s]",
    since_calibration="[s]",
    wrong="probability that the held integers are wrong [-]",
    difference=("f8", (2,), "RTK's position less the one reckoned while RTK is not believed, East, North [m]"),
    sdop="[-]",
)
"""What a :class:`~lanebound.integrity.navigators.solution.Solution` takes of a vehicle."""


class Own(NamedTuple):
    """What belongs to one plug-in mode or stage.

    code of its Mode or AlertReason; state (B,) of its own record, which lasts.
    """

    code: int
    state: Records


class Epoch(NamedTuple):
    """One epoch of B vehicles: what every stage ``stage(first, last, epoch)`` takes.

    parameters (1,) of PARAMETERS and tables; of :class:`State` all fields; signals (B, S) of OBSERVED_SIGNAL and
    observed (B,) of OBSERVED_VEHICLE, what is measured; work (B,) of WORK, marks (B, S) of MARK and fixed_levels
    (B, R, 2) [m] of the RTK position, zeros without one; out (B,) of OUT and levels (B, R, 2) [m].
    """

    parameters: Records
    tables: Tables
    vehicles: Records
    ambiguities: Records
    faults: Records
    starts: Records
    anchors: Records
    filters: FloatFilters | None
    signals: Records
    observed: Records
    work: Records
    marks: Records
    fixed_levels: Array
    out: Records
    levels: Array
