"""Suites: what they drive and in which order, what they refuse, and that the packaged ones are sound."""

from __future__ import annotations

from typing import Any

import pytest

from lanebound.agents.benchmark.suite import TEST, TRAIN, SeedsConfig, SuiteConfig, load_suite, parse_agents
from lanebound.agents.benchmark.work import unfit
from lanebound.agents.drivers import AGENTS
from lanebound.envs import IDS
from lanebound.integrity.core.errors import ConfigError, InputError

SMALL = {"envs": ["lanekeeping", "Merge-v0"], "skies": ["urban", "open"], "agents": ["cruise", "oracle"]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"overrides": {"duraton_s": 5}},
            r"^overrides\.duraton_s is not a known key: did you mean 'overrides\.duration_s'",
        ),
        ({"overrides": {"observation": {"histry": 2}}}, r"^overrides\.observation\.histry is not a known key"),
        ({"overrides": {"navigator": {"rate_hz": 2}}}, r"^overrides\.navigator\.rate_hz is not a known key"),
        (
            {"agents": {"mine": {"agent": "cruise", "config": {"observation": {"histry": 2}}}}, "reference": "mine"},
            r"^agents\.mine\.config\.observation\.histry is not a known key",
        ),
        ({"skies": ["urbane"]}, "^sky must be"),
    ],
)
def test_what_an_environment_refuses_is_named_as_it_was_written(changes: dict[str, Any], message: str):
    with pytest.raises(ConfigError, match=message):
        unfit(SuiteConfig.load({**SMALL, "reference": "cruise", **changes}))


def test_seeds_of_training_and_test_share_none():
    assert set(TRAIN).isdisjoint(TEST)
    assert (TRAIN[0], TRAIN[-1], TEST[0], TEST[-1]) == (1000, 1999, 10_000, 19_999)


def test_tasks_go_env_by_env_and_seed_by_seed():
    suite = SuiteConfig.load({**SMALL, "seeds": {"split": "train", "count": 2}})
    tasks = list(suite.tasks())
    assert [task.id for task in tasks[:5]] == [
        "LaneKeeping-v0/urban-none/cruise/1000",
        "LaneKeeping-v0/urban-none/oracle/1000",
        "LaneKeeping-v0/open-none/cruise/1000",
        "LaneKeeping-v0/open-none/oracle/1000",
        "LaneKeeping-v0/urban-none/cruise/1001",
    ]
    assert len(set(tasks)) == len(tasks) == 2 * 2 * 2 * 2
    assert [task.place.env for task in tasks] == ["LaneKeeping-v0"] * 8 + ["Merge-v0"] * 8


def test_agents_may_be_written_in_three_ways():
    flat = {"agent": "m.zip", "config": {"observation": {"form": "flat"}}}
    listed = SuiteConfig.load({**SMALL, "agents": ["cruise", {"mine": "m.zip"}, {"other": flat}]})
    mapped = SuiteConfig.load({**SMALL, "agents": {"cruise": "cruise", "mine": {"agent": "m.zip"}, "other": flat}})
    assert listed == mapped
    assert SuiteConfig.from_json(listed.to_json()) == listed
    assert parse_agents("cruise, mine=a/b.zip,") == {"cruise": "cruise", "mine": "a/b.zip"}
    with pytest.raises(InputError, match="got cruise twice: call one NAME=cruise"):
        parse_agents("cruise,cruise")


