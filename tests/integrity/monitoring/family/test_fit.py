"""The solution with eliminated clocks against least squares with clock columns."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import quiet, sky
from signed_w import w_statistics

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.detection import adjust, diagonal_covariance
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import row_correlation, solve_codes
from lanebound.integrity.positioning.least_squares import Solvability, design_matrix


def masked(seed: int = 3) -> CodeEpochs:
    rng = np.random.default_rng(seed)
    e = quiet(50, 14, 3, seed)
    return e.with_codes(sigma_m=rng.uniform(0.5, 5.0, e.y_m.shape), used=rng.random(e.y_m.shape) < 0.85)


def test_the_solution_is_that_of_least_squares_with_clock_columns() -> None:
    e = masked()
    fit = solve_codes(e)
    design = design_matrix(e.los_enu, np.broadcast_to(e.system, e.y_m.shape), 3)
    plain = adjust(design, diagonal_covariance(e.sigma_m**2), e.y_m, e.used)
    assert fit.solved.all()
    np.testing.assert_allclose(fit.x_m, plain.x[:, :3], atol=1e-9)
    np.testing.assert_allclose(fit.residual_m, plain.residual, atol=1e-9)
    np.testing.assert_allclose(np.swapaxes(fit.gain, 1, 2), plain.gain[:, :3], atol=1e-9)
    np.testing.assert_array_equal(fit.df, plain.df)
    m = np.diagonal(plain.reliability, axis1=1, axis2=2) * e.sigma_m**2
    np.testing.assert_allclose(fit.redundancy, np.where(e.used, m, 0.0), atol=1e-9)
    np.testing.assert_allclose(np.abs(fit.normalised), np.abs(w_statistics(plain)), atol=1e-7)


def test_the_correlation_of_tests_is_that_of_the_covariance_of_residuals() -> None:
    e = masked(4)
    fit = solve_codes(e)
    design = design_matrix(e.los_enu, np.broadcast_to(e.system, e.y_m.shape), 3)
    plain = adjust(design, diagonal_covariance(e.sigma_m**2), e.y_m, e.used)
    row = np.array([np.flatnonzero(used)[2] for used in e.used])
    found = row_correlation(fit, e.system, row)
    q = plain.reliability  # W Q_e W
    d = np.sqrt(np.maximum(np.diagonal(q, axis1=1, axis2=2), 0.0))
    at = np.arange(e.count)
    wanted = q[at, row] / np.where(d > 0.0, d, 1.0) / d[at, row][:, None]
    np.testing.assert_allclose(np.where(e.used, found, 0.0), np.where(e.used, wanted, 0.0), atol=1e-8)


def test_what_cannot_be_solved_is_an_outcome() -> None:
    rng = np.random.default_rng(5)
    few = CodeEpochs.of(np.zeros((1, 3)), sky(rng, 3))
    assert solve_codes(few).status[0] == Solvability.TOO_FEW.code
    same = np.broadcast_to(sky(rng, 1), (1, 6, 3))
    assert solve_codes(CodeEpochs.of(np.zeros((1, 6)), same)).status[0] == Solvability.SINGULAR.code
    alone = CodeEpochs.of(np.ones((1, 6)), sky(rng, 6), 1.0, True, np.array([0, 0, 0, 0, 0, 1]))
    fit = solve_codes(alone)  # the clock of the second system takes its only code
    assert fit.df[0] == 1
    assert fit.redundancy[0, 5] == pytest.approx(0.0)
    assert fit.slopes()[0, 5] == 0.0


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"y_m": np.full((1, 6), np.nan)}, "y_m must be finite"),
        ({"sigma_m": np.full((1, 6), -1.0)}, "sigma_m must be finite and in"),
        ({"system": np.full(6, 9)}, "system must lie in"),
        ({"los_enu": np.zeros((1, 6, 3))}, "unit vectors"),
    ],
)
def test_bad_input_is_refused_by_name(changed: dict[str, object], words: str) -> None:
    e = CodeEpochs.of(np.zeros((1, 6)), sky(np.random.default_rng(6), 6))
    with pytest.raises(InputError, match=words):
        CodeEpochs(**{**vars(e), **changed}).checked()
