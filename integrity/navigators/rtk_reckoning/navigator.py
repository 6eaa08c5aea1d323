"""The navigator of the kind ``rtk_reckoning``: an epoch is a list of stages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import GROWTH
from lanebound.integrity.monitoring.doppler_separation_kernel import Influences, Separations
from lanebound.integrity.monitoring.heading_doubt_kernel import HEADING_DOUBT
from lanebound.integrity.monitoring.heading_separation_kernel import SPREAD, Courses
from lanebound.integrity.navigators.navigator import Measurements, Navigator, Rows, register_navigator
from lanebound.integrity.navigators.rtk_reckoning.attitude_kernel import find_attitude
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.extension_kernel import begin
from lanebound.integrity.navigators.rtk_reckoning.float_stage_kernel import add_to_filter
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import find_levels
from lanebound.integrity.navigators.rtk_reckoning.lock_kernel import follow_carriers
from lanebound.integrity.navigators.rtk_reckoning.modes_kernel import advance_nothing
from lanebound.integrity.navigators.rtk_reckoning.monitors import BUILT_IN, Point
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters, epoch_tables
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import (
    START,
    VEHICLE,
    WORK,
    Epoch,
    EpochInputs,
    Lasting,
    Measured,
    Outputs,
    State,
    Work,
)
from lanebound.integrity.navigators.rtk_reckoning.report_kernel import report, take_fix
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import resolve_integers
from lanebound.integrity.navigators.rtk_reckoning.stages import OutsideStage, SeparateStage, Stage, StageList
from lanebound.integrity.navigators.services.stage import ServiceSet
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.drift_watch_kernel import ANCHOR, DRIFT, DriftWatch
from lanebound.integrity.positioning.float_filter_kernel import FILTER_ROW, MEASURED, SLOT, STATES, Filtered
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY
from lanebound.integrity.sensors.finite import with_finite

__all__ = ["RtkReckoningNavigator"]

Array = NDArray[np.float64]
LOCATE_US = 20.0  # of one thread for a vehicle and epoch, measured


class RtkReckoningNavigator(Navigator):
    """RTK, bridged by Doppler and by dead reckoning with odometer and gyro, with protection levels and alerts."""

    config: RtkReckoningConfig

    def prepare(self) -> None:
        """The parameters, and the list of stages."""
        self._parameters = epoch_parameters(self.config)
        self._tables = epoch_tables(self.config, self.track.system)
        self._services = ServiceSet(self.config, self.track.system)
        self._stages = StageList(stages_of(self.config, self._services))
        self._stages.compile_ahead(self._blank_epoch)
        self._excludes = any(Point.MEASURED in monitor.stages for monitor in self.config.chosen_monitors)

    def initial_belief(self, batch: int) -> State:
        """Nothing is known but the bounds of the heading and of the gyro bias."""
        rtk = self.config.positioning.rtk
        belief = blank_state(batch, len(self.track.system), self._tables.prior.size, len(self.config.cases), rtk)
        vehicles, heading = belief.vehicles, self.config.positioning.heading
        vehicles["heading"]["p_hh"] = np.deg2rad(heading.initial_sigma_deg) ** 2
        vehicles["heading"]["p_bb"] = heading.bias_initial_radps**2
        vehicles["heading"]["p_ss"] = heading.gyro_scale**2
        vehicles["since_rtk"] = vehicles["since_calibration"] = vehicles["backup"]["age"] = np.inf
        vehicles["alert"]["alert"], vehicles["alert"]["reason"] = True, AlertReason.INITIALISING.code
        vehicles["alert"]["onset_s"] = -1.0
        return belief

    def initial_extensions(self, batch: int) -> dict[str, Records]:
        """The states of services, and of the modes and monitors from outside."""
        modes = {f"mode {mode.mode.key}": mode.initial for mode in self.config.chosen_modes}
        monitors = {f"monitor {monitor.name}": monitor.initial for monitor in self.config.chosen_monitors}
        given = {**modes, **monitors}.items()
        states = {name: np.repeat(initial, batch) for name, initial in given if initial is not None}
        return states | self._services.initial(batch)

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """Give the vehicles a prior heading, (B,) azimuth and its 1-sigma, as from a compass or the last drive."""
        vehicles = self.state.belief.vehicles
        give_heading(vehicles["heading"], heading_rad, sigma_rad)
        vehicles["since_calibration"], vehicles["memory_s"] = 0.0, 0.0
        for array in self.state.belief.courses:
            array[:] = 0.0
        vehicles["spread"], vehicles["doubt"] = np.zeros((), SPREAD), np.zeros((), HEADING_DOUBT)

    def place_rows(
        self, rows: Rows | slice, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_heading_rad: float
    ) -> None:
        """Dead-reckon from the prior until RTK is found; the gyro bias and the alert stay."""
        belief = self.state.belief
        old, fresh = belief.vehicles[rows], np.zeros(position_en_m.shape[0], belief.vehicles.dtype)
        fresh["position"][:, :2], fresh["position"][:, 2] = position_en_m, old["position"][:, 2]
        fresh["velocity"] = old["velocity"]
        fresh["heading"], fresh["alert"], fresh["rtk"] = old["heading"], old["alert"], old["rtk"]
        give_heading(fresh["heading"], heading_rad, sigma_heading_rad)
        fresh["initialised"], fresh["backup"]["age"] = True, np.inf
        fresh["backup"]["position"] = old["backup"]["position"]
        belief.vehicles[rows] = fresh
        for array in arrays_of(belief[2:]):  # all but vehicles and ambiguities
            array[rows] = np.zeros((), array.dtype)
        belief.ambiguities["held"][rows], belief.ambiguities["last_phase"][rows] = False, 0.0
        for axis in ("p_ee", "p_nn"):
            belief.growth[axis][rows] = sigma_m**2
        self._services.forget(self.state.extensions, rows)

    def locate(self, m: Measurements) -> Solution:
        """The belief after the measurements of one epoch; reads nothing else."""
        m = with_finite(m)
        measured, belief = measured_of(m), self.state.belief
        if self._excludes:
            measured = measured._replace(tracked=measured.tracked.copy())
        owners = self._parameters, self._tables, belief
        lasting = self.state.locating.of(owners, lambda: self._lasting(belief))
        inputs, states = EpochInputs(measured), self._services.with_inputs(m, self.state.extensions)
        run_rows(self._stages, self.batch, lasting, inputs, states, row_us=LOCATE_US)
        return solution_of(m, lasting.values.out)

    def _blank_epoch(self) -> Epoch:
        """Data of the types of an epoch."""
        measured = blank_measured(1, len(self.track.system))
        return Epoch(*self._lasting(self.initial_belief(1)), measured)

    def _lasting(self, belief: State) -> Lasting:
        """What the stages work on in every epoch."""
        batch, satellites = belief.ambiguities.shape
        cases = self._tables.cases.shape[0]
        work, out = blank_work(batch, satellites, cases), blank_outputs(batch, satellites, cases)
        return Lasting(self._parameters, self._tables, belief, work, out)


def give_heading(heading: Records, angle_rad: Array, sigma_rad: float) -> None:
    """Set heading filters (n,) to a heading (n,) and its 1-sigma; what they know of the gyro stays."""
    heading["angle"], heading["p_hh"] = angle_rad, sigma_rad**2
    for name in ("p_hb", "p_hs", "axle_h", "axle_b", "axle_s", "noise", "white"):
        heading[name] = 0.0


def stages_of(config: RtkReckoningConfig, services: ServiceSet) -> list[Stage | SeparateStage]:
    """The stages of an epoch, in their order."""
    monitors = [*BUILT_IN.values(), *config.chosen_monitors]

    def monitored(point: Point) -> list[Stage | OutsideStage]:
        return [monitor.stages[point] for monitor in monitors if point in monitor.stages]

    return [
        begin,
        *services.begin(),
        *monitored(Point.MEASURED),
        *monitored(Point.VELOCITY),
        find_attitude,
        *(carrier_stages(config.positioning.rtk) if services.with_rtk else ()),
        *(monitored(Point.FIX) if services.with_rtk else ()),
        *monitored(Point.ESTIMATED),
        *(mode.stage for mode in config.chosen_modes),
        advance_nothing,
        *monitored(Point.MOVED),
        *services.before_levels(),
        find_levels,
        *services.fixes(),
        *monitored(Point.JUDGED),
        take_fix,
        *services.settle(),
        *monitored(Point.BOUNDED),
        report,
        *services.label(),
    ]


def carrier_stages(rtk: RtkConfig) -> list[Stage]:
    """The stages that follow carriers and resolve their integers."""
    if rtk.float_solution.kind == "sequential":
        return [follow_carriers, add_to_filter, resolve_integers]
    return [follow_carriers, resolve_integers]


def blank_state(batch: int, satellites: int, modes: int, cases: int, rtk: RtkConfig) -> State:
    """The state of vehicles, all zeros; ``modes`` is the width of the arrays of fault modes."""

    def blank(kind: type[Any]) -> Any:
        return kind(*(np.zeros((batch, modes)) for _ in kind._fields))

    return State(
        np.zeros(batch, VEHICLE), np.zeros((batch, satellites), AMBIGUITY), blank_filters(batch, rtk),
        np.zeros((batch, 2), GROWTH),
        np.zeros((batch, 2, cases), START), blank(Influences), blank(Influences), blank(Separations),
        blank(Separations), blank(Courses),
        DriftWatch(np.zeros(batch, DRIFT), np.zeros((batch, rtk.drift.anchors), ANCHOR)),
    )  # fmt: skip


def blank_filters(batch: int, rtk: RtkConfig, stands: bool = False) -> Filtered:
    """Filters of float ambiguities that know nothing; without a slot where floats come from single epochs.

    ``stands``: the receivers do not move, and their position is a state of the filter.
    """
    slots = rtk.max_candidates if rtk.float_solution.kind == "sequential" else 0
    n = STATES * slots + (4 if stands and slots else 1)
    return Filtered(
        np.zeros(batch, FILTER_ROW), np.zeros((batch, slots), SLOT), np.zeros((batch, n, n)), np.zeros((batch, n)),
        np.zeros((batch, n, n)), np.zeros((batch, MEASURED * slots, n)),
    )  # fmt: skip


def arrays_of(values: tuple[Any, ...]) -> Iterator[NDArray[Any]]:
    """The arrays of NamedTuples, at any depth."""
    for value in values:
        if isinstance(value, np.ndarray):
            yield value
        else:
            yield from arrays_of(value)


def blank_work(batch: int, satellites: int, cases: int) -> Work:
    """Work of vehicles, all zeros."""
    shape = batch, satellites
    return Work(
        np.zeros(batch, WORK), np.zeros(shape), np.zeros(shape), np.zeros(shape, np.bool_), np.zeros(shape, np.bool_),
        np.zeros((batch, cases, 2)),
    )  # fmt: skip


def blank_measured(batch: int, satellites: int) -> Measured:
    """Measurements of vehicles, all zeros, in arrays of the types of real ones."""
    by_satellite, by_band = (batch, satellites), (batch, satellites, 2)
    return Measured(
        los=np.zeros((batch, satellites, 3)), sight=np.zeros(batch, np.int64), tracked=np.zeros(by_satellite, np.bool_),
        cn0=np.zeros(by_satellite), code=np.zeros(by_band), phase=np.zeros(by_band), range_rate=np.zeros(by_satellite),
        lock_lost=np.zeros(by_satellite, np.bool_), age=np.zeros(batch), turn=np.zeros((batch, 3)),
        delta_v=np.zeros((batch, 3)), speed=np.zeros(batch), integer_error=np.zeros(by_band, np.int64),
        next_best=np.zeros((batch, 2)),
    )  # fmt: skip


def blank_outputs(batch: int, satellites: int, cases: int) -> Outputs:
    """Outputs of vehicles, to be filled; arrays of one shape and type are parts of one block."""
    heading, sigma_at, sigma_ct, hdop, since_rtk, since_calibration, wrong, sdop = np.empty((8, batch))
    position, velocity, difference = np.empty((3, batch, 2))
    mode, rtk, reason, satellites_rtk, satellites_doppler, excluded = np.empty((6, batch), np.int64)
    alert, available = np.empty((2, batch), np.bool_)
    return Outputs(
        position=position, heading=heading, velocity=velocity, covariance=np.empty((batch, 2, 2)), sigma_at=sigma_at,
        sigma_ct=sigma_ct, levels=np.full((batch, cases, 2), np.inf),
        mode=mode, rtk=rtk, alert=alert, available=available,
        reason=reason, hdop=hdop, satellites=satellites_rtk, satellites_doppler=satellites_doppler, excluded=excluded,
        since_rtk=since_rtk, since_calibration=since_calibration, wrong=wrong,
        held=np.empty((batch, satellites), np.bool_), difference=difference, sdop=sdop,
    )  # fmt: skip


def measured_of(m: Measurements) -> Measured:
    """The measurements as the stages take them."""
    g, wrong, rank = m.gnss, m.gnss.integer_error, m.gnss.next_best
    if wrong is None or rank is None:
        wrong, rank = _no_error(g.phase_m.shape)
    elif not wrong.flags.writeable:  # compiled stages take arrays of one kind
        wrong, rank = wrong.copy(), rank.copy()
    arrays: Any = (
        m.sky.los_enu, m.sky.index, g.tracked, g.cn0_dbhz, g.code_m, g.phase_m, g.range_rate_mps, g.lock_lost,
        g.corrections_age_s, m.imu.delta_theta_rad, m.imu.delta_v_mps, m.odometer.speed_mps, wrong, rank,
    )  # fmt: skip
    return Measured(*map(np.ascontiguousarray, arrays))


@lru_cache(maxsize=16)
def _no_error(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], Array]:
    """No integer is wrong, and no rank: shared by all epochs, which only read them."""
    return np.zeros(shape, np.int64), np.zeros((shape[0], 2))


def solution_of(m: Measurements, out: Outputs) -> Solution:
    """The solution in arrays of its own, copied from the outputs of all stages block by block."""
    blocks: tuple[Any, ...] = out.heading.base, out.position.base, out.mode.base, out.alert.base
    heading, sigma_at, sigma_ct, hdop, since_rtk, since_calibration, wrong, sdop = blocks[0].copy()
    position, velocity, difference = blocks[1].copy()
    mode, rtk, reason, satellites, satellites_doppler, excluded = blocks[2].copy()
    alert, available = blocks[3].copy()
    levels = out.levels.copy()
    return Solution(  # positional, in the order of its fields: half the time for a single vehicle
        m.time_s, position, heading, velocity, m.odometer.speed_mps, out.covariance.copy(), sigma_at, sigma_ct,
        levels[:, 0, 0], levels[:, 0, 1], levels, mode, rtk, alert, available, reason, hdop, satellites,
        satellites_doppler, excluded, since_rtk, since_calibration, m.gnss.corrections_age_s, wrong, out.held.copy(),
        difference, *_no_filter(heading.size), sdop,
    )  # fmt: skip


@lru_cache(maxsize=64)
def _no_filter(batch: int) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]:
    """Probability of a model, NIS of six vectors, trust level and SBAS level of vehicles without a filter, (B,)."""
    zero, none = np.zeros(batch), np.full(batch, np.inf)
    return zero, zero, zero, zero, zero, zero, zero, none, none


register_navigator(RtkReckoningConfig, RtkReckoningNavigator)
