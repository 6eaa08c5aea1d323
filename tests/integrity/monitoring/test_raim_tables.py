"""Thresholds, non-centralities and factors of RAIM as others printed them."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.monitoring.detection import chi2_threshold
from lanebound.integrity.monitoring.risk import upper_quantile
from lanebound.integrity.monitoring.sbas import Operation
from lanebound.integrity.monitoring.significance import noncentrality

# L3NAV, gps_example_11 (tables XFDNT): sqrt of the chi-square threshold for 1, 2, ... degrees of freedom, printed to
# five decimals and to five of another program's.
THRESHOLDS = {
    6.666667e-5: [
        3.98792,
        4.38539,
        4.6856,
        4.93879,
        5.16259,
        5.36564,
        5.55301,
        5.72792,
        5.89265,
        6.04884,
        6.1977,
        6.3402,
        6.4771,
        6.60904,
        6.73654,
        6.86,
    ],
    3.3333e-7: [5.10383, 5.46152, 5.73854, 5.97522, 6.18628, 6.379, 6.55774, 6.72514, 6.88354, 7.03383],
}
# pbias, sqrt of the non-centrality for a missed detection of 1e-3, derived with scipy.stats.ncx2.
BIASES = {
    6.666667e-5: [
        7.07811123090967,
        7.388286246908094,
        7.609083319743553,
        7.787999932969887,
        7.941325840996915,
        8.076947590113479,
        8.199395036485477,
        8.311554898186833,
        8.415400702305586,
        8.512352056763147,
    ],
    3.3333e-7: [
        8.193788200620213,
        8.478591933006332,
        8.687491003865421,
        8.85972054987256,
        9.00906976612869,
        9.142339134873033,
        9.263493303444408,
        9.375090282555572,
        9.478897376595986,
        9.576197464203858,
    ],
}


@pytest.mark.parametrize(("false_alarm", "tolerance"), [(6.666667e-5, 1e-4), (3.3333e-7, 5e-4)])
def test_chi_square_thresholds(false_alarm: float, tolerance: float) -> None:
    printed = THRESHOLDS[false_alarm]
    found = np.sqrt(chi2_threshold(false_alarm, np.arange(1, len(printed) + 1)))
    np.testing.assert_allclose(found, printed, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("false_alarm", list(BIASES))
def test_noncentralities(false_alarm: float) -> None:
    found = [np.sqrt(noncentrality(false_alarm, 0.999, df)) for df in range(1, 11)]
    np.testing.assert_allclose(found, BIASES[false_alarm], rtol=1e-6)


@pytest.mark.parametrize(
    ("alpha", "power", "shift"),
    [(1e-3, 0.8, 4.132147965064808), (1e-2, 0.8, 3.417450537121815), (1e-4, 0.9, 5.1721434519576945)],
)
def test_constants_of_the_w_test(alpha: float, power: float, shift: float) -> None:
    """Baarda's delta_0; lambda_0 = delta_0^2 but for the other tail, whose share is below 1e-7."""
    assert np.sqrt(noncentrality(alpha, power)) == pytest.approx(shift, rel=1e-6)


def test_factors_of_do_229() -> None:
    """K_V 5.33 is two-sided at 1e-7; K_H 6.18 is Rayleigh's at 5e-9."""
    assert upper_quantile(0.5e-7) == pytest.approx(5.326723886384496, rel=1e-12)
    assert np.sqrt(-2.0 * np.log(5e-9)) == pytest.approx(6.182851756998919, rel=1e-12)
    assert Operation.PRECISION_APPROACH.value == (6.0, pytest.approx(5.3267, abs=5e-3))
    assert Operation.EN_ROUTE.value[0] == pytest.approx(6.1829, abs=5e-3)
    levels = {1e-3: 3.2905267314918945, 1e-4: 3.890591886413094, 1e-5: 4.417173413469023, 1e-6: 4.891638475698591}
    for risk, factor in levels.items():
        assert upper_quantile(0.5 * risk) == pytest.approx(factor, rel=1e-12)
