"""How far the predicted satellites are from those in sight: the order of S2, whose map was good to 2-3 m."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.envs import RoundaboutEnv
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.sky import SkyLevel, Street, build_street
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SignalPath

HOURS = (0.0, 1.0, 2.0, 3.0)


def network(world: str) -> RoadNetwork:
    if world == "straight":
        return RoadNetwork.straight_road_network(2, length=1200.0)
    env = RoundaboutEnv()
    env.reset(seed=0)
    return env.road.network


def differences(street: Street) -> NDArray[np.int64]:
    """Predicted less true satellites in line of sight, at every station of the first lane, at four hours."""
    config = SkyConfig()
    track, stations = SkyTrack.from_config(config, 3.5 * 3600.0), street.mask.path.shape[0]
    arc, lane = street.lanes.spacing_m * np.arange(stations), np.zeros(stations, dtype=np.int64)
    out = []
    for hour in HOURS:
        sky = track.at(track.start_s + 3600.0 * hour, np.zeros(stations, dtype=np.int64))
        seen = (street.mask.look(arc, lane, sky).path == SignalPath.LOS) & sky.above[0]
        out.append(street.forecast.count(arc, lane, sky) - seen.sum(-1))
    return np.array(out)


@pytest.mark.parametrize("world", ["straight", "roundabout"])
@pytest.mark.parametrize("name", ["urban", "dense"])
def test_predictions_are_off_as_much_as_published(world: str, name: str) -> None:
    """S2 section 5: two satellites on average, within five; over two layouts of each."""
    roads, level = network(world), SkyLevel.named(name)
    off = np.concatenate([differences(build_street(roads, level, seed)).ravel() for seed in (0, 1)])
    assert 1.0 < np.abs(off).mean() < 3.0
    assert (np.abs(off) <= 5).mean() > 0.8
    assert 0.1 < (off == 0).mean() < 0.6
    assert off.min() < 0 < off.max()


def test_an_open_sky_is_predicted_as_it_is() -> None:
    assert not differences(build_street(network("straight"), SkyLevel.named("open"), 0)).any()


def test_an_exact_map_predicts_what_is_in_sight() -> None:
    exact = {"height_sigma_m": 0.0, "position_sigma_m": 0.0, "trees": True}
    level = SkyLevel.named("dense").replace(map=exact)
    assert not differences(build_street(network("roundabout"), level, 0)).any()


def test_the_map_moves_nothing_that_is_received() -> None:
    level, roads = SkyLevel.named("urban"), network("roundabout")
    one, two = (build_street(roads, level.replace(map={"height_sigma_m": h}), 0, reuse=False) for h in (1.0, 3.0))
    np.testing.assert_array_equal(one.mask.path, two.mask.path)
    np.testing.assert_array_equal(one.mask.excess_m, two.mask.excess_m)
    assert (one.forecast.free != two.forecast.free).any()
