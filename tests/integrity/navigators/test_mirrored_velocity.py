"""Doppler and gyro contradict each other: levels cover both histories, and the heading is right again afterwards.

A facade that reflects all satellites in use mirrors the velocity: the speed agrees with the odometer, and residuals are
those of noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.monitoring.heading_doubt_kernel import FOLLOWS, NONE, OPEN, cover_axes
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
DT, MPS, VEHICLES = 0.1, 12.0, 16
AZIMUTHS = np.linspace(0.1, 6.0, VEHICLES)
CONFIG = NavigatorConfig().replace(positioning={"rtk": {"max_age_s": 3.0}})
LEVER = CONFIG.replace(positioning={"antenna_forward_m": 2.0, "antenna_right_m": -0.3})
TRACK = SkyTrack.from_config(CONFIG.sky, 120.0)
LOSS_S, EVENT_S = 30.0, 45.0  # RTK is lost, Doppler and gyro part
NO_CORRECTIONS = Fault(kind="corrections_loss", start_s=LOSS_S, duration_s=60.0)


class _Cars:
    """Vehicles on straight lines; from ``EVENT_S`` the velocities that satellites show are turned by an angle, and the
    gyros are wrong by a rate, each for a time. Without satellites from ``tunnel_s`` on.
    """

    def __init__(
        self, faults: tuple[Fault, ...], turned_rad: float = 0.0, for_s: float = 0.0, config: NavigatorConfig = CONFIG,
        tunnel_s: float = np.inf, from_s: float = EVENT_S,
    ) -> None:  # fmt: skip
        self.navigator = Navigator(config, TRACK, SkyMask.open(), list(range(VEHICLES)), faults=FaultSchedule(faults))
        self.turned_rad, self.for_s, self.tunnel_s, self.from_s, self.k = turned_rad, for_s, tunnel_s, from_s, 0
        self.along = np.column_stack([np.sin(AZIMUTHS), np.cos(AZIMUTHS)])

    def step(self) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """Error (B, 2) along and across the true heading [m], levels (B, 2) [m], heading error (B,) [rad], modes."""
        before, after, self.k = MPS * DT * self.k, MPS * DT * (self.k + 1), self.k + 1
        velocity = MPS * self.along
        places = self.along * before, self.along * after
        truth = truth_between(DT * self.k, DT, places, (velocity, velocity), (AZIMUTHS, AZIMUTHS), arc_m=after)
        m = self.navigator.measure(truth)
        if self.from_s < truth.time_s <= self.from_s + self.for_s:
            turned = AZIMUTHS + self.turned_rad
            feigned = np.column_stack([MPS * np.sin(turned), MPS * np.cos(turned), np.zeros(VEHICLES)])
            feigned[:, :2] -= velocity
            rates = m.gnss.range_rate_mps - feigned @ m.sky.los_enu[0].T
            m = replace(m, gnss=replace(m.gnss, range_rate_mps=rates))
        if truth.time_s > self.tunnel_s:
            m = replace(m, gnss=replace(m.gnss, tracked=np.zeros_like(m.gnss.tracked)))
        s = self.navigator.solve(m)
        east, north = (s.position_en_m - places[1]).T
        sine, cosine = self.along.T
        error = np.abs(np.column_stack([east * sine + north * cosine, east * cosine - north * sine]))
        return error, np.column_stack([s.pl_at_m, s.pl_ct_m]), wrap_angle(s.heading_rad - AZIMUTHS), s.mode

    def drive(self, until_s: float) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """The same of all epochs, (T, B, ...)."""
        rows = [self.step() for _ in range(round(until_s / DT) - self.k)]
        return tuple(np.array(column) for column in zip(*rows, strict=True))  # type: ignore[return-value]

    @property
    def stages(self) -> NDArray[np.int64]:
        """(B,) of the heading monitor."""
        stage: NDArray[np.int64] = self.navigator.state.belief.vehicles["doubt"]["stage"]
        return stage


@pytest.mark.parametrize("turned_deg", [15.0, -40.0, 100.0])
@pytest.mark.parametrize("config", [CONFIG, LEVER], ids=["", "lever"])
def test_levels_cover_a_velocity_that_a_facade_mirrors(turned_deg: float, config: NavigatorConfig) -> None:
    cars = _Cars((NO_CORRECTIONS,), np.deg2rad(turned_deg), for_s=6.0, config=config)
    cars.drive(EVENT_S)
    error, level, heading, mode = cars.drive(60.0)
    assert (np.abs(heading) > 0.5 * np.deg2rad(abs(turned_deg))).any(axis=0).all()  # all followed it: this can fail
    assert error.max() > 5.0
    assert (mode != Mode.RTK).all()
    assert (error <= level).all()
    assert np.abs(np.rad2deg(heading[-1])).max() < 3.0  # the courses came back
    assert (cars.stages == NONE).all()


def test_a_short_reflection_changes_no_heading() -> None:
    cars = _Cars((NO_CORRECTIONS,), np.deg2rad(60.0), for_s=1.5)
    cars.drive(EVENT_S + 1.0)
    assert (cars.stages == OPEN).all()
    error, level, heading, _ = cars.drive(50.0)
    assert np.rad2deg(np.abs(heading)).max() < 3.0
    assert (error <= level).all()
    assert (cars.stages == NONE).all()


@pytest.mark.parametrize(
    ("degps", "for_s"), [(1.0, 3.0), (5.0, 0.5), (8.0, 3.0), (-30.0, 0.6), (30.0, 3.0), (-30.0, 12.0)]
)
def test_levels_cover_a_gyro_that_fails(degps: float, for_s: float) -> None:
    """From its first moment on, with Doppler and without RTK."""
    knock = Fault(kind="gyro_bias", start_s=EVENT_S, duration_s=for_s, magnitude_degps=degps)
    cars = _Cars((NO_CORRECTIONS, knock))
    cars.drive(EVENT_S)
    error, level, heading, mode = cars.drive(EVENT_S + 15.0)
    assert (mode != Mode.RTK).all()
    assert (error <= level).all()
    if for_s <= 3.0:
        assert np.abs(np.rad2deg(heading[-10:])).max() < 5.0


def test_levels_cover_a_heading_that_comes_back() -> None:
    """A gyro that is wrong by 30 degrees a second to the right, and then to the left for as long."""
    knocks = (
        Fault(kind="gyro_bias", start_s=EVENT_S, duration_s=0.6, magnitude_degps=30.0),
        Fault(kind="gyro_bias", start_s=EVENT_S + 0.6, duration_s=0.6, magnitude_degps=-30.0),
    )
    cars = _Cars((NO_CORRECTIONS, *knocks))
    cars.drive(EVENT_S)
    error, level, _, _ = cars.drive(EVENT_S + 10.0)
    assert error.max() > 1.0
    assert (error <= level).all()


def test_rtk_shows_that_doppler_was_right() -> None:
    knock = Fault(kind="gyro_bias", start_s=EVENT_S, duration_s=3.0, magnitude_degps=8.0)
    cars = _Cars((NO_CORRECTIONS.replace(duration_s=30.0), knock))
    cars.drive(LOSS_S + 29.0)
    assert (cars.stages == FOLLOWS).all()
    _, _, heading, mode = cars.drive(LOSS_S + 50.0)
    assert (mode[-1] == Mode.RTK).all()
    assert (cars.stages == NONE).all()
    assert np.abs(np.rad2deg(heading[-1])).max() < 3.0


@pytest.mark.parametrize("config", [CONFIG, LEVER], ids=["", "lever"])
def test_rtk_shows_that_the_gyro_was_right(config: NavigatorConfig) -> None:
    """The mirrored velocities last on; RTK, back early, gives the heading of the gyro back."""
    cars = _Cars((NO_CORRECTIONS.replace(duration_s=17.0),), np.deg2rad(25.0), for_s=10.0, config=config)
    cars.drive(LOSS_S + 16.9)
    assert (cars.stages == FOLLOWS).all()
    error, level, heading, mode = cars.drive(70.0)
    assert (mode[-1] == Mode.RTK).all()
    assert (error <= level).all()
    assert np.abs(np.rad2deg(heading[-1])).max() < 3.0
    assert (cars.stages == NONE).all()
    assert level[-1].max() < 0.5


@pytest.mark.parametrize("config", [CONFIG, LEVER], ids=["", "lever"])
def test_while_rtk_lasts_a_mirrored_velocity_turns_no_heading(config: NavigatorConfig) -> None:
    cars = _Cars((), np.deg2rad(60.0), for_s=6.0, config=config)
    cars.drive(EVENT_S + 4.0)
    assert (cars.stages == OPEN).all()
    error, level, heading, mode = cars.drive(EVENT_S + 7.0)
    assert (mode == Mode.RTK).all()
    assert np.rad2deg(np.abs(heading)).max() < 3.0
    assert (error <= level).all()
    assert (cars.stages == NONE).all()


def test_a_course_that_no_gyro_explains_inflates_no_level_in_a_tunnel() -> None:
    """One epoch of 60 degrees at its mouth: in 0.1 s a gyro drifts by 3 degrees at most."""
    level = {}
    for turned in (0.0, 60.0):
        cars = _Cars((NO_CORRECTIONS,), np.deg2rad(turned), for_s=0.15, tunnel_s=EVENT_S + 0.15)
        error, level[turned], _, _ = cars.drive(EVENT_S + 20.0)
        assert (error[-150:] <= level[turned][-150:]).all()
    assert (level[60.0][-1, :, 1] < level[0.0][-1, :, 1] + 0.06 * MPS * 20.0 + 1.0).all()


@pytest.mark.parametrize("levels", [(1.0, 4.0), (3.0, 0.5), (2.0, 2.0)])
@pytest.mark.parametrize("between", [0.0, 0.2, 1.0, 3.0])
def test_levels_on_turned_axes_are_those_of_the_corners_of_the_box(levels: tuple[float, float], between: float) -> None:
    """Against all corners at 20,000 angles up to the one given."""
    turned = np.linspace(0.0, between, 20_000)
    corners = np.array([(a * levels[0], b * levels[1]) for a in (-1, 1) for b in (-1, 1)])
    along = np.abs(np.outer(np.cos(turned), corners[:, 0]) + np.outer(np.sin(turned), corners[:, 1])).max()
    across = np.abs(np.outer(np.cos(turned), corners[:, 1]) - np.outer(np.sin(turned), corners[:, 0])).max()
    found = np.array(levels)
    cover_axes(between, found)
    np.testing.assert_allclose(found, (along, across), rtol=1e-6)
