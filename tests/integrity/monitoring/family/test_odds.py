"""Weak codes as fault modes with odds: which are left out, the level against its sum written out, and its promise."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from code_geometry import quiet
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import binom

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.odds import code_odds, odds_level, trusted_codes
from lanebound.integrity.monitoring.risk import false_alarm_factor
from lanebound.integrity.monitoring.separation import separate
from lanebound.integrity.positioning.least_squares import design_matrix

EAST = 0.5 * np.pi
RISKS = np.array([1e-2, 1e-4])


def weakened(loss_db: list[float], epochs: int = 5, seed: int = 51, systems: int = 2) -> CodeEpochs:
    """Normal errors; codes as weak as stated below the C/N0 of an open sky, those not stated as strong as there."""
    e = quiet(epochs, 14, systems, seed)
    open_sky = 38.0 + 10.0 * np.sin(e.elevation_rad)
    lost = np.zeros(14)
    lost[: len(loss_db)] = loss_db
    return replace(e, cn0_dbhz=open_sky - lost)


def test_odds_are_half_of_the_most_at_the_centre_and_never_below_the_prior() -> None:
    config = monitor_named("odds").config()
    odds = code_odds(weakened([4.8, 30.0, -30.0]), config, 1e-4)[0]
    np.testing.assert_allclose(odds[:3], [0.085 + 1e-5, 0.17 + 1e-5, 1e-5], rtol=1e-9)


def test_codes_are_left_out_the_weakest_first_until_the_rest_can_be_monitored() -> None:
    config = monitor_named("odds").config()
    e = weakened([12.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.0])
    strict, loose = (trusted_codes(e, config, np.array([risk])).used[0] for risk in (1e-5, 1e-2))
    assert strict[7:].all()
    assert not strict[:4].any()
    assert (loose | ~strict).all()
    assert loose.sum() > strict.sum()
    kept = np.flatnonzero(~strict).max(initial=-1)
    assert not strict[: kept + 1].any()
    assert trusted_codes(e, monitor_named("separation_root").config(), RISKS) is e


def test_priors_of_systems_leave_out_codes_that_may_fail_beside_them() -> None:
    e = weakened([4.0])
    few, none = (
        trusted_codes(e, monitor_named("odds").config({"constellation_prior": prior}), np.array([1e-5])).used[0, 0]
        for prior in (1e-3, 0.0)
    )
    assert not few
    assert none


def test_the_level_is_the_root_of_its_sum_written_out() -> None:
    """Single codes with the threshold of their test, sets and systems with the separation that is observed."""
    e = weakened([3.5, 3.2, 3.0])
    config = monitor_named("odds").config()
    e = trusted_codes(e, config, RISKS)
    assert e.used.all()
    odds, m = code_odds(e, config, 1e-4)[0], 14
    found = odds_level(e, solve_codes(e), config, RISKS)
    limit, sets, least = 0.1 * 1e-4, [], 0.1 * 1e-4
    several = [c for size in (2, 3) for c in combinations(range(m), size)]
    chance = {c: float(np.prod(odds[list(c)])) for c in several}
    left = float(np.prod(1.0 + odds) - 1.0 - odds.sum())
    while left - sum(chance[c] for c in sets) > limit:
        sets = [c for c in several if chance[c] >= least]
        least *= 0.5
    assert sets
    apart = left - sum(chance[c] for c in sets) + 2e-4 * odds.sum()
    removes = np.zeros((m + 2 + len(sets), m), bool)
    removes[:m] = np.eye(m)
    removes[m], removes[m + 1] = e.system == 0, e.system == 1
    for k, c in enumerate(sets):
        removes[m + 2 + k, list(c)] = True
    design = design_matrix(e.los_enu, np.broadcast_to(e.system, e.y_m.shape), 2)
    parts = separate(design, np.eye(m) * e.sigma_m[:, :, None] ** 2, removes, np.full(5, EAST), y=e.y_m)
    k_fa = false_alarm_factor(config.false_alarm, m + 2)
    offset = np.abs(parts.separation_m)
    offset[:, 1 : m + 1] = k_fa * parts.delta_m[:, 1 : m + 1]
    offset[:, 0] = 0.0
    prior = np.concatenate([[2.0], odds, [2e-4, 2e-4], [2.0 * chance[c] for c in sets]])
    for i in range(5):
        for r, risk in enumerate(RISKS):
            level = [
                brentq(
                    lambda x, i=i, q=q, b=0.5 * (risk - apart): (
                        prior * ndtr((offset[i, :, q] - x) / parts.sigma_m[i, :, q])
                    ).sum() - b,
                    0.0, 1e4,
                )
                for q in range(2)
            ]  # fmt: skip
            assert found[i, r] == pytest.approx(np.hypot(*level), rel=1e-6)


def test_several_late_codes_at_their_odds_stay_within_the_level() -> None:
    """Five weak codes, each late by 15 to 60 m with probability ``o / (1 + o)``: exceedances by chance in one of a
    million runs above the bound. Separation without odds, which promises single faults, is exceeded."""
    count, risk = 20_000, 1e-2
    e = weakened([9.0, 9.0, 9.0, 9.0, 9.0], count, 53)
    rng = np.random.default_rng(54)
    late = (rng.random((count, 5)) < 0.17 / 1.17) * rng.uniform(15.0, 60.0, (count, 5))
    y = e.y_m.copy()
    y[:, :5] += late
    e = replace(e, y_m=y)
    beyond = {}
    for name in ("odds", "separation_fde"):
        v = watch(e, monitor_named(name).config(), risk)
        assert v.usable.mean() > 0.5
        beyond[name] = int((v.usable & (np.hypot(*v.position_enu_m[:, :2].T) > v.hpl_m[:, 0])).sum())
    assert beyond["odds"] <= binom.isf(1e-6, count, risk)
    assert beyond["separation_fde"] > beyond["odds"]


def test_left_out_codes_are_reported_and_are_no_exclusion() -> None:
    v = watch(weakened([12.0]), monitor_named("odds").config(), 1e-5)
    assert not v.used[:, 0].any()
    assert v.used[:, 1:].all()
    assert not v.excluded.any()
    assert (v.outcome == 0).all()


def test_the_level_needs_odds() -> None:
    with pytest.raises(ConfigError, match=r"reflections\.sets must be at least 1"):
        monitor_named("odds").config({"reflections": {"sets": 0}})
