"""Random fault campaigns: how often each kind of fault begins, how long it lasts and how large it is."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.faults import SIZES, Fault, FaultKind
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.view import SkyView

__all__ = ["FaultPrior", "FaultPriors", "random_campaign"]

K = FaultKind


class FaultPrior(Config):
    """How one kind of fault comes: Poisson onsets at each target, lognormal length, uniform size of random sign."""

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


class FaultPriors(Config):
    """Priors by kind. Satellite figures are commitments of the system providers, road figures are argued."""

    satellite_range: FaultPrior = Field(
        FaultPrior(per_h=1e-5, median_s=600.0, low=5.0, high=100.0),
        description="GPS SPS PS 2020: 1e-5 per hour and satellite, error above 4.42 URA, ended within the hour",
    )
    constellation: FaultPrior = Field(
        FaultPrior(per_h=1e-4, median_s=600.0, low=5.0, high=100.0, ramp_share=1.0),
        description="ARAIM ADD v3: 1e-4 for Galileo and others (GPS 1e-8), wrong Earth orientation",
    )
    cycle_slip: FaultPrior = Field(
        FaultPrior(per_h=0.05, median_s=0.2, low=1, high=10, ramp_share=0.0),
        description="slips a receiver does not notice, per satellite; a few per day of urban driving",
    )
    reference_coordinates: FaultPrior = Field(
        FaultPrior(per_h=1e-5, median_s=3600.0, low=0.05, high=2.0, ramp_share=0.0),
        description="wrong reference coordinates; an operator's error every ten years of a station",
    )
    spoofing: FaultPrior = Field(
        FaultPrior(per_h=1e-5, median_s=60.0, low=5.0, high=50.0, ramp_share=1.0),
        description="drag-off; rare outside of known regions",
    )
    jamming: FaultPrior = Field(
        FaultPrior(per_h=0.2, median_s=10.0, low=5.0, high=40.0, ramp_share=1.0),
        description="privacy jammers; STRIKE3: 1,141 deliberate events at 8 airports in 30 days",
    )
    corrections_loss: FaultPrior = Field(
        FaultPrior(per_h=2.0, median_s=11.5), description="loss of the mobile network; outage length fits S1 section 5"
    )
    gyro_bias: FaultPrior = Field(
        FaultPrior(per_h=1e-4, median_s=600.0, low=0.1, high=2.0),
        description="jump of a MEMS bias, shock or temperature",
    )
    wheel_slip: FaultPrior = Field(
        FaultPrior(per_h=0.1, median_s=1.0, low=0.05, high=0.5, ramp_share=0.0),
        description="slippery patches beyond the slip of normal driving",
    )
    odometer_frozen: FaultPrior = Field(
        FaultPrior(per_h=1e-4, median_s=5.0),
        description="stuck bus message; ASIL B wheel-speed sensors aim at 1e-7 per hour",
    )
    v2v_lie: FaultPrior = Field(
        FaultPrior(per_h=1e-3, median_s=60.0, low=1.0, high=20.0), description="wrong or malicious broadcasts; argued"
    )

    @model_validator(mode="after")
    def _sizes_are_given(self) -> Self:
        for kind, names in SIZES.items():
            prior: FaultPrior = getattr(self, kind.value)
            if names and prior.per_h > 0.0 and prior.high == 0.0:
                raise ValueError(f"{kind.value}.high must be > 0 when per_h is, got 0: give low and high too")
        return self


def _targets(kind: FaultKind, sky: SkyView) -> list[dict[str, int | System]]:
    """What a kind of fault can strike: each satellite, each system, each vehicle, or the street as a whole."""
    if kind in (K.SATELLITE_RANGE, K.CYCLE_SLIP):
        return [{"system": System(int(s)), "prn": int(p)} for s, p in zip(sky.system, sky.prn, strict=True)]
    if kind is K.CONSTELLATION:
        return [{"system": System(int(s))} for s in np.unique(sky.system)]
    if kind in (K.REFERENCE_COORDINATES, K.JAMMING, K.SPOOFING):
        return [{}]
    return [{"vehicle": v} for v in range(sky.batch)]


def _magnitude(kind: FaultKind, prior: FaultPrior, generator: np.random.Generator) -> dict[str, float | int]:
    """A magnitude in the unit of the kind; negative in half the cases where a sign makes sense."""
    size, sign = generator.uniform(prior.low, prior.high), generator.choice([-1.0, 1.0])
    if not SIZES[kind]:
        return {}
    if kind is K.CYCLE_SLIP:
        return {"magnitude_cycles": int(sign) * max(1, round(size))}
    unsigned = kind in (K.JAMMING, K.WHEEL_SLIP)
    return {SIZES[kind][0]: size if unsigned else sign * size}


def _draw(
    kind: FaultKind,
    prior: FaultPrior,
    target: dict[str, int | System],
    duration_s: float,
    generator: np.random.Generator,
) -> Fault:
    length = prior.median_s * float(np.exp(prior.log_sd * generator.standard_normal()))
    profile: Literal["step", "ramp"] = "ramp" if generator.random() < prior.ramp_share else "step"
    return Fault.load(
        {
            "kind": kind,
            "start_s": generator.uniform(0.0, duration_s),
            "duration_s": length,
            "profile": profile,
            "ramp_s": 0.5 * length,
            "azimuth_deg": generator.uniform(0.0, 360.0),
            **target,
            **_magnitude(kind, prior, generator),
        }
    )


def random_campaign(
    priors_per_h: FaultPriors, duration_s: float, generator: np.random.Generator, sky: SkyView
) -> tuple[Fault, ...]:
    """Draw the faults of a run: for each kind and target a Poisson number of onsets, uniform over the run.

    Parameters
    ----------
    priors_per_h : rates by kind
    duration_s : length of the run [s]
    generator : stream "faults"
    sky : names the satellites and the number of vehicles

    Returns
    -------
    The faults in the order of their onset; give them to :class:`~.faults.FaultSchedule`.

    Raises
    ------
    InputError
        When ``duration_s`` is not positive.
    """
    if not duration_s > 0.0:
        raise InputError(f"duration_s must be positive, got {duration_s}: pass the length of the run in seconds")
    faults: list[Fault] = []
    for kind in FaultKind:
        prior: FaultPrior = getattr(priors_per_h, kind.value)
        targets = _targets(kind, sky)
        for target, count in zip(
            targets, generator.poisson(prior.per_h * duration_s / 3600.0, len(targets)), strict=True
        ):
            faults.extend(_draw(kind, prior, target, duration_s, generator) for _ in range(count))
    return tuple(sorted(faults, key=lambda f: f.start_s))
