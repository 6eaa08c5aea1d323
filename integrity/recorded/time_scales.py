"""Leap seconds, and times of week that pass the end of a week."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

__all__ = ["BDT_BEHIND_GPS_S", "GPS_EPOCH_S", "WEEK_S", "leap_seconds", "unrolled"]

Array = NDArray[np.float64]

WEEK_S = 604_800.0
GPS_EPOCH_S = 315_964_800.0  # 1980-01-06 in seconds since 1970
BDT_BEHIND_GPS_S = 14.0  # BeiDou time starts at 2006-01-01 without the leap seconds before that date
# First days with one leap second more between UTC and GPS time; IERS Bulletin C, none after 2017 until 2026
LEAP_DAYS = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip
LEAP_S = np.array([datetime(year, month, 1, tzinfo=UTC).timestamp() - GPS_EPOCH_S for year, month in LEAP_DAYS])


def leap_seconds(utc_s: Array) -> Array:
    """GPS time less UTC [s] at times (...,) of UTC, in seconds since 1980-01-06 without leap seconds."""
    return np.searchsorted(LEAP_S, utc_s, side="right").astype(np.float64)


def unrolled(tow_s: Array) -> Array:
    """Times of week (N,) [s] that continue beyond the end of a week: 604,800 s are added where the week begins anew."""
    return np.asarray(tow_s + WEEK_S * np.cumsum(np.diff(tow_s, prepend=tow_s[:1]) < -0.5 * WEEK_S))
