"""The tables of modes and of alert reasons: codes, names, and members from outside."""

from __future__ import annotations

import copy
import pickle

import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning import codes_kernel as codes
from lanebound.integrity.positioning.modes import Mode, RtkStatus


def test_codes_are_those_of_the_kernels() -> None:
    for mode in Mode:
        assert int(mode) == getattr(codes, mode.name)
    for status in RtkStatus:
        assert status.code == getattr(codes, status.name)


def test_a_mode_from_outside_takes_the_next_code_until_it_is_withdrawn() -> None:
    mode = Mode.register("camera", "camera")
    assert (int(mode), mode.name, Mode(11), len(Mode)) == (11, "CAMERA", mode, 12)
    assert Mode.register("camera", "camera") is mode
    assert pickle.loads(pickle.dumps(mode)) is copy.deepcopy(mode) is mode
    with pytest.raises(InputError, match="label of mode 'camera' must be 'camera', got 'lidar': choose another key"):
        Mode.register("camera", "lidar")
    later = Mode.register("lidar", "lidar")
    with pytest.raises(InputError, match="mode must be the one registered last, got 'camera'"):
        Mode.withdraw(mode)
    Mode.withdraw(later)
    Mode.withdraw(mode)
    with pytest.raises(InputError, match=r"mode must be one of none, .*, nrtk, got 'camera': import the module"):
        Mode.named("camera")
    with pytest.raises(InputError, match="mode must be the one registered last, got 'nrtk'"):
        Mode.withdraw(Mode.NRTK)


def test_a_reason_from_outside_takes_the_next_code_until_it_is_withdrawn() -> None:
    reason = AlertReason.register("map_changed", "the map does not fit; drive by sight")
    assert (reason.code, reason.name, reason.value) == (11, "MAP_CHANGED", "the map does not fit; drive by sight")
    assert AlertReason.MAP_CHANGED is AlertReason["MAP_CHANGED"] is AlertReason.from_code(11) is reason  # type: ignore[attr-defined]
    assert pickle.loads(pickle.dumps(reason)) is copy.deepcopy(reason) is reason
    assert AlertReason.count([11, 0, 11])["map_changed"] == 2
    with pytest.raises(InputError, match="advice of AlertReason MAP_CHANGED must be"):
        AlertReason.register("map_changed", "another")
    with pytest.raises(InputError, match="name must be that of the last AlertReason, got 'HOLDING'"):
        AlertReason.withdraw("HOLDING")
    AlertReason.withdraw("map_changed")
    with pytest.raises(InputError, match="AlertReason code must be one of"):
        AlertReason.from_code(11)
