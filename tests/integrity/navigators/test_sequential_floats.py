"""A drive whose float ambiguities come from the filter: same bits alone and in a batch, right fixes, bounded errors."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

SEQUENTIAL = NavigatorConfig().replace(positioning={"rtk": {"float_solution": {"kind": "sequential"}}})
EPOCHS, SEEDS = 150, [3, 4, 5]
ROAD = Road.through(
    np.array([[0.0, 0.0], [0.0, 260.0], [220.0, 260.0], [220.0, 0.0]]), corner_radius_m=20.0, closed=True
)


@pytest.fixture(scope="module")
def street() -> tuple[SkyTrack, SkyMask]:
    city = build_city(ROAD, CityConfig.uniform(SectionKind("semi_urban")), np.random.default_rng(5))
    return SkyTrack.from_config(SEQUENTIAL.sky, 60.0), SkyMask.build(ROAD, city)


def driven(street: tuple[SkyTrack, SkyMask], seeds: list[int]) -> dict[str, np.ndarray]:
    """The solutions of vehicles (T, B, ...), and their true positions as ``true_m`` (T, B, 2)."""
    navigator = Navigator(SEQUENTIAL, *street, seeds)
    drive, streams = CityDrive(ROAD, DriveConfig(), SEQUENTIAL.dt_s), Streams([s + 1 for s in seeds])
    state = drive.start(streams, spread_m=300.0)
    navigator.place(state.position_m, state.heading_rad, 0.05, 0.01)
    rows: dict[str, list[np.ndarray]] = {}
    for _ in range(EPOCHS):
        truth = drive.step(state, streams)
        solution = navigator.step(truth)
        rows.setdefault("true_m", []).append(truth.position_enu_m[:, :2].copy())
        for f in fields(solution):
            rows.setdefault(f.name, []).append(np.asarray(getattr(solution, f.name)).copy())
    return {name: np.stack(values) for name, values in rows.items()}


def test_a_vehicle_alone_and_in_a_batch_have_the_same_bits(street: tuple[SkyTrack, SkyMask]) -> None:
    together = driven(street, SEEDS)
    for row, seed in enumerate(SEEDS):
        alone = driven(street, [seed])
        for name in ("position_en_m", "pl_cases_m", "mode", "rtk_status", "held"):
            if name in alone:
                np.testing.assert_array_equal(alone[name][:, 0], together[name][:, row], err_msg=f"{name}, {seed}")
    fixed = together["mode"] == int(Mode.RTK)
    assert fixed.mean() > 0.5
    error = np.hypot(*np.moveaxis(together["position_en_m"] - together["true_m"], -1, 0))
    assert error[fixed].max() < 0.3  # a wrong integer moves the position by decimetres


def test_a_snapshot_holds_the_filter(street: tuple[SkyTrack, SkyMask]) -> None:
    navigator = Navigator(SEQUENTIAL, *street, [7])
    drive, streams = CityDrive(ROAD, DriveConfig(), SEQUENTIAL.dt_s), Streams([8])
    state = drive.start(streams)
    for _ in range(15):
        navigator.step(drive.step(state, streams))
    truths = [drive.step(state, streams) for _ in range(15)]
    stored = navigator.snapshot()
    first = [navigator.step(truth).position_en_m for truth in truths]
    navigator.restore(stored)
    np.testing.assert_array_equal(first, [navigator.step(truth).position_en_m for truth in truths])
