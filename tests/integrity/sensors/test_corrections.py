import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest, norm, poisson

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors import corrections
from lanebound.integrity.sensors import corrections_kernel as kernel
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.corrections import CorrectionsConfig


@jit
def received(epoch, rules, areas, sent, u, z, lost, links, held, age):
    """The reception of each vehicle: its age."""
    for v in range(age.shape[0]):
        a = v % areas.shape[0]
        age[v] = kernel.receive(epoch, rules[0], areas[a], sent[a], u[v], z[v], lost[v], links[v], held[v])


class _Link:
    """The links of a batch of vehicles, in one area or each in its own, stepped epoch by epoch."""

    def __init__(self, config, batch=1, dt=0.1, seeds=1, area=None):
        self.config, self.dt, self.batch = config, dt, batch
        self.streams, own = (Streams(seeds, None if isinstance(seeds, list) else batch) for _ in range(2))
        self.area_streams = own if area is None else Streams([area])
        self.network = corrections.initial_network(config, dt, self.area_streams)
        self.state = corrections.initial_state(config, self.network, 2, dt, self.streams)
        self.sent = np.zeros((self.area_streams.batch, 2), gk.STATION)

    def step(self, lost=False):
        """The ages (B,) after one epoch, by the kernels that the instruments call."""
        config, network, none = self.config, self.network, np.zeros(self.batch)
        rules, outages = corrections.link_parameters(config, self.dt), config.outage_per_h > 0.0
        network.epoch += 1
        z = self.area_streams.normal("network", 2) if outages else np.zeros((network.areas.size, 2))
        kernel.advance_networks(network.epoch, rules[0], z, network.areas)
        self.sent["code_multipath"] = network.areas["message"][:, None]  # every message says its number
        u, z = (getattr(self.streams, law)("corrections") if outages else none for law in ("uniform", "normal"))
        lost, age = np.broadcast_to(lost, self.batch).copy(), np.empty(self.batch)
        received(network.epoch, rules, network.areas, self.sent, u, z, lost, self.state.links, self.state.held, age)
        return age

    def up(self, epochs):
        """(epochs, B) bool, whether the link carries messages."""
        return np.array([self.step() is not None and self.state.links["up"].copy() for _ in range(epochs)])


def _ages(config, epochs, dt=0.1, batch=1, lost=lambda n: False, seed=1):
    """(epochs, B) ages; ``lost`` says for each epoch, counted from 1, whether a fault cuts the link."""
    link = _Link(config, batch, dt, seed)
    return np.array([link.step(lost(n)) for n in range(1, epochs + 1)])


def test_age_is_a_sawtooth_from_the_latency_on():
    ages = _ages(CorrectionsConfig(), 36)[:, 0]
    assert np.isinf(ages[:2]).all()  # the first message, measured at 0, arrives after 0.3 s
    np.testing.assert_allclose(ages[2:], 0.3 + 0.1 * (np.arange(34) % 10), atol=1e-12)


def test_nothing_drifts_in_ten_hours():
    link = _Link(CorrectionsConfig())
    link.network.epoch, link.network.areas["message"] = 360_000, 35_999
    link.state.links["newest"] = 35_999
    for n in range(20):
        assert link.step()[0] == pytest.approx(0.3 + 0.1 * ((n - 2) % 10), abs=1e-9)


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
    link = _Link(CorrectionsConfig(), 3, seeds=[1, 2, 3])
    for _ in range(30):
        age = link.step(np.array([False, True, False]))
    assert np.isfinite(age[[0, 2]]).all()
    assert np.isinf(age[1])


def test_what_is_held_is_the_newest_message_received():
    link = _Link(CorrectionsConfig(outage_per_h=200.0), 3, area=1)
    for n in range(1, 600):
        link.step(np.array([n % 70 < 40, False, n < 100]))
        newest, held = link.state.links["newest"], link.state.held["code_multipath"]
        expected = np.where(newest >= 0, newest, 0)[:, None]
        np.testing.assert_array_equal(held, np.broadcast_to(expected, held.shape))
    assert len(set(newest)) > 1


def _runs(down):
    """Lengths in epochs of the runs of True in each column that begin and end within it."""
    edge = np.diff(down.astype(np.int8), axis=0)
    lengths = []
    for column in edge.T:
        begins, ends = np.flatnonzero(column > 0), np.flatnonzero(column < 0)
        ends = ends[ends > begins[0]] if begins.size else ends[:0]
        lengths.extend(ends - begins[: ends.size])
    return np.array(lengths)


def test_outages_of_one_vehicle_come_at_their_rate_and_last_lognormally():
    config = CorrectionsConfig(outage_per_h=60.0, outage_max_s=1e6, network_share=0.0)
    down = ~_Link(config, batch=500, seeds=7).up(6000)
    begun = (down[1:] & ~down[:-1]).sum()
    low, high = poisson.interval(1 - 1e-4, 60.0 * (~down[:-1]).sum() * 0.1 / 3600.0)  # fails once in 10,000 seeds
    assert low <= begun <= high
    # runs are whole epochs: half an epoch comes off; 600 s see few of the longest, so only the shorter half is compared
    lengths, law = 0.1 * _runs(down) - 0.05, norm(np.log(11.5), 0.8)
    short = lengths[lengths < 11.5]
    assert kstest(np.log(short), lambda x: law.cdf(x) / 0.5).pvalue > 1e-4  # fails by chance once in 10,000 seeds


LAWS = [
    {"outage_per_h": 34.0, "outage_median_s": 14.0, "outage_log_sd": 0.4, "outage_max_s": 35.0},
    {"outage_per_h": 38.0, "outage_median_s": 28.0, "outage_log_sd": 0.35, "outage_max_s": 49.2},
    {"outage_per_h": 83.0},
]


