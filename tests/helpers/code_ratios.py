"""Normalised errors of code positions under an open sky: error over declared deviation, by service and user."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.services import stage
from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges

DT_S = 0.1
EXACT = {
    "dgps": {"declared_m": 0.15},
    "sbas_l1": {"declared_m": 0.4, "iono_declared_m": 0.4},
    "sbas_dfmc": {"declared_m": 0.25},
    "ppp": {"declared_m": 0.03},
}
"""Providers that declare the residual that they have, and no multiple of it."""


def truths(batch: int, epochs: int, speed_mps: float):
    """Vehicles that drive North."""
    heading, velocity = np.zeros(batch), np.tile([0.0, speed_mps], (batch, 1))
    place = np.zeros((batch, 2))
    for k in range(epochs):
        before, place = place, place + DT_S * velocity
        yield truth_between((k + 1) * DT_S, DT_S, (before, place), (velocity, velocity), (heading, heading))


def service_solutions(
    monkeypatch, service: str, batch: int, epochs: int = 11, speed_mps: float = 10.0, **changes: Mapping[str, Any]
) -> tuple[CodeFit, Truth]:
    """The least squares of the ranges that a service has after its fault test in the last epoch that is due, each of
    B vehicles in an area of its own, and the truth of that epoch."""
    config = NavigatorConfig(service=service, gnss={"bands": [0, 2]}).replace(**changes)
    navigator = Navigator.nominal(config, list(range(1000, 1000 + batch)), duration_s=DT_S * epochs + 60.0)
    navigator.place(np.zeros((batch, 2)), np.zeros(batch), 1000.0, 0.01)
    found: dict[str, Any] = {}
    original = stage.find_fix

    def keep(first, last, epoch, tables, inputs, ranges):
        # Called once a piece of the vehicles, on several threads: what is kept is complete only after the step.
        original(first, last, epoch, tables, inputs, ranges)
        found.update(ranges=ranges, epoch=epoch, system=tables.tables.satellites["system"])

    monkeypatch.setattr(stage, "find_fix", keep)
    for truth in truths(batch, epochs, speed_mps):
        navigator.step(truth)
        ranges = found["ranges"]
        if ranges.work["due"].any():
            rows, consistent = ranges.rows.copy(), ranges.work["consistent"].copy()
            los, then = found["epoch"].signals["e"].copy(), truth
    monkeypatch.undo()
    used = rows["used"] & consistent[:, None]
    return solve_ranges(los, rows["y"], rows["variance"], used, found["system"]), then


def ratio_of(error_m: np.ndarray, covariance_m2: np.ndarray) -> float:
    """RMS of errors (B, k) over the deviations of (B, k, k), all axes together."""
    sigma = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
    return float(np.sqrt(np.mean(np.square(error_m / sigma))))


def horizontal_ratio(fit: CodeFit, truth: Truth) -> float:
    """Of the solved epochs of a fit."""
    good = fit.solved
    return ratio_of(fit.x_m[good, :2] - truth.position_enu_m[good, :2], fit.cofactor[good, :2, :2])
