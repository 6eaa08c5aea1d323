"""The digest of the defaults changes with what users get who name nothing, and with nothing else."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lanebound.agents.checkpointing.folder import defaults_digest
from lanebound.envs import registration
from lanebound.integrity.core import presets


def test_another_process_finds_the_same_digest() -> None:
    program = "from lanebound.agents.checkpointing.folder import defaults_digest; print(defaults_digest())"
    found = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == defaults_digest()


@pytest.mark.parametrize("changed", ["skies/urban", "drivers/cautious", "suites/quick"])
def test_presets_of_values_count_and_those_of_commands_do_not(monkeypatch, changed: str) -> None:
    original = presets.load_preset
    monkeypatch.setattr(presets, "load_preset", lambda name: {"x": 1} if name == changed else original(name))
    assert (defaults_digest.__wrapped__() == defaults_digest()) == changed.startswith("suites/")


def test_an_id_counts_as_it_is_shipped(monkeypatch) -> None:
    original = registration.make_config
    monkeypatch.setattr(registration, "make_config", lambda name: original(name, {"cost_limit": 0.5}))
    assert defaults_digest.__wrapped__() != defaults_digest()
