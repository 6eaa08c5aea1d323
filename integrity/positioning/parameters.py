"""The configuration of positioning as its kernels take it: one record for each part."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri, ndtri

from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.positioning.config import ModeConfig, PositioningConfig
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.drift_watch_kernel import DRIFT_RULES
from lanebound.integrity.positioning.heading_kernel import CALIBRATION
from lanebound.integrity.positioning.mode_kernel import MODE_LIMITS
from lanebound.integrity.positioning.motion_config import DeadReckoningConfig, HeadingConfig
from lanebound.integrity.positioning.odometer_watch_kernel import WATCH_LIMITS
from lanebound.integrity.positioning.reflection_odds_kernel import REFLECTION_RULES
from lanebound.integrity.positioning.rtk_config import ReflectionHypothesesConfig, RtkConfig
from lanebound.integrity.positioning.rtk_kernel import FILTER_RULES, MOST_AMBIGUITIES, RTK_RULES
from lanebound.integrity.positioning.slip_watch_kernel import SLIP_RULES

__all__ = [
    "calibration_parameters",
    "drift_parameters",
    "mode_parameters",
    "reflection_parameters",
    "rtk_parameters",
    "slip_parameters",
    "watch_parameters",
]


def rtk_parameters(config: RtkConfig, bands: int, smallest_risk: float) -> Records:
    """RTK_RULES (1,) of :mod:`.rtk_kernel`; ``smallest_risk`` is that of the strictest level reported."""
    return one_record(
        RTK_RULES,
        bands=bands,
        sin_mask=np.sin(np.deg2rad(config.elevation_mask_deg)),
        cn0_min=config.cn0_min_dbhz,
        cn0_knee=config.cn0_knee_dbhz,
        fade=config.fade_db,
        fade_decay=config.fade_decay_dbps,
        sigma_code=config.sigma_code_m,
        sigma_phase=config.sigma_phase_m,
        sigma_phase_integrity=config.sigma_phase_integrity_m,
        phase_bias=config.phase_bias_m,
        age_sigma=config.age_sigma_mps,
        max_age=config.max_age_s,
        fix_max_age=config.fix_max_age_s,
        fix_limit=config.ambiguity_risk_share * smallest_risk,
        ratio_min=config.ratio_min,
        posterior=config.posterior_margin**2,
        misfit=chdtri(np.maximum(np.arange(MOST_AMBIGUITIES + 1), 1), config.fit_false_rejection),
        attempts=config.attempts,
        max_candidates=config.max_candidates,
        min_satellites=config.min_satellites,
        min_further=config.min_further,
        hold_failures=config.hold_failures,
        retry=config.retry_s,
        reflections=reflection_parameters(config.reflections, smallest_risk),
        filter=one_record(
            FILTER_RULES,
            sequential=config.float_solution.kind == "sequential",
            interval=config.float_solution.interval_s,
            memory=config.float_solution.memory_s,
            code_tau=config.float_solution.code_tau_s,
            phase_tau=config.float_solution.phase_tau_s,
            ionosphere=config.float_solution.ionosphere_m,
            troposphere=config.float_solution.troposphere_m,
        ),
    )


def reflection_parameters(config: ReflectionHypothesesConfig, smallest_risk: float) -> Records:
    """REFLECTION_RULES (1,) of :mod:`.reflection_odds_kernel`; ``smallest_risk`` is that of the strictest level."""
    return one_record(
        REFLECTION_RULES,
        sets=config.sets,
        zenith=config.zenith_dbhz,
        horizon=config.horizon_dbhz,
        most=config.odds,
        centre=config.centre_db,
        scale=config.scale_db,
        limit=config.share * smallest_risk,
        single=config.confirm_from,
    )


def slip_parameters(config: CycleSlipConfig) -> Records:
    """SLIP_RULES (1,) of :mod:`.slip_watch_kernel`."""
    return one_record(
        SLIP_RULES,
        k=config.threshold,
        ionosphere=config.ionosphere_rate_mps,
        fit=config.fit_limit,
        failure=config.repair_failure_rate,
    )


def calibration_parameters(config: HeadingConfig) -> Records:
    """CALIBRATION (1,) of :mod:`.heading_kernel`."""
    return one_record(
        CALIBRATION,
        min_speed=config.min_speed_mps,
        speed_agreement=config.speed_agreement_mps,
        max_hdop=config.max_hdop,
        max_jump=np.deg2rad(config.max_jump_deg),
    )


def drift_parameters(p: PositioningConfig, dt_s: float) -> Records:
    """DRIFT_RULES (1,) of :mod:`.drift_watch_kernel`.

    The union bound of false alarms is over epochs, windows, two axes and two signs. A bias of every satellite moves a
    position by at most about twice its size, at both ends of a window.
    """
    c, o = p.rtk.drift, p.dead_reckoning
    return one_record(
        DRIFT_RULES,
        spacing=c.window_s / c.windows,
        window=c.window_s,
        k=-ndtri(c.false_alarms_per_h * dt_s / 3600.0 / (4.0 * c.windows)),
        scale=o.odometer_scale,
        scale_walk=c.scale_walk,
        slip=c.slip_s2_per_m,
        sigma=o.odometer_sigma_mps,
        tau=o.odometer_tau_s,
        bias=o.odometer_bias_mps,
        creep=o.standstill_speed_mps,
        axle=p.axle_bound_m,
        heading_drift=np.deg2rad(o.heading_drift_degps),
        phase=4.0 * p.rtk.phase_bias_m,
    )


def mode_parameters(config: ModeConfig, odometer_follows: bool = True) -> Records:
    """MODE_LIMITS (1,) of :mod:`.mode_kernel`; ``odometer_follows``: gyro and odometer move what Doppler does not."""
    return one_record(
        MODE_LIMITS,
        rtk_max_hdop=config.rtk_max_hdop,
        doppler_agreement=config.doppler_agreement_mps,
        doppler_max_hdop=config.doppler_max_hdop,
        doppler_max_sdop=np.inf if config.doppler_max_sdop is None else config.doppler_max_sdop,
        doppler_max_s=config.doppler_max_s,
        doppler_if_tighter=config.doppler_when == "tighter" and odometer_follows,
    )


def watch_parameters(config: DeadReckoningConfig) -> Records:
    """WATCH_LIMITS (1,) of :mod:`.odometer_watch_kernel`."""
    w = config.watch
    return one_record(
        WATCH_LIMITS,
        allowed=w.accelerometer_bias_mps2 + GRAVITY_MPS2 * w.grade,
        scale=w.scale,
        misalignment=np.tan(np.deg2rad(w.misalignment_deg)),
        lever=w.lever_m,
        jump=w.sigmas * np.sqrt(2.0) * config.odometer_sigma_mps + config.standstill_speed_mps,
        stuck_s=w.stuck_s,
        still_rate=np.deg2rad(w.still_rate_degps),
        still_s=w.still_s,
        agree_s=w.agree_s,
    )
