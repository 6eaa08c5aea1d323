"""What the navigation believes: the only thing a controller may act on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus

if TYPE_CHECKING:
    from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["ContextReport", "Solution"]

Array = NDArray[np.float64]


class ContextReport(NamedTuple):
    """What a context monitor says of B vehicles; it holds until the next verdict.

    context_warning (B,) bool; context_phases (B,) phases passed, 0 to 3; context_score (B,) 0 to 100; link_probability
    (B,) of the matched link; light, reason (B,) codes of Light and ContextReason; link (B,) identity in the map, -1
    without.
    """

    context_warning: NDArray[np.bool_]
    context_phases: NDArray[np.int64]
    context_score: Array
    link_probability: Array
    light: NDArray[np.int64]
    reason: NDArray[np.int64]
    link: NDArray[np.int64]

    def rows(self, rows: NDArray[np.int64]) -> ContextReport:
        """The reports of some vehicles."""
        return ContextReport(**{name: value[rows] for name, value in self._asdict().items()})

    @classmethod
    @lru_cache(maxsize=16)
    def none(cls, batch: int) -> ContextReport:
        """Without a monitor: no warning. Not to be written."""
        whole, zero = np.zeros(batch, np.int64), np.zeros(batch)
        return cls(np.zeros(batch, np.bool_), whole, zero, zero, whole, whole, whole - 1)


@dataclass(frozen=True)
class Solution:
    """Belief of B vehicles at one epoch. No entry is ever NaN; a missing protection level is ``inf``.

    Attributes
    ----------
    time_s : end of the epoch
    position_en_m : (B, 2) East, North of the vehicle's reference point; meaningful where ``mode`` is not NONE
    heading_rad : (B,) azimuth clockwise from North
    velocity_en_mps : (B, 2); speed_mps : (B,) odometer speed, signed
    covariance_en_m2 : (B, 2, 2)
    sigma_at_m, sigma_ct_m : (B,) standard deviations along and across the estimated heading
    pl_at_m, pl_ct_m : (B,) protection levels at the operative risk
    pl_cases_m : (B, R, 2) protection levels AT, CT of every configured case, the operative one first
    mode : (B,) :class:`~lanebound.integrity.positioning.modes.Mode`
    rtk : (B,) :class:`~lanebound.integrity.positioning.modes.RtkStatus`, why RTK holds or not
    alert : (B,) bool; available : (B,) bool, no protection level exceeds its limit now
    reason : (B,) codes of :class:`~lanebound.integrity.monitoring.alerts.AlertReason`
    hdop : (B,) of the solution in use (inf without satellites)
    satellites : (B,) number used by RTK; satellites_doppler : (B,) by the velocity
    excluded : (B,) satellites excluded by fault detection in this epoch, RTK and Doppler together
    since_rtk_s : (B,) time since the last RTK position (inf before the first)
    since_calibration_s : (B,) time since the heading was last calibrated
    corrections_age_s : (B,) age of the reference data (inf when the link is out)
    wrong_fix_risk : (B,) probability that the held ambiguities are wrong
    held : (B, S) bool, satellites whose ambiguities are fixed and held
    doubt_en_m : (B, 2) RTK less dead reckoning while RTK is not trusted; levels cover it; else 0
        (:mod:`~lanebound.integrity.monitoring.jump_kernel`)
    model_curved : (B,) probability of the curved vehicle model of a filter; 0 of other kinds
    nis_position, nis_wheels, nis_gyro, nis_steering, nis_slip, nis_compass : (B,) normalised innovation squared of the
        last GNSS position, wheel speed, integrated gyro, steering angle, slip by the geometry and compass heading of a
        filter; 0 before, of sensors that are not fitted, and of other kinds
    trust_m : (B,) horizontal trust level of a filter; inf without one, and of other kinds
    hpl_sbas_m : (B,) level of SBAS of the position by codes of a filter that uses SBAS; inf without one, and of others
    sdop : (B,) speed dilution of precision of the Doppler velocity, 1 sigma of the speed over that of one range rate at
        the zenith; inf without one, and of other kinds
    context : of the context monitor, None without one
    """

    time_s: float
    position_en_m: Array
    heading_rad: Array
    velocity_en_mps: Array
    speed_mps: Array
    covariance_en_m2: Array
    sigma_at_m: Array
    sigma_ct_m: Array
    pl_at_m: Array
    pl_ct_m: Array
    pl_cases_m: Array
    mode: NDArray[np.int64]
    rtk: NDArray[np.int64]
    alert: NDArray[np.bool_]
    available: NDArray[np.bool_]
    reason: NDArray[np.int64]
    hdop: Array
    satellites: NDArray[np.int64]
    satellites_doppler: NDArray[np.int64]
    excluded: NDArray[np.int64]
    since_rtk_s: Array
    since_calibration_s: Array
    corrections_age_s: Array
    wrong_fix_risk: Array
    held: NDArray[np.bool_]
    doubt_en_m: Array
    model_curved: Array
    nis_position: Array
    nis_wheels: Array
    nis_gyro: Array
    nis_steering: Array
    nis_slip: Array
    nis_compass: Array
    trust_m: Array
    hpl_sbas_m: Array
    sdop: Array
    context: ContextReport | None = None

    @classmethod
    def blank(cls, m: Measurements, levels: int) -> Self:
        """Solutions without a position and with R levels; a navigator replaces what it knows."""
        batch, satellites = m.gnss.tracked.shape
        zero, inf, none = np.zeros(batch), np.full(batch, np.inf), np.zeros(batch, np.int64)
        return cls(
            time_s=m.time_s, position_en_m=np.zeros((batch, 2)), heading_rad=zero, velocity_en_mps=np.zeros((batch, 2)),
            speed_mps=m.odometer.speed_mps, covariance_en_m2=np.zeros((batch, 2, 2)), sigma_at_m=inf, sigma_ct_m=inf,
            pl_at_m=inf, pl_ct_m=inf, pl_cases_m=np.full((batch, levels, 2), np.inf), mode=none + int(Mode.NONE),
            rtk=none + RtkStatus.TOO_FEW.code, alert=np.ones(batch, np.bool_), available=np.zeros(batch, np.bool_),
            reason=none + AlertReason.INITIALISING.code, hdop=inf, satellites=none, satellites_doppler=none,
            excluded=none, since_rtk_s=inf, since_calibration_s=inf, corrections_age_s=m.gnss.corrections_age_s,
            wrong_fix_risk=zero, held=np.zeros((batch, satellites), np.bool_), doubt_en_m=np.zeros((batch, 2)),
            model_curved=zero, nis_position=zero, nis_wheels=zero, nis_gyro=zero, nis_steering=zero, nis_slip=zero,
            nis_compass=zero, trust_m=inf, hpl_sbas_m=inf, sdop=inf,
        )  # fmt: skip

    def rows(self, rows: NDArray[np.int64]) -> Solution:
        """The solutions of some vehicles."""
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen: dict[str, Any] = {name: v[rows] if isinstance(v, np.ndarray) else v for name, v in values.items()}
        chosen["context"] = None if self.context is None else self.context.rows(rows)
        return Solution(**chosen)

    @property
    def batch(self) -> int:
        """Number of vehicles."""
        return int(self.mode.shape[0])
