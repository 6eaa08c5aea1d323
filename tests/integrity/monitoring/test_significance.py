"""Significance levels: Baarda's tables, their inverses, Bonferroni, and the threshold tables."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, ncx2, norm

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.significance import (
    Linking,
    baarda_global_significance,
    baarda_local_significance,
    noncentrality,
    significances,
    threshold_tables,
)


@pytest.mark.parametrize(
    ("alpha", "power", "published"),
    [(0.001, 0.80, 17.07), (0.001, 0.50, 10.83), (0.01, 0.80, 11.68), (0.05, 0.80, 7.85)],
)
def test_noncentrality_golden(alpha: float, power: float, published: float) -> None:
    """Baarda (1968), nomograms; Teunissen, Testing Theory (2006), appendix: one degree of freedom."""
    assert noncentrality(alpha, power) == pytest.approx(published, abs=0.01)


@pytest.mark.parametrize("df", [1, 3, 12, 40])
def test_noncentrality_gives_its_power(df: int) -> None:
    lam = noncentrality(0.01, 0.8, df)
    assert ncx2.sf(chi2.isf(0.01, df), df, lam) == pytest.approx(0.8, rel=1e-8)


@pytest.mark.parametrize("df", [1, 2, 7, 30, 100])
def test_baarda_local_is_the_inverse_of_global(df: int) -> None:
    assert baarda_local_significance(baarda_global_significance(0.001, 0.8, df), 0.8, df) == pytest.approx(
        0.001, rel=1e-9
    )


def test_baarda_links_nothing_at_one_degree_of_freedom() -> None:
    assert baarda_global_significance(0.003, 0.8, 1) == pytest.approx(0.003, rel=1e-9)


def test_global_significance_grows_with_redundancy() -> None:
    sizes = [baarda_global_significance(0.001, 0.8, df) for df in range(1, 30)]
    assert np.all(np.diff(sizes) > 0.0)


def test_significances_by_linking() -> None:
    assert significances(0.01, 5, 10, Linking.BONFERRONI, 0.8) == (0.01, pytest.approx(0.001))
    assert significances(0.01, 5, 10, Linking.BAARDA_FROM_GLOBAL, 0.8)[0] == 0.01
    assert significances(0.001, 5, 10, Linking.BAARDA_FROM_LOCAL, 0.8)[1] == 0.001


def test_tables_hold_the_papers_thresholds() -> None:
    tables = threshold_tables(0.01, 20, axes=2)
    assert tables.global_chi2[6] == pytest.approx(chi2.isf(0.01, 6), rel=1e-12)
    assert tables.local_normal[6, 10] == pytest.approx(norm.isf(0.01 / (2 * 2 * 10)), rel=1e-12)  # S2 eq 8
    assert np.isinf(tables.global_chi2[0])
    assert np.isinf(tables.local_normal[0]).all()


def test_tables_link_by_redundancy() -> None:
    tables = threshold_tables(0.001, 12, Linking.BAARDA_FROM_LOCAL, 0.8)
    assert tables.local_normal[5, 9] == pytest.approx(norm.isf(0.0005), rel=1e-12)
    assert tables.global_chi2[5] == pytest.approx(chi2.isf(baarda_global_significance(0.001, 0.8, 5), 5), rel=1e-9)


@pytest.mark.parametrize("bad", [(0.0, 0.8, 1), (0.01, 1.0, 1), (0.01, 0.8, 0), (0.5, 0.2, 1)])
def test_noncentrality_refuses(bad: tuple[float, float, int]) -> None:
    with pytest.raises(InputError, match="must"):
        noncentrality(*bad)


def test_tables_refuse_empty() -> None:
    with pytest.raises(InputError, match="n_max"):
        threshold_tables(0.01, 0)
