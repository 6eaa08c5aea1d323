"""Where the margins of ``cautious`` were tuned, and where it drives with some that nobody fitted to the place.

The preset is read as it stands: to list the agents must not take what validates it.
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
    """Base of the world and sky of all places that margins were found for; faults were none there."""
    import yaml

    found = yaml.safe_load(files("lanebound.configs").joinpath(PRESET).read_text(encoding="utf-8"))
    return tuple((base, sky) for base, skies in found["at"].items() for sky in skies)


def is_untuned(chosen: AgentConfig, place: Place) -> bool:
    """Whether an agent is to be tuned and was not at this place; with figures of its own it is what they say."""
    if chosen.agent != TUNED_AGENT or chosen.figures:
        return False
    return place.faults != NO_FAULTS or (_base(place.env), place.sky) not in tuned_places()


def _base(env: str) -> str:
    """The world that an environment is made on; those of highway-env are their own."""
    from lanebound.agents.episodes.opening import full_id
    from lanebound.envs import IDS, make_config

    env_id = full_id(env)
    return make_config(env_id).base if env_id in IDS else env_id
