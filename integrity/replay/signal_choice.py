"""Selection of the signals of each system for a pair of receivers.

Rover and base can track a band with different codes (for example L2W and L2L). Constant differences between codes are
absorbed by the clock, which single differences estimate for each system, band and observable. Therefore a band (the
digit of the code) is selected for both receivers, and a code of this band for each receiver. All satellites of a system
use the same codes: with different ones the constant differences would not be common to the clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System

__all__ = ["BAND_MHZ", "LETTERS", "USUAL_CN0_DBHZ", "Choice", "choose_signals"]

Bools = NDArray[np.bool_]
Strengths = dict[str, dict[str, NDArray[np.float64]]]

LETTERS = {"G": System.GPS, "E": System.GALILEO, "C": System.BEIDOU, "J": System.QZSS}
# RINEX 3.04 tables 4 to 10; without GLONASS, whose differences are not integers because its channels differ
BAND_MHZ = {
    "G": {"1": 1575.42, "2": 1227.60, "5": 1176.45},
    "E": {"1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1278.75},
    "C": {"2": 1561.098, "1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1268.52},
    "J": {"1": 1575.42, "2": 1227.60, "5": 1176.45, "6": 1278.75},
}
WIDE_MHZ, NEAR_SHARE = 100.0, 0.5  # E5a and E5b are 31 MHz apart, L1 and L2 348 MHz
USUAL_CN0_DBHZ = 45.0  # for receivers that do not record the C/N0
WEAK = 1e-6  # weight of a signal below the lowest C/N0: better than none
MARGIN_S = 1.0  # of the overlap in time
PRNS = 256
B1C_SINCE = 3.04  # version of the first table with B1C; the reader has moved B1I to band 2


@dataclass(frozen=True)
class Choice:
    """By system letter: codes of rover and base without their first letter, one for each band; wavelengths (systems, 2)
    [m] in the order of :class:`~lanebound.integrity.sky.systems.System`; number of bands, 1 or 2."""

    rover: dict[str, tuple[str, ...]]
    base: dict[str, tuple[str, ...]]
    wavelength_m: NDArray[np.float64]
    bands: int


def choose_signals(
    rover: Observations, base: Observations, bands: int | None = None, *, cn0_min_dbhz: float = 0.0,
    cn0_knee_dbhz: float = 35.0,
) -> Choice:  # fmt: skip
    """Select the bands and codes with the strongest signals: two bands if a system has two on both receivers, else one.

    A satellite counts with the weakest of its signals: the share of epochs in which it has code, phase and at least
    ``cn0_min_dbhz``, each weighted by ``1 / (1 + 10^((knee - C/N0) / 10))``, the inverse of its variance in RTK. A weak
    semi-codeless signal therefore counts less than a civil one of the same band. Two bands less than WIDE_MHZ apart
    count NEAR_SHARE: they hold little more than one.

    Raises
    ------
    InputError
        The receivers share no band of GPS, Galileo, BeiDou or QZSS.
    """
    wanted, limits, overlap = (
        (2, 1) if bands is None else (bands,),
        (cn0_min_dbhz, cn0_knee_dbhz),
        _overlap(rover, base),
    )
    strengths = {
        letter: (
            _strengths(letter, rover, overlap[0], limits),
            _strengths(letter, base, overlap[1], limits),
        )
        for letter in LETTERS
    }
    for count in wanted:
        found = {letter: _best(letter, *strengths[letter], count) for letter in LETTERS}
        chosen = {letter: best for letter, best in found.items() if best is not None}
        if chosen:
            wavelength = np.ones((len(System), 2))
            for letter, pairs in chosen.items():
                for band, (code, _) in enumerate(pairs):
                    wavelength[LETTERS[letter], band] = SPEED_OF_LIGHT_MPS / (1e6 * BAND_MHZ[letter][code[0]])
            return Choice(
                {letter: tuple(r for r, _ in pairs) for letter, pairs in chosen.items()},
                {letter: tuple(b for _, b in pairs) for letter, pairs in chosen.items()}, wavelength, count,
            )  # fmt: skip
    raise InputError(
        f"rover and base must share a band of {', '.join(LETTERS)} with code and phase, rover has "
        f"{_codes_of(rover)}, base {_codes_of(base)}: record both observables"
    )


def _codes_of(observations: Observations) -> str:
    return "; ".join(f"{s} {' '.join(c)}" for s, c in observations.header.codes.items()) or "nothing"


def _overlap(rover: Observations, base: Observations) -> tuple[Bools, Bools]:
    """Epochs (T,) of each receiver within the time of the other; all where there are none."""
    week = int(min(rover.week[0], base.week[0]))
    times = rover.since(week), base.since(week)
    first, last = max(t[0] for t in times) - MARGIN_S, min(t[-1] for t in times) + MARGIN_S
    within = [(t >= first) & (t <= last) for t in times]
    if not (within[0].any() and within[1].any()):
        within = [np.ones(t.size, np.bool_) for t in times]
    return within[0], within[1]


def _best(letter: str, rover: Strengths, base: Strengths, count: int) -> list[tuple[str, str]] | None:
    """Pairs (code of rover, code of base) of the ``count`` bands with the strongest satellites, or None."""
    shared = [band for band in BAND_MHZ[letter] if band in rover and band in base]
    best, most = None, 0.0
    for group in combinations(shared, count):
        apart = abs(BAND_MHZ[letter][group[0]] - BAND_MHZ[letter][group[-1]])
        share = 1.0 if count == 1 or apart >= WIDE_MHZ else NEAR_SHARE
        for pairs in product(*(product(rover[band], base[band]) for band in group)):
            sides = [side[code[0]][code] for pair in pairs for side, code in zip((rover, base), pair, strict=True)]
            strength = share * float(np.minimum.reduce(sides).sum())
            if strength > most:
                best, most = list(pairs), strength
    return best


def _strengths(letter: str, observations: Observations, within: Bools, limits: tuple[float, float]) -> Strengths:
    """By band and code, the weighted share of epochs of each PRN (PRNS,) that has code and phase."""
    if letter not in observations.rows:
        return {}
    (least, knee), rows, version = limits, observations.rows[letter], observations.header.version
    found: Strengths = {}
    for code in rows.codes:
        name = code[1:]
        if code[0] != "L" or len(name) != 2 or name[0] not in BAND_MHZ[letter]:
            continue
        if letter == "C" and name == "1X" and version < B1C_SINCE:
            continue  # B1C or B1I: not defined in older tables
        whole = (rows.column(f"C{name}") != 0.0) & (rows.column(code) != 0.0) & within[rows.epoch]
        if whole.any():
            cn0 = rows.column(f"S{name}")
            cn0 = np.where(cn0 > 0.0, cn0, USUAL_CN0_DBHZ)
            weight = np.where(cn0 >= least, 1.0 / (1.0 + 10.0 ** (0.1 * (knee - cn0))), WEAK)
            total = np.bincount(rows.satellite, np.where(whole, weight, 0.0), PRNS)
            found.setdefault(name[0], {})[name] = total / np.count_nonzero(within)
    return found
