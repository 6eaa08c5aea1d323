"""The ego's picture of the traffic: broadcasts that come late or never, and how both sources go together."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from lanebound.envs.batch import perception_kernel as pk
from lanebound.envs.batch.belief_kernel import FIX
from lanebound.envs.batch.perception import PerceptionBatch
from lanebound.envs.batch.records_kernel import BELIEF, PERCEIVED
from lanebound.envs.perception import PerceptionConfig
from lanebound.envs.records import Traffic
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import Records
from lanebound.integrity.positioning.modes import Mode
from vehicles import cars_at, record_of

DT, ROW = 0.1, np.zeros(1, dtype=np.int64)
CLEAR = {"latency_s": 0.0, "jitter_s": 0.0, "loss": 0.0, "range_m": 1e9}
EXACT = {
    "range_sigma_m": 0.0, "bearing_sigma_deg": 0.0, "lateral_bias_sigma_m": 0.0, "speed_sigma_mps": 0.0,
    "heading_sigma_deg": 0.0,
}  # fmt: skip


def honest(car: Records, capacity: int) -> Any:
    """What vehicles that know the truth broadcast, with levels of 1 m and 0.5 m: (C,) CLAIM by slot."""
    claims = np.zeros(capacity, pk.CLAIM)
    claims["pl_at_m"], claims["pl_ct_m"], claims["sends"] = 1.0, 0.5, 1
    for name, field in (("x_m", "x"), ("y_m", "y"), ("heading_rad", "heading"), ("speed_mps", "speed")):
        claims[name][car["slot"][1:]] = car[field][1:]
    return claims


class Street:
    """Steps the picture of one ego with honest claims unless told otherwise; vehicles have the keys 1, 2, ..."""

    def __init__(self, capacity: int = 4, seed: int = 1, **config: Any) -> None:
        self.picture = PerceptionBatch(PerceptionConfig.load(config), 1, capacity, capacity + 1, DT)
        self.capacity, self.epoch, self.lies = capacity, 0, None
        names = np.column_stack([np.arange(capacity + 1.0), np.zeros(capacity + 1)])
        crew = cars_at(names)[None]
        self.picture.begin(ROW, [seed], np.ones((1, capacity), dtype=np.bool_), crew)

    def step(self, car: Records, claims: Any = None) -> Traffic:
        self.epoch += 1
        batch, p, time = self.picture, self.picture.pictures, self.epoch * DT
        x, y, heading, speed = car[["x", "y", "heading", "speed"]][0]
        ego = record_of(BELIEF, x_m=x, y_m=y, heading_rad=heading, speed_mps=speed)
        if batch.has_radio:
            said = honest(car, self.capacity) if claims is None else claims
            u = batch._draw("v2v", ROW, 2)[0]
            pk.hear(p.picture[0], p.radio, 0, p.of_radio[0], time, said, car, u, self.lies)
        if batch.has_sensor:
            noise, ahead = batch._draw("sensor", ROW, 4)[0], np.empty((len(car), 2))
            pk.look(p.picture[0], p.tracks[0], p.of_sensor[0], ego, car, noise, ahead, p.walls)
        square = np.empty(self.capacity + 2)
        count = pk.sum_up(p.radio, p.tracks[0], p.slots[0], 0, p.of_tracks[0], time, ego, square, p.perceived[0])
        return Traffic.of(p.perceived[0, :count])


def test_clear_channel_tells_what_others_believe_nearest_first() -> None:
    traffic = Street(v2v=CLEAR).step(cars_at([[0, 0], [50, 4], [-20, 0]], speed_mps=10.0))
    np.testing.assert_array_equal(traffic.key, [2, 1])
    np.testing.assert_allclose(traffic.position_m, [[-20, 0], [50, 4]])
    np.testing.assert_allclose(traffic.heading_rad, 0.0, atol=1e-15)
    np.testing.assert_array_equal(traffic.pl_at_m, 1.0)
    np.testing.assert_array_equal(traffic.length_m, 5.0)
    assert not traffic.relative.any()


@pytest.mark.parametrize("heading_rad", [0.0, 0.7, -2.5])
def test_latency_shows_as_age_and_the_vehicle_is_brought_forward(heading_rad: float) -> None:
    street = Street(v2v={**CLEAR, "latency_s": 0.2})
    step_m = 12.0 * DT * np.array([np.cos(heading_rad), np.sin(heading_rad)])
    traffic = [street.step(cars_at([[0, 0], [30, 4] + n * step_m], heading_rad, 12.0)) for n in range(6)]
    assert traffic[1].count == 0
    np.testing.assert_allclose(traffic[5].age_s, 0.2)
    np.testing.assert_allclose(traffic[5].position_m[0], [30, 4] + 5 * step_m)
    np.testing.assert_allclose(traffic[5].pl_at_m, 1.0 + 0.5 * 8.0 * 0.2**2)
    np.testing.assert_allclose(traffic[5].pl_ct_m, 0.5 + 0.5 * 8.0 * 0.2**2 + 12.0 * 0.2 * np.sin(np.radians(5.0)))


@given(acceleration=st.floats(-8.0, 8.0), lateral=st.floats(-8.0, 8.0), age=st.integers(1, 10))
def test_grown_levels_bound_any_acceleration_within_the_bound(acceleration: float, lateral: float, age: int) -> None:
    street = Street(v2v={**CLEAR, "rate_hz": 0.5})
    traffic = Traffic.none()
    for n in range(20 + age):  # the one message goes out in epoch 20
        t = (n - 19) * DT
        x, v = 50.0 + 15.0 * t + 0.5 * acceleration * t * t, 15.0 + acceleration * t
        y = 0.5 * lateral * t * t + 15.0 * np.tan(np.radians(4.9)) * t
        traffic = street.step(cars_at([[0, 0], [x, y]], speed_mps=v))
    assert abs(traffic.position_m[0, 0] - x) <= traffic.pl_at_m[0] - 1.0 + 1e-9
    assert abs(traffic.position_m[0, 1] - y) <= traffic.pl_ct_m[0] - 0.5 + 1e-9


def test_share_of_fresh_messages_is_binomial_and_falls_with_the_distance() -> None:
    epochs, loss, range_m = 1000, 0.2, 100.0
    distance = np.array([1.0, 70.0, 95.0, 101.0])
    position = np.column_stack([np.r_[0.0, distance], np.zeros(5)])
    street = Street(5, v2v={**CLEAR, "loss": loss, "range_m": range_m}, drop_after_s=0.0)
    heard = np.zeros(5)
    for _ in range(epochs):
        heard[street.step(cars_at(position)).key] += 1
    share = (1 - loss) * np.maximum(1 - (distance / range_m) ** 4, 0.0)
    low, high = binom.ppf([[1.25e-4], [1 - 1.25e-4]], epochs, share)  # fails by chance once in 1000 seeds
    assert (low <= heard[1:]).all()
    assert (heard[1:] <= high).all()
    assert heard[4] == 0


def test_a_vehicle_that_falls_silent_ages_and_is_dropped() -> None:
    street, vehicles = Street(v2v=CLEAR, drop_after_s=0.3), cars_at([[0, 0], [20, 0]])
    street.step(vehicles)
    silent = honest(vehicles, 4)
    silent["sends"] = 0
    ages = [street.step(vehicles, silent).age_s for _ in range(4)]
    np.testing.assert_allclose(np.concatenate(ages[:3]), [0.1, 0.2, 0.3])
    assert ages[3].size == 0


def test_without_a_position_silent_without_a_level_unbounded() -> None:
    street, vehicles = Street(v2v=CLEAR), cars_at([[0, 0], [20, 0], [30, 0]])
    claims = honest(vehicles, 4)
    claims["sends"][0] = 0
    claims["pl_at_m"][1] = claims["pl_ct_m"][1] = np.inf
    traffic = street.step(vehicles, claims)
    np.testing.assert_array_equal(traffic.key, [2])
    assert np.isinf([traffic.pl_at_m, traffic.pl_ct_m]).all()


def test_liar_is_displaced_east_and_north_and_promises_too_much() -> None:
    street = Street(v2v=CLEAR)
    street.lies = np.tile([0.0, 0.0, 0.0, 1.0], (1, 4, 1))
    street.lies[0, 0] = 5.0, -2.0, 0.0, 0.1
    traffic = street.step(cars_at([[0, 0], [20, 0]]))
    np.testing.assert_allclose(traffic.position_m, [[25.0, 2.0]])
    np.testing.assert_allclose([traffic.pl_at_m[0], traffic.pl_ct_m[0]], [0.1, 0.05])


def test_a_new_vehicle_inherits_nothing_from_the_slot() -> None:
    street, old = Street(v2v={**CLEAR, "latency_s": 0.2}), cars_at([[0, 0], [20, 0]])
    for _ in range(5):
        street.step(old)
    street.picture.enter(0, 0, 777, 5.0, 2.0)
    counts = [street.step(old) for _ in range(4)]
    assert [t.count for t in counts] == [0, 0, 1, 1]  # nor what the old one had under way
    assert counts[2].key[0] == 777


def test_one_that_leaves_stays_for_as_long_as_it_is_believed() -> None:
    street = Street(v2v=CLEAR, drop_after_s=0.2)
    street.step(cars_at([[0, 0], [20, 0]], speed_mps=10.0))
    counts = [street.step(cars_at([[0, 0]])).count for _ in range(3)]
    assert counts == [1, 1, 0]


def test_keys_stay_while_the_order_of_vehicles_changes() -> None:
    street, vehicles = Street(v2v=CLEAR), cars_at([[0, 0], [20, 0], [40, 0]])
    street.step(vehicles)
    turned = cars_at([[0, 0], [40, 0], [20, 0]])
    turned["slot"][:] = [-1, 1, 0]
    traffic = street.step(turned)
    np.testing.assert_array_equal(traffic.key, [1, 2])
    np.testing.assert_allclose(traffic.position_m[:, 0], [20, 40])


def test_both_takes_the_newer_and_the_sensor_when_equally_old() -> None:
    street = Street(v2v=CLEAR, sensor=EXACT, source="both", drop_after_s=0.5)
    apart, hidden = cars_at([[0, 0], [20, 4], [40, 0]]), cars_at([[0, 0], [20, 0], [40, 0]])
    np.testing.assert_array_equal(street.step(apart).relative, [True, True])
    traffic = street.step(hidden)
    np.testing.assert_array_equal(traffic.key, [1, 2])
    np.testing.assert_array_equal(traffic.relative, [True, False])
    np.testing.assert_allclose(traffic.age_s, 0.0, atol=1e-12)
    far = street.step(cars_at([[0, 0], [20, 0], [200, 0]]))
    np.testing.assert_array_equal(far.relative, [True, False])


def test_truth_is_everybody_as_they_are_and_who_has_no_slot_is_overlooked() -> None:
    car = cars_at([[0, 0], [900, 4], [-20, 0], [5, 0]], speed_mps=10.0)
    car["slot"][3] = -1
    for every, keys in ((False, [2, 1]), (True, [3, 2, 1])):
        seen = np.zeros(3, PERCEIVED)
        count = pk.see_truth(car, 0.0, 0.0, every, seen)
        traffic = Traffic.of(seen[:count])
        np.testing.assert_array_equal(traffic.key, keys)
        np.testing.assert_array_equal(traffic.position_m, np.column_stack([car["x"], car["y"]])[keys])
        assert not traffic.pl_at_m.any()
        assert not traffic.age_s.any()


def _picture(street: Street, epochs: int) -> list[Traffic]:
    rng = np.random.default_rng(3)
    lanes = np.column_stack([np.sort(rng.uniform(-60, 60, 8)), 4.0 * rng.integers(0, 3, 8)])
    return [street.step(cars_at(lanes + np.array([n, 0.0]), speed_mps=10.0)) for n in range(epochs)]


def _assert_same(one: list[Traffic], two: list[Traffic]) -> None:
    for a, b in zip(one, two, strict=True):
        for field in Traffic.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


@pytest.mark.parametrize("source", ["v2v", "sensor", "both"])
def test_same_seed_same_bits_and_a_copy_goes_on_alike(source: str) -> None:
    one, two = Street(8, source=source), Street(8, source=source)
    _assert_same(_picture(one, 20), _picture(two, 20))
    twin = copy.deepcopy(one)
    _assert_same(_picture(one, 10), _picture(twin, 10))
    other = _picture(Street(8, seed=2, source=source), 20)
    with pytest.raises(AssertionError):
        _assert_same(_picture(Street(8, source=source), 20), other)


def test_one_vehicle_more_moves_no_draw_of_the_others() -> None:
    position = [[0, 0], [20, 4], [-30, -4], [40, 8]]
    few, many = Street(source="both"), Street(source="both")
    for _ in range(10):
        a, b = few.step(cars_at(position[:3])), many.step(cars_at(position))
    kept = b.key != 3
    np.testing.assert_array_equal(a.key, b.key[kept])
    np.testing.assert_array_equal(a.position_m, b.position_m[kept])


def test_claims_of_navigators_are_turned_into_the_plane() -> None:
    fixes = np.zeros(2, FIX)
    fixes["position_en_m"], fixes["heading_rad"] = [[3.0, 4.0], [0.0, 0.0]], [0.5 * np.pi - 0.1, 0.0]
    fixes["velocity_en_mps"], fixes["speed_mps"] = [[10.0, 0.0], [0.0, 0.0]], [10.0, 0.0]
    fixes["pl_at_m"], fixes["pl_ct_m"] = [1.0, np.inf], [0.5, np.inf]
    fixes["mode"] = int(Mode.RTK), int(Mode.NONE)
    claims = np.zeros(2, pk.CLAIM)
    for v in range(2):
        pk.claim(fixes[v], claims[v])
    assert (claims["x_m"][0], claims["y_m"][0]) == (3.0, -4.0)
    assert claims["heading_rad"][0] == 0.0  # the course, not the heading
    assert claims["heading_rad"][1] == -0.5 * np.pi
    np.testing.assert_array_equal(claims["sends"], [1, 0])


def test_bad_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="source"):
        PerceptionConfig.load({"source": "radio"})
