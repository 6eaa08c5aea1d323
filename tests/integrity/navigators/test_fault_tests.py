"""Every fault test that a configuration can choose: levels against the plain form, false alarms, exceedance, drives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plain_closed_form import plain_levels
from scipy.stats import binom, chi2, norm
from signal_records import rows_of

from fault_rows import constellation_modes
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.detection import adjust, diagonal_covariance
from lanebound.integrity.monitoring.detection_kernel import detect_and_exclude
from lanebound.integrity.monitoring.exclusion import FdeConfig, FdeOutcome, Search, fde_parameters, fde_thresholds
from lanebound.integrity.monitoring.separation import Separation, separate
from lanebound.integrity.monitoring.significance import Linking, baarda_global_significance, baarda_local_significance
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import LevelForm, Navigator, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import fixed_scratch, levels_of_fix
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters, epoch_tables
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning import geometry_kernel as gk
from lanebound.integrity.positioning.least_squares import design_matrix
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET, find_sets
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
ALPHA, POWER = 0.01, 0.8
WHOLE = {"constellation_prior": (1e-6,) * 5}
OPTIONS: dict[str, dict[str, dict[str, Any]]] = {
    "none": {},
    "global first": {"fde": {"global_first": True}},
    "B-method, from global": {"fde": {"linking": Linking.BAARDA_FROM_GLOBAL}},
    "B-method, from local": {"fde": {"linking": Linking.BAARDA_FROM_LOCAL}},
    "B-method, global first": {"fde": {"linking": Linking.BAARDA_FROM_LOCAL, "global_first": True}},
    "w-test": {"fde": {"search": Search.W_TEST}},
    "direction": {"fde": {"search": Search.DIRECTION}},
    "direction_test": {"risk": {"direction_test": True}},
    "constellations": {"risk": WHOLE},
    "constellations, w-test": {"fde": {"search": Search.W_TEST}, "risk": WHOLE},
    "constellations, direction": {"risk": {**WHOLE, "direction_test": True}},
    "constellations, global first": {"fde": {"global_first": True}, "risk": WHOLE},
    "constellations, B-method, w-test": {
        "fde": {"search": Search.W_TEST, "linking": Linking.BAARDA_FROM_GLOBAL}, "risk": WHOLE,
    },
}  # fmt: skip


@dataclass
class Case:
    """A random epoch of n satellites: rows, their plain modes, and the separation of each mode."""

    los: Array
    group: NDArray[np.int64]
    variance: Array
    accuracy: Array
    bias: Array
    heading: float

    @classmethod
    def of(cls, seed: int, n: int, systems: int) -> Case:
        rng = np.random.default_rng(seed)
        sine, azimuth = rng.uniform(0.17, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
        flat = np.sqrt(1.0 - sine**2)
        los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1)
        group = np.sort(np.arange(n) % systems).astype(np.int64)
        variance, accuracy, bias = rng.uniform(0.2, 2.0, n), rng.uniform(0.1, 1.0, n), rng.uniform(0.0, 0.5, n)
        return cls(los, group, variance, accuracy, bias, rng.uniform(-3.0, 3.0))

    @property
    def n(self) -> int:
        return self.group.size

    def modes(self, config: NavigatorConfig) -> NDArray[np.bool_]:
        single = np.eye(self.n, dtype=bool)
        whole = config.risk.monitors_constellations
        return np.concatenate([single, constellation_modes(self.group)]) if whole else single

    def separation(self, config: NavigatorConfig) -> Separation:
        return separate(
            design_matrix(self.los, self.group, gk.MAX_GROUPS), np.diag(self.variance), self.modes(config),
            self.heading, accuracy=np.diag(self.accuracy), bias=self.bias,
        )  # fmt: skip


def factors(config: NavigatorConfig, case: Case) -> Array:
    """K_fa of each mode by the formulas of the tests, written out."""
    fde, modes = config.fde, case.modes(config)
    df = case.n - 3 - np.unique(case.group).size
    size = ALPHA / len(modes)
    if fde.linking is Linking.BAARDA_FROM_GLOBAL:
        size = baarda_local_significance(ALPHA, POWER, df)
    elif fde.linking is Linking.BAARDA_FROM_LOCAL:
        size = ALPHA
    overall = baarda_global_significance(ALPHA, POWER, df) if fde.linking is Linking.BAARDA_FROM_LOCAL else ALPHA
    search = Search.DIRECTION if config.risk.direction_test else fde.search
    out = np.empty(len(modes))
    for i, mode in enumerate(modes):
        rank = max(int(mode.sum()) - 1, 1)
        if search is Search.SEPARATION:
            out[i] = norm.isf(size / 4.0)
        else:
            out[i] = np.sqrt(chi2.isf(size, min(rank, 2) if search is Search.DIRECTION else rank))
        if fde.global_first:
            out[i] = max(out[i], np.sqrt(chi2.isf(overall, df)))
    return out


def levels(config: NavigatorConfig, case: Case) -> Array:
    """PL_AT and PL_CT of the compiled navigator, less the bound of the reference's coordinates."""
    assert isinstance(config, RtkReckoningConfig)
    n, turn, par = case.n, (np.sin(case.heading), np.cos(case.heading)), epoch_parameters(config)[0]
    scratch, out = fixed_scratch(n, 0), np.empty((len(config.cases), 2))
    assert gk.find_geometry(case.los, case.group, case.variance, case.bias, n, *turn, scratch.geo) == gk.SOLVED
    scratch.group[:n], scratch.accuracy[:n] = case.group, case.accuracy
    levels_of_fix(n, 0.0, *turn, epoch_tables(config, case.group), par, scratch, out)
    return out[0] - par["risk"]["reference_bias"]


