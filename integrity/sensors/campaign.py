"""Random faults: how often each kind begins, how long it lasts and how large it is.

A run has as many faults as their rates give (:func:`random_campaign`), or exactly one (:func:`single_fault`), with the
weight and the probability by which means over such runs become means at the rates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import ConfigDict, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest
from lanebound.integrity.sensors.fault_kinds import FaultKind, FaultPrior, FaultTarget, Profile
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import Fault
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.view import SkyView

__all__ = ["FaultPriors", "SingleFault", "random_campaign", "single_fault"]


class FaultPriors(Config):
    """Priors by kind: an entry for each registered kind, by default the prior that the kind declares.

    Raises
    ------
    ConfigError
        A name is not that of a registered kind, or a kind with a magnitude can begin without any size.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, FaultPrior]

    @model_validator(mode="before")
    @classmethod
    def _one_of_each_kind(cls, given: Any) -> Any:
        if not isinstance(given, Mapping):
            return given
        priors = {kind.name: kind.prior for kind in fault_kinds()}
        unknown = next((name for name in given if name not in priors), None)
        if unknown is not None:
            raise ValueError(f"{unknown} is not a known key: {nearest(unknown, priors)}")
        return {**priors, **given}

    @model_validator(mode="after")
    def _sizes_are_given(self) -> Self:
        for kind in fault_kinds():
            prior = self.of(kind)
            if kind.magnitudes and prior.per_h > 0.0 and prior.high == 0.0:
                raise ValueError(f"{kind.name}.high must be > 0 when per_h is, got 0: give low and high too")
        return self

    def of(self, kind: FaultKind) -> FaultPrior:
        """The prior of a kind."""
        return self.__pydantic_extra__[kind.name]


def _targets(kind: FaultKind, sky: SkyView) -> list[dict[str, int | System]]:
    """All that faults of a kind can strike: each satellite, each system, each vehicle, or the street as a whole."""
    match kind.target:
        case FaultTarget.SATELLITE:
            return [{"system": System(int(s)), "prn": int(p)} for s, p in zip(sky.system, sky.prn, strict=True)]
        case FaultTarget.SYSTEM:
            return [{"system": System(int(s))} for s in np.unique(sky.system)]
        case FaultTarget.STREET:
            return [{}]
        case FaultTarget.VEHICLE:
            return [{"vehicle": v} for v in range(sky.batch)]


def _magnitude(kind: FaultKind, prior: FaultPrior, generator: np.random.Generator) -> dict[str, float | int]:
    """The first magnitude of the kind; negative in half the cases where it is signed."""
    size, sign = generator.uniform(prior.low, prior.high), generator.choice([-1.0, 1.0])
    of = kind.magnitude
    if of is None:
        return {}
    if of.whole:
        size = max(1, round(size))
    return {of.field: type(size)(sign) * size if of.signed else size}


def _draw(
    kind: FaultKind,
    prior: FaultPrior,
    target: dict[str, int | System],
    duration_s: float,
    generator: np.random.Generator,
) -> Fault:
    length = prior.median_s * float(np.exp(prior.log_sd * generator.standard_normal()))
    profile: Profile = "ramp" if generator.random() < prior.ramp_share and "ramp" in kind.profiles else "step"
    return Fault.load(
        {
            "kind": kind.name,
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
    sky : satellites and number of vehicles

    Returns
    -------
    The faults in the order of their onset; give them to :class:`~.faults.FaultSchedule`.

    Raises
    ------
    InputError
        When ``duration_s`` is not positive.
    """
    _require_duration(duration_s)
    faults: list[Fault] = []
    for kind in fault_kinds():
        prior, targets = priors_per_h.of(kind), _targets(kind, sky)
        for target, count in zip(
            targets, generator.poisson(prior.per_h * duration_s / 3600.0, len(targets)), strict=True
        ):
            faults.extend(_draw(kind, prior, target, duration_s, generator) for _ in range(count))
    return tuple(sorted(faults, key=lambda f: f.start_s))


class SingleFault(NamedTuple):
    """The one random fault of a run, and what turns means over such runs into means at the rates of the priors.

    With X of a run, ``E[X] = P0 E[X | no fault] + P1 E[weight X | one] + r``, where ``r`` is of runs with two faults or
    more: between 0 and ``1 - P0 - P1`` for an X in [0, 1].

    Attributes
    ----------
    fault : the fault
    weight : probability of its kind, given exactly one fault, over that with which it was drawn [-]
    probability : P1, of exactly one fault in the run [-]
    none_probability : P0, of none [-]
    """

    fault: Fault
    weight: float
    probability: float
    none_probability: float


def single_fault(
    priors_per_h: FaultPriors, duration_s: float, generator: np.random.Generator, sky: SkyView
) -> SingleFault:
    """Draw exactly one fault of the vehicles of a sky or of what they share: each kind that occurs is equally likely.

    Importance sampling of a Poisson process: given one event, it is of kind k with the probability ``L_k / L`` and its
    onset is uniform; so are its targets, which have equal rates. Here k is one of K kinds with ``1 / K``, thus ``weight
    = K L_k / L``, ``P1 = L exp(-L)`` and ``P0 = exp(-L)``; L_k is the expected number of faults of the kind, L the sum.
    Onset, target, length and size are those of :func:`random_campaign`: the fault may begin at any time of the run, and
    none has begun before it.

    Parameters
    ----------
    priors_per_h : rates by kind
    duration_s : length of the run [s]
    generator : stream "faults"
    sky : satellites and number of vehicles, 1 for faults that strike a vehicle itself

    Raises
    ------
    InputError
        When ``duration_s`` is not positive, or no kind occurs.
    """
    _require_duration(duration_s)
    expected, able = [], []
    for kind in fault_kinds():
        prior, targets = priors_per_h.of(kind), _targets(kind, sky)
        # What a vehicle broadcasts does not change what it believes itself.
        if not kind.broadcast and prior.per_h > 0.0 and targets:
            able.append((kind, prior, targets))
            expected.append(prior.per_h * duration_s / 3600.0 * len(targets))
    if not able:
        raise InputError("priors_per_h must let a kind occur that is no broadcast, got 0 for all: set its per_h")
    k, total = int(generator.integers(len(able))), math.fsum(expected)
    kind, prior, targets = able[k]
    fault = _draw(kind, prior, targets[int(generator.integers(len(targets)))], duration_s, generator)
    none = math.exp(-total)
    return SingleFault(fault, len(able) * expected[k] / total, total * none, none)


def _require_duration(duration_s: float) -> None:
    if not duration_s > 0.0:
        raise InputError(f"duration_s must be positive, got {duration_s}: pass the length of the run in seconds")
