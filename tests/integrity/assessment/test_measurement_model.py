"""Random geometries: their levels are the layer's, and their matrices do what an adjustment does."""

from __future__ import annotations

import numpy as np
import pytest
from plain_closed_form import plain_levels

from lanebound.integrity.assessment.exceedance import Case, Form, Worst, draw_case, prepare
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.detection import adjust, diagonal_covariance
from lanebound.integrity.monitoring.risk import RiskConfig, Variant
from lanebound.integrity.monitoring.separation import separate
from lanebound.integrity.positioning.least_squares import design_matrix

RULES = RiskConfig(satellite_prior=(1e-5,) * 5)
RISKS = np.array([1e-3, 1e-5])


def cases(count: int = 6, seed: int = 2) -> list[Case]:
    rng = np.random.default_rng(seed)
    return [draw_case(rng, int(n), 2.0) for n in rng.integers(5, 36, count)]


def design(case: Case) -> np.ndarray:
    return design_matrix(case.los_enu, case.group, int(case.group.max()) + 1)


def test_levels_are_those_of_the_layer() -> None:
    drawn = cases()
    for case, one in zip(drawn, prepare(drawn, RULES, RISKS, 1e-6), strict=True):
        n = len(case)
        arguments = (design(case), np.diag(case.sigma_m**2), np.eye(n, dtype=bool), case.heading_rad)
        exact = separate(*arguments, bias=case.bias_bound_m)
        printed = separate(*arguments, bias=case.bias_bound_m, variant=Variant.PUBLISHED)
        prior = np.full(n, 1e-5)
        for form, root in ((Form.ROOT, True), (Form.CLOSED, False)):
            expected = plain_levels(exact, prior, RULES, RISKS, spent=1e-6, root=root)
            np.testing.assert_allclose(one.levels_m[form], expected, rtol=1e-8)
        as_printed = plain_levels(printed, prior, RULES.replace(variant=Variant.PUBLISHED), RISKS, root=False)
        np.testing.assert_allclose(one.levels_m[Form.PUBLISHED], as_printed, rtol=1e-9)
        assert (one.levels_m[Form.BIAS] <= one.levels_m[Form.CLOSED] * (1.0 + 1e-12)).all()
        assert (one.levels_m[Form.THRESHOLD] <= one.levels_m[Form.CLOSED] * (1.0 + 1e-12)).all()


def test_matrices_do_what_an_adjustment_does() -> None:
    rng = np.random.default_rng(4)
    drawn = cases(4)
    for case, one in zip(drawn, prepare(drawn, RULES, RISKS), strict=True):
        n, normal, size, k = len(case), rng.standard_normal(len(case)), 0.3, len(case) // 2
        y = case.bias_m + case.sigma_m * normal + size * (np.arange(n) == k)
        full = adjust(design(case), diagonal_covariance(case.sigma_m**2), y)
        turn = track_from_enu_matrix(case.heading_rad)
        error = one.error_rows @ normal + one.shift + size * one.fault_error[k]
        np.testing.assert_allclose(error, turn @ full.x[:2], atol=1e-12)
        statistic = one.test_rows @ normal + one.test_shift + size * one.fault_test[k]
        for j in range(n):
            part = adjust(design(case), diagonal_covariance(case.sigma_m**2), y, np.arange(n) != j)
            if not part.solvable:
                continue
            apart = turn @ (full.x[:2] - part.x[:2])
            rows = turn @ (full.gain[:2] - part.gain[:2])
            sigma = np.sqrt(((rows * case.sigma_m) ** 2).sum(-1))
            if sigma.max() > 1e-9:
                axis = int(sigma.argmax())
                assert statistic[j] == pytest.approx(apart[axis] / sigma[axis], abs=1e-6)


def test_a_fault_of_any_satellite_moves_its_own_separation_to_either_side() -> None:
    """Separations are signed: half of the satellites were taken for such that no fault can be in."""
    for one in prepare(cases(20), RULES, RISKS):
        own = np.diag(one.fault_test)
        moves = np.abs(one.fault_error).max(-1) > 1e-9  # not so the only one of its clock, which can do no harm
        np.testing.assert_allclose(np.abs(own) * one.sigma_of_fault_m, moves)
        assert {-1.0, 1.0} <= set(np.sign(own))


def test_errors_have_nothing_in_common_with_separations() -> None:
    """Of a solution of least variance; closed forms of misleading faults are products because of it."""
    for one in prepare(cases(), RULES, RISKS):
        sigma = np.linalg.norm(one.error_rows, axis=-1)[:, None]
        np.testing.assert_allclose(one.error_rows @ one.test_rows.T / sigma, 0.0, atol=1e-9)


def test_biases_are_at_their_bounds_and_hurt_the_axis_named() -> None:
    drawn = cases(20)
    for case, one in zip(drawn, prepare(drawn, RULES, RISKS), strict=True):
        np.testing.assert_allclose(np.abs(case.bias_m), case.bias_bound_m)
        assert (case.bias_bound_m <= 2.0 * case.sigma_m).all()
        most = np.abs(one.fault_error).T @ case.bias_bound_m
        assert (np.abs(one.shift) <= most * (1.0 + 1e-12)).all()
        if case.worst is not Worst.NEITHER:
            assert one.shift[case.worst.value] == pytest.approx(most[case.worst.value])
    assert {case.worst for case in drawn} == set(Worst)


def test_too_few_satellites_are_refused() -> None:
    with pytest.raises(InputError, match="at least 5"):
        draw_case(np.random.default_rng(0), 4)


@pytest.mark.parametrize("form", Form)
def test_every_form_says_what_it_is(form: Form) -> None:
    assert len(form.meaning) > 20
