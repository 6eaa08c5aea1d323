"""Map matching: the link of a map on which a vehicle drives, from its position, heading and speed.

Three matchers share inputs, outputs and configuration: the nearest link, the weighted topological matcher of S5's kind,
and the hidden Markov matcher of Newson and Krumm. All take batches of vehicles; a vehicle's row depends on no other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.row_memory import EVERY, Memory, Rows
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, NearLinks, RoadMap

__all__ = [
    "HiddenMarkovConfig", "MapMatcher", "MapMatches", "MatchInputs", "MatcherKind", "MatchingConfig", "NearestLink",
    "TopologicalConfig", "TopologicalMatcher", "connectivity", "heading_agreement", "link_weights",
]  # fmt: skip

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STEADY_MPS = 2.0  # below this speed the direction of motion is not used; S5 section 3.2


class MatcherKind(StrEnum):
    """How positions are matched."""

    NEAREST = "nearest"
    TOPOLOGICAL = "topological"
    HIDDEN_MARKOV = "hidden_markov"


class TopologicalConfig(Config):
    """Weights of the topological matcher; only their ratios count.

    The form is that of weight-based matchers (Quddus 2003, Velaga 2009, and S5's source): heading, proximity and
    connection. The ratio of heading and distance is chosen: heading first, as in S5's fuzzy weights. Scale and
    connection are fitted on maps that no result uses (``agents.studies.context_drive``). A large connection keeps a
    wrong choice: it outweighs ``connection / distance * scale_m`` of distance.
    """

    heading: float = Field(0.4, ge=0, description="of the cosine of the difference of heading [-]; chosen")
    distance: float = Field(0.35, ge=0, description="of 1 - distance / scale_m, -1 at least [-]; chosen")
    scale_m: float = Field(15.0, gt=0, description="distance that has no weight [m]; fitted")
    connection: float = Field(0.05, ge=0, description="of links that the last link leads to [-]; fitted")


class HiddenMarkovConfig(Config):
    """Newson and Krumm 2009: normal emissions, exponential transitions."""

    beta_m: float = Field(
        3.0, gt=0, description="mean of |route distance - distance moved| [m]; chosen for epochs of a second"
    )
    heading_sigma_deg: float | None = Field(
        30.0, gt=0, description="1 sigma of the heading against the link's [deg]; chosen. none: as Newson and Krumm"
    )
    backward_m: float = Field(15.0, ge=0, description="steps back on one link that noise may make [m]; chosen")
    detour_m: float = Field(200.0, gt=0, description="longest detour of a route over the distance moved [m]; chosen")


class MatchingConfig(Config):
    """Which matcher, and its settings."""

    kind: MatcherKind = Field(MatcherKind.TOPOLOGICAL, description="nearest, topological (S5) or hidden_markov")
    radius_m: float = Field(50.0, gt=0, le=500, description="links farther away are no candidates [m]; N&K: 200 m")
    candidates: int = Field(8, ge=1, le=64, description="most links considered, the nearest [-]")
    sigma_m: float = Field(
        4.07, gt=0, description="error of a position, 1 sigma, where none is given [m]; Newson and Krumm"
    )
    topological: TopologicalConfig = TopologicalConfig()
    hidden_markov: HiddenMarkovConfig = HiddenMarkovConfig()


class MatchInputs(NamedTuple):
    """What an epoch gives to matchers, of B vehicles.

    position_en_m (B, 2); heading_rad (B,) azimuth of motion; speed_mps (B,); moved_m (B,) distance since the last
    epoch; sigma_m (B,) of the position on one axis; usable (B,) there is a position; headed (B,) the heading is known.
    """

    position_en_m: Array
    heading_rad: Array
    speed_mps: Array
    moved_m: Array
    sigma_m: Array
    usable: Bools
    headed: Bools

    @classmethod
    def of(
        cls,
        position_en_m: ArrayLike,
        *,
        heading_rad: ArrayLike = 0.0,
        speed_mps: ArrayLike = 0.0,
        moved_m: ArrayLike = 0.0,
        sigma_m: ArrayLike = 4.07,
        usable: ArrayLike = True,
        headed: ArrayLike = True,
    ) -> Self:
        """Inputs of positions (B, 2), with scalars for what all vehicles have in common."""
        position = require_finite("position_en_m", position_en_m)
        batch = position.shape[0]

        def each(name: str, value: ArrayLike) -> Array:
            return np.broadcast_to(require_finite(name, value), batch).astype(np.float64)

        return cls(
            position, each("heading_rad", heading_rad), each("speed_mps", speed_mps), each("moved_m", moved_m),
            each("sigma_m", sigma_m), np.broadcast_to(np.asarray(usable, np.bool_), batch).copy(),
            np.broadcast_to(np.asarray(headed, np.bool_), batch).copy(),
        )  # fmt: skip

    @property
    def steady(self) -> Bools:
        """(B,): there is a direction of motion."""
        return np.asarray((self.speed_mps >= STEADY_MPS) & self.headed)


class MapMatches(NamedTuple):
    """Matches of B vehicles; without one the link is NO_LINK, the distance infinite and the probability 0.

    link (B,) index in the map; distance_m (B,); arc_m (B,) along the link; foot_en_m (B, 2); heading_rad (B,) of the
    link; probability (B,) of the link among the candidates, given the model of the matcher.
    """

    link: Ints
    distance_m: Array
    arc_m: Array
    foot_en_m: Array
    heading_rad: Array
    probability: Array

    @classmethod
    def none(cls, batch: int) -> Self:
        """No match."""
        zero = np.zeros(batch)
        return cls(
            np.full(batch, NO_LINK), np.full(batch, np.inf), zero, np.zeros((batch, 2)), zero.copy(), zero.copy()
        )

    @classmethod
    def chosen(cls, near: NearLinks, column: Ints, probability: Array) -> Self:
        """The candidates in ``column`` (B,), with their probability (B,)."""
        rows = np.arange(column.size)
        there = near.link[rows, column] != NO_LINK
        return cls(
            near.link[rows, column], near.distance_m[rows, column], near.arc_m[rows, column],
            near.foot_en_m[rows, column], near.heading_rad[rows, column], np.where(there, probability, 0.0),
        )  # fmt: skip

    def where(self, keep: Bools, other: MapMatches) -> MapMatches:
        """These rows where ``keep`` (B,), those of ``other`` elsewhere."""
        return MapMatches(*(
            np.where(keep if a.ndim == 1 else keep[:, None], a, b) for a, b in zip(self, other, strict=True)
        ))  # fmt: skip


class MapMatcher(Protocol):
    """A matcher of a batch of vehicles; it remembers their last match."""

    road_map: RoadMap
    memory: Memory

    def step(self, inputs: MatchInputs, rows: Rows = EVERY) -> MapMatches:
        """Match the positions of the vehicles in ``rows``; vehicles without a position have no match."""

    def forget(self, rows: Rows) -> None:
        """Begin anew with these vehicles."""


def heading_agreement(near: NearLinks, inputs: MatchInputs) -> Array:
    """Cosine of the link's heading against the motion, (B, K); 0 for vehicles too slow to have a heading."""
    steady = inputs.steady[:, None]
    return np.where(steady, np.cos(near.heading_rad - inputs.heading_rad[:, None]), 0.0)


def emission(near: NearLinks, inputs: MatchInputs, heading_sigma_rad: float | None = None) -> Array:
    """Log density of a position given that the vehicle is on each link, up to a constant (B, K); Newson and Krumm eq 1.

    ``-(d / sigma)^2 / 2``, and the same of the heading where one is given; -inf without a link.
    """
    near_d = np.where(near.there, near.distance_m, 0.0)
    out = -0.5 * np.square(near_d / inputs.sigma_m[:, None])
    if heading_sigma_rad is not None:
        off = wrap_angle(near.heading_rad - inputs.heading_rad[:, None]) / heading_sigma_rad
        out = out - np.where(inputs.steady[:, None], 0.5 * np.square(off), 0.0)
    return np.where(near.there, out, -np.inf)


def normalised(log_weight: Array) -> Array:
    """Probabilities (B, K) from logarithms; 0 where all are -inf."""
    top = log_weight.max(-1, keepdims=True)
    weight = np.exp(log_weight - np.where(np.isfinite(top), top, 0.0))
    total = weight.sum(-1, keepdims=True)
    return np.asarray(weight / np.where(total > 0.0, total, 1.0))


@dataclass
class NearestLink:
    """Geometric matching: the link nearest to the position, whatever its direction (point to curve)."""

    road_map: RoadMap
    config: MatchingConfig
    memory: Memory = field(default_factory=dict)

    def step(self, inputs: MatchInputs, rows: Rows = EVERY) -> MapMatches:
        """The nearest link; its probability is that of the emissions alone."""
        near = self.road_map.near(inputs.position_en_m, self.config.radius_m, self.config.candidates)
        probability = normalised(emission(near, inputs))[:, 0]
        return MapMatches.chosen(near, np.zeros(probability.size, np.int64), probability).where(
            inputs.usable, MapMatches.none(probability.size)
        )

    def forget(self, rows: Rows) -> None:
        """Nothing lasts."""


class TopologicalMatcher:
    """Weight-based topological matching: heading, proximity and connection to the last link.

    It takes the link of the largest :func:`link_weights`. A vehicle that is too slow to have a heading stays on its
    link. ``memory``: link (B,), the last one.
    """

    def __init__(self, road_map: RoadMap, config: MatchingConfig, batch: int) -> None:
        self.road_map, self.config = road_map, config
        self.memory: Memory = {"link": np.full(batch, NO_LINK)}

    def step(self, inputs: MatchInputs, rows: Rows = EVERY) -> MapMatches:
        """The link of the highest score."""
        c, w, last = self.config, self.config.topological, self.memory["link"][rows]
        near = self.road_map.near(inputs.position_en_m, c.radius_m, c.candidates)
        score = link_weights(self.road_map, near, inputs, last, w)
        stays = (inputs.speed_mps[:, None] < STEADY_MPS) & (near.link == last[:, None])
        score = np.where(near.there, score + 10.0 * stays, -np.inf)
        best = np.argmax(score, -1)
        sigma = None if c.hidden_markov.heading_sigma_deg is None else np.deg2rad(c.hidden_markov.heading_sigma_deg)
        probability = normalised(emission(near, inputs, sigma))[np.arange(best.size), best]
        out = MapMatches.chosen(near, best, probability).where(inputs.usable, MapMatches.none(best.size))
        self.memory["link"][rows] = np.where(out.link == NO_LINK, last, out.link)
        return out

    def forget(self, rows: Rows) -> None:
        """Begin without a last link."""
        self.memory["link"][rows] = NO_LINK


def link_weights(
    road_map: RoadMap, near: NearLinks, inputs: MatchInputs, last: Ints, config: TopologicalConfig
) -> Array:
    """``w_h cos(dtheta) + w_d (1 - d / scale) + w_c c`` of each candidate (B, K), after the last links (B,).

    c = 1 on the last link and on links that it leads to, 0 on links that begin where it begins (a choice at a junction
    can be corrected) or without a last link, -1 on others.
    """
    c = config
    weight = c.heading * heading_agreement(near, inputs)
    weight = weight + c.distance * np.maximum(1.0 - np.where(near.there, near.distance_m, 0.0) / c.scale_m, -1.0)
    return np.asarray(weight + c.connection * connectivity(road_map, last, near.link))


def connectivity(road_map: RoadMap, last: Ints, link: Ints) -> Array:
    """1 where the last link (B,) is this one of (B, K) or leads to it, 0 where both begin at one node, else -1.

    Without a last link all are 0.
    """
    at, to = np.maximum(last, 0)[:, None], np.maximum(link, 0)
    joined = (at == to) | (road_map.link_to[at] == road_map.link_from[to])
    joined &= road_map.twin[at] != to
    beside = road_map.link_from[at] == road_map.link_from[to]
    return np.where(last[:, None] == NO_LINK, 0.0, np.where(joined, 1.0, np.where(beside, 0.0, -1.0)))


def require_batch(inputs: MatchInputs, batch: int) -> None:
    """Raise InputError unless the inputs are of ``batch`` vehicles."""
    if inputs.position_en_m.shape != (batch, 2):
        raise InputError(f"position_en_m must be ({batch}, 2), got {inputs.position_en_m.shape}: one row a vehicle")
