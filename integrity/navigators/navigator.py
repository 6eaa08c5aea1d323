"""The corridor: an epoch of a batch of vehicles through sky, sensors, positioning and monitoring, truth to belief.

>>> from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
>>> navigator = Navigator.nominal(NavigatorConfig(), seeds=[1, 2, 3], duration_s=60.0)   # three vehicles, open sky
>>> solution = navigator.step(truth)                                                     # truth: what really happens
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass
from enum import Enum
from functools import lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError, InputError, require_finite
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.alerts import AlertConfig, AlertState
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import GROWTH_SIZE, P_EE, P_NN, VAR_TH
from lanebound.integrity.monitoring.doppler_separation_kernel import APART_ROWS
from lanebound.integrity.monitoring.exclusion import FdeConfig, Search
from lanebound.integrity.monitoring.jump_kernel import D_E, D_N
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, false_alarm_factor, upper_quantile
from lanebound.integrity.monitoring.significance import Linking
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.motion.truth_kernel import all_finite
from lanebound.integrity.navigators import navigator_columns_kernel as col
from lanebound.integrity.navigators import navigator_kernel as nk
from lanebound.integrity.navigators.rtk_declared import declared_rtk
from lanebound.integrity.navigators.rtk_stage_kernel import NX as RTK_STATE_SIZE
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.config import PositioningConfig
from lanebound.integrity.sensors import corrections as links
from lanebound.integrity.sensors import gnss as receiver
from lanebound.integrity.sensors.area import initial_area
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sensors.imu import ImuConfig, initial_imu
from lanebound.integrity.sensors.instruments import Instruments, InstrumentState, Measurements
from lanebound.integrity.sensors.odometer import OdometerConfig, initial_odometer
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.systems import FIXABLE, WAVELENGTH_M
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["Form", "Measurements", "Navigator", "NavigatorConfig", "NavigatorState", "PlCase"]

Array = NDArray[np.float64]
LOCATE_US = 20.0  # of one thread for a vehicle and epoch, measured
LEVER_RISK_SHARE = 0.01  # of the smallest risk, for the heading by which an antenna tells of the reference point


class Form(Enum):
    """How the RTK protection level is found."""

    ROOT = "root"
    CLOSED = "closed"


class PlCase(Config):
    """One protection level to report: a risk, a variant and a form."""

    integrity_risk: float = Field(gt=0, lt=1, description="total horizontal risk [-]")
    variant: Variant = Field(Variant.EXACT, description="exact or published factors and biases")
    form: Form = Field(Form.ROOT, description="multi-hypothesis root (S2 eq 10-11) or closed form (S1 eq 17)")

    @property
    def row(self) -> int:
        """Row of the kernel's table of risks: root, closed, published."""
        if self.variant is Variant.PUBLISHED:
            return 2
        return 0 if self.form is Form.ROOT else 1


class NavigatorConfig(Config):
    """Instruments, declared errors and rules of one vehicle."""

    dt_s: float = Field(0.1, gt=0, le=1, description="length of an epoch [s]; 10 Hz GNSS, S1 section 4")
    sky: SkyConfig = SkyConfig()
    gnss: GnssConfig = GnssConfig()
    corrections: CorrectionsConfig = CorrectionsConfig()
    imu: ImuConfig = ImuConfig()
    odometer: OdometerConfig = OdometerConfig()
    positioning: PositioningConfig = PositioningConfig()
    fde: FdeConfig = FdeConfig()
    risk: RiskConfig = RiskConfig()
    form: Form = Field(Form.ROOT, description="form of the operative RTK protection level")
    more_levels: tuple[PlCase, ...] = Field(
        (), description="further protection levels to report beside the operative one"
    )
    alert: AlertConfig = AlertConfig()

    @model_validator(mode="after")
    def _levels_fit_the_tests(self) -> Self:
        if self.fde.alpha < self.risk.false_alarm:
            raise ConfigError(
                f"fde.alpha must be >= risk.false_alarm = {self.risk.false_alarm}, got {self.fde.alpha}: "
                "the levels count on the thresholds of false_alarm"
            )
        if (
            self.fde.global_first
            or self.fde.linking is not Linking.BONFERRONI
            or self.fde.search is not Search.SEPARATION
        ):
            raise ConfigError(
                "fde must search by SEPARATION with BONFERRONI and without global_first: the levels count on that test"
            )
        if self.risk.direction_test or self.risk.monitors_constellations:
            raise ConfigError(
                "risk.direction_test and risk.constellation_prior must be off in a navigator, which tests satellites "
                "along and across the track: use monitoring.separation and monitoring.protection for them"
            )
        return self

    @property
    def cases(self) -> tuple[PlCase, ...]:
        """All protection levels reported, the operative one first."""
        first = PlCase(integrity_risk=self.risk.integrity_risk, variant=self.risk.variant, form=self.form)
        return (first, *self.more_levels)


