"""Every snippet of the README runs and says what it says."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

from lanebound.agents.learning.experiment import load_experiment

README = Path(__file__).resolve().parents[2] / "README.md"


def test_readme_snippets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run where snippets may write files."""
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(README), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert result.attempted > 10
    assert result.failed == 0


def test_readme_names_no_unfilled_figure() -> None:
    assert "@" not in README.read_text(encoding="utf-8")


def test_the_experiment_of_the_readme_can_be_learnt(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(extends: experiments/.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    path = tmp_path / "mine.yaml"
    path.write_text(block, encoding="utf-8")
    found, base = (load_experiment(name) for name in (str(path), "car_following_ppo_lagrangian"))
    assert (found.env, found.sky, found.steps, found.count) == (base.env, "dense", 100_000, 32)
