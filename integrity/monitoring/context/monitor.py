"""The context-aware monitor: position, then speed, then map; a verdict, a score and a light for the driver.

S5 figure 2. Each phase is reached by those that passed the one before; every vehicle has a verdict at every epoch.

At rest there is neither a Doppler speed nor a direction to test. The position is tested as in motion; of speed and map
the last verdict in motion holds, with its reason and score: a vehicle at rest is on the road it was on. Rest is what
the wheels say as long as Doppler does not contradict (:mod:`.speed_phase`); it is not known without a Doppler velocity.

>>> from lanebound.integrity.monitoring.context.monitor import ContextMonitor, ContextConfig   # doctest: +SKIP
>>> monitor = ContextMonitor(ContextConfig(), road_map, batch=3, dt_s=1.0)                       # doctest: +SKIP
>>> verdict = monitor.step(fix, wheel_mps)                                                       # doctest: +SKIP
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.row_memory import EVERY, Memory, Rows
from lanebound.integrity.monitoring.context.code_fix import CodeCovariance, CodeErrorsConfig, CodeFix, JudgedFix
from lanebound.integrity.monitoring.context.link_scores import make_score
from lanebound.integrity.monitoring.context.map_phase import MapPhase, MapPhaseConfig, MapTest
from lanebound.integrity.monitoring.context.position_phase import PositionPhaseConfig, PositionTest, check_position
from lanebound.integrity.monitoring.context.speed_phase import SpeedPhase, SpeedPhaseConfig, SpeedTest
from lanebound.integrity.positioning.map_matching.hidden_markov import make_matcher
from lanebound.integrity.positioning.map_matching.matching import MapMatches, MatchingConfig, MatchInputs
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

__all__ = ["ContextConfig", "ContextMonitor", "ContextReason", "ContextVerdict", "Light", "light_of", "match_inputs"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class ContextReason(Advice):
    """Why the driver is warned, or that the road and speed shown may be used."""

    TRUSTED = 0, "position, speed and road agree"
    NO_POSITION = 1, "no position: too few satellites"
    UNAVAILABLE = 2, "the protection level exceeds the alert limit: the position may be wrong by more"
    POSITION_FAULT = 3, "the satellites contradict each other: do not use the position"
    SLOW = 4, "too slow for Doppler and a direction: the last verdict in motion holds"
    COLLECTING = 5, "the average speed is not known yet"
    SPEED_FAULT = 6, "the Doppler speed is not to be trusted"
    NO_ROAD = 7, "no road of the map near the position"
    DOUBTFUL_ROAD = 8, "the road shown does not fit the motion"


class Light(IntEnum):
    """What the driver sees."""

    GREEN = 0
    AMBER = 1
    RED = 2


AMBER = (ContextReason.UNAVAILABLE, ContextReason.SLOW, ContextReason.COLLECTING)


class ContextConfig(Config):
    """The three phases, their matcher, and what holds at rest."""

    codes: CodeErrorsConfig = CodeErrorsConfig()
    position: PositionPhaseConfig = PositionPhaseConfig()
    speed: SpeedPhaseConfig = SpeedPhaseConfig()
    map: MapPhaseConfig = Field(default_factory=MapPhaseConfig)
    matching: MatchingConfig = MatchingConfig()
    warn_at_rest: bool = Field(
        False, description="warn below the least speed, as S5's flow chart does; false: the verdict in motion holds"
    )
    position_phase: bool = Field(True, description="the first phase may warn; false: for ablations")
    speed_phase: bool = Field(True, description="the second phase may warn")
    map_phase: bool = Field(True, description="the third phase may warn")

    @model_validator(mode="after")
    def _printed_slope_is_of_single_codes(self) -> ContextConfig:
        if self.position.printed_slope and self.codes.covariance is not CodeCovariance.DIAGONAL:
            raise ConfigError(
                "codes.covariance must be diagonal with position.printed_slope, got full: the printed slope takes each "
                "code by itself; set codes.covariance=diagonal"
            )
        return self


class ContextVerdict(NamedTuple):
    """What the monitor says of B vehicles.

    warn (B,) bool; reason (B,) codes of ContextReason; phases (B,) phases passed, 0 to 3; score (B,) 0 to 100; link
    (B,) identity of the matched link, NO_LINK without; match, position, speed, map: what the phases found.
    """

    warn: Bools
    reason: Ints
    phases: Ints
    score: Array
    link: Ints
    match: MapMatches
    position: PositionTest
    speed: SpeedTest
    map: MapTest

    @property
    def light(self) -> Ints:
        """Codes of Light, (B,)."""
        return light_of(self.reason, self.warn)


def light_of(reason: Ints, warn: Bools) -> Ints:
    """Green without a warning, amber where nothing is known to be wrong, red where something is."""
    amber = np.isin(reason, [member.code for member in AMBER])
    return np.where(~warn, int(Light.GREEN), np.where(amber, int(Light.AMBER), int(Light.RED)))


class ContextMonitor:
    """Monitors B vehicles on one map.

    Parameters
    ----------
    config : ContextConfig
    road_map : RoadMap
        The map that the vehicles have, with its errors.
    batch : int
    dt_s : float
        Time between epochs.

    Attributes
    ----------
    memory : what lasts, of the matcher, the phases and the last verdicts in motion; arrays with the vehicles as first
        axis
    """

    def __init__(self, config: ContextConfig, road_map: RoadMap, batch: int, dt_s: float) -> None:
        if not dt_s > 0.0 or batch < 1:
            raise InputError(f"dt_s must be > 0 and batch >= 1, got {dt_s} and {batch}: give an epoch and vehicles")
        self.config, self.road_map, self.dt_s = config, road_map, dt_s
        self.matcher = make_matcher(road_map, config.matching, batch)
        self.speed = SpeedPhase(config.speed, batch)
        self.map = MapPhase(config.map, batch)
        m = config.map
        self.score = make_score(m.score, road_map, config.matching, m.map_sigma_m, m.intervals, batch)
        unknown = np.full(batch, ContextReason.COLLECTING.code)
        self._held: Memory = {"reason": unknown, "score": np.zeros(batch)}  # of speed and map, last in motion

    @property
    def memory(self) -> dict[str, Memory]:
        """See the class."""
        return {
            "matcher": self.matcher.memory, "speed": self.speed.memory, "map": self.map.memory, "held": self._held,
            **({} if self.score is None else {"score": self.score.memory}),
        }  # fmt: skip

    @memory.setter
    def memory(self, memory: dict[str, Memory]) -> None:
        self.matcher.memory, self.speed.memory = memory["matcher"], memory["speed"]
        self.map.memory, self._held = memory["map"], memory["held"]
        if self.score is not None:
            self.score.memory = memory["score"]

    def forget(self, rows: Rows) -> None:
        """Begin anew with these vehicles."""
        self.matcher.forget(rows)
        self.speed.forget(rows)
        self.map.forget(rows)
        if self.score is not None:
            self.score.forget(rows)
        self._held["reason"][rows], self._held["score"][rows] = ContextReason.COLLECTING.code, 0.0

    def step(
        self,
        fix: JudgedFix,
        wheel_mps: Array,
        position: PositionTest | None = None,
        speed: SpeedTest | None = None,
        rows: Rows = EVERY,
    ) -> ContextVerdict:
        """The verdict of an epoch, from a position and the wheel speed (B,).

        ``position`` and ``speed`` are results of the first phases on the same fix, when another monitor has them. With
        ``rows`` only these vehicles have an epoch, and all arguments are theirs.

        Raises
        ------
        InputError
            Neither are there codes, which the first phase tests, nor its result.
        """
        if position is None:
            if not isinstance(fix, CodeFix):
                raise InputError("position must be given for a fix without codes, got None: pass the result of a test")
            position = check_position(fix.codes, self.config.position, fix.hdop)
        if speed is None:
            speed = self.speed.step(fix.velocity_en_mps, fix.velocity_covariance, wheel_mps, fix.has_velocity, rows)
        inputs = match_inputs(fix, speed, self.dt_s)
        match = self.matcher.step(inputs, rows)
        last = np.where(fix.has_velocity, np.hypot(*fix.velocity_en_mps.T), np.abs(wheel_mps))
        average = np.where(speed.known, speed.average_mps, last)
        score = None if self.score is None else self.score.step(match, inputs, rows)
        tested = self.map.step(
            match, fix.position_en_m, inputs.sigma_m, inputs.heading_rad, average, self.dt_s, rows, inputs.headed, score
        )  # fmt: skip
        held, shown = self._held_at_rest(fix.has_velocity, speed, tested, rows)
        reason = self._of_position(fix.located, position)
        reason = np.where(reason == ContextReason.TRUSTED.code, held, reason)
        calm = ContextReason.TRUSTED.code if self.config.warn_at_rest else ContextReason.SLOW.code
        warn = (reason != ContextReason.TRUSTED.code) & (reason != calm)
        names = np.append(self.road_map.identity, NO_LINK)
        return ContextVerdict(
            warn, reason, _phases_passed(position, speed, tested), shown, names[match.link], match, position, speed,
            tested,
        )  # fmt: skip

    def _of_position(self, located: Bools, position: PositionTest) -> Ints:
        """Why the first phase fails; TRUSTED where it does not."""
        on = self.config.position_phase
        return _first(
            (~located, ContextReason.NO_POSITION),
            (on & ~position.available, ContextReason.UNAVAILABLE),
            (on & ~position.consistent, ContextReason.POSITION_FAULT),
        )

    def _held_at_rest(self, has_velocity: Bools, speed: SpeedTest, tested: MapTest, rows: Rows) -> tuple[Ints, Array]:
        """Why the second or third phase fails, and the score: those of now in motion, at rest those of the last motion.

        At rest a verdict without a warning is SLOW, and COLLECTING without a Doppler velocity that confirms the rest.
        """
        c, rest = self.config, speed.at_rest
        now = _first(
            (c.speed_phase & speed.contradicted, ContextReason.SPEED_FAULT),
            (c.speed_phase & ~speed.known, ContextReason.COLLECTING),
            (c.speed_phase & ~speed.consistent, ContextReason.SPEED_FAULT),
            (c.map_phase & ~tested.matched, ContextReason.NO_ROAD),
            (c.map_phase & ~tested.passed, ContextReason.DOUBTFUL_ROAD),
        )
        reason = np.where(rest, self._held["reason"][rows], now)
        score = np.where(rest, self._held["score"][rows], tested.score)
        self._held["reason"][rows], self._held["score"][rows] = reason, score
        sure = has_velocity | (not c.speed_phase)
        calm = np.where(sure, ContextReason.SLOW.code, ContextReason.COLLECTING.code)
        return np.where(rest & (reason == ContextReason.TRUSTED.code), calm, reason), score


def match_inputs(fix: JudgedFix, speed: SpeedTest, dt_s: float) -> MatchInputs:
    """What matchers take of an epoch; the 1 sigma of the position on one axis is 1 m at least."""
    east, north = fix.velocity_en_mps.T
    sigma = np.sqrt(np.maximum(0.5 * np.trace(fix.covariance_en_m2, axis1=1, axis2=2), 1.0))
    moved = np.where(fix.has_velocity, np.hypot(east, north), speed.surely_mps) * dt_s
    return MatchInputs(
        fix.position_en_m, np.arctan2(east, north), speed.surely_mps, moved, sigma, fix.located, fix.has_velocity
    )  # fmt: skip


def _first(*checks: tuple[Bools, ContextReason]) -> Ints:
    """The reason of the first check that fails, in the order of S5 figure 2."""
    return np.select([failed for failed, _ in checks], [why.code for _, why in checks], 0).astype(np.int64)


def _phases_passed(position: PositionTest, speed: SpeedTest, tested: MapTest) -> Ints:
    """Phases passed one after another, 0 to 3."""
    first = position.passed
    second = first & speed.passed
    return first.astype(np.int64) + second + (second & tested.passed)
