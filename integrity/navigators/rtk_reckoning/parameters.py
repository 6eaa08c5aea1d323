"""The declared figures of a configuration as the records and tables that the stages take."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring.alerts import alert_parameters
from lanebound.integrity.monitoring.detection_kernel import Thresholds
from lanebound.integrity.monitoring.exclusion import FdeConfig, fde_parameters, fde_thresholds
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, false_alarm_factor, upper_quantile
from lanebound.integrity.navigators.navigator import LevelForm, PlCase, Start
from lanebound.integrity.navigators.rtk_reckoning import records_kernel as rk
from lanebound.integrity.positioning.correlation import bound_correlation
from lanebound.integrity.positioning.motion_config import DeadReckoningConfig, DopplerConfig, HeadingConfig
from lanebound.integrity.positioning.parameters import (
    calibration_parameters,
    drift_parameters,
    mode_parameters,
    rtk_parameters,
    slip_parameters,
    watch_parameters,
)
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import SATELLITE
from lanebound.integrity.sky.systems import FIXABLE, WAVELENGTH_M

if TYPE_CHECKING:
    from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig

__all__ = ["LEVER_RISK_SHARE", "epoch_parameters", "epoch_tables", "satellite_table"]

Array = NDArray[np.float64]

SPENDABLE_SHARE = 0.005  # of the risk, for the fault of a system whose separation would make a level useless
MOST_DRIFTING = 64  # carriers excluded at most: as many as drift, while redundancy is left
LEVER_RISK_SHARE = 0.01  # of the smallest risk, for the heading that turns the lever arm


def epoch_parameters(c: RtkReckoningConfig) -> Records:
    """The parameters (1,) of PARAMETERS."""
    p, smallest = c.positioning, min(case.integrity_risk for case in c.cases)
    of_lever = LEVER_RISK_SHARE * smallest if any(p.lever_arm_m) else 0.0
    share = min(c.risk.at_share, 1.0 - c.risk.at_share)
    return one_record(
        rk.PARAMETERS,
        dt=c.dt_s,
        cold=c.start is Start.COLD,
        confirm=p.rtk.confirm_s,
        rtk=rtk_parameters(p.rtk, len(c.gnss.bands), smallest),
        slips=slip_parameters(p.slips),
        doppler=_doppler_rules(p.doppler, p.rtk, c.tests, c.dt_s),
        heading=_heading_rules(p.heading),
        odometer=_odometer_rules(p.dead_reckoning),
        modes=mode_parameters(p.mode, "imu_odometer" in c.modes),
        lever=one_record(
            rk.LEVER,
            forward=p.antenna_forward_m,
            right=p.antenna_right_m,
            k=upper_quantile(0.5 * share * of_lever) if of_lever else 0.0,
            axle=p.axle_m,
            axle_bound=p.axle_bound_m,
        ),
        jump=one_record(
            rk.JUMP_RULES,
            after_jump=p.rtk.jump_quarantine_s,
            after_outage=p.rtk.return_quarantine_s,
            backup=p.rtk.backup_s,
        ),
        drift=drift_parameters(p, c.dt_s),
        risk=risk_parameters(c.risk, of_lever, p.rtk.reference_bias_m),
        fde=fde_parameters(c.tests, c.risk.monitors_constellations),
        alert=alert_parameters(c.alert),
    )


def _doppler_rules(d: DopplerConfig, rtk: RtkConfig, tests: FdeConfig, dt_s: float) -> Records:
    correlation = bound_correlation(*d.tau_range_s, dt_s)
    return one_record(
        rk.DOPPLER_RULES,
        sigma=d.sigma_mps,
        decay=correlation.decay,
        white=correlation.white,
        course=correlation.course,
        bias=d.bias_mps,
        carriers=d.carriers,
        carrier_sigma=np.sqrt(2.0) * rtk.sigma_phase_m / dt_s,
        window=d.window_s,
        fde=fde_parameters(tests.replace(max_excluded=MOST_DRIFTING)),
        sin_mask=np.sin(np.deg2rad(d.elevation_mask_deg)),
        cn0_min=d.cn0_min_dbhz,
    )


def _heading_rules(h: HeadingConfig) -> Records:
    return one_record(
        rk.HEADING_RULES,
        angle_random_walk=h.angle_random_walk_rad,
        bias_walk=h.bias_walk_radps,
        bias_initial=h.bias_initial_radps,
        gyro_scale=h.gyro_scale,
        calibration=calibration_parameters(h),
    )


def _odometer_rules(o: DeadReckoningConfig) -> Records:
    return one_record(
        rk.ODOMETER_RULES,
        sigma=o.odometer_sigma_mps,
        tau=o.odometer_tau_s,
        bias=o.odometer_bias_mps,
        scale=o.odometer_scale,
        still_speed=o.standstill_speed_mps,
        heading_bias=np.deg2rad(o.heading_bias_deg),
        heading_drift=np.deg2rad(o.heading_drift_degps),
        watch=watch_parameters(o),
    )


def risk_parameters(risk: RiskConfig, of_lever: float, reference_bias_m: float) -> Records:
    """Figures (1,) of RISK_RULES; ``of_lever`` is the risk spent on the heading that turns the lever arm."""
    satellite, constellation = risk.priors()
    return one_record(
        rk.RISK_RULES,
        at_share=risk.at_share,
        fault_free_share=risk.fault_free_share,
        spent=risk.unmonitored_risk + of_lever,
        fault_duration=risk.fault_duration_s,
        reference_bias=reference_bias_m,
        constellations=risk.monitors_constellations,
        multiple=risk.subtract_multiple,
        tolerate=risk.spend_unsolvable,
        published=risk.variant is Variant.PUBLISHED,
        satellite_prior=satellite,
        constellation_prior=constellation,
        spendable=SPENDABLE_SHARE * risk.integrity_risk,
    )


def epoch_tables(c: RtkReckoningConfig, system: NDArray[np.int64]) -> rk.Tables:
    """The tables for satellites of these systems (S,)."""
    p, total = c.positioning, np.array([case.integrity_risk for case in c.cases])
    of_lever = LEVER_RISK_SHARE * total.min() if any(p.lever_arm_m) else 0.0
    wrong_fix = p.rtk.ambiguity_risk_share * total.min()
    spent = c.risk.unmonitored_risk + of_lever + wrong_fix
    wavelength = np.ascontiguousarray(WAVELENGTH_M[:, list(c.gnss.bands)])
    return rk.Tables(
        satellite_table(system, wavelength, FIXABLE[system], c.risk),
        mode_priors(system, c.risk),
        case_table(c.cases, c.risk, spent),
        *separation_thresholds(c, len(system)),
    )


def satellite_table(
    system: NDArray[np.int64], wavelength_m: NDArray[np.float64], fixable: NDArray[np.bool_], risk: RiskConfig
) -> Records:
    """Satellites (S,) of SATELLITE from their systems, the wavelengths (systems, bands) and what can be fixed (S,)."""
    out = np.zeros(len(system), SATELLITE)
    out["system"], out["fixable"], out["prior"] = system, fixable, risk.priors()[0][system]
    out["wavelength"][:, : wavelength_m.shape[1]] = wavelength_m[system]
    return out


def mode_priors(system: NDArray[np.int64], risk: RiskConfig) -> NDArray[np.float64]:
    """Fault probability of each fault mode of Doppler (W,): satellites, systems, in this order."""
    return np.concatenate([risk.priors()[0][system], risk.doppler_priors()[: int(system.max(initial=-1)) + 1]])


def case_table(cases: tuple[PlCase, ...], risk: RiskConfig, spent: float) -> Records:
    """The levels to report (R,) of CASE; ``spent`` is the risk of dead reckoning that is spent otherwise."""
    total = np.array([case.integrity_risk for case in cases])
    published = np.array([case.variant is Variant.PUBLISHED for case in cases])
    budgets = risk.axis_budgets(total, spent)
    out = np.zeros(len(cases), rk.CASE)
    out["risk"], out["published"], out["budget"], out["k_published"] = total, published, budgets, upper_quantile(total)
    out["form"] = [_form(case) for case in cases]
    out["k_dead"] = np.where(published[:, None], upper_quantile(total)[:, None], upper_quantile(0.5 * budgets))
    return out


def _form(case: PlCase) -> int:
    if case.variant is Variant.PUBLISHED:
        return rk.PUBLISHED
    return rk.MULTI_HYPOTHESIS if case.form is LevelForm.ROOT else rk.CLOSED


def separation_thresholds(c: RtkReckoningConfig, satellites: int) -> tuple[Thresholds, Array]:
    """Thresholds of the tests, and the factors of the same tests at ``risk.false_alarm``, which the levels count on.

    Tests of a larger ``fde.alpha`` have lower thresholds, so the levels hold for them too.
    """
    systems = c.risk.monitors_constellations
    counted = fde_thresholds(c.tests.replace(alpha=c.risk.false_alarm), satellites, systems)
    tests = fde_thresholds(c.tests, satellites, systems)
    published = false_alarm_factor(c.risk.false_alarm, np.arange(counted.limits.size), Variant.PUBLISHED)
    tests.limits["counted"], tests.limits["published"] = counted.limits["overall"], published[:, None]
    return tests, counted.factor
