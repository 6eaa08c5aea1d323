"""The ego's own sensor: what hides what, and measurements that are right between the vehicles, wrong on the globe."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import binom, chi2, norm

from lanebound.envs.batch import perception_kernel as pk
from lanebound.envs.batch.perception import PerceptionBatch
from lanebound.envs.batch.records_kernel import BELIEF
from lanebound.envs.perception import PerceptionConfig, SensorConfig
from lanebound.integrity.core.records import Records
from vehicles import cars_at, record_of

DT, ROW = 0.1, np.zeros(1, dtype=np.int64)
EXACT = SensorConfig(
    range_sigma_m=0.0, bearing_sigma_deg=0.0, lateral_bias_sigma_m=0.0, speed_sigma_mps=0.0, heading_sigma_deg=0.0
)
Array = NDArray[np.float64]


class Sensor:
    """The sensor of one ego, with its own noise."""

    def __init__(self, config: SensorConfig, capacity: int, seed: int = 1) -> None:
        made = PerceptionConfig(source="sensor", sensor=config)
        self.batch = PerceptionBatch(made, 1, capacity, capacity + 1, DT)
        crew = cars_at(np.zeros((capacity + 1, 2)))[None]
        self.batch.begin(ROW, [seed], np.ones((1, capacity), dtype=np.bool_), crew)

    def look(self, ego: Any, car: Records) -> Any:
        """Tracks (C,) SIGHTING by slot after another epoch."""
        p, noise = self.batch.pictures, self.batch._draw("sensor", ROW, 4)[0]
        pk.look(p.picture[0], p.tracks[0], p.of_sensor[0], ego, car, noise, np.empty((len(car), 2)), p.walls)
        return p.tracks[0].copy()


def believe(x: float = 0.0, y: float = 0.0, heading_rad: float = 0.0, speed_mps: float = 0.0) -> Any:
    return record_of(BELIEF, x_m=x, y_m=y, heading_rad=heading_rad, speed_mps=speed_mps)


def look(car: Records, config: SensorConfig = EXACT, ego: Any = None) -> Any:
    if ego is None:
        ego = believe(car["x"][0], car["y"][0], car["heading"][0], car["speed"][0])
    return Sensor(config, len(car) - 1).look(ego, car)


def seen(car: Records, config: SensorConfig = EXACT) -> list[int]:
    """Which vehicles are in sight, by number."""
    return [1 + int(i) for i in np.flatnonzero(look(car, config)["time_s"] == 0.0)]


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
    vehicles = cars_at(
        np.r_[[[0.0, 0.0]], rng.choice([-1, 1], (9, 2)) * rng.uniform(4, 60, (9, 2))], rng.uniform(-4, 4, 10)
    )
    ahead = np.column_stack([np.cos(vehicles["heading"]), np.sin(vehicles["heading"])])
    position = np.column_stack([vehicles["x"], vehicles["y"]])
    for i in range(1, 10):
        # a target inside another vehicle crosses an odd number of its edges all the same, as the ego is outside
        hidden = any(
            _edges_crossed(position[0], position[i], position[j], vehicles["heading"][j], 5.0, 2.0)
            for j in range(1, 10)
            if j != i
        )
        assert pk.in_sight(vehicles, ahead, i) != hidden


def test_the_leader_hides_its_own_leader_but_not_the_next_lane() -> None:
    assert seen(cars_at([[0, 0], [15, 0], [30, 0], [30, 4], [-15, 0]])) == [1, 3, 4]


def test_nothing_is_seen_beyond_range_or_view() -> None:
    row = cars_at([[0, 0], [79, 0], [0, 20], [-20, 0], [0, -81]])
    assert seen(row) == [1, 2, 3]
    assert seen(row, EXACT.replace(field_of_view_deg=120.0)) == [1]
    row["heading"][:] = np.pi
    assert seen(row, EXACT.replace(field_of_view_deg=120.0)) == [3]


@pytest.mark.parametrize("heading_rad", [0.0, 2.9, -2.9])
def test_relative_geometry_is_right_on_a_wrong_belief(heading_rad: float) -> None:
    vehicles = cars_at([[100, 50], [120, 58]], [heading_rad, heading_rad + 0.3], [10.0, 8.0])
    track = look(vehicles, ego=believe(103.0, 49.0, heading_rad + 0.1, 10.5))[0]
    cos, sin = np.cos(0.1), np.sin(0.1)
    np.testing.assert_allclose([track["x_m"] - 103.0, track["y_m"] - 49.0], [20 * cos - 8 * sin, 20 * sin + 8 * cos])
    np.testing.assert_allclose(track["heading_rad"], heading_rad + 0.4)
    np.testing.assert_allclose(track["speed_mps"], 8.0 + 0.5 * np.cos(0.3))


def test_levels_are_k_sigma_along_and_across_the_others_heading() -> None:
    config = EXACT.replace(range_sigma_m=1e-6, bearing_sigma_deg=np.degrees(1e-7), integrity_risk=1e-5)
    k = norm.isf(1e-5 / 4)
    along, abeam = look(cars_at([[0, 0], [40, 0]], [0.0, 0.0]), config)[0], look(cars_at([[0, 0], [0, 40]]), config)[0]
    np.testing.assert_allclose([along["pl_at_m"], along["pl_ct_m"]], [k * 1e-6, k * 40 * 1e-7], rtol=1e-4)
    np.testing.assert_allclose([abeam["pl_at_m"], abeam["pl_ct_m"]], [k * 40 * 1e-7, k * 1e-6], rtol=1e-4)


def _errors(config: SensorConfig, looks: int, psi: float) -> tuple[Array, Array, Any]:
    """Errors along and across the measured heading, and the tracks, of a vehicle 40 m away turned by ``psi``."""
    vehicles = cars_at([[0, 0], [40, 0]], [0.0, psi], [10.0, 8.0])
    sensor, ego = Sensor(config, 1, 4), believe(speed_mps=10.0)
    tracks = np.concatenate([sensor.look(ego, vehicles)[:1] for _ in range(looks)])
    x, y, cos, sin = tracks["x_m"] - 40.0, tracks["y_m"], np.cos(tracks["heading_rad"]), np.sin(tracks["heading_rad"])
    return x * cos + y * sin, y * cos - x * sin, tracks


@pytest.mark.parametrize("psi", [0.0, 0.6, 1.6])
def test_errors_have_the_stated_size_and_break_their_bounds_as_often_as_stated(psi: float) -> None:
    looks, risk = 2000, 0.1
    at, ct, tracks = _errors(SensorConfig(integrity_risk=risk, lateral_bias_sigma_m=0.0), looks, psi)
    k = norm.isf(risk / 4)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], looks)  # each of the six assertions fails by chance once in 5000 seeds
    for error, level in ((at, tracks["pl_at_m"]), (ct, tracks["pl_ct_m"])):
        assert low < ((k * error / level) ** 2).sum() < high
        assert binom.ppf(1e-4, looks, risk / 2) <= (np.abs(error) > level).sum() <= binom.isf(1e-4, looks, risk / 2)
    assert low < (((tracks["speed_mps"] - 8.0) / 0.1) ** 2).sum() < high
    assert low < (((tracks["heading_rad"] - psi) / np.radians(2.0)) ** 2).sum() < high


@pytest.mark.parametrize("psi", [0.0, 0.6, 1.6])
def test_the_error_across_the_ego_stays_for_an_episode_and_is_bounded(psi: float) -> None:
    seeds, risk = 400, 0.1
    config = EXACT.replace(lateral_bias_sigma_m=0.5, integrity_risk=risk)
    vehicles, ego = cars_at([[0, 0], [40, 0]], [0.3, 0.3 + psi]), believe(heading_rad=0.3)
    found = []
    for seed in range(seeds):
        sensor = Sensor(config, 1, seed)
        first, again = (sensor.look(ego, vehicles)[0] for _ in range(2))
        assert (first["x_m"], first["y_m"]) == (again["x_m"], again["y_m"])
        x, y = first["x_m"] - 40.0, first["y_m"]
        across = y * np.cos(0.3) - x * np.sin(0.3)
        assert x * np.cos(0.3) + y * np.sin(0.3) == pytest.approx(0.0, abs=1e-9)
        k = norm.isf(risk / 4)
        levels = k * 0.5 * abs(np.sin(psi)), k * 0.5 * abs(np.cos(psi))
        assert (first["pl_at_m"], first["pl_ct_m"]) == pytest.approx(levels, abs=1e-9)
        found.append(across / 0.5)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], seeds)
    assert low < np.square(found).sum() < high


def test_a_track_out_of_sight_ages_and_moves_with_the_egos_odometry_not_with_its_jumps() -> None:
    sensor = Sensor(EXACT, 2)
    sensor.look(believe(speed_mps=10.0), cars_at([[0, 0], [20, 4], [40, 0]], speed_mps=10.0))
    hidden = cars_at([[1, 0], [21, 0], [41, 0]], speed_mps=10.0)
    track = sensor.look(believe(1.0 + 3.0, -1.0, speed_mps=10.0), hidden)[1]  # the solution jumps by (3, -1)
    np.testing.assert_allclose(track["time_s"], 0.1)
    np.testing.assert_allclose([track["x_m"], track["y_m"]], [40.0 + 3.0, -1.0])  # where it was, by the new reckoning
    sensor.batch.enter(0, 1, 9, 5.0, 2.0)
    assert math.isinf(sensor.look(believe(), hidden)[1]["time_s"])
