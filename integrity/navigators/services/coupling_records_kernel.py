"""What coupling keeps of code errors in a reckoned position, and what it works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.monitoring.doppler_separation_kernel import Separations

__all__ = ["COUPLED", "COUPLING_RULES", "EXTRA", "NO_PROPOSAL", "WHOLE", "WITH_RECKONED", "Coupling", "Part"]

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


class Coupling(NamedTuple):
    """What lasts of B vehicles, and what is proposed in an epoch.

    rules (1,) of COUPLING_RULES and parameters (1,) of PARAMETERS, whose reflections leave fewer sets uncovered;
    coupled (B,) of COUPLED and extra (B, R) of EXTRA; proposal (B,) of this epoch;
    growth (B,) of GROWTH, starts (B, R) of START and separations (B, W) of it, with after (B,) of COUPLED and
    extra_after (B, R) of EXTRA; by_doppler, separated (B,) whether Doppler had moved the position, and whether
    separations had grown.
    """

    rules: Records
    parameters: Records
    coupled: Records
    extra: Records
    proposal: NDArray[np.int64]
    growth: Records
    starts: Records
    separations: Separations
    after: Records
    extra_after: Records
    by_doppler: NDArray[np.bool_]
    separated: NDArray[np.bool_]
