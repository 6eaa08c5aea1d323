"""What the starts of N episodes draw beside the traffic: cities, hours, shifts of maps, first positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.streams import named_generator

__all__ = ["Scenes", "draw_scenes"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
FLEET_SEEDS = 2**62  # as set_scene draws them
STARTS = 2  # of a fleet: when it enters the world, and again when it is put back for its approach


@dataclass(frozen=True)
class Scenes:
    """Draws of n episodes of M navigating vehicles.

    Attributes
    ----------
    layout, hour, fleet_seed : (n,) city, hour of the constellations, seed of the others' instruments
    map_shift : (n, 2) standard normal, of each ego's map
    noise : (n M, 3) standard normal, of the first positions and headings
    """

    layout: Rows
    hour: Rows
    fleet_seed: Rows
    map_shift: Array
    noise: Array


def draw_scenes(seeds: Sequence[int], layouts: int, hours: int, crew: NDArray[np.bool_], sensed: bool) -> Scenes:
    """Draw as ``set_scene``, ``Cockpit`` and ``Fleet`` do, in their order, by the seeds of the episodes.

    crew (n, M - 1): places of the others that a vehicle has taken; zeros are drawn for the rest. ``sensed``: the egos'
    own places are, and so their maps have a shift.
    """
    drawn = np.zeros((3, len(seeds)), dtype=np.int64)
    shift, noise = np.zeros((len(seeds), 2)), np.zeros((len(seeds), 1 + crew.shape[1], 3))
    for n, seed in enumerate(seeds):
        scene, start = named_generator(seed, "scene"), named_generator(seed, "start")
        drawn[:, n] = [scene.integers(below) for below in (layouts, hours, FLEET_SEEDS)]
        if sensed:
            shift[n], noise[n, 0] = start.standard_normal(2), start.standard_normal(3)
        if others := int(crew[n].sum()):
            drawn_noise = named_generator(int(drawn[2, n]), "start").standard_normal((STARTS, others, 3))
            noise[n, 1 : 1 + others] = drawn_noise[STARTS - 1]
    return Scenes(drawn[0], drawn[1], drawn[2], shift, noise.reshape(-1, 3))
