"""The packaged levels, and how often RTK is missing under each: the calibration that their files speak of."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from highway_env.envs import HighwayEnv
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.agents.cli.listing import resolve
from lanebound.envs.config import EnvConfig
from lanebound.envs.manual import markdown
from lanebound.envs.records import azimuth_of, enu_of
from lanebound.envs.scene import navigator_config
from lanebound.envs.sky import SKIES, SKY_LEVELS, SkyLevel, Street, build_street
from lanebound.envs.worlds import LaneKeepingWorld
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import preset_names
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.city import SectionKind
from lanebound.integrity.sky.track import SkyTrack

# Share of time without RTK; measured over 4 layouts: suburban 0.05-0.06, urban 0.19-0.23, dense 0.42-0.52.
BANDS = {"open": (0.0, 0.02), "suburban": (0.02, 0.09), "urban": (0.10, 0.28), "dense": (0.35, 0.60)}
SPEED_MPS = 12.0
SECONDS, VEHICLES, LAYOUTS = 150, 10, 3
SETTLED_S = 10.0


@pytest.mark.parametrize("name", SKY_LEVELS)
def test_levels_are_presets_that_the_command_line_knows(name: str) -> None:
    kind, config = resolve(f"skies/{name}")
    assert kind == "sky_level"
    assert config == SkyLevel.named(name)
    assert SkyLevel.from_json(config.to_json()) == config


def test_every_packaged_sky_is_known_by_its_short_and_its_full_name_and_documented() -> None:
    full = [name for name in preset_names() if name.startswith("skies/")]
    assert sorted(f"skies/{name}" for name in SKIES) == sorted(full)
    assert SKIES[: len(SKY_LEVELS)] == SKY_LEVELS
    page = markdown()
    for name in SKIES:
        levels = [EnvConfig.build({"base": "highway-v0"}, {"sky": sky}).level for sky in (name, f"skies/{name}")]
        assert levels == [SkyLevel.preset(f"skies/{name}")] * 2
        assert f"\n| `{name}` | " in page
    with pytest.raises(ConfigError, match=r"^sky must be one of .*plaza, or a file, got 'plazza': did you mean 'plaza"):
        EnvConfig.build({"base": "highway-v0"}, {"sky": "plazza"})


def test_an_unknown_level_is_refused() -> None:
    with pytest.raises(ConfigError, match="preset 'skies/lunar' is unknown"):
        SkyLevel.named("skies/lunar")


def test_a_level_of_ones_own_extends_a_packaged_one(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("extends: skies/urban\ncorrections: {outage_per_h: 100.0}\n")
    assert SkyLevel.named(str(path)) == SkyLevel.named("urban").replace(corrections={"outage_per_h": 100.0})
    assert EnvConfig.build({"base": "highway-v0"}, {"sky": str(path)}).level.corrections.outage_per_h == 100.0
    limits = (1.5, 0.6)
    outages = []
    for per_h in (100.0, 200.0):  # a file that is changed counts for environments made after that
        path.write_text(f"extends: skies/urban\ncorrections: {{outage_per_h: {per_h}}}\n")
        config = EnvConfig.build({"base": "highway-v0"}, {"sky": str(path)})
        outages += [config.level.corrections.outage_per_h, navigator_config(config, limits).corrections.outage_per_h]
        path.write_text("extends: skies/dense\n")
        assert config.level.corrections.outage_per_h == per_h
    assert outages == [100.0, 100.0, 200.0, 200.0]
    path.write_text("extends: skies/urban\nstreet_width_m: -1\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml: street_width_m must lie in \[0, 200\], got -1"):
        EnvConfig.build({"base": "highway-v0"}, {"sky": str(path)})
    path.write_text("extends: suites/quick\n")
    with pytest.raises(ConfigError, match=r"sky must be a file of kind sky_level, got .*mine\.yaml of kind suite"):
        SkyLevel.named(str(path))
    with pytest.raises(ConfigError, match="sky must be a file that can be read"):
        SkyLevel.named(str(tmp_path / "none.yaml"))


def test_the_navigator_takes_the_levels_link_and_instruments_and_nothing_else() -> None:
    level, base = SkyLevel.named("dense"), NavigatorConfig(dt_s=0.2)
    got = level.navigator(base)
    assert got.corrections == level.corrections
    assert got.positioning.rtk.max_age_s == level.max_age_s
    assert got.dt_s == 0.2
    assert got.alert == base.alert
    assert got.imu == base.imu
    assert got.gnss.replace(range_rate_sigma_mps=base.gnss.range_rate_sigma_mps) == base.gnss
    assert got.positioning.doppler.sigma_mps > base.positioning.doppler.sigma_mps
    assert SkyLevel.named("suburban").navigator(base).gnss == base.gnss


def test_levels_grow_harder() -> None:
    links = [SkyLevel.named(name).corrections for name in SKY_LEVELS]
    lost = [c.outage_per_h * c.outage_median_s for c in links]
    assert all(a < b for a, b in pairwise(lost))
    assert max(c.outage_max_s for c in links[1:]) <= 50.0


def test_narrow_roads_get_wider_pavements() -> None:
    level = SkyLevel.named("dense")
    narrow, wide = (level.streets_along(w).street(SectionKind.DENSE_CANYON) for w in (4.0, 16.0))
    assert 2.0 * narrow.setback_m + 4.0 == level.street_width_m
    assert wide.setback_m == 4.0


def drive(
    network: RoadNetwork, street: Street, config: NavigatorConfig, seed: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Drive along the middles of the first edge's lanes: RTK missing, and corrections too old, (T, B) each."""
    (start, end), lanes = next(((a, b), lanes) for a, ends in network.graph.items() for b, lanes in ends.items())
    rng, dt = np.random.default_rng(seed), config.dt_s
    reach = street.lanes.reach_m[start, end, 0] - 1.3 * SPEED_MPS * SECONDS
    place = rng.uniform(0.0, max(reach, 0.0), VEHICLES)
    which = rng.integers(0, len(lanes), VEHICLES)
    navigator = Navigator(config, SkyTrack.from_config(config.sky, SECONDS + 60.0), street.mask, seed, VEHICLES)

    def pose() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        xy = np.array([lanes[i].position(s, 0.0) for i, s in zip(which, place, strict=True)])
        azimuth = azimuth_of(np.array([lanes[i].heading_at(s) for i, s in zip(which, place, strict=True)]))
        return enu_of(xy), azimuth, SPEED_MPS * np.stack([np.sin(azimuth), np.cos(azimuth)], -1)

    missing, late = [], []
    before = pose()
    navigator.align(before[1], 0.01)
    for k in range(int(SECONDS / dt)):
        place += SPEED_MPS * dt
        now = pose()
        where = [street.where((start, end, int(i)), float(s)) for i, s in zip(which, place, strict=True)]
        arc, lane = (np.array(column) for column in zip(*where, strict=True))
        p, h, v = ((before[i], now[i]) for i in range(3))
        solution = navigator.step(truth_between((k + 1) * dt, dt, p, v, h, arc, lane))
        missing.append(solution.mode != Mode.RTK)
        late.append(solution.corrections_age_s > config.positioning.rtk.max_age_s)
        before = now
    settled = int(SETTLED_S / dt)
    return np.array(missing)[settled:], np.array(late)[settled:]


