"""What a response says of two runs made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lanebound.agents.studies.fault_response import Run, as_broadcast, measure_response
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault

EPOCHS, VEHICLES = 50, 3


def quiet() -> Run:
    shape = (EPOCHS, VEHICLES)
    return Run(
        time_s=0.1 * np.arange(1, EPOCHS + 1),
        heading_rad=np.tile([0.0, 0.5 * np.pi, np.pi], (EPOCHS, 1)),
        error_m=np.full((*shape, 2), 0.01),
        level_m=np.full((*shape, 2), 0.1),
        squared=np.zeros(shape),
        mode=np.full(shape, Mode.RTK, dtype=np.int64),
        excluded=np.zeros(shape, np.int64),
        held=np.full(shape, 12, dtype=np.int64),
        alert=np.zeros(shape, np.bool_),
        available=np.ones(shape, np.bool_),
    )


ONSET = np.array([1.0, 1.0, 2.0])


def test_nothing_differs() -> None:
    found = measure_response(quiet(), quiet(), ONSET, 10.0, (1.0, 1.0))
    assert np.isinf(found.noticed_s).all()
    assert not (found.excluded | found.alerted | found.failed).any()
    assert found.hazardous.sum() == found.misleading.sum() == 0
    assert found.epochs.tolist() == [40, 40, 30]
    np.testing.assert_allclose(found.worst_m, 0.01)


def test_each_thing_is_told_of_its_vehicle() -> None:
    faulty = quiet()
    faulty.excluded[14:16, 0] = 1  # at 1.5 s
    faulty.mode[25:, 1] = Mode.DOPPLER
    faulty.error_m[30:40, 1, 1] = 2.0
    faulty.alert[36:, 1] = True  # six epochs late
    faulty.error_m[45:, 2, 0] = -0.5
    faulty.held[40, 2] = 11  # at 4.1 s
    faulty.available[-1, 2] = faulty.available[20, 0] = False
    found = measure_response(faulty, quiet(), ONSET, 10.0, (1.0, 1.0))
    np.testing.assert_allclose(found.noticed_s, [0.5, 1.6, 2.1])
    assert found.excluded.tolist() == [True, False, False]
    assert found.given_up.tolist() == [False, False, True]
    assert found.alerted.tolist() == [False, True, False]
    assert found.failed.tolist() == [False, True, False]
    np.testing.assert_allclose(found.late_s, [0.0, 0.6, 0.0])
    assert found.hazardous.tolist() == [0, 6, 0]
    assert found.misleading.tolist() == [0, 6, 4]
    np.testing.assert_allclose(found.worst_m, [0.01, 2.0, 0.5])
    assert found.lost.tolist() == [False, False, True]


def test_what_is_noticed_once_a_fault_is_over_does_not_count_as_noticed() -> None:
    faulty = quiet()
    faulty.excluded[30, 0] = 1  # at 3.1 s
    faulty.alert[19, 1], faulty.alert[30, 1] = True, True
    found = measure_response(faulty, quiet(), ONSET, 2.0, (1.0, 1.0))
    np.testing.assert_allclose(found.noticed_s, [np.inf, 1.0, np.inf])
    assert found.noticed_after.tolist() == [True, False, False]
    assert found.excluded.tolist() == [True, False, False]
    assert measure_response(faulty, quiet(), ONSET, 2.1, (1.0, 1.0)).noticed_s[0] == pytest.approx(2.1)


def test_what_the_sound_vehicle_does_too_is_no_response() -> None:
    faulty, sound = quiet(), quiet()
    for run in (faulty, sound):
        run.excluded[20, :] = 1
        run.alert[30:, :] = True
    found = measure_response(faulty, sound, ONSET, 10.0, (1.0, 1.0))
    assert np.isinf(found.noticed_s).all()
    assert not found.alerted.any()


@pytest.mark.parametrize("before", [True, False])
def test_before_the_onset_nothing_counts(before: bool) -> None:
    faulty = replace(quiet())
    faulty.error_m[5 if before else 15, 0, 0] = 3.0
    found = measure_response(faulty, quiet(), ONSET, 10.0, (1.0, 1.0))
    assert found.failed[0] != before


def test_a_lie_moves_what_is_heard_and_shrinks_its_level() -> None:
    common = {"kind": "v2v_lie", "start_s": 2.0, "duration_s": 1.0, "magnitude_m": 3.0, "azimuth_deg": 90.0}
    lies = [Fault.load(common | {"vehicle": v, "magnitude_ratio": -0.5}) for v in (0, 1)]
    heard, said = as_broadcast(quiet(), NavigatorConfig(), lies), quiet()
    lying = (said.time_s > 2.05) & (said.time_s < 3.05)
    np.testing.assert_allclose(heard.error_m[lying, 0], [[0.01, 3.01]] * 10)  # eastward is across a drive to the North
    np.testing.assert_allclose(heard.error_m[lying, 1], [[3.01, 0.01]] * 10)
    np.testing.assert_array_equal(heard.error_m[:, 2], said.error_m[:, 2])
    np.testing.assert_array_equal(heard.error_m[~lying], said.error_m[~lying])
    np.testing.assert_allclose(heard.level_m[lying, :2], 0.05)
    found = measure_response(heard, said, np.array([2.0, 2.0, 2.0]), 1.0, (1.0, 1.0))
    assert found.hazardous.tolist() == found.misleading.tolist() == [10, 10, 0]
    assert np.isinf(found.noticed_s).all()
