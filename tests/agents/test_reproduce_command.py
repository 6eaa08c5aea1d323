"""``lanebound reproduce urban-drive``: refusals before the bar, the printed tables, and Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from threading import Lock
from typing import Any

import pytest
from processes import started
from typer.testing import CliRunner

from lanebound.agents.checkpointing import runner
from lanebound.agents.cli import app
from lanebound.agents.cli import output as progress
from lanebound.agents.cli.listing import resolve
from lanebound.agents.cli.output import wait_for
from lanebound.agents.studies import urban_drive as study
from lanebound.agents.studies.urban_drive import CELLS, MODES, RISKS, UrbanDriveConfig, risk_key

PROGRAM = str(Path(sys.executable).parent / "lanebound")
STUBBORN = """
import time
from lanebound.agents.cli.output import resumable, wait_for

def deaf():
    print("ready", flush=True)
    while True:
        try:
            time.sleep(0.02)
        except KeyboardInterrupt:
            pass

with resumable(lambda: "all is kept"):
    wait_for(deaf)
"""


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["reproduce", "urban-drive", *arguments])


def tables(seeds: int, minutes: float) -> dict[str, Any]:
    """Tables in which every figure is as printed by the paper, but the first, which lies outside its band."""
    found: dict[str, Any] = {"seeds": seeds, "minutes": minutes, "spread": {}, "availability": {"rtk_1m": 0.997}}
    for i, cell in enumerate(CELLS):
        branch = found
        for key in cell.path[:-1]:
            branch = branch.setdefault(key, {})
        branch[cell.path[-1]] = cell.published if i else 2.0 * cell.high
    found["epochs"] = dict(zip(MODES, (1_100_000, 420_000, 41_234), strict=True))
    rates = {risk_key(risk): 0.0 for risk in RISKS}
    found["exceedance"] = {mode: {"published": rates | {"1e-3": 2.5e-4}} for mode in MODES}
    return found


@pytest.mark.parametrize(
    "arguments",
    [
        ("--set", "seedz=3"),
        ("--set", "navigator.dt_s=-1"),
        ("--set", "loop_m=[[0, 0], [0, 0], [0, 0]]"),
        ("--seeds", "0"),
    ],
)
def test_bad_input_is_refused_before_the_bar_shows(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "run_study", None)
    result = run("--out", str(tmp_path / "new"), *arguments)
    assert result.exit_code == 2
    assert all(line.startswith("error: ") for line in result.stderr.splitlines())
    assert not (tmp_path / "new").exists()


def test_a_folder_with_another_study_is_refused_before_the_bar_shows(tmp_path: Path) -> None:
    config = resolve("studies/urban_drive", {"seeds": 1})[1]
    assert isinstance(config, UrbanDriveConfig)
    study.check(config, tmp_path)
    result = run("--out", str(tmp_path), "--seeds", "2")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: the folder must be empty or hold the same urban drive study, got")
    assert "which differs in seeds (1 there, now 2)" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(("seeds", "minutes", "short"), [(100, 26.0, False), (8, 6.0, True)])
def test_the_tables_say_what_they_are_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seeds: int, minutes: float, short: bool
) -> None:
    monkeypatch.setattr(study, "run_study", lambda *_: tables(seeds, minutes))
    text = run("--out", str(tmp_path), "--seeds", str(seeds)).stdout
    assert f"medians over {seeds} drives of {minutes:g} min" in text
    assert f"38 of {len(CELLS)} printed figures lie inside" in text
    assert "1,561,234 epochs in all" in text
    assert ("1,100,000" in text, "2.5e-04" in text, "0.0e+00" in text) == (True, True, False)
    assert ("meant for the whole study, 100 drives of 26 min" in text) is short
    assert ("outside (short run)" in text) is short
    result = json.loads(run("--out", str(tmp_path), "--seeds", str(seeds), "--json").stdout)
    assert result["short_run"] is short
    assert result["tables"]["epochs"]["rtk"] == 1_100_000


def test_an_interruption_says_what_is_kept_and_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        (tmp_path / "parts").mkdir()
        (tmp_path / "parts" / "seeds-1000-1024.json").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "run_study", stop)
    monkeypatch.setattr(progress.os, "_exit", sys.exit)
    monkeypatch.setattr(runner, "STARTING", Lock())  # it stays acquired
    result = run("--out", str(tmp_path))
    assert result.exit_code == 130
    line = result.stderr.splitlines()[-1]
    assert line.startswith("interrupted: 1 finished part is kept in")
    assert line.endswith("run the same command again to resume")


def test_work_returns_and_raises_as_if_it_were_called() -> None:
    assert wait_for(lambda: 3) == 3
    with pytest.raises(ZeroDivisionError):
        wait_for(lambda: 1 // 0)


def test_work_that_swallows_interrupts_is_left_at_once() -> None:
    with started([sys.executable, "-c", STUBBORN]) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert (process.returncode, said) == (130, "interrupted: all is kept\n")


def test_the_program_stops_while_its_kernels_compile(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [PROGRAM, "reproduce", "urban-drive", "--out", str(out), "--seeds", "1", "--minutes", "1"]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with started(command, env=environment) as process:
        while not (out / "run.json").exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(1.0)  # it compiles for half a minute now
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 130
    assert said.splitlines()[-1].startswith("interrupted: no part was finished; ")
