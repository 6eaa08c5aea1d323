"""Hidden Markov map matching (Newson and Krumm 2009): forward filter for drives, Viterbi for recorded tracks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_finite
from lanebound.integrity.core.row_memory import EVERY, Memory, Rows
from lanebound.integrity.positioning.map_matching.matching import (
    HiddenMarkovConfig,
    MapMatcher,
    MapMatches,
    MatcherKind,
    MatchingConfig,
    MatchInputs,
    NearestLink,
    TopologicalMatcher,
    emission,
    normalised,
    require_batch,
)
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, NearLinks, RoadMap

__all__ = ["HiddenMarkovMatcher", "ViterbiPath", "make_matcher", "transition", "viterbi"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def make_matcher(road_map: RoadMap, config: MatchingConfig, batch: int) -> MapMatcher:
    """The matcher of the configuration's kind, for B vehicles."""
    if config.kind is MatcherKind.NEAREST:
        return NearestLink(road_map, config)
    kind = TopologicalMatcher if config.kind is MatcherKind.TOPOLOGICAL else HiddenMarkovMatcher
    return kind(road_map, config, batch)


def transition(road_map: RoadMap, before: NearLinks, now: NearLinks, moved_m: Array, c: HiddenMarkovConfig) -> Array:
    """Log probability of each candidate (K2) after each one before (K1), (B, K1, K2); Newson and Krumm eq 2.

    ``-|route distance - moved| / beta``, -inf beyond the longest detour.
    """
    route = road_map.route_distance_m(
        before.link[:, :, None], before.arc_m[:, :, None], now.link[:, None, :], now.arc_m[:, None, :], c.backward_m
    )
    off = np.abs(route - moved_m[:, None, None])
    return np.where(off <= c.detour_m, -off / c.beta_m, -np.inf)


class HiddenMarkovMatcher:
    """Forward filter: the probability of each candidate link given all positions up to now, and the likeliest link.

    A vehicle whose candidates no route joins begins anew with the emissions. ``memory``: the candidates of the last
    position (fields of NearLinks), their log_probability (B, K), and moved_m (B,) since.
    """

    def __init__(self, road_map: RoadMap, config: MatchingConfig, batch: int) -> None:
        self.road_map, self.config = road_map, config
        k = config.candidates
        none = np.full((batch, k), NO_LINK)
        near = NearLinks(
            none, np.full((batch, k), np.inf), np.zeros((batch, k)), np.zeros((batch, k, 2)), np.zeros((batch, k))
        )
        self.memory: Memory = {
            **near._asdict(), "log_probability": np.full((batch, k), -np.inf), "moved_m": np.zeros(batch)
        }  # fmt: skip

    def step(self, inputs: MatchInputs, rows: Rows = EVERY) -> MapMatches:
        """The likeliest link and its probability; vehicles without a position keep what they know."""
        before = NearLinks(*(self.memory[name][rows] for name in NearLinks._fields))
        logs, moved = self.memory["log_probability"][rows], self.memory["moved_m"][rows] + inputs.moved_m
        batch, c, h = moved.size, self.config, self.config.hidden_markov
        require_batch(inputs, batch)
        near = _padded(self.road_map.near(inputs.position_en_m, c.radius_m, c.candidates), c.candidates)
        sigma = None if h.heading_sigma_deg is None else float(np.deg2rad(h.heading_sigma_deg))
        seen = emission(near, inputs, sigma)
        joint = logs[:, :, None] + transition(self.road_map, before, near, moved, h)
        found = _log_sum(joint) + seen
        lost = np.asarray(~np.isfinite(found).any(-1))
        found = np.where(lost[:, None], seen, found)
        probability = normalised(found)
        usable = inputs.usable & near.there[:, 0]
        with np.errstate(divide="ignore"):
            self._keep(rows, usable, {**near._asdict(), "log_probability": np.log(probability)})
        self.memory["moved_m"][rows] = np.where(usable, 0.0, moved)
        return _likeliest(near, probability).where(inputs.usable, MapMatches.none(batch))

    def _keep(self, rows: Rows, usable: NDArray[np.bool_], now: Memory) -> None:
        """Remember what is new of the vehicles with a position."""
        for name, new in now.items():
            old = self.memory[name][rows]
            self.memory[name][rows] = np.where(usable.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    def forget(self, rows: Rows) -> None:
        """Begin with the emissions alone."""
        self.memory["log_probability"][rows], self.memory["moved_m"][rows] = -np.inf, 0.0


def _padded(near: NearLinks, columns: int) -> NearLinks:
    """Candidates with ``columns`` columns, also where the map has fewer links."""
    lack = columns - near.link.shape[1]
    if lack <= 0:
        return near
    fill = (NO_LINK, np.inf, 0.0, 0.0, 0.0)
    return NearLinks(*(
        np.pad(value, [(0, 0), (0, lack)] + [(0, 0)] * (value.ndim - 2), constant_values=with_)
        for value, with_ in zip(near, fill, strict=True)
    ))  # fmt: skip


def _log_sum(joint: Array) -> Array:
    """``log sum exp`` over axis 1 of (B, K1, K2); -inf where all are."""
    top = joint.max(1)
    safe = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.exp(joint - safe[:, None, :]).sum(1)) + safe)


def _likeliest(near: NearLinks, probability: Array) -> MapMatches:
    best = np.argmax(probability, -1)
    return MapMatches.chosen(near, best, probability[np.arange(best.size), best])


@dataclass(frozen=True)
class ViterbiPath:
    """Links (T,) of the positions of a track, and the connected links of its route."""

    link: Ints
    route: list[int]


def viterbi(road_map: RoadMap, position_en_m: ArrayLike, config: MatchingConfig) -> ViterbiPath:
    """The likeliest sequence of links of one track (T, 2), by the distances between its positions (Newson and Krumm).

    Positions without a link within the radius, and those that no route reaches, have NO_LINK.
    """
    track = require_finite("position_en_m", position_en_m)
    near = road_map.near(track, config.radius_m, config.candidates)
    inputs = MatchInputs.of(track, sigma_m=config.sigma_m)
    seen, steps = emission(near, inputs), track.shape[0]
    kept = np.flatnonzero(near.there[:, 0])
    link = np.full(steps, NO_LINK)
    if kept.size == 0:
        return ViterbiPath(link, [])
    score, back = seen[kept[0]], []
    for last, now in pairwise(kept.tolist()):
        moved = np.atleast_1d(np.linalg.norm(track[now] - track[last]))
        total = score[:, None] + transition(road_map, near.rows(last), near.rows(now), moved, config.hidden_markov)[0]
        best, top = total.argmax(0), total.max(0)
        if not np.isfinite(top + seen[now]).any():  # no route: the sequence begins anew
            best, top = np.full(top.size, score.argmax()), np.zeros(top.size)
        back.append(best)
        score = top + seen[now]
    column = int(score.argmax())
    columns = [column]
    for best in reversed(back):
        column = int(best[column])
        columns.append(column)
    link[kept] = near.link[kept, columns[::-1]]
    return ViterbiPath(link, _joined(road_map, [int(i) for i in link[kept]]))


def _joined(road_map: RoadMap, links: list[int]) -> list[int]:
    """Matched links with the links of the shortest routes between them, none twice in a row."""
    out = links[:1]
    for link in links[1:]:
        if link == out[-1]:
            continue
        a, b = int(road_map.link_to[out[-1]]), int(road_map.link_from[link])
        if np.isfinite(road_map.node_distance_m[a, b]):
            out += road_map.route_between(a, b)
        out.append(link)
    return out