@dataclass
class NavigatorState(InstrumentState):
    """Everything that lasts from epoch to epoch: the instruments' own state, and the belief's.

    ``belief`` (B, NX), ``rtk`` (B, NX) and ``growth`` (B, 2, NP) are the flat columns of
    :mod:`.navigator_columns_kernel`, :mod:`.rtk_stage_kernel` and :mod:`.monitoring.dead_reckoning_pl_kernel`, which
    all R levels share;
    ``start`` (B, 2, R, 4) is what an RTK position left to each, ``apart`` (B, 2, APART_ROWS, S) the separations of
    :mod:`.monitoring.doppler_separation_kernel`; each since the last RTK position, and since the one that the witness
    (:mod:`.monitoring.jump_kernel`) began at. ``held`` (B, S), ``integers`` (B, S, 2), ``fix_id`` and ``fix_risk``
    (B, S) are the ambiguities held; ``last_phase_m`` (B, S, 2) serves to find slips.
    """

    alert: AlertState
    belief: Array
    rtk: Array
    last_phase_m: Array
    growth: Array
    start: Array
    apart: Array
    held: NDArray[np.bool_]
    integers: Array
    fix_id: NDArray[np.int64]
    fix_risk: Array

    def copy(self) -> NavigatorState:
        """An independent copy."""
        return copy.deepcopy(self)


