"""Cycle slips: false alarms, missed detections, blind pairs, repairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import binom

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.positioning import cycle_slips_kernel as kernel
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from plain_cycle_slips import RepairStatus, SlipEvidence, detect, remove_common, repair

Array = NDArray[np.float64]
LAMBDA = np.array([0.190293673, 0.244210213])  # GPS L1 and L2
PHASE_M, DOPPLER_MPS, CODE_M, DT_S = 0.003, 0.1, 0.4, 0.1
CONFIG = CycleSlipConfig()
PREDICTED_M, IONO_M = DOPPLER_MPS * DT_S, CONFIG.ionosphere_rate_mps * DT_S


def changes(runs: int, seed: int, slip: tuple[float, float] = (0.0, 0.0)) -> tuple[Array, Array, Array]:
    """Phase changes (runs, 2), code changes (runs, 2) and predictions (runs,) with the stated noise."""
    rng = np.random.default_rng(seed)
    rho = rng.normal(0, 1.0, runs)
    iono = rng.normal(0, IONO_M, runs)
    phase = rho[:, None] + np.sqrt(2) * PHASE_M * rng.standard_normal((runs, 2)) + LAMBDA * np.array(slip)
    phase[:, 1] -= iono
    code = rho[:, None] + np.sqrt(2) * CODE_M * rng.standard_normal((runs, 2))
    return phase, code, rho + rng.normal(0, PREDICTED_M, runs)


def evidence(
    phase: Array, code: Array, p: Array, threshold: float, s_p: float = PREDICTED_M, s_code: float = CODE_M
) -> NDArray[np.int64]:
    """The reference with this file's noise."""
    return detect(phase, LAMBDA, p, PHASE_M, s_p, IONO_M, threshold, code_change_m=code, sigma_code_m=s_code)


def test_false_alarms_stay_within_the_stated_rate() -> None:
    runs, rate = 200_000, 1e-3
    threshold = CycleSlipConfig(false_alarm_rate=rate).threshold
    alarms = int((evidence(*changes(runs, 1), threshold) != 0).sum())
    # Bonferroni bounds the rate from above, by less than a factor of 3 for these correlated tests; once in 10,000 runs
    assert binom.isf(1 - 5e-5, runs, rate / 3) <= alarms <= binom.isf(5e-5, runs, rate)


@pytest.mark.parametrize(
    "slip", [(1, 0), (0, 1), (1, 1), (-1, 1), (4, 3), (9, 7), (77, 60), (0.5, 0), (0, 0.5), (0.5, 0.5)]
)
def test_no_slip_is_missed_at_10_hz(slip: tuple[float, float]) -> None:
    phase, code, p = changes(20_000, 2, slip)
    assert (evidence(phase, code, p, CONFIG.threshold) != 0).all()


def test_blind_pairs_of_each_test() -> None:
    phase, code, p = changes(4000, 3, (9, 7))
    found = evidence(phase, code, p, CONFIG.threshold)
    assert (found & SlipEvidence.GEOMETRY_FREE != 0).mean() < 0.01  # 9 lambda_1 - 7 lambda_2 = 3 mm
    assert (found & SlipEvidence.PREDICTED != 0).all()
    blind = evidence(phase, code, p, CONFIG.threshold, s_p=np.inf)
    assert (blind & SlipEvidence.PREDICTED == 0).all()
    assert (blind & SlipEvidence.CODE_PHASE != 0).mean() < 0.5  # two wide lanes, 1.7 m, in one epoch of code
    smooth = evidence(phase, 0.1 * (code - p[:, None]) + p[:, None], p, CONFIG.threshold, s_p=np.inf, s_code=0.04)
    assert (smooth & SlipEvidence.CODE_PHASE != 0).all()
    equal = evidence(*changes(4000, 4, (5, 5)), CONFIG.threshold)
    assert (equal & SlipEvidence.CODE_PHASE != 0).mean() < 0.01
    assert (equal & SlipEvidence.GEOMETRY_FREE != 0).all()


@given(
    slip=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    seed=st.integers(0, 999),
    dual=st.booleans(),
    g=st.floats(-0.1, 0.1),
    s_p=st.sampled_from([0.01, 0.3, np.inf]),
    s_code=st.sampled_from([0.3, np.inf]),
)
def test_kernel_equals_reference(
    slip: tuple[float, float], seed: int, dual: bool, g: float, s_p: float, s_code: float
) -> None:
    phase, code, p = changes(6, seed, slip)
    phase[0, 1], p[1] = np.nan, np.nan
    lambdas = np.tile(LAMBDA * [1, dual], (6, 1))
    slow = detect(
        phase, lambdas, p, PHASE_M, s_p, IONO_M, 3.0, geometry_free_m=g, code_change_m=code, sigma_code_m=s_code
    )
    deviation = kernel.Deviations(PHASE_M, s_p, IONO_M, s_code)
    for i in range(6):
        change = kernel.Changes(*phase[i], p[i], g, *code[i])
        assert kernel.detect_slip(change, *lambdas[i], deviation, 3.0) == slow[i]


