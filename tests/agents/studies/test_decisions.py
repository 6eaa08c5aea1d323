"""Where a level decides: figures of drives under a constant error, medians of levels by age, and their tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers.clock import AGES_S
from lanebound.agents.studies.decisions import DRIVERS, SECTIONS, DecisionsConfig, _decided, assess_decisions, tables
from lanebound.integrity.core.errors import ConfigError, InputError

AWAY: dict[str, Any] = {
    "navigation": {"source": "offset", "offset_ct_m": 21.5},
    "perception": {"source": "none"},
    "world": {"vehicles_count": 0},
    "duration_s": 6.0,
}
ONE = {"one": "navigators/consumer"}


def test_a_position_on_the_other_road_shows_in_the_figures(tmp_path: Path) -> None:
    """To the right by the distance of the roads: from the motorway it is the collector road, from there no road."""
    few = {"envs": ["Guidance"], "navigators": ONE, "split": "train", "skip": 2, "seeds": 4, "fitted": 2}
    config = DecisionsConfig.load({**few, "overrides": AWAY})
    found = assess_decisions(config, tmp_path)
    assert list(found["places"]) == ["Guidance-one"]
    place = found["places"]["Guidance-one"]
    assert tuple(place["drivers"]) == tuple(DRIVERS)
    for part in place["drivers"].values():
        assert part["time_s"] == [6.0] * 4
        assert part["available"] == [0.0] * 4
        assert {round(share) for share in part["wrong_road"]} == {0, 1}
        assert part["error_m"] == pytest.approx([21.5] * 3, abs=0.1)
        assert part["beyond"] == 0
        assert not any(part["success"])
        assert part["throughput_mps"] == pytest.approx(part["speed_mps"]), "none ends before its longest time"
    assert place["drivers"]["clock"] == place["drivers"]["fixed"], "without RTK a clock stands still"
    assert place["drivers"]["clock_scaled"] == place["drivers"]["fixed_scaled"] != place["drivers"]["clock"]
    blocked = place["drivers"]["integrity_aware"]["causes"]["cost_blocking"]
    assert blocked < 0.05, "at the limit of the slower possible road a car does not block"
    shown = tables(found)
    assert tuple(shown) == SECTIONS
    for heads, rows in shown.values():
        assert all(len(row) == len(heads) for row in rows)
    assert [len(rows) for _, rows in shown.values()] == [1, 1, 7, 7, 1]
    assert assess_decisions(config, tmp_path)["places"] == found["places"]  # as kept


def test_medians_by_the_time_since_rtk_rise_in_outages(tmp_path: Path) -> None:
    """Under ``urban`` RTK is out for seconds; the level at any time is among those of the ages."""
    few = {"envs": ["LaneKeeping"], "navigators": ONE, "seeds": 2, "fitted": 4, "drivers": ["clock"]}
    place = assess_decisions(DecisionsConfig.load(few), tmp_path)["places"]["LaneKeeping-one"]
    for axis in ("at", "ct"):
        levels = place["levels"][f"pl_{axis}_m"]
        assert len(levels) == len(AGES_S)
        assert levels[0] < levels[2] < levels[4]
        assert levels[0] <= place["fixed"][f"pl_{axis}_m"][0] <= max(levels)
    for age, count, low, median, high, error, most in place["spread"]:
        assert median == place["levels"]["pl_ct_m"][AGES_S.index(age)]
        assert count >= 1
        assert low <= median <= high
        assert error <= most < high


def test_figures_of_the_scaled_driver_are_those_of_its_twins(tmp_path: Path) -> None:
    """At a level that may fill hardly any room both stand; the harm of standing is none."""
    few = {"envs": ["LaneKeeping"], "navigators": ONE, "split": "train", "skip": 2, "seeds": 2, "fitted": 2}
    few |= {"drivers": ["clock_scaled", "level_scaled"], "scaled": {"fill": 1e-3}, "overrides": {"duration_s": 8.0}}
    drivers = assess_decisions(DecisionsConfig.load(few), tmp_path)["places"]["LaneKeeping-one"]["drivers"]
    for part in drivers.values():
        assert max(part["throughput_mps"]) < 3.0
        assert max(part["harm"]) == 0.0
    assert drivers["clock_scaled"]["throughput_mps"] != drivers["level_scaled"]["throughput_mps"]


def test_harm_counts_an_end_once_and_the_area_beyond_the_lane(tmp_path: Path) -> None:
    """Displaced by a lane to the left a car that holds its believed lane leaves the road, or strikes what is there."""
    away = {"navigation": {"source": "offset", "offset_ct_m": -3.0}, "duration_s": 8.0}
    few = {"envs": ["LaneKeeping"], "navigators": ONE, "seeds": 4, "fitted": 2, "drivers": ["nominal"]}
    part = assess_decisions(DecisionsConfig.load({**few, "overrides": away}), tmp_path)["places"]["LaneKeeping-one"]
    found = part["drivers"]["nominal"]
    ended = np.array(found["crashed"]) + np.array(found["off_road"]) > 0
    beyond = np.array(found["harm"]) - 50.0 * ended
    assert ended.any()
    assert (beyond > 0.0).all()


def test_comparisons_without_any_difference_count_in_the_family() -> None:
    """A difference with p = 2^-7 is clear among three comparisons, and not among the 15 that were planned."""
    faster = {
        "harm": [0.0] * 8,
        "true_cost": [0.0] * 8,
        "throughput_mps": [12.0, 12.2, 11.8, 12.1, 11.9, 12.0, 12.3, 11.7],
    }
    slower = faster | {"throughput_mps": [speed - 2.0 for speed in faster["throughput_mps"]]}
    rest = {"available": [1.0] * 8}
    config = {"drivers": ["clock_scaled", "level_scaled"]}

    def verdicts(alike: int) -> list[str]:
        drivers = [{"clock_scaled": slower | rest, "level_scaled": faster | rest}]
        drivers += alike * [{"clock_scaled": slower | rest, "level_scaled": slower | rest}]
        places = {str(i): {"env": "one", "navigator": "one", "drivers": part} for i, part in enumerate(drivers)}
        return [row[-1] for row in _decided({"config": config, "places": places})[1]]

    assert verdicts(0) == ["20 % faster"]
    assert verdicts(4) == ["-"] * 5


def test_what_does_not_exist_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="navigator"):
        assess_decisions(DecisionsConfig.load({"navigators": {"one": "services/none"}}), tmp_path)
    with pytest.raises(InputError, match="drivers must be of"):
        DecisionsConfig.load({"drivers": ["ppo"]})
    with pytest.raises(InputError, match="skip must be >= fitted = 24"):
        DecisionsConfig.load({"split": "train"})
    assert not list(tmp_path.iterdir())
