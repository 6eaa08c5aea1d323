"""What an agent sees: bounded numbers built from belief, perceived traffic, map and predicted sky, never from truth."""

from __future__ import annotations

from lanebound.envs.observation.build import Observation, Observer
from lanebound.envs.observation.config import ObservationConfig
from lanebound.envs.observation.index import (
    GROUPS,
    OBSERVATION_INDEX,
    Entry,
    Observed,
    describe,
    entries,
    group_slices,
    register_entry,
    withdraw_entry,
)

__all__ = [
    "GROUPS",
    "OBSERVATION_INDEX",
    "Entry",
    "Observation",
    "ObservationConfig",
    "Observed",
    "Observer",
    "describe",
    "entries",
    "group_slices",
    "register_entry",
    "withdraw_entry",
]
