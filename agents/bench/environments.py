"""Speed of environments and of learning in them: of one, of the vector engine, of PPO; and how long starts take."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from importlib import import_module
from typing import Any

import gymnasium
import numpy as np
import torch
from highway_env.envs.common.abstract import AbstractEnv
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from lanebound.agents.bench.runner import Row, alternate, median_ratio
from lanebound.agents.learning.training import one_thread
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.navigation import NavigationBatch
from lanebound.envs.ids import Highway, Preset, has_engine, presets
from lanebound.envs.vector import VectorDrivingEnv, engine_class
from lanebound.envs.vector.engine import Engine
from lanebound.envs.world import guard

GATES = {"Highway": (1.0, 1.0, 0.1), "Merge": (1.0, 5.0, 1.5)}
IDS = ("Highway", "Merge", "Roundabout", "Intersection", "Racetrack")
STEPS, SEED = 4, 1


def _wrapped(name: str, source: str) -> DrivingEnv:
    return DrivingEnv(make_config(f"lanebound/{name}-v0", {"perception": {"source": source}}))


def bare_of(env: DrivingEnv) -> AbstractEnv:
    """highway-env's own environment of the same configuration, with a Kinematics observation."""
    kind = type(env.world)
    return guard(kind, {**env.world.config, "observation": {"type": "Kinematics"}})


def _run(env: gymnasium.Env[Any, Any], command: Any) -> tuple[float, int]:
    """Seconds and policy steps of the first steps of an episode; the reset is not counted."""
    env.reset(seed=SEED)
    begun, count, over = time.perf_counter(), 0, False
    while count < STEPS and not over:
        _, _, terminated, truncated, _ = env.step(command)
        count, over = count + 1, terminated or truncated
    return time.perf_counter() - begun, count


@contextmanager
def _navigation_clock() -> Iterator[dict[str, float]]:
    """In this context, the time that navigation takes in single environments: skies, measurements and solutions."""
    spent, kept = {"all": 0.0}, {name: getattr(NavigationBatch, name) for name in ("sense", "locate")}
    for name, function in kept.items():
        setattr(NavigationBatch, name, _timed(function, spent, "all", time.perf_counter))
    try:
        yield spent
    finally:
        for name, function in kept.items():
            setattr(NavigationBatch, name, function)


def _layer_shares(name: str, source: str, rounds: int) -> tuple[float, float]:
    """Layer time over the bare step's time [%], and bare over wrapped time, medians over the rounds."""
    env = _wrapped(name, source)
    bare = bare_of(env)
    command = 1 if hasattr(env.action_space, "n") else env.action_space.sample() * 0.0
    _run(env, command), _run(bare, command)
    shares, ratios = [], []
    for _ in range(rounds):
        seconds, count = _run(bare, command)
        with _navigation_clock() as spent:
            env.reset(seed=SEED)
            spent["all"] = 0.0
            begun = time.perf_counter()
            for _ in range(count):
                env.step(command)
            whole = time.perf_counter() - begun
        shares.append(100.0 * spent["all"] / seconds)
        ratios.append(seconds / whole)
    return statistics.median(shares), statistics.median(ratios)


def measure_environments(rounds: int = 5) -> list[Row]:
    """Shares of the layer for the ego alone and with every neighbour's navigator, and the ratio of whole steps.

    Both sides drive the same id with the same rates, traffic and seeds; the bare side observes highway-env's
    Kinematics.
    """
    rows = []
    for name in IDS:
        ratio_gate, share_gate, share_stretch = GATES.get(name, (1.0, None, None))
        share, _ = _layer_shares(name, "sensor", rounds)
        rows.append(Row(f"layer_share_{name}", share, "%", share_gate, share_stretch, higher_is_better=False))
        share, ratio = _layer_shares(name, "v2v", rounds)
        gate, stretch = (10.0, 2.0) if name == "Highway" else (None, None)
        rows.append(Row(f"layer_share_v2v_{name}", share, "%", gate, stretch, higher_is_better=False))
        rows.append(Row(f"wrapped_vs_bare_{name}", ratio, "x", ratio_gate, 1.3 if name == "Merge" else None))
    return rows


PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
FULL: dict[str, Any] = {"perception": {"source": "truth"}}
AS_PRESET: dict[str, Any] = {}  # as the id presets it
MANY, HEARING, TURNS = 512, 8, 64


