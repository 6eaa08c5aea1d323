"""The engine's columns turned into the rows that infos are: one for each name, of all environments."""

from __future__ import annotations

from lanebound.envs.vector import columns_kernel as k
from lanebound.integrity.accel import jit

__all__ = ["NUMBERS", "fill_infos"]

# rows of ``numbers``: columns of ``out``, columns of ``belief``, limits, margins, the true speed
OF_OUT = (
    k.O_COST, *range(k.O_CAUSES, k.O_CAUSES + k.CAUSES), k.O_TTA, k.O_ERR_AT, k.O_ERR_CT, k.O_HMI_SHARE, k.O_TURN_RATE,
    *range(k.O_TERMS, k.O_TERMS + k.TERMS),
)  # fmt: skip
BELIEVED = len(OF_OUT)
NUMBERS = BELIEVED + 7
# rows of ``flags``, true where positive: columns of ``out``, then of ``belief``; rows of ``codes``
FLAGS_OF_OUT = (
    k.O_MI, k.O_HMI, k.O_IS_CRASHED, k.O_CRASHED_NOW, k.O_OFF_ROAD, k.O_WRONG_WAY, k.O_ASTRAY_NOW, k.O_SUCCESS,
)  # fmt: skip
FLAGS_OF_BELIEF = (k.B_ALERT, k.B_AVAILABLE)
CODES = (k.B_MODE, k.B_REASON)


@jit
def fill_infos(told, out, belief, cars, limits, numbers, flags, codes):  # type: ignore[no-untyped-def]
    """Fill numbers (NUMBERS, N), flags (10, N), codes (2, N) of environments that are ``told`` (N,) of, 0 elsewhere.

    limits (2,): alert limits along and across [m].
    """
    numbers[:, :], flags[:, :], codes[:, :] = 0.0, False, 0
    for e in range(told.shape[0]):
        if not told[e]:
            continue
        for n in range(len(OF_OUT)):
            numbers[n, e] = out[e, OF_OUT[n]]
        for axis in range(2):
            level = belief[e, k.B_PL_AT + axis]
            numbers[BELIEVED + axis, e], numbers[BELIEVED + 2 + axis, e] = level, limits[axis]
            numbers[BELIEVED + 4 + axis, e] = limits[axis] - level
        numbers[BELIEVED + 6, e] = cars[e, k.SPEED, 0]
        for n in range(len(FLAGS_OF_OUT)):
            flags[n, e] = out[e, FLAGS_OF_OUT[n]] > 0.0
        for n in range(len(FLAGS_OF_BELIEF)):
            flags[len(FLAGS_OF_OUT) + n, e] = belief[e, FLAGS_OF_BELIEF[n]] > 0.0
        for n in range(len(CODES)):
            codes[n, e] = int(belief[e, CODES[n]])
