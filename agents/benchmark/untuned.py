"""The places for which the margins of ``cautious`` were tuned, and places without tuned margins.

The preset is read without validation, so that listing the agents stays fast.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lanebound.agents.benchmark.outcome import Place
    from lanebound.agents.benchmark.suite import AgentConfig

__all__ = ["is_untuned", "tuned_places"]

TUNED_AGENT, PRESET = "cautious", "drivers/cautious.yaml"
NO_FAULTS = "none"


@cache
def tuned_places() -> tuple[tuple[str, str], ...]:
    """Base of the world and sky of all places with tuned margins, without faults."""
    import yaml

    found = yaml.safe_load(files("lanebound.configs").joinpath(PRESET).read_text(encoding="utf-8"))
    return tuple((base, sky) for base, skies in found["at"].items() for sky in skies)


def is_untuned(chosen: AgentConfig, place: Place) -> bool:
    """Whether an agent has tuned margins, but none for this place; its own figures count as tuned."""
    if chosen.agent != TUNED_AGENT or chosen.figures:
        return False
    from lanebound.envs.registration import base_of

    return place.faults != NO_FAULTS or (base_of(place.env), place.sky) not in tuned_places()
