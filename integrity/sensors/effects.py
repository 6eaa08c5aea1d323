"""Effects of faults on the instruments in one epoch."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, record

__all__ = ["SIGNAL_EFFECTS", "VEHICLE_EFFECTS", "FaultEffects"]

Array = NDArray[np.float64]

SIGNAL_EFFECTS = record(
    code_bias_m="added to the code of both bands",
    phase_bias_m="added to the phase of both bands",
    range_rate_bias_mps="added to the Doppler range rate, the derivative of the phase bias",
    cn0_drop_db="subtracted from the carrier-to-noise density (jamming)",
    slip_cycles=("i8", (2,), "jump of the ambiguity in this epoch, which the receiver does not detect"),
    integer_error=("i8", (2,), "cycles by which the integers are wrong that positioning fixes and accepts"),
)
"""Effects of faults on a satellite's signal at a vehicle."""

VEHICLE_EFFECTS = record(
    next_best=("f8", (2,), "rank of the wrong integers that positioning accepts, 0 for none; their azimuth [rad]"),
    spoof_enu_m=("f8", (3,), "displacement of the position that the signals describe"),
    reference_enu_m=("f8", (3,), "error of the reference coordinates, by which RTK positions move"),
    corrections_lost=("?", "the reference link is cut"),
    gyro_bias_radps="added to the yaw gyro",
    odometer_scale="factor on the distance counted by the wheels, 1 = none",
    odometer_frozen=("?", "the odometer repeats its last message"),
    v2v_offset_enu_m=("f8", (3,), "added to the position a vehicle broadcasts"),
    v2v_pl_scale="factor on the protection levels it broadcasts, 1 = none",
)
"""Effects of faults on the rest of a vehicle."""


@dataclass(frozen=True)
class FaultEffects:
    """Effects of faults on B vehicles and S satellites in an epoch; biases are 0 and factors 1 without a fault.

    Attributes
    ----------
    signals, vehicles : (B, S) of SIGNAL_EFFECTS and (B,) of VEHICLE_EFFECTS
    code_bias_m to integer_error : the fields of ``signals``, (B, S) and (B, S, 2), which effect functions change in
        place
    next_best to v2v_pl_scale : those of ``vehicles``, (B,), (B, 2) and (B, 3)
    """

    signals: Records
    vehicles: Records
    code_bias_m: Array = field(init=False, repr=False)
    phase_bias_m: Array = field(init=False, repr=False)
    range_rate_bias_mps: Array = field(init=False, repr=False)
    cn0_drop_db: Array = field(init=False, repr=False)
    slip_cycles: NDArray[np.int64] = field(init=False, repr=False)
    integer_error: NDArray[np.int64] = field(init=False, repr=False)
    next_best: Array = field(init=False, repr=False)
    spoof_enu_m: Array = field(init=False, repr=False)
    reference_enu_m: Array = field(init=False, repr=False)
    corrections_lost: NDArray[np.bool_] = field(init=False, repr=False)
    gyro_bias_radps: Array = field(init=False, repr=False)
    odometer_scale: Array = field(init=False, repr=False)
    odometer_frozen: NDArray[np.bool_] = field(init=False, repr=False)
    v2v_offset_enu_m: Array = field(init=False, repr=False)
    v2v_pl_scale: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for records in (self.signals, self.vehicles):
            for name in records.dtype.names or ():
                object.__setattr__(self, name, records[name])

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
        vehicles = np.zeros(batch, VEHICLE_EFFECTS)
        vehicles["odometer_scale"] = vehicles["v2v_pl_scale"] = 1.0
        return cls(np.zeros((batch, satellites), SIGNAL_EFFECTS), vehicles)


@lru_cache(maxsize=64)
def _none(batch: int, satellites: int) -> FaultEffects:
    effects = FaultEffects.blank(batch, satellites)
    effects.signals.flags.writeable = effects.vehicles.flags.writeable = False
    return FaultEffects(effects.signals, effects.vehicles)
