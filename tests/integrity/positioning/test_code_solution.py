"""The one solver of code positions: known heights, satellites at a distance, outcomes, rows for themselves."""

from __future__ import annotations

import numpy as np
from code_geometry import sky

from lanebound.integrity.positioning.code_solution import gauss_newton, solve_ranges
from lanebound.integrity.positioning.least_squares import Solvability


def rows(seed: int, epochs: int = 20, m: int = 9):
    """Sights, values, variances, use and systems."""
    rng = np.random.default_rng(seed)
    los = np.stack([np.asarray(sky(rng, m)).reshape(m, 3) for _ in range(epochs)])
    return los, rng.standard_normal((epochs, m)), rng.uniform(0.5, 4.0, (epochs, m)), np.arange(m) % 2


def test_a_known_height_is_a_row() -> None:
    los, y, variance, system = rows(1)
    fit = solve_ranges(los, y, variance, np.ones(y.shape, bool), system, (np.full(20, 0.7), np.full(20, 0.4)))
    for e in range(20):
        design = np.column_stack([-los[e], system == 0, system == 1])
        design = np.vstack([design, [0.0, 0.0, 1.0, 0.0, 0.0]])
        weight = np.diag(np.append(1.0 / variance[e], 0.4**-2))
        q = np.linalg.inv(design.T @ weight @ design)
        x = q @ design.T @ weight @ np.append(y[e], 0.7)
        left = np.append(y[e], 0.7) - design @ x
        np.testing.assert_allclose(fit.x_m[e], x[:3], atol=1e-9)
        np.testing.assert_allclose(fit.cofactor[e], q[:3, :3], atol=1e-9)
        np.testing.assert_allclose(fit.wsse[e], left @ weight @ left, rtol=1e-9)
        np.testing.assert_allclose(fit.redundancy[e], 1.0 - np.diag(design @ q @ design.T @ weight)[:9], atol=1e-9)
    assert (fit.df == 9 + 1 - 5).all()


def test_a_known_height_replaces_a_satellite() -> None:
    los, y, variance, _ = rows(2, 5, 3)
    alone, none = np.ones(y.shape, bool), np.full(5, np.inf)
    few = solve_ranges(los, y, variance, alone, np.zeros(3, int), (np.zeros(5), none))
    assert (few.status == Solvability.TOO_FEW.code).all()
    known = solve_ranges(los, y, variance, alone, np.zeros(3, int), (np.zeros(5), np.full(5, 0.1)))
    assert known.solved.all()
    assert (known.df == 0).all()


def test_what_is_not_solvable_is_zero_and_never_nan() -> None:
    los, y, variance, system = rows(3)
    los[0] = los[0, :1]  # nine times one satellite
    used = np.ones(y.shape, bool)
    used[1, 4:] = False
    y[2], los[3], variance[3], used[2:4] = np.nan, np.inf, 0.0, False
    fit = solve_ranges(los, y, variance, used, system)
    assert fit.status[:4].tolist() == [Solvability.SINGULAR.code] + 3 * [Solvability.TOO_FEW.code]
    assert fit.solved[4:].all()
    for name, value in vars(fit).items():
        assert np.isfinite(value).all(), name
    assert not fit.x_m[:4].any()


def test_an_epoch_has_the_same_bits_in_every_batch_and_beside_columns_without_use() -> None:
    los, y, variance, system = rows(4, 400)
    used = np.random.default_rng(4).random(y.shape) < 0.9
    together = solve_ranges(los, y, variance, used, system)
    alone = solve_ranges(los[7:8], y[7:8], variance[7:8], used[7:8], system)
    assert (alone.x_m == together.x_m[7]).all()
    wide = [np.concatenate([value[7:8], value[:1, :3]], 1) for value in (los, y, variance, used)]
    wide[3][:, 9:] = False
    padded = solve_ranges(*wide, np.append(system, [5, 6, 7]))
    assert (padded.x_m == together.x_m[7]).all()
    assert (padded.cofactor == together.cofactor[7]).all()


def test_ranges_to_satellites_at_a_distance_settle_at_the_position() -> None:
    """From 6,000 km away, two clocks."""
    rng, m = np.random.default_rng(5), 10
    truth = np.array([[1e3, -2e3, 50.0], [0.0, 4e5, 10.0]])
    place = 2.2e7 * np.asarray(sky(rng, m)).reshape(m, 3)
    clock = np.array([3e4, -5e3])[np.arange(m) % 2]
    measured = np.linalg.norm(place - truth[:, None], axis=-1) + clock

    def linearise(x):
        away = place - x[:, None]
        distance = np.linalg.norm(away, axis=-1)
        return measured - distance, away / distance[..., None]

    used, start = np.ones((2, m), bool), np.array([[0.0, 0.0, -6e6], [1e5, 0.0, -6e6]])
    found, fit = gauss_newton(linearise, start, 1.0, used, np.arange(m) % 2)
    assert fit.solved.all()
    np.testing.assert_allclose(found, truth, atol=1e-3)
    sights = linearise(truth)[1]
    wild = gauss_newton(lambda x: (1e3 * np.cos(x[:, :1] + np.arange(m)), sights), start, 1.0, used, clock > 0)
    assert (wild[1].status == Solvability.UNSETTLED.code).all()
