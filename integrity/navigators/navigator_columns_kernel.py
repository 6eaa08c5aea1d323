"""The flat columns of a navigator: its state ``x`` (NX,), solution ``out`` (NO,) and declared figures ``par`` (NP,).

Those of what reckons since an RTK position stand at the end.
"""

from lanebound.integrity.monitoring.jump_kernel import DOUBT_SIZE
from lanebound.integrity.positioning.odometer_watch_kernel import LIMITS, WATCH_SIZE

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
