"""Protection levels: the published ARAIM example, the kernels against the plain form, and what the levels promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_closed_form import missed_detection_factor, plain_levels
from scipy.stats import binom, norm

from fault_rows import constellation_modes
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring import protection_kernel as pk
from lanebound.integrity.monitoring.protection import (
    closed_form_published,
    multi_hypothesis,
    protection_levels,
    protection_levels_batch,
    tail_sum,
)
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, false_alarm_factor, multiple_fault_risk
from lanebound.integrity.monitoring.separation import Separation, separate
from lanebound.integrity.monitoring.separation_kernel import (
    find_modes,
    mode_scratch,
    moment_scratch,
    set_factors,
    set_priors,
)
from lanebound.integrity.positioning import geometry_kernel as gk
from lanebound.integrity.positioning.least_squares import design_matrix

PRIORS = (1e-5, 1e-6, 1e-5, 3e-5, 1e-5)
RISKS = np.array([1e-2, 1e-3, 1e-5, 1e-6])

# WG-C ARAIM Reference Airborne Algorithm Description Document v3.1 (20 June 2019), appendix D: ENU rows, two systems
# of five satellites, variances for integrity and for accuracy [m^2], bias 0.5 m, P_sat 1e-5, P_const 1e-4.
ARAIM_ROWS = np.array(
    [
        [0.0225, 0.9951, -0.0966],
        [0.675, -0.69, -0.2612],
        [0.0723, -0.6601, -0.7477],
        [-0.9398, 0.2553, -0.2269],
        [-0.5907, -0.7539, -0.2877],
        [-0.3236, -0.0354, -0.9455],
        [-0.6748, 0.4356, -0.5957],
        [0.0938, -0.7004, -0.7075],
        [0.5571, 0.3088, -0.7709],
        [0.6622, 0.6958, -0.278],
    ]
)
ARAIM_INTEGRITY = [3.2899, 1.2792, 0.7901, 1.443, 1.1847, 0.7737, 0.8233, 0.7962, 0.7871, 1.2166]
ARAIM_ACCURACY = [2.9774, 0.9667, 0.4776, 1.1305, 0.8722, 0.4612, 0.5108, 0.4837, 0.4746, 0.9041]


def sky(seed: int, epochs: int, n: int, systems: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    elevation = np.arcsin(rng.uniform(0.14, 1.0, (epochs, n)))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, (epochs, n))
    flat = np.cos(elevation)
    return {
        "los": np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1),
        "group": rng.integers(0, systems, (epochs, n)),
        "variance": rng.uniform(0.2, 2.0, (epochs, n)),
        "accuracy": rng.uniform(0.1, 1.0, (epochs, n)),
        "bias": rng.uniform(0.0, 0.5, (epochs, n)),
        "heading": rng.uniform(-np.pi, np.pi, epochs),
    }


def reference(case: dict[str, np.ndarray], e: int, rows: np.ndarray, systems: bool) -> tuple[Separation, np.ndarray]:
    group = case["group"][e, rows]
    removed = np.eye(len(rows), dtype=bool)
    if systems:
        removed = np.concatenate([removed, constellation_modes(group)])
    found = separate(
        design_matrix(case["los"][e, rows], group, 5),
        np.diag(case["variance"][e, rows]),
        removed,
        case["heading"][e],
        accuracy=np.diag(case["accuracy"][e, rows]),
        bias=case["bias"][e, rows],
    )
    priors = np.concatenate([np.array(PRIORS)[group], np.full(len(removed) - len(rows), 1e-6)])
    return found, priors


def araim_axis(axis: int) -> tuple[Separation, np.ndarray, np.ndarray]:
    """East (axis 0) or North as the along-track axis of the example."""
    group = np.repeat([0, 1], 5)
    removed = np.concatenate([np.eye(10, dtype=bool), constellation_modes(group)])
    found = separate(
        np.hstack([ARAIM_ROWS, np.eye(2)[group]]),
        np.diag(ARAIM_INTEGRITY),
        removed,
        np.pi / 2 if axis == 0 else 0.0,
        accuracy=np.diag(ARAIM_ACCURACY),
        bias=0.5,
    )
    faults = np.array([1e-5] * 10 + [1e-4] * 2)
    return found, np.concatenate([[2.0], faults]), faults


def test_araim_reference_example() -> None:
    """ADD v3.1 appendix D. Exact root 13.406 m (printed 13.45 at a tolerance of 0.05 m; Stanford MAAST 13.4065)."""
    found, columns, faults = araim_axis(0)
    outside = multiple_fault_risk(faults)
    horizontal, vertical = 2e-9, 9.8e-8
    budget = 0.5 * horizontal * (1.0 - outside / (horizontal + vertical))
    k_fa = false_alarm_factor(9e-8, 12)
    assert k_fa == pytest.approx(5.894859640911244, abs=1e-9)
    np.testing.assert_allclose(found.sigma_m[0], [0.6223481242, 0.7448616216], rtol=1e-9)
    np.testing.assert_allclose(found.bias_m[0], [0.8729065771, 0.9528080635], rtol=1e-9)
    level = multi_hypothesis(found, columns, k_fa, np.full(2, budget))
    np.testing.assert_allclose(level, [8.90345702913343, 10.022828486964505], rtol=1e-9)
    assert np.hypot(*level) == pytest.approx(13.406290984, abs=1e-6)


def test_araim_example_in_the_kernel() -> None:
    """The same figures from the kernel, whose lines of sight have the other sign."""
    geo, moments, modes = gk.geometry_scratch(10), moment_scratch(10), mode_scratch(10)
    group, out = np.repeat([0, 1], 5).astype(np.int64), np.empty((1, 2))
    bias, integrity, accuracy = np.full(10, 0.5), np.array(ARAIM_INTEGRITY), np.array(ARAIM_ACCURACY)
    assert gk.find_geometry(-ARAIM_ROWS, group, integrity, bias, 10, 1.0, 0.0, geo) == gk.SOLVED
    count = find_modes(group, accuracy, 10, 1.0, 0.0, True, False, geo, moments, modes)
    assert count == 13
    lost = set_priors(group, 10, count, np.full(8, 1e-5), np.full(8, 1e-4), geo.clocks, modes)
    budget = np.full((1, 2), 1e-9 * (1.0 - multiple_fault_risk([1e-5] * 10 + [1e-4] * 2) / 1e-7))
    set_factors(10, count, np.full(2, 5.894859640911244), 0.0, geo.clocks, modes)
    pk.multi_hypothesis_pl(count, budget, lost, False, modes, out)
    assert np.hypot(*out[0]) == pytest.approx(13.406290984, abs=1e-6)


@pytest.mark.parametrize("direction", [False, True])
@pytest.mark.parametrize("systems_may_fail", [False, True])
@pytest.mark.parametrize(("n", "systems"), [(6, 1), (9, 2), (14, 3), (22, 4), (35, 5)])
def test_batch_equals_reference(n: int, systems: int, systems_may_fail: bool, direction: bool) -> None:
    """Roots and closed forms of masked random epochs to 1e-9 (1e-8 where a subset is nearly singular)."""
    config = RiskConfig(
        satellite_prior=PRIORS,
        constellation_prior=(1e-6 if systems_may_fail else 0.0,) * 5,
        fault_free_share=0.25 if systems_may_fail else 0.0,
        direction_test=direction,
    )
    case = sky(n, 8, n, systems)
    view = np.random.default_rng(n).random((8, n)) < 0.9
    found = protection_levels_batch(
        case["los"],
        view,
        case["group"],
        case["variance"],
        case["heading"],
        config,
        RISKS,
        accuracy_m2=case["accuracy"],
        bias_m=case["bias"],
        spent=1e-7,
        closed=True,
    )
    for e in range(8):
        separation, priors = reference(case, e, np.flatnonzero(view[e]), systems_may_fail)
        assert separation.status[0] == found.status[e]
        for root, levels in ((True, found.root_m[e]), (False, found.closed_m[e])):
            expected = plain_levels(separation, priors, config, RISKS, spent=1e-7, root=root)
            np.testing.assert_array_equal(np.isinf(levels), np.isinf(expected))
            known = np.isfinite(expected)
            tolerance = 1e-8 if separation.sigma_m[separation.solved].max() > 20.0 else 1e-9
            np.testing.assert_allclose(levels[known], expected[known], rtol=tolerance)


def test_threads_give_the_same_bits() -> None:
    case = sky(1, 40, 16, 3)
    arguments = (case["los"], True, case["group"], case["variance"], case["heading"], RiskConfig(), RISKS)
    with serial():
        alone = protection_levels_batch(*arguments, bias_m=case["bias"])
    threads = protection_levels_batch(*arguments, bias_m=case["bias"])
    np.testing.assert_array_equal(alone.root_m, threads.root_m)


def test_root_is_never_below_and_hardly_above() -> None:
    """f(PL) <= budget < f(PL (1 - 1e-8)) in the plain tail sum."""
    config = RiskConfig(satellite_prior=PRIORS)
    case = sky(3, 20, 15, 3)
    found = protection_levels_batch(
        case["los"], True, case["group"], case["variance"], case["heading"], config, RISKS,
        accuracy_m2=case["accuracy"], bias_m=case["bias"],
    )  # fmt: skip
    for e in range(20):
        separation, priors = reference(case, e, np.arange(15), False)
        columns = np.concatenate([[2.0], priors])
        budgets = config.axis_budgets(RISKS, 0.5 * (priors.sum() ** 2 - (priors**2).sum()))
        k_fa = config.false_alarm_factors(15)[15]
        for budget, level in zip(budgets, found.root_m[e], strict=True):
            assert (tail_sum(level, separation, columns, k_fa) <= budget * (1.0 + 1e-10)).all()
            assert (tail_sum(level * (1.0 - 1e-8), separation, columns, k_fa) > budget).all()


def test_closed_form_is_above_the_root_and_both_fall_with_risk() -> None:
    case = sky(4, 200, 18, 4)
    risks = np.logspace(-2, -7, 11)
    found = protection_levels_batch(
        case["los"], True, case["group"], case["variance"], case["heading"],
        RiskConfig(satellite_prior=(1e-6,) * 5), risks, bias_m=case["bias"], closed=True,
    )  # fmt: skip
    assert (found.status == 0).all()
    assert (found.closed_m >= found.root_m).all()
    assert (np.diff(found.root_m, axis=1) > 0.0).all()
    assert (np.diff(found.closed_m, axis=1) > 0.0).all()


def test_published_closed_form() -> None:
    """S1 eq 17 by hand, and in the kernel."""
    case = sky(5, 1, 12, 2)
    separation, _ = reference(case, 0, np.arange(12), False)
    k_fa, k_md = norm.isf(0.01 / 24.0), norm.isf(1e-5)
    expected = (k_fa * separation.delta_m + k_md * separation.sigma_m + separation.bias_m).max(0)
    config = RiskConfig(variant=Variant.PUBLISHED)
    found = plain_levels(separation, np.full(12, 1e-5), config, [1e-5], root=False)
    np.testing.assert_allclose(found[0], expected, rtol=1e-12)
    np.testing.assert_allclose(closed_form_published(separation, np.array(k_fa), 1e-5), expected, rtol=1e-12)
    modes, out = mode_scratch(12), np.empty((1, 2))
    for name in ("sigma", "delta", "bias"):
        getattr(modes, name)[:, :13] = getattr(separation, f"{name}_m").T
    modes.k_fa[:13] = k_fa
    pk.closed_form_published(13, np.array([k_md]), modes, out)
    np.testing.assert_allclose(out[0], expected, rtol=1e-12)


def test_spent_risk_and_unsolvable_modes() -> None:
    """No budget: inf. A mode that cannot be solved: inf, unless its prior may be spent."""
    case = sky(7, 1, 5, 1)
    arguments = (case["los"], True, case["group"], case["variance"], case["heading"])
    strict, lenient = RiskConfig(), RiskConfig(spend_unsolvable=True)
    assert np.isinf(protection_levels_batch(*arguments, strict, [1e-3], spent=1e-3, closed=True).closed_m).all()
    alone = dict(case, group=np.zeros_like(case["group"]))
    four = np.array([True, True, True, True, False])
    assert np.isinf(protection_levels_batch(alone["los"], four, *arguments[2:], strict, [1e-3]).root_m).all()
    loose = protection_levels_batch(
        alone["los"], four, *arguments[2:], lenient, [1e-3, 1e-5], bias_m=case["bias"], closed=True
    )
    assert np.isfinite(loose.root_m[0, 0]).all()
    assert np.isinf(loose.root_m[0, 1]).all()
    separation, priors = reference(alone, 0, np.arange(4), False)
    for root, level in ((True, loose.root_m[0]), (False, loose.closed_m[0])):
        expected = plain_levels(separation, np.full_like(priors, 1e-5), lenient, [1e-3, 1e-5], root=root)
        np.testing.assert_allclose(level[0], expected[0], rtol=1e-6)
        assert np.isinf(expected[1]).all()


def fault_free_errors(separation: Separation, variance: np.ndarray, bias: np.ndarray, draws: int) -> np.ndarray:
    """AT and CT errors with every nominal bias at its bound and signs chosen against the AT axis."""
    rng = np.random.default_rng(8)
    rows = separation.gain_track[0]
    noise = rng.normal(size=(draws, len(variance))) * np.sqrt(variance) + bias * np.sign(rows[0])
    return np.asarray(noise @ rows.T)


@pytest.mark.parametrize("risk", [1e-2, 1e-3])
def test_fault_free_errors_stay_within_the_level(risk: float) -> None:
    """Share of 400,000 errors beyond PL_AT or PL_CT at most the risk; fails by chance less than once in 1000 runs."""
    case = sky(9, 1, 12, 2)
    separation, priors = reference(case, 0, np.arange(12), False)
    level = protection_levels(separation, priors, RiskConfig(satellite_prior=PRIORS), [risk])[0]
    errors = fault_free_errors(separation, case["variance"][0], case["bias"][0], 400_000)
    beyond = int((np.abs(errors) > level).any(-1).sum())
    assert beyond <= binom.isf(1e-3, 400_000, risk)
    assert beyond > 0.05 * risk * 400_000


def test_published_level_fails_where_the_exact_one_holds() -> None:
    """Biases at their bound with bad signs: the published PL_AT is exceeded far more often than the risk allows."""
    case = sky(10, 1, 12, 1)
    case["variance"] *= 0.01
    case["accuracy"], case["bias"] = case["variance"], np.full((1, 12), 0.3)
    exact, priors = reference(case, 0, np.arange(12), False)
    g = design_matrix(case["los"][0], case["group"][0])
    published = separate(
        g, np.diag(case["variance"][0]), np.eye(12, dtype=bool), case["heading"][0], bias=0.3, variant=Variant.PUBLISHED
    )
    errors = np.abs(fault_free_errors(exact, case["variance"][0], case["bias"][0], 20_000))[:, 0]
    small = plain_levels(published, priors, RiskConfig(variant=Variant.PUBLISHED), [1e-3], root=False)[0, 0]
    large = plain_levels(exact, priors, RiskConfig(), [1e-3], root=False)[0, 0]
    assert (errors > small).mean() > 0.05
    assert (errors > large).mean() <= binom.isf(1e-3, 20_000, 1e-3) / 20_000


def test_undetected_faults_stay_within_the_risk() -> None:
    """The worst size of a fault on each satellite, counted only when every separation test passes.

    Priors of 1 % and a risk of 1e-3, so that Monte Carlo sees it: sum_k P_k P(error > PL, no alarm | fault k) plus the
    fault-free part is at most the budget of the axis, within the sampling error (three standard deviations).
    """
    case = sky(11, 1, 9, 1)
    case["accuracy"], case["bias"] = case["variance"], np.zeros((1, 9))
    separation, _ = reference(case, 0, np.arange(9), False)
    config = RiskConfig(integrity_risk=1e-3, satellite_prior=(0.01,) * 5, subtract_multiple=False)
    level = protection_levels(separation, np.full(9, 0.01), config)[0]
    k_fa, draws = config.false_alarm_factors(9)[9], 20_000
    noise = np.random.default_rng(12).normal(size=(draws, 9)) * np.sqrt(case["variance"][0])
    delta_rows = separation.gain_track[:1] - separation.gain_track[1:]
    total = 2.0 * norm.sf(level / separation.sigma_m[0])
    for k in range(9):
        worst = np.zeros(2)
        for size in np.linspace(0.0, 1.6, 9):
            fault = size * (level / np.abs(separation.gain_track[0, :, k])).min()
            y = noise + fault * (np.arange(9) == k)
            passed = (np.abs(y @ delta_rows.reshape(-1, 9).T) <= k_fa * separation.delta_m[1:].ravel()).all(-1)
            worst = np.maximum(worst, ((np.abs(y @ separation.gain_track[0].T) > level) & passed[:, None]).mean(0))
        total = total + 0.01 * worst
    assert (total <= 0.5e-3).all()
    assert (total > 1e-6).all()


def test_exact_factors_of_one_mode_by_hand() -> None:
    """Two columns sharing 1e-5: PL = max(K_md,0 sigma_0, K_fa sigma_d + K_md,1 sigma_1)."""
    one = np.array([[1.0, 1.0], [1.5, 1.2]])
    found = Separation(one, np.array([[0.0, 0.0], [0.5, 0.4]]), 0 * one, 0 * one, np.zeros(2, int), np.zeros((2, 2, 1)))
    config = RiskConfig(integrity_risk=1e-5, subtract_multiple=False)
    level = plain_levels(found, [1e-4], config, root=False)[0]
    k_fa = norm.isf(0.01 / 4.0)
    first, second = missed_detection_factor(5e-6, 0.5, [2.0, 1e-4])
    np.testing.assert_allclose(level, np.maximum(first, k_fa * found.delta_m[1] + second * one[1]), rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    n=st.integers(0, 14),
    systems=st.integers(1, 4),
    exponent=st.floats(-9.0, -1.0),
    scale=st.floats(1e-4, 1e4),
)
def test_levels_are_positive_or_infinite(seed: int, n: int, systems: int, exponent: float, scale: float) -> None:
    case = sky(seed, 2, n, systems)
    found = protection_levels_batch(
        case["los"], True, case["group"], scale * case["variance"], case["heading"],
        RiskConfig(spend_unsolvable=bool(seed % 2)), [10.0**exponent], bias_m=case["bias"], closed=True,
    )  # fmt: skip
    assert (found.root_m > 0.0).all()
    assert (found.closed_m >= found.root_m * (1 - 1e-9)).all()


def test_bad_input_is_named() -> None:
    case = sky(1, 2, 6, 1)

    def call(**changes: object) -> None:
        given_values: dict[str, object] = {**case, "view": True, **changes}
        names = ("los", "view", "group", "variance", "heading")
        protection_levels_batch(*(given_values[k] for k in names), RiskConfig(), bias_m=given_values["bias"])

    spoiled = case["los"].copy()
    spoiled[1, 2, 0] = np.nan
    with pytest.raises(InputError, match=r"los_enu\[1\] must be finite"):
        call(los=spoiled)
    with pytest.raises(InputError, match=r"los_enu\[0\] must hold unit vectors"):
        call(los=10.0 * case["los"])
    with pytest.raises(InputError, match=r"variance_m2\[0\] must lie in \(0"):
        call(variance=-case["variance"])
    with pytest.raises(InputError, match=r"bias_m\[0\]"):
        call(bias=-case["bias"])
    with pytest.raises(InputError, match=r"group\[0\]"):
        call(group=case["group"] + 8)
    with pytest.raises(InputError, match="heading_rad"):
        call(heading=np.inf)
    with pytest.raises(InputError, match="los_enu must have shape"):
        call(los=case["los"][0])
    view = np.ones((2, 6), bool)
    view[1, 2] = False
    call(los=spoiled, view=view)
