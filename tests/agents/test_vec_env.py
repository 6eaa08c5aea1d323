"""The engine under Stable-Baselines3's contract for vector environments."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from lanebound.agents import vec_env
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs.episode_totals import EPISODE_KEY
from lanebound.envs.ids import META, Preset, register_id
from lanebound.envs.observation import entries
from lanebound.envs.registration import wrap
from lanebound.envs.wrappers import EpisodeStatistics
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.modes import Mode

CONFIG: dict[str, Any] = {
    "navigation": {"source": "perfect"},
    "perception": {"source": "truth"},
    "world": {"vehicles_count": 4},
    "duration_s": 2.0,
}


def test_it_does_what_a_dummy_of_single_environments_does() -> None:
    engine = EngineVecEnv("lanebound/Highway-v0", 3, CONFIG, keys=("cost", "crashed", "costs"))
    single = DummyVecEnv([lambda: gymnasium.make("lanebound/Highway-v0", config=CONFIG) for _ in range(3)])
    for env in (engine, single):
        env.seed(4)
    first, wanted = engine.reset(), single.reset()
    for group in wanted:
        np.testing.assert_allclose(first[group], wanted[group], atol=1e-6)
    rng, ends = np.random.default_rng(1), 0
    for _ in range(10):
        actions = rng.integers(5, size=3)
        seen, rewards, over, infos = engine.step(actions)
        seen_too, rewards_too, over_too, infos_too = single.step(actions)
        for group in seen_too:
            np.testing.assert_allclose(seen[group], seen_too[group], atol=1e-6)
        np.testing.assert_allclose(rewards, rewards_too, atol=1e-6)
        np.testing.assert_array_equal(over, over_too)
        for info, info_too in zip(infos, infos_too, strict=True):
            assert info["cost"] == pytest.approx(info_too["cost"], abs=1e-9)
            np.testing.assert_allclose(info["costs"], info_too["costs"], atol=1e-9)
            if "terminal_observation" in info_too:
                ends += 1
                assert info["TimeLimit.truncated"] == info_too["TimeLimit.truncated"]
                assert set(info) == set(info_too) | {"episode"}
                for group, last in info_too["terminal_observation"].items():
                    np.testing.assert_allclose(info["terminal_observation"][group], last, atol=1e-6)
            else:
                assert set(info) == {"cost", "crashed", "costs"}
    assert ends >= 3
    assert rewards.dtype == np.float32
    assert engine.get_attr("render_mode") == [None] * 3
    assert engine.get_attr("action_space", [0, 2]) == [engine.action_space] * 2
    with pytest.raises(InputError, match="np_random is not shared"):
        engine.get_attr("np_random")
    assert engine.env_is_wrapped(VecMonitor) == [False] * 3
    assert engine.env_is_wrapped(Monitor) == [True] * 3  # as far as its infos go
    for masks, env in zip(engine.env_method("action_masks"), single.envs, strict=True):
        np.testing.assert_array_equal(masks, env.unwrapped.action_masks())


def test_options_and_seeds_are_checked_and_options_hold_for_one_reset() -> None:
    engine = EngineVecEnv("lanebound/LaneKeeping-v0", 2, {"sky": "open", "cities": {"count": 1}})
    for options in ([{}], [{}] * 3):
        with pytest.raises(InputError, match=f"one for each of 2 environments, got {len(options)} of them"):
            engine.set_options(options)
    with pytest.raises(InputError, match="options"):
        engine.set_options({"fault": []})
    wrong: tuple[Any, ...] = (-1, [1, 2], True)
    for seed in wrong:
        with pytest.raises(InputError, match="seed must be a whole number"):
            engine.seed(seed)
    engine.set_options({"faults": [{"kind": "jamming", "magnitude_db": 20.0, "start_s": 1e6}]})
    with pytest.raises(InputError, match="start_s must be before the end"):
        engine.reset()
    engine.reset()


def test_one_layout_of_observations_serves_several_services() -> None:
    spaces = []
    for service in ("spp", "dgps"):
        config = {"sky": "open", "navigator": {"service": service}, "observation": {"services": ["dgps", "spp"]}}
        engine = EngineVecEnv("lanebound/LaneKeeping-v0", 2, config)
        single = DummyVecEnv([lambda c=config: gymnasium.make("lanebound/LaneKeeping-v0", config=c) for _ in range(2)])
        spaces += [engine.observation_space, single.observation_space]
        names = [e.name for e in entries(single.envs[0].unwrapped.config.observation) if e.group == "integrity"]
        places = [names.index("mode_spp"), names.index("mode_dgps")]
        assert places[0] + 1 == places[1]
        for env in (engine, single):
            env.seed(4)
            seen = env.reset()["integrity"][:, places]
            np.testing.assert_array_equal(seen, [[service == "spp", service == "dgps"]] * 2)
            env.close()
    assert all(space == spaces[0] for space in spaces)


def test_statistics_of_episodes_are_those_of_single_environments() -> None:
    config = {"sky": "urban", "duration_s": 2.0}

    def single() -> EpisodeStatistics:
        return EpisodeStatistics(gymnasium.make("lanebound/LaneKeeping-v0", config=config))

    engine = EngineVecEnv("lanebound/LaneKeeping-v0", 2, config, statistics=True)
    found: dict[Any, Any] = {}
    wanted: dict[Any, Any] = {}
    for env, told in ((engine, found), (DummyVecEnv([single] * 2), wanted)):
        env.seed(3)
        env.reset()
        for step in range(22):
            _, _, _, infos = env.step(np.full((2, 2), 0.01, dtype=np.float32))
            told |= {(step, row): info[EPISODE_KEY] for row, info in enumerate(infos) if EPISODE_KEY in info}
    first = {key: wanted[key] for key in list(wanted)[:2]}
    assert len(found) >= 4
    assert set(found) == set(wanted)
    for key, episode in first.items():
        told = found[key]
        assert told["mode_shares"] == episode["mode_shares"]
        plain = [name for name in episode if name != "mode_shares"]
        np.testing.assert_allclose([told[n] for n in plain], [episode[n] for n in plain], atol=1e-5, err_msg=str(plain))


def test_ppo_learns_on_it_and_logs_returns_without_a_wrapper(tmp_path: Path) -> None:
    config = {**CONFIG, "observation": {"form": "flat"}}
    env = EngineVecEnv("lanebound/Highway-v0", 4, config)
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=1, seed=1)
    model.set_logger(configure(str(tmp_path), ["json"]))
    model.learn(64)
    model.logger.close()
    assert model.num_timesteps == 64
    last = json.loads((tmp_path / "progress.json").read_text(encoding="utf-8").splitlines()[-1])
    assert model.ep_info_buffer
    assert last["rollout/ep_len_mean"] == np.mean([info["l"] for info in model.ep_info_buffer])
    assert last["rollout/ep_rew_mean"] == pytest.approx(np.mean([info["r"] for info in model.ep_info_buffer]))


def test_episodes_are_those_of_vec_monitor() -> None:
    config = {**CONFIG, "observation": {"form": "flat"}}
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        env = VecMonitor(EngineVecEnv("lanebound/Highway-v0", 3, config))
    own = EngineVecEnv("lanebound/Highway-v0", 3, config)
    rng, ends = np.random.default_rng(2), 0
    for one in (env, own):
        one.seed(4)
        one.reset()
    for _ in range(12):
        actions = rng.integers(5, size=3)
        infos, ours = env.step(actions)[3], own.step(actions)[3]
        for info, mine in zip(infos, ours, strict=True):
            assert ("episode" in info) == ("episode" in mine)
            if "episode" in mine:
                ends += 1
                assert mine["episode"]["r"] == pytest.approx(float(info["episode"]["r"]), abs=1e-4)
                assert mine["episode"]["l"] == info["episode"]["l"]
                assert mine["episode"]["t"] >= 0.0
    assert ends >= 3


def test_each_environment_takes_faults_of_its_own() -> None:
    """As a dummy of single environments does; they count for one episode."""
    config = {"sky": "open", "cities": {"count": 1}, "duration_s": 1.0}
    engine = EngineVecEnv("lanebound/LaneKeeping-v0", 2, config, keys=("mode", "pl_ct_m"))
    single = DummyVecEnv([lambda: gymnasium.make("lanebound/LaneKeeping-v0", config=config) for _ in range(2)])
    for env in (engine, single):
        env.seed(4)
        env.set_options([{}, {"faults": [{"kind": "jamming", "magnitude_db": 60.0}]}])
        env.reset()
    modes = []
    for _ in range(8):
        infos = engine.step(np.zeros((2, 2), dtype=np.float32))[3]
        infos_too = single.step(np.zeros((2, 2), dtype=np.float32))[3]
        for info, info_too in zip(infos, infos_too, strict=True):
            assert info["mode"] == info_too["mode"]
            assert info["pl_ct_m"] == pytest.approx(info_too["pl_ct_m"], abs=1e-9)
        modes.append([info["mode"] for info in infos])
    assert modes[0] == [Mode.RTK, Mode.IMU_ODOMETER]
    assert modes[-1] == [Mode.RTK, Mode.RTK]


def test_an_id_of_highway_env_is_wrapped() -> None:
    engine = EngineVecEnv("u-turn-v0", 2, CONFIG | {"world": {}})
    single = DummyVecEnv([lambda: wrap("u-turn-v0", CONFIG | {"world": {}})] * 2)
    for env in (engine, single):
        env.seed(4)
    first, wanted = engine.reset(), single.reset()
    for group in wanted:
        np.testing.assert_allclose(first[group], wanted[group], atol=1e-6)


def test_what_it_cannot_do_is_refused() -> None:
    class LongMerge(Preset):
        PRESET: ClassVar[Mapping[str, Any]] = {"base": "merge-generic-v0", **META}

    register_id(LongMerge)
    with pytest.raises(InputError, match="SubprocVecEnv"):
        EngineVecEnv("lanebound/LongMerge-v0", 2)
    with pytest.raises(InputError, match="env_id 'LaneKeping' is unknown: did you mean 'lanebound/LaneKeeping-v0'"):
        EngineVecEnv("LaneKeping", 2)
    with pytest.raises(InputError, match="'cst': did you mean 'cost'"):
        EngineVecEnv("lanebound/Highway-v0", 2, CONFIG, keys=("cst",))
    with pytest.raises(InputError, match=r"pass \['cost'\]"):
        EngineVecEnv("lanebound/Highway-v0", 2, CONFIG, keys="cost")
    env = EngineVecEnv("lanebound/Highway-v0", 2, CONFIG)
    with pytest.raises(InputError, match="configuration"):
        env.set_attr("config", None)
    with pytest.raises(InputError, match="action_masks"):
        env.env_method("render")
    with pytest.raises(InputError, match=r"options must be among faults, got 'fault': correct the name"):
        env.set_options({"fault": []})


def test_more_threads_of_torch_than_one_are_advised_against_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    vec_env._advise_one_thread.cache_clear()
    for threads in (1, 3, 3):
        monkeypatch.setattr("torch.get_num_threads", lambda threads=threads: threads)
        EngineVecEnv("lanebound/Highway-v0", 1, CONFIG).close()
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == ["lanebound"]
    assert "torch computes on 3 threads. Call torch.set_num_threads(1)" in caplog.text
