"""Faults with a start, a duration and a profile, and their schedule.

The kinds are declared in :mod:`.fault_registry`; :func:`~.fault_registry.register_fault` adds others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.fault_kinds import MAGNITUDE_FIELDS, FaultKind, FaultMoment, Magnitude, Profile
from lanebound.integrity.sensors.fault_registry import KindName, fault_kind
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.view import SkyView

__all__ = ["Fault", "FaultSchedule", "add_effects"]

Array = NDArray[np.float64]
ROUNDING_S = 1e-6  # epochs are sums of floating-point steps


NEEDED = {
    "system": f"give one of {', '.join(f'{int(system)} ({system.name})' for system in System)}",
    "prn": "give the number of the satellite, or use constellation for a whole system",
}
"""Remedies for fields without a value that a kind needs."""


class Fault(Config):
    """One fault. Its magnitude is given in the field of its kind; the other magnitudes are 0.

    A fault acts on the epochs that end in ``(start, start + duration]``. A step has its whole size at once; a ramp
    grows linearly during ``ramp_s`` and then stays. A kind that takes no ramps has its whole size at once in either
    profile. A cycle slip happens once, in the first of these epochs. A drift of ranges shows in the Doppler too; a step
    does not, because a jump is no rate.

    Raises
    ------
    ConfigError
        The kind is unknown, a magnitude is missing, of another kind or beyond its bounds, or the kind needs a field
        that is missing.
    """

    kind: KindName = Field(description="kind of the fault")
    start_s: float = Field(0.0, ge=0, description="onset [s]")
    duration_s: float = Field(10.0, gt=0, description="length [s]")
    profile: Profile = Field("step", description="how the magnitude comes about")
    ramp_s: float = Field(10.0, gt=0, description="time in which a ramp reaches the magnitude [s]")
    system: System | None = Field(None, description="satellite system that fails; needed by satellite faults")
    prn: int | None = Field(None, ge=1, description="satellite of that system; None: all of them")
    band: Literal[0, 1] | None = Field(None, description="band of a cycle slip; None: both")
    vehicle: int | None = Field(None, ge=0, description="row of the vehicle; None: all")
    azimuth_deg: float = Field(
        90.0, description="direction of a displacement, or side of the sky of nlos_burst, clockwise from North [deg]"
    )
    satellites: int = Field(4, ge=1, description="number of satellites that nlos_burst strikes")
    loss_db: float = Field(
        6.0, ge=0, description="loss of nlos_burst [dB]; 6: right- to left-handed signals at a patch antenna, metal"
    )
    integers: tuple[tuple[System, int, int, int], ...] = Field(
        (), description="errors of wrong_fix by satellite: system, number, cycles of the first and the second band"
    )
    magnitude: float = Field(0.0, description="size of a kind whose unit has no field here, in the unit of the kind")
    magnitude_m: float = Field(
        0.0, description="range error, displacement towards the azimuth, or twice the distance of a facade [m]"
    )
    magnitude_cycles: int = Field(0, description="size of a cycle slip, or error of an integer [cycles]")
    magnitude_rank: int = Field(0, description="rank by fit of the wrong integers that are accepted; 1: second best")
    magnitude_db: float = Field(0.0, description="loss of C/N0 by jamming [dB]")
    magnitude_degps: float = Field(0.0, description="yaw gyro bias, positive clockwise [deg/s]")
    magnitude_ratio: float = Field(
        0.0, description="wheel slip: distance counted is 1 + this; V2V: the PL broadcast is 1 + this [-]"
    )

    @model_validator(mode="after")
    def _fits_kind(self) -> Fault:
        kind, of = self.declaration, {magnitude.field: magnitude for magnitude in self.declaration.magnitudes}
        given = {name: getattr(self, name) for name in MAGNITUDE_FIELDS if getattr(self, name) != 0}
        for name, value in given.items():
            if name not in of:
                raise ValueError(f"{kind.name} has no {name}: {_remedy(of)}")
            if not of[name].admits(value):
                raise ValueError(f"{name} must be {of[name].bounds}, got {value}: correct that value")
        if self.integers and not kind.lists_integers:
            raise ValueError(f"{kind.name} has no integers: {_remedy(of)}")
        if of and not given and not self.integers:
            raise ValueError(f"{kind.name} needs {' or '.join(of)} other than 0: {_remedy(of)}")
        for name in kind.needs:
            if getattr(self, name) is None:
                raise ValueError(f"{kind.name} needs a {name}: {NEEDED.get(name, 'give it')}")
        return self

    @property
    def declaration(self) -> FaultKind:
        """The declaration of its kind."""
        return fault_kind(self.kind)

    @property
    def size(self) -> float:
        """The first magnitude of its kind, in the unit of the kind; 0 for a kind without."""
        magnitude = self.declaration.magnitude
        return 0.0 if magnitude is None else float(getattr(self, magnitude.field))

    def acts(self, time_s: float) -> bool:
        """Whether the epoch that ends at ``time_s`` is affected."""
        return self.start_s + ROUNDING_S < time_s <= self.start_s + self.duration_s + ROUNDING_S

    def begins(self, time_s: float, dt_s: float) -> bool:
        """Whether that epoch is the first one affected."""
        return self.acts(time_s) and time_s - dt_s <= self.start_s + ROUNDING_S

    def level(self, time_s: float) -> float:
        """Share of the magnitude that is present at ``time_s``, 0 to 1."""
        return min((time_s - self.start_s) / self.ramp_s, 1.0) if self._ramps else 1.0

    def growth_per_s(self, time_s: float) -> float:
        """Growth of that share [1/s]; 0 for a step, because a jump is no rate."""
        return 1.0 / self.ramp_s if self._ramps and time_s - self.start_s <= self.ramp_s else 0.0

    @property
    def _ramps(self) -> bool:
        return self.profile == "ramp" and "ramp" in self.declaration.profiles

    @property
    def direction_enu(self) -> Array:
        """Unit vector of a displacement, (3,)."""
        azimuth = math.radians(self.azimuth_deg)
        return np.array([math.sin(azimuth), math.cos(azimuth), 0.0])


def _remedy(of: Mapping[str, Magnitude]) -> str:
    """The field in which a kind has its magnitude, with its unit."""
    fields = " or ".join(f"{name} [{magnitude.unit}]" for name, magnitude in of.items())
    return f"give its size as {fields}" if of else "leave it out, this kind has no size"


def add_effects(effects: FaultEffects, acting: Sequence[Fault], time_s: float, dt_s: float, sky: SkyView) -> None:
    """Add those of faults that act on the epoch of length ``dt_s`` that ends at ``time_s``, in place.

    Raises
    ------
    InputError
        The function of a kind returns its effects.
    """
    for fault in acting:
        rows = slice(None) if fault.vehicle is None else slice(fault.vehicle, fault.vehicle + 1)
        level, growth = fault.level(time_s), fault.growth_per_s(time_s)
        apply: Callable[..., object] = fault.declaration.apply
        found = apply(effects, FaultMoment(fault, time_s, dt_s, sky, rows, level, growth))
        if found is not None:
            raise InputError(
                f"apply of fault kind {fault.kind!r} must change the effects in place and return nothing, got "
                f"{type(found).__name__}: write effects.code_bias_m[now.rows] += ..."
            )


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
        """Effects of the faults in the epoch of length ``dt_s`` that ends at ``time_s``; faults at one time add up.

        A fault of a satellite or vehicle that is not there has no effect.
        """
        acting = self.active(time_s) if self.faults else ()
        if not acting:
            return FaultEffects.none(batch, sky.satellites)
        effects = FaultEffects.blank(batch, sky.satellites)
        add_effects(effects, acting, time_s, dt_s, sky)
        return effects

    @property
    def span_s(self) -> tuple[float, float]:
        """First onset, and end of the last fault; (inf, -inf) without faults. No fault acts before or after it."""
        return float(self._start_s.min(initial=np.inf)), float(self._end_s.max(initial=-np.inf)) + ROUNDING_S

    def active(self, time_s: float) -> list[Fault]:
        """The faults that act on the epoch that ends at ``time_s``."""
        near = (self._start_s < time_s) & (time_s <= self._end_s + ROUNDING_S)
        return [self.faults[i] for i in np.flatnonzero(near) if self.faults[i].acts(time_s)]
