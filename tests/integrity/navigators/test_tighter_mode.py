"""Doppler positioning gives way to gyro and odometer where their velocity has the smaller bound."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning import modes_kernel
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask
from tests.helpers.tunnel_drives import drive, yaw_rates


def declared(**changes: Any) -> Any:
    """The parameters of a navigator, with their fields as attributes."""

    def named(record: Any) -> Any:
        names = record.dtype.names
        return SimpleNamespace(**{name: named(record[name]) for name in names}) if names else record

    return named(epoch_parameters(NavigatorConfig.load(changes))[0])


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The comparison in plain Python."""
    monkeypatch.setattr(modes_kernel, "heading_bias", modes_kernel.heading_bias.py_func)
    return modes_kernel.doppler_is_tighter.py_func


K_MD = np.array([4.0, 4.5])
LOSS = Fault(kind="corrections_loss", start_s=6.0, duration_s=60.0)


def vehicle_of(sigma_heading: float, since_calibration: float, doubted: bool = False) -> Any:
    """The fields of a vehicle that the comparison reads."""
    heading, watch = SimpleNamespace(p_hh=sigma_heading**2), SimpleNamespace(doubted=doubted)
    return SimpleNamespace(heading=heading, since_calibration=since_calibration, watch=watch)


def bounds(sigma_v: float, sigma_heading: float, speed: float) -> tuple[float, float]:
    """The bounds of Doppler, and of gyro and odometer, by hand [m/s]."""
    par = declared()
    bias = par.odometer.heading_bias + 5.0 * par.odometer.heading_drift
    across = speed * (K_MD[1] * sigma_heading + bias)
    along = K_MD[0] * par.odometer.sigma + par.odometer.bias + par.odometer.scale * speed
    return K_MD[1] * sigma_v * math.sqrt(2.0) + math.sqrt(2.0) * par.doppler.bias, math.hypot(across, along)


@pytest.mark.parametrize("sigma_v", [0.01, 0.05, 0.1, 0.2, 0.5])
@pytest.mark.parametrize("sigma_heading", [1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("speed", [1.0, 13.0])
def test_the_smaller_bound_decides(sigma_v: float, sigma_heading: float, speed: float, plain: Any) -> None:
    par = declared()
    w = SimpleNamespace(q=sigma_v**2 * np.eye(4))
    vehicle = vehicle_of(sigma_heading, 5.0)
    doppler, odometer = bounds(sigma_v, sigma_heading, speed)
    assert plain(w, vehicle, speed, K_MD, par) == (doppler < odometer)


def test_an_unknown_heading_leaves_the_position_to_doppler(plain: Any) -> None:
    par = declared()
    w = SimpleNamespace(q=np.eye(4))
    vehicle = vehicle_of(0.0, math.inf)
    assert plain(w, vehicle, 13.0, K_MD, par)


def test_a_doubted_odometer_leaves_the_position_to_doppler(plain: Any) -> None:
    w = SimpleNamespace(q=np.eye(4))
    assert not plain(w, vehicle_of(1e-3, 5.0), 1.0, K_MD, declared())
    assert plain(w, vehicle_of(1e-3, 5.0, doubted=True), 1.0, K_MD, declared())


def test_the_velocity_of_an_epoch_by_odometer_counts_in_the_next_trapezoid() -> None:
    """Doppler after gyro and odometer moves by ``dt/2 (v_- + v)``: the growth has to know the covariance of ``v_-``."""
    config = NavigatorConfig.load({"positioning": {"doppler": {"sigma_mps": 1.0}, "rtk": {"max_age_s": 3.0}}})
    navigator = Navigator(config, SkyTrack.from_config(config.sky, 30.0), SkyMask.open(), 3, 2, FaultSchedule((LOSS,)))
    heading, velocity = np.zeros(2), np.tile([0.0, 13.0], (2, 1))
    for k in range(150):
        place = tuple(np.tile([0.0, 1.3 * n], (2, 1)) for n in (k, k + 1))
        s = navigator.step(truth_between(0.1 * (k + 1), 0.1, place, (velocity, velocity), (heading, heading)))
    growth = navigator.state.belief.vehicles["growth"]
    assert (s.mode == Mode.IMU_ODOMETER).all()
    assert growth["have_l"].all()
    assert (growth["l_ee"] > 0.0).all()


def doppler_without_rtk(sigma_mps: float, **mode: str) -> float:
    """Share of Doppler in a straight drive whose corrections end after 6 s, with range rates of a 1-sigma."""
    config = NavigatorConfig.load(
        {
            "gnss": {"range_rate_sigma_mps": 0.5 * sigma_mps},
            "positioning": {"doppler": {"sigma_mps": sigma_mps}, "rtk": {"max_age_s": 3.0}, "mode": mode},
        }
    )
    run = drive(config, yaw_rates((0.0, 25.0)), 1000.0, 4, from_s=15.0, faults=FaultSchedule((LOSS,)))
    assert np.isin(run.mode, [Mode.DOPPLER, Mode.IMU_ODOMETER]).all()
    return float((run.mode == Mode.DOPPLER).mean())


def test_declared_doppler_noise_chooses_the_mode_of_an_outage() -> None:
    assert doppler_without_rtk(0.02) > 0.9
    assert doppler_without_rtk(1.0) == 0.0
    assert doppler_without_rtk(1.0, doppler_when="usable") > 0.9


def test_doppler_alone_is_used_wherever_it_is_usable() -> None:
    assert not declared(modes=["doppler"]).modes.doppler_if_tighter
    assert declared().modes.doppler_if_tighter


def test_another_word_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"positioning\.mode.doppler_when"):
        NavigatorConfig.load({"positioning": {"mode": {"doppler_when": "never"}}})
