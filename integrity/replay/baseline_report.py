"""Files of an RTK solution of a recorded pair: positions, levels and statistics, and errors if the truth is known.

The pair is checked: whether its files and given positions fit what its codes and its fixed baseline say.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.accuracy import bounding_by_axis, doubt
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import (
    ecef_from_geodetic,
    enu_axes,
    geodetic_from_ecef,
    track_from_enu_matrix,
)
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.recorded.rinex_observation import WEEK_S, Observations, read_observations
from lanebound.integrity.recorded.rtklib import MATCHED_S, ReferenceTrack, read_reference
from lanebound.integrity.recorded.source import finite_number, leap_seconds
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.baseline import (
    Baseline,
    BaselineConfig,
    base_antenna,
    date_text,
    on_earth,
    solve_baseline,
)
from lanebound.integrity.replay.code_places import MOVES_M, WRONG_M, CodePlaces, require_gps_time
from lanebound.integrity.replay.signal_choice import choose_signals
from lanebound.integrity.sky.broadcast import VALID_FOR_S, Ephemerides, read_navigation
from lanebound.integrity.sky.klobuchar import Klobuchar, read_klobuchar

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
        of_rover, of_base = rover.rows[letter], base.rows[letter]
        first, second = (
            np.round(1e3 * data.since(int(rover.week[0]))[rows.epoch]).astype(np.int64) * 1000 + rows.satellite
            for data, rows in ((rover, of_rover), (base, of_base))
        )
        _, i, j = np.intersect1d(first, second, return_indices=True)
        for code in (code for code in of_rover.codes if code in of_base.codes and code[0] in "CLP"):
            one, other = of_rover.column(code)[i], of_base.column(code)[j]
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
    remedy = f"{'correct' if source == given.base else 'give'} {given.base}"
    if rover_m is not None and _is_at(own, rover_m) and _is_at(at_rover, base_m):
        remedy = f"{given.rover} fits them, and that of the base the rover's: exchange the two, or rover and base"
    elif _is_at(own, _from_radians(base_m)):
        remedy = f"it is probably given in radians: convert {source} to degrees"
    _require_base(own, base_m, source, remedy)
    if rover_m is None:
        return own.distance_m(base_m), None
    _require_rover(at_rover, rover_m, given.rover)
    return own.distance_m(base_m), at_rover.distance_m(rover_m)


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


HEAD = (
    "week", "tow_s", "mode", "status", "x_m", "y_m", "z_m", "east_m", "north_m", "up_m", "heading_rad", "pl_at_m",
    "pl_ct_m", "sigma_at_m", "sigma_ct_m", "satellites", "excluded", "wrong_fix_risk", "age_s",
)  # fmt: skip

CAUTION = (
    "epochs of one session are not independent: adjacent epochs share satellites, multipath and integers. The exact "
    "intervals are therefore too narrow"
)


def run_baseline(
    rover: Path, base: Path, navigation: Sequence[Path], out: Path, *, base_ecef_m: Array | None = None,
    rover_ecef_m: Array | None = None, truth: Path | None = None, config: BaselineConfig | None = None,
    progress: Progress = silent, given: GivenBy = OPTIONS,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Solve RINEX files of a rover, a base and their navigation, which are merged.

    Writes ``solution.csv`` and ``rtk.json`` into ``out``.
    ``base_ecef_m`` and ``rover_ecef_m`` (3,) are antenna reference points: of the base, by default that of its header,
    and of a rover that stands, if its true position is known; ``truth`` is a table of the true positions of one that
    moves (:func:`~..recorded.rtklib.read_reference`). Errors are then reported. ``progress`` is called with the number
    of solved epochs and the total number. ``given`` names the inputs of the positions in messages.

    Raises
    ------
    InputError
        A file is invalid, the files do not belong together, the codes contradict a position that is given, or the rover
        has two true positions, or none at its epochs.
    """
    if truth is not None and rover_ecef_m is not None:
        raise InputError(f"a rover that stands has {given.rover}, one that moves --truth, got both: leave one out")
    track = None if truth is None else read_reference(truth)
    if Path(rover).resolve() == Path(base).resolve():
        raise InputError(f"rover and base must be files of two receivers, got {rover} twice: correct one of the paths")
    rover_data, base_data = read_observations(rover), read_observations(base)
    require_two_receivers(rover_data, base_data)
    files = {str(path): read_navigation(path) for path in navigation}
    table = Ephemerides.merged(list(files.values()))
    config, source = config or BaselineConfig(), "the header of its file" if base_ecef_m is None else given.base
    place = base_antenna(base_data, base_ecef_m)
    away: tuple[float | None, float | None] = None, None
    if len(table):
        away = check_places(
            rover_data, base_data, table, read_klobuchar(navigation), place, source, rover_ecef_m, given
        )
        if config.static:
            require_standing(rover_data, base_data, table)
    solved = solve_baseline(rover_data, base_data, table, place, config, progress)
    if config.static:
        require_still(solved)
    notes = {"rover": rover_data.note, "base": base_data.note, "navigation": table.stopped}
    notes |= navigation_notes(files, rover_data)
    summary = {
        "stopped": {name: note for name, note in notes.items() if note},
        "signals": {"rover": solved.choice.rover, "base": solved.choice.base},
        "base_antenna_ecef_m": solved.base_ecef_m.tolist(),
        "base_antenna_from": source,
        "positions_given_by": given._asdict(),
        "base_from_codes_m": away[0],
        "base_from_header_m": _distance_to_header(solved.base_ecef_m, base_data.header.antenna_ecef_m),
        "half_cycle_share": {"rover": rover_data.half_cycle_share, "base": base_data.half_cycle_share},
        "antenna_delta_enu_m": {
            "rover": rover_data.header.antenna_delta_enu_m,
            "base": base_data.header.antenna_delta_enu_m,
        },
        **summarise(solved, rover_ecef_m if track is None else _true_places(solved, track, truth)),
    }
    if rover_ecef_m is not None:
        summary |= {"rover_from_codes_m": away[1], "fixed_baseline": baseline_fit(solved, rover_ecef_m)}
    written = [out / "rtk.json", out / "solution.csv"]
    write_summary(written[0], summary)
    with written[1].open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEAD)
        writer.writerows(_rows(solved))
    return summary, written


