"""Selection of the signals of each system for a pair of receivers.

Rover and base can track a band with different codes (for example L2W and L2L). Constant differences between codes are
absorbed by the clock, which single differences estimate for each system, band and observable. Therefore a band (the
digit of the code) is selected for both receivers, and a code of this band for each receiver.

Two bands of each system are selected first. Further signals follow, each with a clock of its own, as long as clocks are
left: a third band, and a second code of the second band, for satellites that lack the first (L2W for those without
L2C): with the same clock the constant difference of the codes would be taken for a range.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.recorded.rinex_observation import Observations, SystemRows
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Strengths = dict[str, dict[str, Array]]
Pair = tuple[str, str]

LETTERS = {"G": System.GPS, "E": System.GALILEO, "C": System.BEIDOU, "J": System.QZSS}
# RINEX 3.04 tables 4 to 10; without GLONASS, whose differences are not integers because its channels differ
BAND_MHZ = {
    "G": {"1": 1575.42, "2": 1227.60, "5": 1176.45},
    "E": {"1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1278.75},
    "C": {"2": 1561.098, "1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1268.52},
    "J": {"1": 1575.42, "2": 1227.60, "5": 1176.45, "6": 1278.75},
}
WIDE_MHZ, NEAR_SHARE = 100.0, 0.5  # E5a and E5b are 31 MHz apart, L1 and L2 348 MHz
MOST_INDICATOR = 9.0  # signal strength indicators are 1 to 9
USUAL_CN0_DBHZ = 45.0  # for receivers that do not record the C/N0
WEAK = 1e-6  # weight of a signal below the lowest C/N0: better than none
MARGIN_S = 1.0  # of the overlap in time
PRNS = 256
COLUMNS = 4  # signals of a system at most
FEWEST = 2  # satellites with a further signal: one alone differs from no other
LITTLE = 0.1  # strength of a satellite below which it lacks a signal
SEMI_CODELESS_DB = 10.0
"""By how much the C/N0 of L2W may be lower with the same noise, because L1 guides its loop, which may be narrower. On
the static pair double differences of its phases at 27 to 36 dB-Hz are as precise as those of L1 at 41 to 46 dB-Hz."""
B1C_SINCE = 3.04  # version of the first table with B1C; the reader has moved B1I to band 2


@dataclass(frozen=True)
class Choice:
    """By system letter: codes of rover and base without their first letter, one for each signal; wavelengths (systems,
    COLUMNS) [m] in the order of :class:`~lanebound.integrity.sky.systems.System`, 1 for none; number of bands of the
    system that has most; clock (systems, COLUMNS) of each signal, that of the first one being the system's number."""

    rover: dict[str, tuple[str, ...]]
    base: dict[str, tuple[str, ...]]
    wavelength_m: NDArray[np.float64]
    bands: int
    clock: NDArray[np.int64] = field(default_factory=lambda: np.zeros((len(System), COLUMNS), np.int64))


def choose_signals(
    rover: Observations, base: Observations, bands: int | None = None, *, cn0_min_dbhz: float = 0.0,
    cn0_knee_dbhz: float = 35.0,
) -> Choice:  # fmt: skip
    """Select the bands and codes with the strongest signals: of each system at most ``bands``, by default up to three.

    A satellite counts with the weakest of its signals: the share of epochs in which it has code, phase and at least
    ``cn0_min_dbhz``, each weighted by ``1 / (1 + 10^((knee - C/N0) / 10))``, the inverse of its variance in RTK. A weak
    semi-codeless signal therefore counts less than a civil one of the same band. Two bands less than WIDE_MHZ apart
    count NEAR_SHARE: they hold little more than one.

    Raises
    ------
    InputError
        The receivers share no band of GPS, Galileo, BeiDou or QZSS.
    """
    limits, within = (cn0_min_dbhz, cn0_knee_dbhz), _overlap(rover, base)
    chosen = {}
    for letter in LETTERS:
        at_rover, at_base = (
            _strengths(letter, of, there, limits, False) for of, there in zip((rover, base), within, strict=True)
        )
        found = _best(letter, at_rover, at_base, 2) if bands != 1 else None
        found = found or _best(letter, at_rover, at_base, 1)
        if found:
            chosen[letter] = found
    if not chosen:
        raise InputError(
            f"rover and base must share a band of {', '.join(LETTERS)} with code and phase, rover has "
            f"{_codes_of(rover)}, base {_codes_of(base)}: record both observables"
        )
    if bands != 1:
        sides = {
            letter: (
                _strengths(letter, rover, within[0], limits, True),
                _strengths(letter, base, within[1], limits, True),
            )
            for letter in chosen
        }
        _add_further(chosen, sides, bands)
    return _choice(chosen)


