"""Faults in the engine are those of single environments: the same draws, effects and lies, each by its own clock."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from lanebound.envs.config import FaultLevel
from lanebound.envs.core import DrivingEnv
from lanebound.envs.info import FAULT_INFO
from lanebound.envs.registration import make_config
from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.env import VectorCarFollowing, VectorLaneKeeping
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.campaign import FaultPriors
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import Fault
from side_by_side import PERFECT, Pairs, require_equal

SMALL: dict[str, Any] = {"sky": "open", "cities": {"count": 1}}
FEW: dict[str, Any] = {"world": {"vehicles_count": 4}, "sky": "urban", "extent_m": 300.0, "cities": {"count": 2}}
GENTLE: Mapping[str, Any] = {
    "satellite_range": {"magnitude_m": 6.0, "profile": "ramp", "ramp_s": 1.0},
    "constellation": {"magnitude_m": 3.0, "profile": "ramp", "ramp_s": 1.0},
    "cycle_slip": {"magnitude_cycles": 3},
    "reference_coordinates": {"magnitude_m": 0.5},
    "spoofing": {"magnitude_m": 4.0, "profile": "ramp", "ramp_s": 1.5},
    "jamming": {"magnitude_db": 15.0},
    "corrections_loss": {},
    "gyro_bias": {"magnitude_degps": 1.0},
    "wheel_slip": {"magnitude_ratio": 0.2},
    "odometer_frozen": {},
    "v2v_lie": {"magnitude_m": 3.0, "magnitude_ratio": -0.5},
    "wrong_fix": {"magnitude_rank": 1},
    "nlos_burst": {"magnitude_m": 20.0},
}
BUSY = {kind.name: {"per_h": 4000.0 if kind.target.name in ("STREET", "VEHICLE") else 300.0, "median_s": 0.6,
                    "low": 0.5, "high": 3.0} for kind in fault_kinds()}  # fmt: skip
"""Some faults in a second."""


def _navigation(owner: Any) -> Any:
    """Of an engine, or of a single environment."""
    return (owner if isinstance(owner, Engine) else owner.belief_loop).episodes.navigation


def _fault(kind: str, number: int, single: DrivingEnv) -> Fault:
    """A fault of a kind, on the highest satellite of its sky where it is of one, at an onset of its own."""
    navigation = _navigation(single)
    sky = navigation._sky_over(0)
    highest = int(np.argmax(np.where(sky.above[0], sky.elevation_rad[0], -1.0)))
    system, prn = int(sky.system[highest]), int(sky.prn[highest])
    struck = {"satellite_range": {"system": system, "prn": prn}, "constellation": {"system": 0},
              "cycle_slip": {"system": system}, "v2v_lie": {"vehicle": 1}}.get(kind, {})  # fmt: skip
    return Fault.load({"kind": kind, "start_s": 0.1 * (number % 4), "duration_s": 1.2, **struck, **GENTLE[kind]})


def test_every_kind_has_the_effects_that_it_has_in_a_single_environment() -> None:
    """One engine, in which each environment has another kind of fault, and one has none."""
    kinds = [kind.name for kind in fault_kinds()]
    pairs = Pairs("CarFollowing", {**SMALL, "policy_hz": 10}, len(kinds) + 1, 5)
    assert pairs.engine.episodes.navigation is not None
    faults = [[_fault(kind, n, single)] for n, (kind, single) in enumerate(zip(kinds, pairs.singles, strict=False))]
    pairs.reset(np.arange(len(kinds) + 1), 5, [*faults, None])
    navigation = _navigation(pairs.engine)
    shape = navigation.count, navigation.vehicles
    blank, seen, lied = FaultEffects.blank(navigation.motions.size, navigation.skies.satellites), set(), False
    for _ in range(14):
        pairs.step(1)
        if navigation.effects is not None:
            now = navigation.effects
            struck = (now.signals != blank.signals).any(1) | (now.vehicles != blank.vehicles)
            seen |= set(np.flatnonzero(struck.reshape(shape).any(1)).tolist())
        lied = lied or navigation.lies is not None
    require_equal(pairs.tally)
    assert pairs.tally.steps == 14 * (len(kinds) + 1)
    assert seen == set(range(len(kinds))), "each acts in its own environment alone"
    assert lied


@pytest.mark.parametrize(("name", "config"), [("LaneKeeping", SMALL), ("CarFollowing", SMALL), ("Highway", FEW)])
def test_random_faults_are_those_of_single_environments(
    name: str, config: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In first episodes, and in later ones, which have been prepared ahead beside others that drive."""
    monkeypatch.setattr(FaultLevel, "priors", property(lambda self: FaultPriors.load(BUSY)))
    pairs = Pairs(name, {**config, "faults": "stress", "duration_s": 6.0}, 3, 5)
    some = []
    for rows in ([1], [0, 2], [1, 2], [2], [0, 1, 2]):
        navigation = _navigation(pairs.engine)
        for row, single in enumerate(pairs.singles):
            (drawn,) = _navigation(single).faults.schedules
            assert navigation.faults.schedules[row].faults == drawn.faults
            some.append(len(drawn.faults))
        pairs.step(3)
        pairs.reset(np.array(rows), None)
    pairs.step(3)
    require_equal(pairs.tally)
    assert pairs.tally.steps >= 40
    assert min(some) >= 1
    assert len(set(some)) > 3, "each episode has faults of its own"


