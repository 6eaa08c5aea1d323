"""The ego's picture of the traffic: broadcasts that come late or never, and how both sources go together."""

from __future__ import annotations

import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from beliefs import believe
from lanebound.envs.perception import Claims, Perception, PerceptionConfig, Vehicles
from lanebound.envs.records import EgoBelief, Traffic
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.effects import FaultEffects

DT = 0.1
EGO = 0
CLEAR = {"latency_s": 0.0, "jitter_s": 0.0, "loss": 0.0, "range_m": 1e9}
EXACT = {"range_sigma_m": 0.0, "bearing_sigma_deg": 0.0, "speed_sigma_mps": 0.0, "heading_sigma_deg": 0.0}


def believed(x: float = 0.0, y: float = 0.0, heading_rad: float = 0.0, speed_mps: float = 0.0) -> EgoBelief:
    return believe(position_m=np.array([x, y]), heading_rad=heading_rad, speed_mps=speed_mps, pl_at_m=1.0, pl_ct_m=1.0)


def there(position_m: Any, speed_mps: float = 0.0, heading_rad: Any = 0.0, **rest: Any) -> Vehicles:
    """Vehicles in slots and with keys 0, 1, ...; the ego is the first."""
    position = np.asarray(position_m, dtype=np.float64)
    v = position.shape[0]
    return replace(
        Vehicles(
            slot=np.arange(v),
            key=np.arange(v) + 100,
            position_m=position,
            heading_rad=np.broadcast_to(np.asarray(heading_rad, dtype=np.float64), (v,)).copy(),
            speed_mps=np.full(v, speed_mps),
            length_m=np.full(v, 5.0),
            width_m=np.full(v, 2.0),
        ),
        **rest,
    )


def honest(vehicles: Vehicles, capacity: int) -> Claims:
    """Claims of vehicles that know the truth, with levels of 1 m and 0.5 m."""
    claims = Claims(
        position_m=np.zeros((capacity, 2)),
        heading_rad=np.zeros(capacity),
        speed_mps=np.zeros(capacity),
        pl_at_m=np.full(capacity, 1.0),
        pl_ct_m=np.full(capacity, 0.5),
        initialised=np.ones(capacity, dtype=np.bool_),
    )
    claims.position_m[vehicles.slot] = vehicles.position_m
    claims.heading_rad[vehicles.slot] = vehicles.heading_rad
    claims.speed_mps[vehicles.slot] = vehicles.speed_mps
    return claims


class Street:
    """Steps a perception with honest claims unless told otherwise."""

    def __init__(self, capacity: int = 4, seed: int = 1, **config: Any) -> None:
        self.config = PerceptionConfig.load(config)
        self.perception = Perception(self.config, capacity, DT, Streams([seed]))
        self.effects = FaultEffects.none(capacity, 0)
        self.epoch = 0

    def step(self, vehicles: Vehicles, claims: Claims | None = None, ego: EgoBelief | None = None) -> Traffic:
        self.epoch += 1
        capacity = self.perception.capacity
        x, y = vehicles.position_m[0]
        ego = ego or believed(x, y, vehicles.heading_rad[0], vehicles.speed_mps[0])
        claims = claims or honest(vehicles, capacity)
        return self.perception.step(self.epoch * DT, ego, EGO, vehicles, claims, self.effects)


def test_clear_channel_tells_what_others_believe_nearest_first() -> None:
    traffic = Street(v2v=CLEAR).step(there([[0, 0], [50, 4], [-20, 0]], 10.0))
    np.testing.assert_array_equal(traffic.key, [102, 101])
    np.testing.assert_allclose(traffic.position_m, [[-20, 0], [50, 4]])
    np.testing.assert_allclose(traffic.heading_rad, 0.0, atol=1e-15)
    np.testing.assert_array_equal(traffic.pl_at_m, 1.0)
    np.testing.assert_array_equal(traffic.length_m, 5.0)
    assert not traffic.relative.any()


