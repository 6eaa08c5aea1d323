"""The vehicles that N egos perceive in each epoch: radios, sensors, and the state of both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lanebound.envs.batch import cooperative_kernel as ck
from lanebound.envs.batch import perception_kernel as pk
from lanebound.envs.batch import rows_kernel as rk
from lanebound.envs.batch import surrogate_kernel as gk
from lanebound.envs.batch.records_kernel import PERCEIVED
from lanebound.envs.perception import PerceptionConfig
from lanebound.integrity.core import streams_kernel as sk
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import ZIGGURAT, Streams, named_generator
from lanebound.integrity.sensors import uwb_kernel as uk

__all__ = ["PerceptionBatch", "perceives"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]
GIVEN = ("truth", "none")
UNIFORM = ("v2v", "paths")
FAR_M = 1000.0  # beyond the roads of a crossing and any sensor
PERCEIVE_US = 6.0  # of one thread for an environment, measured


def perceives(config: PerceptionConfig) -> bool:
    """Whether traffic is perceived by sensor or radio, not given."""
    return config.source not in GIVEN


class PerceptionBatch:
    """The egos' pictures of the traffic.

    Parameters
    ----------
    config : sources and their figures
    count, capacity : N egos, and C slots of others that each may perceive
    vehicles : V that an environment may have, the ego included
    epoch_s : length of an epoch
    recordings : whose errors the broadcasts of the others have, None where they navigate
    level_risk : integrity risk of the levels of positions

    Attributes
    ----------
    has_radio, has_sensor, has_ranges : whether the sources are the radio, a sensor, or both, and ranges with a radio
    pictures : the records, for kernels
    """

    def __init__(
        self,
        config: PerceptionConfig,
        count: int,
        capacity: int,
        vehicles: int,
        epoch_s: float,
        recordings: gk.Recordings | None = None,
        level_risk: float = 1e-5,
    ) -> None:
        v, s = config.v2v, config.sensor
        self.config, self.count, self.capacity, self.vehicles = config, count, capacity, vehicles
        self.recordings = recordings
        self.has_radio, self.has_sensor = capacity > 0 and config.has_radio, capacity > 0 and config.has_sensor
        self.has_ranges = self.has_radio and config.source == "cooperative"
        self._slots_late = math.ceil(v.latency_max_s / epoch_s) + 2 if self.has_radio else 0
        self._radio = one_record(
            pk.RADIO, latency_s=v.latency_s, jitter_s=v.jitter_s, latency_max_s=v.latency_max_s, loss=v.loss,
            range_m=v.range_m, rate_hz=v.rate_hz, epoch_s=epoch_s, cam=v.messages == "cam",
            level_sigmas=_sigmas(level_risk),
        )  # fmt: skip
        self._sensor = one_record(
            pk.SENSOR, range_m=s.range_m, half_view_rad=math.radians(0.5 * s.field_of_view_deg),
            range_sigma_m=s.range_sigma_m, lateral_bias_sigma_m=s.lateral_bias_sigma_m,
            bearing_sigma_rad=math.radians(s.bearing_sigma_deg),
            speed_sigma_mps=s.speed_sigma_mps, heading_sigma_rad=math.radians(s.heading_sigma_deg),
            bound_sigmas=s.bound_sigmas, epoch_s=epoch_s,
        )  # fmt: skip
        self._tracking = one_record(
            pk.TRACKING, drop_after_s=config.drop_after_s, along_mps2=config.acceleration_bound_mps2,
            across_mps2=config.lateral_bound_mps2, course_sin=math.sin(math.radians(config.course_bound_deg)),
        )  # fmt: skip
        self._of_ranges = config.cooperation.ranging.figures(epoch_s)
        self._of_relations = _cooperation(config, level_risk)
        self._make()

    def _make(self) -> None:
        n, late, heard = self.count, self._slots_late, self.capacity if self.has_radio else 0
        slots = self.capacity + 1 if self.has_radio or self.has_sensor else 0
        self._streams = Streams([0] * n)
        self._there = np.ones((n, slots), dtype=np.bool_)
        spoken = heard if self.recordings is not None else 0
        one, every = np.zeros((3, n), dtype=np.int64), np.zeros((n, spoken), dtype=np.int64)
        moves = np.zeros((n, spoken), gk.MOVE)
        self._stand_ins = gk.StandIns(episode=one[0], now=one[1], since=every, began=one[2], moves=moves)
        radio = pk.Radio(
            np.zeros((n, late, heard), pk.SIGHTING),
            np.full((n, late, heard), -1, dtype=np.int64),
            np.full((n, heard), -1, dtype=np.int64),
            np.zeros((n, heard), pk.SIGHTING),
            np.zeros((n, heard), pk.CAM),
        )
        ranged = self.capacity if self.has_ranges else 0
        ranging = pk.Ranging(
            modules=np.zeros((n, ranged + 1 if ranged else 0), uk.MODULE),
            links=np.zeros((n, ranged, uk.PAIRS), uk.LINK),
            ranges=np.zeros((n, ranged, uk.PAIRS)),
            relations=np.zeros((n, ranged), ck.RELATION),
            of_ranges=self._of_ranges,
            of_relations=self._of_relations,
        )
        self.pictures = pk.PerceptionArrays(
            picture=np.zeros(n, pk.PICTURE),
            perceived=np.zeros((n, max(slots, self.vehicles - 1, 1)), PERCEIVED),
            tracks=np.zeros((n, slots), pk.SIGHTING),
            slots=np.zeros((n, slots), pk.SLOT),
            spoken=np.zeros((n, heard), pk.CLAIM),
            radio=radio,
            of_radio=self._radio,
            of_sensor=self._sensor,
            of_tracks=self._tracking,
            walls=_walls(self.config.sensor.corner_m),
            ranging=ranging,
        )

    def another(self, count: int) -> PerceptionBatch:
        """Pictures of ``count`` egos by the same sources, before any start."""
        other = object.__new__(PerceptionBatch)
        other.__dict__.update(self.__dict__, count=count)
        other._make()
        return other

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(array.nbytes for array in self.arrays)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Those that have a row for each environment."""
        p = self.pictures
        own = p.picture, p.perceived, p.tracks, p.slots, *p.radio, *p.ranging[:4]
        return *own, self._there, *self._stand_ins

    def begin(self, rows: Rows, seeds: Sequence[int], there: Flags, cars: Records) -> None:
        """Start radios without messages and sensors without tracks, with the seeds of the episodes.

        there (n, C): places of others, by slot, that draw.
        """
        p = self.pictures
        p.picture["seen"][rows] = 0
        if not (self.has_radio or self.has_sensor):
            return
        p.picture["epoch"][rows], p.picture["sent"][rows] = 0, -1
        p.picture["last_x_m"][rows] = p.picture["last_y_m"][rows] = 0.0
        p.slots[rows] = np.zeros((), pk.SLOT)
        _silence(p.tracks, rows, np.inf)
        if self.has_radio:
            _silence(p.radio.held, rows, -np.inf)
            p.radio.arriving[rows] = p.radio.origin[rows] = -1
            p.radio.cams[rows] = np.zeros((), pk.CAM)
            p.radio.cams["time_s"][rows], p.radio.cams["gap_s"][rows] = -np.inf, pk.CAM_MOST_S
        self._there[rows, : self.capacity], self._there[rows, self.capacity] = there, True
        for row, seed in zip(rows.tolist(), seeds, strict=True):
            self._streams.reseed(row, seed)
        if self.has_sensor:
            bias = np.empty((rows.size, 1))
            sk.normals(self._streams.states("sensor_bias"), rows, ZIGGURAT, bias)
            p.picture["bias_m"][rows] = self.config.sensor.lateral_bias_sigma_m * bias[:, 0]
        if self.has_ranges:
            self._begin_ranges(rows)
        slot = cars["slot"][rows]
        n, v = np.nonzero(slot >= 0)
        e, s = rows[n], slot[n, v]
        p.slots["key"][e, s] = v
        p.slots["length_m"][e, s], p.slots["width_m"][e, s] = cars["length"][e, v], cars["width"][e, v]
        if self.recordings is not None:
            own, recorded = self._stand_ins, len(self.recordings.vehicles)
            own.episode[rows] = [int(named_generator(seed, "others").integers(recorded)) for seed in seeds]
            own.now[rows] = own.since[rows] = 0
            own.moves[rows] = np.zeros((), gk.MOVE)
            own.began[rows] = (slot >= 0).sum(axis=1)

    def _begin_ranges(self, rows: Rows) -> None:
        """Draw the modules and bodies of the vehicles of episodes, slot by slot, and forget all ranges."""
        ranging, figures = self.pictures.ranging, self._of_ranges[0]
        ranging.links[rows], ranging.relations[rows] = np.zeros((), uk.LINK), np.zeros((), ck.RELATION)
        self.pictures.picture["excluded"][rows] = self.pictures.picture["reason"][rows] = 0
        drawn = self._draw("modules", rows, 3)
        ranging.modules["error_m"][rows] = figures["module_sigma_m"] * drawn[..., :2]
        tall = ndtr(drawn[..., 2]) < figures["tall_share"]
        ranging.modules["height_m"][rows] = np.where(tall, figures["tall_m"], figures["body_m"])

    def adopt(self, rows: Rows, other: PerceptionBatch, theirs: Rows) -> None:
        """Go on in ``rows`` with the draws of the egos ``theirs`` of another batch, whose arrays have been copied."""
        if self.has_radio or self.has_sensor:
            self._streams.adopt(rows, other._streams, theirs)

    def make_room(self, vehicles: int) -> None:
        """Room for as many vehicles, the ego included."""
        perceived = self.pictures.perceived
        if vehicles - 1 > perceived.shape[1]:
            longer = np.zeros((self.count, vehicles - 1), PERCEIVED)
            longer[:, : perceived.shape[1]] = perceived
            self.vehicles, self.pictures = vehicles, self.pictures._replace(perceived=longer)

    def enter(self, row: int, slot: int, key: int, length_m: float, width_m: float) -> None:
        """Assign a slot of an environment to another vehicle and clear what was known of the last one."""
        if not (self.has_radio or self.has_sensor):
            return
        p = self.pictures
        pk.forget_slot(p.radio, p.tracks, row, slot)
        p.slots[row, slot] = key, length_m, width_m
        if self.has_ranges:
            p.ranging.links[row, slot] = np.zeros((), uk.LINK)
            p.ranging.relations[row, slot] = np.zeros((), ck.RELATION)
        if self.recordings is not None:
            self._stand_ins.since[row, slot] = self._stand_ins.now[row] + 1

    def perceive(
        self, rows: Rows, at: Rows, time_s: Array, fixes: Records | None, cars: Records, egos: Records,
        lies: Array | None = None,
    ) -> None:  # fmt: skip
        """One epoch of the egos ``rows`` (n,).

        at (n,): rows of the egos in ``fixes``, after which those of the others follow by slot; time_s (n,) of the
        episodes; lies (N, C, 4): see :func:`.perception_kernel.hear`.
        """
        p, recordings = self.pictures, self.recordings
        hears = self.has_radio and (fixes is not None or recordings is not None)
        if not (hears or self.has_sensor):
            return
        heard = self._draw("v2v", rows, 2) if hears else None
        seen = self._draw("sensor", rows, 4) if self.has_sensor else None
        noise = self._draw("ranges", rows, uk.PAIRS) if self.has_ranges else None
        luck = self._draw("paths", rows, 2 * uk.PAIRS) if self.has_ranges else None

        def work(first: int, last: int) -> None:
            if heard is not None:
                if recordings is None:
                    rk.claim_rows(first, last, rows, at, fixes, p)
                else:
                    gk.stand_in_rows(first, last, rows, cars, egos, p, recordings, self._stand_ins, time_s)
                rk.hear_rows(first, last, rows, cars, egos, p, time_s, heard, lies)
            if seen is not None:
                rk.look_rows(first, last, rows, cars, egos, p, seen)
            if noise is not None:
                rk.range_rows(first, last, rows, cars, egos, p, noise, luck, time_s)
                rk.relate_rows(first, last, rows, egos, p, time_s)
            rk.sum_up_rows(first, last, rows, egos, p, time_s)

        run_rows(work, rows.size, row_us=PERCEIVE_US)

    def _draw(self, name: str, rows: Rows, width: int) -> Array:
        """Draws (n, C + 1, width) for the vehicles there are, one after another, with zeros in empty places.

        Those of messages and paths are uniform, others normal.
        """
        states, there = self._streams.states(name), self._there[rows]
        own, out = states[rows], np.zeros((rows.size, there.shape[1], width))
        if name not in UNIFORM:
            sk.normals_at(0, rows.size, own, there, ZIGGURAT, out)
        else:
            sk.uniforms_at(own, there, out)
        states[rows] = own
        return out


