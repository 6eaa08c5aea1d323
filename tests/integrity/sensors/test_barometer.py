"""The barometer: its errors have the law that it states, and what a navigator declares bounds them."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.services.config import DeclaredBarometerConfig
from lanebound.integrity.sensors.barometer import BarometerConfig, initial_barometer, sample_barometer


@pytest.mark.parametrize(("speed", "time_s"), [(0.0, 60.0), (20.0, 60.0), (10.0, 1800.0)])
def test_errors_have_their_variance_and_the_declared_one_bounds_it(speed: float, time_s: float) -> None:
    """2,000 vehicles; a variance of 2,000 normal errors is off by 14 % once in 10,000 cases."""
    config, streams, batch = BarometerConfig(fitted=True), Streams(range(2000)), 2000
    state, dt = initial_barometer(config, streams), time_s / 20.0
    velocity, position = np.tile([0.0, speed], (batch, 1)), np.zeros((batch, 2))
    for k in range(20):
        places = position + dt * k * velocity, position + dt * (k + 1) * velocity
        truth = truth_between(dt * (k + 1), dt, places, (velocity, velocity), (np.zeros(batch),) * 2)
        height = sample_barometer(config, state, truth, streams).height_m
    error = height - truth.position_enu_m[:, 2]
    weather = config.weather_m**2 * (1.0 - np.exp(-2.0 * time_s / config.weather_tau_s))
    wind = (config.wind * speed**2 / 19.62) ** 2
    stated = config.offset_m**2 + weather + wind + config.noise_m**2
    assert error.var() == pytest.approx(stated, rel=0.14)
    declared = DeclaredBarometerConfig().variance_m2(time_s, np.array([speed]))[0]
    assert stated < declared < 3.0 * stated


def test_a_barometer_makes_code_positions_surer_and_changes_no_other_draw() -> None:
    """HDOP-like gain under an open sky is small, but it is there; RTK does not read the barometer."""
    levels, others = {}, {}
    for fitted in (False, True):
        config = NavigatorConfig(service="spp", barometer={"fitted": fitted}, risk={"integrity_risk": 1e-3})
        navigator = Navigator.nominal(config, seeds=list(range(16)), duration_s=30.0)
        zero, heading = np.zeros((16, 2)), np.zeros(16)
        navigator.place(zero, heading, 30.0, 0.01)
        for k in range(21):
            truth = truth_between(0.1 * (k + 1), 0.1, (zero, zero), (zero, zero), (heading, heading))
            measured = navigator.measure(truth)
            solution = navigator.locate(measured)
        assert (measured.barometer is not None) is fitted
        levels[fitted], others[fitted] = np.median(solution.pl_cases_m), measured.gnss.code_m
        assert (np.abs(solution.position_en_m[:, 1]) <= solution.pl_at_m).all()
    np.testing.assert_array_equal(others[True], others[False])
    assert levels[True] < levels[False]
