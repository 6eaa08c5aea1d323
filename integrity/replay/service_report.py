"""Files of a recorded drive with a positioning service: statistics, the solution by epochs, and figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.bounding import measure_bounding
from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.assessment.record import AXES
from lanebound.integrity.assessment.series import series_figure
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.replay.baseline import require_one_site, solve_baseline
from lanebound.integrity.replay.baseline_report import read_coordinates
from lanebound.integrity.replay.city_report import read_city
from lanebound.integrity.replay.pair_files import find_pair, navigation_files, observation_files
from lanebound.integrity.replay.service_drive import ServiceDrive, config_of, drive_service, require_possible
from lanebound.integrity.replay.service_epochs import ServiceEpochs, epochs_of_drive, epochs_of_receiver
from lanebound.integrity.sky.broadcast import Ephemerides, read_navigation
from lanebound.integrity.sky.klobuchar import read_klobuchar

__all__ = ["read_service_epochs", "summarise_service", "write_service"]

Array = NDArray[np.float64]

SMARTLOC_DT_S = 0.1  # its epochs are 0.2 and 0.3 s apart
HEAD = (
    "time_s", "mode", "status", "east_m", "north_m", "heading_rad", "pl_at_m", "pl_ct_m", "alert", "error_e_m",
    "error_n_m",
)  # fmt: skip
LEVEL, NO_LEVEL, NO_POSITION = "level", "no level", "no position"
CAUTION = (
    "epochs of one drive are not independent: adjacent epochs share satellites and reflections. The exact intervals "
    "are therefore too narrow"
)


def write_service(
    folder: Path, kind: str, names: Sequence[str], out: Path, changes: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Drive a recording with services in their order of preference; writes ``service.json``, ``service.csv`` and, with
    a known truth, ``series.png`` into ``out``.

    Parameters
    ----------
    kind : of the recording, as :func:`~.datasets.kind_of` finds it
    changes : overrides of the navigator's configuration

    Raises
    ------
    ConfigError
        A service needs what the recording does not hold, or a change is invalid.
    InputError
        The recording cannot be used for services.
    """
    epochs, dt_s, stopped = read_service_epochs(folder, kind, names)
    config = config_of(epochs, names, dt_s, changes)
    drive = drive_service(epochs, config, progress)
    summary = {
        "dataset": "service", "recording": kind, "service": list(config.service), "stopped": stopped,
        **summarise_service(drive),
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "service.json", out / "service.csv"]
    written[0].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    _write_rows(drive, written[1])
    if drive.judged.any():
        limits = config.alert.limits
        figure = series_figure(
            drive.record(), risk=config.risk.integrity_risk, al_at_m=limits.al_at_m, al_ct_m=limits.al_ct_m
        )
        written.append(save(figure, out / "series.png"))
    return summary, written


def read_service_epochs(
    folder: Path, kind: str, names: Sequence[str]
) -> tuple[ServiceEpochs, float, dict[str, str] | None]:
    """The epochs of a recording, the time between ticks of a navigator [s], and which files end early.

    Raises
    ------
    ConfigError, InputError
        As :func:`write_service`.
    """
    if kind == "comma2k19":
        raise InputError(
            f"--service needs satellite positions, which the pseudoranges in {folder} come without: take a smartLoc "
            "drive or RINEX files with their navigation"
        )
    if kind == "smartloc":
        require_possible(names, False, "a smartLoc drive")
        drive = read_city(folder)
        return epochs_of_drive(drive), SMARTLOC_DT_S, drive.notes or None
    return _rinex_epochs(folder, names)


