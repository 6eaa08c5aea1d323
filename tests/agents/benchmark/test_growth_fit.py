"""The fit of the growth of protection levels, on made-up outages and on a drive."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.agents.benchmark import growth_fit as fit
from lanebound.agents.drivers.horizon import GrowthConfig

STEP_S = 0.2


def made_up(outages: int = 300, g: tuple[float, float] = (0.9, 1.4), p: float = 0.75, seed: int = 1) -> fit.Decisions:
    """One episode: outages of 10 s after 5 s on RTK, each with its own factor, of median 1."""
    rng, rows = np.random.default_rng(seed), []
    for _ in range(outages):
        factor = np.exp(0.3 * rng.standard_normal(2))
        for _ in range(25):
            rows.append([0.0, 0.2, 0.21, 0.5, 10.0, 20.0])
        for t in STEP_S * np.arange(1, 51):
            rows.append([t, *(0.2 + np.array(g) * factor * t**p + [0.0, 0.01]), 0.5, 10.0, 9.0])
    return fit.Decisions.of(np.array(rows))


def test_power_and_factors_of_made_up_outages_are_found() -> None:
    found = fit.fit_growth([made_up()], STEP_S)
    assert found["growth_power"] == pytest.approx(0.75, abs=0.02)
    # 0.3 sigma over 300 outages: 2 % on the median, 3 % on the quantile
    assert (found["growth_at_m"], found["growth_ct_m"]) == pytest.approx((0.9, 1.4), rel=0.08)
    upper = np.exp(0.3 * 1.2816)
    assert (found["upper_at_m"], found["upper_ct_m"]) == pytest.approx((0.9 * upper, 1.4 * upper), rel=0.1)
    assert (found["reset_at_m"], found["reset_ct_m"], found["spare_m"]) == (0.2, 0.21, 0.0)
    assert found["satellites_needed"] == 10


def test_gains_count_from_the_last_decision_on_rtk_and_need_one() -> None:
    rows = np.array([[0.4, 3.0, 3.0, 0.5, 1.0, 9.0], [0.0, 0.2, 0.3, 0.5, 2.0, 20.0], [0.2, 0.5, 0.8, 0.5, 4.0, 9.0]])
    found = fit.gains_of([fit.Decisions.of(rows)], 0.05)
    np.testing.assert_allclose(np.column_stack(found), [[0.2, 0.3, 0.5, 4.0]])


def test_satellites_count_only_while_the_link_holds_and_the_sky_is_known() -> None:
    rows = np.repeat(
        [[1.0, 2.0, 2.0, 9.0, 8.0, 12.0], [1.0, 2.0, 2.0, 0.5, 8.0, -1.0], [1.0, 2.0, 2.0, 0.5, 8.0, 7.0]], 40, axis=0
    )
    assert fit.most_satellites([fit.Decisions.of(rows)], 0.05, 1.5) == 8


def test_a_drive_gives_every_figure_of_the_law() -> None:
    seen = []
    episodes, step_s = fit.measure_growth(("LaneKeeping",), ("dense",), 1, seen.append)
    assert (len(episodes), step_s, seen[-1].done, seen[-1].of) == (1, STEP_S, 1, 1)
    assert episodes[0].level_m.shape == (episodes[0].since_s.size, 2)
    assert (episodes[0].since_s >= 0.0).all()
    assert set(fit.fit_growth([made_up()], STEP_S)) <= set(GrowthConfig.model_fields)
