"""What vehicles of an area share: bits by clock and seed, whoever asks; sizes and times of the station's part."""

import numpy as np
import pytest

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors.area import advance_area, initial_area
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.gnss import GnssConfig

GNSS, LINK, DT, N_SAT = GnssConfig(), CorrectionsConfig(outage_per_h=120.0), 0.1, 7


def _area(seeds=(5,), gnss=GNSS, link=LINK, satellites=N_SAT):
    return initial_area(gnss, link, satellites, DT, Streams(list(seeds)))


def _bits(state):
    s, n = state.signals, state.network
    return [s.memory, s.message, s.site, n.epoch, n.areas]


def _numbers(memory):
    """(A, S) records of six numbers as (A, S, 6): ionosphere, satellite, troposphere, then the station's multipath."""
    return memory.view(np.float64).reshape(*memory.shape, 6)


def _assert_same(one, two):
    for a, b in zip(_bits(one), _bits(two), strict=True):
        np.testing.assert_array_equal(a, b)


def test_areas_agree_at_the_same_clock_whenever_they_were_asked_first():
    early, late = _area(), _area()
    for k in range(1, 101):
        advance_area(GNSS, LINK, early, k * DT, DT)
    advance_area(GNSS, LINK, late, 10.0, DT)
    _assert_same(early, late)
    kept = early.copy()
    advance_area(GNSS, LINK, early, 10.0, DT)
    _assert_same(early, kept)


def test_an_area_is_the_same_among_others():
    alone, among = _area([6]), _area([5, 6])
    advance_area(GNSS, LINK, alone, 5.0, DT)
    advance_area(GNSS, LINK, among, 5.0, DT)
    np.testing.assert_array_equal(alone.signals.memory[0], among.signals.memory[1])
    np.testing.assert_array_equal(alone.network.areas["until"][0], among.network.areas["until"][1])


class _DrawnOutside(Streams):
    """Streams whose draws are handed to the kernel."""

    draws_by_row = False


def test_draws_from_outside_the_kernel_give_the_same_bits():
    inside, outside = _area([5, 6]), initial_area(GNSS, LINK, N_SAT, DT, _DrawnOutside([5, 6]))
    advance_area(GNSS, LINK, inside, 30.0, DT)
    advance_area(GNSS, LINK, outside, 30.0, DT)
    _assert_same(inside, outside)


def test_the_stations_noise_is_new_with_each_message_and_the_rest_lasts():
    area, noise, slow = _area(), [], []
    for k in range(1, 41):
        advance_area(GNSS, LINK, area, k * DT, DT)
        noise.append(area.signals.message["code"][0, 0, 0])
        slow.append(area.signals.memory["code_multipath"][0, 0])
    changes = np.flatnonzero(np.diff(noise))
    np.testing.assert_array_equal(changes, [1, 11, 21, 31])  # messages of 0, 1, 2, 3 s, 0.3 s later
    assert np.abs(np.diff(slow)).max() < 0.6


def test_a_message_has_the_multipath_of_its_time_beside_its_noise():
    area = _area()
    for k in range(1, 41):
        advance_area(GNSS, LINK, area, k * DT, DT)
        if area.network.areas["fresh"]:
            sent = area.signals.memory.copy()
        if area.network.areas["message"] >= 0:
            for name in ("code_multipath", "phase_multipath"):
                np.testing.assert_array_equal(area.signals.message[name], sent[name])
    assert area.signals.message.shape == (1, N_SAT)


def test_what_lasts_keeps_unit_variance_and_its_correlation():
    """2000 values of each of six states: of chi-square 4.5 sigma, and 4.5 sigma of a correlation, once in 10,000."""
    area = _area(satellites=2000)
    before = _numbers(area.signals.memory).copy()
    advance_area(GNSS, LINK, area, 60.0, DT)
    after = _numbers(area.signals.memory)
    assert np.abs((after**2).mean((0, 1)) - 1.0).max() < 4.5 * np.sqrt(2.0 / 2000)
    tau_s = np.full(6, GNSS.station_multipath_tau_s)
    tau_s[:3] = GNSS.iono_tau_s, GNSS.age_tau_s, GNSS.tropo_tau_s
    np.testing.assert_allclose((before * after).mean((0, 1)), np.exp(-60.0 / tau_s), atol=4.5 / np.sqrt(2000))


@pytest.mark.parametrize("sigma_m", [0.0, 0.05, 0.15, 2.0])
def test_a_station_never_brings_more_than_half_the_variance(sigma_m):
    parts = GNSS.replace(code_sigma_m=sigma_m, code_multipath_m=sigma_m).station_parts
    for name in ("station_code", "station_code_multipath"):
        assert parts[name] == pytest.approx(min(0.1, np.sqrt(0.5) * sigma_m))