def _true_places(solved: Baseline, track: ReferenceTrack, path: Path | None) -> Array:
    """True positions (T, 3) of the epochs of the rover ECEF [m], NaN where the track has none."""
    found = track.at(solved.week * WEEK_S + solved.tow_s)
    if np.isnan(found).all():
        first, last = (f"{t:.1f}" for t in track.tow_s[[0, -1]])
        raise InputError(
            f"--truth must have positions within {MATCHED_S:g} s of epochs of the rover (time of week "
            f"{solved.tow_s[0]:.1f} to {solved.tow_s[-1]:.1f} s), got {path} with {first} to {last} s: use the track "
            "of the same drive in GPS time"
        )
    _require_no_shift(solved, track, found)
    return found


def _require_no_shift(solved: Baseline, track: ReferenceTrack, found: Array) -> None:
    """Refuse a track that fits the fixed positions only with its times moved by leap seconds."""
    time, known = solved.week * WEEK_S + solved.tow_s, solved.fixed & np.isfinite(found[:, 0])

    def off_m(places: Array) -> float:
        return float(np.nanmedian(np.linalg.norm(places - solved.ecef_m, axis=1)[known]))

    if not known.any():
        return
    leap_s = float(leap_seconds(time[:1])[0])
    for shift_s in (-leap_s, leap_s):
        moved = track.at(time + shift_s)
        here = np.isfinite(moved[:, 0]) & known
        if here.any() and off_m(found) > STILL_M > 2.0 * off_m(np.where(here[:, None], moved, np.nan)):
            raise InputError(
                f"--truth must be in GPS time, got positions {off_m(found):.0f} m off, which fit {abs(shift_s):g} s "
                f"{'earlier' if shift_s < 0.0 else 'later'}: convert its times from UTC"
            )


