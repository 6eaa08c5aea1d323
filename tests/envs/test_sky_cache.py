"""Streets are found again by what they follow from, and built anew when they cannot be."""

from __future__ import annotations

import os
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from highway_env.road.road import RoadNetwork

from lanebound.envs.sky import SkyLevel, Street, build, build_street, cache
from lanebound.integrity.sky.city import CityConfig, SectionKind

LEVEL = SkyLevel(city=CityConfig.uniform(SectionKind.SEMI_URBAN))


def road(length_m: float = 60.0) -> RoadNetwork:
    return RoadNetwork.straight_road_network(1, length=length_m)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "streets")
    monkeypatch.setattr(cache, "_recent", OrderedDict())
    return tmp_path / "streets"


def forbid_building(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> Street:
        raise AssertionError("built again")

    monkeypatch.setattr(build, "_build", refuse)


def test_a_street_comes_from_memory_then_from_disk_bit_for_bit(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = build_street(road(), LEVEL, 0)
    forbid_building(monkeypatch)
    assert build_street(road(), LEVEL, 0) is first
    cache._recent.clear()
    again = build_street(road(), LEVEL, 0)
    assert again is not first
    np.testing.assert_array_equal(again.mask.path, first.mask.path)
    np.testing.assert_array_equal(again.mask.excess_m, first.mask.excess_m)
    np.testing.assert_array_equal(again.city.triangles_enu_m, first.city.triangles_enu_m)
    np.testing.assert_array_equal(again.forecast.free, first.forecast.free)
    assert replace(again.forecast, free=first.forecast.free) == first.forecast
    assert again.mask.path.dtype == np.uint8
    assert again.mask.excess_m.dtype == np.float32
    assert again.lanes == first.lanes
    assert [file.suffix for file in place.iterdir()] == [".npz"]


def test_whatever_a_street_follows_from_names_it() -> None:
    keys = [
        cache.key_of(road(), LEVEL, 0, ()),
        cache.key_of(road(61.0), LEVEL, 0, ()),
        cache.key_of(road(), LEVEL.replace(street_width_m=30.0), 0, ()),
        cache.key_of(road(), LEVEL.replace(map={"height_sigma_m": 1.0}), 0, ()),
        cache.key_of(road(), LEVEL, 1, ()),
        cache.key_of(road(), LEVEL, 0, (("0", "1", 0.0, 5.0, "open"),)),
    ]
    assert len(set(keys)) == len(keys)
    assert cache.key_of(road(), LEVEL, 0, ()) == keys[0]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut short", b"no archive"])
def test_a_damaged_file_is_built_anew(place: Path, content: bytes) -> None:
    first = build_street(road(), LEVEL, 0)
    next(place.iterdir()).write_bytes(content)
    cache._recent.clear()
    np.testing.assert_array_equal(build_street(road(), LEVEL, 0).mask.path, first.mask.path)
    assert len(next(place.iterdir()).read_bytes()) > 100


def test_a_file_with_damaged_blocks_is_built_anew(place: Path) -> None:
    first = build_street(road(), LEVEL, 0)
    whole = next(place.iterdir()).read_bytes()
    for at in range(200, len(whole) - 400, len(whole) // 12):
        next(place.iterdir()).write_bytes(whole[:at] + b"\xff" * 64 + whole[at + 64 :])
        cache._recent.clear()
        np.testing.assert_array_equal(build_street(road(), LEVEL, 0).mask.path, first.mask.path)


def test_no_place_to_write_is_no_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_recent", OrderedDict())
    blocked = tmp_path / "file"
    blocked.write_text("a file where a folder should be")
    for place in (None, blocked / "streets"):
        monkeypatch.setattr(cache, "folder", lambda place=place: place)
        cache._recent.clear()
        assert len(build_street(road(), LEVEL, 0).city)


def test_memory_and_disk_are_bounded(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "IN_MEMORY", 2)
    build_street(road(20.0), LEVEL, 0)
    size = next(place.iterdir()).stat().st_size
    monkeypatch.setattr(cache, "ON_DISK_BYTES", 4 * size)
    for seed in range(1, 12):
        build_street(road(20.0), LEVEL, seed)
    assert len(cache._recent) == 2
    kept = list(place.iterdir())
    assert len(kept) >= 2
    assert sum(file.stat().st_size for file in kept) <= 4 * size


def test_a_street_that_is_loaded_is_kept_longer_than_one_that_is_not(place, monkeypatch):
    for seed in (1, 2):
        build_street(road(), LEVEL, seed)
    for age, file in enumerate(sorted(place.glob("*.npz"))):
        os.utime(file, (1000.0 + age, 1000.0 + age))
    oldest = min(place.glob("*.npz"), key=lambda file: file.stat().st_mtime)
    cache._recent.clear()
    for seed in (1, 2):
        build_street(road(), LEVEL, seed)
    assert oldest.stat().st_mtime > 2000.0
