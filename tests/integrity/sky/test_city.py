"""Streets made up by rule: what stands where, reproducibly, and never on the road."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sky.city import STREETS, CityConfig, SectionConfig, SectionKind, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, prisms

ROAD = Road.straight(1000.0, 0.7, lane_count=3)
LOOP = Road.through([(0, 0), (0, 200), (250, 200), (250, 0)], closed=True, lane_count=2, corner_radius_m=12.0)


def _city(kind: SectionKind, road: Road = ROAD, seed: int = 3, **changes: float) -> City:
    return build_city(road, CityConfig.uniform(kind, **changes), np.random.default_rng(seed))


def test_prisms_are_closed_boxes() -> None:
    box = prisms([[[0, 0], [4, 0], [4, 2], [0, 2]]], 1.0, 6.0, floor=True)
    assert box.shape == (12, 3, 3)
    area = 0.5 * np.linalg.norm(np.cross(box[:, 1] - box[:, 0], box[:, 2] - box[:, 0]), axis=-1).sum()
    assert area == pytest.approx(2 * (4 * 2 + 4 * 5 + 2 * 5))
    assert prisms([[[0, 0], [4, 0], [4, 2], [0, 2]]], 1.0, 6.0).shape == (10, 3, 3)


def test_same_seed_same_city() -> None:
    first, second = _city(SectionKind.DENSE_CANYON), _city(SectionKind.DENSE_CANYON)
    np.testing.assert_array_equal(first.triangles_enu_m, second.triangles_enu_m)
    other = _city(SectionKind.DENSE_CANYON, seed=4)
    assert other.triangles_enu_m.shape != first.triangles_enu_m.shape or not np.array_equal(
        other.triangles_enu_m, first.triangles_enu_m
    )


@pytest.mark.parametrize("kind", [SectionKind.SUBURBAN, SectionKind.SEMI_URBAN, SectionKind.DENSE_CANYON])
def test_heights_follow_their_distribution(kind: SectionKind) -> None:
    city = _city(kind, Road.straight(6000.0))
    tops = city.triangles_enu_m.reshape(-1, 10, 9)[:, 0].reshape(-1, 3, 3)[:, :, 2].max(1)
    street = STREETS[kind]
    n = tops.size
    # sample median of log heights: standard error 1.2533 sd / sqrt(n); 4.5 of them fail by chance less than 1e-5
    error = np.log(np.median(tops) / street.height_median_m)
    assert abs(error) < 4.5 * 1.2533 * street.height_log_sd / np.sqrt(n)
    assert n > 200


@pytest.mark.parametrize("kind", list(SectionKind))
@pytest.mark.parametrize("road", [ROAD, LOOP], ids=["straight", "loop"])
def test_nothing_solid_stands_on_the_road(kind: SectionKind, road: Road) -> None:
    city = _city(kind, road)
    solid = city.triangles_enu_m[~city.foliage]
    standing = solid[solid[:, :, 2].min(1) < 4.5]
    if standing.size:
        weights = np.random.default_rng(0).dirichlet(np.ones(3), 20)
        points = np.einsum("wk,tkc->twc", weights, standing[:, :, :2])
        _, lateral = road.project(points)
        assert np.abs(lateral).min() >= road.edge_m + 0.6  # tunnel walls are straight pieces


def test_kinds_have_what_their_names_say() -> None:
    assert len(_city(SectionKind.OPEN)) == 0
    assert _city(SectionKind.TREES).foliage.any()
    slabs = _city(SectionKind.OVERPASS).triangles_enu_m
    assert slabs[..., 2].min() == 6.0
    assert slabs.shape[0] % 12 == 0
    tunnel = _city(SectionKind.TUNNEL).triangles_enu_m
    assert tunnel[..., 2].min() == 0.0
    assert tunnel[..., 2].max() == 7.0


def test_sections_repeat_and_sides_differ() -> None:
    config = CityConfig(
        sections=(
            SectionConfig(kind=SectionKind.DENSE_CANYON, length_m=100.0, left_kind=SectionKind.OPEN),
            SectionConfig(kind=SectionKind.OPEN, length_m=50.0),
        )
    )
    stretches = config.stretches(270.0)
    assert [(s.start_m, s.end_m) for s in stretches] == [(0, 100), (100, 150), (150, 250), (250, 270)]
    road = Road.straight(270.0)
    city = build_city(road, config, np.random.default_rng(0))
    arc, lateral = road.project(city.triangles_enu_m[..., :2])
    assert lateral.min() > 0.0  # the right only
    assert not ((arc > 101.0) & (arc < 149.0)).any()
    assert len(CityConfig.uniform(SectionKind.TREES).stretches(1000.0)) == 1


def test_side_streets_open_on_both_sides() -> None:
    road = Road.straight(500.0)
    city = _city(SectionKind.DENSE_CANYON, road, gap_probability=0.0, cross_street_m=20.0)
    arc, _ = road.project(city.triangles_enu_m[..., :2])
    low, high = arc.min(1), arc.max(1)
    free = [a for a in np.arange(0.0, 500.0, 1.0) if not ((low < a) & (a < high)).any()]
    assert len(free) >= 4 * 15


def test_config_refuses_nonsense() -> None:
    for bad in (
        {"sections": []},
        {"sections": [{"kind": "forest"}]},
        {"sections": [{"length_m": 1.0}]},
        {"streets": {"trees": {"height_log_sd": -1.0}}},
        {"street": {}},
    ):
        with pytest.raises(ConfigError):
            CityConfig.load(bad)
    config = CityConfig.uniform(SectionKind.TUNNEL, clearance_m=5.0)
    assert CityConfig.from_json(config.to_json()) == config
    assert config.street(SectionKind.TUNNEL).clearance_m == 5.0
    assert config.street(SectionKind.TREES) == STREETS[SectionKind.TREES]
