"""The declaration of a fault kind: one record that validation, random faults, the fault campaign and the docs follow.

A kind of your own is a :class:`FaultKind` with an effect function, given to
:func:`~lanebound.integrity.sensors.fault_registry.register_fault`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sky.view import SkyView

if TYPE_CHECKING:
    from lanebound.integrity.sensors.faults import Fault

__all__ = ["MAGNITUDE_FIELDS", "FaultKind", "FaultMoment", "FaultPrior", "FaultTarget", "Magnitude", "Profile"]

Profile = Literal["step", "ramp"]
MAGNITUDE_FIELDS = (
    "magnitude", "magnitude_m", "magnitude_cycles", "magnitude_rank", "magnitude_db", "magnitude_degps",
    "magnitude_ratio",
)  # fmt: skip
"""Fields of a fault that hold a magnitude; the first has no unit of its own."""
PLACES = ("system", "prn", "band", "vehicle")  # fields of a fault that are None by default


class FaultTarget(Enum):
    """What a fault of a kind strikes, where it is drawn at random or placed by the fault campaign."""

    SATELLITE = "one satellite"
    SYSTEM = "a satellite system"
    STREET = "all vehicles of the street"
    VEHICLE = "one vehicle"


@dataclass(frozen=True)
class Magnitude:
    """A size that faults of a kind have.

    Attributes
    ----------
    unit : unit, for messages and tables
    field : field of :class:`~.faults.Fault` that holds it; ``magnitude`` has no unit of its own
    ge, gt, le : bounds (>=, >, <=); None: no bound
    signed : random faults take either sign
    whole : an integer

    Raises
    ------
    ConfigError
        There is no such field, or random faults would take a sign that the bounds refuse.
    """

    unit: str
    field: str = "magnitude"
    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    signed: bool = True
    whole: bool = False

    def __post_init__(self) -> None:
        if self.field not in MAGNITUDE_FIELDS:
            raise ConfigError(f"field must be one of {', '.join(MAGNITUDE_FIELDS)}, got {self.field!r}: correct it")
        lowest = self.ge if self.gt is None else self.gt
        if self.signed and lowest is not None and lowest >= 0.0:
            raise ConfigError(f"signed must be False where a magnitude must be >= {lowest:g}, got True: correct it")

    def admits(self, value: float) -> bool:
        """Whether a value keeps the bounds."""
        return not (
            (self.ge is not None and value < self.ge)
            or (self.gt is not None and value <= self.gt)
            or (self.le is not None and value > self.le)
            or (self.whole and value != round(value))
        )

    @property
    def bounds(self) -> str:
        """The bounds in words, as in "an integer >= 0"; "any number" without bounds."""
        signs = [
            f"{sign} {limit:g}"
            for sign, limit in ((">=", self.ge), (">", self.gt), ("<=", self.le))
            if limit is not None
        ]
        return " ".join([*(["an integer"] if self.whole else []), " and ".join(signs)]).strip() or "any number"


class FaultPrior(Config):
    """How often a kind of fault begins (Poisson), how long it lasts (lognormal) and how large it is (uniform)."""

    per_h: float = Field(0.0, ge=0, description="onsets of each target (satellite, system or vehicle) [1/h]")
    median_s: float = Field(30.0, gt=0, description="median length [s]")
    log_sd: float = Field(0.8, ge=0, description="1-sigma of the length's logarithm [-]")
    low: float = Field(0.0, ge=0, description="smallest magnitude, in the unit of the kind")
    high: float = Field(0.0, ge=0, description="largest magnitude, in the unit of the kind")
    ramp_share: float = Field(0.5, ge=0, le=1, description="share of ramps, the rest are steps [-]")

    @model_validator(mode="after")
    def _range_is_ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low must be <= high, got {self.low} > {self.high}: exchange them")
        return self


NEVER = FaultPrior()


@dataclass(frozen=True)
class FaultMoment:
    """A fault in one epoch: what an effect function computes with.

    Attributes
    ----------
    fault : the fault
    time_s, dt_s : end and length of the epoch [s]
    sky : satellites in the epoch
    rows : vehicles that the fault strikes, a slice of the first axis of the effects
    level : share of the magnitude that is present, 0 to 1
    growth_per_s : rate of that share [1/s]; 0 for a step, because a jump is no rate
    """

    fault: Fault
    time_s: float
    dt_s: float
    sky: SkyView
    rows: slice
    level: float
    growth_per_s: float

    @property
    def magnitude(self) -> float:
        """Size of the fault at this time, in the unit of its kind: ``level`` times the fault's magnitude."""
        return self.fault.size * self.level

    @property
    def begins(self) -> bool:
        """Whether this is the first epoch of the fault."""
        return self.fault.begins(self.time_s, self.dt_s)

    @property
    def satellites(self) -> NDArray[np.bool_]:
        """Satellites that the fault strikes, (S,): those of its system and number; all where it names no system."""
        system, prn = self.fault.system, self.fault.prn
        found = np.ones(self.sky.satellites, np.bool_) if system is None else np.asarray(self.sky.system == system)
        return found if prn is None else found & (self.sky.prn == prn)


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault.

    Attributes
    ----------
    name : the ``kind`` of a :class:`~.faults.Fault`
    summary : what the fault does to which measurement, for the docs
    apply : function of (:class:`~.effects.FaultEffects`, :class:`FaultMoment`) that adds the fault to the effects of an
        epoch in place; the effects of faults add up, factors multiply
    target : what a random fault strikes
    magnitudes : sizes that a fault of this kind has; at least one of them must be given. Random faults and the fault
        campaign set the first
    profiles : time profiles; a kind without "ramp" has its whole size at once, whatever the profile of the fault
    needs : fields of a fault that must be given, of ``system``, ``prn``, ``band`` and ``vehicle``
    sizes_tried : sizes in the fault campaign, in the unit of the first magnitude
    tried_with : further fields of a fault, with each of which the fault campaign tries each size
    lists_integers : errors of integers may be given by satellite, in place of a magnitude
    not_tried_because : reason why the fault campaign omits the kind
    in_blackout : the fault campaign tries the kind without satellites, because with satellites it has no effect
    broadcast : the fault changes what a vehicle broadcasts; the fault campaign judges what the receivers believe
    prior : rate and duration of random faults of the kind; by default there are none
    prior_source : source of the prior, for the docs

    Raises
    ------
    ConfigError
        A name that is no identifier, a function, target or profiles of another kind, a size beyond its bounds, or
        neither sizes to try nor a reason to omit them.
    """

    name: str
    summary: str
    apply: Callable[[FaultEffects, FaultMoment], None]
    target: FaultTarget = FaultTarget.VEHICLE
    magnitudes: tuple[Magnitude, ...] = ()
    profiles: tuple[Profile, ...] = ("step", "ramp")
    needs: tuple[str, ...] = ()
    sizes_tried: tuple[float, ...] = ()
    tried_with: tuple[Mapping[str, float], ...] = ({},)
    lists_integers: bool = False
    not_tried_because: str = ""
    in_blackout: bool = False
    broadcast: bool = False
    prior: FaultPrior = NEVER
    prior_source: str = ""

    def __post_init__(self) -> None:
        for wrong, message in (
            (not self.name.isidentifier(), f"name must be an identifier, got {self.name!r}: write it as clock_jump"),
            (not self.summary, "summary must say what the fault does, got nothing: the docs print it"),
            (not callable(self.apply), f"apply must be a function of effects and moment, got {self.apply!r}: give one"),
            (
                not isinstance(self.target, FaultTarget),
                f"target must be a FaultTarget, got {self.target!r}: write FaultTarget.SATELLITE",
            ),
            (
                not isinstance(self.profiles, tuple) or not set(self.profiles) <= {"step", "ramp"},
                f"profiles must be a tuple of 'step' and 'ramp', got {self.profiles!r}: correct it",
            ),
            ("step" not in self.profiles, f"profiles must contain 'step', got {self.profiles}: add it"),
            (not set(self.needs) <= set(PLACES), f"needs must be of {', '.join(PLACES)}, got {self.needs}: correct it"),
        ):
            if wrong:
                raise ConfigError(f"fault kind {self.name!r}: {message}")
        self._check_sizes()

    def _check_sizes(self) -> None:
        of, tried = self.magnitude, self.sizes_tried
        if of is None and tried:
            raise ConfigError(f"fault kind {self.name!r}: sizes_tried must be empty without a magnitude, got {tried}")
        if of is not None and not tried and not self.not_tried_because:
            raise ConfigError(
                f"fault kind {self.name!r}: sizes_tried must hold the sizes of the fault campaign, got none: give "
                "them, or give the reason in not_tried_because"
            )
        if tried and self.not_tried_because:
            raise ConfigError(
                f"fault kind {self.name!r}: not_tried_because must be empty, got sizes_tried too: omit one"
            )
        for size in tried:
            if of is not None and (size == 0.0 or not of.admits(size)):
                raise ConfigError(f"fault kind {self.name!r}: sizes_tried must be {of.bounds} and not 0, got {size:g}")
        for name, size in (("low", self.prior.low), ("high", self.prior.high)) if self.prior.per_h > 0.0 else ():
            if of is not None and not of.admits(size):
                raise ConfigError(f"fault kind {self.name!r}: prior.{name} must be {of.bounds}, got {size:g}")

    @property
    def magnitude(self) -> Magnitude | None:
        """The first magnitude, in whose unit random faults and the fault campaign set sizes; None without any."""
        return self.magnitudes[0] if self.magnitudes else None

    @property
    def unit(self) -> str:
        """Unit of the first magnitude; "" without any."""
        return "" if self.magnitude is None else self.magnitude.unit
