"""Measurements of the user's own that are not finite: signals are taken out of use, body sensors are refused.

A NaN in one signal would otherwise reach position, clocks and covariance of its vehicle. A satellite with a code,
phase, range rate, C/N0 or direction that is not finite counts as not tracked, as where ``tracked`` is False. Gyros,
accelerometers and wheels have no mask: without them an epoch cannot be reckoned.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.finite_kernel import finite_bands, finite_records
from lanebound.integrity.sensors.instruments import Measurements, observed

__all__ = ["with_finite"]

Array = NDArray[np.float64]
SIGNALS = ("code_m", "phase_m", "range_rate_mps", "cn0_dbhz", "raw_code_m", "raw_phase_m")
BODY = (
    ("imu", "delta_theta_rad"), ("imu", "delta_v_mps"), ("odometer", "speed_mps"), ("odometer", "distance_m"),
    ("chassis", "steering_rad"), ("chassis", "wheel_mps"), ("compass", "heading_rad"), ("barometer", "height_m"),
)  # fmt: skip


def with_finite(m: Measurements) -> Measurements:
    """``m`` where all is finite; else a copy in which satellites with a value that is not are untracked, and 0.

    Raises
    ------
    InputError
        A value of gyros, accelerometers, wheels, chassis, compass or barometer is not finite.
    """
    g, finite = m.gnss, bool(finite_records(*observed(m)))
    if finite and g.raw_code_m is not None and g.raw_phase_m is not None:
        finite = finite_bands(g.raw_code_m, g.raw_phase_m)
    if finite and m.chassis is None and m.compass is None and m.barometer is None:
        return m
    _require_body(m)
    return m if finite else _masked(m)


def _require_body(m: Measurements) -> None:
    for sensor, field in BODY:
        sample = getattr(m, sensor)
        values = None if sample is None else getattr(sample, field)
        if values is not None and not np.isfinite(values).all():
            at = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise InputError(
                f"m.{sensor}.{field} must be finite, got {values[at]} for vehicle {at[0]}: give its last value "
                f"that was (only satellites can be masked, by m.gnss.tracked)"
            )


def _masked(m: Measurements) -> Measurements:
    """A copy without the satellites that have a value which is not finite."""
    g, sky = m.gnss, m.sky
    directed = np.asarray(np.isfinite(sky.los_enu).all(-1))
    bad = np.asarray(~directed[sky.index])
    values: dict[str, Any] = {name: getattr(g, name) for name in SIGNALS if getattr(g, name) is not None}
    for x in values.values():
        wrong = ~np.isfinite(x)
        bad = np.asarray(bad | (wrong.any(-1) if x.ndim == 3 else wrong))
    for name, x in values.items():
        values[name] = np.where(bad[..., None] if x.ndim == 3 else bad, 0.0, x)
    values["tracked"] = g.tracked & ~bad
    values["corrections_age_s"] = np.where(np.isnan(g.corrections_age_s), np.inf, g.corrections_age_s)
    if not directed.all():
        sky = replace(
            sky, los_enu=np.where(directed[..., None], sky.los_enu, np.array([0.0, 0.0, 1.0])),
            elevation_rad=np.where(directed, sky.elevation_rad, 0.5 * np.pi),
        )  # fmt: skip
    return replace(m, sky=sky, gnss=replace(g, **values))