def _single_side(env: gymnasium.Env[Any, Any], act: Callable[[], Any]) -> Callable[[], int]:
    """A policy step of a single environment, which is reset where its episode ends."""
    env.reset(seed=SEED)
    env.action_space.seed(SEED)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(act())
        if terminated or truncated:
            env.reset()
        return 1

    return step


def engine_side(
    kind: type[Preset], count: int, config: dict[str, Any]
) -> tuple[Callable[[], int], VectorDrivingEnv]:  # fmt: skip
    """A policy step of so many environments of an id under random actions, and these environments."""
    env = engine_class(kind)(count, config, autoreset_mode="SameStep")
    env.reset(seed=SEED)
    env.action_space.seed(SEED)
    actions, turn = [env.action_space.sample() for _ in range(TURNS)], iter(range(10**9))

    def step() -> int:
        env.step(actions[next(turn) % TURNS])
        return count

    return step, env


def measure_engine(rounds: int = 5) -> list[Row]:
    """Ratios of policy steps of Highway a second, resets included; rates of ours; the memory of an environment.

    Both sides have the same roads, vehicles, rates and kind of actions; highway-env observes its Kinematics, the engine
    all of an observation of ours.
    """
    bare, rng = bare_of(DrivingEnv(make_config("lanebound/Highway-v0", PERFECT))), np.random.default_rng(SEED)
    cases = {"many": (MANY, PERFECT), "one": (1, PERFECT), "full": (MANY, FULL), "v2v": (HEARING, AS_PRESET)}
    engines = {name: engine_side(Highway, count, config) for name, (count, config) in cases.items()}
    sides = {"bare": _single_side(bare, lambda: int(rng.integers(5)))}
    rates = alternate({**sides, **{name: step for name, (step, _) in engines.items()}}, rounds, 1.0)
    ratio = {name: median_ratio(rates, name, "bare") for name in cases}
    size = {name: env.engine.bytes_per_environment / 1024.0 for name, (_, env) in engines.items()}
    return [
        Row("engine_dynamics_vs_highway_2core", ratio["many"], "x", 5000.0, 12000.0),
        Row("engine_dynamics_vs_highway_1env", ratio["one"], "x", 2500.0, 5000.0),
        Row("engine_full_vs_highway_2core", ratio["full"], "x", 1000.0, 3000.0),
        Row("engine_v2v_vs_highway_2core", ratio["v2v"], "x", 200.0, 600.0),
        Row("engine_dynamics_per_s", statistics.median(rates["many"]), "1/s"),
        Row("engine_full_per_s", statistics.median(rates["full"]), "1/s"),
        Row("engine_memory_per_environment", size["many"], "KiB", higher_is_better=False),
        Row("engine_full_memory_per_environment", size["full"], "KiB", higher_is_better=False),
        Row("engine_v2v_memory_per_environment", size["v2v"], "KiB", higher_is_better=False),
    ]


SHIPPED = 64
SURROGATE: dict[str, Any] = {"perception": {"others": "surrogate"}}


def _subproc_side(kind: type[Preset], envs: SubprocVecEnv) -> Callable[[], int]:
    """A policy step of environments of SB3, which resets them."""
    envs.seed(SEED)
    envs.reset()
    envs.action_space.seed(SEED)

    def step() -> int:
        envs.step(np.array([envs.action_space.sample() for _ in range(envs.num_envs)]))
        return envs.num_envs

    return step


def measure_presets(rounds: int = 5) -> list[Row]:
    """Of each id with an engine: steps a second of the engine, ratios to one single environment and to two of SB3.

    Where others have radio, steps a second with surrogates as well. Resets count on both sides; actions are random.
    """
    return [row for kind in filter(has_engine, presets()) for row in _of_id(kind, rounds)]


def _of_id(kind: type[Preset], rounds: int) -> list[Row]:
    step, ours = engine_side(kind, SHIPPED, {})
    single, name = kind(), kind.__name__
    sides = {"engine": step, "single": _single_side(single, single.action_space.sample)}
    assert isinstance(ours.engine, Engine)
    if ours.engine.episodes.perception.has_radio:
        sides["surrogate"] = engine_side(kind, SHIPPED, SURROGATE)[0]
    with closing(SubprocVecEnv([kind] * 2, start_method="spawn")) as envs:
        rates = alternate({**sides, "subproc": _subproc_side(kind, envs)}, rounds, 1.0)
    rows = [
        Row(f"preset_{name}_steps_per_s", statistics.median(rates["engine"]), "1/s", 10_000.0, 20_000.0),
        Row(f"preset_{name}_vs_subproc", median_ratio(rates, "engine", "subproc"), "x", 200.0),
        Row(f"preset_{name}_vs_single", median_ratio(rates, "engine", "single"), "x"),
    ]
    if "surrogate" in rates:
        rows.append(Row(f"preset_{name}_surrogate_per_s", statistics.median(rates["surrogate"]), "1/s"))
    return rows