class Navigator:
    """Sensing and belief of a batch of vehicles.

    Parameters
    ----------
    config : NavigatorConfig
    track : SkyTrack
        Satellites over the place and time of the drive.
    mask : SkyMask
        What buildings leave of the sky along the street.
    seeds : one seed for each vehicle, or one int with ``batch``
    faults : FaultSchedule, optional
    area_seed : int, optional
        One area for all vehicles of this and of any navigator with the same seed, clock and sky: the same atmosphere,
        reference station and outages of its network (:mod:`.sensors.area`). Without it each vehicle has its own.

    Raises
    ------
    InputError
        When the seeds are negative or do not fit ``batch``.
    """

    def __init__(
        self,
        config: NavigatorConfig,
        track: SkyTrack,
        mask: SkyMask,
        seeds: int | Sequence[int],
        batch: int | None = None,
        faults: FaultSchedule | None = None,
        area_seed: int | None = None,
    ) -> None:
        self.config, self.track, self.mask = config, track, mask
        self.faults = faults or FaultSchedule(())
        self._tables, self._lever_m = _Tables.of(config, track.system), config.positioning.lever_arm_m
        self._instruments = Instruments.of(config.gnss, config.corrections, config.imu, config.odometer, config.dt_s)
        area = Streams(seeds, batch) if area_seed is None else Streams([area_seed])
        self.state = self._initial(Streams(seeds, batch), area)

    @classmethod
    def nominal(
        cls, config: NavigatorConfig, seeds: int | Sequence[int], batch: int | None = None, duration_s: float = 600.0
    ) -> Navigator:
        """A navigator under the nominal constellations of the configuration and an open sky."""
        return cls(config, SkyTrack.from_config(config.sky, duration_s), SkyMask.open(), seeds, batch)

    def _initial(self, streams: Streams, area_streams: Streams) -> NavigatorState:
        c, batch, n_sat = self.config, streams.batch, len(self.track.system)
        area = initial_area(c.gnss, c.corrections, n_sat, c.dt_s, area_streams)
        sky = self.track.at(self.track.start_s, np.zeros(batch, dtype=np.int64))
        heading = c.positioning.heading
        belief = np.zeros((batch, col.NX))
        belief[:, col.P_HH] = np.deg2rad(heading.initial_sigma_deg) ** 2
        belief[:, col.P_BB] = heading.bias_initial_radps**2
        belief[:, [col.SINCE_RTK, col.SINCE_CAL, col.WITNESS_S]] = np.inf
        return NavigatorState(
            streams=streams,
            area=area,
            gnss=receiver.initial_state(c.gnss, sky, streams),
            corrections=links.initial_state(c.corrections, area.network, n_sat, c.dt_s, streams),
            imu=initial_imu(c.imu, streams),
            odometer=initial_odometer(c.odometer, streams),
            alert=AlertState.initial(batch),
            belief=belief,
            rtk=np.zeros((batch, RTK_STATE_SIZE)),
            last_phase_m=np.zeros((batch, n_sat, 2)),
            growth=np.zeros((batch, 2, GROWTH_SIZE)),
            start=np.zeros((batch, 2, len(c.cases), 4)),
            apart=np.zeros((batch, 2, APART_ROWS, n_sat)),
            held=np.zeros((batch, n_sat), dtype=np.bool_),
            integers=np.zeros((batch, n_sat, 2)),
            fix_id=np.zeros((batch, n_sat), dtype=np.int64),
            fix_risk=np.zeros((batch, n_sat)),
        )

    @property
    def batch(self) -> int:
        """Number of vehicles."""
        return self.state.streams.batch

    @property
    def epoch(self) -> int:
        """Epochs that its clock has counted."""
        return self.state.area.network.epoch

    def another(self, streams: Streams) -> Navigator:
        """A navigator of the same configuration for other vehicles, each in an area of its own, just switched on."""
        other = copy.copy(self)
        other.state = other._initial(streams, streams)
        return other

    def adopt(self, rows: NDArray[np.int64], other: Navigator, theirs: NDArray[np.int64]) -> None:
        """Take over the vehicles ``theirs`` (n,) of another navigator as ``rows`` (n,), in place of those there.

        Each keeps a time of its own, wherever the clocks of both are, so that from then on ``measure`` must be told the
        sky of each; streams are not taken over.

        Raises
        ------
        InputError
            Vehicles of either navigator share an area, are seeded jointly, or suffer faults, which go by one clock.
        """
        for name, navigator in (("this navigator", self), ("other", other)):
            navigator._require_single(name)
        _hand_over(self.state, other.state, rows, theirs)
        mine, network = self.state.area.network, other.state.area.network
        mine.begun[rows] = mine.epoch - network.own_epoch[theirs]

    def _require_single(self, name: str) -> None:
        """Raise InputError unless vehicles share nothing, neither generators nor areas nor a schedule of faults."""
        areas, seeds = self.state.area.network.up.shape[0], self.state.streams.seeds
        if areas != self.batch:
            raise InputError(f"{name} must have an area for each of {self.batch} vehicles, got {areas}: "
                             "give it no area_seed")  # fmt: skip
        if seeds is None:
            raise InputError(f"{name} must have a seed for each vehicle, got one for all: give it a list of seeds")
        if self.faults.faults:
            raise InputError(f"{name} must have no faults, got {len(self.faults.faults)}: their times are of one clock")

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        """Give the vehicles a prior heading, (B,) azimuth and its 1-sigma, as from a compass or the last drive."""
        self.state.belief[:, col.HEADING] = heading_rad
        self.state.belief[:, col.P_HH] = sigma_rad**2
        self.state.belief[:, col.SINCE_CAL] = 0.0

    def place(
        self,
        position_en_m: Array,
        heading_rad: Array,
        sigma_m: float,
        sigma_heading_rad: float,
        rows: NDArray[np.int64] | slice = slice(None),
    ) -> None:
        """Give the vehicles of ``rows`` (all by default) a prior position and heading, as from a drive before.

        position_en_m (n, 2), heading_rad (n,) azimuths; 1-sigma on each horizontal axis and of the heading. They then
        dead-reckon from there until RTK is found; a slot may so be handed to another vehicle.

        Raises
        ------
        InputError
            When an entry is not finite or a sigma is not positive.
        """
        if not (sigma_m > 0.0 and sigma_heading_rad > 0.0):
            raise InputError(f"sigma_m and sigma_heading_rad must be > 0, got {sigma_m} and {sigma_heading_rad}")
        belief, growth = self.state.belief, self.state.growth
        belief[rows, col.EAST : col.NORTH + 1] = require_finite("position_en_m", position_en_m)
        belief[rows, col.HEADING] = require_finite("heading_rad", heading_rad)
        belief[rows, col.P_HH], belief[rows, col.P_HB] = sigma_heading_rad**2, 0.0
        belief[rows, col.SINCE_RTK] = belief[rows, col.SINCE_CAL] = 0.0
        belief[rows, col.HAS_VEL] = belief[rows, col.FIXED_S] = belief[rows, col.REST_S] = 0.0
        belief[rows, col.UNBOUNDED] = belief[rows, col.CONFLICT_S] = belief[rows, col.REFUSED_S] = 0.0
        belief[rows, col.INITIALISED], belief[rows, col.WITNESS_S] = 1.0, np.inf
        belief[rows, col.APART :] = 0.0  # with the memory of the odometer's watch
        self.state.start[rows] = self.state.apart[rows] = 0.0
        self.state.held[rows], self.state.last_phase_m[rows] = False, 0.0
        self.state.odometer.last_true_mps[rows] = np.nan  # no acceleration, so no slip, in the first epoch
        growth[rows] = 0.0
        growth[rows, ..., [P_EE]] = growth[rows, ..., [P_NN]] = sigma_m**2
        growth[rows, ..., [VAR_TH]] = sigma_heading_rad**2

    def snapshot(self) -> NavigatorState:
        """An independent copy of everything that lasts."""
        return self.state.copy()

    def restore(self, state: NavigatorState) -> None:
        """Continue from a snapshot, with the same draws."""
        self.state = state.copy()

    def step(self, truth: Truth) -> Solution:
        """Measure the truth of one epoch and locate the vehicles.

        Raises
        ------
        InputError
            When the truth has another batch or epoch length, or lies outside the sky track.
        """
        return self.locate(self.measure(truth))

    def measure(self, truth: Truth, sky: SkyView | None = None) -> Measurements:
        """What the instruments say of this epoch: the only place where truth is read.

        ``sky`` holds the satellites of the track as the vehicles see them, when that is not by the truth's clock: each
        may be at an hour of its own.

        Raises
        ------
        InputError
            As :meth:`step`; or there is no ``sky`` for vehicles that were adopted, whose times differ.
        """
        self._require_fitting(truth)
        if sky is None:
            if self.state.area.network.begun.any():
                raise InputError("sky must be given for vehicles that were adopted, got None: each has its own time")
            sky = self.track.at(self.track.start_s + truth.time_s, np.zeros(self.batch, dtype=np.int64))
        if self.faults.faults and self.faults.active(truth.time_s):
            effects = self.faults.effects(truth.time_s, truth.dt_s, sky, self.batch)
        else:
            effects = _no_effects(self.batch, sky.satellites)
        at_antenna = truth.at(*self._lever_m) if any(self._lever_m) else truth
        return self._instruments.sense(self.state, sky, self.mask, at_antenna, effects)

    def _require_fitting(self, truth: Truth) -> None:
        """Raise InputError unless the truth is finite, of this batch and of an epoch's length."""
        if truth.batch != self.batch:
            raise InputError(f"truth must have {self.batch} vehicles, got {truth.batch}: one row for each seed")
        if abs(truth.dt_s - self.config.dt_s) > 1e-9:
            raise InputError(f"truth.dt_s must be {self.config.dt_s}, got {truth.dt_s}: step at the navigator's rate")
        if not all_finite(truth.position_enu_m, truth.velocity_enu_mps, truth.heading_rad, truth.arc_m):
            for name in ("position_enu_m", "velocity_enu_mps", "heading_rad", "arc_m"):
                require_finite(f"truth.{name}", getattr(truth, name))

    def locate(self, m: Measurements) -> Solution:
        """The belief after the measurements of one epoch; reads nothing else."""
        s, t, g, batch = self.state, self._tables, m.gnss, self.batch
        out, levels = np.empty((batch, col.NO)), np.empty((batch, t.k_dead.shape[0], 2))
        covariance = np.empty((batch, 2, 2))
        run_rows(
            nk.run_some, batch, m.sky.los_enu, m.sky.system, m.sky.index, g.tracked, g.cn0_dbhz,
            g.code_m, g.phase_m, g.range_rate_mps, g.lock_lost, g.corrections_age_s, m.imu.delta_theta_rad,
            m.imu.delta_v_mps, m.odometer.speed_mps,
            t.par, t.rtk_par, t.mode_limits, t.heading_limits, t.wavelength, t.fixable, t.fit, t.chi2, t.normal, t.fde,
            t.risks, t.shares, t.spent, t.priors, t.k_fa, t.k_published, t.k_dead, t.published, t.operative_published,
            t.alert_limits, t.drift_group, s.belief, s.rtk, s.last_phase_m, s.growth, s.start, s.apart, s.held,
            s.integers, s.fix_id, s.fix_risk, s.alert.alert, s.alert.reason, s.alert.onset_s, s.alert.clear_s, out,
            levels, covariance, row_us=LOCATE_US,
        )  # fmt: skip
        return self._solution(m, out, levels, covariance)

    def _solution(self, m: Measurements, out: Array, levels: Array, covariance: Array) -> Solution:
        s = self.state
        belief, whole = s.belief.copy(), out[:, : col.N_WHOLE].astype(np.int64)
        return Solution(
            time_s=m.time_s,
            position_en_m=belief[:, col.EAST : col.NORTH + 1],
            heading_rad=belief[:, col.HEADING],
            velocity_en_mps=belief[:, col.VEL_E : col.VEL_N + 1],
            speed_mps=m.odometer.speed_mps,
            covariance_en_m2=covariance,
            sigma_at_m=out[:, col.O_SIGMA_AT],
            sigma_ct_m=out[:, col.O_SIGMA_CT],
            pl_at_m=levels[:, 0, 0],
            pl_ct_m=levels[:, 0, 1],
            pl_cases_m=levels,
            mode=whole[:, col.O_MODE],
            rtk=whole[:, col.O_RTK],
            alert=s.alert.alert.copy(),
            available=out[:, col.O_AVAILABLE] > 0.0,
            reason=s.alert.reason.copy(),
            hdop=out[:, col.O_HDOP],
            satellites=whole[:, col.O_SATELLITES],
            satellites_doppler=whole[:, col.O_DOPPLER],
            excluded=whole[:, col.O_EXCLUDED],
            since_rtk_s=belief[:, col.SINCE_RTK],
            since_calibration_s=belief[:, col.SINCE_CAL],
            corrections_age_s=m.gnss.corrections_age_s,
            wrong_fix_risk=out[:, col.O_WRONG],
            held=s.held.copy(),
            doubt_en_m=belief[:, col.DOUBT + D_E : col.DOUBT + D_N + 1],
        )


