"""Modules of a user that register fault kinds, on the command line and in worker processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lanebound.agents.assess.faults import FaultsConfig, assess_faults
from lanebound.agents.plugins import load_plugin
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.sensors.fault_kinds import FaultKind
from lanebound.integrity.sensors.fault_registry import register_fault, withdraw_fault

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


def test_modules_that_cannot_be_imported_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "broken_faults.py").write_text("1 / 0", encoding="utf-8")
    (tmp_path / "gymnasium.py").write_text("", encoding="utf-8")
    for name, message in (
        ("no_such_module", "'no_such_module' must name a module .*, got ModuleNotFoundError"),
        ("none.py", "none.py, which does not exist"),
        (str(tmp_path / "broken_faults.py"), "ZeroDivisionError: division by zero"),
        (str(tmp_path / "gymnasium.py"), "must have a name of its own, got .*: rename it"),
    ):
        with pytest.raises(InputError, match=message):
            load_plugin(name)


def test_worker_processes_need_an_effect_function_that_they_can_import(tmp_path: Path) -> None:
    register_fault(FaultKind(name="local", summary="nothing", apply=lambda effects, now: None))
    try:
        with pytest.raises(InputError, match="jobs must be 1 for fault kind 'local', because worker processes cannot"):
            assess_faults(FaultsConfig(kinds=("local",)), tmp_path, jobs=2)
    finally:
        withdraw_fault("local")


def test_the_campaign_refuses_a_kind_that_declares_why_it_is_not_tried() -> None:
    register_fault(
        FaultKind(name="rare", summary="nothing", apply=lambda effects, now: None, not_tried_because="it has no effect")
    )
    try:
        assert "rare" not in FaultsConfig().kinds
        with pytest.raises(ConfigError, match="kinds must be tried in the campaign, got 'rare': it has no effect"):
            FaultsConfig(kinds=("rare",))
    finally:
        withdraw_fault("rare")