def levels_by_hand(config: NavigatorConfig, case: Case) -> Array:
    """The same by the plain form with the factors written out."""
    found, risk = case.separation(config), config.risk.replace(direction_test=False)
    count = len(found.sigma_m) - 1
    scale = factors(config, case) / risk.false_alarm_factors(count)[count]
    found = replace(found, delta_m=found.delta_m * np.concatenate([[1.0], scale])[:, None])
    satellite, constellation = risk.priors()
    priors = satellite[case.group]
    if risk.monitors_constellations:
        priors = np.concatenate([priors, constellation[np.unique(case.group)]])
    return plain_levels(found, priors, risk, root=config.form is LevelForm.ROOT)[0]


@pytest.mark.parametrize("form", list(LevelForm))
@pytest.mark.parametrize("name", list(OPTIONS))
def test_levels_count_on_the_threshold_of_the_test(name: str, form: LevelForm) -> None:
    config = NavigatorConfig().replace(form=form, **OPTIONS[name])
    for seed, (n, systems) in enumerate([(9, 1), (12, 2), (17, 3), (22, 4), (30, 5)]):
        case = Case.of(seed, n, systems)
        expected = levels_by_hand(config, case)
        assert np.isfinite(expected).all() == (not (systems == 1 and config.risk.monitors_constellations))
        np.testing.assert_allclose(levels(config, case), expected, rtol=1e-9)


SETS = 60
REFLECTIONS = {"positioning": {"rtk": {"reflections": {"sets": SETS}}}}


@pytest.mark.parametrize("form", list(LevelForm))
@pytest.mark.parametrize("weak", [(), (2,), (2, 7)])
def test_sets_of_doubtful_carriers_count_with_their_separation(weak: tuple[int, ...], form: LevelForm) -> None:
    """By the plain form: a mode for each satellite, and for each set one of both tails with abs(x - x_A)."""
    config, case = NavigatorConfig().replace(form=form, **REFLECTIONS), Case.of(3, 12, 2)
    odds, par = np.full(12, 1e-4), epoch_parameters(config)[0]
    odds[list(weak)] = 0.02
    y, turn = np.random.default_rng(8).normal(size=12), (np.sin(case.heading), np.cos(case.heading))
    scratch, out = fixed_scratch(12, SETS), np.empty((len(config.cases), 2))
    assert gk.find_geometry(case.los, case.group, case.variance, case.bias, 12, *turn, scratch.geo) == gk.SOLVED
    y *= np.sqrt(case.variance)
    gk.solve(y, case.group, 12, scratch.geo)
    scratch.group[:12], scratch.accuracy[:12], scratch.odds[:12] = case.group, case.accuracy, odds
    levels_of_fix(12, 0.0, *turn, epoch_tables(config, case.group), par, scratch, out)
    found = np.full((SETS, LARGEST_SET), -1, dtype=np.int64)
    count, left = find_sets(odds, 12, par["rtk"]["reflections"], found)
    assert (count > 0) == bool(weak)
    removed = np.zeros((count, 12), np.bool_)
    for row, members in zip(removed, found, strict=False):
        row[members[members >= 0]] = True
    plain = separate(
        design_matrix(case.los, case.group, gk.MAX_GROUPS), np.diag(case.variance),
        np.concatenate([np.eye(12, dtype=bool), removed]), case.heading, accuracy=np.diag(case.accuracy),
        bias=case.bias, y=y,
    )  # fmt: skip
    risk = config.risk.replace(subtract_multiple=False)
    modes = 12 + count
    assumed = plain.delta_m * (factors(config, case)[0] / risk.false_alarm_factors(modes)[modes])
    assumed[13:] = np.abs(plain.separation_m[13:]) / risk.false_alarm_factors(modes)[modes]
    priors = np.concatenate([odds, [2.0 * odds[row].prod() for row in removed]])  # both tails of a set
    plain = replace(plain, delta_m=assumed)
    expected = plain_levels(plain, priors, risk, spent=left, root=form is LevelForm.ROOT)[0]
    np.testing.assert_allclose(out[0] - par["risk"]["reference_bias"], expected, rtol=1e-8)


