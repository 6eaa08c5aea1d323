"""The same work by this package and by sidereon 3.0.4 (Rust), one core each; no rows where that is not installed."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.bench._sidereon import Araim, installed, package
from lanebound.agents.bench.ambiguity import drifting_problems
from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.araim import AraimConfig, levels_at
from lanebound.integrity.monitoring.fault_modes import enumerate_faults
from lanebound.integrity.positioning import lambda_kernel as kernel
from lanebound.integrity.positioning.ambiguity import NODE_LIMIT

__all__ = ["measure"]

Array = NDArray[np.float64]

SATELLITES, SYSTEMS, EPOCHS = 30, 3, 512
AGREE_M = 0.06  # sidereon solves the horizontal level to 0.05 m
RULES = AraimConfig(constellation_prior=1e-6)  # with 1e-4 pairs of three systems alone would use up the risk


def measure(rounds: int = 5) -> list[Row]:
    """ARAIM levels of 30 satellites with 33 fault modes, and cold integer least squares at n = 20; compared first."""
    return [*_levels(rounds), *_integers(rounds)] if installed() else []


def _levels(rounds: int) -> list[Row]:
    rng = np.random.default_rng(4)
    elevation = np.arcsin(rng.uniform(0.14, 1.0, (EPOCHS, SATELLITES)))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, (EPOCHS, SATELLITES))
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    group = np.arange(SATELLITES) % SYSTEMS
    variance, accuracy = 0.5 + 0.3 / np.sin(elevation) ** 2, 0.3 + 0.2 / np.sin(elevation) ** 2
    bias = np.full((EPOCHS, SATELLITES), 0.5)
    theirs = [Araim(los[e], group, variance[e], accuracy[e], bias[e], 1e-5, 1e-6) for e in range(16)]
    modes = enumerate_faults(group, RULES.satellite_prior, RULES.constellation_prior, at_once=1)

    def ours() -> tuple[Array, Array]:
        with serial():
            up, plane = levels_at(los, group, variance, accuracy, bias, RULES, modes, np.ones(1))
        return up[:, 0], plane[:, 0]

    up, plane = ours()
    apart = [
        abs(one.vpl_m - v) + abs(one.hpl_m - np.hypot(*h))
        for one, v, h in zip((one.solve() for one in theirs), up, plane, strict=False)
    ]
    if not max(apart) < 2.0 * AGREE_M:
        raise InputError(f"both sides must agree to {2.0 * AGREE_M} m, they differ by {max(apart)} m: fix it first")

    def fast() -> int:
        ours()
        return EPOCHS

    turn = itertools.cycle(theirs)

    def slow() -> int:
        next(turn).solve()
        return 1

    rates = alternate({"ours": fast, "sidereon": slow}, rounds)
    return [
        Row("pl_kernel_n30_vs_sidereon", median_ratio(rates, "ours", "sidereon"), "x", gate=10.0, stretch=60.0),
        Row("sidereon_araim_n30_epochs_per_s", float(np.median(rates["sidereon"])), "1/s"),
    ]


def _integers(rounds: int) -> list[Row]:
    a, Q = drifting_problems()
    epochs, n = a.shape
    candidates, norms = np.empty((epochs, 2, n)), np.empty((epochs, 2))
    failure_rate, status = np.empty(epochs), np.empty(epochs, dtype=np.int64)

    def ours() -> int:
        kernel.solve_epochs(a, Q, NODE_LIMIT, False, candidates, norms, failure_rate, status)
        return int(epochs)

    search = package().lambda_ils_search
    turn = itertools.cycle(range(epochs))

    def theirs() -> int:
        e = next(turn)
        search(a[e], Q[e])
        return 1

    ours()
    for e in range(8):
        found = search(a[e], Q[e])
        if not np.array_equal(found.fixed, candidates[e, 0]):
            raise InputError(f"both sides must find the same integers, they differ at epoch {e}: fix it first")
    rates = alternate({"ours": ours, "sidereon": theirs}, rounds)
    return [Row("lambda_n20_vs_sidereon", median_ratio(rates, "ours", "sidereon"), "x", gate=5.0, stretch=20.0)]
