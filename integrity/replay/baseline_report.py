"""Files of an RTK solution of recorded files: positions, levels and statistics, and errors if the truth is known."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.bounding import doubt, measure_bounding
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import (
    ecef_from_enu_matrix,
    ecef_from_geodetic,
    geodetic_from_ecef,
    track_from_enu_matrix,
)
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.recorded.rinex_observation import WEEK_S, read_observations
from lanebound.integrity.recorded.source import finite_number
from lanebound.integrity.replay.baseline import Baseline, BaselineConfig, base_antenna, on_earth, solve_baseline
from lanebound.integrity.replay.pair_checks import (
    OPTIONS,
    GivenBy,
    baseline_fit,
    check_places,
    navigation_notes,
    require_standing,
    require_still,
    require_two_receivers,
)
from lanebound.integrity.sky.broadcast import Ephemerides, read_navigation
from lanebound.integrity.sky.klobuchar import read_klobuchar

__all__ = ["read_coordinates", "run_baseline", "summarise"]

Array = NDArray[np.float64]

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
    rover_ecef_m: Array | None = None, config: BaselineConfig | None = None, progress: Progress = silent,
    given: GivenBy = OPTIONS,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Solve RINEX files of a rover, a base and their navigation, which are merged.

    Writes ``solution.csv`` and ``rtk.json`` into ``out``.
    ``base_ecef_m`` and ``rover_ecef_m`` (3,) are antenna reference points: of the base, by default that of its header,
    and of a rover that stands, if its true position is known; errors are then reported. ``progress`` is called with the
    number of solved epochs and the total number. ``given`` names the inputs of the positions in messages.

    Raises
    ------
    InputError
        A file is invalid, the files do not belong together, or the codes contradict a position that is given.
    """
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
        **summarise(solved, rover_ecef_m),
    }
    if rover_ecef_m is not None:
        summary |= {"rover_from_codes_m": away[1], "fixed_baseline": baseline_fit(solved, rover_ecef_m)}
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "rtk.json", out / "solution.csv"]
    written[0].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    with written[1].open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEAD)
        writer.writerows(_rows(solved))
    return summary, written


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
    """Statistics of a solution as JSON data; epochs are those of the rover."""
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
    latitude, longitude, _ = geodetic_from_ecef(solved.base_ecef_m)
    true = (rover_ecef_m - solved.base_ecef_m) @ ecef_from_enu_matrix(latitude, longitude)
    out: dict[str, Any] = {}
    doubts = []
    for name, keep in (("fixed", solved.fixed), ("all", solved.mode != Mode.NONE)):
        if not keep.any():
            continue
        off = solved.enu_m[keep] - true
        track = (track_from_enu_matrix(solved.heading_rad[keep]) @ off[:, :2, None])[..., 0]
        doubts.append(doubt(solved.risk, track, solved.pl_m[keep], f"{name} epochs"))
        out[name] = {
            "horizontal_max_m": float(np.hypot(*off[:, :2].T).max()),
            "spatial_max_m": float(np.linalg.norm(off, axis=1).max()),
            "mean_enu_m": off.mean(0).tolist(),
            **{a: asdict(measure_bounding(track[:, q], solved.pl_m[keep, q])) for q, a in enumerate(("at", "ct"))},
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
