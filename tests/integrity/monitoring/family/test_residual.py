"""Residual RAIM: three forms of one test, the slope level against the worst bias, and rates against theory."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import directions, quiet, ring, sky
from residual_forms import parity_statistic, range_comparison_statistic, residual_statistic
from scipy.stats import binom, ncx2
from worst_bias import SIGMA_M, SKIES, beyond, worst_code, worst_rate

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.levels import fixed_level_false_alarm, noncentralities, predicted_level
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.rejection import global_threshold
from lanebound.integrity.monitoring.significance import noncentrality
from lanebound.integrity.positioning.least_squares import design_matrix

RISK = np.array([1e-3])
AFTER_GLOBAL = {"rejection": "local_test", "test": "global"}


def test_residuals_parity_and_range_comparison_are_one_statistic() -> None:
    rng = np.random.default_rng(1)
    for systems in (1, 2):
        e = quiet(200, 11, systems, 7)
        sigma = rng.uniform(0.5, 4.0, e.y_m.shape)
        design = design_matrix(e.los_enu, np.broadcast_to(e.system, e.y_m.shape), systems)
        forms = [f(design, sigma, e.y_m) for f in (residual_statistic, parity_statistic, range_comparison_statistic)]
        np.testing.assert_allclose(forms[1], forms[0], rtol=1e-9)
        np.testing.assert_allclose(forms[2], forms[0], rtol=1e-9)
        np.testing.assert_allclose(solve_codes(e.with_codes(sigma_m=sigma)).wsse, forms[0], rtol=1e-9)
    with pytest.raises(InputError, match="more rows than columns"):
        parity_statistic(np.eye(4), 1.0, np.zeros(4))


def test_the_slope_level_is_the_worst_bias_that_a_search_finds() -> None:
    e = quiet(1, 9, 1, 11)
    level = predicted_level(solve_codes(e), 1e-3, RISK)[0, 0]
    limit = global_threshold(np.array([5]), 1e-3)[0]
    worst = 0.0
    for i in range(9):
        y = np.zeros((4000, 9))
        y[:, i] = np.linspace(0.01, 200.0, 4000)
        fit = solve_codes(CodeEpochs.of(y, np.broadcast_to(e.los_enu, (4000, 9, 3)), 2.0))
        missed = ncx2.cdf(limit, 5, fit.wsse)  # without noise wsse is the non-centrality
        worst = max(worst, float(np.hypot(*fit.x_m[missed >= RISK[0], :2].T).max()))
    assert worst == pytest.approx(level, rel=2e-3)


def test_power_at_the_minimum_detectable_bias_is_as_theory_says() -> None:
    risk, trials = np.array([0.2]), 4000
    e = quiet(trials, 9, 1, 13)
    fit = solve_codes(e)
    lam = noncentralities(fit.df[:1], 1e-3, risk)[0, 0]
    y = e.y_m.copy()
    y[:, 4] += 2.0 * np.sqrt(lam / fit.redundancy[0, 4])  # sigma sqrt(lambda / R)
    found = watch(CodeEpochs.of(y, e.los_enu, 2.0), monitor_named("residual").config(), risk)
    low, high = binom.ppf([5e-4, 1 - 5e-4], trials, 1.0 - risk[0])
    assert low <= found.alarm.sum() <= high


@pytest.mark.parametrize("codes", [5, 7, 9])
def test_what_residual_levels_promise_and_what_they_do_not(codes: int) -> None:
    """The docs have the table. A bias whose mean effect is the slope level is missed with P_MD: 20,000 trials, outside
    by chance once in 1,000. With noise on top of the bias the error goes beyond that level more often; with five codes
    it goes beyond those of Walter and Enge and of HUL hundreds of times as often as the risk. Levels by separation
    bound both, times the prior of the fault."""
    risk, trials = 1e-3, 20_000
    _, worst, _ = worst_code(codes)
    fit = solve_codes(CodeEpochs.of(np.zeros((1, codes)), SKIES[codes], SIGMA_M))
    level = predicted_level(fit, 1e-3, np.array([risk]))[0, 0]
    size = level / fit.slopes()[0, worst]  # the mean effect of this bias is the level
    low, high = binom.ppf([5e-4, 1 - 5e-4], trials, risk) / trials
    assert low <= beyond("residual", codes, risk, size, trials)[1] <= high
    if codes == 9:
        assert worst_rate("residual", codes) > 2 * risk
    if codes == 5:
        assert worst_rate("weighted", codes, trials=2000) > 100 * risk
        assert worst_rate("uncertainty", codes, trials=2000) > 100 * risk
    for kind in ("separation", "separation_root"):  # the level counts the prior 1e-3 of the fault
        assert 1e-3 * worst_rate(kind, codes, trials=2000) <= risk


@pytest.mark.parametrize(("codes", "seed"), [(9, 1), (15, 2), (30, 3)])
def test_data_snooping_finds_the_minimum_detectable_bias(codes: int, seed: int) -> None:
    """w-tests that always run miss the MDB at most with the risk: 20,000 trials at 1e-2, above by chance once in 1,000;
    a local test after the global one misses it more often the more codes there are."""
    risk, trials = 1e-2, 20_000
    rng = np.random.default_rng(seed)
    los = directions(rng.uniform(0, 360, codes), rng.uniform(10, 80, codes))
    fit = solve_codes(CodeEpochs.of(np.zeros((1, codes)), los, 2.0))
    worst = int(fit.slopes()[0].argmax())
    bias = 2.0 * np.sqrt(noncentrality(1e-3 / codes, 1.0 - risk, 1) / fit.redundancy[0, worst])
    y = 2.0 * rng.normal(size=(trials, codes))
    y[:, worst] += bias
    e = CodeEpochs.of(y, np.broadcast_to(los, (trials, codes, 3)), 2.0)
    found, after = (watch(e, monitor_named("baarda").config(changes), risk) for changes in ({}, AFTER_GLOBAL))
    missed, late = ((~v.alarm & ~v.excluded.any(-1)).sum() for v in (found, after))
    assert missed <= binom.ppf(0.999, trials, risk)
    assert late > 2 * binom.ppf(0.999, trials, risk) or codes == 9
    level = watch(e.take([0]), monitor_named("baarda").config(), risk).hpl_m[0, 0]
    assert level == pytest.approx(bias * np.hypot(*fit.gain[0, worst, :2]), rel=1e-9) or found.excluded[0].any()


@pytest.mark.parametrize("name", ["residual", "separation_root", "ibpl"])
def test_false_alarms_are_within_their_allocation(name: str) -> None:
    trials, rate = 4000, 0.02
    found = watch(quiet(trials, 10, 2, 17), monitor_named(name).config({"false_alarm": rate}), 1e-3)
    low, high = binom.ppf([5e-4, 1 - 5e-4], trials, rate)
    assert found.alarm.sum() <= high
    if name == "residual":  # exact; the sum over local tests is a bound
        assert found.alarm.sum() >= low
    assert set(np.unique(found.false_alarm)) == ({0.0} if name == "ibpl" else {rate})


def test_road_raim_fixes_the_level_and_pays_in_false_alarms() -> None:
    e = quiet(3000, 9, 1, 19)
    fit = solve_codes(e)
    config = monitor_named("road").config({"hal_m": 12.0})
    found = watch(e, config, RISK)
    assert set(np.unique(found.hpl_m)) <= {12.0, np.inf}
    chance = fixed_level_false_alarm(fit, 12.0, RISK)[1][0, 0]
    low, high = binom.ppf([5e-4, 1 - 5e-4], e.count, chance)
    assert low <= found.alarm.sum() <= high
    limit = fixed_level_false_alarm(fit, 12.0, RISK)[0][0, 0]
    lam = (12.0 / fit.slopes().max()) ** 2
    assert ncx2.cdf(limit, fit.df[0], lam) == pytest.approx(RISK[0], rel=1e-6)
    wide = fixed_level_false_alarm(fit, 120.0, RISK)[1][0, 0]
    assert wide < chance


def test_the_uncertainty_level_grows_with_the_residuals_and_the_predicted_one_does_not() -> None:
    e = quiet(2, 9, 1, 23)
    y = e.y_m.copy()
    y[1] = y[0]
    y[1, 3] += 40.0
    both = CodeEpochs.of(y, e.los_enu, 2.0)
    loose = {"test": "none"}
    hul = watch(both, monitor_named("uncertainty").config(loose), 1e-3).hpl_m[:, 0]
    hpl = watch(both, monitor_named("residual").config(loose), 1e-3).hpl_m[:, 0]
    assert hul[1] > hul[0]
    assert hpl[1] == hpl[0]


def test_without_redundancy_there_is_no_level_and_no_nan() -> None:
    e = CodeEpochs.of(np.zeros((1, 4)), ring(4))
    for name in ("residual", "uncertainty", "weighted", "baarda", "ibpl"):
        found = watch(e, monitor_named(name).config(), RISK)
        assert np.isinf(found.hpl_m).all(), name
        assert not found.usable.any(), name
    assert np.isfinite(watch(CodeEpochs.of(np.zeros((1, 6)), sky(np.random.default_rng(1), 6)),
                             monitor_named("residual").config(), RISK).hpl_m).all()  # fmt: skip
