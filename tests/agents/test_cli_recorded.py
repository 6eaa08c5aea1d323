"""``lanebound replay`` and ``rtk`` beside their results: threads, progress in files, and what an interrupt leaves."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from lanebound.agents.checkpointing.runner import RunProgress
from lanebound.agents.cli import app
from lanebound.agents.cli import output as progress
from lanebound.agents.cli.recorded import _higher_risk, _limit_blas_threads, _solve, _written_text


def test_linear_algebra_gets_one_thread_unless_the_user_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    _limit_blas_threads()
    assert (os.environ["OMP_NUM_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]) == ("3", "1")


def test_numpy_is_loaded_after_that() -> None:
    """The libraries read the variables when they are loaded."""
    code = "import sys, lanebound.agents.cli.recorded; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_interrupt_names_what_is_written(tmp_path: Path) -> None:
    assert _written_text(tmp_path, 0.0) == "nothing is kept"
    (tmp_path / "run.json").write_text("{}")
    assert _written_text(tmp_path, 0.0) == "nothing is kept"
    (tmp_path / "replay.json").write_text("{}")
    assert _written_text(tmp_path, 0.0) == f"replay.json is written in {tmp_path}; later files are missing"
    old = (tmp_path / "replay.json").stat().st_mtime + 100.0
    assert _written_text(tmp_path, old) == "nothing is kept"  # of an earlier run


def test_a_refusal_leaves_a_folder_that_other_work_can_claim(tmp_path: Path) -> None:
    out, data = tmp_path / "out", tmp_path / "data"
    data.mkdir()
    (data / "a_Input.txt").touch()
    assert CliRunner().invoke(app, ["replay", str(data), "--out", str(out)]).exit_code == 2
    assert not list(out.iterdir())
    assert _solve(out, "drive on a service", lambda _: 1) == 1


def test_slow_work_reports_within_half_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    lines = progress._Lines("epochs")
    for done in range(4):
        now[0] = 20.0 * done
        lines(RunProgress(of=1000, done=done))
    assert [line.split(",")[0] for line in capsys.readouterr().err.splitlines()] == [
        "2 of 1",
    ]


def test_a_higher_risk_than_the_present_one_is_advised() -> None:
    assert _higher_risk(1e-5).endswith("--set risk.integrity_risk=0.0001")
    assert _higher_risk(1e-3).endswith("--set risk.integrity_risk=0.01")
    assert _higher_risk(1e-2) == ""
