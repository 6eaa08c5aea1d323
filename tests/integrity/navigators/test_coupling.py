"""Coupling of code services with dead reckoning: its bounds against brute force, and drives."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom
from signal_records import records_of

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import GROWTH
from lanebound.integrity.monitoring.doppler_separation_kernel import SEPARATION
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.services.config import CodeServiceConfig, CouplingConfig
from lanebound.integrity.navigators.services.coupling import coupling_rules
from lanebound.integrity.navigators.services.coupling_kernel import fault_bound, rotated, shares_of, transform
from lanebound.integrity.navigators.services.coupling_records_kernel import Part
from lanebound.integrity.navigators.services.tight_kernel import (
    AIDED_RANGE,
    Aided,
    gain_of,
    share_of_ranges,
    solve_aided,
)
from lanebound.integrity.positioning.modes import Mode

Array = NDArray[np.float64]


@pytest.mark.parametrize("smoothing_s", [0.0, 100.0])
def test_a_white_error_bounds_errors_of_any_shorter_correlation_at_any_spacing(smoothing_s: float) -> None:
    """Largest eigenvalue of correlation matrices of epochs at least ``interval`` apart."""
    declared = CodeServiceConfig(smoothing_s=smoothing_s)
    white = float(coupling_rules(CouplingConfig(kind="loose"), declared, 0.1)["white"][0])
    rng, tau = np.random.default_rng(1), declared.errors.multipath_tau_s
    for _ in range(20):
        t = np.cumsum(1.0 + rng.exponential(0.5, 300) * rng.integers(0, 2))
        lag = np.abs(t[:, None] - t)
        own = np.exp(-lag / (tau * rng.uniform(0.05, 1.0)))
        if smoothing_s:  # a mean of that error over an exponential window
            own = (smoothing_s * np.exp(-lag / smoothing_s) - tau * np.exp(-lag / tau)) / (smoothing_s - tau)
        assert np.linalg.eigvalsh(own)[-1] <= white
    assert white < 1.0 + 2.2 * (tau + smoothing_s)


def test_faults_of_all_epochs_stay_within_the_mean_of_their_bounds_at_the_risk() -> None:
    """Observed separations ``d = F + N`` of epochs that depend wholly on each other: the same fault in all of them.

    A quarter of the risk is that of modes that this test has not. Failing by chance: once in 10,000 for each size.
    """
    rng, epochs, runs, risk = np.random.default_rng(2), 6, 3000, 0.04
    prior, sigma = np.array([0.0, 0.05, 0.02, 0.004]), np.array([0.0, 0.6, 1.0, 2.0])
    for size in (0.3, 1.0, 3.0, 30.0):
        weight = rng.dirichlet(np.ones(epochs))
        mode = rng.choice(4, size=runs, p=[1.0 - prior.sum(), *prior[1:]])
        noise, moved, bound = rng.standard_normal((runs, 4)), np.zeros(runs), np.zeros(runs)
        for k in range(epochs):
            own = noise if k % 2 else rng.standard_normal((runs, 4))  # some epochs have the same noise, too
            d = sigma * own
            d[np.arange(runs), mode] += np.where(mode > 0, size, 0.0)
            moved += weight[k] * np.where(mode > 0, size, 0.0)
            bound += weight[k] * np.array([fault_bound(4, prior, row, sigma, risk, 0.0, 1.0) for row in d])
        assert (moved > bound).sum() <= binom.isf(1e-4, runs, risk), size
    few = np.array([fault_bound(4, prior, row, 0.1 * sigma, risk, 0.0, 1.0) for row in np.zeros((1, 4))])
    assert few[0] < 1.0  # nothing is seen and separations are sure: the bound is small


def test_faults_that_no_mode_covers_leave_no_bound_when_a_mean_remembers_them_too_often() -> None:
    one = np.array([1e-6]), np.array([0.1]), np.array([0.5])
    assert fault_bound(1, *one, 1e-5, 1e-7, 10.0) < np.inf
    assert fault_bound(1, *one, 1e-5, 1e-6, 10.0) == np.inf
    bounds = [fault_bound(1, np.array([p]), one[1], one[2], 1e-5, 0.0, 1.0) for p in (1e-8, 1e-6, 1e-4, 1e-2)]
    assert all(a <= b for a, b in pairwise(bounds))


def test_the_sum_of_two_errors_is_bounded_whatever_their_correlation() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        x, y = rng.normal(size=(2, 2, 2))
        p, q = x @ x.T, y @ y.T
        one, other = shares_of(np.trace(p), np.trace(q))
        turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
        cross = x @ turn @ y.T  # the largest correlation
        total = p + q + cross + cross.T
        assert np.linalg.eigvalsh(one * p + other * q - total)[0] > -1e-9


def test_what_remains_of_dead_reckoning_is_transformed_as_its_error() -> None:
    rng = np.random.default_rng(4)
    a = rng.normal(size=(2, 2))
    g, names = np.zeros(1, GROWTH), [name for name in GROWTH.names if GROWTH[name].kind == "f"]
    for name in names:
        g[name] = rng.normal()
    before = g.copy()
    s = np.zeros(8, SEPARATION)
    for name in SEPARATION.names:
        s[name] = rng.normal(size=8)
    d, ee, en, nn = np.array([s["d_e"], s["d_n"]]), *(s[name].copy() for name in ("s_ee", "s_en", "s_nn"))
    transform(a, g[0], s)
    for east, north in (("th_e", "th_n"), ("od_e", "od_n"), ("cth_e", "cth_n"), ("ne_e", "nn_e"), ("fs_e", "fs_n")):
        np.testing.assert_allclose([g[east][0], g[north][0]], a @ [before[east][0], before[north][0]])
    np.testing.assert_allclose([g["box_e"][0], g["box_n"][0]], np.abs(a) @ [before["box_e"][0], before["box_n"][0]])
    np.testing.assert_allclose([s["d_e"], s["d_n"]], a @ d)
    for k in range(8):
        p = a @ np.array([[ee[k], en[k]], [en[k], nn[k]]]) @ a.T
        np.testing.assert_allclose(rotated(a, ee[k], en[k], nn[k]), (p[0, 0], p[0, 1], p[1, 1]))
        np.testing.assert_allclose((s["s_ee"][k], s["s_en"][k], s["s_nn"][k]), (p[0, 0], p[0, 1], p[1, 1]))
    unchanged = {"p_ee", "p_en", "p_nn", "l_ee", "l_ne", "l_nn", "have_l"}
    assert all(g[name][0] == before[name][0] for name in unchanged)


def _aided(n: int, seed: int = 5) -> Aided:
    """Ranges of two systems and a position that is known to metres."""
    rng = np.random.default_rng(seed)
    los = rng.normal(size=(n, 3))
    los[:, 2] = np.abs(los[:, 2])
    los /= np.linalg.norm(los, axis=1, keepdims=True)
    fast, slow = rng.uniform(0.5, 2.0, (2, n))
    prior = np.linalg.inv(np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 2.0]]))
    ranges = records_of(
        AIDED_RANGE, n, e=los, group=np.arange(n) % 2, y=rng.normal(size=n), weight=1.0 / (21.0 * fast + 2.0 * slow),
        fast=fast, slow=slow, odds=1e-5,
    )  # fmt: skip
    return Aided(ranges, prior, np.zeros((3, 3)), np.zeros(3))


@pytest.mark.parametrize("n", [2, 3, 4, 9])
def test_ranges_of_any_number_correct_the_position_as_least_squares_with_a_prior_do(n: int) -> None:
    """Clocks as unknowns of the dense form; gains by unit errors of one range after another."""
    aided = _aided(n)
    removed = np.zeros(n, bool)
    assert solve_aided(removed, aided)
    shift, inverse = aided.shift.copy(), aided.inverse.copy()
    ranges = aided.ranges
    design = np.hstack([-ranges["e"], np.eye(2)[ranges["group"]]])
    normal = design.T @ (ranges["weight"][:, None] * design)
    normal[:3, :3] += aided.prior
    dense = np.linalg.inv(normal)
    np.testing.assert_allclose(inverse, dense[:3, :3], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(shift, (dense @ design.T @ (ranges["weight"] * ranges["y"]))[:3], rtol=1e-8, atol=1e-10)
    part, a = Part(np.zeros(3), np.zeros(3), np.zeros((1, 2))), np.zeros((2, 2))
    share_of_ranges(aided, 1.0, part, a)
    gains = dense[:2] @ design.T * ranges["weight"]
    np.testing.assert_allclose([gain_of(i, aided) for i in range(n)], gains.T, rtol=1e-8, atol=1e-10)
    fast = gains @ np.diag(ranges["fast"]) @ gains.T
    np.testing.assert_allclose(part.fast, (fast[0, 0], fast[0, 1], fast[1, 1]), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(a, (dense[:3, :3] @ aided.prior)[:2, :2], rtol=1e-8, atol=1e-10)
    removed[0] = True
    assert solve_aided(removed, aided)
    less = np.linalg.eigvalsh(aided.inverse - inverse)
    assert less[0] > -1e-9  # a solution without a range is no surer
    if n == 2:  # two ranges of two systems say nothing: each clock takes its own
        np.testing.assert_allclose(shift, 0.0, atol=1e-12)


def _drive(config: NavigatorConfig, batch: int, epochs: int) -> tuple[Array, Array, NDArray[np.int64]]:
    """Drive North-East at 10 m/s under an open sky: errors and levels (K, B, 2) along and across, modes (K, B)."""
    navigator = Navigator.nominal(config, seeds=list(range(batch)), duration_s=0.1 * epochs + 60.0)
    heading, dt = np.full(batch, 0.25 * np.pi), config.dt_s
    velocity = np.tile([10.0 * np.sqrt(0.5), 10.0 * np.sqrt(0.5)], (batch, 1))
    position = np.zeros((batch, 2))
    navigator.place(position, heading, 30.0, 0.01)
    errors, levels, modes = [], [], []
    for k in range(epochs):
        before, position = position, position + dt * velocity
        truth = truth_between((k + 1) * dt, dt, (before, position), (velocity, velocity), (heading, heading))
        s = navigator.step(truth)
        d = s.position_en_m - position
        errors.append(np.stack([d[:, 0] + d[:, 1], d[:, 0] - d[:, 1]], -1) * np.sqrt(0.5))
        levels.append(np.stack([s.pl_at_m, s.pl_ct_m], -1))
        modes.append(s.mode)
    return np.array(errors), np.array(levels), np.array(modes)


@pytest.mark.parametrize("kind", ["loose", "tight"])
def test_a_coupled_position_is_better_and_its_levels_hold(kind: str) -> None:
    base: dict[str, Any] = {"service": "dgps"}
    config = NavigatorConfig(**base)
    alone, coupled = (_drive(c, 24, 400) for c in (config, config.replace(services={"coupling": kind})))
    assert (np.abs(coupled[0]) <= coupled[1]).all()
    rms = [float(np.sqrt(np.mean(np.square(run[0][200:])))) for run in (alone, coupled)]
    level = [float(np.median(run[1][200:])) for run in (alone, coupled)]
    assert rms[1] < 0.95 * rms[0]
    assert level[1] < level[0]
    assert (coupled[2][50:] == int(Mode.DGPS)).mean() > 0.3


def test_a_vehicle_that_is_placed_anew_holds_no_code_errors() -> None:
    config = NavigatorConfig(service="dgps", services={"coupling": "loose"})
    navigator = Navigator.nominal(config, seeds=[1, 2], duration_s=30.0)
    zero, velocity, heading = np.zeros((2, 2)), np.tile([0.0, 10.0], (2, 1)), np.zeros(2)
    navigator.place(zero, heading, 30.0, 0.01)
    position = zero
    for k in range(30):
        before, position = position, position + 0.1 * velocity
        navigator.step(truth_between(0.1 * (k + 1), 0.1, (before, position), (velocity, velocity), (heading, heading)))
    assert navigator.state.extensions["coupling"]["active"].all()
    navigator.place_rows(np.array([1]), zero[:1], heading[:1], 1.0, 0.01)
    assert navigator.state.extensions["coupling"]["active"].tolist() == [True, False]


def test_couplings_that_would_not_hold_are_refused() -> None:
    assert NavigatorConfig(service="spp", services={"coupling": "tight"}).services.coupling.kind == "tight"
    with pytest.raises(ConfigError, match="smoothing_s must be <= 300"):
        NavigatorConfig.preset("services/ppp").replace(services={"coupling": "loose"})
    with pytest.raises(ConfigError, match="risk_share must be <= 0"):
        NavigatorConfig(service="spp", services={"coupling": "loose", "spp": {"risk_share": 1.0}})
    with pytest.raises(ConfigError, match="coupling"):
        NavigatorConfig(service="spp", services={"coupling": "close"})
