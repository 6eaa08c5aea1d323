"""The warm-up error of accelerometers: closed forms, its published figures, and the fit from a static log."""

import numpy as np
import pytest
from scipy.stats import chi2

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
    found = fit_inertial_law(TIME_S, PUBLISHED.error_mps2(TIME_S)).law
    np.testing.assert_allclose(found.c1_mps2, -0.0043, rtol=1e-4)
    np.testing.assert_allclose(found.c2_mps2, -0.007, rtol=1e-4)
    np.testing.assert_allclose(found.tau_s, 500.0, rtol=1e-4)


def test_the_fit_survives_the_noise_of_the_paper():
    """S4's residual has a standard deviation of 3.3 mm/s^2; 60 s then drift by well below the uncorrected 12.9 m.

    sigma of the double integral of white noise at 1 Hz: 0.0033 sqrt(60^3 / 3) = 0.89 m; 4 sigma and the fit.
    """
    noise = 0.0033 * np.random.default_rng(5).standard_normal(TIME_S.size)
    found = fit_inertial_law(TIME_S, PUBLISHED.error_mps2(TIME_S) + noise).law
    np.testing.assert_allclose(found.c2_mps2, -0.007, atol=1e-3)
    np.testing.assert_allclose(found.c1_mps2, -0.0043, atol=1e-3)
    left = PUBLISHED.error_mps2(TIME_S) + noise - found.error_mps2(TIME_S)
    assert abs(left.mean()) < 1e-6
    assert abs(drift_m(TIME_S, left)) < 4.5


def test_other_laws_are_found_too():
    for law in (InertialErrorLaw(0.02, -0.01, 100.0), InertialErrorLaw(-0.1, 0.3, 1500.0)):
        found = fit_inertial_law(TIME_S, law.error_mps2(TIME_S)).law
        np.testing.assert_allclose(
            [found.c1_mps2, found.c2_mps2, found.tau_s], [law.c1_mps2, law.c2_mps2, law.tau_s], rtol=1e-3
        )


def noisy(seconds, seed, step_s=0.1):
    """A log of S4's law and noise, by default at 10 Hz."""
    t = np.arange(0.0, seconds, step_s)
    return t, PUBLISHED.error_mps2(t) + 0.0033 * np.random.default_rng(seed).standard_normal(t.size)


def test_sigmas_are_the_spread_of_the_fits():
    """40 logs of 4,000 s, a sample each 4 s: standardised errors have a variance of 1 (0.4 to 1.9 at 0.001)."""
    truth, apart = np.array([PUBLISHED.c1_mps2, PUBLISHED.c2_mps2, PUBLISHED.tau_s]), []
    for seed in range(40):
        fit = fit_inertial_law(*noisy(4000.0, seed, 4.0))
        assert fit.reason is None
        apart.append((np.array([fit.law.c1_mps2, fit.law.c2_mps2, fit.law.tau_s]) - truth) / fit.sigma)
    spread = np.square(apart).mean(0)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 40) / 40
    assert ((low < spread) & (spread < high)).all()


@pytest.mark.parametrize("seconds", [60.0, 120.0])
def test_a_log_that_is_too_short_is_fitted_by_a_constant(seconds):
    """S4's law with tau 500 s and its noise: the constant is its mean, and the message says what is needed."""
    for seed in range(5):
        t, a = noisy(seconds, seed)
        fit = fit_inertial_law(t, a)
        assert fit.law.c1_mps2 == 0.0
        assert fit.law.c2_mps2 == pytest.approx(a.mean())
        assert "log for two tau or more" in fit.reason


def test_constant_logs_and_lines_have_no_warm_up():
    t = np.arange(0.0, 300.0, 0.1)
    flat = fit_inertial_law(t, np.full(t.size, -0.007))
    assert (flat.law.c1_mps2, flat.law.c2_mps2) == (0.0, pytest.approx(-0.007))
    assert flat.reason == "the log is constant"
    assert fit_inertial_law(t, 1e-5 * t).reason.startswith("tau is not within 0.01 to 2 lengths")
    white = fit_inertial_law(t, 0.0033 * np.random.default_rng(1).standard_normal(t.size))
    assert white.law.c1_mps2 == 0.0


def test_gravity_left_in_a_log_is_refused():
    with pytest.raises(InputError, match=r"mean within 1 m/s\^2, got 9.8: subtract gravity"):
        fit_inertial_law(TIME_S, PUBLISHED.error_mps2(TIME_S) + 9.807)


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


def test_a_static_log_in_other_clothes_and_its_times(tmp_path):
    time, log = 0.1 * np.arange(3000), tmp_path / "log.csv"

    def written(times, head="time_s,a", separator=",", end="\n"):
        lines = [head.replace(",", separator), *(f"{t:.4f}{separator}{0.001 * k:.4f}" for k, t in enumerate(times))]
        log.write_bytes(b"\xef\xbb\xbf" + (end.join(lines) + end).encode())
        return read_static_log(log)

    for separator, end in ((",", "\r\n"), (";", "\n"), ("\t", "\n")):
        found, columns, note = written(time, separator=separator, end=end)
        np.testing.assert_allclose(found, time, atol=1e-4)
        assert (list(columns), note) == (["a"], "")
    found, columns, note = written(np.concatenate([time[:100], time[50:52], time[130:]]))
    assert columns["a"].size == found.size == 2970
    assert note == "2 of 2972 rows left out that are not later than one before; 1 gap, the longest of 3.10 s"
    with pytest.raises(InputError, match="must have times that increase, 2999 of 3000 rows go back"):
        written(time[::-1])
    with pytest.raises(InputError, match="must have its times in s, they are 100 apart: are they in ms"):
        written(1000.0 * time)