def _sigmas(risk: float) -> float:
    """How many standard deviations bound an error on both sides of two axes: ``Qinv(risk / 4)``."""
    return -NormalDist().inv_cdf(risk / 4.0)


def _cooperation(config: PerceptionConfig, level_risk: float) -> Records:
    """(1,) COOPERATION."""
    c, r = config.cooperation, config.cooperation.ranging
    figures, sigmas = r.figures(0.1)[0], _sigmas(c.integrity_risk)
    module, hidden = float(figures["module_sigma_m"]), 0.0
    if figures["late_share"] > 0.0:  # below the gate; along and across predictions are as uncertain as ranges
        hidden = ck.LATE_SIGMAS * math.sqrt(3.0 * (float(figures["sigma_m"]) ** 2 + 2.0 * module**2))
    return one_record(
        ck.COOPERATION, sigmas=sigmas, level_sigmas=_sigmas(level_risk), gate=_sigmas(2.0 * c.false_alarm),
        ellipse=-2.0 * math.log(c.false_alarm), log_alarm=-math.log(c.false_alarm),
        log_risk=-math.log(c.integrity_risk), window_s=c.window_s,
        own_heading_rad=math.radians(c.own_heading_sigma_deg), heading_rad=math.radians(c.heading_sigma_deg),
        hidden_m=hidden,
    )  # fmt: skip


def _walls(corner_m: float | None) -> Array:
    """The buildings (W, 4) at the four corners of a crossing at the origin, none without a distance."""
    if corner_m is None:
        return np.zeros((0, 4))
    spans = (corner_m, FAR_M), (-FAR_M, -corner_m)
    return np.array([(*x, *y) for x in spans for y in spans])


def _silence(sightings: Records, rows: Rows, time_s: float) -> None:
    """Clear sightings, :func:`.perception_kernel.silence`."""
    sightings[rows] = np.zeros((), pk.SIGHTING)
    for name, value in (("pl_at_m", np.inf), ("pl_ct_m", np.inf), ("time_s", time_s)):
        sightings[name][rows] = value