@pytest.mark.parametrize("heading_rad", [0.0, 0.7, -2.5])
def test_latency_shows_as_age_and_the_vehicle_is_brought_forward(heading_rad: float) -> None:
    street = Street(v2v={**CLEAR, "latency_s": 0.2})
    step_m = 12.0 * DT * np.array([np.cos(heading_rad), np.sin(heading_rad)])
    traffic = [street.step(there([[0, 0], [30, 4] + n * step_m], 12.0, heading_rad)) for n in range(6)]
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
        traffic = street.step(there([[0, 0], [x, y]], v))
    assert abs(traffic.position_m[0, 0] - x) <= traffic.pl_at_m[0] - 1.0 + 1e-9
    assert abs(traffic.position_m[0, 1] - y) <= traffic.pl_ct_m[0] - 0.5 + 1e-9


def test_share_of_fresh_messages_is_binomial_and_falls_with_the_distance() -> None:
    epochs, loss, range_m = 1000, 0.2, 100.0
    distance = np.array([1.0, 70.0, 95.0, 101.0])
    position = np.column_stack([np.r_[0.0, distance], np.zeros(5)])
    street = Street(5, v2v={**CLEAR, "loss": loss, "range_m": range_m}, drop_after_s=0.0)
    heard = np.zeros(105)
    for _ in range(epochs):
        heard[street.step(there(position)).key] += 1
    share = (1 - loss) * np.maximum(1 - (distance / range_m) ** 4, 0.0)
    low, high = binom.ppf([[1.25e-4], [1 - 1.25e-4]], epochs, share)  # fails by chance once in 1000 seeds
    assert (low <= heard[101:]).all()
    assert (heard[101:] <= high).all()
    assert heard[104] == 0


def test_a_vehicle_that_falls_silent_ages_and_is_dropped() -> None:
    street, vehicles = Street(v2v=CLEAR, drop_after_s=0.3), there([[0, 0], [20, 0]])
    street.step(vehicles)
    silent = replace(honest(vehicles, 4), initialised=np.zeros(4, dtype=np.bool_))
    ages = [street.step(vehicles, silent).age_s for _ in range(4)]
    np.testing.assert_allclose(np.concatenate(ages[:3]), [0.1, 0.2, 0.3])
    assert ages[3].size == 0


def test_without_a_position_silent_without_a_level_unbounded() -> None:
    street, vehicles = Street(v2v=CLEAR), there([[0, 0], [20, 0], [30, 0]])
    claims = honest(vehicles, 4)
    claims.initialised[1] = False
    claims.pl_at_m[2] = claims.pl_ct_m[2] = np.inf
    traffic = street.step(vehicles, claims)
    np.testing.assert_array_equal(traffic.key, [102])
    assert np.isinf([traffic.pl_at_m, traffic.pl_ct_m]).all()


def test_liar_is_displaced_east_and_north_and_promises_too_much() -> None:
    street = Street(v2v=CLEAR)
    street.effects = FaultEffects.blank(4, 0)
    street.effects.v2v_offset_enu_m[1] = [5.0, -2.0, 0.0]
    street.effects.v2v_pl_scale[1] = 0.1
    traffic = street.step(there([[0, 0], [20, 0]]))
    np.testing.assert_allclose(traffic.position_m, [[25.0, 2.0]])
    np.testing.assert_allclose([traffic.pl_at_m[0], traffic.pl_ct_m[0]], [0.1, 0.05])


def test_a_new_vehicle_inherits_nothing_from_the_slot() -> None:
    street, old = Street(v2v={**CLEAR, "latency_s": 0.2}), there([[0, 0], [20, 0]])
    for _ in range(5):
        street.step(old)
    new = replace(old, key=np.array([100, 777]))
    counts = [street.step(new) for _ in range(4)]
    assert [t.count for t in counts] == [0, 0, 1, 1]  # nor what the old one had under way
    assert counts[2].key[0] == 777


def test_one_that_leaves_stays_for_as_long_as_it_is_believed() -> None:
    street = Street(v2v=CLEAR, drop_after_s=0.2)
    street.step(there([[0, 0], [20, 0]], 10.0))
    counts = [street.step(there([[0, 0]])).count for _ in range(3)]
    assert counts == [1, 1, 0]


def test_one_that_changes_its_slot_is_known_once() -> None:
    street, vehicles = Street(v2v=CLEAR), there([[0, 0], [20, 0]])
    street.step(vehicles)
    moved = replace(vehicles, slot=np.array([0, 3]))
    traffic = street.step(moved, honest(moved, 4))
    np.testing.assert_array_equal(traffic.key, [101])
    assert traffic.age_s[0] == 0.0


