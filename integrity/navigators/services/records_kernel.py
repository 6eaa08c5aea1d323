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
    "PART",
    "SERVICE_INPUT",
    "SERVICE_LABEL",
    "SERVICE_RULES",
    "SERVICE_SATELLITE",
    "SERVICE_SIGNAL",
    "SERVICE_WORK",
    "ServiceInputs",
    "ServiceRows",
    "ServiceState",
    "ServiceTables",
]

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


SERVICE_SATELLITE = record(
    share=("f8", (2,), "of each band in its range [-]"),
    noise="1 sigma of the range over that of one band [-]",
    allowed=("?", "it may be used"),
)
"""What a service declares of a satellite."""

SERVICE_SIGNAL = record(
    code=("f8", (2,), "undifferenced, by band [m]"),
    phase=("f8", (2,), "the same of the carrier [m]"),
    satellite="correction of the satellite [m]",
    zenith="vertical ionosphere on the first band [m]",
    declared="1 sigma of the satellite as the provider declares it, inf without a correction [m]",
)
"""Measurements and corrections of a satellite in an epoch."""

SERVICE_INPUT = record(
    zenith_declared="1 sigma of the vertical ionosphere as the provider declares it [m]",
    age="of the corrections [s]",
    zenith_age="of the ionospheric grid [s]",
    height="Up of the antenna by the barometer [m]",
    height_variance="inf without a barometer [m^2]",
)
"""The rest of an epoch."""

PART = record(fast="part of the variance by noise and multipath [m^2]", odds="that the range is off [-]")
"""What a row of a service has in addition to :data:`~lanebound.integrity.positioning.rows_kernel.ROW`."""

SERVICE_WORK = record(
    due=("?", "a position is to be found"),
    consistent=("?", "the fault test has passed"),
    few=("?", "too few ranges for it remain"),
    excluded=("i8", "ranges that it has put out of use"),
    least="smallest sum of squares of both levels that a service has found in this epoch [m^2]",
)
"""Work of one service after another, of a vehicle."""

SERVICE_LABEL = record(
    offered=("i8", "mode whose position a service offers in this epoch, 0: none"),
    latest=("i8", "mode of the last position that was taken, 0: RTK"),
)
"""Which service a vehicle's position comes from."""


class ServiceTables(NamedTuple):
    """Parameters of a service.

    rules (1,) of SERVICE_RULES; parameters (1,) of PARAMETERS and tables with its risks, tests and fault priors;
    satellites (S,) of SERVICE_SATELLITE; later (n,) modes of the services that are less preferred.
    """

    rules: Records
    parameters: Records
    tables: Tables
    satellites: Records
    later: NDArray[np.int64]


class ServiceInputs(NamedTuple):
    """Measurements and corrections of an epoch: signals (B, S) of SERVICE_SIGNAL, vehicles (B,) of SERVICE_INPUT."""

    signals: Records
    vehicles: Records


class ServiceState(NamedTuple):
    """What lasts of a service: hatch (B, S) of HATCH; since (B,) time since the last attempt at a position [s]."""

    hatch: Records
    since: NDArray[np.float64]


class ServiceRows(NamedTuple):
    """Corrected ranges of an epoch, work of one service after another.

    rows (B, S) of ROW and parts (B, S) of PART; work (B,) of SERVICE_WORK; labels (B,) of SERVICE_LABEL.
    """

    rows: Records
    parts: Records
    work: Records
    labels: Records
