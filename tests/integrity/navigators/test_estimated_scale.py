"""The default navigator with an estimated scale of the odometer: its levels in a tunnel, and what ends the estimate."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask
from tests.helpers.tunnel_drives import Drive, drive, pieces, turning, yaw_rates

OPEN_S, DARK_S, MPS = 80.0, 25.0, 12.0


def config(scale: str = "estimated", **more: Any) -> NavigatorConfig:
    """Wheels of 0.6 %, with the bound declared for them in streets."""
    reckoning = {"scale": scale, "odometer_scale": 0.027}
    given = {"odometer": {"scale_sigma": 0.006}, "positioning": {"dead_reckoning": reckoning}, **more}
    return NavigatorConfig.load(given)


@cache
def tunnel(scale: str, vehicles: int = 24) -> Drive:
    """A bend, then straight into a tunnel with a turn back in it."""
    bend = pieces((0.0, 20.0), turning(0.3, 0.5 * np.pi), (0.0, OPEN_S - 20.0 - 0.5 * np.pi / 0.3))
    back = pieces((0.0, 8.0), turning(0.3, np.pi), (0.0, DARK_S - 8.0 - np.pi / 0.3))
    return drive(config(scale), yaw_rates(*bend, *back), OPEN_S, vehicles, from_s=OPEN_S)


def test_levels_along_are_smaller_and_hold() -> None:
    found, before = tunnel("estimated"), tunnel("declared")
    level, error = found.levels_m[:, :, 0], found.error_m
    assert (error <= level).all()
    at = int(np.argmin(np.abs(found.time_s - (OPEN_S + 7.5))))  # before the turn back
    assert np.median(level[at, :, 0]) < 0.8 * np.median(before.levels_m[at, :, 0, 0])
    assert np.median(error[at, :, 0]) < 0.5 * np.median(before.error_m[at, :, 0])
    assert (level[at, :, 1] <= before.levels_m[at, :, 0, 1] * 1.05).all()  # the risk of three false windows is spent


def straight(navigator: Navigator, epochs: int, first: int = 0) -> Any:
    """Drive North at 12 m/s; the last solution."""
    batch = navigator.batch
    heading, velocity = np.zeros(batch), np.tile([0.0, MPS], (batch, 1))
    for k in range(first, first + epochs):
        place = tuple(np.tile([0.0, 0.1 * MPS * n], (batch, 1)) for n in (k, k + 1))
        s = navigator.step(truth_between(0.1 * (k + 1), 0.1, place, (velocity, velocity), (heading, heading)))
    return s


def navigator(given: NavigatorConfig, batch: int, *faults: Fault) -> Navigator:
    """Under the open sky, with these faults."""
    track = SkyTrack.from_config(given.sky, 200.0)
    return Navigator(given, track, SkyMask.open(), list(range(5, 5 + batch)), faults=FaultSchedule(faults))


def test_the_estimate_is_near_the_scale_of_the_wheels_and_within_its_bound() -> None:
    n = navigator(config(), 6)
    straight(n, 900)
    wheels, true = n.state.belief.vehicles["wheels"], 1.0 / n.state.odometer.wheels["scale"] - 1.0
    assert wheels["known"].all()
    assert (wheels["count"] == 24).all()
    error = np.abs(wheels["scale"] - true)
    assert (error < 0.001).all()
    assert (np.abs(true) > 2.0 * error).any()
    assert (error < n.state.belief.starts["scale"][:, 0, 0]).all()
    assert (n.state.belief.starts["scale"][:, 0, 0] < 0.012).all()


def test_a_larger_scale_ends_the_estimate_and_is_learnt_anew() -> None:
    slip = Fault(kind="wheel_slip", magnitude_ratio=0.02, start_s=90.0, duration_s=100.0)
    n = navigator(config(), 2, slip)
    straight(n, 900)
    assert n.state.belief.vehicles["wheels"]["known"].all()
    straight(n, 60, 900)
    assert not n.state.belief.vehicles["wheels"]["known"].any()
    straight(n, 400, 960)
    wheels = n.state.belief.vehicles["wheels"]
    true = 1.0 / (1.02 * n.state.odometer.wheels["scale"]) - 1.0
    assert wheels["known"].all()
    assert (np.abs(wheels["scale"] - true) < 0.002).all()


def test_a_placed_vehicle_knows_no_scale() -> None:
    n = navigator(config(), 2)
    straight(n, 400)
    assert n.state.belief.vehicles["wheels"]["known"].all()
    n.place(np.zeros((1, 2)), np.zeros(1), 0.05, 0.01, rows=np.array([1]))
    assert n.state.belief.vehicles["wheels"]["known"].tolist() == [True, False]
    assert not n.state.belief.windows["path"][1].any()


def test_one_vehicle_and_a_batch_have_the_same_bits() -> None:
    many, one = navigator(config(), 3), navigator(config(), 1)
    a, b = straight(many, 500), straight(one, 500)
    assert (a.position_en_m[0] == b.position_en_m[0]).all()
    assert a.pl_at_m[0] == b.pl_at_m[0]
    assert many.state.belief.vehicles["wheels"][0] == one.state.belief.vehicles["wheels"][0]


def test_a_declared_scale_has_no_windows() -> None:
    n = navigator(config("declared"), 2)
    straight(n, 300)
    assert n.state.belief.windows.shape == (2, 0, 1)
    assert not n.state.belief.vehicles["wheels"]["scale"].any()


def test_another_word_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"positioning\.dead_reckoning.scale"):
        config("guessed")
