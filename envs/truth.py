"""The true state in the form of a belief, for scoring and for columns of logs only. Agents must not use it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lanebound.envs.batch.costs_kernel import lead_of
from lanebound.envs.batch.perception_kernel import see_truth
from lanebound.envs.batch.records_kernel import PERCEIVED
from lanebound.envs.batch.view_kernel import true_view
from lanebound.envs.belief_loop import BeliefLoop
from lanebound.integrity.core.records import Records

__all__ = ["TrueLead", "true_lead"]


class TrueLead(NamedTuple):
    """The vehicle next ahead in the ego's lane: gap between bumpers [m], and its speed [m/s]."""

    gap_m: float
    speed_mps: float


def true_lead(loop: BeliefLoop) -> TrueLead | None:
    """The vehicle that the ego truly follows, None for none."""
    belief, traffic = _true_belief(loop), _true_traffic(loop)
    lanes, length = loop.episodes.table.lanes, float(loop.ego.LENGTH)
    lead, gap = lead_of(belief[0], traffic, traffic.size, length, lanes)
    return None if lead < 0 else TrueLead(float(gap), float(traffic["speed_mps"][lead]))


def _true_belief(loop: BeliefLoop) -> Records:
    e = loop.episodes
    loop.belief()  # brings the records up to date
    view: Records = e.ego["belief"].copy()
    true_view(e.cars[0, 0], e.table.lanes, e.path_of[0], e.rules[0], view[0])
    return view


def _true_traffic(loop: BeliefLoop) -> Records:
    loop.seats.read(full=True)
    e = loop.episodes
    cars = e.cars[0, : int(e.ego["vehicles"][0])]
    seen = np.zeros(cars.size, PERCEIVED)
    count = see_truth(cars, float(cars["x"][0]), float(cars["y"][0]), True, seen)
    return seen[:count]
