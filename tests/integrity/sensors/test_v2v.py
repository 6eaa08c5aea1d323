"""The broadcast channel: latency, loss, range, liars, and what is held in between."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.v2v import V2vConfig, V2vInbox, V2vMessage, exchange, forget, initial_v2v

DT = 0.1
PERFECT = V2vConfig(latency_s=0.0, jitter_s=0.0, loss=0.0, range_m=1e9)


def _message(batch: int, time_s: float = 0.0) -> V2vMessage:
    vehicle = np.arange(batch, dtype=np.float64)
    position = np.column_stack([10.0 * vehicle + time_s, vehicle])
    return V2vMessage(position, 0.1 * vehicle, 10.0 + vehicle, 1.0 + vehicle, 0.5 + vehicle)


def _run(config: V2vConfig, epochs: int, batch: int = 3, gap_m: float = 10.0, seed: int = 1) -> list[V2vInbox]:
    state, streams = initial_v2v(config, batch, DT), Streams(seed, batch)
    antenna = np.column_stack([gap_m * np.arange(batch), np.zeros(batch)])
    none = FaultEffects.none(batch, 0)
    return [
        exchange(config, state, n * DT, DT, _message(batch, n * DT), antenna, none, streams)
        for n in range(1, epochs + 1)
    ]


def test_perfect_channel_delivers_each_senders_own_words_at_once() -> None:
    inbox = _run(PERFECT, 1)[0]
    assert inbox.heard.sum() == 6
    assert not inbox.heard.diagonal().any()
    assert inbox.age_s[0, 2] == 0.0
    np.testing.assert_allclose(inbox.position_en_m[0, 2], [20.0 + DT, 2.0])
    assert inbox.speed_mps[1, 2] == 12.0
    assert inbox.pl_at_m[1, 0] == 1.0
    assert inbox.pl_ct_m[1, 0] == 0.5


def test_latency_is_the_age_at_reception() -> None:
    config = PERFECT.replace(latency_s=0.2)
    boxes = _run(config, 10)
    assert not boxes[1].heard.any()
    assert np.isinf(boxes[1].pl_at_m).all()
    np.testing.assert_allclose(boxes[5].age_s[0, 1], 0.2)
    np.testing.assert_allclose(boxes[5].position_en_m[0, 1, 0], 10.0 + 0.4)


def test_slow_senders_are_held_and_age() -> None:
    ages = [box.age_s[0, 1] for box in _run(PERFECT.replace(rate_hz=2.0), 20)]
    np.testing.assert_allclose(ages[5:10], [0.1, 0.2, 0.3, 0.4, 0.0], atol=1e-9)


def test_share_lost_is_binomial() -> None:
    epochs, loss = 2000, 0.3
    boxes = _run(PERFECT.replace(loss=loss), epochs, batch=2)
    fresh = sum(box.age_s[0, 1] < 0.05 for box in boxes)
    low, high = binom.ppf([5e-4, 1 - 5e-4], epochs, 1 - loss)  # fails by chance once in 1000 seeds
    assert low <= fresh <= high


def test_nothing_is_heard_beyond_the_range_or_from_another_street() -> None:
    assert not _run(PERFECT.replace(range_m=9.9), 5)[-1].heard.any()
    state, streams = initial_v2v(PERFECT, 3, DT), Streams(1, 3)
    street = np.array([0, 1, 1])
    box = exchange(PERFECT, state, DT, DT, _message(3), np.zeros((3, 2)), FaultEffects.none(3, 0), streams, street)
    assert box.heard[1, 2]
    assert not box.heard[0].any()


def test_jitter_never_brings_an_older_message_over_a_newer_one() -> None:
    config = V2vConfig(jitter_s=0.2, loss=0.2)
    stamps = np.array([n * DT - box.age_s[0, 1] for n, box in enumerate(_run(config, 500), start=1) if box.heard[0, 1]])
    assert (np.diff(stamps) >= -1e-9).all()
    assert np.diff(stamps).max() > 0.15


def test_liar_displaces_its_position_and_shrinks_its_levels() -> None:
    effects = FaultEffects.blank(3, 0)
    effects.v2v_offset_enu_m[1] = [5.0, -2.0, 0.0]
    effects.v2v_pl_scale[1] = 0.1
    state, streams = initial_v2v(PERFECT, 3, DT), Streams(1, 3)
    box = exchange(PERFECT, state, DT, DT, _message(3), np.zeros((3, 2)), effects, streams)
    np.testing.assert_allclose(box.position_en_m[0, 1], [15.0, -1.0])
    np.testing.assert_allclose(box.pl_at_m[0], [np.inf, 0.2, 3.0])


def test_missing_level_stays_missing() -> None:
    message = _message(2)
    message.pl_at_m[:] = np.inf
    state, streams = initial_v2v(PERFECT, 2, DT), Streams(1, 2)
    box = exchange(PERFECT, state, DT, DT, message, np.zeros((2, 2)), FaultEffects.none(2, 0), streams)
    assert np.isinf(box.pl_at_m).all()
    assert not np.isnan(box.age_s).any()


def test_same_seed_same_bits_and_a_copy_goes_on_alike() -> None:
    config = V2vConfig(jitter_s=0.1)
    a, b = _run(config, 30, seed=5)[-1], _run(config, 30, seed=5)[-1]
    np.testing.assert_array_equal(a.age_s, b.age_s)
    state, streams = initial_v2v(config, 2, DT), Streams(1, 2)
    twin, twin_streams = state.copy(), streams.snapshot()
    none, still = FaultEffects.none(2, 0), np.zeros((2, 2))
    for n in range(1, 20):
        one = exchange(config, state, n * DT, DT, _message(2), still, none, streams)
        two = exchange(config, twin, n * DT, DT, _message(2), still, none, twin_streams)
        np.testing.assert_array_equal(one.age_s, two.age_s)


def test_one_receiver_holds_what_it_would_hold_among_all() -> None:
    config, none = V2vConfig(jitter_s=0.1, loss=0.3, range_m=100.0), FaultEffects.none(3, 0)
    antenna = np.column_stack([30.0 * np.arange(3), np.zeros(3)])
    state, streams = initial_v2v(config, 3, DT), Streams([7, 8, 9])
    alone, own = initial_v2v(config, 3, DT, receivers=2), Streams([9, 7])
    for n in range(1, 100):
        box = exchange(config, state, n * DT, DT, _message(3, n * DT), antenna, none, streams)
        two = exchange(config, alone, n * DT, DT, _message(3, n * DT), antenna, none, own, receivers=[2, 0])
        np.testing.assert_array_equal(two.age_s, box.age_s[[2, 0]])
        np.testing.assert_array_equal(two.position_en_m, box.position_en_m[[2, 0]])
        np.testing.assert_array_equal(two.pl_at_m, box.pl_at_m[[2, 0]])


def test_silent_vehicles_are_not_heard_and_forgotten_ones_no_more() -> None:
    config, none = PERFECT.replace(latency_s=0.2), FaultEffects.none(3, 0)
    state, streams, still = initial_v2v(config, 3, DT), Streams(1, 3), np.zeros((3, 2))
    sending = np.array([True, True, False])
    for n in range(1, 6):
        box = exchange(config, state, n * DT, DT, _message(3), still, none, streams, sending=sending)
    np.testing.assert_array_equal(box.heard[0], [False, True, False])
    forget(state, np.array([1]))
    box = exchange(config, state, 0.6, DT, _message(3), still, none, streams, sending=np.zeros(3, dtype=np.bool_))
    assert not box.heard[0].any()
    assert box.heard[1, 0]
    np.testing.assert_array_equal([box.age_s[0, 1], box.pl_at_m[0, 1], box.speed_mps[0, 1]], [np.inf, np.inf, 0.0])


def test_bad_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="loss"):
        V2vConfig(loss=1.5)
    with pytest.raises(InputError, match="dt_s"):
        initial_v2v(PERFECT, 2, 0.0)
    state, none = initial_v2v(PERFECT, 2, DT), FaultEffects.none(2, 0)
    with pytest.raises(InputError, match="antenna_en_m"):
        exchange(PERFECT, state, DT, DT, _message(2), np.zeros((3, 2)), none, Streams(1, 2))
    with pytest.raises(InputError, match="finite"):
        exchange(PERFECT, state, DT, DT, _message(2), np.full((2, 2), np.nan), none, Streams(1, 2))
    with pytest.raises(InputError, match="receivers"):
        initial_v2v(PERFECT, 2, DT, receivers=3)
    with pytest.raises(InputError, match="streams"):
        exchange(PERFECT, state, DT, DT, _message(2), np.zeros((2, 2)), none, Streams(1, 3))
