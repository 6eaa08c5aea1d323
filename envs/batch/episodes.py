"""N episodes of one configuration: beliefs of the egos, perceived vehicles, scores and observations.

The same code serves a single environment, which is one row, and the vector engine. The wrapped world drives the cars
(highway-env or compiled traffic), writes their poses into ``cars`` and says in ``facts`` of ``ego`` how a step ended;
all else is here:

1. :meth:`Episodes.begin` at a start: navigation on its approach, first belief, first picture of the traffic;
2. after each simulation step the belief is carried on (:func:`.rows_kernel.carry_on`);
3. after each epoch :meth:`Episodes.sense`, :meth:`Episodes.locate` and :meth:`Episodes.perceive`;
4. after each policy step :meth:`Episodes.score_and_observe`.
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
from lanebound.envs.batch.motion_kernel import MOTION
from lanebound.envs.batch.navigation import NavigationBatch, Starts, heard_at
from lanebound.envs.batch.perception import PerceptionBatch, perceives
from lanebound.envs.batch.records_kernel import CAR, EGO
from lanebound.envs.batch.route_map import Reach, Routes
from lanebound.envs.config import EnvConfig
from lanebound.envs.info import EXCLUSION_INFO, info_entries, own_info
from lanebound.envs.observation.index import Observed, Source, entries, sources_of
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_states

__all__ = ["Episodes", "copy_rows", "empty_cars", "reach_of"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
RESTARTED = "belief", "eye", "camera", "track", "command", "score", "facts", "outcome"
"""Parts of EGO that a start clears."""
EPS_S = 1e-6  # a window of 1 s holds ten steps of 0.1 s, whatever they sum to
TAKE_US, CONCLUDE_US = 0.5, 5.0  # of one thread for an environment, measured


def empty_cars(count: int, vehicles: int) -> Records:
    """(N, V) CAR: environments without vehicles."""
    cars = np.zeros((count, vehicles), CAR)
    cars["slot"] = cars["onward"] = NONE
    return cars


def copy_rows(arrays: Sequence[NDArray[Any]], rows: Rows, others: Sequence[NDArray[Any]], theirs: Rows) -> None:
    """Copy rows ``theirs`` of arrays to ``rows`` of arrays of the same types and shapes."""
    for array, other in zip(arrays, others, strict=True):
        _words(array, np.uint8)[rows] = _words(other, np.uint8)[theirs]


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
    cars : the vehicles (N, V) CAR, moved elsewhere
    navigation : of what is sensed, None where nothing is
    perception : of the traffic

    Attributes
    ----------
    ego : (N,) EGO
    path_of : (Q, L) row of the path from each lane, by ``ego["route"]``
    views : what observations are derived of
    frame : (N, E) float32, the newest observations
    own_info : (N,) each, the newest numbers of ``info`` that not all environments have, by name
    epoch_steps : simulation steps in an epoch; None with perfect positions and without sensing: there are no epochs
    """

    def __init__(
        self,
        config: EnvConfig,
        rules: Records,
        routes: Routes,
        cars: Records,
        navigation: NavigationBatch | None,
        perception: PerceptionBatch,
    ) -> None:
        self.config, self.rules, self.routes = config, rules, routes
        self.cars, self.navigation, self.perception = cars, navigation, perception
        o, n = config.observation, len(cars)
        self.path_of: Rows = np.arange(len(routes.table.index))[None]
        self.index = entries(o)
        self._sources = sources_of(self.index)
        self._extra = [(place, entry) for place, entry in enumerate(self.index) if callable(entry.source)]
        self._info_entries = info_entries()
        self.own_info: dict[str, Array] = {name: np.zeros(n) for name in own_info(config)}
        self.ego: Records = np.zeros(n, EGO)
        self.motions: Records = np.zeros((n, 0), MOTION) if navigation is None else navigation.motions
        self._sensed = config.navigation.source.uses_sensors
        trail = 1 + int(np.ceil((o.trend_window_s - EPS_S) * config.policy_hz))
        self.views = vk.Views(
            preview=np.zeros((n, len(o.preview_m)), vk.AHEAD),
            vehicles=np.zeros((n, o.vehicles), vk.BESIDE),
            sky=np.full((n, 3 * len(o.satellites_m)), -1.0),
            trail=np.zeros((n, trail, 2)),
            distances=np.array(o.preview_m, dtype=np.float64),
        )
        self.frame = np.zeros((n, len(self.index)), dtype=np.float32)
        exact = not (rules["offset_at_m"][0] or rules["offset_ct_m"][0])
        alike = exact and navigation is None and not (perceives(config.perception) or o.closure)
        self.epoch_steps = None if alike else config.navigation.steps_per_epoch(config.simulation_hz)

    @property
    def table(self) -> LaneTable:
        """The lanes of the road network."""
        return self.routes.table

    @property
    def ego_is_sensed(self) -> bool:
        """Whether the positions of the egos are sensed, not given."""
        return self._sensed

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Those that have a row for each environment, but for what navigates."""
        views = self.views.preview, self.views.vehicles, self.views.sky, self.views.trail
        return self.cars, self.ego, *views, self.frame, *self.own_info.values(), *self.perception.arrays

    @property
    def nbytes(self) -> int:
        """Memory of the arrays that have a row for each environment."""
        size = sum(array.nbytes for array in self.arrays)
        return size + (0 if self.navigation is None else self.navigation.nbytes)

    def another(self, count: int) -> Episodes:
        """``count`` episodes of the same configuration, before any start."""
        cars = empty_cars(count, self.cars.shape[1])
        navigation = None if self.navigation is None else self.navigation.another(count)
        other = Episodes(self.config, self.rules, self.routes, cars, navigation, self.perception.another(count))
        other.path_of = self.path_of
        return other

    @property
    def times_s(self) -> Array:
        """(N,) time of the last epoch of each episode."""
        if self.navigation is not None:
            return self.navigation.time_s
        steps = self.config.navigation.steps_per_epoch(self.config.simulation_hz)
        return np.asarray(self.ego["score"]["steps"] // steps * float(self.rules["epoch_s"][0]), dtype=np.float64)

    def adopt(self, rows: Rows, other: Episodes, theirs: Rows) -> None:
        """Go on in ``rows`` with others' episodes ``theirs``."""
        copy_rows(self.arrays, rows, other.arrays, theirs)
        if self.navigation is not None and other.navigation is not None:
            self.navigation.adopt(rows, other.navigation, theirs)
        self.perception.adopt(rows, other.perception, theirs)

    # Starts

    def begin(self, rows: Rows, seeds: Sequence[int], starts: Starts | None, there: NDArray[np.bool_]) -> None:
        """Begin episodes with the cars where they are, after an approach of those that navigate.

        starts: what the seeds draw for navigation; there (n, C): slots of others for which is drawn.
        """
        for name in RESTARTED:
            self.ego[name][rows] = np.zeros((), EGO[name])
        self.ego["belief"]["target_lane"][rows] = self.cars["lane"][rows, 0]
        approach, local, navigation = None, np.arange(rows.size), self.navigation
        if navigation is not None and starts is not None:
            crew = there[:, : navigation.vehicles - 1]
            approach = navigation.begin(rows, seeds, starts, self.cars, crew)
            local *= navigation.vehicles
        lanes, rules = self.table.lanes, self.rules
        if self.config.lane_sensor is not None:
            rk.open_rows(0, rows.size, rows, self.cars, self.ego, named_states(seeds, "lane_sensor"), lanes, rules)
        if self._sensed and approach is not None and starts is not None:
            fixes, shift = approach.fixes, self.config.navigation.map_sigma_m * starts.map_shift
            rk.begin_rows(0, rows.size, rows, local, fixes, shift, self.ego, lanes, rules)
        else:
            rk.give_rows(0, rows.size, rows, self.cars, self.ego, lanes, rules)
        self.perception.begin(rows, seeds, there, self.cars)
        heard = [(0.0, None)] if approach is None else approach.heard
        if self.perception.recordings is not None:
            epoch_s = float(rules["epoch_s"][0])
            heard = [(time_s, None) for time_s in heard_at(epoch_s, self.config.navigation.epochs_before(epoch_s))]
        for time_s, of_all in heard if perceives(self.config.perception) else ():
            self.perception.perceive(rows, local, np.full(rows.size, time_s), of_all, self.cars, self.ego)

    def replace_cars(self, cars: Records) -> None:
        """Other vehicles in place of those there have been, perhaps more of them."""
        self.cars = cars
        self.perception.make_room(cars.shape[1])

    # Steps

    def carry_on(self, rows: Rows, ends_epoch: bool) -> None:
        """A simulation step has passed."""
        lanes, motions = self.table.lanes, self.motions
        rk.carry_rows(0, rows.size, rows, self.cars, self.ego, motions, lanes, self.rules, ends_epoch)

    def sense(self, rows: Rows) -> None:
        """Measure the epoch that ends now."""
        if self.navigation is not None:
            self.navigation.sense(rows, self.cars, self.ego)

    def locate(self, rows: Rows) -> None:
        """Solve the epoch, and take the solutions of the egos over into their beliefs."""
        if self.navigation is not None:
            self.navigation.locate()
            if self._sensed:
                at, fixes = self.navigation.at(rows), self.navigation.fixes
                run_rows(
                    rk.take_rows, rows.size, rows, at, fixes, self.ego, self.table.lanes, self.rules, row_us=TAKE_US
                )
        self.count_epoch(rows)

    def count_epoch(self, rows: Rows) -> None:
        """Count an epoch for the scores, misleading or not."""
        rk.count_rows(0, rows.size, rows, self.cars, self.ego)

    def perceive(self, rows: Rows, time_s: Array) -> None:
        """Perceive the traffic at the end of an epoch; time_s (n,) of the episodes."""
        n = self.navigation
        at, fixes, lies = (rows, None, None) if n is None else (n.at(rows), n.fixes, n.lies)
        self.perception.perceive(rows, at, time_s, fixes, self.cars, self.ego, lies)
        if self.config.observation.closure:
            rk.receive_rows(0, rows.size, rows, self.cars, self.ego, self.perception.pictures.of_radio, time_s)

    def score_and_observe(self, rows: Rows, start: bool) -> None:
        """Score a policy step, or a start, find what is shown of the egos, and fill the frames."""
        p, n, ahead = self.perception.pictures, self.navigation, None
        if n is not None and self._sensed and self.views.sky.size:
            ahead = n.ahead
        run_rows(
            rk.conclude_rows, rows.size, rows, self.cars, self.ego, p.picture, p.perceived, self.path_of,
            self.table.lanes, self.routes.map, self.rules, self.views, ahead, self._sources, self.frame, start,
            row_us=CONCLUDE_US,
        )  # fmt: skip
        if self.perception.has_ranges:
            for name, field in zip(EXCLUSION_INFO, ("excluded", "reason"), strict=True):
                self.own_info[name][rows] = p.picture[field][rows]
        if self._extra or self._info_entries:
            self._fill_extra(rows)

    def _fill_extra(self, rows: Rows) -> None:
        """Fill the entries of observations and infos whose sources are functions."""
        v, e = self.views, self.ego[rows]
        observed = Observed(e["shown"], e["own"], v.preview[rows], v.sky[rows], v.vehicles[rows], self._states(rows))
        for place, entry in self._extra:
            value = _taken(f"entry {entry.column}", entry.source, observed)
            self.frame[rows, place] = np.clip(value / entry.scale, entry.low, entry.high)
        for extra in self._info_entries:
            self.own_info[extra.name][rows] = _taken(f"info.{extra.name}", extra.source, observed)

    def _states(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """The states (n,) of plug-in stages and modes of the egos."""
        navigation = self.navigation
        if navigation is None or not self._sensed:
            return {}
        states = navigation.navigator.state.extensions
        return {name: navigation.by_ego(state)[rows, 0] for name, state in states.items()}


def _taken(what: str, source: Source, observed: Observed) -> Array:
    """What the function of an entry returns, (N,).

    Raises
    ------
    InputError
        It fails, or returns something else or NaN.
    """
    assert callable(source)
    try:
        value = np.asarray(source(observed), dtype=np.float64)
    except Exception as exc:
        raise InputError(
            f"source of {what} must return one number for each environment, got {type(exc).__name__}: "
            f"{exc}: correct the function"
        ) from exc
    if value.shape != observed.belief.shape:
        raise InputError(
            f"source of {what} must return one number for each environment, shape "
            f"{observed.belief.shape}, got shape {value.shape}: return an array of that shape"
        )
    if np.isnan(value).any():
        raise InputError(f"source of {what} must return numbers, got nan: correct the function")
    return value


def _words(array: NDArray[Any], kind: Any) -> NDArray[Any]:
    """The memory of an array (N, ...) as (N, words)."""
    words: NDArray[Any] = array.reshape(-1).view(kind).reshape(len(array), -1)
    return words
