"""The context monitor on a recorded drive with a map that the user gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.warning_rates import WarningCounts
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.monitor import ContextMonitor, ContextVerdict
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedTest
from lanebound.integrity.positioning.map_matching.hidden_markov import viterbi
from lanebound.integrity.positioning.map_matching.map_errors import with_errors
from lanebound.integrity.positioning.map_matching.matching import MatchingConfig
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap
from lanebound.integrity.recorded.road_file import RoadLines
from lanebound.integrity.replay.context_epochs import ContextEpochs, ContextReplayConfig
from lanebound.integrity.replay.road_network import RoadNetwork, network_near

__all__ = ["ReplayedContext", "drive_context"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TRUTH = MatchingConfig(radius_m=30.0, candidates=16, sigma_m=3.0)
"""The reference on the map: its error, the half width of a road and the error of a digitised map."""


@dataclass(frozen=True)
class ReplayedContext:
    """Verdicts of E epochs.

    network : the map of the file; the monitor has it with the configured errors
    warn, light, reason, phases, link (E,); score, probability, level_m (E,)
    true_link : (E,) link of the file's map on which the reference drives, NO_LINK where it is on none
    right : (E,) the matched road is that one, in either direction, or the neighbour at a node
    """

    config: ContextReplayConfig
    epochs: ContextEpochs
    network: RoadNetwork
    warn: Bools
    light: Ints
    reason: Ints
    phases: Ints
    link: Ints
    score: Array
    probability: Array
    level_m: Array
    true_link: Ints
    right: Bools

    @property
    def judged(self) -> Bools:
        """Epochs (E,) with a position and a reference that is on a road of the map."""
        return np.asarray(self.epochs.known & (self.true_link != NO_LINK) & self.epochs.fix.located)

    def counts(self, warn: Bools) -> WarningCounts:
        """Counts of warnings (E,) of the judged epochs."""
        return WarningCounts.of(warn, ~self.right, self.judged)

    def errors_m(self) -> Array:
        """Horizontal errors (N,) of the positions at epochs with a reference."""
        keep = self.epochs.known & self.epochs.fix.located
        return np.asarray(np.hypot(*(self.epochs.fix.position_en_m - self.epochs.truth_en_m)[keep].T))


def drive_context(
    epochs: ContextEpochs, roads: RoadLines, config: ContextReplayConfig, progress: Progress = silent
) -> ReplayedContext:
    """Judge all epochs; ``progress`` is called with the number of epochs done and the total number.

    Raises
    ------
    InputError
        No road of the map is near the positions.
    """
    track = epochs.fix.position_en_m[epochs.fix.located]
    network = network_near(roads, epochs.frame, track, config.within_m)
    road_map = with_errors(network.road_map, config.map_errors, named_generator(config.map_seed, "map"))
    own = config if epochs.has_wheels else config.replace(speed={"form": SpeedForm.PRINTED.value})
    monitor = ContextMonitor(own, road_map, 1, config.interval_s)
    verdicts = list[ContextVerdict]()
    for k in range(epochs.time_s.size):
        row, monitor.dt_s = slice(k, k + 1), _interval(epochs, k, config)
        speed = None if epochs.distance_m is None else _speed_by_wheels(epochs, epochs.distance_m, k, config)
        verdicts.append(monitor.step(epochs.fix.rows(row), epochs.wheel_mps[row], epochs.position.rows(row), speed))
        progress(k + 1, epochs.time_s.size)
    return _gathered(config, epochs, network, verdicts)


def _interval(epochs: ContextEpochs, k: int, config: ContextReplayConfig) -> float:
    """Time since the epoch before [s]."""
    return float(epochs.time_s[k] - epochs.time_s[k - 1]) if k else config.interval_s


def _speed_by_wheels(epochs: ContextEpochs, distance_m: Array, k: int, config: ContextReplayConfig) -> SpeedTest:
    """In place of the second phase: the mean speed by wheels over its time, known with a direction of motion."""
    first = max(k - config.speed.intervals, 0)
    time = epochs.time_s[k] - epochs.time_s[first]
    mean = abs(float(distance_m[k] - distance_m[first])) / time if time > 0.0 else abs(float(epochs.wheel_mps[k]))
    known = epochs.fix.has_velocity[k : k + 1] & (k >= config.speed.intervals)
    wheels = np.abs(epochs.wheel_mps[k : k + 1])
    return SpeedTest(wheels > config.speed.least_mps, known, known, np.array([mean]), np.zeros(1, np.bool_), wheels)


def _gathered(
    config: ContextReplayConfig, epochs: ContextEpochs, network: RoadNetwork, verdicts: list[ContextVerdict]
) -> ReplayedContext:
    def all_of(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(verdict, name) for verdict in verdicts])

    link = all_of("link")
    true = _true_links(epochs, network.road_map)
    return ReplayedContext(
        config, epochs, network, warn=all_of("warn"), light=all_of("light"), reason=all_of("reason"),
        phases=all_of("phases"), link=link, score=all_of("score"),
        probability=np.concatenate([v.match.probability for v in verdicts]), level_m=epochs.position.level_m,
        true_link=true, right=_right(network.road_map, link, true, epochs.truth_en_m, config.node_m),
    )  # fmt: skip


def _true_links(epochs: ContextEpochs, road_map: RoadMap) -> Ints:
    """Links (E,) of the reference: its likeliest sequence on the map, all epochs at once."""
    out, keep = np.full(epochs.time_s.size, NO_LINK), np.flatnonzero(epochs.known)
    if keep.size:
        out[keep] = viterbi(road_map, epochs.truth_en_m[keep], TRUTH).link
    return out


def _right(road_map: RoadMap, link: Ints, true: Ints, truth_en_m: Array, node_m: float) -> Bools:
    """Whether links (E,) are on the road of the true ones, or on one that meets it within ``node_m``."""
    a, b = np.maximum(link, 0), np.maximum(true, 0)
    same = (a == b) | (road_map.twin[a] == b)
    for node in (road_map.link_from[b], road_map.link_to[b]):
        close = np.hypot(*(road_map.node_en_m[node] - truth_en_m).T) <= node_m
        same |= close & ((road_map.link_from[a] == node) | (road_map.link_to[a] == node))
    return np.asarray(same & (link != NO_LINK) & (true != NO_LINK))