def _add_further(
    chosen: dict[str, list[Pair]], sides: dict[str, tuple[Strengths, Strengths]], bands: int | None
) -> None:
    """Append further signals to those ``chosen``, the strongest first, while clocks are left."""
    found = []
    for letter, pairs in chosen.items():
        taken = [pair[0][0] for pair in pairs]
        for band in BAND_MHZ[letter]:
            rover, base = (side.get(band, {}) for side in sides[letter])
            if (band not in taken and bands == 2) or band == taken[0]:
                continue
            before = pairs[taken.index(band)] if band in taken else None
            lacking = np.ones(PRNS) if before is None else _shared(rover, base, before) < LITTLE
            gains = {pair: _shared(rover, base, pair) * lacking for pair in product(rover, base) if pair != before}
            others = [
                (float(gain.sum()), pair) for pair, gain in gains.items() if np.count_nonzero(gain >= LITTLE) >= FEWEST
            ]
            if others:
                strength, best = max(others)
                found.append((before is None, strength, letter, best))
    clocks = sum(len(pairs) for pairs in chosen.values())
    for _, _, letter, pair in sorted(found, key=lambda row: row[:2], reverse=True):
        if clocks < MAX_GROUPS and len(chosen[letter]) < COLUMNS:
            chosen[letter].append(pair)
            clocks += 1


def _shared(rover: dict[str, Array], base: dict[str, Array], pair: Pair) -> Array:
    """Strength of each PRN (PRNS,) in two codes of a band."""
    return np.asarray(np.minimum(rover[pair[0]], base[pair[1]]))


def _choice(chosen: dict[str, list[Pair]]) -> Choice:
    """The choice of these pairs of codes, with a clock for each."""
    wavelength = np.ones((len(System), COLUMNS))
    clock = np.zeros((len(System), COLUMNS), np.int64)
    free = [k for k in range(MAX_GROUPS) if k not in {int(LETTERS[letter]) for letter in chosen}]
    for letter, pairs in chosen.items():
        system = LETTERS[letter]
        for column, (code, _) in enumerate(pairs):
            wavelength[system, column] = SPEED_OF_LIGHT_MPS / (1e6 * BAND_MHZ[letter][code[0]])
            clock[system, column] = free.pop(0) if column else system
    return Choice(
        {letter: tuple(at_rover for at_rover, _ in pairs) for letter, pairs in chosen.items()},
        {letter: tuple(at_base for _, at_base in pairs) for letter, pairs in chosen.items()}, wavelength,
        max(len({at_rover[0] for at_rover, _ in pairs}) for pairs in chosen.values()), clock,
    )  # fmt: skip


def comparable_cn0(name: str, cn0_dbhz: NDArray[np.float64]) -> NDArray[np.float64]:
    """C/N0 of a civil signal of the same noise, from that of the signal ``name`` (a code without its first letter)."""
    return cn0_dbhz + SEMI_CODELESS_DB if name[1:] == "W" else cn0_dbhz


def strength_dbhz(rows: SystemRows, name: str) -> Array:
    """C/N0 of the rows in the signal ``name`` (a code without its first letter), 0 for none.  (N,) [dB-Hz].

    Some files hold RINEX indicators of 1 to 9 instead: level n begins at ``6 n`` dB-Hz (RINEX 3.04 section 5.7).
    """
    strength = rows.column(f"S{name}")
    return 6.0 * strength if 0.0 < strength.max(initial=0.0) <= MOST_INDICATOR else strength


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


def _best(letter: str, rover: Strengths, base: Strengths, count: int) -> list[Pair] | None:
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


def _strengths(
    letter: str, observations: Observations, within: Bools, limits: tuple[float, float], comparable: bool
) -> Strengths:
    """By band and code, the weighted share of epochs of each PRN (PRNS,) that has code and phase; ``comparable``: a
    semi-codeless signal counts by its noise, otherwise by its C/N0, with which it is easily lost."""
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
            cn0 = strength_dbhz(rows, name)
            cn0 = np.where(cn0 > 0.0, comparable_cn0(name, cn0) if comparable else cn0, USUAL_CN0_DBHZ)
            weight = np.where(cn0 >= least, 1.0 / (1.0 + 10.0 ** (0.1 * (knee - cn0))), WEAK)
            total = np.bincount(rows.satellite, np.where(whole, weight, 0.0), PRNS)
            found.setdefault(name[0], {})[name] = total / np.count_nonzero(within)
    return found
