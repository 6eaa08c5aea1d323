"""Code positions of made-up skies, for monitors that take the rows of a least squares."""

import numpy as np

from lanebound.integrity.monitoring.context.code_fix import CodeFix
from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges


def sky_design(satellites: int, rng: np.random.Generator, unknowns: int = 4) -> np.ndarray:
    """Design (m, 4) of satellites well spread over the sky, one clock."""
    azimuth = 2.0 * np.pi * (np.arange(satellites) + rng.uniform(0.0, 0.5, satellites)) / satellites
    elevation = np.deg2rad(rng.permutation(np.linspace(12.0, 75.0, satellites)))
    level = np.cos(elevation)
    los = np.column_stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)])
    return np.column_stack([-los, np.ones(satellites)])[:, :unknowns]


def solve_rows(design: np.ndarray, observed: np.ndarray, weight: np.ndarray) -> CodeFit:
    """The solution of rows (B, m, 4) with weights (B, m), 0 of rows without use."""
    used = weight > 0.0
    variance = 1.0 / np.where(used, weight, 1.0)
    return solve_ranges(-design[..., :3], observed, variance, used, np.zeros(observed.shape[-1], np.int64))


def code_rows(position_en_m: np.ndarray, sigma_m: float, rng: np.random.Generator, satellites: int = 9) -> CodeFit:
    """Code positions with white errors of B vehicles at (B, 2) under one sky."""
    design = np.broadcast_to(sky_design(satellites, rng), (len(position_en_m), satellites, 4))
    truth = np.column_stack([position_en_m, np.zeros((len(position_en_m), 2))])
    noise = sigma_m * rng.standard_normal(design.shape[:2])
    weight = np.full(design.shape[:2], sigma_m**-2)
    return solve_rows(design, np.einsum("bmi,bi->bm", design, truth) + noise, weight)


def fix_at(position_en_m, velocity_en_mps, rng, *, code_m: float = 0.7, rate_mps: float = 0.05) -> CodeFix:
    """A fix of B vehicles at a place and velocity (B, 2)."""
    return CodeFix(
        code_rows(np.asarray(position_en_m, float), code_m, rng, 12),
        code_rows(np.asarray(velocity_en_mps, float), rate_mps, rng, 12),
    )