def test_an_environment_is_changed_by_suite_place_and_agent():
    suite = SuiteConfig.load({**SMALL, "overrides": {"duration_s": 5.0, "observation": {"history": 2}}})
    place = suite.places[1]
    assert suite.env_overrides(place, "cruise") == {
        "duration_s": 5.0, "observation": {"history": 2}, "sky": "open", "faults": "none",
    }  # fmt: skip
    assert suite.env_overrides(place, "oracle")["observation"] == {"history": 2, "integrity": "oracle"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"envs": ["LaneKepeing"]}, "environment 'LaneKepeing' is unknown: did you mean"),
        ({"envs": []}, "envs must"),
        ({"seeds": {"split": "train", "count": 1001}}, "count must be <= 1000 in the split train, got 1001"),
        ({"faults": ["stres"]}, "faults.0 must be one of"),
        ({"agents": ["runs/model.zip"]}, "a name of an agent must be letters"),
        ({"agents": {"a": {"agnet": "cruise"}}}, "agents.a.agent is required"),
        ({"episode_timeout_s": 0}, "episode_timeout_s must be > 0"),
        ({"reference": ["cruise", "cruise"]}, "reference must name an agent, or several once each"),
        (
            {"envs": ["LaneKeeping", "Merge", "lanekeeping-v0"]},
            "^envs must differ .*, got LaneKeeping-v0 2 times: name",
        ),
        (
            {"skies": ["dense", "dense", "dense"]},
            "^skies must differ from each other, got dense 3 times: name each once",
        ),
        ({"skies": ["plaza", "skies/plaza"]}, "^skies must differ from each other, got plaza 2 times"),
        ({"skies": ["./a.csv", "a.csv"]}, "^skies must differ from each other, got a.csv 2 times"),
        ({"faults": ["none", "none"]}, "^faults must differ from each other, got none 2 times"),
        ({"agents": ["cruise", {"cruise": "idm"}]}, "^agents must differ from each other, got cruise 2 times: give"),
        ({"reference": []}, "reference must name an agent, or several once each"),
    ],
)
def test_refusals(change, message):
    with pytest.raises(InputError, match=message):
        SuiteConfig.load({**SMALL, **change})


def test_suites_come_from_names_and_files(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("envs: [Merge]\nagents: [cruise]\n", encoding="utf-8")
    assert load_suite(str(path), {"seeds": {"count": 3}}).seeds.count == 3
    (tmp_path / "other.yaml").write_text("extends: experiments/lane_keeping_ppo\n")
    with pytest.raises(ConfigError, match=r"suite must be a file of kind suite, got .*other\.yaml of kind experiment"):
        load_suite(str(tmp_path / "other.yaml"))
    with pytest.raises(ConfigError, match="suite 'quik' is unknown: did you mean"):
        load_suite("quik")
    with pytest.raises(ConfigError, match="suite must be a file that can be read"):
        load_suite("nowhere.yaml")


@pytest.mark.parametrize("name", ["quick", "standard", "claim", "faults", "look_ahead", "learnt"])
def test_packaged_suites_hold_the_reference_and_agents_that_exist(name):
    suite = load_suite(name)
    assert set(suite.references) <= set(suite.agents)
    assert {chosen.agent for chosen in suite.agents.values()} <= set(AGENTS)
    assert suite.seeds.split == ("train" if name == "look_ahead" else "test")
    assert suite.title


def test_a_suite_has_one_reference_or_several():
    one = SuiteConfig.load({**SMALL, "reference": "cruise"})
    both = SuiteConfig.load({**SMALL, "reference": ["cruise", "oracle"]})
    assert (one.references, both.references) == (("cruise",), ("cruise", "oracle"))
    assert SuiteConfig.load(SMALL).references == ("nominal",)
    assert SuiteConfig.from_json(both.to_json()) == both
    assert load_suite("claim").references == ("nominal", "cautious")


def test_who_sees_the_truth_is_known_by_name_and_by_what_it_needs():
    seeing = {"agent": "cruise", "config": {"observation": {"integrity": "oracle"}}}
    agents = SuiteConfig.load({**SMALL, "agents": {"cruise": "cruise", "oracle": "oracle", "mine": seeing}}).agents
    assert {name: chosen.sees_truth for name, chosen in agents.items()} == {
        "cruise": False, "oracle": True, "mine": True,
    }  # fmt: skip


def test_the_standard_suite_is_of_all_environments_and_skies():
    suite = load_suite("standard")
    assert {f"lanebound/{env}" for env in suite.envs} == set(IDS)
    assert suite.skies == ("open", "suburban", "urban", "dense")
    assert suite.seeds.count == 50


def test_seeds_that_were_looked_at_may_be_left_out() -> None:
    assert SeedsConfig(count=3, skip=2000).seeds == range(12_000, 12_003)
    assert SeedsConfig(split="train", count=1, skip=999).seeds == range(1999, 2000)
    with pytest.raises(ConfigError, match="count must be <= 999 in the split train after the first 1, got 1000: take"):
        SeedsConfig(split="train", count=1000, skip=1)
    with pytest.raises(
        ConfigError, match="count must be <= 0 in the split train after the first 5000, got 1: take fewer"
    ):
        SeedsConfig(split="train", count=1, skip=5000)