def run_test(config: NavigatorConfig, case: Case, y: Array) -> NDArray[np.int64]:
    """Outcome of the compiled test for each row of y (D, n), with ``accuracy`` as variance."""
    assert isinstance(config, RtkReckoningConfig)
    whole = config.risk.monitors_constellations
    thresholds, rules = fde_thresholds(config.tests, case.n, whole), fde_parameters(config.tests, whole)[0]
    x, q, out = np.empty(3), np.empty((3, 3)), np.empty(len(y), np.int64)
    for k, row in enumerate(y):
        rows = rows_of(case.los, case.group, True, case.accuracy, row)
        out[k] = detect_and_exclude(rows, case.heading, thresholds, rules, x, q)[0]
    return out


@pytest.mark.parametrize("name", list(OPTIONS))
def test_false_alarms_come_at_their_stated_rate(name: str) -> None:
    """The global test alone, or at most the sum of the sizes of all tests; each bound fails by chance 5 in 10,000."""
    config, trials = NavigatorConfig().replace(**OPTIONS[name]), 6000
    case = Case.of(21, 14, 3)
    y = np.random.default_rng(5).normal(size=(trials, case.n)) * np.sqrt(case.accuracy)
    alarms = int((run_test(config, case, y) != FdeOutcome.CLEAN.code).sum())
    df, fde, modes = case.n - 6, config.fde, len(case.modes(config))
    overall, local = ALPHA, ALPHA / modes
    if fde.linking is Linking.BAARDA_FROM_GLOBAL:
        local = baarda_local_significance(ALPHA, POWER, df)
    elif fde.linking is Linking.BAARDA_FROM_LOCAL:
        overall, local = baarda_global_significance(ALPHA, POWER, df), ALPHA
    most = overall if fde.global_first else min(overall + modes * local, 1.0)
    assert binom.ppf(5e-4, trials, overall) <= alarms <= binom.ppf(1.0 - 5e-4, trials, most)


def worst_fault(case: Case, mode: NDArray[np.bool_], axis: int, size: float) -> Array:
    """The fault of these rows that moves the axis most for its statistic, with a mean separation of ``size`` sigma."""
    design = design_matrix(case.los, case.group, gk.MAX_GROUPS)
    a = adjust(design, diagonal_covariance(case.accuracy), np.zeros(case.n))
    gain = track_from_enu_matrix(case.heading) @ a.gain[:2]
    block = np.linalg.pinv(a.reliability[np.ix_(mode, mode)], rcond=1e-9)
    fault = np.zeros(case.n)
    fault[mode] = block @ gain[axis, mode]
    sigma = np.sqrt(gain[axis, mode] @ fault[mode])
    return np.asarray(size * fault / sigma)


