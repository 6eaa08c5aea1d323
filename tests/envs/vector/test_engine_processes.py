"""The vector engine in several processes: the results of one process, and clear ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import initializers
import numpy as np
import pytest

from lanebound.envs import wrap_vec
from lanebound.envs.ids import presets
from lanebound.envs.ids.streets import LaneKeeping
from lanebound.envs.vector.env import VectorDrivingEnv, engine_class
from lanebound.envs.vector.processes import EngineProcesses
from lanebound.integrity.core.errors import InputError

COUNT = 5
CONFIG: dict[str, Any] = {"sky": "open", "cities": {"count": 1}, "duration_s": 3.0, "faults": "stress"}
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


IDS = sorted(kind.__name__ for kind in presets())
SOON = "Highway", "Intersection", "UrbanCanyon"  # traffic, vehicles that come and go, a street


@pytest.mark.parametrize("name", [pytest.param(id_, marks=() if id_ in SOON else pytest.mark.slow) for id_ in IDS])
def test_every_id_drives_in_several_processes_as_in_one(name: str) -> None:
    """Intersection is one whose drivers highway-env changes when it makes a world."""
    kind = next(kind for kind in presets() if kind.__name__ == name)
    config = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "observation": {"history": 2}}
    make_three = partial(engine_class(kind), 3, config)
    with closing(make_three()) as one, closing(make_three(processes=2)) as three:
        equal(one.reset(seed=5), three.reset(seed=5))
        one.action_space.seed(6)
        for _ in range(25):
            action = one.action_space.sample()
            equal(one.step(action), three.step(action))


def test_episodes_prepared_while_nothing_is_asked_are_the_same() -> None:
    options = {"faults": [{"kind": "gyro_bias", "start_s": 1.0, "magnitude_degps": 1.0}]}
    make_disabled = partial(engine_class(LaneKeeping), COUNT, CONFIG, autoreset_mode="Disabled")
    with closing(make_disabled()) as one, closing(make_disabled(processes=2)) as two:
        engine = two.engine
        assert isinstance(engine, EngineProcesses)
        equal(one.reset(seed=3), two.reset(seed=3))
        _await(lambda: bool(engine._ready.all()))
        mask = np.array([True, False, True, True, False])
        equal(one.reset(options=options | {"reset_mask": mask}), two.reset(options=options | {"reset_mask": mask}))
        equal(one.reset(options={"reset_mask": mask}), two.reset(options={"reset_mask": mask}))
        equal(one.step(np.zeros(one.action_space.shape)), two.step(np.zeros(one.action_space.shape)))


def _await(condition: Callable[[], bool]) -> None:
    ends = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.01)


def test_an_interrupted_step_demands_a_reset_and_its_answer_is_left_aside(pair: Pair) -> None:
    """SIGINT comes while the processes work, as Ctrl-C does."""
    one, two = pair
    equal(one.reset(seed=5), two.reset(seed=5))
    action = np.zeros(one.action_space.shape)
    engine = two.engine
    assert isinstance(engine, EngineProcesses)
    for worker in engine._workers:
        os.kill(worker.process.pid or 0, signal.SIGSTOP)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        two.step(action)
    for worker in engine._workers:
        os.kill(worker.process.pid or 0, signal.SIGCONT)
    with pytest.raises(
        InputError, match="reset must come first, got step\\(\\) after one that was interrupted or failed"
    ):
        two.step(action)
    equal(one.reset(seed=6), two.reset(seed=6))
    equal(one.step(action), two.step(action))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system has no /proc")
def test_processes_are_never_interrupted_themselves(pair: Pair) -> None:
    """Ctrl-C reaches all processes of a terminal; the parent closes the pipes."""
    engine = pair[1].engine
    assert isinstance(engine, EngineProcesses)
    for worker in engine._workers:
        status = Path(f"/proc/{worker.process.pid}/status").read_text(encoding="utf-8")
        blocked = int(status.partition("SigBlk:")[2].split()[0], 16)
        assert blocked >> (signal.SIGINT - 1) & 1


def test_the_death_of_a_process_is_told() -> None:
    with closing(make(2)) as envs:
        envs.reset(seed=1)
        engine = envs.engine
        assert isinstance(engine, EngineProcesses)
        killed = engine._workers[1].process
        os.kill(killed.pid or 0, signal.SIGKILL)
        killed.join()
        with pytest.raises(RuntimeError, match=r"environments 2 to 4 has ended, exit code -9: make the env.*memory"):
            envs.step(np.zeros(envs.action_space.shape))
    assert not any(worker.process.is_alive() for worker in engine._workers)


def test_initialize_runs_first_in_each_process() -> None:
    with pytest.raises(InputError, match="no plug-in"):
        make(2, initialize=initializers.fail)
    with closing(make(2, initialize=partial(initializers.set_variable, "LANEBOUND_TEST"))) as envs:
        assert envs.num_envs == COUNT
    assert "LANEBOUND_TEST" not in os.environ
    with pytest.raises(InputError, match="processes must be 1 here, got 2: the configuration cannot be given"):
        make(2, initialize=lambda: None)


def test_what_a_process_raises_or_has_registered_otherwise_is_told() -> None:
    with pytest.raises(RuntimeError, match="TwoArgumentsError: odd"):
        make(2, initialize=initializers.fail_oddly)
    with pytest.raises(InputError, match=r"other entries of info than this process, got 'late_m'"):
        make(2, initialize=initializers.register_late)


def test_gymnasium_and_the_command_line_divide_environments_too() -> None:
    with closing(gymnasium.make_vec("lanebound/LaneKeeping-v0", 2, config=CONFIG, processes=2)) as envs:
        assert isinstance(envs.unwrapped.engine, EngineProcesses)
    script = "import gymnasium, lanebound.envs\ngymnasium.make_vec('lanebound/LaneKeeping-v0', 2, processes=2).reset()"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "unguarded.py"
        path.write_text(script, encoding="utf-8")
        told = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=300)
    assert told.returncode == 1
    assert told.stderr.rstrip().splitlines()[-1].startswith("RuntimeError: the process of environments 0 to 0")
    assert "__main__" in told.stderr.rstrip().splitlines()[-1]


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


def test_worker_processes_have_none_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    with pytest.raises(InputError) as refused:
        make(2)
    assert str(refused.value) == ("processes must be 1 in a worker process, which cannot have its own, got 2: give 1")
