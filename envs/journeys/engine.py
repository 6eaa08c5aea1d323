"""The engine of journeys: N of them at once, by which the single environment drives one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from numpy.typing import NDArray

from lanebound.envs.journeys.config import Departure, JourneyConfig, Realised
from lanebound.envs.journeys.course_kernel import drive_rows, only_option
from lanebound.envs.journeys.full import FullDrive
from lanebound.envs.journeys.plan_kernel import HERE, STREET, observe_rows, preview_rows
from lanebound.envs.journeys.records import CAR, JOURNEY, LAW, MOST_STREETS
from lanebound.envs.journeys.town import StreetForecast, TownHour, city_hours
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import ZIGGURAT, named_generator, named_states
from lanebound.integrity.sky.availability import NO_LEVEL_M
from lanebound.integrity.sky.journeys.planner import (
    AIR_KGPM3,
    DRAG_M2,
    DRIVELINE,
    GAPS_S,
    GRAVITY,
    JOULES,
    MASS_KG,
    ROLLING,
    WEIGHT,
)
from lanebound.integrity.sky.journeys.realised import GAP_EDGES_S, RUN_EDGES, packaged_law
from lanebound.integrity.sky.journeys.streets import ACCELERATION_MPS2, BRAKING_MPS2

__all__ = ["ENTRIES", "HOUR_ENTRIES", "SCALES", "STREET_ENTRIES", "JourneyStep", "Journeys", "columns"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

SKY = "urban"  # the level of sky whose instruments the availability model and the law are fitted on
SCALES = {"time_s": 600.0, "length_m": 5000.0, "gap_s": 60.0, "level_m": 20.0, "speed_mps": 20.0}
"""Of entries; quantities beyond are shown as 1."""
ENTRIES = (
    "elapsed", "distance", "goal_sin", "goal_cos", "rtk", "usable", "level", "gap", "unusable", "predicted", "hour_sin",
    "hour_cos",
)  # fmt: skip
STREET_ENTRIES = (
    "exists", "turn_sin", "turn_cos", "speed", "length", "time", "unusable", "level_median", "level_90", "arrives",
    "aware_time", "aware_unusable", "aware_length", "fast_time", "fast_unusable", "fast_length",
    "short_time", "short_unusable", "short_length", "aware_excess", "fast_excess",
)  # fmt: skip
HOUR_ENTRIES = "time", "unusable"
COUNTED = "time_s", "energy_kwh", "unusable_s"
MOVES = one_record(
    CAR, rolling=MASS_KG * GRAVITY * ROLLING / (DRIVELINE * JOULES),
    drag=0.5 * AIR_KGPM3 * DRAG_M2 / (DRIVELINE * JOULES), acceleration_mps2=ACCELERATION_MPS2,
    braking_mps2=BRAKING_MPS2,
)  # fmt: skip


def columns(config: JourneyConfig) -> tuple[str, ...]:
    """Names of the entries of an observation."""
    names = [*ENTRIES, *(f"street{k}_{name}" for k in range(MOST_STREETS) for name in STREET_ENTRIES)]
    if config.departure is Departure.CHOOSE:
        names += ["departing", *(f"hour{k}_{name}" for k in range(len(config.hours)) for name in HOUR_ENTRIES)]
    return tuple(names)


class JourneyStep(NamedTuple):
    """What a step of N journeys brings: time [s], energy [kWh], time without a position [s]; what ended; mistakes."""

    time_s: Array
    energy_kwh: Array
    unusable_s: Array
    arrived: Flags
    late: Flags
    invalid: Flags


class Journeys:
    """N journeys.

    Parameters
    ----------
    config, count
    traced : whether the streets driven are kept, for pictures

    Attributes
    ----------
    state : (N,) JOURNEY
    ways : edges driven, of each
    action_space, observation_space : of one journey
    """

    def __init__(self, config: JourneyConfig, count: int, traced: bool = False) -> None:
        self.config, self.count = config, count
        self.state: Records = np.zeros(count, JOURNEY)
        self.state["host"] = -1  # not begun
        self._cities: dict[int, tuple[TownHour, ...]] = {}  # of the rows, so that none is built twice while in use
        self.chooses = config.departure is Departure.CHOOSE
        self.choices = MOST_STREETS + (len(config.hours) if self.chooses else 0)
        paces = len(config.speed_classes)
        self.action_space: Discrete[Any] | MultiDiscrete = (
            Discrete(self.choices) if paces == 1 else MultiDiscrete([self.choices, paces])
        )
        self.observation_space = Box(-1.0, 1.0, (len(columns(config)),), np.float32)
        self._rngs: list[np.random.Generator | None] = [None] * count
        self._sky = np.zeros((count, 4), np.uint64)
        self._full: list[FullDrive | None] = [None] * count
        self._seeds = [0] * count  # of the navigator
        self.traced, self.ways = traced, [list[int]() for _ in range(count)]
        self._running = np.zeros(count, dtype=np.bool_)
        law = packaged_law()
        self._law = one_record(
            LAW, bridged=law.bridged_table(), gap_edges_s=GAP_EDGES_S, run_edges=RUN_EDGES,
            level_edges=law.level_edges, levels=law.levels, correlation=law.correlation,
        )  # fmt: skip
        self._gaps, self._scales = np.array(GAPS_S), np.array(list(SCALES.values()))
        self._drawn, self._rest = np.empty(1), np.empty(3)

    @property
    def running(self) -> Flags:
        """Which journeys have begun and are not over, (N,)."""
        return self._running.copy()

    def seeded(self, row: int) -> bool:
        """Whether a row has a seed."""
        return self._rngs[row] is not None

    def seed(self, row: int, seed: int, sky: int | None = None) -> None:
        """Seed the journeys of a row: where and when they lead, and, with ``sky`` otherwise, what the sky does."""
        self._rngs[row] = named_generator(seed, "journeys")
        self._sky[row] = named_states([seed if sky is None else sky], "realised")[0]

    def begin(self, rows: Sequence[int], into: int | None = None) -> None:
        """Draw a journey for each row; ``into`` a city instead of the one drawn."""
        c = self.config
        for b in rows:
            rng = self._rngs[b]
            if rng is None:
                raise InputError("reset must come before everything else, got no episode: call reset() first")
            city, hour = int(rng.integers(c.cities.number)), int(rng.integers(len(c.hours)))
            share, self._seeds[b] = rng.random(), int(rng.integers(2**32))
            city = city if into is None else into
            if city not in self._cities:
                self._cities[city] = city_hours(SKY, c.map, c.cities.seed_of(city), c.hours)
            pairs = self._cities[city][0].town.pairs
            origin, goal = pairs[int(share * len(pairs))]
            self.state[b] = np.zeros((), JOURNEY)
            own = self.state[b]
            own["origin"], own["goal"], own["host"], own["edge"] = origin, goal, city, -1
            own["hour"] = -1 if self.chooses else hour
            own["level_m"] = NO_LEVEL_M  # the navigator starts facing the street that is chosen first
            self._full[b], self._running[b], self.ways[b] = None, True, []
        used = set(self.state["host"].tolist())
        self._cities = {city: hours for city, hours in self._cities.items() if city in used}

    def at(self, row: int) -> TownHour:
        """City and hour of a row; the first hour where none is chosen yet."""
        own = self.state[row]
        if own["host"] < 0:
            raise InputError("reset must come before everything else, got no episode: call reset() first")
        return self._cities[int(own["host"])][max(int(own["hour"]), 0)]

    def _groups(self, rows: Ints) -> Iterator[tuple[TownHour, Ints]]:
        """Rows that have begun, by city and hour."""
        rows = rows[self.state["host"][rows] >= 0]
        keys = self.state["host"][rows] * len(self.config.hours) + np.maximum(self.state["hour"][rows], 0)
        order = np.argsort(keys, kind="stable")
        for own in np.split(rows[order], np.flatnonzero(np.diff(keys[order])) + 1):
            if own.size:
                yield self.at(int(own[0])), own

    # Actions

    def masks(self) -> Flags:
        """Which first parts of an action are valid, (N, choices)."""
        out = np.zeros((self.count, self.choices), dtype=np.bool_)
        for at, rows in self._groups(np.arange(self.count)):
            edge, origin = self.state["edge"][rows], self.state["origin"][rows]
            options = np.where((edge < 0)[:, None], at.town.origins[origin], at.town.edges["options"][edge])
            out[rows, :MOST_STREETS] = options >= 0
        departing = (self.state["hour"] < 0) & (self.state["host"] >= 0)
        out[departing, :MOST_STREETS], out[departing, MOST_STREETS:] = False, True
        return out

    def action_masks(self) -> Flags:
        """As :meth:`masks`, with a part for speed classes, which are all valid: (N, choices + speed classes)."""
        masks, paces = self.masks(), len(self.config.speed_classes)
        return masks if paces == 1 else np.concatenate([masks, np.ones((self.count, paces), dtype=np.bool_)], 1)

    def _valid(self, choice: Ints) -> tuple[Ints, Flags]:
        """Choices with the nearest valid one in place of one that is not, and whether it was not."""
        masks = self.masks()
        away = np.where(masks, np.abs(np.arange(self.choices) - choice[:, None]), self.choices + 1)
        found = away.argmin(1)
        return found, found != choice

    # Steps

    def step(self, actions: NDArray[Any], active: Flags) -> JourneyStep:
        """Carry out an action of each active journey: an hour of departure, or the street to the next junction.

        Raises
        ------
        InputError
            An action lies outside of the action space.
        """
        space = self.action_space
        given = np.asarray(actions)
        shape = (self.count, *(space.shape or ()))
        if given.shape != shape or given.dtype.kind not in "iu":
            raise InputError(f"actions must be integers {shape}, got {given.dtype} {given.shape}: see action_space")
        given = given.astype(np.int64)
        top = np.array([self.choices, len(self.config.speed_classes)])[: 2 if given.ndim == 2 else 1]
        if ((given[active] < 0) | (given[active] >= top)).any():
            raise InputError(f"actions must lie in {space}, got {given[active].tolist()}: choose one in it")
        first, pace = (given, np.zeros_like(given)) if given.ndim == 1 else (given[:, 0], given[:, 1])
        choice, invalid = self._valid(first)
        before = {name: self.state[name].copy() for name in COUNTED}
        departing = active & (self.state["hour"] < 0)
        self.state["hour"][departing] = choice[departing] - MOST_STREETS
        rows = np.flatnonzero(active & ~departing)
        self._drive(rows, choice, np.array(self.config.speed_classes)[pace])
        arrived = active & (self.state["arrived"] == 1)
        late = active & ~arrived & (self.state["time_s"] > self.config.duration_s)
        self._running &= ~(arrived | late)
        time_s, energy, unusable = (np.where(active, self.state[name] - before[name], 0.0) for name in COUNTED)
        return JourneyStep(time_s, energy, unusable, arrived, late, invalid & active)

    def _drive(self, rows: Ints, choice: Ints, paces: Array) -> None:
        for at, own in self._groups(rows):
            full = self.config.realised is Realised.FULL
            for b in own.tolist() if full or self.traced else ():
                streets = self._streets(b, at, int(choice[b]))
                self.ways[b] += streets
                if full:
                    self._drive_full(b, at, streets, float(paces[b]))
            if full:
                continue
            town = at.town
            drive_rows(
                own, choice, paces, self.state, self._sky, self._drawn, ZIGGURAT, town.origins, town.goals, town.edges,
                at.stations, at.mapped.ahead, self._gaps, self._law, MOVES,
            )  # fmt: skip

    def _streets(self, b: int, at: TownHour, choice: int) -> list[int]:
        """The streets of a choice to the next junction with a choice, as the kernel takes them."""
        town, own = at.town, self.state[b]
        edge, goals = int(own["edge"]), set(town.goals[own["goal"]].tolist())
        options = town.origins[own["origin"]] if edge < 0 else town.edges["options"][edge]
        chosen = [int(options[choice])]
        while chosen[-1] not in goals and (only := int(only_option(town.edges["options"][chosen[-1]]))) >= 0:
            chosen.append(int(town.edges["options"][chosen[-1]][only]))
        return chosen

    def _drive_full(self, b: int, at: TownHour, chosen: list[int], pace: float) -> None:
        """The same decisions under the navigator."""
        own = self.state[b : b + 1]
        ends = chosen[-1] in at.town.goals[own["goal"][0]]
        drive = self._full[b]
        if drive is None:
            drive = self._full[b] = FullDrive(at, self._seeds[b], self.config.duration_s, MOVES)
        own["arrived"] = drive.drive(chosen, pace, ends, own) and ends
        own["edge"] = chosen[-1]

    # Observations

    def observe(self, oracle: bool = False) -> NDArray[np.float32]:
        """The observations, (N, n); as an ``oracle`` would have them, with the forecast by the true city."""
        out = np.zeros((self.count, *self.observation_space.shape), np.float32)
        for at, rows in self._groups(np.arange(self.count)):
            self._observe(at, rows, at.oracle if oracle else at.mapped, out)
        departing = np.flatnonzero((self.state["hour"] < 0) & (self.state["host"] >= 0))
        if departing.size:
            self._preview(departing, oracle, out)
        return out

    def oracle_observation(self) -> NDArray[np.float32]:
        """The observations with a forecast by the true city in place of the map, for drivers to compare with."""
        return self.observe(oracle=True)

    def _observe(self, at: TownHour, rows: Ints, seen: StreetForecast, out: NDArray[np.float32]) -> None:
        town = at.town
        observe_rows(
            rows, self.state, town.places, town.origins, town.goals, town.edges, seen.ahead, self._gaps, *seen[1:],
            self._scales, at.hour, WEIGHT, self._rest, out,
        )  # fmt: skip

    def _preview(self, rows: Ints, oracle: bool, out: NDArray[np.float32]) -> None:
        """What the integrity-aware route would have at each hour, in place of streets."""
        first = HERE + MOST_STREETS * STREET
        out[rows, HERE - 2 : first], out[rows, first] = 0.0, 1.0
        for city in np.unique(self.state["host"][rows]).tolist():
            own = rows[self.state["host"][rows] == city]
            for k, at in enumerate(self._cities[city]):
                seen, town = at.oracle if oracle else at.mapped, at.town
                preview_rows(
                    own, self.state, town.origins, town.goals, town.edges, seen.ahead, WEIGHT, *seen[1:],
                    SCALES["time_s"], first + 1 + len(HOUR_ENTRIES) * k, self._rest, out,
                )  # fmt: skip