LEARNT = "lanebound/Highway-v0"
PPO_SETTINGS: dict[str, Any] = {"n_epochs": 4, "batch_size": 2048, "gamma": 0.9, "device": "cpu", "seed": 1}
FLAT: dict[str, Any] = {"observation": {"form": "flat"}}


def measure_learning(rounds: int = 5) -> list[Row]:
    """Decisions of Highway a second under PPO, end to end, with and without what is sensed.

    Both sides learn by the same network with the same settings, but for rollouts, and batches no larger than these:
    ours of 512 environments with perfect navigation, or of 128 with the whole layer; theirs, of highway-env, of the two
    of ``SubprocVecEnv``.
    """
    theirs = SubprocVecEnv([_bare_highway] * 2, start_method="spawn")
    try:
        rates = alternate(
            {
                "subproc": _side(theirs, 2),
                "dynamics": _side(EngineVecEnv(LEARNT, 512, PERFECT | FLAT), 16),
                "full": _side(EngineVecEnv(LEARNT, 128, FULL | FLAT), 16),
            },
            rounds,
            1.0,
        )
    finally:
        theirs.close()
    return [
        Row("ppo_end_to_end_vs_subproc2", median_ratio(rates, "dynamics", "subproc"), "x", 1000.0, 3000.0),
        Row("ppo_end_to_end_full_vs_subproc2", median_ratio(rates, "full", "subproc"), "x"),
        Row("ppo_end_to_end_per_s", statistics.median(rates["dynamics"]), "1/s"),
    ]


def _bare_highway() -> Any:
    return Monitor(bare_of(DrivingEnv(make_config(LEARNT, PERFECT))))


def _side(env: VecEnv, steps: int) -> Callable[[], int]:
    """A rollout of so many steps of each environment, and the updates after it."""
    size = steps * env.num_envs
    model = PPO(
        "MlpPolicy", env, n_steps=steps, **{**PPO_SETTINGS, "batch_size": min(PPO_SETTINGS["batch_size"], size)}
    )

    def learn() -> int:
        model.learn(size, reset_num_timesteps=model.num_timesteps == 0)
        return size

    return learn


ID, COUNT, ROLLOUT = "lanebound/LaneKeeping-v0", 64, 64
FORMS = {"flat": "MlpPolicy", "dict": "MultiInputPolicy"}
SETTINGS: dict[str, Any] = {"batch_size": 512, "n_epochs": 10, "device": "cpu", "seed": 1}


def measure_shares(rounds: int = 5) -> list[Row]:
    """Shares of a rollout of LaneKeeping and its update, for either form of observations, by processor time of a core.

    And what threads of torch do to the update: its time on two threads over that on one, by the clock.
    """
    rows = []
    for form, policy in FORMS.items():
        with one_thread(), closing(EngineVecEnv(ID, COUNT, {"observation": {"form": form}})) as env:
            model = PPO(policy, env, n_steps=ROLLOUT, **SETTINGS)
            model.learn(COUNT * ROLLOUT)
            shares = _shares(model, env, rounds)
            ratio = statistics.median(_update_s(model, 2) / _update_s(model, 1) for _ in range(rounds))
        rows += [Row(f"ppo_{form}_{name}_share", 100.0 * share, "%") for name, share in shares.items()]
        rows.append(Row(f"ppo_{form}_update_2_threads", ratio, "x", higher_is_better=False))
    return rows


