"""Navigators: measurements of a batch of vehicles in, solutions with protection levels out.

>>> from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
>>> navigator = Navigator.nominal(NavigatorConfig(), seeds=[1, 2, 3], duration_s=60.0)   # three vehicles, open sky
>>> solution = navigator.step(truth)                                                     # truth: the real motion

A navigator is of the kind that its configuration names. A kind is one configuration class and one navigator class,
joined by :func:`register_navigator`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass
from enum import Enum
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError, InputError, require_finite
from lanebound.integrity.core.records import blocks
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.core.tagged import Tagged
from lanebound.integrity.monitoring.alerts import AlertConfig
from lanebound.integrity.monitoring.exclusion import FdeConfig
from lanebound.integrity.monitoring.risk import RiskConfig, Variant
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.motion.truth_kernel import all_finite
from lanebound.integrity.navigators.context_guard import ContextGuard, ContextGuardConfig, GuardState, Judged
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.config import PositioningConfig
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.sensors import corrections as links
from lanebound.integrity.sensors import gnss as receiver
from lanebound.integrity.sensors.area import initial_area
from lanebound.integrity.sensors.barometer import BarometerConfig, initial_barometer, sample_barometer
from lanebound.integrity.sensors.chassis import ChassisConfig, initial_chassis, sample_chassis
from lanebound.integrity.sensors.compass import CompassConfig, initial_compass, sample_compass
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sensors.finite import with_finite
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sensors.imu import ImuConfig, initial_imu
from lanebound.integrity.sensors.instruments import Instruments, InstrumentState, Measurements
from lanebound.integrity.sensors.odometer import OdometerConfig, initial_odometer
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = [
    "LevelForm",
    "Measurements",
    "Navigator",
    "NavigatorConfig",
    "NavigatorState",
    "PlCase",
    "Start",
    "navigator_class",
    "register_navigator",
    "withdraw_navigator",
]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
STALE_M = 50.0  # driven with one place on the road, after which the place counts as forgotten; chosen
TOLD_SIGMA_M = 0.05  # of a drive that begins where the last one with RTK ended

BUILT_IN = {
    "filter": "lanebound.integrity.navigators.vehicle_filter.navigator",
    "rtk_reckoning": "lanebound.integrity.navigators.rtk_reckoning.navigator",
    "monitored_codes": "lanebound.integrity.navigators.monitored_codes",
}


class LevelForm(Enum):
    """How an RTK protection level is found."""

    ROOT = "root"
    CLOSED = "closed"


class Start(Enum):
    """What a navigator knows when it is switched on."""

    TOLD = "told"
    COLD = "cold"


class PlCase(Config):
    """One protection level to report: a risk, a variant and a form."""

    integrity_risk: float = Field(gt=0, lt=1, description="total horizontal risk [-]")
    variant: Variant = Field(Variant.EXACT, description="exact or published factors and biases")
    form: LevelForm = Field(LevelForm.ROOT, description="multi-hypothesis root (S2 eq 10-11) or closed form (S1 eq 17)")


class NavigatorConfig(Tagged, tag="kind", default="rtk_reckoning", modules=BUILT_IN):
    """Instruments, declared errors and rules of one vehicle; what all kinds of navigators have."""

    kind: str = Field("rtk_reckoning", description="kind of the navigator")
    dt_s: float = Field(0.1, gt=0, le=1, description="length of an epoch [s]; 10 Hz GNSS, S1 section 4")
    sky: SkyConfig = SkyConfig()
    gnss: GnssConfig = GnssConfig()
    corrections: CorrectionsConfig = CorrectionsConfig()
    imu: ImuConfig = ImuConfig()
    odometer: OdometerConfig = OdometerConfig()
    chassis: ChassisConfig = ChassisConfig()
    compass: CompassConfig = CompassConfig()
    barometer: BarometerConfig = BarometerConfig()
    positioning: PositioningConfig = PositioningConfig()
    fde: FdeConfig = FdeConfig()
    risk: RiskConfig = RiskConfig()
    form: LevelForm = Field(LevelForm.ROOT, description="form of the operative RTK protection level")
    start: Start = Field(
        Start.TOLD,
        description="told: a prior pose may be given; cold: position from codes, no level before the heading is known",
    )
    more_levels: tuple[PlCase, ...] = Field(
        (), description="further protection levels to report, in addition to the operative one"
    )
    alert: AlertConfig = AlertConfig()
    context: ContextGuardConfig | None = Field(
        None, description="context-aware monitor of position, Doppler speed and road, which runs next to this navigator"
    )

    @model_validator(mode="after")
    def _levels_fit_the_tests(self) -> Self:
        if self.fde.alpha < self.risk.false_alarm:
            raise ConfigError(
                f"fde.alpha must be >= risk.false_alarm = {self.risk.false_alarm}, got {self.fde.alpha}: "
                "the levels count on the thresholds of false_alarm"
            )
        return self

    @model_validator(mode="after")
    def _flags_are_read(self) -> Self:
        # Flags that nobody reads would look like a detector without effect.
        detector = self.gnss.reflection_detector
        if detector.kind != "none" and detector.use == "flag" and not self.reads_flags:
            raise ConfigError(
                f"gnss.reflection_detector.use must be exclude for navigator {self.kind!r}, which reads no flags, got "
                "flag: set it to exclude, or take monitored_codes with monitor map_exclude or map_deweight"
            )
        return self

    @property
    def reads_flags(self) -> bool:
        """Whether it reads which signals a detector calls reflected."""
        return False

    @property
    def told_sigma_m(self) -> float:
        """1 sigma of the prior position at the start, where nothing else is set [m]; chosen."""
        return TOLD_SIGMA_M

    @property
    def receiver(self) -> GnssConfig:
        """What is simulated of receiver and signals: ``gnss``, and what the kind of navigator needs in addition."""
        return self.gnss

    @property
    def simulated(self) -> GnssConfig:
        """``receiver``, with the undifferenced codes that a context monitor of code positions needs."""
        codes = self.context is not None and self.context.judges is Judged.CODES
        return self.receiver.replace(undifferenced=True) if codes else self.receiver

    @cached_property
    def cases(self) -> tuple[PlCase, ...]:
        """All protection levels reported, the operative one first."""
        first = PlCase(integrity_risk=self.risk.integrity_risk, variant=self.risk.variant, form=self.form)
        return (first, *self.more_levels)


@dataclass
class NavigatorState(InstrumentState):
    """Everything that lasts from epoch to epoch: the state of the instruments, and the belief of the navigator.

    ``belief`` is a NamedTuple or dataclass of arrays with the vehicles as first axis; its type belongs to the kind.
    ``extensions`` holds the arrays (B,) of modes and monitors with a state of their own, by name; ``guard`` what lasts
    of the context monitor.
    """

    belief: Any
    extensions: dict[str, NDArray[Any]]
    guard: GuardState | None = None

    def copy(self) -> NavigatorState:
        """An independent copy."""
        return copy.deepcopy(self)


KINDS: dict[type[NavigatorConfig], type[Navigator]] = {}


def register_navigator(config: type[NavigatorConfig], navigator: type[Navigator]) -> None:
    """Make ``navigator`` the class of the navigators that ``config`` describes.

    ``config`` gives its field ``kind`` a default, the name of the new kind.
    """
    NavigatorConfig.register(config)
    KINDS[config] = navigator


def withdraw_navigator(config: type[NavigatorConfig]) -> None:
    """Remove a registered kind.

    Raises
    ------
    InputError
        The configuration is not registered.
    """
    if config not in KINDS:
        raise InputError(f"config must be a registered class, got {config!r}: pass what register_navigator was given")
    NavigatorConfig.withdraw(config)
    del KINDS[config]


def navigator_class(config: type[Any]) -> type[Navigator]:
    """The class of the navigators of a configuration class, or of the nearest one that it derives from.

    Raises
    ------
    ConfigError
        No such class has one.
    """
    for base in config.__mro__:
        if base in KINDS:
            return KINDS[base]
    known = ", ".join(kind.__name__ for kind in KINDS)
    raise ConfigError(f"config must be of {known} or of a class from one, got {config.__name__}: register_navigator it")


class Navigator:
    """Sensors and estimates of a batch of vehicles. The kind of the configuration chooses the class.

    Parameters
    ----------
    config : NavigatorConfig
    track : SkyTrack
        Satellites over the place and time of the drive.
    mask : SkyMask
        The part of the sky that buildings leave free along the street.
    seeds : one seed for each vehicle, or one int with ``batch``
    faults : FaultSchedule, optional
    area_seed : int, optional
        Seed of an area that all vehicles share: atmosphere, reference station and outages of its network
        (:mod:`.sensors.area`). Navigators with the same seed, clock and sky share it too. None: one for each vehicle.

    Raises
    ------
    InputError
        When the seeds are negative or do not fit ``batch``.

    Attributes
    ----------
    radial_levels : whether each of the two levels bounds the whole horizontal error
    """

    radial_levels: ClassVar[bool] = False

    def __new__(cls, config: NavigatorConfig | None = None, *rest: Any, **more: Any) -> Self:
        """An object of the class of the configuration's kind."""
        kind = navigator_class(type(config)) if cls is Navigator and config is not None else cls
        return super().__new__(kind)  # type: ignore[return-value]

    def __init__(
        self,
        config: NavigatorConfig,
        track: SkyTrack,
        mask: SkyMask,
        seeds: int | Sequence[int],
        batch: int | None = None,
        faults: FaultSchedule | None = None,
        area_seed: int | None = None,
    ) -> None:
        self.config, self.track, self.mask = config, track, mask
        self._arc_m, self._stale_m = np.full(1, np.nan), np.zeros(1)
        self.faults = faults or FaultSchedule(())
        self._lever_m = config.positioning.lever_arm_m
        self._instruments = Instruments.of(
            config.simulated, config.corrections, config.imu, config.odometer, config.dt_s, config.sky.place_rad
        )
        self._guard: ContextGuard | None = None
        self.prepare()
        area = Streams(seeds, batch) if area_seed is None else Streams([area_seed])
        self.state = self._initial(Streams(seeds, batch), area)

    # What a kind defines

    def prepare(self) -> None:
        """Compute what follows from the configuration and the track, once; by default nothing."""
        return

    def initial_belief(self, batch: int) -> Any:
        """The belief of vehicles that have just been switched on: a NamedTuple or dataclass of arrays (B, ...)."""
        raise NotImplementedError

    def initial_extensions(self, batch: int) -> dict[str, NDArray[Any]]:
        """The states (B,) of modes and monitors that have one, by name; by default none."""
        return {}

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """Give the vehicles a prior heading, (B,) azimuth and its 1-sigma, as from a compass or the last drive."""
        raise NotImplementedError

    def place_rows(
        self, rows: Rows | slice, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_heading_rad: float
    ) -> None:
        """:meth:`place` in the belief, with checked arguments."""
        raise NotImplementedError

    def locate(self, m: Measurements) -> Solution:
        """The belief after the measurements of one epoch; reads nothing else.

        The kinds of this package take satellites out of use whose values are not finite, and refuse other sensors whose
        values are not (:func:`~lanebound.integrity.sensors.finite.with_finite`).
        """
        raise NotImplementedError

    # What all kinds have

    @classmethod
    def nominal(
        cls, config: NavigatorConfig, seeds: int | Sequence[int], batch: int | None = None, duration_s: float = 600.0
    ) -> Navigator:
        """A navigator under the nominal constellations of the configuration and an open sky."""
        return cls(config, SkyTrack.from_config(config.sky, duration_s), SkyMask.open(), seeds, batch)

    def _initial(self, streams: Streams, area_streams: Streams) -> NavigatorState:
        c, batch, n_sat = self.config, streams.batch, len(self.track.system)
        area = initial_area(c.simulated, c.corrections, n_sat, c.dt_s, area_streams)
        sky = self.track.at(self.track.start_s, np.zeros(batch, dtype=np.int64))
        return NavigatorState(
            streams=streams,
            area=area,
            gnss=receiver.initial_state(c.simulated, sky, streams),
            corrections=links.initial_state(c.corrections, area.network, n_sat, c.dt_s, streams),
            imu=initial_imu(c.imu, streams),
            odometer=initial_odometer(c.odometer, streams),
            chassis=initial_chassis(c.chassis, streams) if c.chassis.fitted else None,
            compass=initial_compass(c.compass, streams) if c.compass.fitted else None,
            barometer=initial_barometer(c.barometer, streams) if c.barometer.fitted else None,
            belief=self.initial_belief(batch),
            extensions=self.initial_extensions(batch),
            guard=None if self._guard is None else self._guard.initial(batch),
        )

    def use_map(self, road_map: RoadMap, one_in: int = 1) -> None:
        """Give the context monitor its road network, before the first epoch; without ``context`` nothing happens.

        ``one_in``: only every ``one_in``-th vehicle is monitored, beginning with the first.
        """
        if self.config.context is not None:
            self._guard = ContextGuard(self.config.context, road_map, self.config.dt_s, one_in, self.radial_levels)
            self.state.guard = self._guard.initial(self.batch)

    @property
    def batch(self) -> int:
        """Number of vehicles."""
        return self.state.streams.batch

    @property
    def epoch(self) -> int:
        """Epochs that its clock has counted."""
        return self.state.area.network.epoch

    def another(self, streams: Streams) -> Self:
        """A navigator of the same configuration for other vehicles, each in an area of its own, just switched on."""
        other = copy.copy(self)
        other.state = other._initial(streams, streams)
        return other

    def adopt(self, rows: Rows, other: Navigator, theirs: Rows) -> None:
        """Take over the vehicles ``theirs`` (n,) of another navigator as ``rows`` (n,), in place of those there.

        Each vehicle keeps its own time, so that from then on ``measure`` needs the sky of each; streams are not taken
        over.

        Raises
        ------
        InputError
            Vehicles of either navigator share an area, are seeded jointly, or suffer faults, which go by one clock.
        """
        for name, navigator in (("this navigator", self), ("other", other)):
            navigator._require_single(name)
        _hand_over(self.state, other.state, rows, theirs)
        mine, network = self.state.area.network, other.state.area.network
        mine.areas["begun"][rows] = mine.epoch - network.own_epoch[theirs]

    def _require_single(self, name: str) -> None:
        """Raise InputError unless vehicles share nothing, neither generators nor areas nor a schedule of faults."""
        areas, seeds = self.state.area.network.areas.size, self.state.streams.seeds
        if areas != self.batch:
            raise InputError(f"{name} must have an area for each of {self.batch} vehicles, got {areas}: "
                             "give it no area_seed")  # fmt: skip
        if seeds is None:
            raise InputError(f"{name} must have a seed for each vehicle, got one for all: give it a list of seeds")
        if self.faults.faults:
            raise InputError(f"{name} must have no faults, got {len(self.faults.faults)}: their times are of one clock")

    def place(
        self,
        position_en_m: Array,
        heading_rad: Array,
        sigma_m: float,
        sigma_heading_rad: float,
        rows: Rows | slice = slice(None),
    ) -> None:
        """Set position and heading of the vehicles of ``rows`` (all by default), with their standard deviations.

        position_en_m (n, 2), heading_rad (n,) azimuths; 1-sigma on each horizontal axis and of the heading. Errors
        that grow between positions begin anew. Estimates of sensor errors (gyro bias) and the alert may stay.

        Raises
        ------
        InputError
            When an entry is not finite or a sigma is not positive.
        """
        if not (sigma_m > 0.0 and sigma_heading_rad > 0.0):
            raise InputError(f"sigma_m and sigma_heading_rad must be > 0, got {sigma_m} and {sigma_heading_rad}")
        position, heading = require_finite("position_en_m", position_en_m), require_finite("heading_rad", heading_rad)
        self.place_rows(rows, position, heading, sigma_m, sigma_heading_rad)
        for name, fresh in self.initial_extensions(1).items():
            self.state.extensions[name][rows] = fresh
        if self._guard is not None and self.state.guard is not None:
            self._guard.forget(self.state.guard, rows)
        self.state.odometer.wheels["last_true_mps"][rows] = np.nan  # no acceleration, so no slip, in the first epoch

    def snapshot(self) -> NavigatorState:
        """An independent copy of everything that lasts."""
        return self.state.copy()

    def restore(self, state: NavigatorState) -> None:
        """Continue from a snapshot, with the same draws."""
        self.state = state.copy()

    def step(self, truth: Truth) -> Solution:
        """Measure the truth of one epoch and locate the vehicles.

        Raises
        ------
        InputError
            When the truth has another batch or epoch length, or lies outside the sky track; or vehicles move through a
            city and ``truth.arc_m``, by which the sky is looked up, stays as it is.
        """
        self._require_moving_sky(truth)
        return self.solve(self.measure(truth))

    def _require_moving_sky(self, truth: Truth) -> None:
        """Refuse vehicles that have moved by STALE_M without a change of their place on the road."""
        if self.mask.rows.cell.shape[0] == 1 or truth.arc_m.shape != (self.batch,):  # one sky everywhere; refused later
            return
        self._stale_m = np.where(truth.arc_m == self._arc_m, self._stale_m + np.abs(truth.distance_m), 0.0)
        self._arc_m = truth.arc_m.copy()
        if (worst := float(self._stale_m.max(initial=0.0))) > STALE_M:
            raise InputError(
                f"truth.arc_m must be the place on the road, got the same over {worst:.0f} m in a city: pass "
                "arc_m=road.project(position)[0] to truth_between"
            )

    def solve(self, m: Measurements) -> Solution:
        """:meth:`locate`, and the report of the context monitor where ``context`` is configured.

        Raises
        ------
        InputError
            The context monitor has no map: :meth:`use_map` gives one.
        """
        solution = self.locate(m)
        if self.config.context is None:
            return solution
        if self._guard is None or self.state.guard is None:
            raise InputError(
                "context (or monitor: {kind: context}) needs a road map, got none: give one by use_map before "
                "the first epoch, or leave it out"
            )
        return self._guard.judge(self.state.guard, with_finite(m), solution)

    def follow(self, m: Measurements) -> None:
        """:meth:`solve` where the solution is not needed."""
        self.solve(m)

    def measure(
        self, truth: Truth, sky: SkyView | None = None, effects: FaultEffects | None = None
    ) -> Measurements:  # fmt: skip
        """The measurements of this epoch; nothing else reads the truth.

        ``sky`` holds the satellites of the track as the vehicles see them, when that is not by the truth's clock: each
        vehicle may be at an hour of its own. ``effects`` are those of faults by other clocks, in place of ``faults``.

        Raises
        ------
        InputError
            As :meth:`step`; or there is no ``sky`` for vehicles that were adopted, whose times differ.
        """
        self._require_fitting(truth)
        if sky is None:
            if self.state.area.network.areas["begun"].any():
                raise InputError("sky must be given for vehicles that were adopted, got None: each has its own time")
            sky = self.track.at(self.track.start_s + truth.time_s, np.zeros(self.batch, dtype=np.int64))
        if effects is None and self.faults.faults and self.faults.active(truth.time_s):
            effects = self.faults.effects(truth.time_s, truth.dt_s, sky, self.batch)
        elif effects is None:
            effects = _no_effects(self.batch, sky.satellites)
        at_antenna = truth.at(*self._lever_m) if any(self._lever_m) else truth
        measured = self._instruments.sense(self.state, sky, self.mask, at_antenna, effects)
        return self._with_body(measured, truth, at_antenna, effects)

    def _with_body(self, m: Measurements, truth: Truth, at_antenna: Truth, effects: FaultEffects) -> Measurements:
        """The measurements with those of chassis, compass and barometer, where they are fitted."""
        c, s = self.config, self.state
        if s.chassis is not None:
            m = m.with_samples(chassis=sample_chassis(c.chassis, s.chassis, truth, effects, s.streams))
        if s.compass is not None:
            m = m.with_samples(compass=sample_compass(c.compass, s.compass, truth, s.streams))
        if s.barometer is not None:
            m = m.with_samples(barometer=sample_barometer(c.barometer, s.barometer, at_antenna, s.streams))
        return m

    def _require_fitting(self, truth: Truth) -> None:
        """Raise InputError unless the truth is finite, of this batch and of an epoch's length."""
        if truth.batch != self.batch:
            raise InputError(f"truth must have {self.batch} vehicles, got {truth.batch}: one row for each seed")
        if abs(truth.dt_s - self.config.dt_s) > 1e-9:
            raise InputError(f"truth.dt_s must be {self.config.dt_s}, got {truth.dt_s}: step at the navigator's rate")
        if not all_finite(truth.records):
            for name in ("position_enu_m", "velocity_enu_mps", "heading_rad", "arc_m"):
                require_finite(f"truth.{name}", getattr(truth, name))


def _hand_over(mine: Any, other: Any, rows: Rows, theirs: Rows) -> None:
    """Copy the rows of every array of a state, and of the states in it; clocks and streams stay."""
    if isinstance(other, np.ndarray):
        if other.dtype.names is not None:
            mine, other = blocks(mine), blocks(other)
        mine[rows] = other[theirs]
        return
    parts = other if isinstance(other, dict) else other._asdict() if hasattr(other, "_asdict") else vars(other)
    for name, value in parts.items():
        if isinstance(value, np.ndarray | dict | tuple) or is_dataclass(value):
            _hand_over(mine[name] if isinstance(mine, dict) else getattr(mine, name), value, rows, theirs)


@lru_cache(maxsize=8)
def _no_effects(batch: int, satellites: int) -> FaultEffects:
    """No fault at all, in shared arrays. Do not write them: they are not read-only, for which kernels would be compiled
    again."""
    return FaultEffects.blank(batch, satellites)
