"""The vector engine in several processes: the results of one process, and clear ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import pytest

from lanebound.envs import wrap_vec
from lanebound.envs.ids.streets import LaneKeeping
from lanebound.envs.vector.env import VectorDrivingEnv, engine_class
from lanebound.envs.vector.processes import EngineProcesses
from lanebound.integrity.core.errors import InputError

COUNT = 5
CONFIG: dict[str, Any] = {"sky": "open", "layouts": 1, "duration_s": 3.0, "faults": "stress"}
Pair = tuple[VectorDrivingEnv, VectorDrivingEnv]


def make(processes: int, **given: Any) -> VectorDrivingEnv:
    return engine_class(LaneKeeping)(COUNT, CONFIG, autoreset_mode="SameStep", processes=processes, **given)


@pytest.fixture(scope="module")
def pair() -> Iterator[Pair]:
    """The same environments in this process and in two."""
    with closing(make(1)) as one, closing(make(2)) as two:
        yield one, two


def equal(a: Any, b: Any) -> None:
    """Arrays, and dicts and tuples of them, have the same bits."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            equal(a[key], b[key])
    elif isinstance(a, tuple) or (isinstance(a, np.ndarray) and a.dtype == object):
        for x, y in zip(a, b, strict=True):
            equal(x, y)
    else:
        np.testing.assert_array_equal(a, b, strict=isinstance(a, np.ndarray))


def test_results_are_those_of_one_process(pair: Pair) -> None:
    one, two = pair
    equal(one.reset(seed=3), two.reset(seed=3))
    one.action_space.seed(4)
    ends = 0
    for _ in range(45):  # three episodes of each
        action = one.action_space.sample()
        ours, theirs = one.step(action), two.step(action)
        equal(ours, theirs)
        ends += int((ours[2] | ours[3]).sum())
    assert ends > 2 * COUNT
    mask = np.array([False, True, False, False, True])
    for options in ({"reset_mask": mask}, {"reset_mask": ~mask}):
        equal(one.reset(options=options), two.reset(options=options))
    equal(one.reset(seed=[7, None, 8, None, None]), two.reset(seed=[7, None, 8, None, None]))
    equal(one.step(action), two.step(action))


def test_refusals_come_from_the_process_and_the_next_call_works(pair: Pair) -> None:
    """The third environment is in the second process."""
    _, two = pair
    fault = {"kind": "gyro_bias", "start_s": 1.0, "vehicle": 3, "magnitude_degps": 1.0}
    with pytest.raises(InputError, match=r"options\.faults\.0\.vehicle must be below 1") as refused:
        two.reset(seed=3, options={"faults": [fault]})
    assert any("give_faults" in note for note in refused.value.__notes__)
    assert two.reset(seed=3)[1]["cost"].shape == (COUNT,)
    with pytest.raises(InputError, match=r"actions\[3\] must lie in"):
        two.step(np.where(np.arange(COUNT)[:, None] == 3, 99.0, np.zeros(two.action_space.shape)))


def test_an_interrupted_call_is_forgotten(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = pair
    one.reset(seed=5), two.reset(seed=5)
    receive, engine = EngineProcesses._receive, two.engine
    assert isinstance(engine, EngineProcesses)

    def interrupted(self: EngineProcesses, k: int) -> Any:
        raise KeyboardInterrupt

    action = np.zeros(one.action_space.shape)
    monkeypatch.setattr(EngineProcesses, "_receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        two.step(action)
    monkeypatch.setattr(EngineProcesses, "_receive", receive)
    equal(one.reset(seed=6), two.reset(seed=6))
    equal(one.step(action), two.step(action))


def test_the_death_of_a_process_is_told() -> None:
    with closing(make(2)) as envs:
        envs.reset(seed=1)
        engine = envs.engine
        assert isinstance(engine, EngineProcesses)
        killed = engine._workers[1].process
        os.kill(killed.pid or 0, signal.SIGKILL)
        killed.join()
        with pytest.raises(RuntimeError, match=r"environments 2 to 4 has ended \(exit code -9; .* make the env"):
            envs.step(np.zeros(envs.action_space.shape))
    assert not any(worker.process.is_alive() for worker in engine._workers)


def set_variable(name: str) -> None:
    os.environ[name] = "1"


def fail() -> None:
    raise InputError("no plug-in")


def test_initialize_runs_first_in_each_process() -> None:
    with pytest.raises(InputError, match="no plug-in"):
        make(2, initialize=fail)
    with closing(make(2, initialize=partial(set_variable, "LANEBOUND_TEST"))) as envs:
        assert envs.num_envs == COUNT
    assert "LANEBOUND_TEST" not in os.environ
    with pytest.raises(InputError, match="processes must be 1 here, got 2: the configuration cannot be given"):
        make(2, initialize=lambda: None)


def test_ids_of_highway_env_and_one_environment_each() -> None:
    config = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
    make_two = partial(wrap_vec, "u-turn-v0", 2, config, "SameStep")
    with closing(make_two()) as one, closing(make_two(processes=2)) as two:
        assert isinstance(one, VectorDrivingEnv)
        assert isinstance(two, VectorDrivingEnv)
        equal(one.reset(seed=1), two.reset(seed=1))
        for _ in range(4):
            equal(one.action_masks(), two.action_masks())
            equal(one.step(np.ones(2, dtype=np.int64)), two.step(np.ones(2, dtype=np.int64)))


@pytest.mark.parametrize("processes", [0, -1, COUNT + 1, 1.5, True, "2", None])
def test_numbers_of_processes_that_do_not_exist_are_refused(processes: Any) -> None:
    with pytest.raises(InputError, match=r"processes must be an int from 1 to num_envs = 5, got"):
        make(processes)


def daemonic(answers: Any) -> None:
    try:
        make(2)
    except InputError as error:
        answers.put(str(error))


def test_worker_processes_have_none_of_their_own() -> None:
    spawn = multiprocessing.get_context("spawn")
    answers = spawn.SimpleQueue()
    process = spawn.Process(target=daemonic, args=(answers,), daemon=True)
    process.start()
    assert answers.get() == "processes must be 1 in a worker process, which cannot have its own, got 2: give 1"
    process.join()
