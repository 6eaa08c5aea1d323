"""Navigation in a batch: with the same draws it is the single environment's, and by its own draws it is as good."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_skies import wall_on_the_left

from lanebound.envs.batch.navigation import NavigationBatch
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.sky import cache
from lanebound.envs.vector.engine import Engine
from lanebound.integrity.core.errors import ConfigError
from side_by_side import Pairs, Tally, require_equal

pytestmark = pytest.mark.usefixtures("few_recordings")
FEW: dict[str, Any] = {"world": {"vehicles_count": 4}, "sky": "urban", "extent_m": 300.0, "cities": {"count": 2}}
CITY: dict[str, Any] = {
    "world": {"vehicles_count": 6, "spread": [-60.0, 90.0]},
    "sky": "urban",
    "extent_m": 300.0,
    "cities": {"count": 2},
}
SURROGATE: dict[str, Any] = {"perception": {"others": "surrogate"}, "duration_s": 8.0}
TRUTH, SENSOR, BOTH = ({"perception": {"source": source}} for source in ("truth", "sensor", "both"))
SEQUENTIAL: dict[str, Any] = {"navigator": {"positioning": {"rtk": {"float_solution": {"kind": "sequential"}}}}}
NEAR: dict[str, Any] = {"navigator": {"gnss": {"near_objects": {"kind": "vehicle"}}}}
CARRIERS: dict[str, Any] = {"navigator": {"positioning": {"doppler": {"carriers": True}}}}
BUDGET: dict[str, Any] = {"alert_limit": "budget"}
COOPERATIVE: dict[str, Any] = {"perception": {"source": "cooperative", "wrong_share": 0.5}}
CAM: dict[str, Any] = {
    "perception": {"source": "cooperative", "v2v": {"messages": "cam"}, "drop_after_s": 1.5, "sensor": {"corner_m": 12}}
}
PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}}
CASES: list[tuple[str, dict[str, Any], int]] = [
    ("LaneKeeping", {"sky": "dense", "cities": {"count": 2}}, 25),
    ("LaneKeeping", {"sky": "urban", "cities": {"count": 2}, **SEQUENTIAL}, 15),
    ("LaneKeeping", {"sky": "open", "action": "meta", "observation": {"history": 2, "satellites_m": []}}, 8),
    ("CarFollowing", {"sky": "open"}, 15),
    ("Highway", {**FEW, **BOTH, "sky": "open"}, 6),
    ("CarFollowing", {"sky": "open", **PERFECT, **SENSOR}, 6),
    ("Highway", FEW, 10),
    ("Highway", {**FEW, **TRUTH, "sky": "open", "observation": {"integrity": "oracle"}}, 5),
    ("Highway", {**FEW, **PERFECT, "sky": "open"}, 5),
    ("UrbanCanyon", {**CITY, "sky": "open"}, 8),
    ("UrbanCanyon", {**CITY, **BOTH}, 6),
    ("LaneKeeping", {"sky": "urban", "cities": {"count": 2}, "navigator": "services/rtk_dfmc"}, 15),
    ("CarFollowing", {"sky": "open", "navigator": "services/sbas_l1"}, 8),
    ("CarFollowing", {"sky": "open", **NEAR}, 8),
    ("LaneKeeping", {"sky": "urban", "cities": {"count": 2}, **CARRIERS}, 25),
    ("Highway", {**FEW, **SENSOR, **NEAR}, 5),
    ("Racetrack", {"sky": "open", "cities": {"count": 1}}, 8),
    ("Merge", {"sky": "urban", "cities": {"count": 1}, **BOTH}, 8),
    ("Roundabout", {"sky": "urban", "cities": {"count": 1}}, 12),
    ("Roundabout", {"sky": "open", "cities": {"count": 1}, **SENSOR, "observation": {"integrity": "oracle"}}, 6),
    ("Intersection", {"sky": "open", "cities": {"count": 1}}, 14),
    ("Intersection", {"sky": "open", "cities": {"count": 1}, **TRUTH}, 8),
    ("Highway", {**FEW, **COOPERATIVE}, 8),
    ("UrbanCanyon", {**CITY, **COOPERATIVE}, 6),
    ("Intersection", {"sky": "open", "cities": {"count": 1}, **CAM}, 14),
    ("Highway", {**FEW, **SURROGATE}, 10),
    ("Highway", {**FEW, **BUDGET}, 8),
    ("CarFollowing", {"sky": "urban", "cities": {"count": 1}, **BUDGET}, 15),
    ("Merge", {"sky": "open", "cities": {"count": 1}, **PERFECT, **BUDGET}, 8),
    ("CarFollowing", {"sky": "open", **PERFECT, **SURROGATE}, 10),
    ("UrbanCanyon", {**CITY, **SURROGATE, "perception": {"source": "both", "others": "surrogate"}}, 6),
    ("Intersection", {"sky": "open", "cities": {"count": 1}, **SURROGATE}, 8),
]


@pytest.mark.parametrize(("name", "config", "steps"), CASES)
def test_with_the_same_draws_it_is_the_single_environment(name: str, config: dict[str, Any], steps: int) -> None:
    pairs = Pairs(name, config, 2, 5)
    pairs.step(steps)
    require_equal(pairs.tally)
    assert pairs.tally.steps >= 8
    crews = pairs.engine.episodes.ego["vehicles"]
    assert name != "UrbanCanyon" or crews[0] != crews[1], "one has an empty place that the other has not"


def test_an_oracle_is_foretold_the_sky_of_its_true_lane() -> None:
    """Under a seed where the navigator takes itself to be in another lane for a moment."""
    pairs = Pairs("Highway", {**FEW, **TRUTH, "sky": "open", "observation": {"integrity": "oracle"}}, 3, 103)
    pairs.step(12)
    require_equal(pairs.tally)


def test_under_a_recorded_sky_it_is_the_single_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "streets")
    wall_on_the_left().save(tmp_path / "wall.csv")
    pairs = Pairs("LaneKeeping", {"sky": str(tmp_path / "wall.csv"), "cities": {"count": 2}}, 3, 5)
    pairs.step(25)
    require_equal(pairs.tally)
    assert pairs.tally.steps >= 20


def test_an_episode_that_starts_while_others_drive_is_the_single_one() -> None:
    pairs = Pairs("CarFollowing", {"sky": "open", "cities": {"count": 1}}, 2, 5)
    for steps in (1, 7, 4):  # whatever the others' messages are at
        pairs.step(steps)
        pairs.reset(np.array([1]), 40 + steps)
    pairs.step(6)
    require_equal(pairs.tally)
    assert pairs.tally.steps == 36


OUTAGES: dict[str, Any] = {"navigator": {"corrections": {"outage_per_h": 900.0}}}
COLD: dict[str, Any] = {"navigator": {"imu": {"mems_exponential": True}}}


DIRECTION = {"fde": {"search": "direction"}, "risk": {"constellation_prior": [1e-6] * 5}}


def detector(kind: str) -> dict[str, Any]:
    """A navigator's detector of reflected signals."""
    return {"gnss": {"reflection_detector": {"kind": kind}}}


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("LaneKeeping", {"sky": "dense", "cities": {"count": 2}, "observation": {"history": 2, "satellites_m": []}}),
        (
            "LaneKeeping",
            {"sky": "dense", "cities": {"count": 2}, "navigator": {**DIRECTION, **detector("code_doppler")}},
        ),
        ("LaneKeeping", {"sky": "dense", "cities": {"count": 2}, "navigator": detector("two_band_cn0")}),
        ("CarFollowing", {"sky": "open", "cities": {"count": 2}, **OUTAGES, **PERFECT, **SENSOR}),
        ("LaneKeeping", {"sky": "open", "cities": {"count": 2}, "navigator": OUTAGES["navigator"] | COLD["navigator"]}),
        ("Highway", {**FEW, **OUTAGES}),
        ("UrbanCanyon", {**CITY, **BOTH}),
        ("Intersection", {"sky": "open", "cities": {"count": 1}, **BOTH, "world": {"spawn_probability": 0.5}}),
        ("Intersection", {"sky": "open", "cities": {"count": 1}, **SURROGATE, "world": {"spawn_probability": 0.5}}),
        (
            "Intersection",
            {"sky": "urban", "cities": {"count": 2}, "extent_m": 300.0, "world": {"spawn_probability": 0.6}},
        ),
        ("LaneKeeping", {"sky": "open", "cities": {"count": 1}, "navigation": {"warm_up_s": 0.75}}),
        ("LaneKeeping", {"sky": "open", "cities": {"count": 1}, **CARRIERS}),
    ],
)
def test_later_episodes_are_those_of_the_single_one(name: str, config: dict[str, Any]) -> None:
    """With links that fail, instruments that warm up, crews that differ."""
    pairs = Pairs(name, config, 3, 5)
    for rows in ([1], [0, 2], [1, 2], [2], [0, 1, 2]):
        pairs.step(3)
        pairs.reset(np.array(rows), None)
    pairs.step(3)
    require_equal(pairs.tally)
    assert pairs.tally.steps >= 40