@pytest.mark.parametrize(("name", "config"), [("LaneKeeping", SMALL), ("CarFollowing", SMALL)])
def test_one_fault_in_each_episode_is_that_of_single_environments(name: str, config: dict[str, Any]) -> None:
    """Fault, weight and probabilities, to the bit, in first episodes and in prepared ones; each tells its own."""
    pairs = Pairs(name, {**config, "faults": "one", "duration_s": 6.0}, 3, 5)
    told = []
    for rows in ([1], [0, 2], [1, 2], [0, 1, 2]):
        navigation, own = _navigation(pairs.engine), pairs.engine.own_info
        for row, single in enumerate(pairs.singles):
            assert single.belief_loop is not None
            ((fault,), info) = _navigation(single).faults.schedules[0].faults, single.belief_loop.info
            assert navigation.faults.schedules[row].faults == (fault,)
            assert fault.vehicle in (None, 0)
            assert {key: values[row] for key, values in own.items()} == {key: info[key] for key in FAULT_INFO}
            assert fault_kinds()[int(info["fault_kind"])].name == fault.kind
            start_s = single.config.navigation.clock_start_s
            assert fault.start_s == info["fault_onset_s"] + start_s
            assert 0.0 <= info["fault_onset_s"] < 6.0
            told.append(tuple(info[key] for key in FAULT_INFO))
        pairs.step(3)
        pairs.reset(np.array(rows), None)
    require_equal(pairs.tally)
    assert len({kind for kind, *_ in told}) > 2, "episodes have faults of several kinds"
    assert all(0.9 < p0 + p1 < 1.0 and p1 < 0.1 < p0 for *_, p1, p0 in told)


def test_one_fault_is_told_in_gymnasium_form_and_by_processes() -> None:
    """At reset and in each step; the end of an episode tells the fault that it had, not that of the next."""
    config = {**SMALL, "faults": "one", "duration_s": 0.6}
    here = VectorLaneKeeping(3, config, AutoresetMode.SAME_STEP)
    apart = VectorLaneKeeping(3, config, AutoresetMode.SAME_STEP, processes=2)
    still = np.zeros((3, 2), dtype=np.float32)
    try:
        (_, first), (_, theirs) = here.reset(seed=1), apart.reset(seed=1)
        for _ in range(3):
            infos, told = here.step(still)[4], apart.step(still)[4]
        for key in FAULT_INFO:
            np.testing.assert_array_equal(first[key], theirs[key])
            np.testing.assert_array_equal(infos["final_info"][key], first[key])
            np.testing.assert_array_equal(told["final_info"][key], first[key])
            np.testing.assert_array_equal(infos[key], told[key])
        assert (infos["fault_onset_s"] != first["fault_onset_s"]).all()
    finally:
        apart.close()


def test_one_fault_goes_with_no_given_faults_and_needs_a_navigator() -> None:
    config = {**SMALL, "faults": "one"}
    engine, single = VectorLaneKeeping(1, config), DrivingEnv(make_config("lanebound/LaneKeeping-v0", config))
    for env in (engine, single):
        for faults in ([], [{"kind": "spoofing", "magnitude_m": 3.0}]):
            with pytest.raises(InputError, match=r"options\.faults must be left out with faults 'one', got \d: set "):
                env.reset(seed=1, options={"faults": faults})
            with pytest.raises(InputError, match="reset must come before"):
                env.step(np.zeros((1, 2) if env is engine else 2, dtype=np.float32))
    for source in ("perfect", "offset"):
        with pytest.raises(
            ConfigError, match=rf"navigation\.source must be 'navigator' with faults 'one', got '{source}'"
        ):
            make_config("lanebound/LaneKeeping-v0", {"faults": "one", "navigation": {"source": source}})


