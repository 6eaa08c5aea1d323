"""Scores of a matched link by other methods that S5 compares itself with (its Table 5), all 0 to 100, high is good.

Each takes the same matched link, the same candidates and the same position, heading and covariance. A score below a
threshold warns. The methods are published with tables that S5 does not repeat, so each is a reading:

- ``quddus``: Quddus 2006. A fuzzy system of the Sugeno type of three inputs: the radius of the region that holds the
  position with 95 %, by the errors of position and map; the distance and the angle between position and link. The terms
  of distance and angle and the outputs are those of his matcher, as the package fuzzyMM has them.
- ``velaga``: Velaga 2010 and 2012. The same residuals, the lead of the matcher's weight over the second best link, and
  two systems by the complexity of the roads around. That its first test is RAIM is left to the first phase.
- ``jabbour``: Jabbour et al. 2008. The number of efficient hypotheses, ``1 / sum w^2``, and the normalised innovation
  squared of the matched link, without an error of the map. The hypotheses are those of the hidden Markov filter. Two
  thresholds become one score: the innovation passes a test of 1e-3, and the score falls with the number of hypotheses.
  They match the most probable hypothesis; the score of another link is smaller by the ratio of both probabilities.
- ``yu``: Yu et al. 2006. The curve of the last positions against that of the matched points: what remains between them
  after a shift, over the extent of the first one; without errors of position and map. They restart after a mismatch;
  here it is only detected.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.row_memory import EVERY, Memory, Rows
from lanebound.integrity.positioning.map_matching.hidden_markov import HiddenMarkovMatcher
from lanebound.integrity.positioning.map_matching.matching import MapMatches, MatchingConfig, MatchInputs, link_weights
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

__all__ = ["LinkScore", "ScoreKind", "make_score", "sugeno"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SUGENO_OUTPUTS = 10.0, 50.0, 100.0  # low, average and high; fuzzyMM, FIS1
FAR_DEG = 20.0, 45.0  # where an angle begins and ceases to be small; fuzzyMM, HE_small
FAR_M = 10.0, 40.0  # the same of the distance from a link; fuzzyMM, PD_short
WIDE_M = 7.5, 15.0  # the same of the region; chosen: half of and whole alert limit of S5, after Velaga 2012
REGION_SIGMAS = float(np.sqrt(chdtri(2, 0.05)))  # of 95 % in the plane
COMPLEX_LINKS, COMPLEX_M = 2, 15.0  # more links within the alert limit than the two of one street; chosen
COMPLEX_SHARE = 0.5  # of the bounds of the residuals where roads are complex; chosen
LEAD = 0.1  # lead of a match that is clear, share of the largest weight; chosen
HEADING_SIGMA_RAD = np.deg2rad(30.0)  # of the innovation; as of the hidden Markov matcher
INNOVATION_GATE = float(chdtri(2, 1e-3))  # P_FA as of S5's first phase; Jabbour et al. derive theirs from data


class ScoreKind(StrEnum):
    """Which score a matched link has."""

    CONTEXT = "context"
    QUDDUS = "quddus"
    VELAGA = "velaga"
    JABBOUR = "jabbour"
    YU = "yu"


class LinkScore(Protocol):
    """A score of matched links of B vehicles; ``memory`` is what lasts, with the vehicles as first axis."""

    memory: Memory

    def step(self, match: MapMatches, inputs: MatchInputs, rows: Rows = EVERY) -> Array:
        """Score (B,) of the matches of an epoch of the vehicles in ``rows``; 0 without a match."""

    def forget(self, rows: Rows) -> None:
        """Begin anew with these vehicles."""


def make_score(
    kind: ScoreKind, road_map: RoadMap, matching: MatchingConfig, map_sigma_m: float, intervals: int, batch: int
) -> LinkScore | None:
    """The score of a kind; None for S5's own, which its third phase computes.

    Parameters
    ----------
    matching : candidates and weights, as of the matcher
    map_sigma_m : 1 sigma of the map on one axis; ``quddus`` and ``velaga`` consider it
    intervals : N, epochs of the curves of ``yu``
    """
    match kind:
        case ScoreKind.CONTEXT:
            return None
        case ScoreKind.QUDDUS:
            return QuddusScore(map_sigma_m)
        case ScoreKind.VELAGA:
            return VelagaScore(road_map, matching, map_sigma_m, batch)
        case ScoreKind.JABBOUR:
            return JabbourScore(road_map, matching, batch)
        case ScoreKind.YU:
            return YuScore(intervals, batch)


def sugeno(*good: Array) -> Array:
    """Score of factors that are good to degrees (B,), 0 to 1: high if all are, average if all but one are, else low.

    The strength of a rule is the product of its memberships; good and bad of a factor sum to 1.
    """
    degrees = np.stack(good)
    everything = degrees.prod(0)
    but_one = sum((1.0 - degrees[k]) * np.delete(degrees, k, 0).prod(0) for k in range(len(good)))
    low, average, high = SUGENO_OUTPUTS
    return np.asarray(low + (high - low) * everything + (average - low) * but_one)


def _falling(value: Array, bounds: tuple[float, float], share: Array | float = 1.0) -> Array:
    """1 up to the first bound, 0 from the second one on, both times ``share``."""
    return np.asarray(np.clip((bounds[1] * share - value) / ((bounds[1] - bounds[0]) * share), 0.0, 1.0))


def _residuals(match: MapMatches, inputs: MatchInputs) -> tuple[Array, Array]:
    """Distance [m] and angle [deg] between position and link; the angle is 0 where there is no direction of motion."""
    angle = np.rad2deg(np.abs(wrap_angle(match.heading_rad - inputs.heading_rad)))
    return np.where(match.link == NO_LINK, 0.0, match.distance_m), np.where(inputs.steady, angle, 0.0)


def _scored(match: MapMatches, score: Array) -> Array:
    return np.where(match.link == NO_LINK, 0.0, score)


class QuddusScore:
    """Radius of the 95 % region, distance and angle."""

    def __init__(self, map_sigma_m: float) -> None:
        self.map_sigma_m, self.memory = map_sigma_m, Memory()

    def step(self, match: MapMatches, inputs: MatchInputs, rows: Rows = EVERY) -> Array:
        """See the protocol."""
        distance, angle = _residuals(match, inputs)
        region = REGION_SIGMAS * np.hypot(inputs.sigma_m, self.map_sigma_m)
        return _scored(match, sugeno(_falling(region, WIDE_M), _falling(distance, FAR_M), _falling(angle, FAR_DEG)))

    def forget(self, rows: Rows) -> None:
        """Nothing lasts."""


class VelagaScore:
    """Distance beyond the errors of position and map, angle, and lead; ``memory``: link (B,), the last one."""

    def __init__(self, road_map: RoadMap, matching: MatchingConfig, map_sigma_m: float, batch: int) -> None:
        self.road_map, self.matching, self.map_sigma_m = road_map, matching, map_sigma_m
        self.memory: Memory = {"link": np.full(batch, NO_LINK)}

    def step(self, match: MapMatches, inputs: MatchInputs, rows: Rows = EVERY) -> Array:
        """See the protocol."""
        c, last = self.matching, self.memory["link"][rows]
        near = self.road_map.near(inputs.position_en_m, c.radius_m, c.candidates)
        weight = np.where(near.there, link_weights(self.road_map, near, inputs, last, c.topological), -np.inf)
        own = near.link == match.link[:, None]
        best = np.where(own, weight, -np.inf).max(-1)
        others = np.where(own, -np.inf, weight).max(-1)
        w = c.topological
        largest = LEAD * (w.heading + w.distance + w.connection)
        alone = ~np.isfinite(others)  # no second link: nothing to be confused with
        lead = np.where(alone, 1.0, (best - np.where(alone, 0.0, others)) / largest)
        lead = np.where(np.isfinite(best), np.clip(lead, 0.0, 1.0), 0.0)
        complex_ = (near.distance_m <= COMPLEX_M).sum(-1) > COMPLEX_LINKS
        share = np.where(complex_, COMPLEX_SHARE, 1.0)
        distance, angle = _residuals(match, inputs)
        beyond = np.maximum(distance - np.hypot(inputs.sigma_m, self.map_sigma_m), 0.0)
        self.memory["link"][rows] = np.where(match.link == NO_LINK, last, match.link)
        return _scored(match, sugeno(_falling(beyond, FAR_M, share), _falling(angle, FAR_DEG, share), lead))

    def forget(self, rows: Rows) -> None:
        """Begin without a last link."""
        self.memory["link"][rows] = NO_LINK


class JabbourScore:
    """``100 / N_eff`` of the hypotheses, times ``w / w_max`` of the matched link, if its innovation is likely."""

    def __init__(self, road_map: RoadMap, matching: MatchingConfig, batch: int) -> None:
        self._hypotheses = HiddenMarkovMatcher(road_map, matching, batch)

    @property
    def memory(self) -> Memory:
        """That of the hidden Markov filter."""
        return self._hypotheses.memory

    @memory.setter
    def memory(self, memory: Memory) -> None:
        self._hypotheses.memory = memory

    def step(self, match: MapMatches, inputs: MatchInputs, rows: Rows = EVERY) -> Array:
        """See the protocol."""
        self._hypotheses.step(inputs, rows)
        weight = np.exp(self.memory["log_probability"][rows])
        own = np.where(self.memory["link"][rows] == match.link[:, None], weight, 0.0).max(-1)
        share = np.square(weight).sum(-1) * own / np.maximum(weight.max(-1), 1e-9)  # 1 / N_eff, and the ratio
        distance, angle = _residuals(match, inputs)
        innovation = np.square(distance / inputs.sigma_m) + np.square(np.deg2rad(angle) / HEADING_SIGMA_RAD)
        return _scored(match, np.where(innovation <= INNOVATION_GATE, 100.0 * share, 0.0))

    def forget(self, rows: Rows) -> None:
        """Begin without hypotheses."""
        self._hypotheses.forget(rows)


class YuScore:
    """``100 (1 - residual / extent)`` of the last N + 1 positions and matched points; 0 with fewer than three of them.

    ``memory``: curves (B, N + 1, 4) positions and matched points, the newest last; count (B,) of them
    """

    def __init__(self, intervals: int, batch: int) -> None:
        points = max(intervals, 2) + 1
        self.memory: Memory = {"curves": np.zeros((batch, points, 4)), "count": np.zeros(batch, np.int64)}

    def step(self, match: MapMatches, inputs: MatchInputs, rows: Rows = EVERY) -> Array:
        """See the protocol."""
        matched = match.link != NO_LINK
        here = np.where(matched[:, None], np.concatenate([inputs.position_en_m, match.foot_en_m], -1), 0.0)
        curves, count = self.memory["curves"][rows], self.memory["count"][rows]
        curves = np.concatenate([curves[:, 1:], here[:, None]], 1)
        count = np.where(matched, np.minimum(count + 1, curves.shape[1]), 0)
        self.memory["curves"][rows], self.memory["count"][rows] = curves, count
        seen = np.arange(curves.shape[1])[::-1] < count[:, None]
        share = seen / np.maximum(count, 1)[:, None]
        extent = _scatter(curves[..., :2], share)
        residual = _scatter(curves[..., :2] - curves[..., 2:], share)
        likeness = 1.0 - np.sqrt(residual / np.maximum(extent, 1e-12))
        return np.where(count > 2, 100.0 * np.clip(likeness, 0.0, 1.0), 0.0)

    def forget(self, rows: Rows) -> None:
        """Begin with no curve."""
        self.memory["count"][rows] = 0


def _scatter(points: Array, share: Array) -> Array:
    """Mean squared distance of points (B, P, 2) from their mean, by shares (B, P)."""
    mean = np.einsum("bp,bpk->bk", share, points)
    return np.asarray(np.einsum("bp,bpk->b", share, np.square(points - mean[:, None])))