def test_an_active_ionosphere_of_known_rate_is_no_slip() -> None:
    rate = 0.3  # a storm
    phase, code, p = changes(100, 5)
    phase[:, 1] -= rate * DT_S
    assert (evidence(phase, code, p, CONFIG.threshold) != 0).mean() > 0.5
    followed = detect(phase, LAMBDA, p, PHASE_M, PREDICTED_M, IONO_M, CONFIG.threshold, geometry_free_m=rate * DT_S)
    assert (followed == 0).all()


def test_clock_is_the_median_of_its_system() -> None:
    system, member = np.array([0, 0, 0, 0, 1, 1, 2, 2, 2]), np.ones(9, dtype=bool)
    member[3] = False
    change = np.array([1.0, 1.2, 50.0, 9.0, 5.0, 5.0, -1.0, -2.0, -3.0])
    expected = [-0.2, 0.0, 48.8, np.nan, np.nan, np.nan, 1.0, 0.0, -1.0]
    np.testing.assert_allclose(remove_common(change, member, system), expected, atol=1e-12)
    out = np.empty(9)
    kernel.remove_common(change, member, system, 3, out)
    np.testing.assert_allclose(out, expected, atol=1e-12)
    kernel.remove_common(change, member, system, 3, change)  # in place
    np.testing.assert_array_equal(change, out)
    change = np.array([1.0, 1.2, 50.0, 9.0, 5.0, 5.0, -1.0, -2.0, -3.0])
    batch = remove_common(np.stack([change, change + 7.0]), member, system)
    np.testing.assert_allclose(batch, [expected, expected], atol=1e-12)


def repaired(phase: Array, p: float, s_p: float = PREDICTED_M) -> tuple[int, Array]:
    """Kernel repair with this file's noise."""
    slips = np.empty(2)
    status = kernel.repair_slip(
        kernel.Changes(phase[0], phase[1], p, 0.0, 0.0, 0.0), *LAMBDA, kernel.Deviations(PHASE_M, s_p, IONO_M, np.inf),
        CONFIG.repair_failure_rate, CONFIG.fit_limit, slips,
    )  # fmt: skip
    return status, slips


@pytest.mark.parametrize("slip", [(1, 0), (9, 7), (-3, 12), (0, 0), (5, 5)])
def test_repair_finds_the_slip(slip: tuple[float, float]) -> None:
    runs = 300
    phase, _, p = changes(runs, 6, slip)
    statuses = []
    for row, prediction in zip(phase, p, strict=True):
        status, slips = repaired(row, prediction)
        slow, slow_status = repair(row, LAMBDA, prediction, PHASE_M, PREDICTED_M, IONO_M, CONFIG)
        assert status == slow_status
        np.testing.assert_array_equal(slips, slow)
        if status == RepairStatus.REPAIRED:
            np.testing.assert_array_equal(slips, slip)
        statuses.append(status)
    refused = runs - statuses.count(RepairStatus.REPAIRED)
    assert refused <= binom.isf(1e-4, runs, 0.01)  # the fit refuses 0.1 %, the likelihood ratio some more


@pytest.mark.parametrize("slip", [(0.5, 0), (0.5, 0.5), (1, 1.5)])
def test_half_cycles_are_never_repaired(slip: tuple[float, float]) -> None:
    phase, _, p = changes(300, 7, slip)
    statuses = [repaired(row, prediction)[0] for row, prediction in zip(phase, p, strict=True)]
    assert RepairStatus.REPAIRED not in statuses
    assert statuses.count(RepairStatus.HALF_CYCLE) > 290
    slips, status = repair(phase[0], LAMBDA, p[0], PHASE_M, PREDICTED_M, IONO_M)
    assert status == RepairStatus.HALF_CYCLE
    np.testing.assert_array_equal(slips, 0.0)


def test_weak_predictions_and_misfits_are_refused() -> None:
    phase, _, p = changes(50, 8, (9, 7))
    for row, prediction in zip(phase, p, strict=True):
        assert repaired(row, prediction, s_p=0.5)[0] == RepairStatus.NOT_UNIQUE
        assert repair(row, LAMBDA, prediction, PHASE_M, 0.5, IONO_M)[1] == RepairStatus.NOT_UNIQUE
        off = row + np.array([0.045, 0.0])
        assert repaired(off, prediction)[0] in (RepairStatus.INCONSISTENT, RepairStatus.NOT_UNIQUE)
        assert repair(off, LAMBDA, prediction, PHASE_M, PREDICTED_M, IONO_M)[1] != RepairStatus.REPAIRED
    assert repair(phase[0], LAMBDA * [1, 0], p[0], PHASE_M, PREDICTED_M, IONO_M)[1] == RepairStatus.NOT_UNIQUE
    assert repaired(np.full(2, np.nan), 0.0)[0] == RepairStatus.NOT_UNIQUE
    assert repaired(phase[0], p[0], s_p=np.inf)[0] == RepairStatus.NOT_UNIQUE


def test_misuse_is_an_error() -> None:
    with pytest.raises(InputError, match="phase_change_m"):
        detect(np.zeros(3), LAMBDA, 0.0, 0.003, 0.01, 0.0, 4.0)
    with pytest.raises(ConfigError, match="false_alarm_rate"):
        CycleSlipConfig(false_alarm_rate=0.0)