def test_where_nothing_navigates_random_faults_do_nothing() -> None:
    pairs = Pairs("LaneKeeping", {**SMALL, **PERFECT, "faults": "stress"}, 2, 5)
    pairs.step(3)
    require_equal(pairs.tally)
    assert _navigation(pairs.engine) is None


def test_given_faults_are_of_the_episodes_for_which_they_are_given() -> None:
    """They replace those of an episode that was prepared ahead; the next episode has random ones again."""
    pairs = Pairs("LaneKeeping", {**SMALL, "faults": "stress"}, 3, 5)
    shift = [Fault(kind="reference_coordinates", magnitude_m=1.5)]
    for rows, faults in (([1], [shift]), ([0, 1], [[], shift]), ([0, 1, 2], [None, shift, None]), ([1], [None])):
        pairs.reset(np.array(rows), None, faults)
        pairs.step(4)
        schedules = _navigation(pairs.engine).faults.schedules
        assert (len(schedules[1].faults) == 1) == (faults[-1] is not None or len(faults) == 3)
    require_equal(pairs.tally)


def test_the_vector_environment_takes_faults_as_single_ones_do() -> None:
    plain, jammed = VectorLaneKeeping(2, SMALL), VectorLaneKeeping(2, SMALL)
    jam = {"kind": "jamming", "magnitude_db": 60.0, "duration_s": 5.0}
    plain.reset(seed=1)
    jammed.reset(seed=1, options={"faults": [jam]})
    still = np.zeros((2, 2), dtype=np.float32)
    assert plain.step(still)[4]["mode"].tolist() == [Mode.RTK, Mode.RTK]
    assert jammed.step(still)[4]["mode"].tolist() == [Mode.IMU_ODOMETER, Mode.IMU_ODOMETER]
    twin = pickle.loads(pickle.dumps(jammed))
    found, again = jammed.step(still)[4], twin.step(still)[4]
    np.testing.assert_array_equal(found["pl_ct_m"], again["pl_ct_m"])
    assert again["mode"].tolist() == [Mode.IMU_ODOMETER, Mode.IMU_ODOMETER], "faults are part of what pickle keeps"
    mask = np.array([False, True])
    jammed.reset(options={"faults": [jam], "reset_mask": mask})
    assert [len(s.faults) for s in _navigation(jammed.engine).faults.schedules] == [1, 1]
    jammed.reset(options={"reset_mask": mask})
    assert [len(s.faults) for s in _navigation(jammed.engine).faults.schedules] == [1, 0]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"start_s": 60.0}, r"options\.faults\.1\.start_s must be before the end of the episode, 60 s, got 60"),
        ({"vehicle": 2}, r"options\.faults\.1\.vehicle must be below 2, .*, got 2"),
        ({"kind": "satellite_range", "system": 0, "prn": 99}, r"options\.faults\.1\.prn must be .*, got 99: it has "),
    ],
)
def test_faults_that_cannot_act_are_refused_as_in_a_single_environment(fault: dict[str, Any], message: str) -> None:
    """After a refusal the environments must be reset; they go on as single ones do."""
    config = make_config("lanebound/CarFollowing-v0", {**SMALL, "duration_s": 60.0})
    engine, single = VectorCarFollowing(1, {**SMALL, "duration_s": 60.0}), DrivingEnv(config)
    good = {"kind": "spoofing", "magnitude_m": 3.0, "vehicle": 0}
    told = []
    for env in (engine, single):
        with pytest.raises(InputError, match=message) as refused:
            env.reset(seed=1, options={"faults": [good, {**good, **fault}]})
        told.append(str(refused.value))
    assert told[0] == told[1]
    with pytest.raises(InputError, match="reset must come before"):
        engine.step(np.zeros((1, 2), dtype=np.float32))
    with pytest.raises(InputError, match="reset must come before"):
        single.step(np.zeros(2, dtype=np.float32))
    np.testing.assert_array_equal(engine.reset()[0]["ego"][0], single.reset()[0]["ego"])


def test_a_wrong_list_of_faults_is_refused() -> None:
    engine = VectorLaneKeeping(1, {**SMALL, **PERFECT})
    with pytest.raises(ConfigError, match=r"options\.faults\.0\.kind must be one of .*did you mean 'spoofing'"):
        engine.reset(seed=1, options={"faults": [{"kind": "spoof"}]})
    with pytest.raises(InputError, match=r"options\.faults must be a list"):
        engine.reset(seed=1, options={"faults": {"kind": "spoofing"}})
    with pytest.raises(InputError, match=r"options\.faults must be left out where nothing navigates"):
        engine.reset(seed=1, options={"faults": [{"kind": "spoofing", "magnitude_m": 3.0}]})
    engine.reset(seed=1, options={"faults": []})
