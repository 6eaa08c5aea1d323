"""The record of fault effects: nothing wrong, shared and read-only."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.effects import FaultEffects

NEUTRAL_ONE = {"odometer_scale", "v2v_pl_scale"}


def test_none_is_neutral_shared_and_read_only() -> None:
    none = FaultEffects.none(2, 5)
    assert FaultEffects.none(2, 5) is none
    for records in (none.signals, none.vehicles):
        for name in records.dtype.names or ():
            array = getattr(none, name)
            assert (array == (1.0 if name in NEUTRAL_ONE else 0.0)).all()
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 3


def test_what_is_changed_in_place_is_in_the_records_that_kernels_take() -> None:
    effects = FaultEffects.blank(2, 5)
    effects.slip_cycles[1, 3, 0] += 2
    effects.odometer_scale[0] *= 1.5
    assert effects.signals["slip_cycles"].sum() == effects.signals["slip_cycles"][1, 3, 0] == 2
    np.testing.assert_array_equal(effects.vehicles["odometer_scale"], [1.5, 1.0])


def test_blank_is_fresh_and_writable() -> None:
    effects = FaultEffects.blank(2, 5)
    effects.code_bias_m[0, 1] = 4.0
    assert FaultEffects.blank(2, 5).code_bias_m[0, 1] == 0.0
    assert effects.slip_cycles.shape == (2, 5, 2)
    assert effects.slip_cycles.dtype == np.int64


def test_negative_sizes_are_refused() -> None:
    with pytest.raises(InputError, match="batch"):
        FaultEffects.blank(-1, 3)
