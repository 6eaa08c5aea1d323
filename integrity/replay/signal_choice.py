"""Selection of the signals of each system for a pair of receivers.

Rover and base can track a band with different codes (for example L2W and L2L). Constant differences between codes are
absorbed by the clock, which single differences estimate for each system, band and observable. Therefore a band (the
digit of the code) is selected for both receivers, and a code of this band for each receiver.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System

__all__ = ["BAND_MHZ", "LETTERS", "Choice", "choose_signals"]

LETTERS = {"G": System.GPS, "E": System.GALILEO, "C": System.BEIDOU, "J": System.QZSS}
# RINEX 3.04 tables 4 to 10; without GLONASS, whose differences are not integers because its channels differ
BAND_MHZ = {
    "G": {"1": 1575.42, "2": 1227.60, "5": 1176.45},
    "E": {"1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1278.75},
    "C": {"2": 1561.098, "1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1268.52},
    "J": {"1": 1575.42, "2": 1227.60, "5": 1176.45, "6": 1278.75},
}
B1C_SINCE = 3.04  # version of the first table with B1C; the reader has moved B1I to band 2


@dataclass(frozen=True)
class Choice:
    """By system letter: codes of rover and base without their first letter, one for each band; wavelengths (systems, 2)
    [m] in the order of :class:`~lanebound.integrity.sky.systems.System`; number of bands, 1 or 2."""

    rover: dict[str, tuple[str, ...]]
    base: dict[str, tuple[str, ...]]
    wavelength_m: NDArray[np.float64]
    bands: int


def choose_signals(rover: Observations, base: Observations, bands: int | None = None) -> Choice:
    """Select the bands with the most satellites: two if a system has two bands on both receivers, otherwise one.

    Raises
    ------
    InputError
        The receivers share no band of GPS, Galileo, BeiDou or QZSS.
    """
    wanted = (2, 1) if bands is None else (bands,)
    for count in wanted:
        found = {letter: _best(letter, rover, base, count) for letter in LETTERS}
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


def _best(letter: str, rover: Observations, base: Observations, count: int) -> list[tuple[str, str]] | None:
    """Pairs (code of rover, code of base) of the ``count`` bands with the most satellite epochs, or None."""
    if letter not in rover.rows or letter not in base.rows:
        return None
    of_rover, of_base = _by_band(letter, rover), _by_band(letter, base)
    shared = [band for band in BAND_MHZ[letter] if band in of_rover and band in of_base]
    best, most = None, 0
    for group in combinations(shared, count):
        epochs = min(int(np.logical_and.reduce([side[b][1] for b in group]).sum()) for side in (of_rover, of_base))
        if epochs > most:
            best, most = [(of_rover[b][0], of_base[b][0]) for b in group], epochs
    return best


def _by_band(letter: str, observations: Observations) -> dict[str, tuple[str, NDArray[np.bool_]]]:
    """For each band the code with the most rows that have code and phase, and a mask of these rows."""
    rows, version = observations.rows[letter], observations.header.version
    found: dict[str, tuple[str, NDArray[np.bool_]]] = {}
    for code in rows.codes:
        name = code[1:]
        if code[0] != "L" or len(name) != 2 or name[0] not in BAND_MHZ[letter]:
            continue
        if letter == "C" and name == "1X" and version < B1C_SINCE:
            continue  # B1C or B1I: not defined in older tables
        whole = (rows.column(f"C{name}") != 0.0) & (rows.column(code) != 0.0)
        if whole.any() and (name[0] not in found or whole.sum() > found[name[0]][1].sum()):
            found[name[0]] = (name, whole)
    return found
