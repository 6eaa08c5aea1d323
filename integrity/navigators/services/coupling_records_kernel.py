"""What coupling keeps of code errors in a reckoned position, and what it works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import GROWTH

__all__ = [
    "COUPLED",
    "COUPLING_RULES",
    "EXTRA",
    "NO_PROPOSAL",
    "PROPOSAL",
    "WHOLE",
    "WITH_RECKONED",
    "Coupling",
    "Part",
]

Array = NDArray[np.float64]

NO_PROPOSAL, WHOLE, WITH_RECKONED = 0, 1, 2  # what is offered: nothing, the position of a service, a coupled position

COUPLING_RULES = record(
    tight=("?", "ranges, not positions, are combined with the position reckoned on"),
    interval="least time in motion between two epochs of ranges [s]",
    creep="speed below which time counts less [m/s]",
    white="variance of a white error that bounds fast errors, over theirs [-]",
    restart="level of a service over that of the coupled position, below which its position is taken whole [-]",
    memory="factor on the probability of faults that no mode covers, for the time that they stay [-]",
)
"""Declared figures of a coupling with one service."""

COUPLED = record(
    active=("?", "the position reckoned on holds code errors, as follows"),
    any_ee="fast errors, whatever their correlation, East [m^2]",
    any_en="the same, East and North",
    any_nn="the same, North",
    white_ee="fast errors, bounded by a white error, East [m^2]",
    white_en="the same, East and North",
    white_nn="the same, North",
    slow_ee="errors of satellites, atmosphere and height, whatever their correlation, East [m^2]",
    slow_en="the same, East and North",
    slow_nn="the same, North",
    held_ee="what the covariance of the growth holds of all code errors, East [m^2]",
    held_en="the same, East and North",
    held_nn="the same, North",
    since="time in motion since the last ranges [s]",
    age="time since a position was taken whole [s]",
)
"""Code errors in the position reckoned on since the last position of a service, of one vehicle."""

EXTRA = record(
    first="bound of faults and of constant errors of codes, on the first axis of the starts [m]",
    second="the same, on the second axis [m]",
)
"""What the ranges of the past left to the levels of one case."""


class Part(NamedTuple):
    """What one epoch of ranges adds: fast, slow (3,) covariances EE, EN, NN of its share in the position [m^2]; extra
    (R, 2) bounds of its faults and constant errors, along and across [m]."""

    fast: Array
    slow: Array
    extra: Array


PROPOSAL = record(
    kind=("i8", "NO_PROPOSAL, WHOLE or WITH_RECKONED"),
    by_doppler=("?", "Doppler had moved the position"),
    separated=("?", "separations had grown"),
    growth=(GROWTH, "of the coupled position"),
    after=(COUPLED, "code errors in it"),
)
"""What is offered of a vehicle in an epoch."""


class Coupling(NamedTuple):
    """What lasts of B vehicles, and what is proposed in an epoch.

    rules (1,) of COUPLING_RULES and parameters (1,) of PARAMETERS, whose reflections leave fewer sets uncovered;
    coupled (B,) of COUPLED and extra (B, R) of EXTRA; proposals (B,) of PROPOSAL with starts (B, R) of START,
    separations (B, M) of SEPARATION and extra_after (B, R) of EXTRA.
    """

    rules: Records
    parameters: Records
    coupled: Records
    extra: Records
    proposals: Records
    starts: Records
    separations: Records
    extra_after: Records