def test_a_start_that_was_interrupted_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = Pairs("CarFollowing", {"sky": "open", "cities": {"count": 1}}, 2, 5)

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(NavigationBatch, "begin", interrupt)
        with pytest.raises(KeyboardInterrupt):
            pairs.engine.reset(np.array([0]), [None])
    for rows in ([0], [0, 1]):
        pairs.reset(np.array(rows), None)
        pairs.step(2)
    require_equal(pairs.tally)


def test_a_seed_puts_an_end_to_what_was_ready() -> None:
    pairs = Pairs("CarFollowing", {"sky": "open", "cities": {"count": 1}}, 2, 5)
    pairs.reset(np.array([0]), None)  # makes the next of both ready
    pairs.reset(np.array([1]), 77)
    pairs.reset(np.array([1]), None)
    pairs.step(3)
    require_equal(pairs.tally)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "config", "steps"), CASES)
def test_with_the_same_draws_for_long(name: str, config: dict[str, Any], steps: int) -> None:
    tally = Tally()
    for seed in range(0, 60, 3):
        Pairs(name, config, 3, 100 + seed, tally).step(30 * steps)
    require_equal(tally, parted=12)
    assert tally.episodes == 60


def test_environments_start_anew_beside_others() -> None:
    made = make_config("lanebound/LaneKeeping-v0", {"sky": "open", "duration_s": 1.0})
    engine = Engine(DrivingEnv(made), 4)
    engine.reset(np.arange(4), [3, 4, 5, 6])
    engine.reset(np.array([1]), [7])
    ends = np.zeros(4, dtype=np.int64)
    for _ in range(12):
        engine.step(np.zeros((4, 2), dtype=np.float32))
        out = engine.outcome
        over = (out["terminated"] > 0.0) | (out["truncated"] > 0.0)
        ends += over
        assert (np.abs([out["err_at_m"], out["err_ct_m"]]) < 1.0).all()  # another's solution would be far off
        if over.any():
            engine.reset(np.flatnonzero(over), [None] * int(over.sum()))
    assert (ends >= 2).all()


