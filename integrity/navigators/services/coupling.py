"""Stages of the coupling of code services with the position reckoned on, and the arrays that they work on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring.doppler_separation_kernel import SEPARATION
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import START, Epoch
from lanebound.integrity.navigators.rtk_reckoning.stages import SeparateStage
from lanebound.integrity.navigators.services.config import CodeServiceConfig, CouplingConfig
from lanebound.integrity.navigators.services.coupling_kernel import begin_coupling, lengthen, settle
from lanebound.integrity.navigators.services.coupling_records_kernel import (
    COUPLED,
    COUPLING_RULES,
    EXTRA,
    PROPOSAL,
    Coupling,
)

__all__ = [
    "BeginCouplingStage",
    "LengthenStage",
    "SettleStage",
    "coupling_of",
    "coupling_parameters",
    "coupling_rules",
    "initial_coupling",
    "proposals",
    "with_rules",
]

UNCOVERED, MOST_SETS = 0.25, 400  # share of the risk; all pairs of 28 satellites
LASTING, EXTRAS, PROPOSED = "coupling", "extra of coupling", "proposals of coupling"  # names of states


def coupling_rules(coupling: CouplingConfig, declared: CodeServiceConfig, dt_s: float) -> Records:
    """COUPLING_RULES (1,) of a coupling with one service.

    Smoothed codes stay as long as their mean, and as the multipath in it: the correlation of both has the sum of both
    times as its integral. Below ``creep`` the way over which multipath lasts takes longer than ``multipath_tau_s``.
    """
    errors, interval = declared.errors, max(declared.interval_s, dt_s)
    lasting = errors.multipath_tau_s + declared.smoothing_s
    return one_record(
        COUPLING_RULES,
        tight=coupling.kind == "tight",
        interval=interval,
        creep=max(errors.multipath_length_m / errors.multipath_tau_s, 1e-3),
        white=1.0 + 2.0 * lasting / interval,
        restart=coupling.restart,
        memory=coupling.memory(interval),
    )


def coupling_parameters(parameters: Records, cases: Records, rules: Records) -> Records:
    """PARAMETERS (1,) of a service, with rules that leave fewer sets of doubtful codes to no mode.

    A fault that no mode covers has a weight in the mean for longer than it lasts: ``memory`` times its probability
    counts, and may be half of the risk (:func:`~.coupling_kernel.fault_bound`).
    """
    own = parameters.copy()
    reflections = own["rtk"]["reflections"]
    reflections["sets"] = np.where(reflections["sets"] > 0, MOST_SETS, 0)
    least = float(cases["budget"].sum(-1).min())
    reflections["limit"] = np.minimum(reflections["limit"], UNCOVERED * least / rules["memory"])
    return own


def initial_coupling(batch: int, cases: int) -> dict[str, NDArray[Any]]:
    """What lasts of a coupling, by name."""
    return {LASTING: np.zeros(batch, COUPLED), EXTRAS: np.zeros((batch, cases), EXTRA)}


def proposals(rules: Records, parameters: Records, lasting: Mapping[str, Any], modes: int) -> Coupling:
    """A coupling of an epoch; ``modes`` is the number of fault modes."""
    coupled, extra = lasting[LASTING], lasting[EXTRAS]
    batch, cases = extra.shape
    return Coupling(
        rules=rules, parameters=parameters, coupled=coupled, extra=extra, proposals=np.zeros(batch, PROPOSAL),
        starts=np.zeros((batch, cases), START), separations=np.zeros((batch, modes), SEPARATION),
        extra_after=np.zeros((batch, cases), EXTRA),
    )  # fmt: skip


def coupling_of(states: Mapping[str, Any]) -> Coupling:
    """The coupling of this epoch."""
    found: Coupling = states[PROPOSED]
    return found


def with_rules(states: Mapping[str, Any], rules: Records, parameters: Records) -> Coupling:
    """The same with the rules of one service."""
    return coupling_of(states)._replace(rules=rules, parameters=parameters)


@dataclass(frozen=True)
class BeginCouplingStage(SeparateStage):
    """Nothing is proposed yet."""

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        begin_coupling(first, last, epoch, coupling_of(states))


@dataclass(frozen=True)
class LengthenStage(SeparateStage):
    """Before the levels of the position reckoned on: faults of velocities since the last whole position count."""

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        lengthen(first, last, epoch, coupling_of(states))


@dataclass(frozen=True)
class SettleStage(SeparateStage):
    """After a position was taken: what it leaves to dead reckoning, where it is a coupled one."""

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        settle(first, last, epoch, coupling_of(states))
