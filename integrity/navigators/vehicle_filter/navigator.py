"""The navigator of the kind ``filter``: an epoch is prediction, corrections, levels, alert."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import track_from_enu_matrix, wrap_angle
from lanebound.integrity.monitoring import alerts
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.sbas import Operation
from lanebound.integrity.navigators.navigator import Measurements, Navigator, Rows, register_navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.navigators.vehicle_filter import epoch as steps
from lanebound.integrity.navigators.vehicle_filter import observations as seen
from lanebound.integrity.navigators.vehicle_filter.belief import (
    BIASES,
    FilterBelief,
    begin_at,
    blank_belief,
    give_heading,
    slow_columns,
    take_slow_error,
)
from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.navigators.vehicle_filter.levels import (
    ModelPositions,
    covariance_levels,
    horizontal_trust_level,
    track_sigma,
    with_slow_errors,
)
from lanebound.integrity.positioning.code_solution import semi_major_m
from lanebound.integrity.positioning.filters.code_position import CodePosition, locate_by_codes
from lanebound.integrity.positioning.filters.multiple_models import combine
from lanebound.integrity.positioning.filters.vehicle_models import MotionInput, S
from lanebound.integrity.positioning.modes import Mode

__all__ = ["FilterNavigator", "FilterReport"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
GNSS, MOTION = 0, 1
COURSE_MPS = 2.0  # speed from which on a Doppler velocity gives the first heading
MONITORED = ("wheels", "steering")  # whose rejections count as rejected motion


@dataclass(frozen=True)
class FilterReport:
    """Beside the solution of an epoch, of B vehicles.

    htl_m (B,) horizontal trust level; hpl_sbas_m (B,) of the GNSS position alone, inf without one; probability (B, r)
    of the models; nis (B, 2) of GNSS position and wheels, 0 without; gnss_used, gnss_rejected (B,).
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
        c = self.config
        self._noise = steps.noise_of(c)
        dead = c.positioning.dead_reckoning
        self._bounds = np.array(
            [c.position.bias_m, c.position.bias_m, np.deg2rad(dead.heading_bias_deg), dead.odometer_bias_mps]
        )

    def initial_belief(self, batch: int) -> FilterBelief:
        """Nothing is known but the spread of sensor errors."""
        return blank_belief(self.config, batch, len(self.track.system))

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """Give the vehicles a prior heading, (B,) azimuth and its 1-sigma, as from a compass or the last drive."""
        give_heading(self.state.belief, slice(None), heading_rad, sigma_rad)

    def place_rows(
        self, rows: Rows | slice, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_heading_rad: float
    ) -> None:
        """Begin anew at a prior pose; what is known of the sensors, and the alert, stay."""
        begin_at(self.state.belief, rows, position_en_m, sigma_m**2)
        give_heading(self.state.belief, rows, heading_rad, sigma_heading_rad)

    def locate(self, m: Measurements) -> Solution:
        """The belief after the measurements of one epoch; reads nothing else."""
        c, b = self.config, self.state.belief
        fix = locate_by_codes(c.position.codes, m)
        predicted, likelihood = self._predict(b, m)
        nis = np.zeros((self.batch, 2))
        self._correct_by_motion(b, m, likelihood, nis)
        used, rejected, lost = self._correct_by_position(b, m, fix, likelihood, nis)
        steps.conclude(b, predicted, likelihood)
        self._begin(b, m, fix)
        return self._report(b, m, fix, nis, used, rejected, lost)

    def _predict(self, b: FilterBelief, m: Measurements) -> tuple[Array, Array]:
        """Advance the models by an epoch; probabilities after interaction, and likelihoods to be filled."""
        c, turn = self.config, m.imu.delta_theta_rad[:, 2]
        b.turned_rad = b.turned_rad + turn
        a = seen.acceleration_along(m, b, c.dt_s)
        likelihood = np.zeros_like(b.probability)
        printed = None
        if c.motion.accelerometer == "observation":
            x, p = combine(b.x, b.p, b.probability)
            printed = seen.printed_inertial(c, x, p, (b.probability * a).sum(-1))
        u = MotionInput(c.dt_s, turn[:, None], a, c.motion.accelerometer == "input")
        predicted = steps.advance(b, c, self._noise, u)
        if printed is not None:
            steps.observe(b, printed, likelihood, c.gate.enabled)
        return predicted, likelihood

    def _correct_by_motion(self, b: FilterBelief, m: Measurements, likelihood: Array, nis: Array) -> None:
        """Gyro, wheels, slip, compass, rest."""
        c, rejected = self.config, np.zeros(self.batch, np.bool_)
        for observation in seen.motion_observations(c, m, b):
            outcome = steps.observe(b, observation, likelihood, c.gate.enabled)
            if observation.name in MONITORED:
                rejected |= outcome.rejected
            if observation.name == "wheels":
                nis[:, MOTION] = outcome.nis
        b.rejected_s[:, MOTION] = np.where(rejected, b.rejected_s[:, MOTION] + c.dt_s, 0.0)

    def _correct_by_position(
        self, b: FilterBelief, m: Measurements, fix: CodePosition, likelihood: Array, nis: Array
    ) -> tuple[Bools, Bools, Bools]:
        """The GNSS position, when it is due; where it was used, rejected, and where the filter has doubted itself."""
        c, p = self.config, self.config.position
        b.fix_age_s = b.fix_age_s + c.dt_s
        b.moved_m = b.moved_m + np.abs(m.odometer.distance_m)
        due = fix.valid & b.known & (b.fix_age_s >= p.interval_s - 1e-9) & (b.moved_m >= p.least_move_m)
        none = np.zeros_like(due)
        if not due.any():
            return none, none, none
        if c.sensor_errors:
            take_slow_error(b, fix, due, p.slow_tau_s)
        heading = (b.probability * b.x[..., S.HEADING]).sum(-1)
        observation = seen.gnss_position(c, fix, heading, due)
        lost = due & (b.rejected_s[:, GNSS] >= c.gate.lost_s)
        if lost.any():
            self._doubt(b, observation, lost)
        outcome = steps.observe(b, observation, likelihood, c.gate.enabled)
        since = np.where(np.isfinite(b.fix_age_s), b.fix_age_s, p.interval_s)
        waited = np.minimum(since, 2.0 * p.interval_s)
        b.rejected_s[:, GNSS] = np.where(
            outcome.used, 0.0, b.rejected_s[:, GNSS] + np.where(outcome.rejected, waited, 0.0)
        )
        b.fix_age_s = np.where(due, 0.0, b.fix_age_s)
        b.moved_m = np.where(due, 0.0, b.moved_m)
        nis[:, GNSS] = outcome.nis
        return outcome.used, outcome.rejected, lost

    def _doubt(self, b: FilterBelief, observation: steps.Observation, lost: Bools) -> None:
        """Take the innovation into the covariance of the position: either it or the filter is wrong by that much."""
        k = np.flatnonzero(lost)
        apart = observation.z[k, None] - b.x[k] @ observation.design.T
        b.p[k, :, :2, :2] += apart[..., :, None] * apart[..., None, :] + np.eye(2)
        b.doubt_m[k] = np.maximum(b.doubt_m[k], np.linalg.norm(apart, axis=-1).max(-1))
        b.doubt_s[k] = self.config.gate.doubt_s

    def _begin(self, b: FilterBelief, m: Measurements, fix: CodePosition) -> None:
        """Vehicles without a pose begin at a position from codes, with the heading of compass or Doppler velocity."""
        if b.known.all() and b.aligned.all():
            return
        speed = np.hypot(fix.velocity_mps[:, 0], fix.velocity_mps[:, 1])
        course = np.arctan2(fix.velocity_mps[:, 0], fix.velocity_mps[:, 1])
        moving = fix.valid & (speed > COURSE_MPS) & (m.odometer.speed_mps > 0.5 * COURSE_MPS) & ~b.aligned
        if moving.any():
            k = np.flatnonzero(moving)
            sigma_v = self.config.positioning.doppler.sigma_mps * np.sqrt(
                np.trace(fix.velocity_m2[k], axis1=1, axis2=2)
            )
            give_heading(b, k, course[k], 3.0 * sigma_v / speed[k] + np.deg2rad(0.5))
        if m.compass is not None and not b.aligned.all():
            k = np.flatnonzero(~b.aligned)
            motion = self.config.motion
            sigma = np.deg2rad(np.hypot(motion.compass_sigma_deg, motion.compass_deviation_deg))
            give_heading(b, k, m.compass.heading_rad[k], 1.5 * sigma)
        starting = b.aligned & ~b.known & fix.valid
        if starting.any():
            k = np.flatnonzero(starting)
            begin_at(b, k, fix.position_m[k, :2], fix.fast_m2[k] + fix.slow_m2[k])
            self._share_slow_error(b, fix, starting, k)

    def _share_slow_error(self, b: FilterBelief, fix: CodePosition, starting: Bools, k: Rows) -> None:
        """The position that a vehicle begins with has the slow error of its GNSS position."""
        if not self.config.sensor_errors:
            return
        take_slow_error(b, fix, starting, self.config.position.slow_tau_s)
        b.p[k, :, :2, S.GNSS_EAST :] = -fix.slow_m2[k][:, None]
        b.p[k, :, S.GNSS_EAST :, :2] = -fix.slow_m2[k][:, None]
        b.influence[k, :, :2, BIASES:] = slow_columns(fix)[k, None]
        b.fix_age_s[k] = b.moved_m[k] = 0.0

    def _report(
        self, b: FilterBelief, m: Measurements, fix: CodePosition, nis: Array, used: Bools, rejected: Bools, lost: Bools
    ) -> Solution:
        """Levels, alert and the solution; where no pose is known, the code position without levels."""
        c = self.config
        x, p = combine(b.x, b.p, b.probability)
        influence = (b.probability[..., None, None] * b.influence[:, :, :2]).sum(1)
        covariance = with_slow_errors(p[:, :2, :2], influence[..., BIASES:])
        heading = np.asarray(wrap_angle(x[:, S.HEADING]))
        trust = horizontal_trust_level(p[:, :2, :2])
        sigma = track_sigma(covariance, track_from_enu_matrix(heading))
        slow = b.influence[:, :, :2, BIASES:]
        models = ModelPositions(
            b.probability, b.x[..., :2] - x[:, None, :2], with_slow_errors(b.p[..., :2, :2], slow),
            b.influence[:, :, :2, :BIASES],
        )  # fmt: skip
        levels = covariance_levels(c.cases, c.risk, models, self._bounds, heading, trust)
        known = b.known & b.aligned
        levels = levels + b.doubt_m[:, None, None]
        b.doubt_s = np.maximum(b.doubt_s - c.dt_s, 0.0)
        b.doubt_m = np.where(b.doubt_s > 0.0, b.doubt_m, 0.0)
        levels = np.where(known[:, None, None], levels, np.inf)
        cause = np.where(lost, AlertReason.INTEGRITY_TEST_FAILED.code, AlertReason.NONE.code)
        cause = np.where(known, cause, AlertReason.INITIALISING.code)
        status = alerts.step(
            c.alert, b.alert, levels[:, 0, 0], levels[:, 0, 1], c.dt_s, sigma_at_m=sigma[:, 0], sigma_ct_m=sigma[:, 1],
            cause=cause,
        )  # fmt: skip
        fixed = known & (b.fix_age_s < c.position.interval_s)
        mode = np.where(fixed | (~known & fix.valid), int(Mode.CODE), int(Mode.IMU_ODOMETER))
        mode = np.where(~known & ~fix.valid, int(Mode.NONE), mode)
        course = x[:, S.HEADING] + x[:, S.SLIP] + x[:, S.SLIDE]
        velocity = x[:, S.SPEED, None] * np.stack([np.sin(course), np.cos(course)], -1)
        hpl = Operation.EN_ROUTE.value[0] * semi_major_m(*self._gnss_variances(fix))
        self.report = FilterReport(
            htl_m=np.where(known, trust, np.inf),
            hpl_sbas_m=np.where(fix.valid, hpl, np.inf), probability=b.probability.copy(), nis=nis, gnss_used=used,
            gnss_rejected=rejected,
        )  # fmt: skip
        position = np.where(known[:, None], x[:, :2], fix.position_m[:, :2])
        return replace(
            Solution.blank(m, len(c.cases)), position_en_m=position, heading_rad=heading, velocity_en_mps=velocity,
            covariance_en_m2=covariance, sigma_at_m=sigma[:, 0], sigma_ct_m=sigma[:, 1],
            pl_at_m=levels[:, 0, 0], pl_ct_m=levels[:, 0, 1], pl_cases_m=levels, mode=mode, alert=status.alert,
            available=status.available, reason=status.reason, hdop=fix.hdop, satellites=fix.satellites,
            excluded=fix.excluded + rejected,
        )  # fmt: skip

    @staticmethod
    def _gnss_variances(fix: CodePosition) -> tuple[Array, Array, Array]:
        """East, North and their covariance of the GNSS position, (B,) each."""
        q = fix.fast_m2 + fix.slow_m2
        return q[:, 0, 0], q[:, 1, 1], q[:, 0, 1]


register_navigator(FilterConfig, FilterNavigator)
