"""Cost of the context-aware monitor for many vehicles on one map: position, matching and the three phases.

The gate is real time at one verdict a second; code positions are solved too, from measurements made beforehand.
"""

from __future__ import annotations

import statistics
import time

import numpy as np

from lanebound.agents.bench.rows import Row
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, CodeFix, code_position
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor
from lanebound.integrity.positioning.code_solution import solve_ranges
from lanebound.integrity.positioning.map_matching.generators import DriveEnvironment, generate_map
from lanebound.integrity.positioning.map_matching.matching import MatcherKind

__all__ = ["measure"]

VEHICLES, SATELLITES, CLOCKS = 10_000, 24, 3
CODE_M, RATE_MPS, SPEED_MPS, STRONG_DBHZ = 2.0, 0.1, 10.0, 45.0


def measure(rounds: int = 5) -> list[Row]:
    """Vehicles whose second passes within a second, for the topological and the hidden Markov matcher."""
    kinds = (MatcherKind.TOPOLOGICAL, MatcherKind.HIDDEN_MARKOV)
    return [
        Row(f"context_{kind}_vehicles_in_real_time", _vehicles_per_second(kind, rounds), "1/s", 10_000.0)
        for kind in kinds
    ]


def _vehicles_per_second(kind: MatcherKind, rounds: int) -> float:
    rng = named_generator(1, "traffic")
    found = generate_map(DriveEnvironment.URBAN, 6400.0, rng)
    road_map = found.road_map
    monitor = ContextMonitor(ContextConfig.load({"matching": {"kind": kind}}), road_map, VEHICLES, 1.0)
    link = rng.choice(found.route, VEHICLES)
    start, end = (road_map.node_en_m[ends[link]] for ends in (road_map.link_from, road_map.link_to))
    unit = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    los, rates = _rows(rng), []
    for k in range(rounds + 1):
        truth = start + SPEED_MPS * k * unit, SPEED_MPS * unit
        observed = [_observe(los, value, sigma, rng) for value, sigma in zip(truth, (CODE_M, RATE_MPS), strict=True)]
        begun = time.perf_counter()
        fix = _solve(los, *observed)
        monitor.step(fix, np.full(VEHICLES, SPEED_MPS))
        if k:  # the first call prepares the cells of the map
            rates.append(VEHICLES / (time.perf_counter() - begun))
    return statistics.median(rates)


def _rows(rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (V, S, 3) to a sky of its own for each vehicle."""
    azimuth, elevation = (
        rng.uniform(0.0, 2.0 * np.pi, (VEHICLES, SATELLITES)),
        rng.uniform(0.2, 1.5, (VEHICLES, SATELLITES)),
    )
    return np.stack([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)], -1)


def _observe(los: np.ndarray, value: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    noise = sigma * rng.standard_normal(los.shape[:2])
    return np.asarray(noise - np.einsum("bmi,bi->bm", los[..., :2], value))


def _solve(los: np.ndarray, codes: np.ndarray, rates: np.ndarray) -> CodeFix:
    """Position with the full covariance of codes, and velocity."""
    used, system = np.ones(codes.shape, bool), np.arange(SATELLITES) % CLOCKS
    found, plain = code_position(los, codes, np.full(codes.shape, STRONG_DBHZ), used, system, CodeErrorsConfig())
    return CodeFix(found, solve_ranges(los, rates, RATE_MPS**2, used, np.zeros_like(system)), plain)
