"""The ego's picture of the traffic, epoch after epoch."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.perception.config import PerceptionConfig
from lanebound.envs.perception.sensor import Sensor
from lanebound.envs.perception.tracks_kernel import AGE, HEADING, N_COLUMNS, PL_AT, PL_CT, SPEED, XY, bring_forward
from lanebound.envs.perception.vehicles import Claims, Vehicles
from lanebound.envs.records import EgoBelief, Traffic, azimuth_of, enu_of, heading_of, xy_of
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.v2v import V2vInbox, V2vMessage, exchange, forget, initial_v2v

__all__ = ["Perception"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


class Perception:
    """What the ego knows of the others, from broadcasts, from its own sensor, or from both.

    Everything is placed where it should be now: brought forward at constant velocity from its measurement, ``age``
    ago, with protection levels grown by ``a_at age^2 / 2`` and ``a_ct age^2 / 2 + v age sin(course)``, from the bounds
    of acceleration along and across and of the angle between course and heading.

    A broadcast's levels are its sender's and bound its position on the globe. Those of the sensor are ``k sigma`` of
    the measurement and bound the position *relative* to the ego (``Traffic.relative``). With both sources the newer
    measurement of a vehicle counts, and of two equally old ones the sensor's: nobody else's words are in it.

    Parameters
    ----------
    config
        Sources and their figures.
    capacity
        Number C of slots.
    dt_s
        Time between steps.
    streams
        Draws for the one receiver, so of batch 1: "v2v" and "sensor", a fixed number in each step that uses them.

    Raises
    ------
    InputError
        When ``streams`` are for another batch, or capacity or step are not positive.
    """

    def __init__(self, config: PerceptionConfig, capacity: int, dt_s: float, streams: Streams) -> None:
        if streams.batch != 1:
            raise InputError(f"streams must be for one receiver, got batch {streams.batch}: pass Streams([seed])")
        self.config = config
        self.capacity = capacity
        self._dt_s = dt_s
        self._streams = streams
        self._channel = initial_v2v(config.v2v, capacity, dt_s, receivers=1)
        self._sensor = Sensor(config.sensor, capacity, dt_s, streams)
        self._slot = np.zeros(0, dtype=np.int64)
        self._key = np.full(capacity, -1, dtype=np.int64)
        self._length_m = np.zeros(capacity)
        self._width_m = np.zeros(capacity)
        self._course_sin = math.sin(math.radians(config.course_bound_deg))
        self._nothing = np.full((capacity, N_COLUMNS), np.inf)

    def step(
        self, time_s: float, ego: EgoBelief, ego_slot: int, vehicles: Vehicles, claims: Claims, effects: FaultEffects
    ) -> Traffic:
        """One epoch: everyone broadcasts, the sensor looks, and the ego's picture of the traffic is renewed.

        Parameters
        ----------
        time_s : end of the epoch
        ego : belief of the ego at that time
        ego_slot : its slot
        vehicles : who is really there, the ego included
        claims : what each slot believes of itself
        effects : faults of C vehicles; liars displace their position and scale their levels

        Raises
        ------
        InputError
            When the ego is not among ``vehicles``, or slots are shared or do not exist.
        """
        self._admit(vehicles)
        me = _row_of(ego_slot, vehicles)
        source = self.config.source
        if source == "none":
            return Traffic.none()
        if source == "truth":
            return _truth(ego, me, vehicles)
        told, seen = self._nothing, self._nothing
        if source != "sensor":
            told = self._listen(time_s, ego_slot, vehicles, claims, effects)
        if source != "v2v":
            seen = self._sensor.look(ego, me, vehicles)
        return self._traffic(ego, told, seen)

    def _admit(self, vehicles: Vehicles) -> None:
        """Clear slots that other vehicles take over and those they had before, and note how large everybody is."""
        slot = vehicles.slot
        if slot.shape != self._slot.shape or (slot != self._slot).any():
            self._slot = _require_slots(slot, self.capacity)
        new = self._key[slot] != vehicles.key
        if new.any():
            moved = np.flatnonzero(np.isin(self._key, vehicles.key[new]))
            gone = np.union1d(slot[new], moved)
            forget(self._channel, gone)
            self._sensor.forget(gone)
            self._key[gone] = -1
            self._key[slot] = vehicles.key
        self._length_m[slot] = vehicles.length_m
        self._width_m[slot] = vehicles.width_m

    def _listen(self, time_s: float, ego_slot: int, vehicles: Vehicles, claims: Claims, effects: FaultEffects) -> Array:
        """The newest broadcast held of each slot, (C, 7); never heard: age inf."""
        antenna = np.zeros((self.capacity, 2))  # x, y do as well as East, North: only distances count
        antenna[vehicles.slot] = vehicles.position_m
        sending = np.zeros(self.capacity, dtype=np.bool_)
        sending[vehicles.slot] = claims.initialised[vehicles.slot]
        message = V2vMessage(
            position_en_m=enu_of(claims.position_m),
            heading_rad=azimuth_of(claims.heading_rad),
            speed_mps=claims.speed_mps,
            pl_at_m=claims.pl_at_m,
            pl_ct_m=claims.pl_ct_m,
        )
        inbox = exchange(
            self.config.v2v,
            self._channel,
            time_s,
            self._dt_s,
            message,
            antenna,
            effects,
            self._streams,
            receivers=[ego_slot],
            sending=sending,
        )
        return _table(inbox)

    def _traffic(self, ego: EgoBelief, told: Array, seen: Array) -> Traffic:
        """The tracks young enough, brought forward to now, nearest first."""
        config, tracks = self.config, np.empty((self.capacity, N_COLUMNS))
        slots, relative = np.empty(self.capacity, dtype=np.int64), np.empty(self.capacity, dtype=np.bool_)
        count = bring_forward(
            told,
            seen,
            config.drop_after_s,
            config.acceleration_bound_mps2,
            config.lateral_bound_mps2,
            self._course_sin,
            np.ascontiguousarray(ego.position_m),
            tracks,
            slots,
            relative,
        )
        track, slots = tracks[:count], slots[:count]
        return Traffic(
            key=self._key[slots],
            position_m=track[:, XY],
            heading_rad=track[:, HEADING],
            speed_mps=track[:, SPEED],
            pl_at_m=track[:, PL_AT],
            pl_ct_m=track[:, PL_CT],
            age_s=track[:, AGE],
            length_m=self._length_m[slots],
            width_m=self._width_m[slots],
            relative=relative[:count],
        )


def _truth(ego: EgoBelief, me: int, vehicles: Vehicles) -> Traffic:
    """Everybody else as they are."""
    gap = vehicles.position_m - ego.position_m
    order = np.argsort(gap[:, 0] ** 2 + gap[:, 1] ** 2, kind="stable")
    order = order[order != me]
    zero = np.zeros(order.size)
    return Traffic(
        key=vehicles.key[order],
        position_m=vehicles.position_m[order],
        heading_rad=vehicles.heading_rad[order],
        speed_mps=vehicles.speed_mps[order],
        pl_at_m=zero,
        pl_ct_m=zero,
        age_s=zero,
        length_m=vehicles.length_m[order],
        width_m=vehicles.width_m[order],
        relative=np.zeros(order.size, dtype=np.bool_),
    )


def _table(inbox: V2vInbox) -> Array:
    """What the one receiver holds, in the plane, (C, 7)."""
    table = np.empty((inbox.age_s.shape[1], N_COLUMNS))
    table[:, XY] = xy_of(inbox.position_en_m[0])
    table[:, HEADING] = heading_of(inbox.heading_rad[0])
    table[:, SPEED] = inbox.speed_mps[0]
    table[:, PL_AT] = inbox.pl_at_m[0]
    table[:, PL_CT] = inbox.pl_ct_m[0]
    table[:, AGE] = inbox.age_s[0]
    return table


def _require_slots(slot: Rows, capacity: int) -> Rows:
    """A copy of ``slot``, or InputError when one does not exist or is shared."""
    if slot.size and (slot.min() < 0 or slot.max() >= capacity):
        raise InputError(f"vehicles.slot must lie in [0, {capacity}), got {slot}: raise the capacity")
    if np.unique(slot).size < slot.size:
        raise InputError(f"vehicles.slot must not repeat, got {slot}: give each vehicle a slot of its own")
    return slot.copy()


def _row_of(slot: int, vehicles: Vehicles) -> int:
    rows = np.flatnonzero(vehicles.slot == slot)
    if rows.size != 1:
        raise InputError(f"ego_slot must be that of one vehicle, got {slot} and slots {vehicles.slot}: add the ego")
    return int(rows[0])
