"""The cockpit: everything between the true world and what the ego believes of it.

It is told when the car has moved, and brings the belief up to date before anything is decided: measures, navigates,
perceives traffic, and places the believed vehicle. Truth enters through :meth:`Cockpit.look` alone, as measurements.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.actuators import ActuatorConfig, Actuators
from lanebound.envs.ego import BelievedVehicle, MetaEgo, take_over
from lanebound.envs.fleet import Fleet, along
from lanebound.envs.lane_search import swift
from lanebound.envs.motion import Motion
from lanebound.envs.navigation import Fix, NavigationConfig, Source, fix_of, place
from lanebound.envs.perception import Perception
from lanebound.envs.records import EgoBelief, Traffic
from lanebound.envs.sky import Street
from lanebound.envs.tracker import Tracker
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.navigator import Measurements, Navigator
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.faults import FaultSchedule

__all__ = ["Cockpit", "Surroundings"]

Array = NDArray[np.float64]
ROW = np.zeros(1, dtype=np.int64)
OTHERS_S = 3.0  # of warm-up for the others: RTK takes a second or two to be found and confirmed
HEARD_S = 0.6  # of it with the radio on: the longest delay of a message


@dataclass(frozen=True)
class Surroundings:
    """What an episode takes place in: the street, the ego's navigator and how the ego perceives others.

    ``navigator`` is None when the position is given, not sensed; ``faults`` are those of the others.
    """

    street: Street
    navigator: Navigator | None
    fleet: Fleet
    perception: Perception
    streams: Streams
    faults: FaultSchedule
    map_bound_m: float


class Cockpit:
    """The ego's senses and belief during one episode.

    Attributes
    ----------
    believed : the vehicle that steers, on its own perceived road over the shared network
    tracker : pose by which it is placed
    traffic : whom the ego perceives
    time_s : since the start
    watch : told each navigation epoch's position, levels, limits and availability, for those who score
    """

    def __init__(
        self,
        world: AbstractEnv,
        config: NavigationConfig,
        actuators: ActuatorConfig | None,
        limits_m: tuple[float, float],
        around: Surroundings,
    ) -> None:
        self.world, self.config, self.around, self.limits_m = world, config, around, limits_m
        world.road.network = swift(world.road.network)  # the same lanes and answers, found sooner
        self.step_s = 1.0 / world.config["simulation_frequency"]
        self.steps_per_epoch = config.steps_per_epoch(world.config["simulation_frequency"])
        self.time_s, self._moved, self._seen = 0.0, 0, 0
        self.alert_age_s = self.steering_rad = 0.0
        self.measurements: Measurements | None = None
        self.traffic = Traffic.none()
        self.watch: Callable[[Array, tuple[float, float], tuple[float, float], bool], None] | None = None
        ego = world.vehicle
        self._actuators = None if actuators is None else Actuators(actuators, self.step_s, ego.LENGTH)
        rng = around.streams.generator("start")
        self._map_shift_m = config.map_sigma_m * rng.standard_normal(2) if around.navigator else np.zeros(2)
        self.believed = BelievedVehicle.of(ego, self._perceived_road())
        self.believed.pursues = actuators is not None and actuators.steering_rate_radps is not None
        take_over(ego, self)
        self._motion = Motion.still(1, self.step_s)
        self.tracker = Tracker(config, self._map_shift_m, self._first_fix())
        self._place()
        self._trust()
        self._warm_up_the_others()
        self._perceive()

    def _perceived_road(self) -> Road:
        """A road over the same network, with a generator of its own and nobody on it but the believed vehicle."""
        road = self.world.road
        return Road(
            network=road.network,
            np_random=np.random.default_rng(0),  # next_lane takes one and draws nothing
            neighbour_vehicles_connected_lanes=road.neighbour_vehicles_connected_lanes,
        )

    @property
    def ego(self) -> Vehicle:
        """The physical car, for those who score."""
        return self.world.vehicle

    # What the physical ego calls

    def moved(self) -> None:
        """The car has moved; the others are about to."""
        self._moved += 1

    def look(self) -> None:
        """Bring the belief up to date with what has moved since."""
        if self._moved == self._seen:
            return
        self._seen = self._moved
        self.time_s = self._seen * self.step_s
        epoch = self._seen % self.steps_per_epoch == 0
        self._motion.advance(ROW, self.ego.position[None], np.array([self.ego.heading], dtype=np.float64))
        self.around.fleet.follow()
        if self.around.navigator is None:
            self.tracker.take(self._given(), self.step_s, self.step_s)
        elif epoch:
            self.tracker.take(self._navigate(self.around.navigator), self.step_s, self.epoch_s)
        else:
            self.tracker.coast(self.step_s)
        self._place()
        if epoch:
            self.around.fleet.navigate(self._clock_s(self.time_s), self.epoch_s)
            self._perceive()
        self._trust()
        if epoch and self.watch is not None:
            self.watch(self.believed.position, self._levels_m, self.limits_m, self._available)
        self.alert_age_s = self.alert_age_s + self.step_s if self._alert else 0.0

    def limit(self, action: dict[str, float]) -> dict[str, float]:
        """What the actuators make of a command."""
        if self._actuators is not None:
            action = self._actuators.limit(action, float(self.believed.speed))
        self.steering_rad = float(action["steering"])
        return action

    # From truth to measurements

    def _clock_s(self, time_s: float) -> float:
        """The navigators' clock at a time of the episode."""
        return self.config.clock_start_s + time_s

    @property
    def epoch_s(self) -> float:
        """Length of a navigation epoch."""
        return float(self.step_s * self.steps_per_epoch)

    def _first_fix(self) -> Fix:
        """Where the ego believes to be at the start, after driving straight up to it."""
        ego, navigator = self.ego, self.around.navigator
        if navigator is None:
            self._motion.enter(0, ego.position, ego.heading, ego.speed)
            return self._given()
        epochs = max(1, round(self.config.warm_up_s / self.epoch_s))
        ahead = ego.speed * np.array([math.cos(ego.heading), math.sin(ego.heading)])
        begin = ego.position - epochs * self.epoch_s * ahead
        self._motion.enter(0, begin, ego.heading, ego.speed)
        noise = self.around.streams.generator("start").standard_normal((1, 3))
        place(navigator, self.config, begin[None], np.array([ego.heading]), noise)
        for k in range(1, epochs * self.steps_per_epoch + 1):
            position = ego.position if k == epochs * self.steps_per_epoch else begin + k * self.step_s * ahead
            self._motion.advance(ROW, position[None], np.array([ego.heading], dtype=np.float64))
            if k % self.steps_per_epoch == 0:
                fix = self._navigate(navigator, (k // self.steps_per_epoch - epochs) * self.epoch_s)
        return fix

    def _warm_up_the_others(self) -> None:
        """Let the others drive straight up to their places, so that they know where they are and have said so."""
        fleet, n = self.around.fleet, self.steps_per_epoch
        if fleet.navigator is None or not fleet.vehicles:
            return
        epochs = max(1, round(min(self.config.warm_up_s, OTHERS_S) / self.epoch_s))
        begin, chord = fleet.rewind(epochs * n)
        heading = np.array([v.heading for v in fleet.vehicles], dtype=np.float64)
        for k in range(1, epochs * n + 1):
            fleet.motion.advance(fleet.rows, begin + k * chord, heading)
            if k % n == 0:
                time_s = (k // n - epochs) * self.epoch_s
                fleet.navigate(self._clock_s(time_s), self.epoch_s)
                if -HEARD_S <= time_s < -0.5 * self.epoch_s:
                    self._perceive(time_s)

    def _navigate(self, navigator: Navigator, time_s: float | None = None) -> Fix:
        """Measure the epoch that ends now, and locate the ego by the measurements alone."""
        ego = self.ego
        arc, lane = self.around.street.where(ego.lane_index, along(ego.lane, ego.position))
        when = self.time_s if time_s is None else time_s
        truth = self._motion.epoch(self._clock_s(when), self.epoch_s, np.array([arc]), np.array([lane]))
        self.measurements = navigator.measure(truth)
        return fix_of(navigator.locate(self.measurements), 0)

    def _given(self) -> Fix:
        """The truth, displaced by the constant offset."""
        ego, c = self.ego, self.config
        forward = np.array([math.cos(ego.heading), math.sin(ego.heading)])
        right = np.array([-forward[1], forward[0]])
        at, ct = (c.offset_at_m, c.offset_ct_m) if c.source is Source.OFFSET else (0.0, 0.0)
        return Fix.known(
            ego.position + at * forward + ct * right, float(ego.heading), float(ego.speed), abs(at), abs(ct)
        )

    # From measurements to belief

    def _place(self) -> None:
        if self.config.source is Source.PERFECT:
            self.believed.copy_from(self.ego)
        else:
            t = self.tracker
            self.believed.place(t.position_m, t.heading_rad, t.fix.speed_mps)

    def _trust(self) -> None:
        """Levels and alert of the pose on the map: the solution's, and what a jump not yet taken over adds."""
        fix, (al_at, al_ct) = self.tracker.fix, self.limits_m
        given = self.around.navigator is None
        self._levels_m = (fix.pl_at_m, fix.pl_ct_m) if given else self.tracker.levels_m(self.around.map_bound_m)
        over_at, over_ct = self._levels_m[0] > al_at, self._levels_m[1] > al_ct
        over = over_at or over_ct
        self._available, self._alert = fix.available and not over, fix.alert or over
        self._reason = fix.reason
        if over and not fix.alert:
            reason = AlertReason.BOTH if over_at and over_ct else AlertReason.PL_AT if over_at else AlertReason.PL_CT
            self._reason = reason.code

    def _perceive(self, time_s: float | None = None) -> None:
        when = self.time_s if time_s is None else time_s
        fleet, perception = self.around.fleet, self.around.perception
        effects = self._effects_on_the_others(self._clock_s(when), fleet.ego_slot + 1)
        self.traffic = perception.step(when, self.belief(), fleet.ego_slot, fleet.present(), fleet.claims(), effects)

    def _effects_on_the_others(self, clock_s: float, slots: int) -> FaultEffects:
        """What faults do to what the others say."""
        navigator, faults = self.around.fleet.navigator, self.around.faults
        if navigator is None or not (faults.faults and faults.active(clock_s)):
            return FaultEffects.none(slots, 0)
        sky = navigator.track.at(navigator.track.start_s + clock_s, np.zeros(slots))
        return faults.effects(clock_s, self.epoch_s, sky, slots)

    def belief(self) -> EgoBelief:
        """All that the ego knows of itself now."""
        b, fix = self.believed, self.tracker.fix
        longitudinal, lateral = b.lane.local_coordinates(b.position)
        return EgoBelief(
            time_s=self.time_s,
            position_m=b.position.copy(),
            heading_rad=float(b.heading),
            speed_mps=float(b.speed),
            yaw_rate_radps=self.tracker.yaw_rate_radps,
            acceleration_mps2=self.tracker.acceleration_mps2,
            steering_rad=self.steering_rad,
            lane_index=b.lane_index,
            longitudinal_m=float(longitudinal),
            lateral_m=float(lateral),
            angle_rad=float(b.lane.local_angle(b.heading, longitudinal)),
            lane_width_m=float(b.lane.width_at(longitudinal)),
            target_lane_index=b.target_lane_index if self.meta else b.lane_index,
            target_speed_mps=float(b.target_speed if self.meta else b.speed),
            pl_at_m=self._levels_m[0],
            pl_ct_m=self._levels_m[1],
            al_at_m=self.limits_m[0],
            al_ct_m=self.limits_m[1],
            mode=fix.mode,
            rtk=fix.rtk,
            reason=self._reason,
            alert=self._alert,
            alert_age_s=self.alert_age_s,
            available=self._available,
            hdop=fix.hdop,
            satellites=fix.satellites,
            satellites_doppler=fix.satellites_doppler,
            excluded=fix.excluded,
            since_rtk_s=fix.since_rtk_s,
            since_calibration_s=fix.since_calibration_s,
            corrections_age_s=fix.corrections_age_s,
        )

    @property
    def route(self) -> list[Any] | None:
        """The route intended, None for wherever the lane leads."""
        route: list[Any] | None = self.believed.route
        return route

    @property
    def meta(self) -> bool:
        """Whether the ego is under meta-actions."""
        return isinstance(self.ego, MetaEgo)
