"""``lanebound agents``: every agent is described, and cannot be taken where its actions do not fit."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from typing import Any

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.drivers import ABOUT, AGENTS, _config_class, make_agent
from lanebound.agents.episodes import open_env
from lanebound.integrity.core.errors import InputError

QUICK = """
import sys
from lanebound.agents.cli import app
app(["agents"], standalone_mode=False)
heavy = {"gymnasium", "highway_env", "numba", "numpy", "torch"} & set(sys.modules)
assert not heavy, heavy
"""


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["agents", *arguments])


def test_every_agent_is_described():
    assert list(ABOUT) == list(AGENTS)


def test_as_table_and_as_json(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("lanebound.agents.benchmark.untuned.tuned_places", lambda: (("CarFollowingWorld", "dense"),))
    table = run().stdout
    assert all(name in table for name in AGENTS)
    assert "{agent: cbf, figures: {over: integrity_aware}}" in table
    assert max(map(len, table.partition("└")[0].splitlines())) <= 80
    told = " ".join(table.split())
    assert "The margins of cautious were tuned for CarFollowing under dense skies; elsewhere they are untuned." in told
    rows = json.loads(run("--json").stdout)
    assert [row["agent"] for row in rows] == list(AGENTS)
    assert set(rows[0]) == {"agent", "does", "reads", "on_alert", "actions"}


def test_listing_needs_none_of_the_heavy_imports():
    done = subprocess.run([sys.executable, "-c", QUICK], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_agent_drives_with_its_own_figures():
    """Each takes the default of its first figure as if it were given, and decides by it; those without say so."""
    env = open_env("LaneKeeping", {"observation": {"integrity": "oracle"}})
    shown, _ = env.reset(seed=1000)
    without = set()
    for name, where in AGENTS.items():
        module, _, maker = where.partition(":")
        try:
            figures = _config_class(name, getattr(import_module(module), maker))().model_dump()
        except InputError:
            without.add(name)
            continue
        key = "gamma" if name == "cbf" else next(key for key, value in figures.items() if isinstance(value, float))
        agent = make_agent(name, env, {key: 0.5 * figures[key]})
        found = agent.config if hasattr(agent, "config") else agent.plan.config
        assert getattr(found, key) == 0.5 * figures[key], name
        assert env.action_space.contains(agent.predict(shown)[0]), name
    assert without == {"random", "ppo"}


@pytest.mark.parametrize("name", ["Merge", "Racetrack", "LaneKeeping"])
def test_refusals_name_exactly_those_that_can_drive(name):
    env = open_env(name, {"observation": {"integrity": "oracle"}})
    can, told = set(), set()
    for agent in AGENTS:
        try:
            make_agent(agent, env)
            can.add(agent)
        except InputError as error:
            if "learn a policy there" not in str(error):
                told.add(str(error).partition("choose one of ")[2])
    assert all(set(names.split(", ")) == can for names in told)
    assert (name == "LaneKeeping") == (can == set(AGENTS))
