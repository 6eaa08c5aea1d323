"""The navigator of the kind ``rtk_reckoning``: an epoch is a list of stages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.records import Records, blocks, copied
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.heading_doubt_kernel import HEADING_DOUBT
from lanebound.integrity.monitoring.heading_separation_kernel import COURSE, SPREAD
from lanebound.integrity.navigators.navigator import Measurements, Navigator, Rows, register_navigator
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.epoch import EpochStages
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters, epoch_tables
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import (
    FAULT,
    MARK,
    OUT,
    START,
    VEHICLE,
    WORK,
    Epoch,
    State,
    Tables,
)
from lanebound.integrity.navigators.services.stage import ServiceSet
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.drift_watch_kernel import ANCHOR
from lanebound.integrity.positioning.float_filter_kernel import MEASURED, SLOT, STATES, FloatFilters
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY
from lanebound.integrity.sensors.finite import with_finite
from lanebound.integrity.sensors.instruments import observed
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL, OBSERVED_VEHICLE

__all__ = ["RtkReckoningNavigator"]

Array = NDArray[np.float64]
LOCATE_US = 20.0  # of one thread for a vehicle and epoch, measured


class RtkReckoningNavigator(Navigator):
    """RTK, bridged by Doppler and by dead reckoning with odometer and gyro, with protection levels and alerts."""

    config: RtkReckoningConfig

    def prepare(self) -> None:
        """The parameters, and the list of stages."""
        kind, text = type(self.config), self.config.to_json()
        self._parameters, self._tables = _figures(kind, text, tuple(self.track.system.tolist()))
        self._services = ServiceSet(self.config, self.track.system)
        self._stages = EpochStages(self.config, self._services)
        self._epoch: tuple[State, Epoch] | None = None
        self._stages.compile_ahead(lambda: blank_epoch(self._parameters, self._tables, self.initial_belief(1)))

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
        """The states of services, and of plug-in modes and stages."""
        modes = {f"mode {mode.mode.key}": mode.initial for mode in self.config.chosen_modes}
        extra = {f"stage {stages.name}": stages.initial for stages in self.config.extra_stages}
        given = {**modes, **extra}.items()
        states = {name: np.repeat(initial, batch) for name, initial in given if initial is not None}
        return states | self._services.initial(batch)

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """Give the vehicles a prior heading, (B,) azimuth and its 1-sigma, as from a compass or the last drive."""
        vehicles = self.state.belief.vehicles
        give_heading(vehicles["heading"], heading_rad, sigma_rad)
        vehicles["since_calibration"], vehicles["memory_s"] = 0.0, 0.0
        self.state.belief.faults["course"] = np.zeros((), COURSE)
        vehicles["spread"], vehicles["doubt"] = np.zeros((), SPREAD), np.zeros((), HEADING_DOUBT)

    def place_rows(
        self, rows: Rows | slice, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_heading_rad: float
    ) -> None:
        """Dead-reckon from the prior until RTK is found; the gyro bias and the alert stay."""
        belief = self.state.belief
        old, fresh = blocks(belief.vehicles)[rows].view(VEHICLE), np.zeros(position_en_m.shape[0], VEHICLE)
        fresh["position"][:, :2], fresh["position"][:, 2] = position_en_m, old["position"][:, 2]
        fresh["velocity"] = old["velocity"]
        fresh["heading"], fresh["alert"], fresh["rtk"] = old["heading"], old["alert"], old["rtk"]
        give_heading(fresh["heading"], heading_rad, sigma_heading_rad)
        fresh["initialised"], fresh["backup"]["age"] = True, np.inf
        fresh["backup"]["position"] = old["backup"]["position"]
        for axis in ("p_ee", "p_nn"):
            fresh["growth"][axis] = sigma_m**2
        blocks(belief.vehicles)[rows] = blocks(fresh)
        for array in arrays_of(belief[2:]):  # all but vehicles and ambiguities
            blocks(array)[rows] = bytes(array.itemsize)
        belief.ambiguities["held"][rows], belief.ambiguities["last_phase"][rows] = False, 0.0
        self._services.forget(self.state.extensions, rows)

    def locate(self, m: Measurements) -> Solution:
        """The belief after the measurements of one epoch; reads nothing else."""
        return solution_of(*self._advance(m))

    def follow(self, m: Measurements) -> None:
        """:meth:`solve` without making the solution."""
        if self.config.context is None:
            self._advance(m)
        else:
            super().follow(m)

    def _advance(self, m: Measurements) -> tuple[Measurements, Epoch]:
        """Advance the belief by an epoch: the measurements that it used, and the epoch."""
        m = with_finite(m)
        states, (signals, vehicles) = self._services.with_inputs(m, self.state.extensions), observed(m)
        stages = self._stages.for_epoch(vehicles)
        if stages.changes_signals:
            signals = copied(signals)
        epoch = self._epoch_of(self.state.belief)._replace(signals=signals, observed=vehicles)
        run_rows(stages, self.batch, epoch, states, row_us=LOCATE_US)
        return m, epoch

    def _epoch_of(self, belief: State) -> Epoch:
        """The arrays of an epoch; those of the belief are its own."""
        if self._epoch is None or self._epoch[0] is not belief:
            self._epoch = belief, blank_epoch(self._parameters, self._tables, belief)
        return self._epoch[1]


@lru_cache(maxsize=32)
def _figures(kind: type[RtkReckoningConfig], text: str, system: tuple[int, ...]) -> tuple[Records, Tables]:
    """Parameters and tables of an epoch for satellites of these systems, in shared arrays. Do not write them."""
    config = kind.from_json(text)
    return epoch_parameters(config), epoch_tables(config, np.array(system, dtype=np.int64))


def give_heading(heading: Records, angle_rad: Array, sigma_rad: float) -> None:
    """Set heading filters (n,) to a heading (n,) and its 1-sigma; what they know of the gyro stays."""
    heading["angle"], heading["p_hh"] = angle_rad, sigma_rad**2
    for name in ("p_hb", "p_hs", "axle_h", "axle_b", "axle_s", "noise", "white"):
        heading[name] = 0.0


def blank_state(batch: int, satellites: int, modes: int, cases: int, rtk: RtkConfig) -> State:
    """The state of vehicles, all zeros; ``modes`` is the number of fault modes."""
    return State(
        np.zeros(batch, VEHICLE), np.zeros((batch, satellites), AMBIGUITY), np.zeros((batch, modes), FAULT),
        np.zeros((batch, 2, cases), START), np.zeros((batch, rtk.drift.anchors), ANCHOR), blank_filters(batch, rtk),
    )  # fmt: skip


def blank_filters(batch: int, rtk: RtkConfig, stands: bool = False) -> FloatFilters | None:
    """Filters of float ambiguities that know nothing; None where floats come from single epochs.

    ``stands``: the receivers do not move, and their position is a state of the filter.
    """
    if rtk.float_solution.kind != "sequential":
        return None
    slots = rtk.max_candidates
    n = STATES * slots + (4 if stands else 1)
    return FloatFilters(
        np.zeros((batch, slots), SLOT), np.zeros((batch, n, n)), np.zeros((batch, n)), np.zeros((batch, n, n)),
        np.zeros((batch, MEASURED * slots, n)),
    )  # fmt: skip


def arrays_of(values: tuple[Any, ...]) -> Iterator[NDArray[Any]]:
    """The arrays of NamedTuples, at any depth."""
    for value in values:
        if isinstance(value, np.ndarray):
            yield value
        elif value is not None:
            yield from arrays_of(value)


def blank_epoch(parameters: Records, tables: Tables, belief: State) -> Epoch:
    """An epoch of vehicles of this belief, before anything is measured."""
    (batch, satellites), cases = belief.ambiguities.shape, tables.cases.shape[0]
    return Epoch(
        parameters, tables, *belief, np.zeros((batch, satellites), OBSERVED_SIGNAL), np.zeros(batch, OBSERVED_VEHICLE),
        np.zeros(batch, WORK), np.zeros((batch, satellites), MARK), np.zeros((batch, cases, 2)), np.zeros(batch, OUT),
        np.full((batch, cases, 2), np.inf),
    )  # fmt: skip


def solution_of(m: Measurements, epoch: Epoch) -> Solution:
    """The solution in arrays of its own."""
    out, levels = copied(epoch.out), epoch.levels.copy()
    return Solution(  # positional, in the order of its fields: half the time for a single vehicle
        m.time_s, out["position"], out["heading"], out["velocity"], m.odometer.speed_mps, out["covariance"],
        out["sigma_at"], out["sigma_ct"], levels[:, 0, 0], levels[:, 0, 1], levels, out["mode"], out["rtk"],
        out["alert"], out["available"], out["reason"], out["hdop"], out["satellites"], out["satellites_doppler"],
        out["excluded"], out["since_rtk"], out["since_calibration"], m.gnss.corrections_age_s, out["wrong"],
        epoch.ambiguities["held"].copy(), out["difference"], *_no_filter(out.size), out["sdop"],
    )  # fmt: skip


@lru_cache(maxsize=64)
def _no_filter(batch: int) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]:
    """Probability of a model, NIS of six vectors, trust level and SBAS level of vehicles without a filter, (B,)."""
    zero, none = np.zeros(batch), np.full(batch, np.inf)
    return zero, zero, zero, zero, zero, zero, zero, none, none


register_navigator(RtkReckoningConfig, RtkReckoningNavigator)
