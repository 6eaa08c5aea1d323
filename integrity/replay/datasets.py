"""Replay of a folder with a recorded data set, whose kind is detected from its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.replay.imu_outages import imu_files
from lanebound.integrity.replay.pair_files import find_pair, observation_files

__all__ = ["kind_of", "replay_folder"]

KINDS = {
    "smartloc": "*_Input.txt(.gz) and *_GT.txt of smartLoc",
    "comma2k19": "global_pose, CAN and IMU of a comma2k19 segment",
    "imu_log": "an inertial log NAME.csv with NAME.csv.tag next to a solution .pos of RTKLIB",
    "rinex": "two observation files and navigation in RINEX 2 to 4, such as rover.obs, base.obs and base.nav",
}
POSITION_FILE = "{}_position.txt"  # latitude and longitude [deg], ellipsoidal height [m]


def kind_of(folder: Path) -> str:
    """Detect the kind of data set in a folder: ``smartloc``, ``comma2k19``, ``imu_log`` or ``rinex``.

    Raises
    ------
    InputError
        The folder is of no known kind.
    """
    if list(folder.glob("*_Input.txt*")):
        return "smartloc"
    if (folder / "global_pose").is_dir():
        return "comma2k19"
    if imu_files(folder):
        return "imu_log"
    if observation_files(folder):
        return "rinex"
    if not folder.is_dir():
        raise InputError(f"the data set must be a folder that exists, got {folder}: correct the path")
    known = "; ".join(f"{what} ({name})" for name, what in KINDS.items())
    raise InputError(f"the data set must be of a known kind, got {folder} with the files of none: it needs {known}")


def replay_folder(
    folder: Path,
    out: Path,
    changes: Mapping[str, Any] | None = None,
    progress: Progress = silent,
    service: Sequence[str] = (),
    navigator: str | None = None,
    roads: Path | None = None,
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a data set; returns the statistics and the files written into ``out``.

    With ``service`` the recording runs through a navigator with these positioning services (:mod:`.service_report`),
    and ``changes`` are those of its configuration.

    ``changes`` are overrides of the configuration of the kind: :class:`~.city.CityReplay`,
    :class:`~.outages.OutageConfig`, :class:`~.imu_outages.ImuOutageConfig` or :class:`~.baseline.BaselineConfig`.
    ``progress`` is called with the number of solved epochs and the total number. ``navigator`` names a filter, by kind
    or preset, in place of the method of the kind of data set; ``changes`` are then those of
    :class:`~.filter_drive.FilterReplayConfig`. With ``roads``, a map as GeoJSON, the context monitor judges the drive;
    ``changes`` are of :class:`~.context_epochs.ContextReplayConfig`.

    Raises
    ------
    InputError
        The folder is of no known kind, or a file or a change is invalid.
    """
    kind, changed = kind_of(folder), dict(changes or {})
    if kind == "imu_log" and (service or navigator is not None or roads is not None):
        option = "service" if service else "roads" if navigator is None else "navigator"
        raise InputError(f"{option} must be left out for an inertial log, which has neither codes nor wheels, "
                         f"got {navigator or roads or ', '.join(service)}: replay it alone")  # fmt: skip
    if roads is not None:
        from lanebound.integrity.replay.context_drive import write_context

        return write_context(folder, kind, roads, out, changed, progress)
    if service:
        from lanebound.integrity.replay.service_drive import write_service

        return write_service(folder, kind, service, out, changed, progress)
    if navigator is not None:
        if kind == "rinex":
            raise InputError("navigator must be left out for RINEX, which has no wheels and no gyro, "
                             f"got {navigator}: give a smartLoc or comma2k19 folder")  # fmt: skip
        from lanebound.integrity.replay.filter_drive import write_filter

        return write_filter(folder, kind, out, navigator, changed)
    if kind == "smartloc":
        from lanebound.integrity.replay.city import CityReplay, write_city

        return write_city(folder, out, CityReplay.build(None, changed), progress)
    if kind == "comma2k19":
        from lanebound.integrity.replay.outages import OutageConfig, write_outages

        return write_outages(folder, out, OutageConfig.build(None, changed))
    if kind == "imu_log":
        from lanebound.integrity.replay.imu_outages import ImuOutageConfig, write_imu_outages

        return write_imu_outages(folder, out, ImuOutageConfig.build(None, changed))
    return _replay_rinex(folder, out, changed, progress)


def _replay_rinex(
    folder: Path, out: Path, changes: dict[str, Any], progress: Progress
) -> tuple[dict[str, Any], list[Path]]:
    """Replay the rover and base of a folder, with the positions in its position files."""
    from lanebound.integrity.replay.baseline import BaselineConfig
    from lanebound.integrity.replay.baseline_report import read_coordinates, run_baseline
    from lanebound.integrity.replay.pair_checks import GivenBy

    pair = find_pair(folder)
    known = {}
    for receiver in ("base", "rover"):
        path = folder / POSITION_FILE.format(receiver)
        known[f"{receiver}_ecef_m"] = read_coordinates(str(path)) if path.is_file() else None
    config = BaselineConfig.build(None, changes)
    found, written = run_baseline(
        pair.rover, pair.base, pair.navigation, out, base_ecef_m=known["base_ecef_m"],
        rover_ecef_m=known["rover_ecef_m"], config=config, progress=progress,
        given=GivenBy(POSITION_FILE.format("base"), POSITION_FILE.format("rover")),
    )  # fmt: skip
    return {"dataset": "rinex", **found}, written
