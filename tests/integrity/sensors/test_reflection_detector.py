"""Detectors of reflected signals: off they change no bit, on they have their rates and their memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.monitored_codes import MonitoredCodesConfig
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sensors.gnss import RATES, TESTS, GnssConfig
from lanebound.integrity.sensors.gnss_kernel import _exceeds
from lanebound.integrity.sky.propagation_kernel import reflection_coefficients
from lanebound.integrity.sky.scene import material_table, permittivities
from lanebound.integrity.sky.visibility import RAY_HZ, SignalPath
from tests.integrity.sensors.test_gnss import DT, PERFECT, _Receiver, _reception

ALARM = 1e-3  # false-alarm rate of each statistic
FIELDS = ("tracked", "code_m", "phase_m", "range_rate_mps", "cn0_dbhz", "lock_lost")


def detected(config: GnssConfig = PERFECT, **detector: Any) -> GnssConfig:
    return config.replace(reflection_detector=detector)


def test_a_detector_that_only_flags_changes_no_other_bit() -> None:
    off, on = (_Receiver(c, 3, 5) for c in (GnssConfig(), detected(GnssConfig(), kind="fisheye", use="flag")))
    flags = 0
    for path in (SignalPath.LOS, SignalPath.REFLECTED, SignalPath.LOS) * 3:
        given = {"reception": _reception(3, path=path, excess_m=20.0)}
        one, two = off.step(**given), on.step(**given)
        for name in FIELDS:
            assert (getattr(one, name) == getattr(two, name)).all()
        assert one.reflected is not None
        assert two.reflected is not None
        assert not one.reflected.any()
        flags += int(two.reflected.sum())
    assert flags > 0


@pytest.mark.parametrize("path", [SignalPath.LOS, SignalPath.REFLECTED])
def test_verdicts_have_the_rates_of_their_kind_and_last(path: SignalPath) -> None:
    """First verdicts of 500 vehicles and 8 satellites are independent; a verdict is drawn anew after 1 s on average."""
    finds, mistakes, lasting_s, batch = 0.7, 0.2, 1.0, 500
    given = {"finds": finds, "mistakes": mistakes, "lasting_s": lasting_s, "use": "flag"}
    receiver = _Receiver(detected(kind="given", **given), batch, 7)
    rate = finds if path is SignalPath.REFLECTED else mistakes
    first = receiver.step(reception=_reception(batch, path=path, excess_m=20.0)).reflected
    assert first is not None
    low, high = binom.ppf([0.5 * ALARM, 1.0 - 0.5 * ALARM], first.size, rate)
    assert low <= first.sum() <= high
    later = receiver.step(reception=_reception(batch, path=path, excess_m=20.0)).reflected
    assert later is not None
    renewed = -np.expm1(-DT / lasting_s)
    changed = 2.0 * rate * (1.0 - rate) * renewed
    low, high = binom.ppf([0.5 * ALARM, 1.0 - 0.5 * ALARM], first.size, changed)
    assert low <= (later != first).sum() <= high


def test_a_signal_that_becomes_reflected_is_judged_at_once_and_left_out() -> None:
    receiver = _Receiver(detected(kind="given", finds=1.0, mistakes=0.0), 2, 3)
    for _ in range(5):
        epoch = receiver.step()
    assert epoch.tracked.all()
    epoch = receiver.step(reception=_reception(2, path=SignalPath.REFLECTED, excess_m=20.0))
    assert epoch.reflected is not None
    assert epoch.reflected.all()
    assert not epoch.tracked.any()
    assert not epoch.code_m.any()
    assert not epoch.cn0_dbhz.any()


def test_polarisation_finds_what_fresnel_s_coefficients_of_concrete_say() -> None:
    """Directions before a facade: sine of the elevation uniform from 15 to 70 degrees, any azimuth in front of it."""
    rng, eps = np.random.default_rng(0), permittivities(material_table(), RAY_HZ)[0]
    azimuth, sine = rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 4000), rng.uniform(*np.sin(np.radians([15, 70])), 4000)
    cosine = np.sqrt(1.0 - sine**2) * np.cos(azimuth)
    co, cross = np.abs([reflection_coefficients(c, eps) for c in cosine]).T
    low, high = binom.ppf([0.5 * ALARM, 1.0 - 0.5 * ALARM], 4000, RATES["dual_polarisation"][0])
    assert low <= (cross > co).sum() <= high


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "given", "finds": 0.9}, "mistakes must be a share for kind 'given', got None"),
        ({"kind": "fisheye", "finds": 0.9}, "finds must be left out for kind 'fisheye', got 0.9"),
        ({"kind": "given", "finds": 1.1, "mistakes": 0.0}, "finds"),
    ],
)
def test_rates_that_do_not_fit_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        GnssConfig(reflection_detector=given)


def test_monitors_with_a_map_need_flags() -> None:
    with pytest.raises(ConfigError, match=r"gnss\.reflection_detector must flag signals for monitor 'map_exclude'"):
        MonitoredCodesConfig(monitor="map_exclude")
    with pytest.raises(ConfigError, match="use must be exclude for navigator 'rtk_reckoning'"):
        NavigatorConfig.load({"gnss": {"reflection_detector": {"kind": "fisheye", "use": "flag"}}})
    flagged = {"reflection_detector": {"kind": "fisheye", "use": "flag"}}
    assert MonitoredCodesConfig(monitor="map_exclude", gnss=flagged).gnss.reflection_detector.rates == RATES["fisheye"]


def test_a_test_has_its_false_alarm_rate_and_half_power_at_its_threshold() -> None:
    for name in ("antenna_array", "two_band_cn0"):
        assert _exceeds(0.0, TESTS[name].limit) == pytest.approx(0.01, abs=1e-6)
        assert _exceeds(TESTS[name].limit, TESTS[name].limit) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(("kind", "rate"), [("antenna_array", 0.01), ("two_band_cn0", 0.01)])
def test_tests_of_direct_signals_have_their_false_alarm_rate(kind: str, rate: float) -> None:
    batch = 2000
    found = _Receiver(detected(kind=kind, use="flag"), batch, 7).step(reception=_reception(batch)).reflected
    assert found is not None
    low, high = binom.ppf([0.5 * ALARM, 1.0 - 0.5 * ALARM], found.size, rate)
    assert low <= found.sum() <= high


def test_an_array_finds_an_unknown_face_and_equal_bands_show_nothing() -> None:
    """At 60 degrees an array of 5 degrees never misses; a reflection alone has the same loss in both bands."""
    shares = []
    for kind in ("antenna_array", "two_band_cn0"):
        receiver = _Receiver(detected(kind=kind, use="flag"), 500, 7)
        found = receiver.step(reception=_reception(500, path=SignalPath.REFLECTED, excess_m=20.0)).reflected
        assert found is not None
        shares.append(found.mean())
    assert shares[0] == 1.0
    assert shares[1] < 0.03


def test_one_band_has_no_difference() -> None:
    with pytest.raises(ConfigError, match=r"must not be 'two_band_cn0' with one band, got bands \[0\]"):
        detected(GnssConfig(bands=[0]), kind="two_band_cn0")


def test_codes_against_doppler_keep_their_false_alarm_rate() -> None:
    """Direct signals with noise, slow multipath and errors of range rates; 10 s between the epochs that count."""
    receiver, flags, seen = _Receiver(detected(GnssConfig(), kind="code_doppler", use="flag"), 300, 11), 0, 0
    for k in range(1200):
        epoch = receiver.step(reception=_reception(300))
        if k % 100 == 99:
            assert epoch.reflected is not None
            flags, seen = flags + int(epoch.reflected.sum()), seen + int(epoch.tracked.sum())
    assert flags > 0
    assert binom.sf(flags - 1, seen, 1e-3) > ALARM


def test_a_code_that_becomes_late_is_left_out_until_it_comes_back() -> None:
    receiver = _Receiver(detected(kind="code_doppler"), 2, 3)
    for _ in range(50):
        assert receiver.step(reception=_reception(2)).reflected is not None
    tracked = []
    for _ in range(80):
        epoch = receiver.step(reception=_reception(2, path=SignalPath.REFLECTED, excess_m=20.0))
        tracked.append(bool(epoch.tracked.any()))
    assert not any(tracked[1:])
    assert (epoch.reflected if epoch.reflected is not None else np.zeros(1)).all()
    back = [receiver.step(reception=_reception(2)) for _ in range(20)]
    assert back[-1].tracked.all()
    assert not back[-1].code_m[~back[-1].tracked].any()