def _hand_over(mine: Any, other: Any, rows: NDArray[np.int64], theirs: NDArray[np.int64]) -> None:
    """Copy the rows of every array of a state, and of the states in it; clocks and streams stay."""
    for name, value in vars(other).items():
        if isinstance(value, np.ndarray):
            getattr(mine, name)[rows] = value[theirs]
        elif is_dataclass(value):
            _hand_over(getattr(mine, name), value, rows, theirs)


@lru_cache(maxsize=8)
def _no_effects(batch: int, satellites: int) -> FaultEffects:
    """No fault at all, in arrays that are never written but not marked so: kernels would be compiled twice."""
    return FaultEffects.blank(batch, satellites)


@dataclass(frozen=True)
class _Tables:
    """The configuration as the arrays that the kernel takes."""

    par: Array
    rtk_par: Array
    mode_limits: Array
    heading_limits: Array
    wavelength: Array
    fixable: NDArray[np.bool_]
    fit: Array
    chi2: Array
    normal: Array
    fde: Array
    risks: Array
    shares: Array
    spent: float
    priors: Array
    k_fa: Array
    k_published: Array
    k_dead: Array
    published: NDArray[np.bool_]
    operative_published: bool
    alert_limits: Array
    drift_group: NDArray[np.int64]

    @classmethod
    def of(cls, c: NavigatorConfig, system: NDArray[np.int64]) -> _Tables:
        n_sat, cases = len(system), c.cases
        thresholds = c.fde.tables(n_sat)
        modes = np.arange(n_sat + 10)
        risks = np.zeros((3, len(cases)))
        for i, case in enumerate(cases):
            risks[case.row, i] = case.integrity_risk
        published = np.array([case.variant is Variant.PUBLISHED for case in cases])
        total = np.array([case.integrity_risk for case in cases])
        wrong_fix = c.positioning.rtk.ambiguity_risk_share * total.min()
        of_lever = LEVER_RISK_SHARE * total.min() if any(c.positioning.lever_arm_m) else 0.0
        spent = c.risk.unmonitored_risk + of_lever
        budgets = c.risk.axis_budgets(total, spent + wrong_fix)
        k_dead = np.where(published[:, None], upper_quantile(total)[:, None], upper_quantile(0.5 * budgets))
        r = c.risk
        return cls(
            par=_declared(c, of_lever),
            rtk_par=declared_rtk(
                c.positioning.rtk, c.positioning.slips, len(c.gnss.bands), min(case.integrity_risk for case in c.cases)
            ),
            mode_limits=c.positioning.mode_limits,
            heading_limits=c.positioning.heading_limits,
            wavelength=np.ascontiguousarray(WAVELENGTH_M[:, list(c.gnss.bands)]),
            fixable=FIXABLE[system],
            fit=c.positioning.rtk.largest_misfits,
            chi2=np.ascontiguousarray(thresholds.global_chi2),
            normal=np.ascontiguousarray(thresholds.local_normal),
            fde=np.array([float(c.fde.global_first), float(c.fde.max_excluded), float(c.fde.min_redundancy)]),
            risks=risks,
            shares=np.array(
                [
                    float(share)
                    for share in (
                        r.monitors_constellations,
                        r.at_share,
                        r.fault_free_share,
                        r.subtract_multiple,
                        r.spend_unsolvable,
                    )
                ]
            ),
            spent=spent,
            priors=np.stack(r.priors()),
            k_fa=np.stack([false_alarm_factor(r.false_alarm, modes, v) for v in (Variant.EXACT, Variant.PUBLISHED)]),
            k_published=upper_quantile(total),
            k_dead=np.hstack([k_dead, budgets]),
            published=published,
            operative_published=bool(published[0]),
            alert_limits=c.alert.packed,
            drift_group=np.zeros(n_sat, dtype=np.int64),
        )


