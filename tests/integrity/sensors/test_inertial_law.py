"""The warm-up error of accelerometers: closed forms, its published figures, and the fit from a static log."""

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.inertial_law import (
    PUBLISHED,
    InertialErrorLaw,
    drift_m,
    fit_inertial_law,
    read_static_log,
)

TIME_S = np.arange(0.0, 3000.0, 1.0)


def test_the_drift_is_the_double_integral():
    t = np.linspace(0.0, 60.0, 60_001)
    np.testing.assert_allclose(drift_m(t, PUBLISHED.error_mps2(t)), PUBLISHED.drift_m(60.0), rtol=1e-8)


def test_the_published_figures_drift_by_less_than_the_paper_says():
    """12.9 m after 60 s from switch-on; S4 states 55 m without correction (equations.md section 12)."""
    assert abs(float(PUBLISHED.drift_m(60.0)) + 12.9) < 0.05


def test_the_fit_returns_the_law_that_made_the_data():
    found = fit_inertial_law(TIME_S, PUBLISHED.error_mps2(TIME_S))
    np.testing.assert_allclose(found.c1_mps2, -0.0043, rtol=1e-4)
    np.testing.assert_allclose(found.c2_mps2, -0.007, rtol=1e-4)
    np.testing.assert_allclose(found.tau_s, 500.0, rtol=1e-4)


def test_the_fit_survives_the_noise_of_the_paper():
    """S4's residual has a standard deviation of 3.3 mm/s^2; 60 s then drift by well below the uncorrected 12.9 m.

    sigma of the double integral of white noise at 1 Hz: 0.0033 sqrt(60^3 / 3) = 0.89 m; 4 sigma and the fit.
    """
    noise = 0.0033 * np.random.default_rng(5).standard_normal(TIME_S.size)
    found = fit_inertial_law(TIME_S, PUBLISHED.error_mps2(TIME_S) + noise)
    np.testing.assert_allclose(found.c2_mps2, -0.007, atol=1e-3)
    np.testing.assert_allclose(found.c1_mps2, -0.0043, atol=1e-3)
    left = PUBLISHED.error_mps2(TIME_S) + noise - found.error_mps2(TIME_S)
    assert abs(left.mean()) < 1e-6
    assert abs(drift_m(TIME_S, left)) < 4.5


def test_other_laws_are_found_too():
    for law in (InertialErrorLaw(0.02, -0.01, 100.0), InertialErrorLaw(-0.1, 0.3, 1500.0)):
        found = fit_inertial_law(TIME_S, law.error_mps2(TIME_S))
        np.testing.assert_allclose(
            [found.c1_mps2, found.c2_mps2, found.tau_s], [law.c1_mps2, law.c2_mps2, law.tau_s], rtol=1e-3
        )


def test_bad_logs_are_refused(tmp_path):
    with pytest.raises(InputError, match="n >= 10 rows"):
        fit_inertial_law([0.0, 1.0], [0.0, 1.0])
    with pytest.raises(InputError, match="must increase"):
        fit_inertial_law(np.zeros(20), np.zeros(20))
    with pytest.raises(InputError, match="file that exists"):
        read_static_log(tmp_path / "none.csv")
    log = tmp_path / "log.csv"
    log.write_text("time_s,accel_mps2\n" + "0,x\n" * 20)
    with pytest.raises(InputError, match="must hold numbers"):
        read_static_log(log)
