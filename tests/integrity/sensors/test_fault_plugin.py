"""A fault kind from outside the package, tests/plugins/clock_jump.py: one record with an effect function."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from clock_jump import CLOCK_JUMP, METRES_PER_NS

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.agents.studies.faults import FaultsConfig, assess_faults
from lanebound.envs.manual import markdown
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.navigators.navigator import Measurements, Navigator
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.fault_registry import register_fault, withdraw_fault
from lanebound.integrity.sensors.faults import Fault
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack


@pytest.fixture(autouse=True)
def _registered() -> None:
    register_fault(CLOCK_JUMP)


def test_an_environment_drives_with_the_fault_and_measurements_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    jump = {"kind": "clock_jump", "start_s": 0.5, "magnitude": 100.0, "vehicle": 0}
    with_fault, without = _drive([jump], monkeypatch), _drive([], monkeypatch)
    assert with_fault[0].time_s == without[0].time_s
    onset_s = next(a.time_s for a, b in zip(with_fault, without, strict=True) if (a.gnss.code_m != b.gnss.code_m).any())
    assert onset_s == pytest.approx(with_fault[-1].time_s - 1.0 + 0.5 + 0.1)  # first epoch after the onset
    for name in ("code_m", "phase_m"):
        jumped, before = (getattr(run[-1].gnss, name) for run in (with_fault, without))
        measured = before != 0.0
        assert measured.sum() > 8
        np.testing.assert_allclose((jumped - before)[measured], 100.0 * METRES_PER_NS, atol=1e-6)


def _drive(faults: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> list[Measurements]:
    """The measurements of a second of LaneKeeping under an open sky."""
    found: list[Measurements] = []
    measure = Navigator.measure

    def watched(navigator: Navigator, *given: Any) -> Measurements:
        found.append(measure(navigator, *given))
        return found[-1]

    with monkeypatch.context() as patch:
        patch.setattr(Navigator, "measure", watched)
        env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"})
        env.reset(seed=1, options={"faults": faults})
        for _ in range(env.unwrapped.config.policy_hz):  # type: ignore[attr-defined]
            env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
        env.close()
    return found


def test_the_fault_campaign_tries_it(tmp_path: Path) -> None:
    assert "clock_jump" in FaultsConfig().kinds
    small = FaultsConfig(
        vehicles=2, warm_up_s=15.0, after_s=2.0, durations_s=(2.0,), kinds=("clock_jump",), control_s=61.0,
        theory_satellites=(),
    )  # fmt: skip
    cells = assess_faults(small, tmp_path)["faults"]
    assert [(c["kind"], c["unit"], c["size"], c["profile"]) for c in cells] == [
        ("clock_jump", "ns", 30.0, "step"), ("clock_jump", "ns", 300.0, "step"),
    ]  # fmt: skip
    # the receiver clock is estimated in each epoch: a jump that all satellites share moves no position
    assert all(c["misled_vehicles"]["events"] == 0 for c in cells)


def test_random_faults_draw_it_after_the_kinds_of_the_package() -> None:
    track = SkyTrack.from_config(SkyConfig(), 60.0)
    sky = track.at(track.start_s, np.zeros(2, dtype=np.int64))
    drawn = random_campaign(FaultPriors(), 2e6, named_generator(1, "faults"), sky)
    jumps = [fault for fault in drawn if fault.kind == "clock_jump"]
    assert len(jumps) > 3
    assert all(10.0 <= abs(fault.magnitude) <= 1000.0 for fault in jumps)
    withdraw_fault("clock_jump")
    others = random_campaign(FaultPriors(), 2e6, named_generator(1, "faults"), sky)
    assert [fault for fault in drawn if fault not in jumps] == list(others)


def test_a_fault_of_it_is_checked_as_any_other() -> None:
    assert Fault(kind="clock_jump", magnitude=-30.0).size == -30.0
    for wrong, message in (
        ({}, "clock_jump needs magnitude other than 0"),
        ({"magnitude_m": 1.0}, "clock_jump has no magnitude_m"),
        ({"kind": "clock_jmp"}, "got 'clock_jmp': did you mean 'clock_jump'"),
    ):
        with pytest.raises(ConfigError, match=message):
            Fault.load({"kind": "clock_jump", **wrong})


def test_the_manual_lists_it() -> None:
    assert "| `clock_jump` | the clock of the receiver" in markdown()


def test_it_is_unknown_once_it_is_removed() -> None:
    withdraw_fault("clock_jump")
    with pytest.raises(ConfigError, match="kind must be one of"):
        Fault(kind="clock_jump", magnitude=1.0)


def test_a_size_in_the_wrong_field_is_refused_with_the_right_one() -> None:
    with pytest.raises(ConfigError, match=r"clock_jump has no magnitude_m: give its size as magnitude \[ns\]$"):
        Fault.load({"kind": "clock_jump", "magnitude_m": 20.0})
    with pytest.raises(
        ConfigError, match=r"clock_jump needs magnitude other than 0: give its size as magnitude \[ns\]$"
    ):
        Fault.load({"kind": "clock_jump"})
