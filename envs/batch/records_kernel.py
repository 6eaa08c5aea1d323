"""The records of N environments: what kernels read and write of vehicles, beliefs, scores and outcomes.

Frame ``xy`` of :mod:`lanebound.envs.records`: headings clockwise from x, offsets and turns positive to the right.
"""

from __future__ import annotations

from lanebound.integrity.core.records import record

__all__ = [
    "BELIEF", "CAR", "CAUSES", "COMMAND", "COST_FIGURES", "EGO", "FACTS", "GIVEN", "OUTCOME", "PERCEIVED",
    "REWARD_WEIGHTS", "RULES", "SCORE", "SENSED", "TERMS", "TRACK", "VIEW",
]  # fmt: skip

GIVEN, SENSED = 0, 1  # sources of the ego's position

TERMS = ("progress", "lane_centre", "comfort", "collision", "base")
"""Terms of the reward."""
CAUSES = (
    "cost_collision", "cost_off_road", "cost_lane", "cost_lane_integrity", "cost_headway", "cost_conflict",
    "cost_alert", "cost_hmi", "cost_context",
)  # fmt: skip
"""Costs by cause."""


CAR = record(
    x="middle [m]",
    y="middle [m]",
    heading="[rad]",
    speed="[m/s]",
    length="[m]",
    width="[m]",
    lane=("i8", "row of the lane that the vehicle is on"),
    crashed=("i8", "1 after a crash"),
    slot=("i8", "row in all that has a row for each of C slots; -1 for the ego, without a slot and in an empty place"),
    onward=("i8", "row of the lane that its route goes on to, NONE where the lane itself says so"),
)
"""A true vehicle. Those of an environment are in the first places of its row, the ego first."""

BELIEF = record(
    time_s="since the start of the episode",
    x_m="believed middle of the car",
    y_m="believed middle of the car",
    heading_rad="of the estimate, not wrapped",
    speed_mps="by the odometer",
    yaw_rate_radps="positive turning right",
    acceleration_mps2="along the heading, smoothed",
    steering_rad="angle commanded last, positive right",
    lane=("i8", "row of the believed lane"),
    path=("i8", "row of the path that is followed from there"),
    longitudinal_m="station on that lane",
    lateral_m="offset from its centreline",
    angle_rad="heading less the lane's",
    lane_width_m="width of the lane there",
    target_lane=("i8", "row of the lane that meta-actions have set, else the believed one"),
    target_speed_mps="speed that meta-actions have set, else the speed itself",
    pl_at_m="protection level along the track, inf when missing",
    pl_ct_m="protection level across the track, inf when missing",
    al_at_m="alert limit along the track",
    al_ct_m="alert limit across the track",
    mode=("i8", "code of Mode"),
    rtk=("i8", "code of RtkStatus"),
    reason=("i8", "code of AlertReason"),
    alert=("i8", "1 while an alert is on"),
    alert_age_s="how long the alert has been on, 0 without",
    available=("i8", "1 while no level exceeds its limit"),
    hdop="horizontal dilution of precision",
    satellites=("i8", "used by RTK"),
    satellites_doppler=("i8", "used by the velocity"),
    excluded=("i8", "by fault detection in this epoch"),
    since_rtk_s="since the last RTK position, inf for never",
    since_calibration_s="since the heading was calibrated, inf for never",
    corrections_age_s="of the reference data, inf when the link is out",
    context_warning=("i8", "1 while the context monitor warns"),
    context_phases=("i8", "phases of the context monitor that are passed, 0 to 3"),
    context_score="of the matched link, 0 to 100",
    link_probability="of the matched link",
    model_curved="probability of the curved model of a filter, 0 without",
    nis_position="of the last position of a filter, 0 without",
    nis_wheels="of the last wheel speed of a filter, 0 without",
    nis_gyro="of the last integrated gyro of a filter, 0 without",
    nis_steering="of the last steering angle of a filter, 0 without",
    nis_slip="of the last slip by the geometry, 0 without",
    nis_compass="of the last compass heading of a filter, 0 without",
    trust_m="horizontal trust level of a filter, inf without",
    sdop="speed dilution of precision, inf without a Doppler velocity",
)

TRACK = record(
    x_m="newest solution, carried on",
    y_m="newest solution, carried on",
    residual_x_m="what a jump has left to be taken over",
    residual_y_m="what a jump has left to be taken over",
    heading_rad="of the solution, carried on",
    yaw_rate_radps="by the last two solutions",
    acceleration_mps2="smoothed",
    fix_heading_rad="of the newest solution",
    fix_speed_mps="of the newest solution",
    pl_at_m="of the newest solution",
    pl_ct_m="of the newest solution",
    alert=("i8", "of the newest solution"),
    available=("i8", "of the newest solution"),
    reason=("i8", "of the newest solution"),
    map_x_m="error of the ego's map",
    map_y_m="error of the ego's map",
)

