"""Accuracy, availability, continuity, outages and bounding against closed forms and published intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, norm

from lanebound.integrity.assessment.accuracy import (
    accuracy_by_mode,
    availability_by_mode,
    bounding_by_mode,
    clopper_pearson,
    doubt,
    find_outages,
    integrity_available,
    measure_accuracy,
    measure_bounding,
    mode_share,
)
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.modes import Mode


@pytest.fixture
def drive() -> Record:
    mode = np.array([1, 1, 1, 1, 2, 2, 0, 0])
    error = np.array([0.1, -0.1, 0.2, 0.0, 0.5, 1.5, 9.0, 9.0])
    pl = np.array([0.3, 0.3, 0.15, 0.3, 1.2, 0.8, np.inf, np.inf])
    quiet = np.zeros(8, dtype=bool)
    return Record(np.arange(8) * 0.5, mode, error, error / 2, pl, pl, quiet, ~quiet)


def test_accuracy_of_gaussian_errors() -> None:
    sample = norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    figures = measure_accuracy(0.3 * sample)
    assert figures.median_m == pytest.approx(0.3 * 0.6745, rel=1e-3)
    assert figures.p95_m == pytest.approx(0.3 * 1.96, rel=1e-3)
    assert figures.rmse_m == pytest.approx(0.3, rel=1e-3)
    assert figures.mean_m == pytest.approx(0.0, abs=1e-12)


def test_accuracy_by_mode_leaves_out_epochs_without_position(drive: Record) -> None:
    table = accuracy_by_mode(drive)
    assert list(table) == ["rtk", "doppler", "all"]
    assert table["rtk"]["at"]["median_m"] == pytest.approx(0.1)
    assert table["all"]["at"]["epochs"] == 6
    assert table["all"]["at"]["max_m"] == 1.5
    with pytest.raises(InputError, match="error_m"):
        measure_accuracy([])


def test_mode_share(drive: Record) -> None:
    shares = mode_share(drive)
    assert {key: share for key, share in shares.items() if share} == {"none": 0.25, "rtk": 0.5, "doppler": 0.25}
    assert list(shares) == [mode.key for mode in Mode]


def test_availability(drive: Record) -> None:
    assert integrity_available(drive, 1.0, 1.0).tolist() == [True] * 4 + [False, True, False, False]
    assert availability_by_mode(drive, 1.0, 1.0) == {"rtk": 1.0, "doppler": 0.5, "all": 0.625}
    assert availability_by_mode(drive, 1.0, 0.2)["rtk"] == 0.25
    with pytest.raises(InputError, match="al_ct_m"):
        integrity_available(drive, 1.0, 0.0)


def test_outages_by_hand() -> None:
    service = np.array([[1, 0], [0, 1], [0, 1], [1, 0], [0, 0]], dtype=bool)
    outages = find_outages(service, [0.0, 1.0, 2.0, 3.0, 4.0])
    assert outages.start_s.tolist() == [1.0, 4.0, 0.0, 3.0]
    assert outages.length_s.tolist() == [2.0, 1.0, 1.0, 2.0]
    summary = outages.summary()
    assert (summary["count"], summary["min_s"], summary["median_s"], summary["max_s"], summary["total_s"]) == (
        4,
        1,
        1.5,
        2,
        6,
    )
    assert find_outages([True, True], [0.0, 1.0]).summary()["count"] == 0


@pytest.mark.parametrize(
    ("events", "trials", "low", "high"),
    [
        (0, 10, 0.0, 0.3085),  # rule of three, exact: 1 - 0.025^(1/10)
        (1, 10, 0.0025, 0.4450),
        (5, 10, 0.1871, 0.8129),
        (10, 10, 0.6915, 1.0),
    ],
)
def test_clopper_pearson_golden(events: int, trials: int, low: float, high: float) -> None:
    """Clopper and Pearson (1934); the usual table of exact 95 % intervals for n = 10."""
    assert clopper_pearson(events, trials) == (pytest.approx(low, abs=5e-5), pytest.approx(high, abs=5e-5))


def test_clopper_pearson_inverts_the_binomial() -> None:
    low, high = clopper_pearson(7, 900, 0.9)
    assert binom.sf(6, 900, low) == pytest.approx(0.05, rel=1e-9)
    assert binom.cdf(7, 900, high) == pytest.approx(0.05, rel=1e-9)
    with pytest.raises(InputError, match="events"):
        clopper_pearson(5, 4)


def test_bounding(drive: Record) -> None:
    bound = measure_bounding(drive.error("at")[:6], drive.pl("at")[:6])
    assert (bound.exceeded, bound.epochs, bound.rate) == (2, 6, pytest.approx(1 / 3))
    assert bound.ratio_min == pytest.approx(0.8 / 1.5)
    assert bound.rate_low < 1 / 3 < bound.rate_high
    assert bounding_by_mode(drive)["rtk"]["ct"]["exceeded"] == 0
    with pytest.raises(InputError, match="shape"):
        measure_bounding([1.0], [1.0, 2.0])


def test_bounding_without_levels_or_errors_stays_finite() -> None:
    none = measure_bounding([1.0, 2.0], [np.inf, np.inf])
    assert (none.exceeded, none.pl_median_m, none.ratio_min) == (0, None, None)
    assert measure_bounding([0.0], [1.0]).exceeded == 0


@pytest.mark.parametrize(("over", "cases", "risk"), [(1, 50, 1e-5), (2, 50, 1e-3), (3, 50, 1e-3), (3, 1000, 1e-3)])
def test_levels_are_doubted_where_the_binomial_tail_of_the_risk_is_below_one_in_a_thousand(
    over: int, cases: int, risk: float
) -> None:
    error = np.zeros((cases, 4, 2))
    error[:over, 1:] = -2.0  # several in one case count once
    told = doubt(risk, error, np.ones_like(error), "outages")
    assert (told is not None) == (over > 1 and binom.sf(over - 1, cases, risk) < 1e-3)
    if told:
        assert told.startswith(f"errors exceed their levels in {over} of {cases} outages, at a risk of {risk:g}: ")
