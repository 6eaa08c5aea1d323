"""Checks of a recorded pair: whether its files and given positions fit what its codes and its fixed baseline say."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.recorded.rinex_observation import WEEK_S, Observations
from lanebound.integrity.replay.baseline import Baseline, date_text
from lanebound.integrity.replay.code_places import MOVES_M, WRONG_M, CodePlaces, require_gps_time
from lanebound.integrity.replay.signal_choice import choose_signals
from lanebound.integrity.sky.broadcast import VALID_FOR_S, Ephemerides
from lanebound.integrity.sky.klobuchar import Klobuchar

__all__ = [
    "OPTIONS", "STILL_M", "GivenBy", "baseline_fit", "check_places", "navigation_notes", "require_standing",
    "require_still", "require_two_receivers",
]  # fmt: skip

Array = NDArray[np.float64]

STILL_M = 0.5  # of fixed positions of a receiver that stands; beyond centimetres and what a pole sways
SAME_SHARE = 0.5  # of values that two files have in common; those of two receivers differ in the last digits
FEWEST_SAME = 20  # values


class GivenBy(NamedTuple):
    """The inputs by which a user gives the positions of base and rover, as messages name them."""

    base: str = "--base-position"
    rover: str = "--rover-position"


OPTIONS = GivenBy()


def require_two_receivers(rover: Observations, base: Observations) -> None:
    """Raise InputError where the files hold the same observations: their differences are 0, and so is the baseline."""
    same, both = (sum(counts) for counts in zip(*_equal_values(rover, base), strict=True))
    if both >= FEWEST_SAME and same > SAME_SHARE * both:
        raise InputError(
            f"rover and base must be of two receivers, got the same observations: {100.0 * same / both:.0f} % of the "
            f"{both:,} codes and phases of common epochs are equal; pass the file of the other receiver as --rover or "
            "--base"
        )


def _equal_values(rover: Observations, base: Observations) -> Iterator[tuple[int, int]]:
    """How many codes and phases of common satellite epochs are equal, and how many both have, by code."""
    yield 0, 0
    for letter in set(rover.rows) & set(base.rows):
        ours, theirs = rover.rows[letter], base.rows[letter]
        first, second = (
            np.round(1e3 * data.since(int(rover.week[0]))[rows.epoch]).astype(np.int64) * 1000 + rows.satellite
            for data, rows in ((rover, ours), (base, theirs))
        )
        _, i, j = np.intersect1d(first, second, return_indices=True)
        for code in (code for code in ours.codes if code in theirs.codes and code[0] in "CLP"):
            one, other = ours.column(code)[i], theirs.column(code)[j]
            there = (one != 0.0) & (other != 0.0)
            yield int((there & (one == other)).sum()), int(there.sum())


def check_places(
    rover: Observations, base: Observations, table: Ephemerides, ionosphere: Klobuchar | None, base_m: Array,
    source: str, rover_m: Array | None, given: GivenBy,
) -> tuple[float | None, float | None]:  # fmt: skip
    """Distances of the base, at ``base_m`` (3,) from ``source``, and of a rover that is said to stand at ``rover_m``
    from where their own codes put them [m]; None without positions from codes, or of the rover.

    Raises
    ------
    InputError
        A receiver cannot be at its position, or it moves.
    """
    choice = choose_signals(rover, base, 1)
    own = require_gps_time("base", base, choice.base, choice, table, ionosphere)
    at_rover = require_gps_time("rover", rover, choice.rover, choice, table, ionosphere)
    theirs = None if rover_m is None else at_rover
    remedy = f"{'correct' if source == given.base else 'give'} {given.base}"
    if theirs is not None and rover_m is not None and _is_at(own, rover_m) and _is_at(theirs, base_m):
        remedy = f"{given.rover} fits them, and that of the base the rover's: exchange the two, or rover and base"
    elif _is_at(own, _from_radians(base_m)):
        remedy = f"it is probably given in radians: convert {source} to degrees"
    _require_base(own, base_m, source, remedy)
    if theirs is None or rover_m is None:
        return own.distance_m(base_m), None
    _require_rover(theirs, rover_m, given.rover)
    return own.distance_m(base_m), theirs.distance_m(rover_m)


def _is_at(own: CodePlaces, place_m: Array) -> bool:
    away = own.distance_m(place_m)
    return away is not None and away <= WRONG_M


def _from_radians(place_m: Array) -> Array:
    """Where a place (3,) is, if the degrees that gave it are radians; itself if they cannot be."""
    latitude, longitude, height = geodetic_from_ecef(place_m)
    if abs(math.degrees(latitude)) > 0.5 * math.pi:
        return place_m
    return np.asarray(ecef_from_geodetic(math.degrees(latitude), math.degrees(longitude), height))


def _require_base(own: CodePlaces, place_m: Array, source: str, remedy: str) -> None:
    if own.moves:
        raise InputError(
            f"the base must stand still, its codes say that it moves: {_spread(own)}; check that --rover and --base "
            "are not swapped"
        )
    away = own.distance_m(place_m)
    if away is None or away <= WRONG_M:
        return
    raise InputError(
        f"the position of the base, from {source}, must be that of its antenna, its own codes put it "
        f"{_length(away)} away, near {_near(own)}: every position would be wrong by as much; {remedy}"
    )


def _require_rover(own: CodePlaces, place_m: Array, source: str) -> None:
    if own.moves:
        raise InputError(
            f"{source} is for a rover that stands, its codes say that it moves: {_spread(own)}; leave it out, and "
            "compare the solution with a true track"
        )
    away = own.distance_m(place_m)
    if away is not None and away > WRONG_M:
        raise InputError(
            f"the true position of the rover, from {source}, must be that of its antenna, its own codes put it "
            f"{_length(away)} away, near {_near(own)}: every error would be wrong by as much; correct {source}, or "
            "leave it out"
        )


def require_standing(rover: Observations, base: Observations, table: Ephemerides) -> None:
    """Raise InputError where the codes of a rover that is said to stand show that it moves."""
    choice = choose_signals(rover, base, 1)
    own = CodePlaces(rover, choice.rover, choice, table)
    if own.moves:
        raise InputError(
            f"the rover must stand with --static (static), its codes say that it moves: {_spread(own)}; leave the "
            "option out"
        )


def require_still(solved: Baseline) -> None:
    """Raise InputError where the fixed positions of a rover that is said to stand, each of its own epoch, differ."""
    places = solved.enu_m[solved.fixed]
    if not len(places):
        return
    away = float(np.linalg.norm((places - np.median(places, axis=0))[:, :2], axis=1).max())
    if away > STILL_M:
        raise InputError(
            f"the rover must stand with --static (static), its fixed positions differ by {away:.1f} m, the bound is "
            f"{STILL_M:g} m: leave the option out, or cut the files to the time in which it stands"
        )


def baseline_fit(solved: Baseline, rover_m: Array) -> dict[str, Any] | None:
    """How far the fixed baseline, median, is from that of the two positions [m], and from that of the two swapped.

    ``likely`` says what is probably wrong where it is beyond STILL_M; None without fixed positions.
    """
    if not solved.fixed.any():
        return None
    found = np.median(solved.ecef_m[solved.fixed], axis=0) - solved.base_ecef_m
    given = rover_m - solved.base_ecef_m
    off, swapped = float(np.linalg.norm(found - given)), float(np.linalg.norm(found + given))
    likely = None
    if off > STILL_M:
        likely = "swapped" if swapped < STILL_M else "wrong"
    return {"off_m": off, "off_swapped_m": swapped, "likely": likely}


def navigation_notes(files: Mapping[str, Ephemerides], rover: Observations) -> dict[str, str]:
    """By name, the navigation files without a message for any time of the rover, if others have some."""
    seen = rover.week[[0, -1]] * WEEK_S + rover.tow_s[[0, -1]]
    notes = {}
    for name, table in files.items():
        valid_s = VALID_FOR_S[table.system]
        if ((table.toe_s + valid_s >= seen[0]) & (table.toe_s - valid_s <= seen[1])).any():
            continue
        sent = [table.toe_s.min(), table.toe_s.max()] if len(table) else []
        others = "; ".join(("it holds none of GPS, Galileo, BeiDou and QZSS", *table.left_out))
        held = f"its messages are of {' to '.join(map(date_text, sent))} and not used" if sent else others
        notes[name] = f"no message of that time, {' to '.join(map(date_text, seen))}: {held}"
    return notes if len(notes) < len(files) else {}


def _spread(own: CodePlaces) -> str:
    return (
        f"a tenth of their positions lie {_length(own.spread_m)} and more from the median, the bound is {MOVES_M:g} m"
    )


def _near(own: CodePlaces) -> str:
    return ",".join(f"{v:.1f}" for v in np.median(own.places_m, axis=0))


def _length(metres: float) -> str:
    return f"{metres / 1000.0:.1f} km" if metres >= 1000.0 else f"{metres:.0f} m"