COMMAND = record(
    acceleration_mps2="commanded directly",
    steering_rad="commanded directly",
    wheel_rad="angle of the road wheels that the actuators have reached",
    effort="what the reward of the wrapped world takes of the last action",
)

SCORE = record(
    steps=("i8", "simulation steps since the start"),
    time_s="of the wrapped world",
    crashed=("i8", "1 after a crash"),
    against_s="how long the car has driven against its lane",
    progress_m="along the lane",
    allowed_m="that limit, bends and the vehicle ahead would have allowed",
    behind_m="way lost to a car at the share of that speed that a success requires; a lead does not count",
    heading_rad="at the last decision",
    speed_mps="at the last decision",
    astray=("i8", "1 after the car left the road or turned against the traffic"),
    epochs=("i8", "navigation epochs in this step"),
    mi=("i8", "of them with misleading information"),
    hmi=("i8", "of them with hazardously misleading information"),
    corridor_road=("i8", "road of the lane that the car is to keep"),
    corridor_side=("i8", "number of that lane"),
    leaving_side=("i8", "number of the lane that a commanded change comes from, NONE without a change"),
    change_s="time spent changing beyond that spent in a lane",
    conflict="largest severity of the conflict that goes on, 0 without one",
    observed=("i8", "observations since the start"),
)

FACTS = record(
    on_road=("i8", "whether the middle of the car is on its lane"),
    terminated=("i8", "whether the wrapped world ends the episode"),
    truncated=("i8", "whether time is up"),
    arrived=("i8", "whether the goal of the world is reached; always where it has none"),
    base="reward of the wrapped world",
)

OUTCOME = record(  # numbers, then what is true where positive, then codes: each in the order in which infos name them
    reward="weighted sum of the terms",
    **{name: f"term of the reward: {name}" for name in TERMS},
    cost="weighted sum of the causes",
    **{name: f"cost by cause: {name}" for name in CAUSES},
    tta_s="time left to react to an alert, 1 s less its age",
    err_at_m="estimate less truth along the track",
    err_ct_m="estimate less truth across the track",
    hmi_share="of the step's epochs",
    yaw_rate_radps="of the true car over the step",
    pl_at_m="protection level along the track",
    pl_ct_m="protection level across the track",
    al_at_m="alert limit along the track",
    al_ct_m="alert limit across the track",
    margin_at_m="AL - PL along the track",
    margin_ct_m="AL - PL across the track",
    speed_mps="of the true car",
    terminated="1 when the episode ends here",
    truncated="1 when time is up",
    mi="1 when any epoch was misleading and none hazardous",
    hmi="1 when any epoch was hazardously misleading",
    crashed="1 after a crash",
    crashed_now="1 in the step of a crash",
    off_road="1 when the car's middle is off the road",
    wrong_way="1 after driving against the lane for too long",
    astray_now="1 in the step in which the car left the road or turned against the traffic",
    is_success="1 when the episode ends well",
    alert="1 while an alert is on",
    available="1 while no level exceeds its limit",
    mode="code of Mode",
    reason="code of AlertReason",
)

VIEW = record(
    heading_sin="sine of the heading less the lane's",
    heading_cos="cosine of the heading less the lane's",
    lateral_share="lateral offset over half the lane's width",
    lane_share="number of the lane over that of the road's last lane",
    left_exists="1 when a lane that may be entered lies to the left",
    right_exists="1 when a lane that may be entered lies to the right",
    target_left="1 when a change to a lane on the left is commanded",
    target_right="1 when a change to a lane on the right is commanded",
    speed_limit_mps="of the lane, inf for none",
    junction_m="to the end of the lane's own stretch of road",
    lane_end_m="to where no lane goes on from this one",
    pl_at_m="protection level along the track; 0 for an oracle",
    pl_at_exists="1 when there is one",
    ratio_at="level over limit, inf when missing",
    margin_at_m="limit less level, -inf when missing",
    trend_at_m="change of the clipped level over the window",
    pl_ct_m="protection level across the track; 0 for an oracle",
    pl_ct_exists="1 when there is one",
    ratio_ct="level over limit, inf when missing",
    margin_ct_m="limit less level, -inf when missing",
    trend_ct_m="change of the clipped level over the window",
    available="1 when the position is available; always for an oracle",
    alert="1 while the alert is on; never for an oracle",
    alert_age_s="how long the alert has been on",
    reason="code of AlertReason",
)
EGO = record(
    belief=(BELIEF, "what the ego believes"),
    shown=(BELIEF, "by which an agent observes: the belief, or the truth for an oracle"),
    own=(VIEW, "what an agent observes of the ego itself"),
    track=(TRACK, "of a position that is sensed"),
    command=(COMMAND, "what is commanded"),
    score=(SCORE, "what scores remember"),
    facts=(FACTS, "what the wrapped world says of the step"),
    outcome=(OUTCOME, "what the step has come to"),
    vehicles=("i8", "vehicles of the environment, the ego included: the first places of its row of cars"),
    route=("i8", "row of the first step that is left of the planned route, 0 for none"),
    place=("i8", "place of the ego in the world's list of vehicles, by which pairs that crash are ordered"),
    placed=("i8", "lane on which the belief was last; where there is a route, it decides between lanes that cross"),
)
"""All that belongs to an environment as a whole."""

