"""The generated cities of episodes: splits, seeds and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs.batch.navigation import draw_starts
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.sky import CitiesConfig, SkyLevel, build_street
from lanebound.envs.sky.cities import TEST_CITIES, TRAIN_CITIES
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.city import SectionKind

ROAD = "lanebound/LaneKeeping-v0"
NOBODY = np.zeros((400, 0), dtype=np.bool_)


def drawn(cities: CitiesConfig) -> list[int]:
    starts = draw_starts(range(400), cities, 24, NOBODY, False)
    return [int(seed) for seed in starts.city]


def test_train_and_test_have_no_city_in_common() -> None:
    last = CitiesConfig(count=TRAIN_CITIES)
    assert last.seed_of(last.number - 1) < CitiesConfig(split="test").seed_of(0)
    assert not set(drawn(last)) & set(drawn(CitiesConfig(split="test")))


def test_the_default_draws_the_four_cities_that_there_have_always_been() -> None:
    before = [int(named_generator(seed, "scene").integers(4)) for seed in range(400)]
    assert drawn(CitiesConfig()) == before
    assert drawn(CitiesConfig(count=4)) == before


def test_all_cities_of_a_split_are_drawn_and_no_others() -> None:
    few, tests = CitiesConfig(count=7), CitiesConfig(split="test", count=7)
    assert set(drawn(few)) == {few.seed_of(k) for k in range(7)}
    assert set(drawn(tests)) == {tests.seed_of(k) for k in range(7)}
    assert CitiesConfig(split="test").number == TEST_CITIES
    assert len(set(drawn(CitiesConfig(count=TRAIN_CITIES)))) == 400


def test_cities_of_two_seeds_differ_and_are_made_again_with_the_same_bits() -> None:
    config = make_config(ROAD, {"extent_m": 200.0})
    network, tests = DrivingEnv(config).world.road.network, CitiesConfig(split="test")
    seeds = (tests.seed_of(0), tests.seed_of(1), tests.seed_of(0))
    one, other, again = (build_street(network, config.level, s, (), 200.0, reuse=False).mask.path for s in seeds)
    assert (one != other).any()
    np.testing.assert_array_equal(one, again)


def test_the_streets_of_a_varied_city_are_those_of_its_level_on_average() -> None:
    level = SkyLevel.named("urban")
    cities = [level.of_city(seed) for seed in range(400)]
    assert level.of_city(7) == cities[7]
    assert len({city.street_width_m for city in cities}) == 400
    assert len({tuple(s.kind for s in city.city.sections) for city in cities}) > 300
    whole = sum(section.length_m for section in level.city.sections)
    for kind in {section.kind for section in level.city.sections}:
        shares = [_length(city, kind) / _length(city) for city in cities]
        share = _length(level, kind) / whole
        assert np.mean(shares) == pytest.approx(share, abs=0.02)
        heights = np.array([city.city.street(kind).height_median_m for city in cities])
        own = level.city.street(kind).height_median_m
        if own:
            logs = np.log(heights / own)
            assert abs(logs.mean()) < 4.0 * 0.15 / np.sqrt(400)
            assert 0.8 * 0.15 < logs.std() < 1.1 * 0.15, "cut off at 2 sigma"
    materials = np.array([city.material_shares for city in cities])
    np.testing.assert_allclose(materials.sum(1), 1.0)
    np.testing.assert_allclose(materials.mean(0), level.material_shares, atol=4.0 * 0.11 / np.sqrt(400))


def _length(level: SkyLevel, kind: SectionKind | None = None) -> float:
    return sum(section.length_m for section in level.city.sections if kind in (None, section.kind))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"cities": {"count": 0}}, r"cities\.count must lie in \[1, 2147483648\], got 0"),
        ({"cities": {"split": "val"}}, r"cities\.split must be one of 'train' or 'test', got 'val'"),
        ({"cities": {"split": "test", "count": 101}}, r"cities\.count must be <= 100 with split 'test', got 101"),
        ({"layouts": 4}, r"layouts must be left out, got 4: set cities\.count"),
    ],
)
def test_refusals_name_field_bound_and_value(given: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        EnvConfig.load({"base": "LaneKeepingWorld", **given})
