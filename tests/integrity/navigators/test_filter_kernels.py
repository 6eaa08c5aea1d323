"""The kernels of vehicle filters equal their reference in NumPy: each epoch from one state, and a whole drive."""

import numpy as np
import plain_filter_navigator as plain
import pytest

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sky.road import Road

BEND = Road.through(np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 200.0]]))
KINDS = {
    "imm": {"filter": "imm"},
    "curved first": {"filter": "imm", "models": ["curved", "straight"], "interaction": "published"},
    "ukf": {"filter": "ukf", "models": ["curved"]},
    "ekf with chassis": {"filter": "ekf", "chassis": {"fitted": True}, "compass": {"fitted": True}},
    "as printed": {"filter": "imm", "sensor_errors": False, "motion": {"accelerometer": "observation"}},
}


def drive(change, seeds=(1, 2, 3)):
    """A navigator that knows its pose, and its truths."""
    levels = [{"integrity_risk": 1e-3}, {"integrity_risk": 1e-7, "variant": "published"}]
    c = NavigatorConfig.load({"kind": "filter", "more_levels": levels, "gnss": {"undifferenced": True}, **change})
    navigator = Navigator.nominal(c, list(seeds), duration_s=60.0)
    traffic, car = Streams(list(seeds)), CityDrive(BEND, DriveConfig(), c.dt_s)
    state = car.start(traffic)
    navigator.place(state.position_m.copy(), state.heading_rad.copy(), 0.5, np.deg2rad(1.0))
    return navigator, (car.step(state, traffic) for _ in range(10_000))


def agree(kernel, reference, tolerance):
    """Position, levels, trust level and NIS."""
    np.testing.assert_allclose(kernel.position_en_m, reference.position_m, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(kernel.pl_cases_m, reference.levels_m, rtol=tolerance)


@pytest.mark.parametrize("kind", KINDS)
def test_an_epoch_equals_the_reference(kind):
    """From the state of the kernels, to 1e-9: position, levels, trust level, NIS, probabilities, covariances."""
    navigator, truths = drive(KINDS[kind])
    used = 0
    for _ in range(45):
        m = navigator.measure(next(truths))
        b = plain.belief_of(navigator.state.belief)
        found = plain.locate(navigator.config, b, m)
        agree(navigator.locate(m), found, 1e-9)
        state, report = navigator.state.belief, navigator.report
        np.testing.assert_allclose(report.htl_m, found.trust_m, rtol=1e-9)
        np.testing.assert_allclose(report.nis, found.nis, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(state.probability, b.probability, rtol=1e-8)
        scale = np.sqrt(np.einsum("brii->bri", b.p)) + 1e-12
        np.testing.assert_allclose(
            state.models["p"] / (scale[..., None] * scale[..., None, :]),
            b.p / (scale[..., None] * scale[..., None, :]),
            atol=1e-8,
        )
        np.testing.assert_allclose(state.influence, b.influence, rtol=1e-7, atol=1e-10)
        used += report.gnss_used.sum()
    assert used >= 6  # positions were in it


def test_a_drive_equals_the_reference():
    """Both go on from their own state for 8 s: rounding grows to no more than a micrometre."""
    navigator, truths = drive({"filter": "imm"})
    b = plain.belief_of(navigator.state.belief)
    for _ in range(80):
        m = navigator.measure(next(truths))
        reference = plain.locate(navigator.config, b, m)
        agree(navigator.locate(m), reference, 1e-6)
