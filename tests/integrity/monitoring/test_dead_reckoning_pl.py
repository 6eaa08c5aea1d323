"""Growth of the error between fixes: closed forms, simulation, kernel against reference, and the levels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, norm

from lanebound.integrity.monitoring import dead_reckoning_pl_kernel as dk
from lanebound.integrity.monitoring.dead_reckoning_pl import (
    Growth,
    HeadingStep,
    bias_track,
    doppler_step,
    initial_growth,
    missed_detection_factors,
    odometer_step,
    protection_levels,
)
from lanebound.integrity.monitoring.risk import RiskConfig, Variant
from lanebound.integrity.positioning import heading_kernel as hk

DT = 0.1
PHI_D, PHI_O = float(np.exp(-DT / 0.54)), float(np.exp(-DT / 1.0))
FACTOR = np.array([[0.10, 0.0], [0.03, 0.08]])  # Cholesky factor of the Doppler velocity covariance [m/s]
SIGMA_ODOMETER = 0.05  # m/s
WHITE = 3.0  # variance of the white part of the Doppler error
ARW, BIAS_WALK, COURSE_SIGMA = 6e-3, 2e-4, 0.02  # rad/sqrt(s), rad/s/sqrt(s), rad
COURSE = np.array([0.006, -0.003])  # error of the course by a unit Doppler error in E and N [rad]
HEADING_P = np.diag([1e-4, 4e-6, 1e-4])  # of heading [rad^2], gyro bias and scale at the fix


def start() -> Growth:
    growth = initial_growth(np.diag([1e-4, 2e-4]), [0.01, 0.02], 0.0)
    growth.covariance[5:8, 5:8] = HEADING_P
    return growth


def covariance_of(factor: np.ndarray) -> tuple[float, float, float]:
    q = factor @ factor.T
    return float(q[0, 0]), float(q[0, 1]), float(q[1, 1])


def heading_at(epoch: int) -> float:
    return 0.3 + 0.05 * epoch


def speed_at(epoch: int) -> float:
    return 10.0 + np.sin(0.2 * epoch)


def blank() -> Any:
    """Growth after a fix, in the kernel."""
    g = np.zeros(1, dk.GROWTH)[0]
    dk.reset(1e-4, 0.0, 2e-4, 0.01, 0.02, g)
    return g


def blank_step() -> Any:
    """An epoch without a turn, in the kernel."""
    step = np.zeros(1, dk.STEP)[0]
    step["dt_s"], step["phi_doppler"], step["phi_odometer"], step["white_doppler"] = DT, PHI_D, PHI_O, WHITE
    return step


def turn_at(epoch: int) -> float:
    return 0.05 if epoch % 20 < 12 else -0.08


def calibrates(epoch: int) -> bool:
    return epoch % 7 == 6


def heading_filter() -> Any:
    h = np.zeros(1, hk.HEADING)[0]
    h["p_hh"], h["p_bb"], h["p_ss"] = np.diag(HEADING_P)
    return h


def covariance_of_filter(h: Any) -> np.ndarray:
    rows = (("p_hh", "p_hb", "p_hs"), ("p_hb", "p_bb", "p_bs"), ("p_hs", "p_bs", "p_ss"))
    return np.array([[h[name] for name in row] for row in rows])


def step_of(epoch: int, h: Any, bias_walk: float = BIAS_WALK) -> tuple[Any, HeadingStep]:
    """What an epoch does to the error processes, in the kernel and in the reference; the filter advances."""
    step = blank_step()
    hk.expect_turn(turn_at(epoch), DT, ARW, 0.0, h, step["turn"])
    hk.predict_heading(turn_at(epoch), DT, ARW, bias_walk, h)
    gains = np.zeros(3)
    if calibrates(epoch):
        gains = hk.correct(0.0, 1.0, 0.0, COURSE_SIGMA**2, h)
        hk.observe(gains, False, 0.0, h, step["turn"])
        step["turn"]["course"][:] = COURSE
    hk.correlate(PHI_D, WHITE, h, step["turn"])
    correction = np.eye(3) - np.outer(gains, [1.0, 0.0, 0.0])
    course = np.outer(gains, COURSE)
    return step, HeadingStep(ARW**2 * DT, turn_at(epoch), DT, correction, course, covariance_of_filter(h))


def drive(sources: str, bias_walk: float = BIAS_WALK) -> tuple[Growth, Any]:
    """One letter for each epoch, d or o, in the reference and in the kernel.

    Without a walk of the bias the reference has the covariance of the heading errors themselves, not that of the
    filter, which bounds the course as white.
    """
    growth, g, before, h = start(), blank(), None, heading_filter()
    for epoch, source in enumerate(sources):
        step, heading = step_of(epoch, h, bias_walk)
        heading = heading if bias_walk else replace(heading, covariance=None)
        common = {"phi_doppler": PHI_D, "white": WHITE, "phi_odometer": PHI_O, "heading": heading}
        t, v = heading_at(epoch), speed_at(epoch)
        if source == "d":
            now = FACTOR * (1.0 + 0.1 * (epoch % 3))
            growth = doppler_step(growth, DT, before, now, bias_mps=0.004, **common)
            dk.step_doppler(step, *covariance_of(now), 0.004, g)
            before = now
        else:
            bias = 1e-3 + 1e-4 * epoch
            common["heading"] = replace(heading, axle_bias_rad=0.1 * turn_at(epoch))
            growth = odometer_step(
                growth, DT, v, t, sigma_mps=SIGMA_ODOMETER, bias_mps=0.01, heading_bias_rad=bias, **common
            )
            turn = np.sin(t), np.cos(t)
            step["axle_bias"] = 0.1 * turn_at(epoch)
            dk.step_odometer(step, v, *turn, SIGMA_ODOMETER, 0.01, bias, g)
            before = None
    return growth, g


def simulate(sources: str, draws: int) -> np.ndarray:
    """Position errors after the same epochs, drawn from the error processes.  (draws, 2) [m]."""
    rng = np.random.default_rng(7)
    error = rng.normal(size=(draws, 2)) * np.sqrt([1e-4, 2e-4])
    n, m, x = (
        rng.normal(size=(draws, 2)),
        rng.normal(size=draws),
        rng.normal(size=(draws, 3)) * np.sqrt(np.diag(HEADING_P)),
    )
    before: np.ndarray | None = None
    h, w = heading_filter(), np.zeros((draws, 2))
    for epoch, source in enumerate(sources):
        last_n, last_d = n + w, x[:, 0]
        _, heading = step_of(epoch, h, 0.0)
        n = PHI_D * n + np.sqrt(1.0 - PHI_D**2) * rng.normal(size=(draws, 2))
        w = np.sqrt(WHITE) * rng.normal(size=(draws, 2))
        m = PHI_O * m + np.sqrt(1.0 - PHI_O**2) * rng.normal(size=draws)
        x = x @ heading.transition.T
        x[:, 0] += ARW * np.sqrt(DT) * rng.normal(size=draws)
        d = x[:, 0]
        if calibrates(epoch):
            x = x @ heading.correction.T + (n + w) @ heading.course.T
        if source == "d":
            now = FACTOR * (1.0 + 0.1 * (epoch % 3))
            error = error + (
                DT * (n + w) @ now.T if before is None else 0.5 * DT * (last_n @ before.T + (n + w) @ now.T)
            )
            before = now
        else:
            t, v = heading_at(epoch), speed_at(epoch)
            along, across = np.array([np.sin(t), np.cos(t)]), np.array([np.cos(t), -np.sin(t)])
            error = error + DT * SIGMA_ODOMETER * m[:, None] * along + v * DT * 0.5 * (last_d + d)[:, None] * across
            before = None
    return np.asarray(error)


SOURCES = ["d" * 40, "o" * 40, "d" * 15 + "o" * 15 + "d" * 15, "od" * 12, "o" * 10 + "d" * 3 + "o" * 10]


@pytest.mark.parametrize("sources", SOURCES)
def test_kernel_equals_reference(sources: str) -> None:
    growth, g = drive(sources)
    c = growth.covariance
    expected = {
        "p_ee": c[0, 0], "p_en": c[0, 1], "p_nn": c[1, 1], "ne_e": c[0, 2], "ne_n": c[0, 3], "nn_e": c[1, 2],
        "nn_n": c[1, 3], "od_e": c[0, 4], "od_n": c[1, 4], "th_e": c[0, 5], "th_n": c[1, 5], "gb_e": c[0, 6],
        "gb_n": c[1, 6], "gs_e": c[0, 7], "gs_n": c[1, 7],
    }  # fmt: skip
    for name, value in expected.items():
        np.testing.assert_allclose(g[name], value, rtol=1e-10, atol=1e-15, err_msg=name)
    for variant in Variant:
        found = np.array(dk.sigma_and_bias(np.sin(1.1), np.cos(1.1), variant is Variant.PUBLISHED, g))
        np.testing.assert_allclose(found[2:], bias_track(growth, 1.1, variant), rtol=1e-12)
        config = RiskConfig(variant=variant)
        levels = missed_detection_factors(config, [1e-3, 1e-6]) * found[:2] + found[2:]
        np.testing.assert_allclose(levels, protection_levels(growth, 1.1, config, [1e-3, 1e-6]), rtol=1e-11)


def test_a_wrong_heading_shortens_the_path_by_no_more_than_its_bound() -> None:
    """Headings at K sigma + B in every epoch, on a path with a bend; at most twice the path."""
    g, step, k, bias, variance, angle = blank(), blank_step(), 4.0, 0.01, 0.03**2, 0.0
    short, error = np.zeros(2), k * 0.03 + bias
    for epoch in range(200):
        step["turn"]["mean_variance"] = variance
        angle = 0.3 if epoch < 100 else 0.3 + np.pi / 2.0
        dk.step_odometer(step, 10.0, np.sin(angle), np.cos(angle), SIGMA_ODOMETER, 0.0, bias, g)
        short += 10.0 * DT * (1.0 - np.cos(error)) * np.array([np.sin(angle), np.cos(angle)])
    for sine, cosine in ((np.sin(angle), np.cos(angle)), (np.cos(angle), -np.sin(angle))):
        bound = dk.shortened(sine, cosine, k, g)
        path = abs(sine) * g["run_e"] + abs(cosine) * g["run_n"]
        assert bound == pytest.approx(0.5 * error**2 * path)
        assert bound >= abs(sine * short[0] + cosine * short[1])
        assert dk.shortened(sine, cosine, 1e3, g) == pytest.approx(2.0 * path)
        assert dk.shortened(sine, cosine, np.inf, g) == pytest.approx(2.0 * path)


@pytest.mark.parametrize("sources", SOURCES)
def test_covariance_is_that_of_simulated_errors(sources: str) -> None:
    """Variances of 40,000 whitened errors in both directions; fails by chance once in 1000 runs for each case."""
    draws = 40_000
    white = np.linalg.solve(
        np.linalg.cholesky(drive(sources, 0.0)[0].position_covariance_m2), simulate(sources, draws).T
    )
    low, high = chi2.ppf([2.5e-4, 1.0 - 2.5e-4], df=draws)
    assert ((low < (white**2).sum(-1)) & ((white**2).sum(-1) < high)).all()
    assert abs(np.corrcoef(white)[0, 1]) < norm.isf(2.5e-4) / np.sqrt(draws)


def gauss_markov_variance(time_s: float, sigma: float, tau_s: float) -> float:
    """Variance of an integrated Gauss-Markov error, ``2 s^2 tau (T - tau (1 - exp(-T/tau)))``."""
    return float(2.0 * sigma**2 * tau_s * (time_s + tau_s * np.expm1(-time_s / tau_s)))


def test_gauss_markov_growth_has_its_closed_form() -> None:
    """Fine steps tend to 2 s^2 tau (T - tau (1 - exp(-T/tau))); trapezoids of 10 ms are within 0.1 %."""
    growth, step, tau = initial_growth(np.zeros((2, 2)), [0.0, 0.0], 0.0), 0.01, 0.54
    factor = 0.1 * np.eye(2)
    for epoch in range(501):  # the first epoch only provides the first velocity
        growth = doppler_step(
            growth, step if epoch else 0.0, factor if epoch else None, factor, phi_doppler=float(np.exp(-step / tau))
        )
    expected = gauss_markov_variance(5.0, 0.1, tau)
    np.testing.assert_allclose(np.diag(growth.position_covariance_m2), expected, rtol=1e-3)


def test_limits_of_the_closed_form() -> None:
    """A short time keeps the velocity error (s T)^2, a long one is a random walk of 2 s^2 tau T."""
    assert gauss_markov_variance(1e-3, 0.1, 10.0) == pytest.approx((0.1 * 1e-3) ** 2, rel=1e-4)
    assert gauss_markov_variance(1e5, 0.1, 0.5) == pytest.approx(2 * 0.01 * 0.5 * 1e5, rel=1e-4)


def test_white_limit_and_the_published_half() -> None:
    """White velocities: dt^2 s^2 for each inner sample; S1 eq 21 gives half of that."""
    grown = {}
    for variant in Variant:
        growth = initial_growth(np.zeros((2, 2)), [0.0, 0.0], 0.0)
        for epoch in range(201):
            previous = 0.1 * np.eye(2) if epoch else None
            growth = doppler_step(growth, DT if epoch else 0.0, previous, 0.1 * np.eye(2), variant=variant)
        grown[variant] = growth.position_covariance_m2[0, 0]
    assert grown[Variant.EXACT] == pytest.approx(DT**2 * 0.01 * 199.5, rel=1e-12)
    assert grown[Variant.PUBLISHED] == pytest.approx(DT**2 * 0.01 * 100, rel=1e-12)


def test_constant_heading_error_is_a_lever() -> None:
    """Straight drive with a heading error of 1 degree: CT error is distance times the angle, AT none."""
    growth = initial_growth(np.zeros((2, 2)), [0.0, 0.0], np.radians(1.0) ** 2)
    for _ in range(40):
        growth = odometer_step(growth, DT, 10.0, 0.8, sigma_mps=0.0)
    levels = protection_levels(growth, 0.8, RiskConfig(integrity_risk=2e-3), None)[0]
    assert levels[1] == pytest.approx(norm.isf(0.5e-3) * 40.0 * np.radians(1.0), rel=1e-9)
    assert levels[0] == pytest.approx(0.0, abs=1e-6)


def test_bias_of_a_closed_loop_cancels_only_where_it_must() -> None:
    """Round a full circle a constant heading bias brings the position back; an accumulated magnitude would not."""
    growth = initial_growth(np.zeros((2, 2)), [0.0, 0.0], 0.0)
    steps = 400
    for i in range(steps):
        turn = 2.0 * np.pi * i / steps
        growth = odometer_step(growth, DT, 10.0, turn, sigma_mps=0.0, bias_mps=0.02, heading_bias_rad=0.01)
        if i == steps // 2 - 1:
            diameter = 2.0 * 10.0 * DT * steps / (2.0 * np.pi)
            assert np.hypot(*growth.by_heading_m) == pytest.approx(0.01 * diameter, rel=1e-3)
    assert np.abs(bias_track(growth, 0.0)).max() < 1e-9


def test_exact_bias_turns_with_the_vehicle_and_published_does_not() -> None:
    exact, published = [], []
    for turn in (0.0, np.pi / 4, 1.0):
        growth = initial_growth(np.zeros((2, 2)), [0.0, 0.0], 0.0)
        for _ in range(30):
            growth = odometer_step(growth, DT, 8.0, turn, sigma_mps=0.0, bias_mps=0.02, heading_bias_rad=0.01)
        exact.append(bias_track(growth, turn))
        published.append(bias_track(growth, turn, Variant.PUBLISHED))
    np.testing.assert_allclose(exact, [[0.06, 0.24]] * 3, rtol=1e-9)
    assert np.ptp(published, axis=0).min() > 0.01


def test_a_stop_freezes_the_error_and_a_fix_clears_it() -> None:
    _, g = drive("d" * 10 + "o" * 10)
    before = g.copy()
    h = heading_filter()
    step = blank_step()
    hk.observe(hk.correct(0.0, 0.0, 1.0, 1e-6, h), True, 0.0, h, step["turn"])
    dk.step_still(step, g)
    for name in ("p_ee", "p_en", "p_nn", "cth_e", "cth_n", "cv_e", "cv_n", "box_e", "box_n"):
        assert g[name] == before[name]
    for name in ("ne_e", "gb_e", "gb_n"):
        assert abs(g[name]) < abs(before[name])
    dk.reset(1e-4, 0.0, 2e-4, 0.01, 0.02, g)
    assert g == blank()


def test_published_levels_by_hand() -> None:
    """S1 eq 18: K_md = Qinv(risk) unsplit, bias by the signed sum."""
    growth = Growth(
        np.diag([0.04, 0.09, 1.0, 1.0, 1.0, *np.zeros(5)]), np.zeros(2), np.array([0.3, 0.4]), *np.zeros((2, 2))
    )
    levels = protection_levels(growth, np.pi / 6, RiskConfig(variant=Variant.PUBLISHED), [1e-5])[0]
    sine, cosine = 0.5, np.sqrt(0.75)
    k = norm.isf(1e-5)
    assert levels[0] == pytest.approx(k * np.hypot(0.2 * sine, 0.3 * cosine) + np.hypot(0.3 * sine, 0.4 * cosine))
    assert levels[1] == pytest.approx(k * np.hypot(0.2 * cosine, 0.3 * sine) + np.hypot(0.3 * cosine, 0.4 * sine))


def test_no_risk_left_gives_no_level() -> None:
    assert np.isinf(protection_levels(start(), 0.0, RiskConfig(unmonitored_risk=1e-4), [1e-5])).all()


@pytest.mark.parametrize("sources", SOURCES)
def test_the_filters_covariance_bounds_the_position_after_correlated_courses(sources: str) -> None:
    """The white error that bounds a course gives the larger position covariance, whatever moves the position."""
    h = heading_filter()
    exact = inflated = start()
    for epoch, source in enumerate(sources):
        _, heading = step_of(epoch, h, 0.0)
        step = {"phi_doppler": PHI_D, "white": WHITE, "phi_odometer": PHI_O}
        exact, inflated = (
            doppler_step(growth, DT, None, FACTOR, heading=way, **step)
            if source == "d"
            else odometer_step(growth, DT, 10.0, 0.3, sigma_mps=0.05, heading=way, **step)
            for growth, way in ((exact, replace(heading, covariance=None)), (inflated, heading))
        )
    more = inflated.position_covariance_m2 - exact.position_covariance_m2
    assert np.linalg.eigvalsh(more).min() > -1e-12
    assert sources[0] == "d" or np.trace(more) > 0.0


@settings(max_examples=25, deadline=None)
@given(
    sources=st.text(alphabet="do", min_size=1, max_size=40),
    heading=st.floats(-10.0, 10.0),
    risk=st.floats(1e-9, 0.5),
)
def test_levels_are_finite_and_cover_the_bias(sources: str, heading: float, risk: float) -> None:
    growth, g = drive(sources)
    level = protection_levels(growth, heading, RiskConfig(), [risk])[0]
    assert np.isfinite(level).all()
    assert (level >= bias_track(growth, heading) - 1e-12).all()
    assert np.linalg.eigvalsh(growth.covariance).min() > -1e-12
    assert all(np.isfinite(g[name]) for name in dk.GROWTH.names)
