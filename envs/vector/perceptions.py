"""Whom N egos perceive by radio and sensor: what ``Perception`` is for one, over arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.perception import Claims, PerceptionConfig
from lanebound.envs.perception.tracks_kernel import AGE, N_COLUMNS, PL_AT, PL_CT
from lanebound.envs.vector.perceive_kernel import SENDS, hear_all, look_all, sum_up
from lanebound.envs.vector.step_kernel import World
from lanebound.integrity.core import streams_kernel as sk
from lanebound.integrity.core.streams import ZIGGURAT, Streams
from lanebound.integrity.navigators.solution import Solution

__all__ = ["Perceptions", "claims_of"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def claims_of(solution: Solution, vehicles: int) -> Array:
    """What the others of n environments of M vehicles would broadcast, (n, M - 1, 8): tracks, and whether they do."""
    c, table = Claims.of(solution), np.zeros((solution.batch, N_COLUMNS + 1))
    table[:, :2], table[:, 2], table[:, 3] = c.position_m, c.heading_rad, c.speed_mps
    table[:, PL_AT], table[:, PL_CT], table[:, SENDS] = c.pl_at_m, c.pl_ct_m, c.initialised
    return table.reshape(-1, vehicles, N_COLUMNS + 1)[:, 1:]


class Perceptions:
    """The egos' pictures of the traffic, epoch after epoch.

    Parameters
    ----------
    config : sources and their figures
    count, others : N egos, each among C others
    epoch_s : time between steps

    Attributes
    ----------
    hears, looks : whether the sources are the radio, a sensor, or both
    """

    def __init__(self, config: PerceptionConfig, count: int, others: int, epoch_s: float) -> None:
        v, s = config.v2v, config.sensor
        self.hears, self.looks = config.source in ("v2v", "both"), config.source in ("sensor", "both")
        self._epoch_s = epoch_s
        self._streams = Streams([0] * count)
        self._radio = np.array(
            [v.latency_s, v.jitter_s, v.latency_max_s, v.loss, v.range_m, epoch_s, v.rate_hz], dtype=np.float64
        )
        self._sensor = np.array(
            [s.range_m, math.radians(0.5 * s.field_of_view_deg), s.range_sigma_m, math.radians(s.bearing_sigma_deg),
             s.speed_sigma_mps, math.radians(s.heading_sigma_deg), s.bound_sigmas], dtype=np.float64
        )  # fmt: skip
        bounds = config.acceleration_bound_mps2, config.lateral_bound_mps2
        self._figures = np.array([config.drop_after_s, *bounds, math.sin(math.radians(config.course_bound_deg))])
        length = math.ceil(v.latency_max_s / epoch_s) + 2 if self.hears else 0
        heard = others if self.hears else 0
        self._epoch, self._sent = np.zeros((2, count), dtype=np.int64)
        self._broadcasts = np.zeros((count, length, heard, N_COLUMNS))
        self._arriving = np.zeros((count, length, heard), dtype=np.int64)
        self._origin = np.zeros((count, heard), dtype=np.int64)
        self._held = np.zeros((count, heard, N_COLUMNS))
        self._told, self._seen = np.full((2, count, others + 1, N_COLUMNS), np.inf)
        self._last_m = np.zeros((count, 2))
        self._there = np.ones((count, others + 1), dtype=np.bool_)

    def begin(self, rows: Rows, seeds: Sequence[int], there: NDArray[np.bool_]) -> None:
        """Start with silent radios and sensors that have seen nobody, under the episodes' seeds.

        there (n, C): whether the others' places are taken.
        """
        self._there[rows, 1:] = there
        for row, seed in zip(rows.tolist(), seeds, strict=True):
            self._streams.reseed(row, seed)
        self._epoch[rows], self._sent[rows] = 0, -1
        self._arriving[rows] = self._origin[rows] = -1
        self._held[rows] = 0.0
        self._held[rows, :, PL_AT : PL_CT + 1], self._held[rows, :, AGE] = np.inf, -np.inf
        self._told[rows] = self._seen[rows] = 0.0
        self._told[rows, :, AGE] = self._seen[rows, :, AGE] = np.inf
        self._last_m[rows] = 0.0

    def adopt(self, rows: Rows, other: Perceptions) -> None:
        """Go on as the egos ``rows`` of other perceptions do."""
        self._streams.adopt(rows, other._streams, rows)
        for mine, theirs in zip(self._arrays, other._arrays, strict=True):
            mine[rows] = theirs[rows]

    @property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return (
            self._epoch, self._sent, self._broadcasts, self._arriving, self._origin, self._held, self._told,
            self._seen, self._last_m, self._there,
        )  # fmt: skip

    def step(self, rows: Rows, time_s: Array, claims: Array, world: World) -> None:
        """One epoch of the egos ``rows`` (n,): others tell claims (n, C, 8) of themselves, sensors look.

        ``time_s`` (n,) of each episode; who is perceived is written into ``world.traffic`` and ``world.seen``.
        """
        if self.hears:
            spoken = claims.copy()
            spoken[..., SENDS] *= self._there[rows, 1:]
            hear_all(
                rows, self._radio, self._epoch, self._sent, time_s, spoken, world.cars,
                self._draw("v2v", rows, 2), self._broadcasts, self._arriving, self._origin, self._held,
                self._told,
            )  # fmt: skip
        if self.looks:
            noise = self._draw("sensor", rows, 4)
            look_all(
                rows, self._sensor, world.belief, world.cars, world.whole, noise, self._epoch_s, self._last_m,
                self._seen,
            )  # fmt: skip
        sum_up(rows, self._figures, self._told, self._seen, world.belief, world.traffic, world.seen)

    def _draw(self, name: str, rows: Rows, width: int) -> Array:
        """Draws (n, C + 1, width) for the vehicles there are, one after another, with zeros in empty places.

        The radio's are uniform, the sensor's normal.
        """
        states, there = self._streams.states(name), self._there[rows]
        own, out = states[rows], np.zeros((rows.size, there.shape[1], width))
        if name == "sensor":
            sk.normals_at(0, rows.size, own, there, ZIGGURAT, out)
        else:
            sk.uniforms_at(own, there, out)
        states[rows] = own
        return out
