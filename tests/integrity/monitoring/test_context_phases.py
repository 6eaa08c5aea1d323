"""The three phases of the context-aware monitor: hand-worked values, oracles, rates."""

import numpy as np
import pytest
from code_rows import code_rows, sky_design, solve_rows
from scipy.stats import binom, chi2, ncx2, norm

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.context.map_phase import MapPhase, MapPhaseConfig
from lanebound.integrity.monitoring.context.position_phase import PositionPhaseConfig, check_position, raim_threshold
from lanebound.integrity.monitoring.context.speed_phase import (
    SpeedForm,
    SpeedPhase,
    SpeedPhaseConfig,
    interval_mean,
    mase,
    trend_error,
)
from lanebound.integrity.positioning.code_solution import solve_ranges
from lanebound.integrity.positioning.map_matching.matching import MapMatches

SDOP = [0.12, 0.15, 0.11, 0.2, 0.18, 0.14, 0.13, 0.16, 0.19, 0.17, 0.15]  # eleven samples, N = 10


# Position


def test_thresholds_are_those_of_the_published_table() -> None:
    """L3NAV gps_example_11: sqrt of the chi-square for P_FA = 1/15000."""
    table = {1: 3.98792, 2: 4.38539, 4: 4.93879, 8: 5.72792, 16: 6.86}
    found = raim_threshold(np.array(list(table)), 6.666667e-5)
    np.testing.assert_allclose(found, list(table.values()), atol=1e-4)
    assert np.isinf(raim_threshold(np.array([0]), 1e-3)[0])


def test_the_level_is_that_of_walter_and_enge() -> None:
    rng = np.random.default_rng(1)
    g, sigma = sky_design(7, rng), rng.uniform(0.5, 3.0, 7)
    w, y = np.diag(sigma**-2), sigma * rng.standard_normal(7)
    k = np.linalg.inv(g.T @ w @ g) @ g.T @ w
    p = g @ k
    slope = sigma * np.hypot(k[0], k[1]) / np.sqrt(1.0 - np.diag(p))
    q = np.linalg.inv(g.T @ w @ g)
    # k(P_MD) is two-sided: the error of a normal law has no preferred side
    level = slope.max() * np.sqrt(chi2.isf(1e-3, 3)) + norm.isf(0.5e-5) * np.sqrt(q[0, 0] + q[1, 1])
    wsse = y @ w @ (np.eye(7) - p) @ y
    found = check_position(solve_rows(g[None], y[None], sigma[None] ** -2), PositionPhaseConfig())
    assert found.level_m[0] == pytest.approx(level, rel=1e-9)
    assert found.statistic[0] == pytest.approx(np.sqrt(wsse), rel=1e-9)
    assert found.threshold[0] == pytest.approx(np.sqrt(chi2.isf(1e-3, 3)))
    printed = check_position(solve_rows(g[None], y[None], sigma[None] ** -2), PositionPhaseConfig(printed_slope=True))
    assert printed.level_m[0] != pytest.approx(level)


def test_the_residual_test_raises_its_allocated_false_alarms() -> None:
    """20,000 fault-free positions; an interval that fails by chance in 1 of 1,000 runs."""
    runs = 20_000
    rows = code_rows(np.zeros((runs, 2)), 2.0, np.random.default_rng(2))
    alarms = int((~check_position(rows, PositionPhaseConfig(false_alarm=0.01)).consistent).sum())
    low, high = binom.ppf([5e-4, 1 - 5e-4], runs, 0.01)
    assert low <= alarms <= high


@pytest.mark.parametrize("bias_m", [20.0, 30.0, 45.0])
def test_an_undetected_fault_stays_within_the_level(bias_m) -> None:
    """The level adds the worst undetected bias and K sigma: fewer than 1 of 1,000 faulty positions lie beyond it."""
    runs, rng = 20_000, np.random.default_rng(3)
    g = np.broadcast_to(sky_design(8, rng), (runs, 8, 4))
    y = 2.0 * rng.standard_normal((runs, 8))
    clean = solve_rows(g[:1], y[:1], np.full((1, 8), 0.25))
    unseen = clean.redundancy[0]
    worst = int(np.argmax(clean.slopes()[0]))
    y[:, worst] += bias_m
    rows = solve_rows(g, y, np.full((runs, 8), 0.25))
    found = check_position(rows, PositionPhaseConfig())
    misleading = found.consistent & (np.hypot(*rows.x_m[:, :2].T) > found.level_m)
    assert misleading.mean() < 1e-3
    missed = ncx2.cdf(chi2.isf(1e-3, 4), 4, bias_m**2 * unseen[worst] / 4.0)
    low, high = binom.ppf([5e-4, 1 - 5e-4], runs, missed)
    assert low <= found.consistent.sum() <= high