@pytest.mark.parametrize("name", list(OPTIONS))
def test_undetected_faults_exceed_the_level_no_more_often_than_it_allows(name: str) -> None:
    """P(error > PL and no alarm | fault i) <= Q((PL - K sigma_di) / sigma_i), for faults at the edge of detection.

    Priors of 1 % and a risk of 4 %, so that Monte Carlo sees it; a bound fails by chance once in a million.
    """
    options = {key: dict(value) for key, value in OPTIONS[name].items()}
    risk = {
        "integrity_risk": 0.04,
        "satellite_prior": (0.01,) * 5,
        "subtract_multiple": False,
        **options.get("risk", {}),
    }
    if "constellation_prior" in risk:
        risk["constellation_prior"] = (0.01,) * 5
    options["risk"], options["fde"] = risk, {**options.get("fde", {}), "max_excluded": 0}
    config, draws = NavigatorConfig().replace(**options), 1500
    case = Case.of(8, 15, 3)
    case.variance, case.bias = case.accuracy, np.zeros(case.n)
    level, found, k_fa = levels(config, case), case.separation(config), factors(config, case)
    rng, seen, modes = np.random.default_rng(3), 0, case.modes(config)
    slope = (found.delta_m[1:] / found.sigma_m[1:]).max(-1)
    for i in [*np.argsort(-slope[: case.n])[:2], *range(case.n, len(modes))]:
        for axis in range(2):
            allowed = norm.sf((level[axis] - k_fa[i] * found.delta_m[1 + i, axis]) / found.sigma_m[1 + i, axis])
            for size in (0.85, 1.0, 1.15):
                fault = worst_fault(case, modes[i], axis, size * k_fa[i])
                y = rng.normal(size=(draws, case.n)) * np.sqrt(case.accuracy) + fault
                error = y @ found.gain_track[0, axis]
                far = np.abs(error) > level[axis]
                exceeded = int((run_test(config, case, y[far]) == FdeOutcome.CLEAN.code).sum())
                assert exceeded <= binom.isf(1e-6, draws, allowed)
                seen += exceeded
    assert seen > 0


def test_an_exclusion_takes_the_whole_constellation() -> None:
    config = NavigatorConfig().replace(risk=WHOLE)
    assert isinstance(config, RtkReckoningConfig)
    case = Case.of(4, 18, 3)
    shift = -case.los @ np.array([30.0, 20.0, 0.0]) * (case.group == 1)
    x, rows = np.empty(3), rows_of(case.los, case.group, True, case.accuracy, shift)
    thresholds, rules = fde_thresholds(config.tests, case.n, True), fde_parameters(config.tests, True)[0]
    outcome = detect_and_exclude(rows, 0.3, thresholds, rules, x, np.empty((3, 3)))
    assert outcome[0] == FdeOutcome.EXCLUDED.code
    assert outcome[4] == 6
    assert (rows["used"] == (case.group != 1)).all()
    np.testing.assert_allclose(x, 0.0, atol=1e-9)


def test_a_statistic_of_one_row_is_its_separation() -> None:
    """``abs(d_q) / sigma_dq = abs(w)``: the threshold of the w-test is K_fa."""
    direction = NavigatorConfig().replace(fde={"search": Search.DIRECTION})
    w_test = NavigatorConfig().replace(fde={"search": Search.W_TEST})
    for seed in range(4):
        case = Case.of(seed, 13, 3)
        np.testing.assert_array_equal(levels(direction, case), levels(w_test, case))
        assert (levels(w_test, case) < levels(NavigatorConfig(), case)).all()


# Drives

CALM = NavigatorConfig().replace(gnss={"slips_per_h": 0.0, "baseline_km": 0.0, "age_rate_mps": 0.0})
TRACK = SkyTrack.from_config(SkyConfig(), 300.0)
DT, SPEED_MPS, AZIMUTH = 0.1, 10.0, np.array([0.4])


def drive(config: NavigatorConfig, faults: tuple[Fault, ...], seconds: float) -> tuple[list[Solution], Array]:
    """Straight on at constant speed: solutions, and errors (T, 2) along and across."""
    navigator = Navigator(config, TRACK, SkyMask.open(), [7], 1, FaultSchedule(faults))
    along = np.column_stack([np.sin(AZIMUTH), np.cos(AZIMUTH)])
    solutions, errors = [], []
    for k in range(round(seconds / DT)):
        before, after = k * DT * SPEED_MPS, (k + 1) * DT * SPEED_MPS
        truth = truth_between(
            (k + 1) * DT, DT, (along * before, along * after), (along * SPEED_MPS, along * SPEED_MPS),
            (AZIMUTH, AZIMUTH), arc_m=after,
        )  # fmt: skip
        solutions.append(navigator.step(truth))
        gap = solutions[-1].position_en_m[0] - along[0] * after
        errors.append(track_from_enu_matrix(AZIMUTH[0]) @ gap)
    return solutions, np.array(errors)


def check_bounded(solutions: list[Solution], errors: Array) -> None:
    level = np.array([[s.pl_at_m[0], s.pl_ct_m[0]] for s in solutions])
    located = np.array([s.mode[0] != Mode.NONE for s in solutions])
    assert (np.abs(errors) < level)[located].all()


