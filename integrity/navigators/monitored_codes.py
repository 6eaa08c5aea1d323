"""Navigator kind ``monitored_codes``: positions by undifferenced codes under a monitor of the family.

Between code positions, and where the monitor gives none, wheels and gyro move the position and the level grows. The
heading is that of the gyro, calibrated by Doppler. The level bounds the horizontal error, so that it is that of both
axes. No reference station, no carriers: metres, not centimetres.

Monitors with a memory (KIPL, ERAIM, the composite) have one for each vehicle. Their steps are the displacement by
wheels and gyro between two code positions, with the deviation that dead reckoning has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.presets import deep_merge
from lanebound.integrity.monitoring.alerts import AlertReason, AlertState, step
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.error_classes import FittedErrors
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.levels import normal_factor
from lanebound.integrity.monitoring.family.memory import Memory
from lanebound.integrity.monitoring.family.monitor import GOES_ON, MEMORY, new_memory, watch
from lanebound.integrity.monitoring.family.outcome import MonitorVerdicts
from lanebound.integrity.monitoring.family.rejection import global_threshold
from lanebound.integrity.monitoring.family.weighting import CodeBudget
from lanebound.integrity.navigators.context_guard import CONTEXT
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig, register_navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.correlation import bound_correlation
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.finite import with_finite
from lanebound.integrity.sensors.gnss import GnssConfig

__all__ = ["MonitorChoice", "MonitoredCodesConfig", "MonitoredCodesNavigator"]

Array = NDArray[np.float64]

BAND = 0
LEAST_SINE = 0.05  # of an elevation, in deviations of range rates
CALIBRATE_MPS, AGREE_MPS = 2.0, 1.5  # speed from which Doppler gives a heading, and agreement with wheels; S1 Table 1


class MonitorChoice(Config):
    """A monitor of the family, and the figures in which it differs from its kind; None: those of the kind."""

    kind: str = Field("odds", description="kind of the monitor, see 'lanebound monitors'; or context")
    false_alarm: float | None = Field(None, gt=0, lt=1, description="P_FA of its test at an epoch [-]")
    satellite_prior: float | None = Field(None, gt=0, lt=1, description="P(fault) of a code [-]")
    code_sigma_m: float | None = Field(None, gt=0, description="deviation of its weight model at 45 dB-Hz [m]")
    hal_m: float | None = Field(None, gt=0, description="alert limit of road RAIM [m]")
    errors: str | None = Field(None, description="preset or file of fit-errors, of kinds with fitted laws")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        """The name of a kind in place of a mapping."""
        return {"kind": data} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _guards_a_drive(self) -> MonitorChoice:
        kind, there = monitor_named(self.kind), {"codes", "fit", "steps", "map"}
        if "fixed" in kind.needs:
            raise ConfigError(
                f"kind must be a monitor of codes, got {self.kind!r}, of fixed carriers: 'navigator: {{kind: "
                "rtk_reckoning}' is that monitor in a drive, with the risk of its fixes"
            )
        anchored = {level.value for level in MEMORY if level not in GOES_ON}
        if not there.issuperset(kind.needs) or kind.changes.get("level") in anchored:
            raise ConfigError(
                f"kind must be a monitor of codes without an anchor, got {self.kind!r}, which needs "
                f"{' and '.join(kind.needs)}: choose another one of 'lanebound monitors'"
            )
        if "fit" in kind.needs and self.errors is None:
            raise ConfigError(f"errors must be given for {self.kind!r}, got nothing: name a preset of fit-errors")
        return self

    def config(self) -> FamilyMonitorConfig:
        """The configuration of the monitor."""
        own = {key: value for key, value in self.to_dict().items() if value is not None}
        changed = {key: value for key, value in own.items() if key not in ("kind", "errors")}
        fitted = {} if self.errors is None else FittedErrors.named(self.errors).changes()
        return monitor_named(self.kind).config(fitted | changed)


class MonitoredCodesConfig(NavigatorConfig):
    """Codes under a monitor; wheels and gyro in between."""

    kind: Literal["monitored_codes"] = "monitored_codes"
    gnss: GnssConfig = GnssConfig(undifferenced=True)
    monitor: MonitorChoice = MonitorChoice()
    budget: CodeBudget = CodeBudget()
    interval_s: float = Field(1.0, ge=0, description="time between two code positions [s]")
    speed_sigma_mps: float = Field(0.1, gt=0, description="error of wheel speed that lasts, 1 sigma [m/s]; S1: 0.05")
    gyro_bias_radps: float = Field(2e-3, gt=0, description="bias of the gyro, 1 sigma [rad/s]; a consumer's turn-on")
    longest_s: float = Field(30.0, gt=0, description="longest time by wheels and gyro with a level [s]")

    @model_validator(mode="before")
    @classmethod
    def _with_codes(cls, data: Any) -> Any:
        """Undifferenced codes are computed, whatever the instruments of a sky say; monitor ``context`` is two."""
        data = with_context(data)
        given = data.get("gnss") if isinstance(data, Mapping) else None
        if isinstance(given, Mapping):
            return {**data, "gnss": {**given, "undifferenced": True}}
        return {**data, "gnss": given.replace(undifferenced=True)} if isinstance(given, GnssConfig) else data

    @model_validator(mode="after")
    def _has_codes(self) -> MonitoredCodesConfig:
        if not self.gnss.undifferenced:
            raise ConfigError("gnss.undifferenced must be true, got false: this kind needs undifferenced codes")
        detector = self.gnss.reflection_detector
        if self.reads_flags and (detector.kind == "none" or detector.use != "flag"):
            raise ConfigError(
                f"gnss.reflection_detector must flag signals for monitor {self.monitor.kind!r}, got kind "
                f"{detector.kind!r} and use {detector.use!r}: set a kind, and use: flag"
            )
        if any(self.positioning.lever_arm_m):
            raise ConfigError(
                "positioning.antenna_forward_m and antenna_right_m must be 0 for monitored_codes, got "
                f"{self.positioning.lever_arm_m}: this kind positions the antenna; set both to 0"
            )
        return self

    @property
    def reads_flags(self) -> bool:
        """A monitor that takes a map reads them in its place."""
        return "map" in monitor_named(self.monitor.kind).needs


def with_context(data: Any) -> Any:
    """Data with ``monitor: {kind: context, ...}`` as those of its parts: weighted RAIM (S5 equations 1 to 4) for the
    position, and the context monitor of codes, which raises alerts."""
    monitor = data.get("monitor") if isinstance(data, Mapping) else None
    monitor = {"kind": monitor} if monitor == CONTEXT else monitor
    if not isinstance(monitor, Mapping) or monitor.get("kind") != CONTEXT:
        return data
    own = {key: value for key, value in monitor.items() if key in MonitorChoice.model_fields}
    more = {key: value for key, value in monitor.items() if key not in own}
    given = data.get("context")
    given = given.to_dict() if isinstance(given, Config) else given
    return {
        **data, "monitor": {**own, "kind": "weighted"}, "context": deep_merge(
            {"alerts": True, "judges": "codes", **(given or {})}, more
        ),
    }  # fmt: skip


@dataclass
class CodeBelief:
    """Position (B, 3) [m], heading and its deviation (B,) [rad], level at each risk (B, R) [m], times (B,) [s]; the
    displacement since the monitor was asked (B, 2) [m], its deviation (B,), inf where the monitor begins anew, and the
    memory of the monitor."""

    position_m: Array
    heading_rad: Array
    sigma_heading_rad: Array
    level_m: Array
    sigma_m: Array
    since_fix_s: Array
    since_calibration_s: Array
    due_s: Array
    alert: AlertState
    step_m: Array
    step_sigma_m: Array
    memory: Memory | None


class MonitoredCodesNavigator(Navigator):
    """See the module."""

    config: MonitoredCodesConfig
    radial_levels = True

    def prepare(self) -> None:
        """Risks, their factors and the monitor."""
        self._monitor = self.config.monitor.config()
        self._risks = np.array([case.integrity_risk for case in self.config.cases])
        self._factor = normal_factor(self._risks)
        correlation = bound_correlation(*self.config.positioning.doppler.tau_range_s, self.config.dt_s)
        self._lasting = float(np.sqrt(correlation.course))

    def initial_belief(self, batch: int) -> CodeBelief:
        """Nothing is known."""
        zero, never = np.zeros(batch), np.full(batch, np.inf)
        return CodeBelief(
            np.zeros((batch, 3)), zero.copy(), np.full(batch, np.pi), np.full((batch, self._risks.size), np.inf),
            never.copy(), never.copy(), never.copy(), zero.copy(), AlertState.initial(batch), np.zeros((batch, 2)),
            never.copy(), new_memory(self._monitor, batch, len(self.track.system), self._risks.size),
        )  # fmt: skip

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """A prior heading."""
        self.state.belief.heading_rad[:], self.state.belief.sigma_heading_rad[:] = heading_rad, sigma_rad

    def place_rows(
        self, rows: Any, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_heading_rad: float
    ) -> None:
        """A prior pose, whose position has the level of a normal error."""
        b = self.state.belief
        b.position_m[rows, :2], b.heading_rad[rows], b.sigma_heading_rad[rows] = (
            position_en_m, heading_rad, sigma_heading_rad,
        )  # fmt: skip
        b.level_m[rows], b.sigma_m[rows], b.since_fix_s[rows], b.due_s[rows] = self._factor * sigma_m, sigma_m, 0.0, 0.0
        b.step_sigma_m[rows] = np.inf

    def locate(self, m: Measurements) -> Solution:
        """Move, calibrate, fix where due, and report."""
        m = with_finite(m)
        velocity = self._move(m)
        count = self._calibrate(m)
        hdop, satellites, excluded = self._fix(m)
        return self._report(m, velocity, count, hdop, satellites, excluded)

    def _move(self, m: Measurements) -> Array:
        """Dead reckoning over the epoch and the growth of levels; returns the velocity (B, 2)."""
        c, b = self.config, self.state.belief
        speed, turn = m.odometer.speed_mps, m.imu.delta_theta_rad[:, 2]
        middle = b.heading_rad + 0.5 * turn
        velocity = speed[:, None] * np.stack([np.sin(middle), np.cos(middle)], -1)
        b.position_m[:, :2] += c.dt_s * velocity
        b.step_m += c.dt_s * velocity
        b.heading_rad = wrap_angle(b.heading_rad + turn)
        drift = c.dt_s * c.gyro_bias_radps + c.positioning.heading.gyro_scale * np.abs(turn)
        b.sigma_heading_rad = np.minimum(b.sigma_heading_rad + drift, np.pi)
        grown = c.dt_s * np.hypot(c.speed_sigma_mps * (np.abs(speed) > 0.0), np.abs(speed) * b.sigma_heading_rad)
        b.level_m += self._factor * grown[:, None]
        b.sigma_m += grown
        b.step_sigma_m += grown
        for since in (b.since_fix_s, b.since_calibration_s, b.due_s):
            since += c.dt_s
        b.level_m[b.since_fix_s > c.longest_s] = np.inf
        return np.asarray(velocity)

    def _calibrate(self, m: Measurements) -> NDArray[np.int64]:
        """Heading by Doppler where its residuals are consistent and it agrees with the wheels; returns the number of
        its satellites. Its deviation is that of a white error that bounds the correlation of range rates in time, so
        that repeating them does not feign precision."""
        b, los = self.state.belief, m.sky.los_enu[m.sky.index]
        los = np.where(m.gnss.tracked[..., None], los, UP)
        deviation = self.config.positioning.doppler.sigma_mps / np.maximum(los[..., 2], LEAST_SINE)
        rates = CodeEpochs.of(m.gnss.range_rate_mps, los, deviation, m.gnss.tracked, 0)
        fit = solve_codes(rates)
        speed, wheel = np.hypot(fit.x_m[:, 0], fit.x_m[:, 1]), m.odometer.speed_mps
        good = (fit.df > 0) & (fit.wsse <= global_threshold(fit.df, self._monitor.false_alarm))
        good &= fit.solved & (np.abs(wheel) > CALIBRATE_MPS) & (np.abs(speed - np.abs(wheel)) < AGREE_MPS)
        back = np.where(wheel < 0.0, np.pi, 0.0)
        off = wrap_angle(np.arctan2(fit.x_m[:, 0], fit.x_m[:, 1]) + back - b.heading_rad)
        sigma = np.where(good, self._lasting * fit.major_m / np.maximum(speed, 0.1), 1.0)
        share = np.where(good, b.sigma_heading_rad**2 / (b.sigma_heading_rad**2 + sigma**2), 0.0)
        b.heading_rad = b.heading_rad + share * off
        b.sigma_heading_rad = np.where(good, np.sqrt(share) * sigma, b.sigma_heading_rad)
        b.since_calibration_s[good] = 0.0
        return np.asarray(fit.used.sum(-1), dtype=np.int64)

    def _fix(self, m: Measurements) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Code positions where due and allowed by the monitor; HDOP, satellites and exclusions (B,)."""
        b, batch = self.state.belief, self.batch
        hdop, none = np.full(batch, np.inf), np.zeros(batch, np.int64)
        due = np.flatnonzero(b.due_s >= self.config.interval_s - 0.5 * self.config.dt_s)
        if not due.size:
            return hdop, none, none.copy()
        epochs = code_epochs(m, self.config.budget, due)
        found = self._asked(epochs, due)
        fit = solve_codes(epochs.with_codes(used=found.used))
        usable = found.usable & fit.solved & np.isfinite(found.hpl_m[:, 0])  # without codes it is dead reckoning's
        rows = due[usable]
        b.position_m[rows], b.level_m[rows] = found.position_enu_m[usable], found.hpl_m[usable]
        b.sigma_m[rows], b.since_fix_s[rows] = fit.major_m[usable], 0.0
        b.due_s[due] = 0.0
        unit = solve_codes(epochs.with_codes(sigma_m=np.ones_like(epochs.sigma_m)))
        hdop[due] = np.where(unit.solved, unit.hdop_m, np.inf)
        satellites, excluded = none.copy(), none.copy()
        satellites[due], excluded[due] = fit.used.sum(-1), found.excluded.sum(-1)
        return hdop, satellites, excluded

    def _asked(self, epochs: CodeEpochs, due: NDArray[np.int64]) -> MonitorVerdicts:
        """Verdicts of the monitor, whose memory goes on."""
        b = self.state.belief
        if b.memory is None:
            return watch(epochs, self._monitor, self._risks)
        step = np.concatenate([b.step_m[due], np.zeros((due.size, 1))], 1)
        moved = replace(epochs, step_enu_m=step, step_sigma_m=b.step_sigma_m[due])
        part = b.memory.take(due)
        found = watch(moved, self._monitor, self._risks, part)
        b.memory.put(due, part)
        b.step_m[due], b.step_sigma_m[due] = 0.0, 0.0
        return found

    def _report(
        self, m: Measurements, velocity: Array, count: NDArray[np.int64], hdop: Array, satellites: NDArray[np.int64],
        excluded: NDArray[np.int64],
    ) -> Solution:  # fmt: skip
        """The belief as a solution; no position without a finite deviation."""
        b, c = self.state.belief, self.config
        placed = np.isfinite(b.position_m[:, :2]).all(-1) & np.isfinite(b.heading_rad)
        b.position_m[~placed], b.level_m[~placed], b.sigma_m[~placed] = 0.0, np.inf, np.inf
        level, there = b.level_m[:, 0].copy(), np.isfinite(b.sigma_m)
        cause = np.where(there, AlertReason.NONE.code, AlertReason.INITIALISING.code)
        status = step(c.alert, b.alert, level, level, c.dt_s, cause=cause)
        recent = b.since_fix_s <= 1.5 * max(c.interval_s, c.dt_s)
        mode = np.where(recent, int(Mode.CODE), int(Mode.IMU_ODOMETER))
        sigma = np.where(there, b.sigma_m, 0.0)
        return replace(
            Solution.blank(m, self._risks.size),
            position_en_m=b.position_m[:, :2].copy(), heading_rad=b.heading_rad.copy(), velocity_en_mps=velocity,
            covariance_en_m2=np.square(sigma)[:, None, None] * np.eye(2), sigma_at_m=b.sigma_m.copy(),
            sigma_ct_m=b.sigma_m.copy(), pl_at_m=level, pl_ct_m=level.copy(),
            pl_cases_m=np.repeat(b.level_m[:, :, None], 2, axis=2), mode=np.where(there, mode, int(Mode.NONE)),
            alert=status.alert, available=status.available, reason=status.reason, hdop=hdop, satellites=satellites,
            satellites_doppler=count, excluded=excluded, since_calibration_s=b.since_calibration_s.copy(),
        )  # fmt: skip


UP = np.array([0.0, 0.0, 1.0])


def code_epochs(m: Measurements, budget: CodeBudget, rows: NDArray[np.int64]) -> CodeEpochs:
    """The undifferenced codes of some vehicles as epochs of the monitor family."""
    g, at = m.gnss, m.sky.index[rows]
    assert g.raw_code_m is not None  # the configuration asks for it
    code, elevation = g.raw_code_m[rows, :, BAND], m.sky.elevation_rad[at]
    used = g.tracked[rows] & (code != 0.0)
    los = np.where(used[..., None], m.sky.los_enu[at], UP)
    return CodeEpochs.of(
        code, los, budget.code(elevation, g.cn0_dbhz[rows]), used, m.sky.system.astype(np.int64),
        cn0_dbhz=g.cn0_dbhz[rows], elevation_rad=elevation, time_s=np.full(rows.size, m.time_s),
        shadowed=None if g.reflected is None else g.reflected[rows],
    )  # fmt: skip


register_navigator(MonitoredCodesConfig, MonitoredCodesNavigator)
