"""Given the same poses of all vehicles, the engine has the observations, rewards and infos of single ones, bit for bit.

The engine replays the poses of the single environments; whatever follows from them is its own: navigation, perception,
beliefs, commands, scores, costs, observations, ends.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from replay import Replay

WORLDS: dict[str, dict[str, Any]] = {
    "LaneKeeping": {"lanes_count": 2},
    "CarFollowing": {},
    "Highway": {"vehicles_count": 4},
    "UrbanCanyon": {"vehicles_count": 5, "spread": [-60.0, 90.0]},
}
SOURCES = ("v2v", "sensor", "both", "truth", "none")
SHOWN = ("full", "blind", "oracle")
ACTIONS = ("meta", "continuous")
POSITIONS = ("navigator", "perfect")
CITY: dict[str, Any] = {"sky": "urban", "cities": {"count": 1}, "extent_m": 300.0}
FEW = [  # every pair of two options
    (name, source, SHOWN[(i + j) % 3], ACTIONS[(i + j) % 2], POSITIONS[(i + j // 2) % 2])
    for i, name in enumerate(WORLDS)
    for j, source in enumerate(SOURCES)
]
OTHERS: list[tuple[str, dict[str, Any]]] = [
    ("LaneKeeping", {"sky": "dense", "cities": {"count": 2}, "observation": {"history": 2, "satellites_m": []}}),
    ("LaneKeeping", {"navigation": {"source": "offset", "offset_at_m": 0.7, "offset_ct_m": -0.4}}),
    ("CarFollowing", {"sky": "open", "navigator": {"corrections": {"outage_per_h": 900.0}}}),
    ("Highway", {"action": "continuous", "actuators": None, "keep_lane": False, "reward": {"base": 0.5}}),
    ("Racetrack", {}),
    ("Merge", {}),
    ("Roundabout", {}),
    ("Roundabout", {"navigation": {"source": "perfect"}, "observation": {"integrity": "oracle"}}),
]


def _given(name: str, source: str, shown: str, action: str, position: str) -> dict[str, Any]:
    """The configuration of options."""
    return {
        **CITY,
        "world": WORLDS[name],
        "perception": {"source": source},
        "observation": {"integrity": shown},
        "action": action,
        "navigation": {"source": position},
    }


def _require_equal(name: str, config: dict[str, Any], steps: int, count: int = 2) -> None:
    replay = Replay(name, config, count, 5)
    replay.step(steps)
    assert replay.differences == {}
    assert replay.steps == steps * count


@pytest.mark.parametrize(("name", "source", "shown", "action", "position"), FEW)
def test_every_bit_is_the_same(name: str, source: str, shown: str, action: str, position: str) -> None:
    _require_equal(name, _given(name, source, shown, action, position), 12)


@pytest.mark.parametrize(("name", "config"), OTHERS)
def test_every_bit_of_other_configurations_is_the_same(name: str, config: dict[str, Any]) -> None:
    _require_equal(name, {**CITY, "world": WORLDS.get(name, {}), **config}, 12)


def test_a_pose_that_differs_is_found() -> None:
    replay = Replay("Highway", _given("Highway", "sensor", "full", "meta", "navigator"), 1, 5)
    replay.step(1)
    replay.shift_m = 1e-9
    replay.step(1)
    assert "poses" in replay.differences
    assert "info err_at_m" in replay.differences


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "source", "shown", "action", "position"), list(product(WORLDS, SOURCES, SHOWN, ACTIONS, POSITIONS))
)
def test_every_bit_is_the_same_for_long(name: str, source: str, shown: str, action: str, position: str) -> None:
    """Half a minute of a single environment, or several episodes that end earlier."""
    config = _given(name, source, shown, action, position)
    _require_equal(name, config, 60 if action == "meta" else 150, count=1)
