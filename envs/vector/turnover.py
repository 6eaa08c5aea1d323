"""Vehicles that leave the environments of an engine and enter them, between policy steps.

What :class:`..seats.Seats` does for the vehicles of a single environment: slots are taken and left in the same order,
and everything is drawn from the same streams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.episodes import Episodes
from lanebound.envs.batch.lanes_kernel import NONE, local
from lanebound.envs.batch.navigation import FLEET_STARTS, Starts, fleet_generator
from lanebound.envs.batch.next_lane_kernel import route_onward
from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M
from lanebound.envs.worlds.seating import close_up
from lanebound.envs.worlds.wander import moved_aside
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

if TYPE_CHECKING:
    from lanebound.envs.vector.engine import Engine

__all__ = ["Turnover"]

Rows = NDArray[np.int64]
LEAVES_M = 20.0  # before the end of an exit: four lengths of a vehicle, IntersectionEnv._clear_vehicles


@jit(borrows=True)
def find_leaving(rows, cars, egos, lanes, exits, leaving):  # type: ignore[no-untyped-def]
    """Fill ``leaving`` (N, V): others near the end of a lane of ``exits`` (bits).  -> whether there are any"""
    some = False
    for e in rows:
        for i in range(1, egos[e].vehicles):
            n = cars[e, i].lane
            if (exits >> n) & 1 != 0:
                s, _, _ = local(lanes, n, cars[e, i].x, cars[e, i].y)
                leaving[e, i] = s >= lanes.table[n].length_m - LEAVES_M
                some = some or leaving[e, i]
    return some


@dataclass
class _Crew:
    """Vehicles of the episode of one environment.

    rng : generator of the world
    seeds : of the episode and of the others' instruments
    began : others at the start
    free, taken : slots, the next one to be taken last, and in the order in which they have been taken
    named : names that have been given
    """

    rng: np.random.Generator
    seeds: tuple[int, int]
    began: int
    free: list[int]
    taken: list[int]
    named: int
    entered: int = 0
    _streams: dict[str, np.random.Generator] = field(default_factory=dict)

    def of_lines(self, wander: Any) -> np.random.Generator:
        """The generator of the lines of drivers, after those that were there at the start."""
        if "wander" not in self._streams:
            self._streams["wander"] = wander.generator(self.seeds[0])
            wander.weights(self._streams["wander"], self.began)
        return self._streams["wander"]

    def of_fleet(self) -> np.random.Generator:
        """The generator of first positions, after what the starts have drawn."""
        if "fleet" not in self._streams:
            self._streams["fleet"] = fleet_generator(self.seeds[1])
            if self.began:
                self._streams["fleet"].standard_normal((FLEET_STARTS, len(self.free) + len(self.taken), 3))
        return self._streams["fleet"]


class Turnover:
    """The coming and going in the episodes of a stage; nothing happens in worlds that no vehicle enters."""

    def __init__(self, engine: Engine, episodes: Episodes) -> None:
        self.engine, self.episodes = engine, episodes
        self._crews: list[_Crew | None] = [None] * len(episodes.cars)

    def begin(
        self, rows: Rows, generators: Sequence[np.random.Generator], seeds: Sequence[int], starts: Starts | None
    ) -> None:
        """Episodes have begun."""
        if not self.engine.newcomers:
            return
        fleet = [0] * rows.size if starts is None else starts.fleet_seed.tolist()
        others = (self.episodes.ego["vehicles"][rows] - 1).tolist()
        for row, rng, seed, of_fleet, began in zip(rows.tolist(), generators, seeds, fleet, others, strict=True):
            slots = min(self.engine.single.config.slots, began + self.engine.newcomers)
            free = list(range(began, slots))[::-1]
            self._crews[row] = _Crew(rng, (seed, of_fleet), began, free, list(range(began)), 1 + began)

    def adopt(self, rows: Rows, other: Turnover, theirs: Rows) -> None:
        """Continue in ``rows`` with the episodes ``theirs`` of another stage."""
        for row, their in zip(rows.tolist(), theirs.tolist(), strict=True):
            self._crews[row] = other._crews[their]

    def step(self, drivers: Records, rows: Rows) -> None:
        """Let vehicles leave and enter after a policy step."""
        e, entrance = self.episodes, self.engine.entrance
        leaving = np.zeros(e.cars.shape, dtype=np.bool_)
        some = find_leaving(rows, e.cars, e.ego, e.table.lanes, self.engine.world["exits"][0], leaving)
        for row in rows.tolist():
            crew, count = self._crews[row], int(e.ego["vehicles"][row])
            assert crew is not None
            assert entrance is not None
            gone = leaving[row, :count]
            if left := bool(some and gone.any()):
                count = self._leave(row, crew, drivers[row], gone)
            after = entrance(crew.rng, e.cars[row], drivers[row], count)
            if after > count:
                self._enter(row, crew, drivers[row], count)
            if left or after > count:
                self._take_slots(row, crew, after)

    def _leave(self, row: int, crew: _Crew, drivers: Records, gone: NDArray[np.bool_]) -> int:
        """Free the slots of vehicles that leave; the others move up."""
        e = self.episodes
        freed = {int(slot) for slot in e.cars["slot"][row, : gone.size][gone]}
        crew.free += [slot for slot in crew.taken if slot in freed]
        crew.taken = [slot for slot in crew.taken if slot not in freed]
        e.ego["place"][row] -= int(gone[1 : int(e.ego["place"][row]) + 1].sum())
        count = close_up(e.cars[row], drivers, ~gone)
        e.cars["slot"][row, count : gone.size] = NONE
        e.ego["vehicles"][row] = count
        return count

    def _enter(self, row: int, crew: _Crew, drivers: Records, i: int) -> None:
        """Put the vehicle that has entered on its line."""
        e, wander = self.episodes, self.engine.single.config.wander
        car, driver = e.cars[row, i], drivers[i]
        x, y, heading = float(car["x"]), float(car["y"]), float(car["heading"])
        if wander.wanders:
            line = 0.0
            driver["wander"] = wander.weights(crew.of_lines(wander), 1)[0]
            for factor, weight in zip(self.engine.wander[0].tolist(), driver["wander"].tolist(), strict=True):
                line += factor * weight  # in the order of the kernel
            driver["aside"] = min(max(line, -WANDER_MOST_M), WANDER_MOST_M)
            car["x"], car["y"] = moved_aside(x, y, heading, float(driver["aside"]))
        driver["cos"], driver["sin"] = np.cos(heading), np.sin(heading)
        driver["entered"] = e.ego["score"]["steps"][row]
        lanes, routes = e.table.lanes, self.engine.plans.steps
        car["onward"] = route_onward(lanes, routes, int(driver["route"]), int(car["lane"]))
        e.ego["vehicles"][row] = i + 1

    def _take_slots(self, row: int, crew: _Crew, count: int) -> None:
        """Give slots to vehicles without one, as far as there are any."""
        e = self.episodes
        cars, navigation = e.cars[row], e.navigation
        fresh = np.flatnonzero(cars["slot"][1:count] == NONE)[: len(crew.free)] + 1
        for i in fresh.tolist():
            slot = crew.free.pop()
            cars["slot"][i] = slot
            crew.taken.append(slot)
            e.perception.enter(row, slot, crew.named, float(cars["length"][i]), float(cars["width"][i]))
            crew.named += 1
        if fresh.size and navigation is not None and navigation.vehicles > 1:
            slots, position = cars["slot"][fresh], np.stack([cars["x"][fresh], cars["y"][fresh]], axis=-1)
            capacity = len(crew.free) + len(crew.taken)
            noise = crew.of_fleet().standard_normal((capacity, 3))[slots]
            passed = navigation.steps - 1
            navigation.enter(row, slots, position, cars["heading"][fresh], cars["speed"][fresh], passed, noise)
