"""Separations of single codes by residuals against adjustments without each code; levels against the vehicle's."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import quiet
from plain_araim import araim
from scipy.special import erfcinv
from scipy.stats import binom

from lanebound.integrity.monitoring.araim import AraimConfig, SortedModes, checked_levels, levels_at
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.separations import separations
from lanebound.integrity.monitoring.fault_modes import FaultModes, enumerate_faults
from lanebound.integrity.monitoring.protection import closed_form_published, protection_levels
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, false_alarm_factor
from lanebound.integrity.monitoring.separation import separate
from lanebound.integrity.positioning.least_squares import design_matrix

EAST = 0.5 * np.pi


def whole(seed: int = 31):
    e = quiet(20, 10, 2, seed)
    design = design_matrix(e.los_enu, np.broadcast_to(e.system, e.y_m.shape), 2)
    covariance = np.eye(10) * e.sigma_m[:, :, None] ** 2
    return e, separate(design, covariance, np.eye(10, dtype=bool), np.full(20, EAST), y=e.y_m)


def test_separations_are_those_of_adjustments_without_each_code() -> None:
    e, plain = whole()
    found = separations(solve_codes(e))
    sign = np.array([1.0, -1.0])  # across the track of a vehicle that drives East is minus North
    np.testing.assert_allclose(found.sigma_m, plain.sigma_m, rtol=1e-9)
    np.testing.assert_allclose(found.delta_m, plain.delta_m, atol=1e-9)
    np.testing.assert_allclose(found.separation_m * sign, plain.separation_m, atol=1e-9)


def test_levels_are_those_of_the_vehicle() -> None:
    e, plain = whole()
    rules = RiskConfig(satellite_prior=(1e-3,) * 8, false_alarm=1e-3, subtract_multiple=False, integrity_risk=1e-4)
    root = protection_levels(plain, np.full((20, 10), 1e-3), rules)[:, 0]
    found = watch(e, monitor_named("separation_root").config({"test": "none"}), 1e-4).hpl_m[:, 0]
    np.testing.assert_allclose(found, np.hypot(root[..., 0], root[..., 1]), atol=2e-3)
    k_fa = false_alarm_factor(1e-3, 10, Variant.PUBLISHED)
    printed = closed_form_published(plain, k_fa, 1e-4)
    published = watch(e, monitor_named("separation_published").config({"test": "none"}), 1e-4).hpl_m[:, 0]
    np.testing.assert_allclose(published, np.hypot(printed[:, 0], printed[:, 1]), rtol=1e-9)


def test_araim_is_that_of_the_package_with_budgets_of_aviation() -> None:
    e = quiet(3, 14, 2, 33)
    config = monitor_named("araim_lpv200").config({"rejection": "none", "test": "none"})
    found = watch(e, config, 1e-3)
    assert config.araim == AraimConfig()
    plain = araim(e.los_enu, e.system, e.sigma_m**2, e.sigma_m**2, 0.0, AraimConfig())
    np.testing.assert_allclose(found.hpl_m[:, 0], plain.hpl_m, rtol=1e-9)
    np.testing.assert_allclose(found.vpl_m[:, 0], plain.vpl_m, rtol=1e-9)


def test_sbas_levels_have_the_factors_of_their_operation() -> None:
    e = quiet(5, 10, 1, 35)
    fit = solve_codes(e)
    approach = watch(e, monitor_named("sbas").config(), [1e-3, 1e-5])
    route = watch(e, monitor_named("sbas").config({"en_route": True}), 1e-3)
    np.testing.assert_allclose(approach.hpl_m, 6.0 * fit.major_m[:, None] * np.ones(2))
    np.testing.assert_allclose(route.hpl_m[:, 0], 6.18 * fit.major_m)
    assert approach.vpl_m[0, 0] == pytest.approx(5.33 * np.sqrt(fit.cofactor[0, 2, 2]))


def modes_and_lost(e: CodeEpochs, budget: AraimConfig) -> tuple[FaultModes, FaultModes]:
    """All modes, and those without a solution: by plain separations."""
    group = e.system
    modes = enumerate_faults(
        group, budget.satellite_prior, budget.constellation_prior, unmonitored_below=budget.unmonitored_below,
        at_once=budget.at_once,
    )  # fmt: skip
    design = design_matrix(e.los_enu[:1], group[None], int(group.max()) + 1)
    variance = np.eye(group.size) * e.sigma_m[:1, :, None] ** 2
    solved = np.isfinite(separate(design, variance, modes.removes, np.array([EAST])).sigma_m[0, 1:, 0])
    return modes.take(solved), modes.take(~solved)


@pytest.mark.parametrize("systems", [(5, 4, 4), (6, 3, 2, 1), (4, 4), (8, 8)])
def test_modes_by_downdates_are_those_solved_anew(systems: tuple[int, ...]) -> None:
    """Levels against the kernel that solves every mode again, the test against plain separations; pairs that take the
    whole of a system of two, and satellites alone in theirs, included. Modes without a solution are spent as those
    that are not monitored: both kernels agree if the plain one has them so."""
    e = quiet(6, sum(systems), len(systems), 37)
    group = np.repeat(np.arange(len(systems)), systems)
    noise = np.random.default_rng(39).normal(size=e.y_m.shape) * e.sigma_m
    y = noise + np.array([40.0, -60.0] + [0.0] * (group.size - 2)) * (np.arange(6) % 2)[:, None]
    budget = AraimConfig(
        vertical_risk=1e-5, horizontal_risk=1e-5, vertical_false_alarm=1e-3, horizontal_false_alarm=1e-3,
        unmonitored_below=1e-6, satellite_prior=1e-3, constellation_prior=1e-6, at_once=2,
    )  # fmt: skip
    e = CodeEpochs.of(y, e.los_enu, e.sigma_m, True, group)
    solved, lost = modes_and_lost(e, budget)
    everything = FaultModes(
        np.concatenate([solved.removes, lost.removes]), np.concatenate([solved.prior, lost.prior]), solved.unmonitored
    )
    kept = SortedModes.of(everything, group)
    assert len(kept) == everything.several.sum()
    assert len(kept.pair) > len(kept.system) > 0
    variance = e.sigma_m**2
    up, plane, alarm = checked_levels(e.los_enu, group, variance, y, budget, kept, np.ones(1))
    assert np.isfinite(up).all()
    assert np.isfinite(plane).all()
    spent = FaultModes(solved.removes, solved.prior, solved.unmonitored + lost.prior.sum())
    share = (group.size + solved.several.sum()) / (group.size + len(kept))  # the same thresholds with fewer modes
    plain_budget = budget.replace(
        vertical_false_alarm=1e-3 * float(share), horizontal_false_alarm=1e-3 * float(share)
    )  # fmt: skip
    plain_up, plain = levels_at(e.los_enu, group, variance, variance, 0.0, plain_budget, spent, np.ones(1))
    np.testing.assert_allclose(up, plain_up, rtol=1e-7)
    np.testing.assert_allclose(plane, plain, rtol=1e-7)
    design = design_matrix(e.los_enu, np.broadcast_to(group, e.y_m.shape), len(systems))
    removes = np.unique(np.concatenate([np.eye(group.size, dtype=bool), everything.removes]), axis=0)
    parts = separate(design, np.eye(group.size) * variance[:, :, None], removes, np.full(6, EAST), y=y)
    limit = np.sqrt(2.0) * erfcinv(2e-3 / (4.0 * (group.size + len(kept))))  # Qinv(a / (4 n))
    size = np.abs(parts.separation_m) / np.where(parts.delta_m > 1e-6, parts.delta_m, np.inf)
    assert (alarm[size.max((-1, -2)) > limit]).all()
    assert alarm.tolist() == [False, True] * 3


@pytest.mark.parametrize("systems", [1, 2, 3, 4])
@pytest.mark.parametrize("codes", [12, 20, 30])
def test_araim_has_a_level_where_its_priors_leave_some_of_the_risk(systems: int, codes: int) -> None:
    """With one system its own fault is spent: 1e-4 leaves nothing of 1e-4 and of LPV-200. A level depends on its own
    risk alone."""
    e = quiet(3, codes, systems, codes)
    risks = np.array([1e-2, 1e-3, 1e-4, 1e-5])
    config = monitor_named("araim").config({"test": "none", "rejection": "none"})
    found = watch(e, config, risks)
    there = risks > 1e-4 if systems == 1 else np.ones(4, bool)
    np.testing.assert_array_equal(np.isfinite(found.hpl_m), np.broadcast_to(there, (3, 4)))
    np.testing.assert_array_equal(np.isfinite(found.vpl_m), np.broadcast_to(there, (3, 4)))
    assert (np.diff(found.hpl_m[:, there], axis=1) > 0.0).all()
    np.testing.assert_allclose(watch(e, config, 1e-3).hpl_m[:, 0], found.hpl_m[:, 1], rtol=1e-12)
    rare = watch(e, config.replace(constellation_prior=1e-8), risks)
    assert np.isfinite(rare.hpl_m).all()
    landing = watch(e, monitor_named("araim_lpv200").config({"test": "none", "rejection": "none"}), 1e-3)
    assert np.isfinite(landing.hpl_m).all() == (systems > 1)
    whole = landing.hpl_m[:, 0]
    assert (whole > found.hpl_m[:, 3]).all() or systems == 1


@pytest.mark.parametrize("prior", [0.0, 1e-5])
def test_what_araim_cannot_monitor_is_spent_once(prior: float) -> None:
    """One system: the level at a risk is that of the risk less the prior of the system, without such a fault."""
    e = quiet(2, 12, 1, 45)
    config = monitor_named("araim").config({"test": "none", "rejection": "none", "constellation_prior": prior})
    plain = config.replace(constellation_prior=0.0)
    risk = 1e-3
    left = watch(e, plain, risk - prior * (1.0 + 12e-3)).hpl_m  # and of the modes of it and one more satellite
    np.testing.assert_allclose(watch(e, config, risk).hpl_m, left, rtol=5e-4)  # one mode more in the thresholds


KINDS = ("separation", "separation_root", "odds", "weighted", "residual", "ibpl", "uncertainty")


@pytest.mark.parametrize("name", KINDS)
def test_vertical_levels_are_those_of_a_plane_that_has_the_height_as_its_axis(name: str) -> None:
    """A separation of one axis at a risk is that of two axes at twice of it."""
    e = quiet(40, 14, 2, 41)
    config = monitor_named(name).config({"vertical": True, "test": "none"})
    found = watch(e, config, [1e-2, 1e-4])
    assert np.isfinite(found.vpl_m).all()
    assert (found.vpl_m[:, 1] > found.vpl_m[:, 0]).all()
    np.testing.assert_array_equal(found.hpl_m, watch(e, config.replace(vertical=False), [1e-2, 1e-4]).hpl_m)
    assert np.isinf(watch(e, config.replace(vertical=False), 1e-2).vpl_m).all()
    if name == "separation_root":
        rules = RiskConfig(
            satellite_prior=(1e-3,) * 8, false_alarm=1e-3, subtract_multiple=False, integrity_risk=2e-4
        )  # fmt: skip
        design = design_matrix(e.los_enu[..., [2, 0, 1]], np.broadcast_to(e.system, e.y_m.shape), 2)
        covariance = np.eye(14) * e.sigma_m[:, :, None] ** 2
        plain = separate(design, covariance, np.eye(14, dtype=bool), np.full(40, EAST), y=e.y_m)
        root = protection_levels(plain, np.full((40, 14), 1e-3), rules)[:, 0]
        np.testing.assert_allclose(found.vpl_m[:, 1], root[:, 0], atol=2e-3)


def test_errors_of_the_height_stay_within_its_levels() -> None:
    """Without faults, 20,000 epochs at 1e-2: above the bound by chance in one of a million runs."""
    e = quiet(20_000, 12, 2, 43)
    for name in ("separation_root", "weighted", "odds", "ibpl"):
        v = watch(e, monitor_named(name).config({"vertical": True}), 1e-2)
        beyond = int((v.usable & (np.abs(v.position_enu_m[:, 2]) > v.vpl_m[:, 0])).sum())
        assert beyond <= binom.isf(1e-6, e.count, 1e-2)
