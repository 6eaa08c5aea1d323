"""What the entries of ``info`` mean; the page of :class:`~lanebound.envs.core.DrivingEnv` says more.

:func:`register_info` adds one from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import remove_registered, require_new

if TYPE_CHECKING:
    from lanebound.envs.config import EnvConfig
    from lanebound.envs.observation import Observed

__all__ = [
    "EXCLUSION_INFO",
    "FAULT_INFO",
    "INFO",
    "InfoEntry",
    "info_entries",
    "own_info",
    "register_info",
    "withdraw_info",
]

INFO: dict[str, str] = {
    "cost": "weighted sum of the costs of this step",
    "costs": "the cost_* of this step, unweighted, as one vector in the order of lanebound.envs.costs.CAUSES",
    "cost_collision": "1 in the step of a crash",
    "cost_off_road": "1 in the step that ends the episode off the road, or against the traffic",
    "cost_lane": "true body beyond its lane, times distance [m2]",
    "cost_lane_integrity": "believed body and its protection level beyond the lane, times distance [m2]",
    "cost_headway": "time with less than the safe distance ahead, weighted by how much [s]",
    "cost_conflict": "peak severity of conflicts with vehicles whose courses cross, 1 at no time between both [-]",
    "cost_alert": "time driven too fast or changing lane while an alert is older than the time to alert [s]",
    "cost_hmi": "time with hazardously misleading information [s]",
    "cost_context": "time driven too fast or changing lane under a warning of the context monitor [s]",
    "cost_blocking": "time slower than the flow where no stop is right, times what lacks; 0 if it weighs 0 [s]",
    "cost_speeding": "time above the limit of the true lane, or of a closure beside it, times the share above [s]",
    "cost_route": "1 in the step in which the true car comes onto a road that does not lead to the goal [-]",
    "cost_gore": "time in which the true body is over a line near a fork; 0 if it weighs 0 [s]",
    "cost_overcharge": "1 where a geo-object is settled that is charged and that the true car has not driven [-]",
    "cost_undercharge": "1 where one is settled that is not charged and that it has driven [-]",
    "pl_at_m": "protection level along the track; inf without one [m]",
    "pl_ct_m": "protection level across the track; inf without one [m]",
    "al_at_m": "alert limit along the track [m]",
    "al_ct_m": "alert limit across the track [m]",
    "margin_at_m": "AL - PL along the track, safe when >= 0 [m]",
    "margin_ct_m": "AL - PL across the track, safe when >= 0 [m]",
    "alert": "the alert is on",
    "available": "no protection level exceeds its limit",
    "mode": "code of the source of the position, see Mode",
    "reason": "code of the alert's reason, see AlertReason",
    "tta_s": "time left to react to an alert: 1 s less its age; the TTA of S3 II.A ends with the alert [s]",
    "speed_mps": "true speed [m/s]",
    "rewards": "terms of the reward by name, unweighted",
    "err_at_m": "true error along the track, forward positive [m]",
    "err_ct_m": "true error across the track, right positive [m]",
    "mi": "misleading in an epoch of it: available, an error above its level but within its limit",
    "hmi": "hazardously misleading in an epoch of it: available, an error above its limit",
    "hmi_share": "share of the step's epochs that were",
    "crashed": "the true car has crashed",
    "crashed_now": "it did so in this step",
    "off_road": "its middle is off the road",
    "wrong_way": "it has driven against its lane for too long",
    "astray_now": "either of these two, and new in this step",
    "is_success": "the episode ends well here",
    "lost": "no lane leads from the true car's road to the goal; never where a network has none",
    "lost_now": "it has come onto such a road in this step",
    "wrong_road": "it is believed on another road; never without a lane sensor",
    "yaw_rate_radps": "true turn rate over the step [rad/s]",
}

FAULT_INFO: dict[str, str] = {
    "fault_kind": "place of the kind of the episode's fault in fault_kinds(), from 0",
    "fault_onset_s": "onset of the fault since the start of the episode [s]",
    "fault_weight": "probability of the kind at nominal rates, given one fault, over that of the draw [-]",
    "fault_probability": "of exactly one fault of the ego, or of what it shares, at nominal rates [-]",
    "no_fault_probability": "of none at nominal rates [-]",
}
"""Entries under ``faults: one``, the same in all steps of an episode."""

EXCLUSION_INFO: dict[str, str] = {
    "senders_excluded": "others whose broadcasts are excluded now, as ranges contradict them",
    "exclusion_reason": "of the last one: 1 nearer than it claims, 2 farther, 3 in another direction; 0 for none",
}
"""Entries under ``perception.source: cooperative``."""


@dataclass(frozen=True)
class InfoEntry:
    """A number of ``info`` from outside.

    Attributes
    ----------
    name, meaning : its key, and what it is, with the unit in brackets
    source : function that returns (N,) numbers for N environments
    """

    name: str
    meaning: str
    source: Callable[[Observed], NDArray[np.float64]]


_registered: list[InfoEntry] = []


def info_entries() -> tuple[InfoEntry, ...]:
    """Those that are registered."""
    return tuple(_registered)


def own_info(config: EnvConfig) -> dict[str, str]:
    """Names and meanings of the entries that not all environments have.

    They are of one fault, of excluded senders, and those that are registered.
    """
    of_fault = FAULT_INFO if config.faults.value == "one" else {}
    of_senders = EXCLUSION_INFO if config.perception.source == "cooperative" else {}
    return of_fault | of_senders | {entry.name: entry.meaning for entry in _registered}


def register_info(entry: InfoEntry) -> None:
    """Add a number to ``info``, for all environments that are made from now on.

    Raises
    ------
    InputError
        The name is taken or no identifier, or the source is no function.
    """
    require_new(
        "an entry of info", entry.name, {*INFO, *FAULT_INFO, *EXCLUSION_INFO, *(other.name for other in _registered)}
    )
    if not callable(entry.source):
        raise InputError(f"source of info.{entry.name} must be a function of Observed, got {entry.source!r}: give one")
    _registered.append(entry)


def withdraw_info(name: str) -> None:
    """Remove a registered entry; environments that exist already still show it.

    Raises
    ------
    InputError
        There is none of this name.
    """
    remove_registered("entry of info", name, _registered, lambda entry: entry.name)