def _distance_to_header(place: Array, header: Array | None) -> float | None:
    """Distance of the base from the position in its header [m], None if the header has no position or 0, 0, 0."""
    return float(np.linalg.norm(place - header)) if header is not None and np.any(header) else None


def _rows(solved: Baseline) -> Iterator[list[Any]]:
    """One row for each epoch of the rover; empty cells for missing positions, levels and ages."""
    for k in range(len(solved.tow_s)):
        there = solved.mode[k] != Mode.NONE
        place = [*solved.ecef_m[k], *solved.enu_m[k]]
        levels = [*solved.pl_m[k], *solved.sigma_m[k]]
        yield [
            int(solved.week[k]), f"{solved.tow_s[k]:.4f}", Mode(int(solved.mode[k])).key,
            RtkStatus.from_code(int(solved.status[k])).name.lower(), *(f"{v:.4f}" if there else "" for v in place),
            f"{solved.heading_rad[k]:.6f}", *(f"{v:.4f}" if np.isfinite(v) else "" for v in levels),
            int(solved.satellites[k]), int(solved.excluded[k]), f"{solved.wrong_fix_risk[k]:.3e}",
            f"{solved.age_s[k]:.3f}" if np.isfinite(solved.age_s[k]) else "",
        ]  # fmt: skip


def summarise(solved: Baseline, rover_ecef_m: Array | None = None) -> dict[str, Any]:
    """Statistics of a solution as JSON data; epochs are those of the rover.

    ``rover_ecef_m`` is the true position (3,) of a rover that stands, or that of each epoch (T, 3), NaN for none.
    """
    fixed, there, modes = solved.fixed, solved.mode != Mode.NONE, np.bincount(solved.mode, minlength=len(Mode))
    found: dict[str, Any] = {
        "epochs": len(solved.tow_s), "fixed": int(fixed.sum()), "fixed_share": float(fixed.mean()),
        "first_fix_s": _first_fix_s(solved), "modes": {m.key: int(modes[m]) for m in Mode},
        "status": RtkStatus.count(solved.status),
        "satellites_median": float(np.median(solved.satellites[there])) if there.any() else 0.0,
        "excluded": int(solved.excluded.sum()),
        "wrong_fix_risk_max": float(solved.wrong_fix_risk[fixed].max()) if fixed.any() else None,
    }  # fmt: skip
    waiting = solved.status == RtkStatus.NOT_CONVERGED.code
    if waiting.any():
        found["not_converged"] = _lacking(solved, waiting)
    if fixed.any():
        finite = solved.pl_m[fixed]
        found["pl_fixed_median_m"] = {
            axis: float(np.median(finite[:, q])) if np.isfinite(finite[:, q]).all() else None
            for q, axis in enumerate(("at", "ct"))
        }
    if rover_ecef_m is not None:
        found |= _errors(solved, rover_ecef_m) | {"caution": CAUTION}
    return found


def _first_fix_s(solved: Baseline) -> float | None:
    """Time from the first epoch of the rover to the first that is fixed [s]; None without."""
    if not solved.fixed.any():
        return None
    k = int(np.argmax(solved.fixed))
    return float((solved.week[k] - solved.week[0]) * WEEK_S + solved.tow_s[k] - solved.tow_s[0])


