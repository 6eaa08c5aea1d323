"""Broadcasts with recorded errors: what is recorded comes back, and which vehicle has the errors of which."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lanebound.envs import recordings
from lanebound.envs.batch.perception import PerceptionBatch
from lanebound.envs.batch.records_kernel import CAR, EGO
from lanebound.envs.batch.surrogate_kernel import NOTE, SAID, TRAITS, Recordings, note, stand_in_rows
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.perception import PerceptionConfig
from lanebound.envs.registration import make_config
from lanebound.envs.vector.crossing_kernel import INSIDE
from lanebound.envs.vector.recorder import Recorder
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.records import one_record

EPOCHS, CREW = 6, 3
pytestmark = pytest.mark.usefixtures("few_recordings")
FEW: dict[str, Any] = {"sky": "open", "cities": {"count": 1}, "duration_s": 2.0, "perception": {"others": "surrogate"}}
RNG = np.random.default_rng(3)  # of poses and errors on which no result depends
TRAIT = one_record(TRAITS, still_mps=0.15, speed_s=0.02, course_s=0.03)


def _recordings(episodes: int = 2, began: int = CREW, count: int = CREW) -> Recordings:
    """Random ones, of vehicles that all stay."""
    said = np.zeros((episodes, count, EPOCHS), SAID)
    for name in ("along_m", "across_m", "turn_rad", "speed_mps", "pl_at_m", "pl_ct_m"):
        said[name] = RNG.uniform(0.1, 0.4, said.shape)
    said["sends"] = 1
    lengths = np.full((episodes, count), EPOCHS)
    return Recordings(said, lengths, np.full(episodes, began), np.full(episodes, count), TRAIT)


def _street(given: Recordings, seed: int = 5) -> tuple[PerceptionBatch, Any, Any]:
    """One ego and three others with slots, each at a place, heading and speed of its own."""
    batch = PerceptionBatch(PerceptionConfig(others="surrogate"), 1, CREW, 1 + CREW, 0.1, given)
    cars, egos = np.zeros((1, 1 + CREW), CAR), np.zeros(1, EGO)
    cars["slot"], egos["vehicles"] = np.arange(-1, CREW), 1 + CREW
    cars["x"], cars["y"] = RNG.uniform(-40.0, 40.0, (2, 1, 1 + CREW))
    cars["heading"], cars["speed"] = RNG.uniform(-3.0, 3.0, (1, 4)), RNG.uniform(3.0, 20.0, (1, 4))
    batch.begin(np.zeros(1, np.int64), [seed], np.ones((1, CREW), np.bool_), cars)
    return batch, cars, egos


def _recite(batch: PerceptionBatch, cars: Any, egos: Any, time_s: float) -> Any:
    rows, p = np.zeros(1, np.int64), batch.pictures
    notes = np.zeros((1, CREW), NOTE)
    notes["move"] = batch._stand_ins.moves
    stand_in_rows(0, 1, rows, cars, egos, p, batch.recordings, batch._stand_ins, np.array([time_s]))
    note(rows, cars, egos, p, notes)
    return notes[0]


@pytest.mark.parametrize("epoch", range(EPOCHS))
def test_what_is_said_has_the_recorded_errors_whatever_the_pose(epoch: int) -> None:
    given = _recordings()
    batch, cars, egos = _street(given)
    heard = _recite(batch, cars, egos, 0.1 * epoch)
    chosen = given.said[batch._stand_ins.episode[0], :, epoch]
    for name in SAID.names or ():
        assert_allclose(heard["said"][name], chosen[name], rtol=1e-4, atol=1e-6, err_msg=name)


def test_before_an_episode_they_come_up_to_where_they_are() -> None:
    given = _recordings()
    batch, cars, egos = _street(given)
    now = _recite(batch, cars, egos, 0.0)["said"]["along_m"].copy()
    before = _recite(batch, cars, egos, -0.3)["said"]["along_m"]
    assert_allclose(now - before, 0.3 * cars["speed"][0, 1:], rtol=1e-5, atol=1e-5)


def test_one_that_stays_longer_goes_back_and_forth() -> None:
    given = _recordings()
    batch, cars, egos = _street(given)
    errors = [float(_recite(batch, cars, egos, 0.1 * k)["said"]["across_m"][0]) for k in range(3 * EPOCHS)]
    order = [0, 1, 2, 3, 4, 5, 4, 3, 2, 1, 0, 1, 2, 3, 4, 5, 4, 3]
    assert_allclose(errors, given.said["across_m"][batch._stand_ins.episode[0], 0, order], rtol=1e-4)


@pytest.mark.parametrize(
    ("began", "count", "keys", "expected"),
    [
        (2, 5, (1, 2, 4), (0, 1, 2)),  # the third at the start, but two recorded ones were; the first to enter
        (2, 5, (5, 6, 7), (3, 4, 2)),  # the fourth to enter speaks as the first again
        (3, 3, (1, 4, 6), (0, 0, 2)),  # none has entered
        (0, 2, (1, 2, 4), (0, 1, 0)),  # none was there
    ],
)
def test_which_recorded_vehicle_stands_in(began: int, count: int, keys: Any, expected: Any) -> None:
    given = _recordings(1, began, count)
    batch, cars, egos = _street(given)
    batch.pictures.slots["key"][0, :CREW] = keys
    heard = _recite(batch, cars, egos, 0.0)["said"]["across_m"]
    assert_allclose(heard, given.said["across_m"][0, list(expected), 0], rtol=1e-4)


def test_in_a_turn_the_course_is_said_and_at_rest_no_speed() -> None:
    given = _recordings()
    batch, cars, egos = _street(given)
    _recite(batch, cars, egos, 0.0)
    cars["heading"][0, 1:] += (0.05, 0.0, 0.0)  # 0.5 rad/s
    cars["speed"][0, 1:] = 10.0, 0.0, 10.0
    batch._stand_ins.moves["last_mps"][0] = 10.0, 0.0, 12.0
    cars["length"][0, 1:] = 5.0
    _recite(batch, cars, egos, 0.1)
    said, claims = given.said[batch._stand_ins.episode[0], :, 1], batch.pictures.spoken[0]
    slip = claims["heading_rad"] - cars["heading"][0, 1:] - said["turn_rad"]
    assert_allclose(slip, [np.arcsin(2.5 * 0.5 / 10.0) + 0.03 * 0.5, 0.0, 0.0], atol=1e-6)
    speeds = [10.0 + said["speed_mps"][0], 0.0, 11.0 + said["speed_mps"][2] + 0.02 * 20.0]
    assert_allclose(claims["speed_mps"], speeds, rtol=1e-6)


def test_what_errors_have_in_common_with_motion_is_taken_out() -> None:
    notes, rng = np.zeros((4, 200, 2), NOTE), np.random.default_rng(7)
    notes["move"]["key"], notes["move"]["speed_mps"] = 1, 8.0
    for name in ("yaw_radps", "braking_mps2"):
        notes["move"][name] = rng.normal(0.0, 1.0, notes.shape)
    rest = rng.normal(0.0, 0.01, (2, *notes.shape))
    notes["said"]["speed_mps"] = 0.05 * notes["move"]["braking_mps2"] + rest[0]
    notes["said"]["turn_rad"] = -0.04 * notes["move"]["yaw_radps"] + rest[1]
    traits = recordings._take_traits(notes, 0.15)[0]
    assert_allclose([traits["speed_s"], traits["course_s"]], [0.05, -0.04], rtol=0.03)
    assert_allclose(notes["said"]["speed_mps"], rest[0], atol=0.006)
    assert_allclose(notes["said"]["turn_rad"], rest[1], atol=0.006)


def test_the_ego_of_a_recording_does_not_matter() -> None:
    """In Intersection one that seems to stand inside keeps the others from entering."""
    config = make_config("lanebound/Intersection-v0", {"sky": "open", "cities": {"count": 1}, "duration_s": 6.0})
    driven = []
    for away_m in (recordings.AWAY_M, 2.0 * recordings.AWAY_M):
        recorder = Recorder(DrivingEnv(config), 3, away_m)
        recorder.record([1, 2, 3], 60)
        cars, kind = recorder.episodes.cars, recorder.roads.crossing.parts["kind"]
        assert (kind[cars["lane"][:, 0]] != INSIDE).all()
        driven.append(cars[["x", "y", "heading", "speed"]][:, 1:].copy())
    np.testing.assert_array_equal(driven[0], driven[1])


def test_the_radio_is_on_for_as_long_as_that_of_receivers() -> None:
    epochs = []
    for others in ("full", "surrogate"):
        env = DrivingEnv(make_config("lanebound/CarFollowing-v0", {**FEW, "perception": {"others": others}}))
        env.reset(seed=1)
        assert env.belief_loop is not None
        epochs.append(int(env.belief_loop.episodes.perception.pictures.picture["epoch"][0]))
    assert epochs[0] == epochs[1] > 3


def test_one_that_enters_begins_at_the_beginning() -> None:
    given = _recordings(1, 2, 4)
    batch, cars, egos = _street(given)
    _recite(batch, cars, egos, 0.3)
    batch.enter(0, 1, 4, 5.0, 2.0)
    for age in range(3):
        heard = _recite(batch, cars, egos, 0.4 + 0.1 * age)
        assert heard["move"]["key"][1] == 4
        assert_allclose(heard["said"]["across_m"][1], given.said["across_m"][0, 2, age], rtol=1e-4)


def test_episodes_are_drawn_evenly() -> None:
    given, seen = _recordings(4), np.zeros(4)
    for seed in range(200):
        seen[_street(given, seed)[0]._stand_ins.episode[0]] += 1
    assert (np.abs(seen - 50.0) < 25.0).all()  # 4 sigma: false alarm 2.5e-4


def test_recordings_are_made_once_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recordings, "cache_root", lambda: tmp_path)
    monkeypatch.setattr(recordings, "EPISODES", 3)
    config = make_config("lanebound/CarFollowing-v0", FEW)
    recordings._recordings.cache_clear()
    with caplog.at_level(logging.WARNING):
        first = recordings.recordings_of(config)
    assert "recording other vehicles" in caplog.text
    assert first.said.shape == (3, 1, 21)
    assert (first.vehicles == 1).all()
    assert (first.said["sends"] == 1).all()
    assert np.abs(first.said["across_m"]).max() < first.said["pl_ct_m"].max()
    caplog.clear()
    recordings._recordings.cache_clear()
    again = recordings.recordings_of(config.replace(cost_limit=3.0, observation={"form": "flat"}))
    assert not caplog.records, "what the agent sees does not change what others say"
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    (file,) = (tmp_path / "recordings").glob("*.npz")
    file.write_bytes(b"broken")
    recordings._recordings.cache_clear()
    np.testing.assert_array_equal(recordings.recordings_of(config).said, first.said)
    recordings._recordings.cache_clear()


def test_what_a_surrogate_cannot_do_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"perception\.others must be 'full' with faults 'nominal', got 'surrogate'"):
        EnvConfig.build({"base": "highway-v0"}, {"faults": "nominal", "perception": {"others": "surrogate"}})
    with pytest.raises(ConfigError, match=r"perception\.others must be 'full' with base 'merge-generic-v1'"):
        DrivingEnv(EnvConfig.build({"base": "merge-generic-v1"}, {"perception": {"others": "surrogate"}}))


def test_lies_of_those_without_receivers_are_refused() -> None:
    env = DrivingEnv(make_config("lanebound/CarFollowing-v0", {**FEW, "perception": {"source": "truth"}}))
    lie = {"kind": "v2v_lie", "start_s": 0.5, "magnitude_m": 5.0}
    with pytest.raises(InputError, match=r"faults\.0\.kind must not be v2v_lie where no other vehicle lies"):
        env.reset(seed=1, options={"faults": [lie]})
    env = DrivingEnv(make_config("lanebound/CarFollowing-v0", FEW))
    jamming = {"kind": "jamming", "start_s": 0.5, "magnitude_db": 20.0}
    with pytest.raises(InputError, match=r"faults\.0\.vehicle must be 0 with perception\.others surrogate, got None"):
        env.reset(seed=1, options={"faults": [jamming]})
    env.reset(seed=1, options={"faults": [{**jamming, "vehicle": 0}]})


def test_one_that_enters_knows_where_it_is() -> None:
    """Its navigator begins where the epoch has begun in which it enters; a step later would be 0.45 m ahead."""
    config = make_config(
        "lanebound/Intersection-v0", {"sky": "open", "cities": {"count": 1}, "world": {"spawn_probability": 0.9}}
    )
    notes = Recorder(DrivingEnv(config), 4, recordings.AWAY_M).record([1, 2, 3, 4], 60)
    key, said = notes["move"]["key"], notes["said"]
    entered = (key[:, 1:] > 0) & (key[:, 1:] != key[:, :-1])
    assert entered.sum() >= 6
    for name, level in (("along_m", "pl_at_m"), ("across_m", "pl_ct_m")):
        errors = np.abs(said[name][:, 1:][entered])
        assert errors.max() < 0.25, name  # 5 sigma of the start
        assert (errors < said[level][:, 1:][entered]).all()
