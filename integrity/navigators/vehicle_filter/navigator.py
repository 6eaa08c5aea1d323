"""The navigator of the kind ``filter``: one kernel for an epoch of all vehicles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.navigator import Measurements, Navigator, Rows, register_navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.navigators.vehicle_filter.epoch_kernel import Filters, run_epoch
from lanebound.integrity.navigators.vehicle_filter.parameters import filter_parameters, initial_sigmas, level_cases
from lanebound.integrity.navigators.vehicle_filter.records_kernel import (
    BIASES,
    COMMON,
    COMPASS,
    GNSS,
    GYRO,
    MEASURED,
    MOTION,
    OUT,
    POSITION,
    SLIPPING,
    SLOW_ERROR,
    STEERING,
    VEHICLE,
    FilterState,
    PositionFix,
)
from lanebound.integrity.navigators.vehicle_filter.start_kernel import give_headings, place_vehicles
from lanebound.integrity.positioning.filters.code_position import CodePosition, locate_by_codes
from lanebound.integrity.positioning.filters.vehicle_states_kernel import MODEL, STATES
from lanebound.integrity.sensors.finite import with_finite

__all__ = ["FilterNavigator", "FilterReport", "blank_state", "fix_of", "run_filters"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
EPOCH_US = 60.0  # of one thread for a vehicle and epoch, measured


@dataclass(frozen=True)
class FilterReport:
    """Beside the solution of an epoch, of B vehicles.

    htl_m (B,) horizontal trust level; hpl_sbas_m (B,) of the GNSS position alone where SBAS corrects it, else inf;
    probability (B, r) of the models; nis (B, VECTORS) of sensor vectors, 0 without; gnss_used, gnss_rejected (B,).
    """

    htl_m: Array
    hpl_sbas_m: Array
    probability: Array
    nis: Array
    gnss_used: Bools
    gnss_rejected: Bools


class FilterNavigator(Navigator):
    """Extended, unscented or multiple-model filters, with levels from their covariance (S4).

    Attributes
    ----------
    report : of the last epoch; None before the first
    """

    config: FilterConfig
    report: FilterReport | None = None

    def prepare(self) -> None:
        """Figures that do not change."""
        self._parameters, self._cases = filter_parameters(self.config), level_cases(self.config)

    def initial_belief(self, batch: int) -> FilterState:
        """Nothing is known but the spread of sensor errors."""
        return blank_state(self.config, batch, len(self.track.system))

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """Give the vehicles a prior heading, (B,) azimuth and its 1-sigma, as from a compass or the last drive."""
        heading = np.ascontiguousarray(np.broadcast_to(heading_rad, self.batch), dtype=np.float64)
        give_headings(self.state.belief, np.arange(self.batch), heading, float(sigma_rad))

    def place_rows(
        self, rows: Rows | slice, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_heading_rad: float
    ) -> None:
        """Begin anew at a prior pose; what is known of the sensors, and the alert, stay."""
        chosen = np.arange(self.batch)[rows]
        position = np.ascontiguousarray(np.broadcast_to(position_en_m, (chosen.size, 2)), dtype=np.float64)
        heading = np.ascontiguousarray(np.broadcast_to(heading_rad, chosen.size), dtype=np.float64)
        place_vehicles(self.state.belief, chosen, position, float(sigma_m) ** 2)
        give_headings(self.state.belief, chosen, heading, float(sigma_heading_rad))

    def locate(self, m: Measurements) -> Solution:
        """The belief after the measurements of one epoch; reads nothing else."""
        m = with_finite(m)
        fix = locate_by_codes(self.config.position.codes, m)
        out, levels = run_filters(self._parameters, self._cases, self.state.belief, _measured_of(m), fix_of(fix))
        nis, trust, sbas = out["last_nis"].T, out["trust"], out["level_sbas"]
        probability = self.state.belief.probability.copy()
        self.report = FilterReport(trust, sbas, probability, out["nis"], out["used"], out["rejected"])
        return replace(
            Solution.blank(m, self._cases.size), position_en_m=out["position"], heading_rad=out["heading"],
            velocity_en_mps=out["velocity"], covariance_en_m2=out["covariance"], sigma_at_m=out["sigma"][:, 0],
            sigma_ct_m=out["sigma"][:, 1], pl_at_m=levels[:, 0, 0], pl_ct_m=levels[:, 0, 1], pl_cases_m=levels,
            mode=out["mode"], alert=out["alert"], available=out["available"], reason=out["reason"], hdop=fix.hdop,
            satellites=fix.satellites, excluded=fix.excluded + out["rejected"], model_curved=out["curved"],
            nis_position=nis[GNSS], nis_wheels=nis[MOTION], nis_gyro=nis[GYRO], nis_steering=nis[STEERING],
            nis_slip=nis[SLIPPING], nis_compass=nis[COMPASS], trust_m=trust, hpl_sbas_m=sbas,
        )  # fmt: skip


def blank_state(config: FilterConfig, batch: int, satellites: int) -> FilterState:
    """Vehicles that have just been switched on: nothing is known but the spread of sensor errors."""
    models = len(config.chosen_models)
    filters, vehicles = np.zeros((batch, models), MODEL), np.zeros(batch, VEHICLE)
    for place, sigma in initial_sigmas(config).items():
        filters["p"][..., place, place] = sigma**2
    vehicles["fix_age"] = vehicles["used_age"] = vehicles["moved"] = np.inf
    vehicles["excess"] = 1.0
    vehicles["alert"]["alert"], vehicles["alert"]["reason"] = True, AlertReason.INITIALISING.code
    vehicles["alert"]["onset_s"] = -1.0
    influence = np.zeros((batch, models, STATES, BIASES + COMMON + satellites))
    probability, used = np.full((batch, models), 1.0 / models), np.zeros((batch, satellites), SLOW_ERROR)
    return FilterState(vehicles, filters, probability, influence, used)


def run_filters(
    parameters: Records, cases: Records, state: FilterState, measured: Records, fix: PositionFix
) -> tuple[Records, Array]:
    """Advance the state of B vehicles by an epoch; returns OUT (B,) and levels (B, R, 2) in arrays of their own."""
    batch = measured.size
    out, levels = np.zeros(batch, OUT), np.zeros((batch, cases.size, 2))
    run_rows(run_epoch, batch, Filters(parameters, cases, state, measured, fix, out, levels), row_us=EPOCH_US)
    return out, levels


def _measured_of(m: Measurements) -> Records:
    """MEASURED (B,) of an epoch."""
    found = np.zeros(m.odometer.speed_mps.shape[0], MEASURED)
    found["turn"], found["delta_v"] = m.imu.delta_theta_rad, m.imu.delta_v_mps
    found["speed"], found["distance"] = m.odometer.speed_mps, m.odometer.distance_m
    if m.chassis is not None:
        found["wheel"], found["steering"] = m.chassis.wheel_mps, m.chassis.steering_rad
    if m.compass is not None:
        found["compass"] = m.compass.heading_rad
    return found


def fix_of(fix: CodePosition) -> PositionFix:
    """The position by codes of an epoch."""
    found = PositionFix(np.zeros(fix.valid.shape, POSITION), np.zeros(fix.own_m2.shape, SLOW_ERROR))
    vehicles, satellites = found
    vehicles["position"], vehicles["velocity"], vehicles["valid"] = fix.position_m, fix.velocity_mps, fix.valid
    vehicles["fast"], vehicles["slow"], vehicles["velocity_m2"] = fix.fast_m2, fix.slow_m2, fix.velocity_m2
    vehicles["common"], satellites["gain"], satellites["own"] = fix.common_m, fix.gain, fix.own_m2
    return found


register_navigator(FilterConfig, FilterNavigator)