def _lacking(solved: Baseline, waiting: NDArray[np.bool_]) -> dict[str, Any]:
    """What epochs that did not converge lacked: their failure rate and its limit, and their signals."""
    sought = waiting & (solved.searched > 0)
    rate = float(np.median(solved.failure[sought])) if sought.any() else None
    signals = float(np.median(solved.searched[sought])) if sought.any() else 0.0
    if rate is None:
        used = "; ".join(f"{letter} {' '.join(codes)}" for letter, codes in solved.choice.rover.items())
        what = (
            f"no position from the codes passed its test: it needs more satellites above "
            f"{solved.rtk.elevation_mask_deg:g} deg with {solved.rtk.cn0_min_dbhz:g} dB-Hz and more at both receivers "
            f"on the bands in use (rover: {used})"
        )
    else:
        also = ", which what was measured did not meet either" if solved.rtk.posterior_margin > 0.0 else ""
        bands = "" if solved.choice.bands >= 2 else ", a second band"
        what = (
            f"the failure rate of the integers of {signals:g} signals was {rate:.1e} (median), its limit is "
            f"{solved.failure_limit:.1e}{also}: more satellites{bands}, a shorter baseline or a longer time lower it"
        )
    return {"failure_rate_median": rate, "failure_limit": solved.failure_limit, "signals_median": signals,
            "what": what}  # fmt: skip


def _errors(solved: Baseline, rover_ecef_m: Array) -> dict[str, Any]:
    """Errors against the true position, for fixed epochs and for all epochs with a position, and doubts of levels."""
    true = np.broadcast_to((rover_ecef_m - solved.base_ecef_m) @ enu_axes(solved.base_ecef_m), solved.enu_m.shape)
    known = np.isfinite(true[:, 0])
    out: dict[str, Any] = {}
    doubts = []
    for name, keep in (("fixed", solved.fixed & known), ("all", (solved.mode != Mode.NONE) & known)):
        if not keep.any():
            continue
        off = solved.enu_m[keep] - true[keep]
        track = (track_from_enu_matrix(solved.heading_rad[keep]) @ off[:, :2, None])[..., 0]
        doubts.append(doubt(solved.risk, track, solved.pl_m[keep], f"{name} epochs"))
        out[name] = {
            "horizontal_median_m": float(np.median(horizontal := np.hypot(*off[:, :2].T))),
            "horizontal_95_m": float(np.quantile(horizontal, 0.95)),
            "horizontal_max_m": float(horizontal.max()),
            "spatial_max_m": float(np.linalg.norm(off, axis=1).max()),
            "mean_enu_m": off.mean(0).tolist(),
            **bounding_by_axis(track, solved.pl_m[keep]),
        }  # fmt: skip
    return {"errors": out, "doubt": next(filter(None, doubts), None)}


def read_coordinates(text: str) -> Array:
    """Parse ``x,y,z`` [m] or ``latitude,longitude,height`` [deg, m], or a file with them, to ECEF (3,) [m].

    Raises
    ------
    InputError
        There are not three numbers, or they are not coordinates near the Earth's surface.
    """
    words = text.replace(",", " ").split()
    if len(words) != 3 and Path(text).is_file():
        words = Path(text).read_text(encoding="utf-8-sig", errors="replace")[:1000].replace(",", " ").split()
    try:
        values = [finite_number(word, -1e8, 1e8) for word in words]
    except ValueError as error:
        raise InputError(f"coordinates '{text[-60:]}': {error}; write x,y,z or latitude,longitude,height") from None
    if len(values) != 3:
        raise InputError(f"coordinates must be three numbers or a file of them, got '{text[-60:]}': write x,y,z [m]")
    place = np.array(values)
    if abs(values[0]) <= 90.0 and abs(values[1]) <= 360.0:
        place = ecef_from_geodetic(np.radians(values[0]), np.radians(values[1]), values[2])
    if not on_earth(place):
        raise InputError(
            f"coordinates must lie near the Earth's surface as x,y,z [m], or be latitude in [-90, 90] and longitude in "
            f"[-360, 360] deg with a height, got '{text[-60:]}': write latitude before longitude"
        )
    return place
