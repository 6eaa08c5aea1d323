"""Rejection of codes: several outliers at once, weights, separability, predicted reflections."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import quiet, sky, with_everything

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.outcome import MonitorOutcome
from lanebound.integrity.monitoring.family.rejection import REJECTIONS, igg3_weight, local_threshold
from lanebound.integrity.monitoring.family.separations import separations

RISK = 1e-3


def spoilt(
    outliers: int, satellites: int = 10, sigma_m: float = 1.0, noise: float = 0.0
) -> tuple[CodeEpochs, set[int]]:
    rng = np.random.default_rng(outliers)
    y = noise * rng.normal(size=(1, satellites))
    bad = rng.permutation(satellites)[:outliers]
    y[0, bad] += rng.uniform(40.0, 200.0, outliers)
    return CodeEpochs.of(y, sky(np.random.default_rng(9), satellites), 1.0), set(map(int, bad))


@pytest.mark.parametrize("outliers", [1, 3, 5])
def test_p_ransac_finds_up_to_n_minus_5_outliers_without_noise(outliers: int) -> None:
    e, bad = spoilt(outliers)
    found = watch(e, monitor_named("p_ransac").config({"subsets": 300, "inlier_sigmas": 0.5}), RISK)
    assert set(map(int, np.flatnonzero(found.excluded[0]))) == bad
    assert np.abs(found.position_enu_m).max() < 1e-6


def test_with_n_minus_4_outliers_every_subset_of_4_agrees_with_itself() -> None:
    e, _ = spoilt(6)
    found = watch(e, monitor_named("p_ransac").config({"subsets": 300, "inlier_sigmas": 1e-6}), RISK)
    assert found.excluded.sum() == 6  # as many are left out, but nothing tells the right ones
    assert not found.usable.any()  # and there is no redundancy to bound an error


def test_subsets_hold_a_code_of_each_system() -> None:
    e = quiet(6, 12, 3, 3)
    y = e.y_m.copy()
    y[:, [2, 7]] += 80.0
    found = watch(CodeEpochs.of(y, e.los_enu, 2.0, True, e.system), monitor_named("p_ransac").config(), RISK)
    assert found.excluded[:, [2, 7]].all()


@pytest.mark.parametrize("name", ["danish", "huber", "igg3"])
def test_robust_weights_bring_the_position_back(name: str) -> None:
    e = quiet(300, 12, 1, 21)
    y = e.y_m.copy()
    y[:, 4] += 60.0
    far = CodeEpochs.of(y, e.los_enu, 2.0)
    plain = watch(far, monitor_named("normal").config({"test": "none"}), RISK).position_enu_m
    robust = watch(far, monitor_named(name).config(), RISK).position_enu_m
    assert np.hypot(*robust[:, :2].T).mean() < 0.5 * np.hypot(*plain[:, :2].T).mean()


@pytest.mark.parametrize("name", ["danish", "huber", "igg3"])
def test_robust_weights_keep_the_test_that_their_level_counts_on(name: str) -> None:
    """A separation above its threshold, by the declared deviations or by those of the level, leaves no level."""
    e = quiet(4000, 8, 1, 22)
    y = e.y_m.copy()
    y[:, 2] += np.linspace(0.0, 40.0, 4000)
    far, config = CodeEpochs.of(y, e.los_enu, 2.0), monitor_named(name).config()
    found, left = watch(far, config, RISK), REJECTIONS[config.rejection](far, config)
    beyond = np.zeros(4000, bool)
    for sigma in (far.sigma_m, left.sigma_m):
        parts = separations(solve_codes(left.with_codes(sigma_m=sigma)))
        d, spread = np.abs(parts.separation_m[:, 1:]), parts.delta_m[:, 1:]
        beyond |= (d > local_threshold(left.used.sum(-1), config.false_alarm)[:, None, None] * spread + 1e-9).any(
            (1, 2)
        )
    assert beyond.any()
    assert np.isinf(found.hpl_m[beyond]).all()
    assert found.usable.any()
    assert monitor_named(name).promise == "none proven"


def test_weights_of_igg3() -> None:
    v = np.array([0.0, 1.5, -2.0, 3.0, 9.0])
    np.testing.assert_allclose(igg3_weight(v, 1.5, 3.0), [1.0, 1.0, 0.75 * (1.0 / 1.5) ** 2, 0.0, 0.0])


def test_a_fault_that_cannot_be_told_apart_stays_an_alarm() -> None:
    rng = np.random.default_rng(2)
    y = rng.normal(size=(50, 9))
    y[:, 0] += 90.0
    los = sky(np.random.default_rng(3), 9, 50)
    least = CodeEpochs.of(y[:, :5], los[:, :5], 1.0)  # one spare code: the tests of all codes are the same
    found = watch(least, monitor_named("separable").config(), RISK)
    assert found.alarm.all()
    assert not found.excluded.any()
    assert watch(CodeEpochs.of(y, los, 1.0), monitor_named("separable").config(), RISK).excluded[:, 0].mean() > 0.9


def test_a_map_leaves_out_or_de_weights_predicted_reflections() -> None:
    e = with_everything(quiet(30, 12, 2, 8))
    assert e.shadowed is not None
    out = watch(e, monitor_named("map_exclude").config(), RISK)
    less = watch(e, monitor_named("map_deweight").config(), RISK)
    plain = watch(e, monitor_named("residual_fde").config(), RISK)
    assert not out.excluded[e.shadowed].any()  # they were never in; excluded counts what tests left out
    assert np.abs(out.position_enu_m - plain.position_enu_m).max() > 0.0
    assert np.abs(out.position_enu_m - less.position_enu_m).max() < 4.0
    with pytest.raises(InputError, match="predicted by a map"):
        watch(quiet(3), monitor_named("map_exclude").config(), RISK)


def test_outcomes_say_why() -> None:
    rng = np.random.default_rng(4)
    y = np.zeros((3, 6))
    used = np.ones((3, 6), bool)
    used[0, 3:], used[1, 4:] = False, False
    y[2, 1] = 500.0
    found = watch(CodeEpochs.of(y, sky(rng, 6, 3), 1.0, used), monitor_named("residual").config(), RISK)
    wanted = [MonitorOutcome.TOO_FEW, MonitorOutcome.NO_REDUNDANCY, MonitorOutcome.ALARM]
    assert [MonitorOutcome.from_code(code) for code in found.outcome] == wanted
    assert np.isinf(found.hpl_m).all()
    assert (found.position_enu_m[0] == 0.0).all()
