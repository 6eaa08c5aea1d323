"""Columns of the flat arrays that hold N environments: one place for what every kernel of the engine reads and writes.

``cars`` (N, CAR, V) and ``whole`` (N, WHOLE, V) hold the vehicles, the ego first: a quantity of all vehicles of an
environment lies in one row, an environment in one block. ``belief`` (N, BELIEF) is what each ego knows of itself,
``score`` (N, SCORE) what those who judge remember, ``out`` (N, OUT) what a step has come to.
"""

from __future__ import annotations

from lanebound.integrity.core.accel import jit

# cars: true pose (x, y, heading, speed), cosine and sine of the heading, what the driver wants, what a crash displaces
X, Y, HEADING, SPEED, COS, SIN, TARGET_SPEED, TIMER, DELTA, IMPACT_X, IMPACT_Y, ACCELERATION = range(12)
CAR = 12
# whole: rows of the lanes that a vehicle is in and wants; flags; order along the road, its inverse, vehicle in front;
# whether there is a vehicle at all: those of an episode come first, the places after them are empty
LANE, TARGET, CRASHED, STRUCK, ORDER, RANK, FRONT, PRESENT = range(8)
WHOLE = 8

# belief
(
    B_X,
    B_Y,
    B_HEADING,
    B_SPEED,
    B_LANE,
    B_ALONG,
    B_LATERAL,
    B_ANGLE,
    B_WIDTH,
    B_TARGET_LANE,
    B_TARGET_SPEED,
    B_YAW_RATE,
    B_ACCELERATION,
    B_STEERING,
    B_PL_AT,
    B_PL_CT,
    B_AVAILABLE,
    B_ALERT,
    B_ALERT_AGE,
    B_REASON,
    B_MODE,
    B_RTK,
    B_HDOP,
    B_SATELLITES,
    B_DOPPLER,
    B_EXCLUDED,
    B_SINCE_RTK,
    B_SINCE_CALIBRATION,
    B_CORRECTIONS_AGE,
    B_WHEEL,
    B_THROTTLE,
    B_TURN,
) = range(32)
BELIEF = 32  # B_WHEEL: steering of the actuators; B_THROTTLE, B_TURN: acceleration and steering commanded directly

# score
(
    S_STEPS,
    S_TIME,
    S_CRASHED,
    S_AGAINST,
    S_PROGRESS,
    S_ALLOWED,
    S_HEADING,
    S_SPEED,
    S_ASTRAY,
    S_EPOCHS,
    S_MI,
    S_HMI,
    S_CORRIDOR,
    S_LEAVING,
    S_CHANGE,
) = range(15)
SCORE = 15

# out: numbers, then what is true where positive, then codes; each in the order in which infos name them
O_REWARD = 0
O_TERMS = 1  # first of TERMS
TERMS = 5
O_COST = 6
O_CAUSES = 7  # first of CAUSES
CAUSES = 7
O_TTA, O_ERR_AT, O_ERR_CT, O_HMI_SHARE, O_TURN_RATE = range(14, 19)
O_PL_AT, O_PL_CT, O_AL_AT, O_AL_CT, O_MARGIN_AT, O_MARGIN_CT, O_SPEED = range(19, 26)
(
    O_TERMINATED,
    O_TRUNCATED,
    O_MI,
    O_HMI,
    O_IS_CRASHED,
    O_CRASHED_NOW,
    O_OFF_ROAD,
    O_WRONG_WAY,
    O_ASTRAY_NOW,
    O_SUCCESS,
    O_ALERT,
    O_AVAILABLE,
) = range(26, 38)
O_MODE, O_REASON = range(38, 40)
O_FLAGS, O_CODES, OUT = O_TERMINATED, O_MODE, 40

# traffic (N, C, SEEN): what the ego perceives of C vehicles, nearest first
T_X, T_Y, T_HEADING, T_SPEED, T_PL_AT, T_PL_CT, T_AGE, T_LENGTH, T_WIDTH, T_RELATIVE = range(10)
SEEN = 10

# figures (FIGURES,) of the configuration
(
    F_STEP_S,
    F_POLICY_S,
    F_META,
    F_PERFECT,
    F_SPEED_MIN,
    F_SPEED_MAX,
    F_PURSUES,
    F_ACTUATED,
    F_LATERAL_MPS2,
    F_WHEEL_RATE,
    F_HOLD_MPS2,
    F_AL_AT,
    F_AL_CT,
    F_OFF_ROAD_ENDS,
    F_WRONG_WAY_S,
    F_SUCCESS_SHARE,
    F_DURATION_S,
    F_WORLD_DURATION_S,
    F_WORLD_TOLERANCE_S,
    F_WORLD_OFF_ROAD,
    F_END_M,
    F_AGAINST_ENDS,
    F_KEEP_LANE,
    F_RESPONSE_S,
    F_ACCELERATE,
    F_BRAKE_MIN,
    F_BRAKE_MAX,
    F_ALERT_SHARE,
    F_TTA_S,
    F_MAX_SPEED,
) = range(30)
F_REWARD_WEIGHTS = 30  # first of TERMS
F_COST_WEIGHTS = F_REWARD_WEIGHTS + TERMS  # first of CAUSES
F_BASE = F_COST_WEIGHTS + CAUSES  # first of the eight figures of the world's own reward
FIGURES = F_BASE + 8
NONE = -1.0  # no lane is left; no limit


@jit
def population(w):  # type: ignore[no-untyped-def]
    """How many vehicles an environment has, the ego included, by its ``whole`` (WHOLE, V)."""
    count = w.shape[1]
    while count > 1 and w[PRESENT, count - 1] == 0:
        count -= 1
    return count


@jit
def flag(condition):  # type: ignore[no-untyped-def]
    """How a truth value stands in a column: 1 or 0."""
    return 1.0 if condition else 0.0