def _share(config):
    """Share of time in outages, lambda m / (1 + lambda m), by integration of the lengths."""
    z = norm.ppf((np.arange(4000) + 0.5) / 4000)
    mean = np.minimum(config.outage_median_s * np.exp(config.outage_log_sd * z), config.outage_max_s).mean() + 0.05
    load = config.outage_per_h / 3600.0 * mean
    return load / (1.0 + load)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_the_link_is_down_for_its_share_of_time_from_the_first_epoch_on(law, share):
    """2000 vehicles over 20 minutes; the share at the start within 4.5 binomial sigma, that of all time within 4 %."""
    config = CorrectionsConfig(network_share=share, **law)
    down = ~_Link(config, batch=2000, dt=0.5, seeds=3).up(2400)
    expected = _share(config)
    assert down[0].mean() == pytest.approx(expected, abs=4.5 * np.sqrt(expected * (1 - expected) / 2000))
    assert down.mean() == pytest.approx(expected, rel=0.04)
    thirds = [part.mean() for part in np.array_split(down, 3)]
    assert np.ptp(thirds) < 0.04


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_outage_at_the_start_has_a_residual_life(share):
    """P(left > t) = E[max(D - t, 0)] / E[D]; each within 4.5 binomial sigma, once in 100,000 seeds, and 1 %.

    The 1 % is for outages that follow at once, and for the longer ones that collide with the network's more often.
    """
    config = CorrectionsConfig(network_share=share, **LAWS[1])
    down = ~_Link(config, batch=6000, dt=0.5, seeds=11).up(80)
    begun = np.logical_and.accumulate(down[:, down[0]], axis=0).sum(0) * 0.5
    length = np.minimum(28.0 * np.exp(0.35 * norm.ppf((np.arange(4000) + 0.5) / 4000)), 49.2)
    for t in (5.0, 10.0, 20.0, 30.0):
        expected = np.maximum(length - t, 0.0).mean() / length.mean()
        sigma = np.sqrt(expected * (1 - expected) / begun.size)
        assert (begun > t + 0.25).mean() == pytest.approx(expected, abs=4.5 * sigma + 0.01)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_outages_are_cut_off_at_the_longest_and_do_not_run_into_each_other(share):
    config = CorrectionsConfig(outage_per_h=60.0, network_share=share)
    lengths = 0.1 * _runs(~_Link(config, batch=300, seeds=5).up(2500))
    assert lengths.max() < 49.2 + 0.11 or (lengths > 49.3).mean() < 0.005  # two that follow at once
    assert np.isclose(lengths, 49.2).any()


def test_vehicles_of_an_area_suffer_the_networks_outages_together():
    """The chance that both links are down, against that of independent ones; deterministic at both ends."""
    law = LAWS[1]
    together = [
        ~_Link(CorrectionsConfig(network_share=1.0, **law), 2, 0.5, [a, a + 500], area=a).up(600) for a in range(30)
    ]
    for down in together:
        np.testing.assert_array_equal(down[:, 0], down[:, 1])
    areas = [
        ~_Link(CorrectionsConfig(network_share=0.5, **law), 2, 0.5, [a, a + 500], area=a).up(600) for a in range(150)
    ]
    down = np.concatenate(areas)
    both, one = down.all(-1).mean(), down.mean()
    assert 1.4 * one**2 < both < 0.9 * one  # 100 areas of 300 s: 2.2 and 0.55 in expectation, some 5 sigma off


def test_an_area_fails_alike_for_links_that_were_made_apart():
    config = CorrectionsConfig(network_share=1.0, **LAWS[0])
    one, two = _Link(config, 1, seeds=[1], area=9), _Link(config, 3, seeds=77, area=9)
    np.testing.assert_array_equal(one.up(1500), two.up(1500)[:, :1])


def test_an_outage_is_silent_for_its_length():
    config = CorrectionsConfig(interval_s=0.1, latency_s=0.0)
    link = _Link(config)
    link.state.links["outage_left"] = 50
    ages = np.array([link.step()[0] for _ in range(60)])
    assert np.isinf(ages[:50]).all()
    np.testing.assert_allclose(ages[50:], 0.0, atol=1e-12)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000))
def test_a_copied_state_goes_on_alike_and_alone(seed):
    link = _Link(CorrectionsConfig(outage_per_h=1000.0), 2, seeds=[seed, seed + 1])
    link.up(20)
    kept = link.state.copy(), link.network.copy(), link.streams.snapshot(), link.area_streams.snapshot()
    ahead = [link.step() for _ in range(30)]
    link.state, link.network, link.streams, link.area_streams = kept
    np.testing.assert_array_equal(ahead, [link.step() for _ in range(30)])


def test_a_vehicle_has_the_same_link_in_any_batch():
    config = CorrectionsConfig(outage_per_h=1000.0)
    many, alone = _Link(config, 3, seeds=[4, 5, 6]), _Link(config, 1, seeds=[5])
    for _ in range(300):
        assert many.step()[1] == alone.step()[0]


def test_refuses_what_cannot_be():
    link = _Link(CorrectionsConfig(), 2)
    with pytest.raises(InputError, match="dt_s must be positive"):
        _Link(CorrectionsConfig(), dt=0.0)
    with pytest.raises(InputError, match="of 1 or 3 areas"):
        corrections.initial_state(CorrectionsConfig(), link.network, 2, 0.1, Streams(1, 3))
    with pytest.raises(ConfigError, match="outage_per_h must be >= 0"):
        CorrectionsConfig(outage_per_h=-1.0)