def test_too_few_satellites_have_no_level() -> None:
    rng = np.random.default_rng(4)
    for satellites, solved in ((3, False), (4, True)):
        rows = code_rows(np.zeros((1, 2)), 1.0, rng, satellites)
        found = check_position(rows, PositionPhaseConfig())
        assert bool(rows.solved[0]) is solved
        assert np.isinf(found.level_m[0])
        assert not found.passed[0]


def test_a_geometry_that_determines_no_position_is_not_solved() -> None:
    design = np.tile(sky_design(6, np.random.default_rng(6))[:1], (6, 1))[None]  # six times one satellite
    both = np.concatenate([design, sky_design(6, np.random.default_rng(6))[None]])
    rows = solve_rows(both, np.zeros((2, 6)), np.ones((2, 6)))
    assert rows.solved.tolist() == [False, True]
    assert (rows.x_m[0] == 0.0).all()
    g = both[1]
    np.testing.assert_allclose(rows.cofactor[1], np.linalg.inv(g.T @ g)[:3, :3], rtol=1e-9)


def test_rows_without_weight_do_not_count() -> None:
    rng = np.random.default_rng(5)
    g, y, weight = sky_design(9, rng)[None], rng.standard_normal((1, 9)), np.ones((1, 9))
    weight[0, [2, 6]] = 0.0
    kept = weight[0] > 0.0
    found = check_position(solve_rows(g, y + 1e3 * (weight == 0.0), weight), PositionPhaseConfig())
    alone = check_position(solve_rows(g[:, kept], y[:, kept], weight[:, kept]), PositionPhaseConfig())
    np.testing.assert_allclose([v[0] for v in found[:3]], [v[0] for v in alone[:3]], rtol=1e-9)


# Speed


def test_mase_of_the_hand_worked_example() -> None:
    """Derived from S5 equations 5 and 6: 1.70 / 10 - (0.12 + 0.15) / 20."""
    assert mase(SDOP) == pytest.approx(0.1565, abs=1e-12)
    assert mase(SDOP) / np.sqrt(10) == pytest.approx(0.049489645381635125, abs=1e-12)
    assert interval_mean([3.0, 5.0]) == 4.0
    assert interval_mean(np.full(11, 7.0)) == pytest.approx(7.0)
    with pytest.raises(InputError, match="two samples"):
        interval_mean([1.0])


def test_the_standard_error_has_no_trend_and_is_that_of_the_mean() -> None:
    n = np.arange(11.0)
    assert trend_error(20.0 - 1.5 * n) == pytest.approx(0.0, abs=1e-12)
    noisy = 20.0 + 0.5 * n + 0.3 * np.random.default_rng(1).standard_normal((50_000, 11))
    mean_of_squares = np.square(trend_error(noisy)).mean()
    assert mean_of_squares == pytest.approx(0.3**2 / 10, rel=0.01)


def drive(form: SpeedForm, doppler, wheels, sigma: float = 0.05, runs: int = 2000):
    """Test after 11 epochs of the speeds (11,), Doppler with white noise."""
    phase, rng = SpeedPhase(SpeedPhaseConfig(form=form), runs), np.random.default_rng(6)
    covariance = np.broadcast_to(sigma**2 * np.eye(2), (runs, 2, 2))
    for speed, wheel in zip(doppler, wheels, strict=True):
        velocity = np.array([0.0, speed]) + sigma * rng.standard_normal((runs, 2))
        found = phase.step(velocity, covariance, np.full(runs, wheel), np.ones(runs, bool))
    return found


def over_the_epoch(speeds):
    """Mean of each interval, as wheels give it; the first is of the epoch before."""
    return np.concatenate([speeds[:1], 0.5 * (speeds[1:] + speeds[:-1])])


STEADY = np.full(11, 12.0)
BRAKING = np.concatenate([np.full(5, 12.0), 12.0 - 1.8 * np.arange(1, 7)])
FALSE_ALARMS = {  # share of windows that fail without a fault, steady and with uneven braking
    SpeedForm.PRINTED: (0.0, 0.0),
    SpeedForm.TREND: (0.002, 1.0),
    SpeedForm.WHEEL: (0.002, 0.002),
}


@pytest.mark.parametrize("form", list(SpeedForm))
def test_false_alarms_of_the_speed_phase(form) -> None:
    for speeds, expected in zip((STEADY, BRAKING), FALSE_ALARMS[form], strict=True):
        found = drive(form, speeds, over_the_epoch(speeds))
        assert found.known.all()
        alarms = 1.0 - found.consistent.mean()
        assert alarms == 1.0 if expected == 1.0 else alarms <= expected


@pytest.mark.parametrize(
    ("doppler", "wheels"),
    [
        pytest.param(STEADY + 1.0, STEADY, id="Doppler of a spoofer, 1 m/s too fast"),
        pytest.param(STEADY, 1.15 * STEADY, id="wheels that slip by 15 %"),
        pytest.param(12.0 - 0.5 * np.arange(11), STEADY, id="frozen wheels while braking gently"),
    ],
)
def test_only_the_comparison_with_the_wheels_sees_steady_faults(doppler, wheels) -> None:
    assert drive(SpeedForm.WHEEL, doppler, wheels).consistent.mean() < 0.01
    for blind in (SpeedForm.PRINTED, SpeedForm.TREND):
        assert drive(blind, doppler, wheels).consistent.mean() > 0.99


