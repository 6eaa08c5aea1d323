"""The ego's own sensor: what hides what, and measurements that are right between the vehicles, wrong on the globe."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import binom, chi2, norm

from beliefs import believe
from lanebound.envs.perception import SensorConfig, Vehicles
from lanebound.envs.perception.sensor import Sensor
from lanebound.envs.perception.tracks_kernel import AGE, HEADING, PL_AT, PL_CT, SPEED, XY, in_sight
from lanebound.integrity.core.streams import Streams

DT = 0.1
EXACT = SensorConfig(range_sigma_m=0.0, bearing_sigma_deg=0.0, speed_sigma_mps=0.0, heading_sigma_deg=0.0)
Array = NDArray[np.float64]


def there(
    position_m: Any, heading_rad: Any = 0.0, speed_mps: Any = 0.0, size_m: tuple[float, float] = (5.0, 2.0)
) -> Vehicles:
    position = np.asarray(position_m, dtype=np.float64)
    v = position.shape[0]
    return Vehicles(
        slot=np.arange(v),
        key=np.arange(v),
        position_m=position,
        heading_rad=np.zeros(v) + heading_rad,
        speed_mps=np.zeros(v) + speed_mps,
        length_m=np.full(v, size_m[0]),
        width_m=np.full(v, size_m[1]),
    )


def look(vehicles: Vehicles, config: SensorConfig = EXACT, ego: Any = None, seed: int = 1) -> Array:
    sensor = Sensor(config, vehicles.slot.size, DT, Streams([seed]))
    at, heading, speed = vehicles.position_m[0], vehicles.heading_rad[0], vehicles.speed_mps[0]
    belief = ego or believe(position_m=at, heading_rad=heading, speed_mps=speed)
    return sensor.look(belief, 0, vehicles).copy()


def seen(vehicles: Vehicles, config: SensorConfig = EXACT) -> list[int]:
    return [int(i) for i in np.flatnonzero(look(vehicles, config)[:, AGE] == 0.0)]


def _edges_crossed(a: Array, b: Array, centre: Array, heading: float, length: float, width: float) -> bool:
    """Oracle: whether the segment crosses one of the four edges, each found by the signs of two pairs of areas."""

    def side(p: Array, q: Array, r: Array) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    ahead = 0.5 * length * np.array([np.cos(heading), np.sin(heading)])
    right = 0.5 * width * np.array([-np.sin(heading), np.cos(heading)])
    corners = [centre + ahead + right, centre + ahead - right, centre - ahead - right, centre - ahead + right]
    for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
        if side(p, q, a) * side(p, q, b) < 0.0 and side(a, b, p) * side(a, b, q) < 0.0:
            return True
    return False


@given(seed=st.integers(0, 10_000))
def test_hidden_is_whose_line_of_sight_crosses_an_edge_of_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vehicles = there(
        np.r_[[[0.0, 0.0]], rng.choice([-1, 1], (9, 2)) * rng.uniform(4, 60, (9, 2))], rng.uniform(-4, 4, 10)
    )
    ahead = np.column_stack([np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)])
    position = vehicles.position_m
    for i in range(1, 10):
        # a target inside another vehicle crosses an odd number of its edges all the same, as the ego is outside
        hidden = any(
            _edges_crossed(position[0], position[i], position[j], vehicles.heading_rad[j], 5.0, 2.0)
            for j in range(1, 10)
            if j != i
        )
        assert in_sight(i, 0, position, ahead, vehicles.length_m, vehicles.width_m) != hidden


def test_the_leader_hides_its_own_leader_but_not_the_next_lane() -> None:
    assert seen(there([[0, 0], [15, 0], [30, 0], [30, 4], [-15, 0]])) == [1, 3, 4]


def test_nothing_is_seen_beyond_range_or_view() -> None:
    row = there([[0, 0], [79, 0], [0, 20], [-20, 0], [0, -81]])
    assert seen(row) == [1, 2, 3]
    assert seen(row, EXACT.replace(field_of_view_deg=120.0)) == [1]
    assert seen(replace(row, heading_rad=np.full(5, np.pi)), EXACT.replace(field_of_view_deg=120.0)) == [3]


@pytest.mark.parametrize("heading_rad", [0.0, 2.9, -2.9])
def test_relative_geometry_is_right_on_a_wrong_belief(heading_rad: float) -> None:
    vehicles = there([[100, 50], [120, 58]], [heading_rad, heading_rad + 0.3], [10.0, 8.0])
    ego = believe(position_m=np.array([103.0, 49.0]), heading_rad=heading_rad + 0.1, speed_mps=10.5)
    track = look(vehicles, ego=ego)[1]
    cos, sin = np.cos(0.1), np.sin(0.1)
    np.testing.assert_allclose(track[XY] - ego.position_m, [20 * cos - 8 * sin, 20 * sin + 8 * cos])
    np.testing.assert_allclose(track[HEADING], heading_rad + 0.4)
    np.testing.assert_allclose(track[SPEED], 8.0 + 0.5 * np.cos(0.3))


def test_levels_are_k_sigma_along_and_across_the_others_heading() -> None:
    config = EXACT.replace(range_sigma_m=1e-6, bearing_sigma_deg=np.degrees(1e-7), integrity_risk=1e-5)
    k = norm.isf(1e-5 / 4)
    along, abeam = look(there([[0, 0], [40, 0]], [0.0, 0.0]), config)[1], look(there([[0, 0], [0, 40]]), config)[1]
    np.testing.assert_allclose(along[[PL_AT, PL_CT]], [k * 1e-6, k * 40 * 1e-7], rtol=1e-4)
    np.testing.assert_allclose(abeam[[PL_AT, PL_CT]], [k * 40 * 1e-7, k * 1e-6], rtol=1e-4)


def _errors(config: SensorConfig, looks: int, psi: float) -> tuple[Array, Array, Array]:
    """Errors along and across the measured heading, and the levels, of a vehicle 40 m away turned by ``psi``."""
    vehicles = there([[0, 0], [40, 0]], [0.0, psi], [10.0, 8.0])
    sensor, ego = Sensor(config, 2, DT, Streams([4])), believe(speed_mps=10.0)
    tracks = np.array([sensor.look(ego, 0, vehicles)[1].copy() for _ in range(looks)])
    error, cos, sin = tracks[:, XY] - [40, 0], np.cos(tracks[:, HEADING]), np.sin(tracks[:, HEADING])
    return error[:, 0] * cos + error[:, 1] * sin, error[:, 1] * cos - error[:, 0] * sin, tracks


@pytest.mark.parametrize("psi", [0.0, 0.6, 1.6])
def test_errors_have_the_stated_size_and_break_their_bounds_as_often_as_stated(psi: float) -> None:
    looks, risk = 2000, 0.1
    at, ct, tracks = _errors(SensorConfig(integrity_risk=risk), looks, psi)
    k = norm.isf(risk / 4)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], looks)  # each of the six assertions fails by chance once in 5000 seeds
    for error, level in ((at, tracks[:, PL_AT]), (ct, tracks[:, PL_CT])):
        assert low < ((k * error / level) ** 2).sum() < high
        assert binom.ppf(1e-4, looks, risk / 2) <= (np.abs(error) > level).sum() <= binom.isf(1e-4, looks, risk / 2)
    assert low < (((tracks[:, SPEED] - 8.0) / 0.1) ** 2).sum() < high
    assert low < (((tracks[:, HEADING] - psi) / np.radians(2.0)) ** 2).sum() < high


def test_a_track_out_of_sight_ages_and_moves_with_the_egos_odometry_not_with_its_jumps() -> None:
    sensor = Sensor(EXACT, 3, DT, Streams([1]))
    step: Any = sensor.look
    step(believe(speed_mps=10.0), 0, there([[0, 0], [20, 4], [40, 0]], speed_mps=10.0))
    hidden = there([[1, 0], [21, 0], [41, 0]], speed_mps=10.0)
    track = step(believe(position_m=np.array([1.0 + 3.0, -1.0]), speed_mps=10.0), 0, hidden)[
        2
    ]  # the solution jumps by (3, -1)
    np.testing.assert_allclose(track[AGE], 0.1)
    np.testing.assert_allclose(track[XY], [40.0 + 3.0, -1.0])  # where it was, by the new reckoning
    sensor.forget(np.array([2]))
    assert np.isinf(sensor.look(believe(), 0, hidden)[2, AGE])