@pytest.mark.parametrize("name", list(OPTIONS))
def test_a_navigator_drives_with_each_test(name: str) -> None:
    """A satellite that drifts by 2 m/s is excluded, and no level is exceeded."""
    config = CALM.replace(**OPTIONS[name])
    clean, errors = drive(config, (), 10.0)
    check_bounded(clean, errors)
    held = int(np.flatnonzero(clean[-1].held[0] & (TRACK.system == System.GPS))[0])
    assert clean[-1].mode[0] == Mode.RTK
    assert clean[-1].pl_at_m[0] < 0.3
    assert not clean[-1].alert[0]
    prn = int(TRACK.prn[held])
    fault = Fault(
        kind="satellite_range", system=System.GPS, prn=prn, magnitude_m=8.0, profile="ramp", ramp_s=4.0, start_s=10.0,
        duration_s=5.0,
    )  # fmt: skip
    faulty, errors = drive(config, (fault,), 13.0)
    check_bounded(faulty, errors)
    assert all(s.mode[0] == Mode.RTK for s in faulty[105:])
    assert all(s.excluded[0] >= 1 for s in faulty[101:])
    assert not faulty[101].held[0][held]


@pytest.mark.parametrize("name", ["default", "reflections"])
@pytest.mark.parametrize("size", [{"magnitude_rank": 1}, {"magnitude_rank": 20}, {"magnitude_cycles": 1}])
def test_wrong_integers_are_detected_and_misled_by_no_level(name: str, size: dict[str, Any]) -> None:
    """Under an open sky of all systems the residuals or the jump refuse the position, or exclude satellites."""
    config = CALM.replace(**REFLECTIONS) if name == "reflections" else CALM
    clean, errors = drive(config, (), 12.0)
    check_bounded(clean, errors)
    held = int(np.flatnonzero(clean[-1].held[0] & (TRACK.system == System.GPS))[0])
    place = {"system": System.GPS, "prn": int(TRACK.prn[held])} if "magnitude_cycles" in size else {}
    fault = Fault(kind="wrong_fix", start_s=10.0, duration_s=2.0, **size, **place)
    faulty, errors = drive(config, (fault,), 12.0)
    check_bounded(faulty, errors)
    assert all(s.mode[0] == Mode.RTK for s in faulty[90:99])
    assert faulty[100].mode[0] != Mode.RTK or faulty[100].excluded[0] > 0


@pytest.mark.parametrize("profile", ["step", "ramp"])
@pytest.mark.parametrize("satellites", [1, 3])
@pytest.mark.parametrize("start_s", [0.0, 10.0])
def test_a_burst_of_reflections_misleads_no_level_of_the_doubtful(
    profile: Any, satellites: int, start_s: float
) -> None:
    """From the first fix on, or while integers are held."""
    config = CALM.replace(**REFLECTIONS)
    fault = Fault(
        kind="nlos_burst", magnitude_m=20.0, satellites=satellites, profile=profile, ramp_s=3.0, start_s=start_s,
        duration_s=8.0,
    )  # fmt: skip
    solutions, errors = drive(config, (fault,), 18.0)
    check_bounded(solutions, errors)
    assert solutions[-1].mode[0] == Mode.RTK


def test_a_displaced_constellation_is_excluded() -> None:
    """More satellites go in one epoch than two tests exclude one by one; two that are left lie abreast the shift."""
    config = CALM.replace(risk=WHOLE)
    fault = Fault(
        kind="constellation", system=System.GALILEO, magnitude_m=2.0, profile="ramp", ramp_s=2.0, start_s=10.0,
        duration_s=10.0,
    )  # fmt: skip
    solutions, errors = drive(config, (fault,), 18.0)
    check_bounded(solutions, errors)
    galileo = TRACK.system == System.GALILEO
    assert (solutions[95].held[0] & galileo).sum() > 3
    assert (solutions[-1].held[0] & galileo).sum() < 3
    assert max(s.excluded[0] for s in solutions[100:]) > 2 * config.fde.max_excluded
    assert solutions[-1].mode[0] == Mode.RTK


def test_the_significance_of_the_test_may_exceed_that_of_the_levels() -> None:
    """Tests of 5 % have lower thresholds than the levels of 1 % count on."""
    loose = NavigatorConfig().replace(fde={"alpha": 0.05})
    case = Case.of(2, 14, 3)
    np.testing.assert_array_equal(levels(loose, case), levels(NavigatorConfig(), case))
    assert FdeConfig(alpha=0.05).tables(14).local_normal[-1, 14] < factors(NavigatorConfig(), case)[0]
