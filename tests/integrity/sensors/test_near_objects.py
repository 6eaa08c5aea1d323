"""Multipath of near objects: off it changes no bit, on it has its sizes, its memory and its Doppler."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors.gnss import GnssConfig, GnssEpoch
from lanebound.integrity.sky.visibility import SignalPath
from tests.integrity.sensors.test_gnss import DT, ELEVATION_DEG, N_SAT, PERFECT, _Receiver, _reception, _truth

SMALL = {"kind": "vehicle", "phase_m": 0.003, "code_m": 0.1}
ROOT = np.sqrt(0.5 * (1.0 + 1.0 / np.sin(np.radians(ELEVATION_DEG)) ** 2))
ALARM = 1e-3  # false-alarm rate of each statistic


def pair(batch: int = 1, config: GnssConfig = PERFECT, near: dict[str, Any] | None = None) -> list[_Receiver]:
    """Receivers of the same seed without and with near objects."""
    with_near = config.replace(near_objects=near or SMALL)
    return [_Receiver(c, batch, 5) for c in (config, with_near)]


def stepped(receivers: list[_Receiver], **given: Any) -> list[GnssEpoch]:
    return [receiver.step(**given) for receiver in receivers]


def added(epochs: list[GnssEpoch]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What near objects add to code and phase (B, S, 2) [m] and range rate (B, S) [m/s]."""
    off, on = epochs
    return on.code_m - off.code_m, on.phase_m - off.phase_m, on.range_rate_mps - off.range_rate_mps


def moving(batch: int, speed: float) -> Truth:
    return _truth(batch, velocity=(0.6 * speed, 0.8 * speed))


def test_sizes_do_not_matter_while_it_is_off() -> None:
    for near in (SMALL | {"kind": "none"}, {"kind": "none"}):
        off, other = pair(3, GnssConfig(), near)
        for _ in range(5):
            one, two = stepped([off, other])
            for name in ("tracked", "code_m", "phase_m", "range_rate_mps", "cn0_dbhz", "lock_lost"):
                assert (getattr(one, name) == getattr(two, name)).all()
        assert "near_objects" not in other.streams._states
        assert (other.state.signals["near"]["code"] == 0.0).all()


def test_on_it_changes_neither_draws_nor_tracking() -> None:
    """Whatever else is drawn stays: the difference is that of receivers without any other error."""
    noisy = added(stepped(pair(4, GnssConfig())))
    clean = added(stepped(pair(4)))
    for one, two in zip(noisy, clean, strict=True):
        np.testing.assert_allclose(one, two, atol=2e-9)
    off, on = stepped(pair(4, GnssConfig()))
    assert (off.tracked == on.tracked).all()
    assert (off.cn0_dbhz == on.cn0_dbhz).all()


@pytest.mark.parametrize("speed", [0.0, 12.0])
def test_the_doppler_is_the_change_of_the_first_carrier(speed: float) -> None:
    receivers = pair(6)
    before = added(stepped(receivers, truth=moving(6, speed)))[1]
    for _ in range(4):
        _, phase, rate = added(stepped(receivers, truth=moving(6, speed)))
        assert np.abs(rate).max() > 1e-4
        np.testing.assert_allclose(rate, (phase - before)[..., 0] / DT, atol=1e-7)
        before = phase


def test_a_recorded_sky_plays_it_too() -> None:
    """Its receptions have a late path without a face; near objects add the same to them as to direct signals."""
    direct = added(stepped(pair(2)))
    receivers = pair(2)
    late = _reception(2, SignalPath.REFLECTED, 12.0)
    epochs = stepped(receivers, reception=late)
    assert epochs[0].tracked.all()
    np.testing.assert_allclose(added(epochs)[0], direct[0], atol=1e-9)
    assert np.abs(direct[0]).min() > 0.0


def test_errors_have_their_sizes_over_elevation() -> None:
    """Sums of squares of 3000 vehicles in each satellite, band and observable; 32 statistics of ALARM each."""
    code, phase, _ = added(stepped(pair(3000)))
    low, high = chi2.ppf([ALARM / 64.0, 1.0 - ALARM / 64.0], 3000)
    for values, sigma in ((code, 0.1), (phase, 0.003)):
        sums = np.square(values / (sigma * ROOT[:, None])).sum(0)
        assert (low < sums).all()
        assert (sums < high).all()


@pytest.mark.parametrize(("speed", "name"), [(14.0, "driving"), (0.0, "standing")])
def test_errors_last_for_a_path_and_longer_at_rest(speed: float, name: str) -> None:
    """Correlation over 1 s of 2000 vehicles and 8 satellites: 14 m of 21 and 14; at rest 1 s of 25 and 100."""
    receivers = pair(2000)
    first = added(stepped(receivers, truth=moving(2000, speed)))
    for _ in range(10):
        epochs = stepped(receivers, truth=moving(2000, speed))
    last = added(epochs)
    for k, (length, tau) in enumerate(((21.0, 25.0), (14.0, 100.0))):
        expected = np.exp(-speed / length - 1.0 / tau)
        found = np.corrcoef(first[k].ravel(), last[k].ravel())[0, 1]
        spread = norm.isf(ALARM / 2.0) * (1.0 - expected**2) / np.sqrt(first[k].size)
        assert abs(found - expected) < spread, name


def test_signals_have_processes_of_their_own() -> None:
    """No correlation between satellites, bands, code and carrier, or vehicles: 4000 products each."""
    code, phase, _ = added(stepped(pair(4000)))
    bound = norm.isf(ALARM / 8.0) / np.sqrt(4000.0)
    z = [values / values.std(0) for values in (code, phase)]
    for product in (z[0][:, 0, 0] * z[0][:, 0, 1], z[1][:, 0, 0] * z[1][:, 1, 0], z[0][:, 2, 0] * z[1][:, 2, 0],
                    z[1][:-1, 3, 0] * z[1][1:, 3, 0]):  # fmt: skip
        assert abs(product.mean()) < bound * 1.01
    assert code.shape == (4000, N_SAT, 2)


@pytest.mark.parametrize(
    "near", [{"kind": "tram"}, {"phase_m": 0.05}, {"code_m": -1.0}, {"phase_length_m": 0.0}, {"sigma": 1.0}]
)
def test_refusals(near: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        GnssConfig().replace(near_objects=near)
