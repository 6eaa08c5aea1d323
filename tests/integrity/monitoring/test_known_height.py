"""Solution separation where the height is known from elsewhere, against dense least squares with one more row."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.monitoring.separation_kernel import find_modes, mode_scratch, moment_scratch
from lanebound.integrity.positioning import geometry_kernel as gk


@pytest.mark.parametrize(("n", "systems"), [(6, 1), (9, 2), (14, 3)])
def test_separations_count_the_row_of_the_height(n: int, systems: int) -> None:
    rng = np.random.default_rng(n)
    elevation, azimuth = np.arcsin(rng.uniform(0.15, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    group, variance, y = np.arange(n) % systems, rng.uniform(0.2, 2.0, n), rng.normal(size=n)
    height, weight, turn = 0.7, 1.0 / 0.8**2, 0.6
    geo, modes, moments = gk.geometry_scratch(n), mode_scratch(n), moment_scratch(n)
    geo.fix["height"], geo.fix["height_weight"] = height, weight
    sine, cosine = float(np.sin(turn)), float(np.cos(turn))
    assert gk.find_geometry(los, group, variance, np.zeros(n), n, sine, cosine, geo) == gk.SOLVED
    gk.solve(y, group, n, geo)
    count = find_modes(group, variance, n, sine, cosine, True, False, geo, moments, modes)

    design = np.vstack([np.hstack([-los, np.eye(systems)[group]]), [0.0, 0.0, 1.0, *np.zeros(systems)]])
    weights, values = np.append(1.0 / variance, weight), np.append(y, height)
    axes = np.array([[sine, cosine, 0.0], [cosine, -sine, 0.0]])

    def solution(left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        w = weights * left
        inverse = np.linalg.pinv(design.T @ (w[:, None] * design))
        gain = axes @ (inverse @ design.T * w)[:3]
        return gain, axes @ inverse[:3, :3] @ axes.T

    whole, _ = solution(np.ones(n + 1))
    assert count == 1 + n + systems
    for k in range(1, count):
        left = np.ones(n + 1)
        left[:n][(np.arange(n) == k - 1) if k <= n else (group == k - n - 1)] = 0.0
        if not np.isfinite(modes.sigma[0, k]):
            assert systems == 1
            assert k > n
            continue
        gain, covariance = solution(left)
        np.testing.assert_allclose(modes.sigma[:, k], np.sqrt(np.diag(covariance)), rtol=1e-7)
        np.testing.assert_allclose(modes.separation[:, k], (whole - gain) @ values, rtol=1e-6, atol=1e-9)
        spread = np.sqrt(((whole - gain) ** 2 / weights).sum(-1))
        np.testing.assert_allclose(modes.delta[:, k], spread, rtol=1e-6)
