"""Faults of any instrument, each with a start, a duration and a profile, and campaigns drawn from priors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.view import SkyView

__all__ = ["Fault", "FaultKind", "FaultSchedule"]

Array = NDArray[np.float64]
ROUNDING_S = 1e-6  # epochs are sums of floating-point steps


class FaultKind(Enum):
    """What can go wrong."""

    SATELLITE_RANGE = "satellite_range"
    CONSTELLATION = "constellation"
    CYCLE_SLIP = "cycle_slip"
    REFERENCE_COORDINATES = "reference_coordinates"
    SPOOFING = "spoofing"
    JAMMING = "jamming"
    CORRECTIONS_LOSS = "corrections_loss"
    GYRO_BIAS = "gyro_bias"
    WHEEL_SLIP = "wheel_slip"
    ODOMETER_FROZEN = "odometer_frozen"
    V2V_LIE = "v2v_lie"


K = FaultKind
SIZES: dict[FaultKind, tuple[str, ...]] = {
    K.SATELLITE_RANGE: ("magnitude_m",),
    K.CONSTELLATION: ("magnitude_m",),
    K.CYCLE_SLIP: ("magnitude_cycles",),
    K.REFERENCE_COORDINATES: ("magnitude_m",),
    K.SPOOFING: ("magnitude_m",),
    K.JAMMING: ("magnitude_db",),
    K.CORRECTIONS_LOSS: (),
    K.GYRO_BIAS: ("magnitude_degps",),
    K.WHEEL_SLIP: ("magnitude_ratio",),
    K.ODOMETER_FROZEN: (),
    K.V2V_LIE: ("magnitude_m", "magnitude_ratio"),
}
"""Which magnitudes a kind has; at least one of them must be given."""
MAGNITUDES = ("magnitude_m", "magnitude_cycles", "magnitude_db", "magnitude_degps", "magnitude_ratio")


class Fault(Config):
    """One fault. Its magnitude is given in the unit of its kind; the others stay 0.

    It acts on the epochs that end in ``(start, start + duration]``. A step is there at once; a ramp grows linearly
    during ``ramp_s`` and then stays. A cycle slip happens once, in the first of these epochs. What drifts shows in the
    Doppler too; a step does not, its jump is no rate.
    """

    kind: FaultKind = Field(description="what goes wrong")
    start_s: float = Field(0.0, ge=0, description="onset [s]")
    duration_s: float = Field(10.0, gt=0, description="length [s]")
    profile: Literal["step", "ramp"] = Field("step", description="how the magnitude comes about")
    ramp_s: float = Field(10.0, gt=0, description="time in which a ramp reaches the magnitude [s]")
    system: System | None = Field(None, description="satellite system that fails; needed by satellite faults")
    prn: int | None = Field(None, ge=1, description="satellite of that system; None: all of them")
    band: Literal[0, 1] | None = Field(None, description="band of a cycle slip; None: both")
    vehicle: int | None = Field(None, ge=0, description="row of the vehicle; None: all")
    azimuth_deg: float = Field(90.0, description="direction of a displacement, clockwise from North [deg]")
    magnitude_m: float = Field(0.0, description="range error, or displacement towards the azimuth [m]")
    magnitude_cycles: int = Field(0, description="size of a cycle slip [cycles]")
    magnitude_db: float = Field(0.0, ge=0, description="loss of C/N0 by jamming [dB]")
    magnitude_degps: float = Field(0.0, description="yaw gyro bias, positive clockwise [deg/s]")
    magnitude_ratio: float = Field(
        0.0, gt=-1, description="wheel slip: distance counted is 1 + this; V2V: the PL broadcast is 1 + this [-]"
    )

    @model_validator(mode="after")
    def _magnitude_fits_kind(self) -> Fault:
        given = [name for name in MAGNITUDES if getattr(self, name) != 0]
        wanted = SIZES[self.kind]
        wrong = [name for name in given if name not in wanted]
        if wrong:
            raise ValueError(f"{self.kind.value} has no {wrong[0]}: leave it 0")
        if wanted and not given:
            raise ValueError(f"{self.kind.value} needs {' or '.join(wanted)} other than 0")
        if self.kind in (K.SATELLITE_RANGE, K.CONSTELLATION, K.CYCLE_SLIP) and self.system is None:
            raise ValueError(f"{self.kind.value} needs a system")
        if self.kind is K.SATELLITE_RANGE and self.prn is None:
            raise ValueError("satellite_range needs a prn: use constellation for a whole system")
        return self

    def acts(self, time_s: float) -> bool:
        """Whether the epoch that ends at ``time_s`` is affected."""
        return self.start_s + ROUNDING_S < time_s <= self.start_s + self.duration_s + ROUNDING_S

    def begins(self, time_s: float, dt_s: float) -> bool:
        """Whether that epoch is the first one affected."""
        return self.acts(time_s) and time_s - dt_s <= self.start_s + ROUNDING_S

    def level(self, time_s: float) -> float:
        """Share of the magnitude present at ``time_s``, 0 to 1."""
        return 1.0 if self.profile == "step" else min((time_s - self.start_s) / self.ramp_s, 1.0)

    def growth_per_s(self, time_s: float) -> float:
        """Growth of that share; 0 for a step, whose jump is no rate."""
        return 1.0 / self.ramp_s if self.profile == "ramp" and time_s - self.start_s <= self.ramp_s else 0.0

    @property
    def direction_enu(self) -> Array:
        """Unit vector of a displacement, (3,)."""
        azimuth = math.radians(self.azimuth_deg)
        return np.array([math.sin(azimuth), math.cos(azimuth), 0.0])


class FaultSchedule:
    """The faults of a run.

    Parameters
    ----------
    faults : any number of :class:`Fault`
    """

    def __init__(self, faults: Sequence[Fault] = ()) -> None:
        self.faults = tuple(faults)
        self._start_s = np.array([f.start_s for f in self.faults])
        self._end_s = np.array([f.start_s + f.duration_s for f in self.faults])

    def effects(self, time_s: float, dt_s: float, sky: SkyView, batch: int) -> FaultEffects:
        """What the faults do in the epoch of length ``dt_s`` that ends at ``time_s``; additive where they overlap.

        A fault of a satellite or vehicle that is not there does nothing.
        """
        acting = self.active(time_s) if self.faults else ()
        if not acting:
            return FaultEffects.none(batch, sky.satellites)
        effects = FaultEffects.blank(batch, sky.satellites)
        for fault in acting:
            _apply(fault, effects, time_s, dt_s, sky)
        return effects

    def active(self, time_s: float) -> list[Fault]:
        """The faults that act on the epoch that ends at ``time_s``."""
        near = (self._start_s < time_s) & (time_s <= self._end_s + ROUNDING_S)
        return [self.faults[i] for i in np.flatnonzero(near) if self.faults[i].acts(time_s)]


def _apply(fault: Fault, effects: FaultEffects, time_s: float, dt_s: float, sky: SkyView) -> None:
    rows = slice(None) if fault.vehicle is None else slice(fault.vehicle, fault.vehicle + 1)
    if fault.system is not None and fault.kind in (K.SATELLITE_RANGE, K.CONSTELLATION, K.CYCLE_SLIP):
        _apply_to_signals(fault, effects, time_s, dt_s, sky, rows)
        return
    level = fault.level(time_s)
    shift = fault.magnitude_m * level * fault.direction_enu
    match fault.kind:
        case K.REFERENCE_COORDINATES:
            effects.reference_enu_m[rows] += shift
        case K.SPOOFING:
            effects.spoof_enu_m[rows] += shift
            feigned_mps = fault.magnitude_m * fault.growth_per_s(time_s) * fault.direction_enu
            effects.range_rate_bias_mps[rows] -= (sky.los_enu @ feigned_mps)[sky.index[rows]]
        case K.JAMMING:
            effects.cn0_drop_db[rows] += fault.magnitude_db * level
        case K.CORRECTIONS_LOSS:
            effects.corrections_lost[rows] = True
        case K.GYRO_BIAS:
            effects.gyro_bias_radps[rows] += math.radians(fault.magnitude_degps) * level
        case K.WHEEL_SLIP:
            effects.odometer_scale[rows] *= 1.0 + fault.magnitude_ratio * level
        case K.ODOMETER_FROZEN:
            effects.odometer_frozen[rows] = True
        case _:
            effects.v2v_offset_enu_m[rows] += shift
            effects.v2v_pl_scale[rows] *= 1.0 + fault.magnitude_ratio * level


def _apply_to_signals(
    fault: Fault, effects: FaultEffects, time_s: float, dt_s: float, sky: SkyView, rows: slice
) -> None:
    """A satellite's clock drifts, a system's frame is displaced by d (``-e.d`` on each range), or a carrier slips."""
    hit = (sky.system == fault.system) & ((fault.prn is None) | (sky.prn == fault.prn))
    if fault.kind is K.CYCLE_SLIP:
        if fault.begins(time_s, dt_s):
            bands = slice(None) if fault.band is None else slice(fault.band, fault.band + 1)
            effects.slip_cycles[rows, :, bands] += fault.magnitude_cycles * hit[:, None]
        return
    size = np.broadcast_to(fault.magnitude_m * hit, (sky.batch, sky.satellites))
    if fault.kind is K.CONSTELLATION:
        size = -size * (sky.los_enu[sky.index] @ fault.direction_enu)
    bias = size[rows] * fault.level(time_s)
    effects.code_bias_m[rows] += bias
    effects.phase_bias_m[rows] += bias
    effects.range_rate_bias_mps[rows] += size[rows] * fault.growth_per_s(time_s)
