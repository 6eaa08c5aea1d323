"""Weights of the topological matcher, fitted on maps and drives that no result uses.

``python -m lanebound.agents.studies.matcher_fit`` drives three maps of each kind of roads (maps and seeds from 1000
on; results have maps 0 to 4) and prints the share of right links for each scale of distance and weight of connection.
The chosen pair has the largest mean share, over kinds of roads, true maps and maps with errors alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.studies.context_drive import DRIVES, drive_of, wrong_map
from lanebound.agents.studies.context_study import ContextStudyConfig
from lanebound.integrity.monitoring.context.monitor import match_inputs
from lanebound.integrity.monitoring.context.speed_phase import SpeedPhase
from lanebound.integrity.positioning.map_matching.hidden_markov import make_matcher
from lanebound.integrity.positioning.map_matching.matching import MatchingConfig, MatchInputs
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

__all__ = ["TRAINING", "MatchedDrives", "fit", "record"]

TRAINING = 1000  # first map and first seed
MAPS, DRIVES_EACH, POINTS = 3, 5, 1000
SCALES_M = (6.0, 8.0, 10.0, 12.0, 15.0, 20.0)
CONNECTIONS = (0.0, 0.05, 0.1, 0.15, 0.25)


class MatchedDrives(NamedTuple):
    """Drives on a map: its true and wrong form, and of each point what matchers take, true links and driving."""

    roads: str
    maps: tuple[RoadMap, RoadMap]
    inputs: list[MatchInputs]
    true_link: NDArray[np.int64]
    driving: NDArray[np.bool_]

    def share(self, config: MatchingConfig) -> float:
        """Share of right links of a matcher, the mean of both maps."""
        shares = []
        for road_map in self.maps:
            matcher = make_matcher(road_map, config, self.driving.shape[1])
            names = np.append(road_map.identity, NO_LINK)
            link = np.array([names[matcher.step(inputs).link] for inputs in self.inputs])
            right = (link[..., None] == self.true_link).any(-1)
            shares.append(float(right[self.driving].mean()))
        return float(np.mean(shares))


def record(roads: str, number: int, seeds: list[int], points: int, study: ContextStudyConfig) -> MatchedDrives:
    """Drive map ``number`` once, for all matchers."""
    table, monitor = DRIVES[roads].replace(points=points), study.monitor
    drive = drive_of(table, number, seeds, (study.gnss, study.sky), {"": monitor.codes}, study.node_m)
    speed, inputs, true_link, driving = SpeedPhase(monitor.speed, len(seeds)), [], [], []
    for p in drive.points:
        fix = p.fix
        tested = speed.step(fix.velocity_en_mps, fix.velocity_covariance, p.wheel_mps, fix.has_velocity)
        inputs.append(match_inputs(fix, tested, 1.0))
        true_link.append(p.true_link)
        driving.append(p.driving)
    maps = drive.road_map, wrong_map(drive.road_map, study.map_errors, table, number)
    return MatchedDrives(roads, maps, inputs, np.array(true_link), np.array(driving))


def fit(drives: Sequence[MatchedDrives], base: MatchingConfig) -> dict[tuple[float, float], dict[str, float]]:
    """Mean share of right links by roads, for each scale [m] and weight of connection."""
    out: dict[tuple[float, float], dict[str, float]] = {}
    for scale, connection in product(SCALES_M, CONNECTIONS):
        config = base.replace(topological={"scale_m": scale, "connection": connection})
        shares: dict[str, list[float]] = {}
        for drive in drives:
            shares.setdefault(drive.roads, []).append(drive.share(config))
        out[scale, connection] = {roads: float(np.mean(each)) for roads, each in shares.items()}
    return out


def _mean(by_roads: Mapping[str, float]) -> float:
    return float(np.mean([*by_roads.values()]))


def main() -> None:
    """Print the table; see the module."""
    study = ContextStudyConfig()
    seeds = list(range(TRAINING, TRAINING + DRIVES_EACH))
    drives = [
        record(roads, TRAINING + number, seeds, POINTS, study)
        for roads in ("urban", "rural", "mixed")
        for number in range(MAPS)
    ]
    found = fit(drives, study.monitor.matching)
    print("scale_m connection    mean  urban  rural  mixed   [% right links]")
    for (scale, connection), by_roads in sorted(found.items(), key=lambda item: -_mean(item[1])):
        cells = " ".join(f"{100.0 * share:6.2f}" for share in (_mean(by_roads), *by_roads.values()))
        print(f"{scale:7g} {connection:10g}  {cells}")


if __name__ == "__main__":
    main()
