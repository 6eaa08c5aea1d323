"""Shared codes and the filter of all vehicles: least squares, honest covariances, nodes that contradict."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from lanebound.agents.studies.cooperative import CooperativeStudyConfig, moments, work_drive
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.navigators.fleet import Fleet, FleetConfig
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.positioning.cooperative.exclusion import ExclusionConfig, NodeBank
from lanebound.integrity.positioning.cooperative.factors import joint_solution
from lanebound.integrity.positioning.cooperative.joint_filter import Codes, JointFilter, JointFilterConfig
from lanebound.integrity.positioning.cooperative.shared_codes import clock_free, double_differences

SYSTEM = np.array([0] * 7 + [1] * 6)


def directions(rng, count):
    azimuth, sine = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.25, 1.0, count)
    cosine = np.sqrt(1.0 - sine**2)
    return np.stack([cosine * np.sin(azimuth), cosine * np.cos(azimuth), sine], -1)


@pytest.mark.parametrize("seed", range(6))
def test_differences_that_share_codes_never_promise_too_much(seed):
    """The covariance that factors of all pairs promise against that of their solution, for any net and satellites."""
    rng = np.random.default_rng(seed)
    nodes, los = 5, directions(rng, len(SYSTEM))
    every = np.array([(i, j) for i in range(nodes) for j in range(i)])
    pairs = every[rng.random(len(every)) < 0.7]
    used = rng.random((nodes, len(SYSTEM))) < 0.9
    variance = rng.uniform(0.1, 4.0, used.shape)
    nothing, prior = np.zeros((nodes, 3)), np.eye(3 * nodes) * 100.0

    def solve(code):
        factors = double_differences(pairs, los, code, variance, used, SYSTEM, np.zeros_like(variance))
        return joint_solution(nothing, prior, factors)

    promised = solve(np.zeros_like(variance))[1]
    gain = np.array([solve(one.reshape(used.shape))[0].reshape(-1) for one in np.eye(used.size)])
    # Of the prior's error (100 m^2, independent) the solution keeps promised / prior.
    kept = promised @ np.linalg.inv(prior)
    true = (gain.T * np.where(used, variance, 0.0).reshape(-1)) @ gain + kept @ prior @ kept.T
    assert np.linalg.eigvalsh(promised - true).min() > -1e-9


def test_two_nodes_alone_lose_nothing():
    """With one difference the factor is that of least squares with a clock for each system."""
    rng = np.random.default_rng(1)
    los, variance = directions(rng, len(SYSTEM)), rng.uniform(0.2, 2.0, (2, len(SYSTEM)))
    code = rng.normal(size=variance.shape)
    factors = double_differences(
        np.array([(0, 1)]), los, code, variance, np.ones_like(variance, bool), SYSTEM, np.zeros_like(variance)
    )
    design = np.concatenate([-los, SYSTEM[:, None] == np.arange(2)], 1)
    weight = np.diag(1.0 / variance.sum(0))
    solution, *_ = np.linalg.lstsq(np.sqrt(weight) @ design, np.sqrt(weight) @ (code[0] - code[1]), rcond=None)
    assert np.allclose(np.linalg.solve(factors.information[0], factors.vector[0]), solution[:3], atol=1e-10)
    assert np.allclose(np.linalg.inv(factors.information[0]), np.linalg.inv(design.T @ weight @ design)[:3, :3])


def test_clocks_are_free():
    weight = clock_free(np.array([1.0, 2.0, 0.0, 4.0]), np.array([0, 0, 0, 1]))
    assert np.allclose(weight @ [5.0, 5.0, 5.0, 9.0], 0.0)
    assert np.allclose(weight[2], 0.0)


def still_fleet(rng, vehicles=2, units=1):
    """A filter of vehicles at rest, its state, satellites and a draw of codes with all of its declared errors."""
    config = JointFilterConfig(codes=CodeErrorBudget(multipath_m=0.0), gate_sigmas=50.0)
    los, places = directions(rng, len(SYSTEM)), 50.0 * rng.normal(size=(units, 3))
    joint = JointFilter(config, vehicles, SYSTEM, places)
    truth = 30.0 * rng.normal(size=(vehicles, 3))
    state = joint.start((truth + config.start_m * rng.normal(size=truth.shape))[None], np.zeros((1, vehicles)))
    nodes = vehicles + units
    cn0 = np.full((1, nodes, len(SYSTEM)), 45.0)
    parts, white, _ = joint.errors(los, cn0, np.ones((1, nodes, 1), bool))
    own, common = rng.normal(size=len(SYSTEM)), rng.normal(size=2)

    def draw():
        clock = 100.0 * rng.normal(size=(nodes, 2))[:, SYSTEM]
        position = np.concatenate([truth, places])
        noise = np.sqrt(white[0]) * rng.normal(size=cn0.shape[1:])
        code = -position @ los.T + clock + np.sqrt(parts.own_m2[0]) * own + parts.common_m[0] @ common + noise
        return Codes(code, np.zeros_like(code), cn0[0], np.ones(code.shape, bool))

    return joint, state, los, truth, draw


def test_the_filter_equals_least_squares_of_all_epochs():
    """Vehicles at rest: state after n epochs against the normal equations of all rows, clocks as unknowns."""
    rng = np.random.default_rng(4)
    joint, state, los, _, draw = still_fleet(rng)
    start, prior = state.mean[0].copy(), state.covariance[0].copy()
    normal, right = np.linalg.inv(prior), np.linalg.inv(prior) @ start
    for _ in range(3):
        codes = draw()
        parts, white, lasting = joint.errors(los, codes.cn0_dbhz[None], np.zeros((1, 3, 1), bool))
        design, expected = joint.code_rows(state, los, parts, lasting)
        offset = np.einsum("nsk,k->ns", design[0], state.mean[0]) - expected[0]
        weight = clock_free(1.0 / white[0], SYSTEM)
        normal = normal + np.einsum("nsi,nst,ntj->ij", design[0], weight, design[0])
        right = right + np.einsum("nsi,nst,nt->i", design[0], weight, codes.code_m + offset)
        joint.update(state, los, codes)
    # Range rates of vehicles at rest carry nothing: their rows of heading and scale are 0.
    assert np.allclose(state.mean[0], np.linalg.solve(normal, right), atol=1e-6)
    assert np.allclose(state.covariance[0], np.linalg.inv(normal), atol=1e-9)


def test_the_filter_meets_its_covariance():
    """Linear and Gaussian, so that the covariance is the Cramer-Rao bound: squared errors of 300 draws are chi^2."""
    rng = np.random.default_rng(8)
    squares = []
    for _ in range(300):
        joint, state, los, truth, draw = still_fleet(rng)
        for _ in range(4):
            joint.update(state, los, draw())
        error = (joint.positions(state)[0, :2] - truth).reshape(-1)
        squares.append(error @ np.linalg.solve(joint.covariances(state)[0].reshape(6, 6), error))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 6 * len(squares))
    assert low < np.sum(squares) < high


def test_a_unit_that_shares_its_codes_makes_vehicles_better():
    sigma = {}
    for units in (0, 1):
        joint, state, los, _, draw = still_fleet(np.random.default_rng(6), units=units)
        for _ in range(3):
            joint.update(state, los, draw())
        sigma[units] = np.sqrt(joint.covariances(state)[0][0, :2, 0, :2].trace())
    assert sigma[1] < 0.4 * sigma[0]


def drive(case_sky, lie=None, uwb=True, seconds=45.0, **options):
    """A short drive of the study; the fleet and what was found in its last epoch, with the truth."""
    config = CooperativeStudyConfig(skies=(case_sky,), warm_up_s=0.0, duration_s=seconds, street_m=500.0)
    rng, fleet, found = np.random.default_rng(1), None, []
    for k, moment in enumerate(moments(config, case_sky, 0, uwb)):
        truth = moment.truth.position_enu_m
        if moment.truth.time_s > seconds:
            break
        if fleet is None:
            places = truth[2:].copy()
            if lie is not None:
                places[0] += lie
            fleet = Fleet(config.fleet(case_sky, "levels").replace(**options), 2, moment.measured.sky.system, places)
            fleet.start(truth[:2] + 3.0 * rng.normal(size=(2, 3)), moment.truth.heading_rad[:2] + 0.02)
        fleet.move(moment.measured)
        if (k + 1) % 10 == 0:
            found.append((truth[:2], fleet.share(moment.measured, moment.pairs, moment.ranges)))
    return fleet, found


def test_a_wrong_unit_is_found_and_levels_hold():
    fleet, found = drive("open", lie=np.array([6.0, 5.0, 0.0]))
    assert [(x.node, x.what) for x in fleet.bank.excluded] == [(2, "node")]
    for truth, placed in found:
        error = np.abs(placed["ekf"].position_m - truth)[:, :2]
        assert (error < placed["ekf"].level_m).all()


def test_a_vehicle_that_lies_is_found_by_its_codes():
    config = CooperativeStudyConfig(skies=("open",), cases=("vehicle",), warm_up_s=20.0, duration_s=20.0)
    found = work_drive(config, "0-3")["vehicle"]
    assert (found["found"], found["innocent"], found["beyond"]) == (1.0, 0.0, 0.0)
    assert found["delay_s"] < 5.0


def test_measurements_that_are_not_numbers_are_left_out():
    joint, state, los, _, draw = still_fleet(np.random.default_rng(2))
    codes = draw()
    codes.code_m[0, 3], codes.rate_mps[1, 2] = np.nan, np.inf
    used = joint.update(state, los, codes)
    assert not used[0, 0, 3]
    joint.update_ranges(state, np.array([(0, 1), (0, 2)]), np.array([np.nan, 60.0]), np.array([0.1, 0.1]))
    assert np.isfinite(state.mean).all()
    assert np.isfinite(state.covariance).all()


def test_priors_must_leave_two_faults_rarer_than_the_risk():
    joint, _, _, truth, _ = still_fleet(np.random.default_rng(2))
    with pytest.raises(InputError, match="prior must be so small that two faults are rarer than integrity_risk 1e-05"):
        NodeBank.start(ExclusionConfig(prior=1e-3), joint, truth, np.zeros(2))


def test_without_a_fault_nobody_is_excluded_and_cooperation_pays():
    fleet, found = drive("open")
    assert fleet.bank.excluded == []
    rms = {
        name: np.sqrt(np.mean([np.square((placed[name].position_m - truth)[:, :2]) for truth, placed in found[15:]]))
        for name in ("local", "ekf")
    }
    assert rms["ekf"] < 0.4 * rms["local"]


def test_all_estimators_run_with_codes_and_ranges():
    names = ("ekf", "mdpc", "spawn", "md_spawn", "gaussian", "split")
    _, found = drive("open", seconds=25.0, estimators=names, exclusion=None, network={"particles": 200})
    truth, placed = found[-1]
    assert set(placed) == {"local", *names}
    for name in names:
        assert np.linalg.norm((placed[name].position_m - truth)[:, :2], axis=-1).max() < 1.5, name


def test_measurements_must_fit_the_fleet():
    config = CooperativeStudyConfig(skies=("open",), street_m=500.0)
    moment = next(moments(config, "open", 0, False))
    fleet = Fleet(FleetConfig(), 3, moment.measured.sky.system, moment.truth.position_enu_m[2:])
    fleet.start(np.zeros((3, 3)), np.zeros(3))
    with pytest.raises(InputError, match="m must have 5 nodes, vehicles and roadside units, got 4"):
        fleet.share(moment.measured, moment.pairs, moment.ranges)