def outages_s(missing: NDArray[np.bool_], dt_s: float) -> NDArray[np.float64]:
    """Lengths of the runs of True in each column."""
    padded = np.zeros((missing.shape[0] + 2, missing.shape[1]), dtype=np.int8)
    padded[1:-1] = missing
    step = np.diff(padded, axis=0).T
    return np.asarray((np.nonzero(step < 0)[1] - np.nonzero(step > 0)[1]) * dt_s)


def _drives(name: str, world: type, layouts: int = LAYOUTS) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """What :func:`drive` gives in each city of a sky."""
    env = world()
    env.reset(seed=0)
    level, network = SkyLevel.named(name), env.road.network
    for k in range(layouts):
        yield drive(network, build_street(network, level, k), level.navigator(), k)


@pytest.mark.slow
@pytest.mark.parametrize("world", [HighwayEnv, LaneKeepingWorld])
@pytest.mark.parametrize("name", SKY_LEVELS)
def test_rtk_is_missing_as_often_as_the_level_says(name: str, world: type) -> None:
    missing, late = (np.concatenate(columns, 1) for columns in zip(*_drives(name, world), strict=True))
    low, high = BANDS[name]
    assert low <= missing.mean() <= high
    if name == "open":
        return
    by_link = (missing & late).mean() / missing.mean()
    assert 0.2 < by_link < 0.75, "half by the link, half by what stands beside the road"
    lengths = outages_s(missing, 0.1)
    assert np.quantile(lengths, 0.98) < 60.0


@pytest.mark.slow
@pytest.mark.parametrize(("world", "low", "high"), [(HighwayEnv, 0.185, 0.255), (LaneKeepingWorld, 0.495, 0.635)])
def test_rtk_is_missing_under_plaza_as_often_as_the_page_says(world: type, low: float, high: float) -> None:
    shares = [missing.mean() for missing, _ in _drives("plaza", world, layouts=4)]
    assert low <= min(shares)
    assert max(shares) <= high
