"""N episodes of one configuration: beliefs of the egos, perceived vehicles, scores and observations.

The same code serves a single environment, which is one row, and the vector engine. The wrapped world moves the cars
(highway-env or compiled traffic), writes their poses into ``cars`` and says in ``ego.facts`` how a step ended; all else
is here:

1. :meth:`Episodes.begin` at a start: navigation on its approach, first belief, first picture of the traffic;
2. :meth:`Episodes.coast` or :meth:`Episodes.navigate` after each simulation step: the belief follows;
3. :meth:`Episodes.finish` after each policy step: scores, costs, rewards, and the frame of the observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch import rows_kernel as rk
from lanebound.envs.batch import view_kernel as vk
from lanebound.envs.batch.lanes import LaneTable
from lanebound.envs.batch.lanes_kernel import NONE
from lanebound.envs.batch.navigation import NavigationBatch, Starts, fixes_of
from lanebound.envs.batch.perception import PerceptionBatch, perceives
from lanebound.envs.batch.records_kernel import BELIEF, COMMAND, FACTS, OUTCOME, SCORE, TRACK, Cars, Ego
from lanebound.envs.batch.route_map import Reach, Routes
from lanebound.envs.batch.route_map_kernel import RouteMap
from lanebound.envs.config import EnvConfig
from lanebound.envs.observation.index import Observed, entries, sources_of
from lanebound.integrity.core.accel import call_links, run_rows
from lanebound.integrity.core.bundle_kernel import Bundle
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records

__all__ = ["Episodes", "empty_cars", "reach_of"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
SHOWN = {"full": vk.FULL, "clock": vk.BLIND, "blind": vk.BLIND, "oracle": vk.ORACLE}
EPS_S = 1e-6  # a window of 1 s holds ten steps of 0.1 s, whatever they sum to
EPOCH_US, FINISH_US = 6.0, 5.0  # of one thread for an environment, measured


def empty_cars(count: int, vehicles: int) -> Cars:
    """N environments without vehicles."""
    shape = count, vehicles
    numbers: list[Any] = [np.zeros(shape) for _ in range(6)]
    wholes: list[Any] = [np.zeros(shape, dtype=np.int64) for _ in range(2)]
    none: list[Any] = [np.full(shape, NONE, dtype=np.int64) for _ in range(2)]
    return Cars(np.zeros(count, dtype=np.int64), *[*numbers, *wholes, *none])


def reach_of(config: EnvConfig) -> Reach:
    """How far paths are looked up for the observations of a configuration."""
    o = config.observation
    return Reach(o.range_m, max(o.range_m, *o.preview_m, 0.0), max(o.satellites_m, default=0.0))


class Episodes:
    """N episodes.

    Parameters
    ----------
    config : of the environments
    rules : its record, see :func:`.rules.rules_of`
    routes : paths over the road network, which all episodes share
    cars : the vehicles (N, V), moved elsewhere
    navigation : of what is sensed, None where nothing is
    perception : of the traffic

    Attributes
    ----------
    ego : the records of the egos
    tracks : (N,) TRACK where the egos' positions are sensed, else None
    sky : (N, 3 D) satellites predicted ahead, negative for unknown
    frame : (N, E) float32, the newest observations
    epoch_steps : simulation steps in an epoch; None where all steps are alike: nothing is sensed, no position is off
    """

    def __init__(
        self,
        config: EnvConfig,
        rules: Records,
        routes: Routes,
        cars: Cars,
        navigation: NavigationBatch | None,
        perception: PerceptionBatch,
    ) -> None:
        self.config, self.rules, self.routes = config, rules, routes
        self.cars, self.navigation, self.perception = cars, navigation, perception
        o, n = config.observation, cars.present.size
        self.path_of: Rows = np.arange(len(routes.table.index))
        self.index = entries(o)
        self._sources = sources_of(self.index)
        self._extra = [(place, entry) for place, entry in enumerate(self.index) if callable(entry.source)]
        truth = config.perception.source == "truth"
        self._shown = SHOWN[o.integrity], int(truth)
        belief: Records = np.zeros(n, BELIEF)
        shown = np.zeros(n, BELIEF) if o.integrity == "oracle" else belief
        records: list[Records] = [np.zeros(n, kind) for kind in (COMMAND, SCORE, FACTS, OUTCOME)]
        self.ego = Ego(belief, *[*records, shown])
        self.tracks: Records | None = np.zeros(n, TRACK) if config.navigation.source.uses_sensors else None
        self._forecasts = self.tracks is not None and bool(o.satellites_m)
        self.sky = np.full((n, 3 * len(o.satellites_m)), -1.0)
        trail = 1 + int(np.ceil((o.trend_window_s - EPS_S) * config.policy_hz))
        self.views = vk.Views(
            own=np.zeros(n, vk.VIEW),
            preview=np.zeros((n, len(o.preview_m)), vk.AHEAD),
            vehicles=np.zeros((n, o.vehicles), vk.BESIDE),
            distances=np.array(o.preview_m, dtype=np.float64),
            trail=np.zeros((n, trail, 2)),
        )
        self.frame = np.zeros((n, len(self.index)), dtype=np.float32)
        self._words = self._all_words()
        self._bundle: tuple[Bundle, RouteMap] | None = None
        exact = not (rules["offset_at_m"][0] or rules["offset_ct_m"][0])
        alike = exact and navigation is None and not perceives(config.perception)
        self.epoch_steps = None if alike else config.navigation.steps_per_epoch(config.simulation_hz)

    def _all_words(self) -> vk.Words:
        """The memory of the records that observations come from."""
        shown, v = self.ego.shown, self.views
        whole = shown.view(np.int64).reshape(shown.size, -1)
        return vk.Words(_words(shown), whole, _words(v.own), _words(v.preview), self.sky, _words(v.vehicles))

    def __getstate__(self) -> dict[str, Any]:
        """Everything but what holds addresses, or the memory of other arrays."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_bundle", "_words")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _bundle=None)
        self._words = self._all_words()

    @property
    def table(self) -> LaneTable:
        """The lanes of the road network."""
        return self.routes.table

    @property
    def batch(self) -> Records:
        """The episodes as kernels take them, with the paths found so far."""
        if self._bundle is None or self._bundle[1] is not self.routes.map:
            arrays = rk.Batch(
                self.cars, self.ego, self.perception.pictures, self.views, self._words, self._sources, self.frame,
                self.rules, self.table.lanes, self.routes.map, self.path_of, *self._shown,
            )  # fmt: skip
            self._bundle = Bundle(arrays), self.routes.map
        return self._bundle[0].handle

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Those that have a row for each environment, but for what navigates."""
        shown = () if self.ego.shown is self.ego.belief else (self.ego.shown,)
        tracks = () if self.tracks is None else (self.tracks,)
        views = self.views.own, self.views.preview, self.views.vehicles, self.views.trail
        known = (*self.cars, *self.ego[:-1], *shown, *tracks, *views, self.sky, self.frame)
        return tuple(array for array in (*known, *self.perception.arrays) if array.size)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays that have a row for each environment."""
        size = sum(array.nbytes for array in self.arrays)
        return size + (0 if self.navigation is None else self.navigation.nbytes)

    def another(self, count: int) -> Episodes:
        """``count`` episodes of the same configuration, before any start."""
        cars = empty_cars(count, self.cars.x.shape[1])
        navigation = None if self.navigation is None else self.navigation.another(count)
        return Episodes(self.config, self.rules, self.routes, cars, navigation, self.perception.another(count))

    @property
    def times_s(self) -> Array:
        """(N,) time of the last epoch of each episode."""
        if self.navigation is not None:
            return self.navigation.time_s
        steps = self.config.navigation.steps_per_epoch(self.config.simulation_hz)
        return np.asarray(self.ego.score["steps"] // steps * float(self.rules["epoch_s"][0]), dtype=np.float64)

    def adopt(self, rows: Rows, other: Episodes, theirs: Rows) -> None:
        """Go on in ``rows`` with navigators and draws of others' episodes ``theirs``, whose arrays have been copied."""
        if self.navigation is not None and other.navigation is not None:
            self.navigation.adopt(rows, other.navigation, theirs)
        self.perception.adopt(rows, other.perception, theirs)

    # Starts

    def begin(self, rows: Rows, seeds: Sequence[int], starts: Starts | None, there: NDArray[np.bool_]) -> None:
        """Begin episodes with the cars where they are, after an approach of those that navigate.

        starts: what the seeds draw for navigation; there (n, C): slots of others for which is drawn.
        """
        approach = None
        for records in (*self.ego[:-1], *([] if self.tracks is None else [self.tracks])):
            _words(records)[rows] = 0.0
        self.ego.belief["target_lane"][rows] = self.cars.lane[rows, 0]
        local, navigation = np.arange(rows.size), self.navigation
        if navigation is not None and starts is not None:
            crew = there[:, : navigation.vehicles - 1]
            approach = navigation.begin(rows, seeds, starts, self.cars, crew)
        if self.tracks is None or approach is None or navigation is None or starts is None:
            rk.give_rows(0, rows.size, rows, self.batch, 0.0)
        else:
            at, fixes = local * navigation.vehicles, fixes_of(approach.solution)
            shift = self.config.navigation.map_sigma_m * starts.map_shift
            rk.begin_rows(0, rows.size, rows, at, fixes, shift, self.tracks, self.batch)
        self.perception.begin(rows, seeds, there, self.cars)
        if perceives(self.config.perception):
            heard = [(0.0, None)] if approach is None else approach.heard
            for time_s, solution in heard:
                self._perceive(rows, local, np.full(rows.size, time_s), solution)
        if navigation is not None:
            kernel, arguments = navigation.sky_link(rows)
            run_rows(kernel, rows.size, *arguments, row_us=EPOCH_US)

    def _perceive(self, rows: Rows, local: Rows, time_s: Array, solution: Any) -> None:
        fixes = None if solution is None else fixes_of(solution)
        at = local * self.navigation.vehicles if self.navigation is not None else local
        links = self.perception.links(rows, at, time_s, fixes, self.batch)
        run_rows(call_links, rows.size, links, row_us=EPOCH_US)

    def replace_cars(self, cars: Cars) -> None:
        """Other vehicles in place of those there have been, perhaps more of them."""
        self.cars, self._bundle = cars, None
        self.perception.make_room(cars.x.shape[1])

    # Steps

    def coast_links(self, rows: Rows) -> list[Any]:
        """A simulation step has passed that ends no navigation epoch."""
        if self.navigation is None:
            return []
        return [self.navigation.coast_link(rows, self.batch, self.tracks)]

    def give_links(self, rows: Rows) -> list[Any]:
        """A simulation step has passed for egos whose positions are given."""
        if self.tracks is not None:
            return []
        return [(rk.give_rows, (rows, self.batch, float(self.rules["step_s"][0])))]

    def epoch_links(self, rows: Rows, fixes: Records | None, time_s: Array, lies: Array | None = None) -> list[Any]:
        """An epoch has been measured: the beliefs take its solutions over, and traffic is perceived."""
        at, batch = rows if self.navigation is None else self.navigation.at(rows), self.batch
        out: list[Any] = []
        if self.tracks is not None and fixes is not None:
            out.append((rk.take_rows, (rows, at, fixes, self.tracks, batch)))
        out.append((rk.count_rows, (rows, batch)))
        return out + self.perception.links(rows, at, time_s, fixes, batch, lies)

    def finish_links(self, rows: Rows, start: bool) -> list[Any]:
        """A policy step is over, or an episode begins: score it, and fill the frames."""
        batch = self.batch
        out: list[Any] = [(rk.locate_rows, (rows, batch))]
        if self._forecasts and self.navigation is not None:
            out.append((rk.predict_rows, (rows, batch, self.navigation.sensed.handle)))
        out.append((rk.finish_rows, (rows, batch, start)))
        return out

    def fill_extra(self, rows: Rows) -> None:
        """Fill the entries whose sources are functions."""
        if not self._extra:
            return
        v = self.views
        observed = Observed(self.ego.shown[rows], v.own[rows], v.preview[rows], self.sky[rows], v.vehicles[rows])
        for place, entry in self._extra:
            if callable(entry.source):
                value = np.asarray(entry.source(observed), dtype=np.float64)
                if value.shape != observed.belief.shape:
                    raise InputError(
                        f"source of entry {entry.column} must return one number for each environment, shape "
                        f"{observed.belief.shape}, got shape {value.shape}: return an array of that shape"
                    )
                self.frame[rows, place] = np.clip(value / entry.scale, entry.low, entry.high)


def _words(records: Records) -> Array:
    """The memory of records (N, ...) of numbers as (N, words)."""
    count = records.shape[0]
    return records.reshape(count, -1).view(np.float64).reshape(count, -1) if records.size else np.zeros((count, 0))
