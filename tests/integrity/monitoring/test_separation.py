"""The plain solution separation against its definition, and the kernels against the plain form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_records import rows_of

from fault_rows import constellation_modes, satellite_modes
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.small_matrix_kernel import hdop_of
from lanebound.integrity.monitoring.risk import Variant
from lanebound.integrity.monitoring.separation import Separation, published_bias, separate
from lanebound.integrity.monitoring.separation_kernel import Modes, find_modes, mode_scratch, moment_scratch, set_priors
from lanebound.integrity.positioning import geometry_kernel as gk
from lanebound.integrity.positioning.least_squares import design_matrix
from plain_least_squares import dilution, solve

PRIORS = np.full(gk.MAX_GROUPS, 1e-5)


class Case:
    """A random epoch."""

    def __init__(self, seed: int, n: int, systems: int) -> None:
        rng = np.random.default_rng(seed)
        elevation = np.arcsin(rng.uniform(0.14, 1.0, n))
        azimuth = rng.uniform(0.0, 2.0 * np.pi, n)
        flat = np.cos(elevation)
        self.los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
        self.group = rng.permutation(np.arange(n) % systems).astype(np.int64)
        self.variance, self.accuracy = rng.uniform(0.2, 2.0, n), rng.uniform(0.1, 1.0, n)
        self.bias, self.y = rng.uniform(0.0, 0.5, n), rng.normal(size=n)
        self.heading = rng.uniform(-np.pi, np.pi)
        self.n = n

    def reference(self, constellations: bool = True, variant: Variant = Variant.EXACT) -> Separation:
        removed = np.eye(self.n, dtype=bool)
        if constellations:
            removed = np.concatenate([removed, constellation_modes(self.group)])
        return separate(
            design_matrix(self.los, self.group, gk.MAX_GROUPS),
            np.diag(self.variance),
            removed,
            self.heading,
            accuracy=np.diag(self.accuracy),
            bias=self.bias,
            y=self.y,
            variant=variant,
        )

    def kernel(self, published: bool = False) -> Found:
        geo, modes = gk.geometry_scratch(self.n), mode_scratch(self.n)
        turn = np.sin(self.heading), np.cos(self.heading)
        status, count, lost = (
            gk.find_geometry(self.los, self.group, self.variance, self.bias, self.n, *turn, geo),
            0,
            0.0,
        )
        if status == gk.SOLVED:
            gk.solve(self.y, self.group, self.n, geo)
            moments = moment_scratch(self.n)
            count = find_modes(self.group, self.accuracy, self.n, *turn, True, published, geo, moments, modes)
            lost = set_priors(self.group, self.n, count, PRIORS, 2.0 * PRIORS, geo.clocks, modes)
        return Found(status, count, geo, modes, lost)


class Found(NamedTuple):
    """What the kernels found."""

    status: int
    count: int
    geo: gk.Geometry
    modes: Modes
    lost: float


def check_columns(reference: Separation, found: Found, tolerance: float = 1e-9) -> None:
    count, modes = found.count, found.modes
    assert count == reference.sigma_m.shape[0]
    solved = np.isfinite(modes.sigma[0, :count])
    np.testing.assert_array_equal(solved, reference.solved)
    for name in ("sigma", "delta", "bias", "separation"):
        expected = getattr(reference, f"{name}_m")[solved]
        scale = np.abs(expected) + reference.sigma_m[solved] * 1e-3
        assert (np.abs(getattr(modes, name)[:, :count].T[solved] - expected) <= tolerance * scale).all(), name


@pytest.mark.parametrize(
    ("n", "systems"), [(6, 1), (9, 2), (12, 3), (16, 4), (17, 4), (20, 5), (24, 5), (30, 4), (35, 5)]
)
def test_kernel_equals_reference(n: int, systems: int) -> None:
    for seed in range(6):
        case = Case(seed, n, systems)
        found = case.kernel()
        assert found.status == gk.SOLVED
        geo, free = found.geo, found.geo.free[:n].min()
        check_columns(case.reference(), found, 1e-9 * max(1.0, 1e-3 / max(free, 1e-9)))
        fix = solve(design_matrix(case.los, case.group, systems), np.diag(case.variance), case.y)
        np.testing.assert_allclose(geo.fix["position"][0], fix.estimate[:3], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(geo.residual[:n], fix.residual, atol=1e-9)
        assert geo.fix["chi2"][0] == pytest.approx(float(fix.chi2), rel=1e-9)
        expected = dilution(design_matrix(case.los, case.group, systems), np.eye(n))
        assert hdop_of(rows_of(case.los, case.group, np.ones(n, dtype=np.bool_))) == pytest.approx(float(expected.hdop))


@pytest.mark.parametrize(("n", "systems"), [(9, 1), (14, 3), (30, 4)])
def test_kernel_equals_reference_with_published_bias(n: int, systems: int) -> None:
    for seed in range(4):
        case = Case(seed, n, systems)
        check_columns(case.reference(variant=Variant.PUBLISHED), case.kernel(published=True))


def test_a_satellite_alone_with_its_clock_changes_nothing() -> None:
    case = Case(3, 10, 1)
    case.group[4] = 2
    found = case.kernel()
    check_columns(case.reference(), found)
    assert found.modes.sigma[0, 5] == found.modes.sigma[0, 0]
    assert found.modes.delta[0, 5] == found.modes.separation[1, 5] == 0.0


def test_nearly_singular_subset_keeps_relative_accuracy() -> None:
    """Only one satellite leaves the plane of the others: 1 - h falls to 1e-6, the separation stays good to 1e-8."""
    case = Case(5, 9, 1)
    case.los[:, 2] = 0.3
    case.los[:-1, :2] /= np.linalg.norm(case.los[:-1, :2], axis=1, keepdims=True) / np.sqrt(1 - 0.09)
    case.los[-2] = [np.sqrt(1 - 0.301**2), 0.0, 0.301]
    case.los[-1] = [0.0, 0.6, 0.8]
    found = case.kernel()
    assert 1e-8 < found.geo.free[8] < 1e-3
    check_columns(case.reference(), found, 1e-8)


def test_modes_without_solution_are_marked() -> None:
    """Five satellites and two clocks: any loss leaves four rows for five unknowns."""
    case = Case(1, 5, 2)
    found = case.kernel()
    assert (found.status, found.count) == (gk.SOLVED, 8)
    assert np.isinf(found.modes.sigma[0, 1:8]).all()
    assert (found.modes.weight[1:8] == 0.0).all()
    assert found.lost == pytest.approx(5 * 1e-5 + 2 * 2e-5)
    assert not case.reference().solved[1:].any()


@pytest.mark.parametrize(("n", "systems", "status"), [(0, 1, gk.TOO_FEW), (1, 1, gk.TOO_FEW), (4, 2, gk.TOO_FEW)])
def test_too_few(n: int, systems: int, status: int) -> None:
    found = Case(0, n, systems).kernel()
    assert found.status == status
    assert np.isinf(found.geo.fix["sigma"]).all()


def test_one_direction_is_singular() -> None:
    case = Case(0, 7, 1)
    case.los[:] = [0.6, 0.0, 0.8]
    assert case.kernel().status == gk.SINGULAR


def test_separation_by_definition_with_correlated_rows() -> None:
    """Code and phase of one satellite removed together, full covariance: S_i, d_i and sigma_di as S1 eq 10-12."""
    rng = np.random.default_rng(11)
    case = Case(11, 7, 1)
    owner = np.repeat(np.arange(7), 2)
    g = np.hstack([np.repeat(-case.los, 2, axis=0), np.eye(2)[np.arange(14) % 2]])
    root = np.diag(np.tile([1.0, 0.01], 7)) + 0.002 * rng.normal(size=(14, 14))
    q, y = root @ root.T, rng.normal(size=14)
    found = separate(g, q, satellite_modes(owner), 0.7, y=y, bias=0.01)
    turn = track_from_enu_matrix(0.7)
    full = turn @ (np.linalg.inv(g.T @ np.linalg.inv(q) @ g) @ g.T @ np.linalg.inv(q))[:2]
    for i in range(7):
        left = owner != i
        w = np.linalg.inv(q[np.ix_(left, left)])
        rows = np.zeros((2, 14))
        rows[:, left] = turn @ (np.linalg.inv(g[left].T @ w @ g[left]) @ g[left].T @ w)[:2]
        apart = full - rows
        np.testing.assert_allclose(found.separation_m[i + 1], apart @ y, atol=1e-10)
        np.testing.assert_allclose(found.delta_m[i + 1], np.sqrt(np.diag(apart @ q @ apart.T)), rtol=1e-7)
        np.testing.assert_allclose(found.sigma_m[i + 1], np.sqrt(np.diag(rows @ q @ rows.T)), rtol=1e-7)
        np.testing.assert_allclose(found.bias_m[i + 1], 0.01 * np.abs(rows).sum(-1), rtol=1e-9)
        np.testing.assert_allclose(found.gain_track[i + 1], rows, atol=1e-10)


def test_subset_variance_is_full_variance_plus_separation_variance() -> None:
    """With one covariance for both, sigma_i^2 = sigma_0^2 + sigma_di^2 (the full solution is efficient)."""
    case = Case(12, 12, 2)
    case.accuracy = case.variance
    found = case.reference()
    np.testing.assert_allclose(found.sigma_m**2, found.sigma_m[:1] ** 2 + found.delta_m**2, rtol=1e-10)


def test_published_bias_cancels_equal_biases() -> None:
    """Equal biases on all satellites of one clock: published 0, while signs that differ would reach the exact bound."""
    case = Case(13, 12, 1)
    case.bias[:] = 0.3
    assert case.reference(False, Variant.PUBLISHED).bias_m.max() < 1e-12
    exact = case.reference(False)
    assert exact.bias_m.min() > 0.05
    reached = exact.gain_track[0, 0] @ (0.3 * np.sign(exact.gain_track[0, 0]))
    assert reached == pytest.approx(exact.bias_m[0, 0])


def test_published_bias_depends_on_heading() -> None:
    """A bias wholly along track counts 0.71 of itself on both axes when driving north-east."""
    gain_en, heading = np.full((2, 1), np.sqrt(0.5)), np.pi / 4
    np.testing.assert_allclose(published_bias(gain_en, np.ones(1), np.array(heading)), np.sqrt(0.5))
    np.testing.assert_allclose(np.abs(track_from_enu_matrix(heading) @ gain_en)[:, 0], [1.0, 0.0], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), turn=st.floats(-3.0, 3.0))
def test_exact_form_turns_with_the_sky(seed: int, turn: float) -> None:
    """Turning satellites and heading together changes nothing along and across the track."""
    case = Case(seed, 11, 2)
    before = case.reference()
    rotation = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    case.los = np.ascontiguousarray(case.los @ rotation.T)
    case.heading += turn
    after = case.reference()
    for name in ("sigma_m", "delta_m", "bias_m", "separation_m"):
        expected = getattr(before, name)
        np.testing.assert_allclose(getattr(after, name), expected, rtol=1e-8, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000))
def test_order_of_satellites_does_not_matter(seed: int) -> None:
    case = Case(seed, 13, 3)
    before = case.kernel()
    order = np.random.default_rng(seed).permutation(13)
    for name in ("los", "group", "variance", "accuracy", "bias", "y"):
        setattr(case, name, np.ascontiguousarray(getattr(case, name)[order]))
    after = case.kernel()
    columns = np.concatenate([[0], 1 + order, np.arange(14, before.count)])
    known = np.isfinite(before.modes.sigma[0, columns])
    for one, two in zip(after.modes[:4], before.modes[:4], strict=True):
        found, expected = one[:, : before.count][:, known], two[:, columns][:, known]
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(0, 20), systems=st.integers(1, 5), spread=st.floats(1e-9, 1.0))
def test_kernel_never_gives_nan(seed: int, n: int, systems: int, spread: float) -> None:
    case = Case(seed, n, systems)
    case.los = case.los * [spread, 1.0, 1.0]
    case.los /= np.linalg.norm(case.los, axis=1, keepdims=True)
    found = case.kernel()
    for part in (*found.modes[:4], *found.geo[2:7]):
        assert not np.isnan(part[..., : found.count]).any()
    for name in found.geo.fix.dtype.names:
        assert not np.isnan(found.geo.fix[name]).any()


def test_bad_input_is_named() -> None:
    case = Case(1, 6, 1)
    g = design_matrix(case.los, case.group)
    with pytest.raises(InputError, match="modes must have shape"):
        separate(g, np.eye(6), np.eye(5, dtype=bool), 0.0)
    with pytest.raises(InputError, match="bias must lie"):
        separate(g, np.eye(6), np.eye(6, dtype=bool), 0.0, bias=-1.0)
    with pytest.raises(InputError, match="covariance must be positive definite"):
        separate(g, -np.eye(6), np.eye(6, dtype=bool), 0.0)
