"""Effects of faults on the instruments in one epoch."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError

__all__ = ["FaultEffects"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FaultEffects:
    """Effects of faults on B vehicles and S satellites in an epoch; biases are 0 and factors 1 without a fault.

    Attributes
    ----------
    code_bias_m, phase_bias_m : (B, S) added to the code and the phase of both bands
    range_rate_bias_mps : (B, S) added to the Doppler range rate, the derivative of the phase bias
    cn0_drop_db : (B, S) subtracted from the carrier-to-noise density (jamming)
    slip_cycles : (B, S, 2) int64, jump of the ambiguity in this epoch, which the receiver does not detect
    integer_error : (B, S, 2) int64, cycles by which the integers are wrong that positioning fixes and accepts
    next_best : (B, 2) rank of the wrong integers that positioning accepts (:mod:`.wrong_fix_kernel`), 0 for none, and
        azimuth of the displacement that they mean [rad]
    spoof_enu_m : (B, 3) displacement of the position that the signals describe
    reference_enu_m : (B, 3) error of the reference coordinates, by which RTK positions move
    corrections_lost : (B,) bool, the reference link is cut
    gyro_bias_radps : (B,) added to the yaw gyro
    odometer_scale : (B,) factor on the distance counted by the wheels, 1 = none
    odometer_frozen : (B,) bool, the odometer repeats its last message
    v2v_offset_enu_m : (B, 3) added to the position a vehicle broadcasts
    v2v_pl_scale : (B,) factor on the protection levels it broadcasts, 1 = none
    """

    code_bias_m: Array
    phase_bias_m: Array
    range_rate_bias_mps: Array
    cn0_drop_db: Array
    slip_cycles: NDArray[np.int64]
    integer_error: NDArray[np.int64]
    next_best: Array
    spoof_enu_m: Array
    reference_enu_m: Array
    corrections_lost: NDArray[np.bool_]
    gyro_bias_radps: Array
    odometer_scale: Array
    odometer_frozen: NDArray[np.bool_]
    v2v_offset_enu_m: Array
    v2v_pl_scale: Array

    @classmethod
    def none(cls, batch: int, satellites: int) -> FaultEffects:
        """The effects without a fault: shared, read-only arrays, made once for each (B, S)."""
        return _none(batch, satellites)

    @classmethod
    def blank(cls, batch: int, satellites: int) -> FaultEffects:
        """The effects without a fault, as new arrays that effect functions change.

        Raises
        ------
        InputError
            When ``batch`` or ``satellites`` is negative.
        """
        if batch < 0 or satellites < 0:
            raise InputError(f"batch and satellites must be >= 0, got {batch} and {satellites}: pass array sizes")
        b, s = batch, satellites
        return cls(
            code_bias_m=np.zeros((b, s)),
            phase_bias_m=np.zeros((b, s)),
            range_rate_bias_mps=np.zeros((b, s)),
            cn0_drop_db=np.zeros((b, s)),
            slip_cycles=np.zeros((b, s, 2), dtype=np.int64),
            integer_error=np.zeros((b, s, 2), dtype=np.int64),
            next_best=np.zeros((b, 2)),
            spoof_enu_m=np.zeros((b, 3)),
            reference_enu_m=np.zeros((b, 3)),
            corrections_lost=np.zeros(b, dtype=np.bool_),
            gyro_bias_radps=np.zeros(b),
            odometer_scale=np.ones(b),
            odometer_frozen=np.zeros(b, dtype=np.bool_),
            v2v_offset_enu_m=np.zeros((b, 3)),
            v2v_pl_scale=np.ones(b),
        )


@lru_cache(maxsize=64)
def _none(batch: int, satellites: int) -> FaultEffects:
    effects = FaultEffects.blank(batch, satellites)
    for field in fields(effects):
        getattr(effects, field.name).flags.writeable = False
    return effects
