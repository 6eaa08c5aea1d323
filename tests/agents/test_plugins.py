"""Modules of a user that register fault kinds, on the command line and in worker processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from lanebound.agents.plugins import load_plugins
from lanebound.agents.studies.faults import FaultsConfig, assess_faults
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.sensors.fault_kinds import FaultKind
from lanebound.integrity.sensors.fault_registry import register_fault

MODULE = """
from lanebound.integrity.sensors.fault_kinds import FaultKind
from lanebound.integrity.sensors.fault_registry import register_fault

def stuck(effects, now):
    effects.odometer_frozen[now.rows] = True

register_fault(FaultKind(name="stuck", summary="the odometer", apply=stuck, profiles=("step",)))
"""


def test_the_command_takes_a_module_and_so_do_its_worker_processes(tmp_path: Path) -> None:
    (tmp_path / "my_faults.py").write_text(MODULE, encoding="utf-8")
    small = ["kinds=[stuck]", "durations_s=[2]", "control_s=61", "after_s=1", "warm_up_s=10", "theory_satellites=[]"]
    command = [str(Path(sys.executable).parent / "lanebound"), "assess", "faults", "--out", "out", "--vehicles", "1"]
    given = [*command, "--jobs", "2", "--plugin", "my_faults.py", *(w for s in small for w in ("--set", s))]
    done = subprocess.run(given, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "stuck, step, 2 s" in done.stdout


PLUGIN = str(Path(__file__).parents[1] / "plugins" / "hairpin.py")
QUICK = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 1.0}


def _lanebound(folder: Path, *words: str) -> str:
    """The output of a command with the world of tests/plugins/hairpin.py."""
    command = [str(Path(sys.executable).parent / "lanebound"), *words, "--plugin", PLUGIN]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_an_environment_of_a_plug_in_is_listed_shown_and_driven(tmp_path: Path) -> None:
    listed = json.loads(_lanebound(tmp_path, "envs", "--json"))
    assert [row["id"] for row in listed][-1] == "lanebound/Hairpin-v0"
    assert json.loads(_lanebound(tmp_path, "envs", "Hairpin", "--json"))["base"] == "HairpinWorld"
    settings = [w for key in ("navigation", "perception") for w in ("--set", f"{key}={json.dumps(QUICK[key])}")]
    shown = _lanebound(tmp_path, "drive", "Hairpin", "--set", "duration_s=1", *settings, "--json")
    assert json.loads(shown)["all"]["success rate"] == 1.0


def test_an_entry_of_a_function_is_shown_as_json(tmp_path: Path) -> None:
    plugin = str(Path(PLUGIN).with_name("stopping_distance.py"))
    index = json.loads(_lanebound(tmp_path, "envs", "LaneKeeping", "--json", "--plugin", plugin))["index"]
    found = next(entry for entry in index if entry["column"] == "ego.stopping_distance")
    assert found["source"] == "stopping_distance:stopping_distance_m"


def test_worker_processes_of_a_benchmark_load_plug_ins(tmp_path: Path) -> None:
    suite = {"envs": ["Hairpin"], "agents": ["random"], "seeds": {"count": 2}, "overrides": QUICK}
    (tmp_path / "suite.yaml").write_text(json.dumps(suite), encoding="utf-8")
    found = json.loads(_lanebound(tmp_path, "benchmark", "suite.yaml", "--out", "out", "--jobs", "2", "--json"))
    assert [outcome["status"] for outcome in found["outcomes"]] == ["ok"] * 2, found["failures"]
    replayed = _lanebound(tmp_path, "replay-episode", "out", "Hairpin/urban-none/random/10000")
    assert "It ended as it did, to the last bit." in replayed


def test_a_policy_learns_in_processes_that_load_plug_ins_and_is_evaluated(tmp_path: Path) -> None:
    learning = {
        "kind": "experiment", "env": "Hairpin", "algorithm": "ppo", "engine": False, "steps": 32, "count": 2,
        "checkpoint_steps": 32, "overrides": QUICK, "settings": {"n_steps": 16, "batch_size": 32, "n_epochs": 1},
    }  # fmt: skip
    (tmp_path / "learning.yaml").write_text(json.dumps(learning), encoding="utf-8")
    assert "1 checkpoint" in _lanebound(tmp_path, "train", "learning.yaml", "--out", "learnt", "--jobs", "2")
    given = ("--out", "judged", "--seeds", "1", "--agents", "random", "--jobs", "1", "--json")
    judged = json.loads(_lanebound(tmp_path, "evaluate", "learnt", *given))
    assert not judged["failures"]
    assert {outcome["agent"] for outcome in judged["outcomes"]} > {"random"}


def test_modules_that_cannot_be_imported_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "broken_faults.py").write_text("1 / 0", encoding="utf-8")
    (tmp_path / "gymnasium.py").write_text("", encoding="utf-8")
    for name, message in (
        ("no_such_module", "'no_such_module' must name a module .*, got ModuleNotFoundError"),
        ("none.py", "none.py, which does not exist"),
        (str(tmp_path / "broken_faults.py"), r"ZeroDivisionError: division by zero at .*broken_faults\.py:1: correct"),
        (str(tmp_path / "gymnasium.py"), "must have a name of its own, got .*: rename it"),
    ):
        with pytest.raises(InputError, match=message):
            load_plugins([name])


def test_worker_processes_need_an_effect_function_that_they_can_import(tmp_path: Path) -> None:
    register_fault(FaultKind(name="local", summary="nothing", apply=lambda effects, now: None))
    with pytest.raises(InputError, match="jobs must be 1 for fault kind 'local', because worker processes cannot"):
        assess_faults(FaultsConfig(kinds=("local",)), tmp_path, jobs=2)


def test_the_campaign_refuses_a_kind_that_declares_why_it_is_not_tried() -> None:
    register_fault(
        FaultKind(name="rare", summary="nothing", apply=lambda effects, now: None, not_tried_because="it has no effect")
    )
    assert "rare" not in FaultsConfig().kinds
    with pytest.raises(ConfigError, match="kinds must be tried in the campaign, got 'rare': it has no effect"):
        FaultsConfig(kinds=("rare",))
