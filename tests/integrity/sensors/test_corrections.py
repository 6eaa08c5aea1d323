import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest, norm, poisson

from lanebound.integrity.errors import ConfigError, InputError
from lanebound.integrity.sensors import corrections
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.streams import Streams


def _ages(config, epochs, dt=0.1, batch=1, lost=lambda n: False, seed=1):
    """(epochs, B) ages; ``lost`` says for each epoch, counted from 1, whether a fault cuts the link."""
    state, streams = corrections.initial_state(batch), Streams(seed, batch)
    return np.array(
        [corrections.step(config, state, dt, np.full(batch, lost(n)), streams) for n in range(1, epochs + 1)]
    )


def test_age_is_a_sawtooth_from_the_latency_on():
    ages = _ages(CorrectionsConfig(), 36)[:, 0]
    assert np.isinf(ages[:2]).all()  # the first message, measured at 0, arrives after 0.3 s
    np.testing.assert_allclose(ages[2:], 0.3 + 0.1 * (np.arange(34) % 10), atol=1e-12)


def test_nothing_drifts_in_ten_hours():
    state, streams = corrections.initial_state(1), Streams(0, 1)
    state.epoch[:] = 360_000
    state.due[:] = state.newest[:] = 35_999
    for n in range(20):
        age = corrections.step(CorrectionsConfig(), state, 0.1, np.zeros(1, dtype=bool), streams)
        assert age[0] == pytest.approx(0.3 + 0.1 * ((n - 2) % 10), abs=1e-9)


@given(
    dt=st.sampled_from([0.01, 0.05, 0.1, 0.25, 1.0 / 15.0, 0.7]),
    interval=st.sampled_from([0.1, 0.5, 1.0, 5.0]),
    latency=st.sampled_from([0.0, 0.3, 1.7]),
)
def test_ages_lie_within_latency_and_an_interval_more(dt, interval, latency):
    config = CorrectionsConfig(interval_s=interval, latency_s=latency)
    ages = _ages(config, 200, dt)
    ages = ages[np.isfinite(ages)]
    assert ages.size > 0
    assert (ages > latency - 1e-6).all()
    assert (ages < latency + interval + 1e-6).all()


def test_a_cut_link_lets_the_age_grow_until_the_next_message():
    ages = _ages(CorrectionsConfig(), 100, lost=lambda n: 20 <= n <= 60)[:, 0]
    # the last message heard was measured at 1 s; those of 2 to 5 s are lost, that of 6 s arrives at 6.3 s
    np.testing.assert_allclose(ages[19:62], 0.1 * np.arange(20, 63) - 1.0, atol=1e-9)
    assert ages[62] == pytest.approx(0.3, abs=1e-9)
    assert np.isinf(_ages(CorrectionsConfig(), 30, lost=lambda n: True)).all()


def test_faults_cut_only_the_vehicles_they_name():
    state, streams, lost = corrections.initial_state(3), Streams([1, 2, 3]), np.array([False, True, False])
    for _ in range(30):
        age = corrections.step(CorrectionsConfig(), state, 0.1, lost, streams)
    assert np.isfinite(age[[0, 2]]).all()
    assert np.isinf(age[1])


def _outages(config, batch, epochs, dt):
    """Lengths [s] of all outages of ``batch`` vehicles that begin and end within ``epochs``, and the time spent up."""
    state, streams, up = corrections.initial_state(batch), Streams(7, batch), 0
    lengths = []
    none = np.zeros(batch, dtype=bool)
    for _ in range(epochs):
        before = state.outage_left.copy()
        corrections.step(config, state, dt, none, streams)
        begun = (before == 0) & (state.outage_left > 0)
        lengths.extend((state.outage_left[begun] + 1) * dt)
        up += int((before == 0).sum())
    return np.array(lengths), up * dt


def test_outages_come_at_their_rate_and_last_lognormally():
    config = CorrectionsConfig(outage_per_h=60.0, outage_max_s=1e6)
    lengths, up_s = _outages(config, batch=500, epochs=6000, dt=0.1)
    low, high = poisson.interval(1 - 1e-4, 60.0 * up_s / 3600.0)  # fails by chance once in 10,000 seeds
    assert low <= lengths.size <= high
    # lengths are rounded up to whole epochs: half an epoch comes off before the comparison
    law = norm(np.log(11.5), 0.8)
    assert kstest(np.log(lengths - 0.05), law.cdf).pvalue > 1e-4  # fails by chance once in 10,000 seeds


def test_outages_are_cut_off_at_the_longest():
    lengths, _ = _outages(CorrectionsConfig(outage_per_h=600.0), batch=200, epochs=2000, dt=0.1)
    assert lengths.max() == pytest.approx(49.2)


def test_an_outage_is_silent_for_its_length():
    config = CorrectionsConfig(outage_per_h=1e9, outage_median_s=5.0, outage_log_sd=0.0, interval_s=0.1, latency_s=0.0)
    ages = _ages(config, 200)[:, 0]  # the next outage begins as soon as one ends: no message is ever heard
    assert np.isinf(ages).all()
    state, streams = corrections.initial_state(1), Streams(1, 1)
    state.outage_left[:] = 50
    quiet = config.replace(outage_per_h=0.0)
    ages = np.array([corrections.step(quiet, state, 0.1, np.zeros(1, dtype=bool), streams)[0] for _ in range(60)])
    assert np.isinf(ages[:50]).all()
    np.testing.assert_allclose(ages[50:], 0.0, atol=1e-12)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000))
def test_a_copied_state_goes_on_alike_and_alone(seed):
    config = CorrectionsConfig(outage_per_h=1000.0)
    state, streams = corrections.initial_state(2), Streams([seed, seed + 1])
    none = np.zeros(2, dtype=bool)
    for _ in range(20):
        corrections.step(config, state, 0.1, none, streams)
    twin, twin_streams = state.copy(), streams.snapshot()
    ahead = [corrections.step(config, state, 0.1, none, streams) for _ in range(30)]
    again = [corrections.step(config, twin, 0.1, none, twin_streams) for _ in range(30)]
    np.testing.assert_array_equal(ahead, again)


def test_a_vehicle_has_the_same_link_in_any_batch():
    config, none = CorrectionsConfig(outage_per_h=1000.0), np.zeros(1, dtype=bool)
    many, alone = corrections.initial_state(3), corrections.initial_state(1)
    streams, own = Streams([4, 5, 6]), Streams([5])
    for _ in range(300):
        ages = corrections.step(config, many, 0.1, np.zeros(3, dtype=bool), streams)
        assert ages[1] == corrections.step(config, alone, 0.1, none, own)[0]


def test_refuses_what_cannot_be():
    state, streams = corrections.initial_state(2), Streams(1, 2)
    with pytest.raises(InputError, match="dt_s must be positive"):
        corrections.step(CorrectionsConfig(), state, 0.0, np.zeros(2, dtype=bool), streams)
    with pytest.raises(InputError, match="must serve 2 vehicles"):
        corrections.step(CorrectionsConfig(), state, 0.1, np.zeros(3, dtype=bool), streams)
    with pytest.raises(InputError, match="batch must be >= 1"):
        corrections.initial_state(0)
    with pytest.raises(ConfigError, match="outage_per_h must be >= 0"):
        CorrectionsConfig(outage_per_h=-1.0)