def _shares(model: PPO, env: EngineVecEnv, rounds: int) -> dict[str, float]:
    """Shares of the processor time of so many rollouts and updates."""
    spent: dict[str, float] = {}
    vector = env.envs
    for owner, method, name in (
        (vector.engine, "step", "step"),
        (vector, "_restart", "reset"),
        (env, "step_wait", "environment"),
        (model.policy, "forward", "policy"),
        (model, "train", "update"),
        (model.rollout_buffer, "add", "copy"),
    ):
        setattr(owner, method, _timed(getattr(owner, method), spent, name))
    rollouts: Any = import_module("stable_baselines3.common.on_policy_algorithm")  # imports the function of the copy
    to_torch = rollouts.obs_as_tensor
    rollouts.obs_as_tensor = _timed(to_torch, spent, "copy")
    try:
        begun = time.process_time()
        model.learn(rounds * COUNT * ROLLOUT, reset_num_timesteps=False)
        total = time.process_time() - begun
    finally:
        rollouts.obs_as_tensor = to_torch
    spent["environment"] -= spent["step"] + spent["reset"]
    spent["rest"] = total - sum(spent.values())
    return {name: seconds / total for name, seconds in sorted(spent.items(), key=lambda item: -item[1])}


def _timed(
    function: Callable[..., Any], spent: dict[str, float], name: str, clock: Callable[[], float] = time.process_time
) -> Callable[..., Any]:
    """The function, whose time by a clock is added to that of its name."""

    def timed(*arguments: Any, **settings: Any) -> Any:
        begun = clock()
        found = function(*arguments, **settings)
        spent[name] = spent.get(name, 0.0) + clock() - begun
        return found

    return timed


def _update_s(model: PPO, threads: int) -> float:
    """Clock time of an update on so many threads of torch."""
    torch.set_num_threads(threads)
    begun = time.perf_counter()
    model.train()
    return time.perf_counter() - begun


ACTIONS = 8
TURN_S = 2.0
BUSY = "print(flush=True)\nwhile True: pass"


@contextmanager
def beside_busy_process() -> Iterator[subprocess.Popen[bytes]]:
    """Inside this context one process computes without end."""
    with subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()  # it has started
            yield process
        finally:
            process.kill()


def measure_busy(rounds: int = 5) -> list[Row]:
    """Median over rounds of steps a second next to a busy process, over those alone just before."""
    env = EngineVecEnv(ID, COUNT, {"observation": {"form": "flat"}})
    try:
        env.seed(SEED)
        env.reset()
        actions = np.random.default_rng(SEED).normal(0.0, 0.1, (ACTIONS, COUNT, 2)).clip(-1.0, 1.0).astype(np.float32)
        turn = iter(range(10**9))

        def step() -> None:
            env.step(actions[next(turn) % ACTIONS])

        step()
        ratios = []
        for _ in range(rounds):
            alone = _rate(step)
            with beside_busy_process():
                ratios.append(_rate(step) / alone)
    finally:
        env.close()
    return [Row("engine_beside_busy_process", statistics.median(ratios), "-", 0.4, 0.6)]


def _rate(step: Callable[[], None]) -> float:
    """Calls a second over one turn."""
    begun, calls = time.perf_counter(), 0
    while (elapsed := time.perf_counter() - begun) < TURN_S:
        step()
        calls += 1
    return calls / elapsed


PROGRAM = """
import gymnasium, lanebound.envs
env = gymnasium.make_vec("lanebound/LaneKeeping-v0", 64)
env.reset(seed=1)
env.step(env.action_space.sample())
"""


def measure_cold(rounds: int = 1) -> list[Row]:
    """From the start of Python to the first step of the vector engine, with an empty cache of kernels.

    One start in a process of its own; it takes minutes, so that ``rounds`` does not repeat it.

    Raises
    ------
    subprocess.CalledProcessError
        The process failed; its message is on standard error.
    """
    with tempfile.TemporaryDirectory() as cache:
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", PROGRAM], check=True, env={**os.environ, "NUMBA_CACHE_DIR": cache})
        seconds = time.perf_counter() - begun
    return [Row("engine_cold_start_s", seconds, "s", 90.0, 45.0, higher_is_better=False)]


COMMAND = [sys.executable, "-c", "from lanebound.agents.cli import main; main()", "--version"]


def _seconds() -> float:
    start = time.perf_counter()
    subprocess.run(COMMAND, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def measure_startup(rounds: int = 5) -> list[Row]:
    """Median time of ``lanebound --version`` in a process of its own, after one run that fills the caches."""
    _seconds()
    median = statistics.median(_seconds() for _ in range(rounds))
    return [Row("cli_start_cached_s", median, "s", gate=1.0, stretch=0.4, higher_is_better=False)]