def _declared(c: NavigatorConfig, of_lever: float) -> Array:
    """The declared figures in the columns of the kernel's ``par``; ``of_lever`` is the risk spent on its heading."""
    r, d, h, o = c.positioning.rtk, c.positioning.doppler, c.positioning.heading, c.positioning.dead_reckoning
    values: dict[int, Any] = {
        col.DT: c.dt_s, col.CN0_KNEE: r.cn0_knee_dbhz, col.REFERENCE_BIAS: r.reference_bias_m, col.CONFIRM: r.confirm_s,
        col.DOP_SIGMA: d.sigma_mps, col.DOP_TAU: d.tau_s, col.DOP_BIAS: d.bias_mps,
        col.DOP_SIN_MASK: np.sin(np.deg2rad(d.elevation_mask_deg)), col.DOP_CN0_MIN: d.cn0_min_dbhz,
        col.ARW: h.angle_random_walk_rad, col.BIAS_WALK: h.bias_walk_radps,
        col.ODO_SIGMA: o.odometer_sigma_mps, col.ODO_TAU: o.odometer_tau_s, col.ODO_BIAS: o.odometer_bias_mps,
        col.HEADING_BIAS: np.deg2rad(o.heading_bias_deg), col.HEADING_DRIFT: np.deg2rad(o.heading_drift_degps),
        col.BIAS_INITIAL: h.bias_initial_radps,
        col.ODO_SCALE: o.odometer_scale, col.STILL_SPEED: o.standstill_speed_mps,
        col.FAULT_DURATION: c.risk.fault_duration_s,
        col.LEVER_FORWARD: c.positioning.antenna_forward_m, col.LEVER_RIGHT: c.positioning.antenna_right_m,
        col.LEVER_K: upper_quantile(0.5 * min(c.risk.at_share, 1.0 - c.risk.at_share) * of_lever) if of_lever else 0.0,
        col.AXLE: c.positioning.axle_m,
        col.AFTER_JUMP: r.jump_quarantine_s, col.AFTER_OUTAGE: r.return_quarantine_s, col.WITNESS_MOST_S: r.witness_s,
    }  # fmt: skip
    par = np.zeros(col.NP)
    par[col.WATCH_LIMITS :] = o.watch.packed(o)
    par[list(values)] = list(values.values())
    return par