def test_keys_stay_while_the_order_of_vehicles_changes() -> None:
    street, vehicles = Street(v2v=CLEAR), there([[0, 0], [20, 0], [40, 0]])
    street.step(vehicles)
    turned = Vehicles(*(getattr(vehicles, f)[[0, 2, 1]] for f in Vehicles.__dataclass_fields__))
    traffic = street.step(turned, honest(turned, 4))
    np.testing.assert_array_equal(traffic.key, [101, 102])
    np.testing.assert_allclose(traffic.position_m[:, 0], [20, 40])


def test_both_takes_the_newer_and_the_sensor_when_equally_old() -> None:
    street = Street(v2v=CLEAR, sensor=EXACT, source="both", drop_after_s=0.5)
    apart, hidden = there([[0, 0], [20, 4], [40, 0]]), there([[0, 0], [20, 0], [40, 0]])
    np.testing.assert_array_equal(street.step(apart).relative, [True, True])
    traffic = street.step(hidden)
    np.testing.assert_array_equal(traffic.key, [101, 102])
    np.testing.assert_array_equal(traffic.relative, [True, False])
    np.testing.assert_allclose(traffic.age_s, 0.0, atol=1e-12)
    far = street.step(there([[0, 0], [20, 0], [200, 0]]))
    np.testing.assert_array_equal(far.relative, [True, False])


def test_truth_is_everybody_as_they_are_and_none_is_nobody() -> None:
    vehicles = there([[0, 0], [900, 4], [-20, 0]], 10.0)
    traffic = Street(source="truth").step(vehicles)
    np.testing.assert_array_equal(traffic.key, [102, 101])
    np.testing.assert_array_equal(traffic.position_m, vehicles.position_m[[2, 1]])
    assert not traffic.pl_at_m.any()
    assert not traffic.age_s.any()
    assert Street(source="none").step(vehicles).count == 0


def _picture(street: Street, epochs: int) -> list[Traffic]:
    rng = np.random.default_rng(3)
    lanes = np.column_stack([np.sort(rng.uniform(-60, 60, 8)), 4.0 * rng.integers(0, 3, 8)])
    return [street.step(there(lanes + np.array([n, 0.0]), 10.0)) for n in range(epochs)]


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
        a, b = few.step(there(position[:3])), many.step(there(position))
    kept = b.key != 103
    np.testing.assert_array_equal(a.key, b.key[kept])
    np.testing.assert_array_equal(a.position_m, b.position_m[kept])


def test_claims_of_navigators_are_turned_into_the_plane() -> None:
    solution: Any = SimpleNamespace(
        position_en_m=np.array([[3.0, 4.0], [0.0, 0.0]]),
        heading_rad=np.array([0.5 * np.pi - 0.1, 0.0]),
        velocity_en_mps=np.array([[10.0, 0.0], [0.0, 0.0]]),
        speed_mps=np.array([10.0, 0.0]),
        pl_at_m=np.array([1.0, np.inf]),
        pl_ct_m=np.array([0.5, np.inf]),
        mode=np.array([Mode.RTK, Mode.NONE]),
    )
    claims = Claims.of(solution)
    np.testing.assert_array_equal(claims.position_m[0], [3.0, -4.0])
    assert claims.heading_rad[0] == 0.0  # the course, not the heading
    assert claims.heading_rad[1] == -0.5 * np.pi
    np.testing.assert_array_equal(claims.initialised, [True, False])


def test_bad_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="source"):
        PerceptionConfig.load({"source": "radio"})
    with pytest.raises(InputError, match="streams"):
        Perception(PerceptionConfig(), 2, DT, Streams([1, 2]))
    vehicles = there([[0, 0], [20, 0]])
    with pytest.raises(InputError, match=r"slot must lie in \[0, 4\)"):
        Street().step(replace(vehicles, slot=np.array([0, 4])), honest(vehicles, 4))
    with pytest.raises(InputError, match="repeat"):
        Street().step(replace(vehicles, slot=np.array([0, 0])))
    with pytest.raises(InputError, match="add the ego"):
        Street().step(replace(vehicles, slot=np.array([1, 2])))
