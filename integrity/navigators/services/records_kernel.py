"""What the stages of a positioning service work on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Tables
from lanebound.integrity.positioning.code_errors_kernel import CODE_ERRORS

__all__ = [
    "LEAST_WEIGHT",
    "SERVICE_RULES",
    "ServiceInputs",
    "ServiceLabels",
    "ServiceRows",
    "ServiceState",
    "ServiceTables",
]

Array = NDArray[np.float64]

LEAST_WEIGHT = 1.0 / 32.0  # of a position in a mean with the one reckoned on

SERVICE_RULES = record(
    mode=("i8", "code of its Mode"),
    combined=("?", "ranges are ionosphere-free combinations of both bands"),
    least=("i8", "fewest ranges that are used"),
    interval="time between two positions [s]",
    smoothing="epochs in the time constant of carrier smoothing [-]; 0: none",
    sin_mask="sine of the lowest elevation used",
    cn0_min="lowest C/N0 used [dB-Hz]",
    max_hdop="largest HDOP of a position [-]",
    errors=(CODE_ERRORS, "error budget of its ranges"),
    bias="bound of a lasting error of one code [m]",
    preference="level over that of a less preferred service, up to which this one is taken [-]",
    max_age="oldest satellite corrections [s]",
    zenith_max_age="oldest ionospheric grid [s]",
)
"""Declared figures of a service, from its CodeServiceConfig."""


class ServiceTables(NamedTuple):
    """Parameters of a service.

    rules (1,) of SERVICE_RULES; parameters (1,) of PARAMETERS and tables with its risks, tests and fault priors;
    share (S, 2) of each band in the range of a satellite; noise (S,) 1 sigma of the range over that of one band;
    allowed (S,) satellites that may be used; later (n,) modes of the services that are less preferred.
    """

    rules: Records
    parameters: Records
    tables: Tables
    share: Array
    noise: Array
    allowed: NDArray[np.bool_]
    later: NDArray[np.int64]


class ServiceInputs(NamedTuple):
    """Measurements and corrections of an epoch.

    code, phase (B, S, 2) undifferenced [m]; height (B,) Up of the antenna by the barometer [m] and height_variance (B,)
    [m^2], inf without one; satellite (B, S) correction [m] and zenith (B, S) vertical ionosphere on
    the first band [m]; declared (S,) 1 sigma of a satellite, inf without a correction, and zenith_declared that of the
    vertical ionosphere [m], both as the provider declares; age, zenith_age (B,) [s].
    """

    code: Array
    phase: Array
    satellite: Array
    zenith: Array
    declared: Array
    zenith_declared: float
    age: Array
    zenith_age: Array
    height: Array
    height_variance: Array


class ServiceState(NamedTuple):
    """What lasts of a service: hatch (B, S) of HATCH; since (B,) time since the last attempt at a position [s]."""

    hatch: Records
    since: Array


class ServiceRows(NamedTuple):
    """Corrected ranges of an epoch, work of one service after another.

    y, variance, odds (B, S), and fast (B, S) the part of the variance by noise and multipath; used (B, S); due (B,) a
    position is to be found; consistent (B,) the fault test has passed, with ``excluded`` (B,) ranges out of use; few
    (B,) too few ranges for it remain; offered, latest (B,) as in ServiceLabels; least (B,) the smallest sum of squares
    of both levels that a service has found in this epoch [m^2].
    """

    y: Array
    variance: Array
    fast: Array
    odds: Array
    used: NDArray[np.bool_]
    due: NDArray[np.bool_]
    consistent: NDArray[np.bool_]
    few: NDArray[np.bool_]
    excluded: NDArray[np.int64]
    offered: NDArray[np.int64]
    latest: NDArray[np.int64]
    least: Array


class ServiceLabels(NamedTuple):
    """offered (B,) mode whose position a service offers in this epoch, 0: none; latest (B,) that of the last position
    that was taken, 0: RTK."""

    offered: NDArray[np.int64]
    latest: NDArray[np.int64]