def _rinex_epochs(folder: Path, names: Sequence[str]) -> tuple[ServiceEpochs, float, dict[str, str] | None]:
    """One receiver alone, or the rover of a pair; the truth is its given position, else fixed RTK positions."""
    alone = len(observation_files(folder)) == 1
    require_possible(names, not alone, "this recording")
    rover_file, base_file, navigation = (
        (observation_files(folder)[0], None, navigation_files(folder)) if alone else find_pair(folder).paths
    )
    rover, base = read_observations(rover_file), None if base_file is None else read_observations(base_file)
    table, ionosphere = Ephemerides.merged([read_navigation(path) for path in navigation]), read_klobuchar(navigation)
    if ionosphere is None:
        raise InputError(
            f"a navigation file in {folder} must have the ionospheric figures GPSA and GPSB in its header, none has: "
            "services on one band need them; download the navigation of the day with its header"
        )
    places = {name: folder / f"{name}_position.txt" for name in ("rover", "base")}
    given = {name: read_coordinates(str(path)) if path.is_file() else None for name, path in places.items()}
    truth, station = None, None
    if base is not None:
        place = base.header.antenna_ecef_m if given["base"] is None else given["base"]
        if place is not None:
            require_one_site(base, given["base"] is not None)
            station = base, place
    if given["rover"] is not None:
        truth = dict.fromkeys(range(rover.epochs), given["rover"]), "given position of the rover"
    elif base is not None:
        solved = solve_baseline(rover, base, table, None if station is None else station[1])
        tow = {round(t, 3): k for k, t in enumerate(rover.tow_s.tolist())}
        found = {tow[round(float(solved.tow_s[k]), 3)]: solved.ecef_m[k] for k in np.flatnonzero(solved.fixed)}
        truth = found, "fixed RTK positions of the pair"
    notes = {"rover": rover.note, "base": "" if base is None else base.note, "navigation": table.stopped}
    epochs = epochs_of_receiver(rover, table, ionosphere, station, truth)
    dt_s = round(float(np.median(np.diff(epochs.time_s))), 3) if rover.epochs > 1 else 1.0
    return epochs, dt_s, {name: note for name, note in notes.items() if note} or None


def summarise_service(drive: ServiceDrive) -> dict[str, Any]:
    """Statistics of a drive as JSON data: errors, levels and shares of the epochs that are judged.

    ``no_level`` and ``modes`` are of all recorded epochs, exceedances of those that have levels.
    """
    epochs, keep = drive.epochs, drive.judged
    there = drive.epoch >= 0
    status = [status_of(drive, int(n)) for n in np.flatnonzero(there)]
    found: dict[str, Any] = {
        "risk": drive.config.risk.integrity_risk, "reference": epochs.reference, "epochs": int(there.sum()),
        "judged": int(keep.sum()), "begun_s": drive.begun_s if np.isfinite(drive.begun_s) else None,
        "no_level": 1.0 - status.count(LEVEL) / len(status), "no_position": status.count(NO_POSITION) / len(status),
        "modes": {m.key: int((drive.mode[there] == int(m)).sum()) for m in Mode if (drive.mode[there] == int(m)).any()},
    }  # fmt: skip
    if not keep.any():
        return found
    record, errors = drive.record(), np.hypot(*drive.errors_en_m().T)
    service = np.array([Mode(int(m)).is_service for m in record.mode])
    figures: dict[str, Any] = {
        "horizontal": _quantiles(errors),
        "horizontal_of_service": _quantiles(errors[service]) if service.any() else None,
        "available": float(record.available.mean()),
        "alert": float(record.alert.mean()),
        "caution": CAUTION,
    }
    level = np.isfinite(record.pl("at") + record.pl("ct"))
    if level.any():  # without one there is nothing to exceed
        figures |= {axis: asdict(measure_bounding(record.error(axis)[level], record.pl(axis)[level])) for axis in AXES}
    return found | figures


def status_of(drive: ServiceDrive, n: int) -> str:
    """Whether tick n has a position with a level, one without, or none."""
    if drive.mode[n] == Mode.NONE:
        return NO_POSITION
    return LEVEL if np.isfinite(drive.pl_m[n]).all() else NO_LEVEL


def _quantiles(error_m: Array) -> dict[str, float]:
    """Median, 95 % and largest of errors (N,) [m]."""
    median, most = np.quantile(error_m, [0.5, 0.95])
    return {
        "epochs": int(error_m.size), "median_m": float(median), "p95_m": float(most), "max_m": float(error_m.max())
    }  # fmt: skip


def _write_rows(drive: ServiceDrive, path: Path) -> None:
    """One row for each recorded epoch; empty cells for what is not known."""
    judged = drive.judged
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEAD)
        for n in np.flatnonzero(drive.epoch >= 0):
            there, levels = drive.mode[n] != Mode.NONE, drive.pl_m[n]
            error = drive.position_en_m[n] - drive.epochs.truth_enu_m[drive.epoch[n], :2]
            writer.writerow([
                f"{drive.time_s[n]:.3f}", Mode(int(drive.mode[n])).key, status_of(drive, int(n)),
                *(f"{v:.3f}" if there else "" for v in drive.position_en_m[n]), f"{drive.heading_rad[n]:.5f}",
                *(f"{v:.3f}" if np.isfinite(v) else "" for v in levels), int(drive.alert[n]),
                *(f"{v:.3f}" if judged[n] else "" for v in error),
            ])  # fmt: skip