def test_slow_vehicles_and_short_histories_have_no_speed() -> None:
    assert not drive(SpeedForm.PRINTED, np.full(11, 1.5), np.full(11, 1.5), runs=3).moving.any()
    found = drive(SpeedForm.PRINTED, STEADY[:10], STEADY[:10], runs=3)
    assert not found.known.any()
    assert not found.passed.any()
    short = SpeedPhase(SpeedPhaseConfig(form="printed", intervals=8), 1)  # below nine the printed test cannot hold
    for _ in range(9):
        eight = short.step(np.array([[0.0, 9.0]]), 0.01 * np.eye(2)[None], np.array([9.0]), np.array([True]))
    assert eight.known[0]
    assert not eight.consistent[0]


def test_an_epoch_without_doppler_begins_the_average_anew() -> None:
    phase, one = SpeedPhase(SpeedPhaseConfig(), 2), np.ones(2)
    for k in range(12):
        known = np.array([True, k != 11])
        found = phase.step(np.array([[9.0, 0.0]] * 2), 0.01 * np.broadcast_to(np.eye(2), (2, 2, 2)), 9.0 * one, known)
    assert found.known.tolist() == [True, False]


# Map


def match_at(foot, heading_rad: float = 0.0, link: int = 0) -> MapMatches:
    one = np.zeros(1)
    return MapMatches(np.array([link]), one, one, np.array([foot], float), one + heading_rad, one + 1.0)


def test_differences_of_distance_and_speed_are_hand_worked() -> None:
    """Three epochs: matched 2 x 10 m, measured a zig-zag of 2 x sqrt(10^2 + 3^2)."""
    phase = MapPhase(MapPhaseConfig(), 1)
    for k, aside in enumerate((0.0, 3.0, 0.0)):
        found = phase.step(
            match_at([0.0, 10.0 * k]), np.array([[aside, 10.0 * k]]), np.ones(1), np.array([0.1]), np.array([9.0]), 1.0
        )
    assert found.distance_m[0] == pytest.approx(2.0 * np.sqrt(109.0) - 20.0)
    assert found.speed_mps[0] == pytest.approx(1.0)
    assert found.heading_deg[0] == pytest.approx(np.rad2deg(0.1))
    assert found.score[0] == 100.0
    printed = MapPhase(MapPhaseConfig(printed_allowance=True, map_sigma_m=5.0), 1)
    for k in range(3):
        at = printed.step(
            match_at([0.0, 10.0 * k]), np.array([[0.0, 10.0 * k]]), np.ones(1), *np.array([[0.0], [10.0]]), 1.0
        )
    assert at.distance_m[0] == pytest.approx(2 * (1.0 + 5.0))


def test_a_link_against_the_motion_and_a_missing_link_fail() -> None:
    phase = MapPhase(MapPhaseConfig(), 1)
    zero = np.zeros(1)
    against = phase.step(match_at([0, 0], heading_rad=np.pi), np.zeros((1, 2)), zero + 1, zero, zero, 1.0)
    assert against.score[0] <= 40.0
    assert not against.passed[0]
    none = phase.step(MapMatches.none(1), np.zeros((1, 2)), zero + 1, zero, zero, 1.0)
    assert none.score[0] == 0.0
    assert not none.passed[0]


def test_sums_cover_the_last_n_epochs_alone() -> None:
    phase = MapPhase(MapPhaseConfig(intervals=4), 1)
    for k in range(12):
        foot = [0.0, 10.0 * k + (50.0 if k >= 5 else 0.0)]  # one jump along the link, between epochs 4 and 5
        found = phase.step(match_at(foot), np.array([[0.0, 10.0 * k]]), np.ones(1), *np.array([[0.0], [10.0]]), 1.0)
        assert found.distance_m[0] == pytest.approx(50.0 if 5 <= k <= 8 else 0.0)


def test_the_printed_level_is_that_of_codes_with_errors_of_one_metre() -> None:
    """Equal deviations of 1 m make the printed slope and the plain HDOP those of Walter and Enge; of 3 m a third."""
    rng = np.random.default_rng(4)
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi, (5, 12)), rng.uniform(0.2, 1.5, (5, 12))
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    system = np.arange(12) % 2
    metre, three = (
        solve_ranges(los, np.zeros((5, 12)), sigma**2, np.ones((5, 12), bool), system) for sigma in (1.0, 3.0)
    )
    own = check_position(metre, PositionPhaseConfig()).level_m
    printed = check_position(three, PositionPhaseConfig(printed_slope=True), metre.hdop_m).level_m
    np.testing.assert_allclose(printed, own, rtol=1e-9)
    np.testing.assert_allclose(check_position(three, PositionPhaseConfig()).level_m, 3.0 * own, rtol=1e-9)