def test_the_same_seed_gives_the_same_bits_however_many_there_are() -> None:
    made = make_config("lanebound/Highway-v0", {**FEW, "sky": "open"})
    three, one = Engine(DrivingEnv(made), 3), Engine(DrivingEnv(made), 1)
    drives = []
    for engine, seeds in ((three, [11, 12, 13]), (three, [11, 12, 13]), (one, [12])):
        engine.reset(np.arange(engine.count), list(seeds))
        for n in range(3):
            engine.step(np.full(engine.count, n % 5))
        engine.reset(np.array([engine.count // 2]), [None])
        engine.step(np.full(engine.count, 3))
        drives.append(engine.episodes.frame.copy())
    np.testing.assert_array_equal(drives[0], drives[1])
    np.testing.assert_array_equal(drives[0][1], drives[2][0])


def test_levels_and_errors_are_those_of_navigation() -> None:
    made = make_config("lanebound/LaneKeeping-v0", {"sky": "open", "duration_s": 30.0})
    engine = Engine(DrivingEnv(made), 24)
    engine.reset(np.arange(24), list(range(24)))
    for _ in range(25):
        engine.step(np.zeros((24, 2), dtype=np.float32))
    out, sky = engine.outcome, engine.episodes.views.sky
    error = np.abs([out["err_at_m"], out["err_ct_m"]])
    assert (error < [out["pl_at_m"], out["pl_ct_m"]]).mean() > 0.95
    assert 0.005 < np.median(error) < 0.2
    assert (sky.max(1) > 10).all()
    assert len(np.unique(sky[:, 1])) > 3, "the hours must differ"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"policy_hz": 4, "navigation": {"rate_hz": 10.0}}, "policy_hz"),
    ],
)
def test_what_navigation_cannot_do_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Engine(DrivingEnv(make_config("lanebound/Highway-v0", {**FEW, **change})), 2)


def test_undifferenced_observables_are_those_of_the_single_environment() -> None:
    """The engine has places for the satellites of all hours; those in view have the same bits."""
    undifferenced = {"navigator": {"gnss": {"undifferenced": True}}}
    pairs = Pairs("LaneKeeping", {"sky": "open", "cities": {"count": 1}, **undifferenced}, 2, 11)
    pairs.step(3)
    navigation: Any = pairs.engine.episodes.navigation
    batch = navigation.measurements.gnss
    for row, single in enumerate(pairs.singles):
        loop: Any = single.belief_loop
        alone = loop.episodes.navigation.measurements.gnss
        assert alone.tracked[0].any()
        for name in ("raw_code_m", "raw_phase_m"):
            found = getattr(batch, name)[row][batch.tracked[row]]
            np.testing.assert_array_equal(found, getattr(alone, name)[0][alone.tracked[0]])