PERCEIVED = record(
    x_m="brought forward to now",
    y_m="brought forward to now",
    heading_rad="as measured or broadcast",
    speed_mps="as measured or broadcast",
    pl_at_m="bound along its own heading, age included",
    pl_ct_m="bound across its own heading, age included",
    age_s="since the measurement behind it",
    length_m="of the vehicle",
    width_m="of the vehicle",
    relative=("i8", "1 when seen by the ego's own sensor: the bounds are relative to the ego"),
    key=("i8", "names the vehicle for as long as it is perceived"),
)

REWARD_WEIGHTS = record(**{name: f"weight of {name}" for name in TERMS})
COST_FIGURES = record(
    collision="weight of cost_collision",
    off_road="weight of cost_off_road",
    lane="weight of cost_lane [1/m^2]",
    lane_integrity="weight of cost_lane_integrity [1/m^2]",
    headway="weight of cost_headway [1/s]",
    conflict="weight of cost_conflict [-]",
    alert="weight of cost_alert [1/s]",
    hmi="weight of cost_hmi [1/s]",
    context="weight of cost_context [1/s]",
    conflict_s="time below which a crossing is a conflict",
    response_s="response time of the RSS distance",
    accelerate_mps2="acceleration during the response",
    brake_min_mps2="braking that the ego is sure to reach",
    brake_max_mps2="braking of the leader at most",
    alert_speed_share="share of the speed limit permitted during an alert",
    time_to_alert_s="allowed for a reaction to an alert",
)
RULES = record(
    step_s="simulation step",
    epoch_s="navigation epoch",
    policy_s="policy step",
    meta=("i8", "1 under meta-actions"),
    source=("i8", "GIVEN or SENSED"),
    offset_at_m="constant error of a given position, forward",
    offset_ct_m="constant error of a given position, to the right",
    jump_m="larger corrections are smoothed",
    smoothing_s="time constant of the smoothing, 0 for none",
    map_bound_m="bound of the map's error on each axis",
    al_at_m="alert limit along the track",
    al_ct_m="alert limit across the track",
    actuated=("i8", "1 with limits of steering and a brake that holds"),
    pursues=("i8", "1 where meta-actions steer by pure pursuit"),
    lateral_mps2="largest lateral acceleration that steering asks for, negative for none",
    wheel_rate_radps="of the road wheels, negative for no limit",
    hold_mps2="brake that holds a standing car, 0 for none",
    off_road_ends=("i8", "1 when leaving the road ends an episode"),
    wrong_way_s="driving against the lane for longer ends an episode",
    success_share="mean speed over the allowed speed that a success requires",
    behind_s="largest time behind a car at that speed at the end of a success",
    keep_lane=("i8", "1 when the car must keep its lane"),
    max_speed_mps="taken where a lane has no limit",
    reason_none=("i8", "code of AlertReason.NONE"),
    reason_at=("i8", "code of AlertReason.PL_AT"),
    reason_ct=("i8", "code of AlertReason.PL_CT"),
    reason_both=("i8", "code of AlertReason.BOTH"),
    mode_given=("i8", "code of Mode for a position that is given"),
    rtk_given=("i8", "code of RtkStatus for a position that is given"),
    pl_most_m="protection levels are shown up to here",
    shown=("i8", "what is shown of integrity: FULL, BLIND, or ORACLE, by which the truth is shown"),
    sees_truth=("i8", "1 where the ego perceives the traffic as it is"),
    rewards=(REWARD_WEIGHTS, "weights of the terms"),
    costs=(COST_FIGURES, "weights and figures of the costs"),
)
