"""Column ``headway_s`` of the logs of episodes: time to the vehicle ahead."""

import math

from lanebound.agents.episodes.columns import Column, Moment, register_column
from lanebound.envs.truth import true_lead


def headway_s(moment: Moment) -> float:
    """True gap over true speed; inf without a vehicle ahead, or at rest."""
    loop, speed = moment.env.belief_loop, moment.info["speed_mps"]
    lead = true_lead(loop) if loop is not None else None
    return lead.gap_m / speed if lead is not None and speed > 0.0 else math.inf


register_column(Column("headway_s", "float", "s", "true time to the vehicle ahead; inf without", headway_s))
