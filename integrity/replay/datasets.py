"""Replay of a folder with a recorded data set: its kind, and in a RINEX pair the rover, the base and the navigation.

Files are recognized by their first line. Two observation files are distinguished by their names (``rover``, ``rov``,
``mobile``; ``base``, ``ref``, ``station``) and otherwise by their positions: the receiver that moves is the rover.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.packed import CRINEX_REMEDY
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.recorded.source import Lines
from lanebound.integrity.replay.code_places import CodePlaces
from lanebound.integrity.replay.imu_outages import imu_files
from lanebound.integrity.replay.signal_choice import choose_signals
from lanebound.integrity.sky.broadcast import Ephemerides, read_navigation

RINEX_NAME = re.compile(r"\.(\d\d[a-z]|obs|nav|rnx|crx)(\.\w+)?$", re.IGNORECASE)
NAMES = {"rover": ("rover", "rov", "mobile"), "base": ("base", "ref", "station")}


@dataclass(frozen=True)
class PairFiles:
    """Paths of the observations of rover and base, and of all navigation files."""

    rover: Path
    base: Path
    navigation: list[Path]

    @property
    def paths(self) -> tuple[Path, Path | None, list[Path]]:
        """Rover, base and navigation."""
        return self.rover, self.base, self.navigation


def observation_files(folder: Path) -> list[Path]:
    """The RINEX observation files in a folder, in the order of their names."""
    return _of_type(folder, "O")


def navigation_files(folder: Path) -> list[Path]:
    """The RINEX navigation files in a folder, in the order of their names.

    Raises
    ------
    InputError
        There is none.
    """
    found = _of_type(folder, "NGH")
    if not found:
        raise InputError(
            f"{folder} must hold a RINEX navigation file next to its observations, has none: add one, such as base.nav"
        )
    return found


def _of_type(folder: Path, kinds: str) -> list[Path]:
    """Files whose first line is that of a RINEX file of a type: O (observations), or N, G, H (navigation)."""
    found = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.is_file() and not path.name.startswith("."):
            try:
                first = next(iter(Lines(path)), "")
            except InputError:
                if RINEX_NAME.search(path.name):
                    raise  # it says how to unpack it; a file of another name is none of ours
                continue
            if not path.stat().st_size and RINEX_NAME.search(path.name):
                raise InputError(f"{path} must be a RINEX file, is empty: download it again")
            if first[60:80].startswith("CRINEX") and "O" in kinds:
                raise InputError(f"{path} must be a plain RINEX file: {CRINEX_REMEDY}")
            if first[60:80].strip() == "RINEX VERSION / TYPE" and first[20:21].upper() in tuple(kinds):
                found.append(path)
    return found


def find_pair(folder: Path) -> PairFiles:
    """The files of a pair in a folder.

    Raises
    ------
    InputError
        There are not two observation files and a navigation file, or it is not clear which receiver is the rover.
    """
    files, navigation = observation_files(folder), navigation_files(folder)
    named = {
        role: [p for p in files if any(p.name.lower().startswith(n) for n in names)] for role, names in NAMES.items()
    }
    if all(len(paths) == 1 for paths in named.values()):
        return PairFiles(named["rover"][0], named["base"][0], navigation)
    if len(files) != 2:
        raise InputError(
            f"{folder} must hold observations of two receivers, has {_listed(files)}: name two of them rover.obs and "
            "base.obs, or call lanebound rtk with --rover, --base and --nav"
        )
    moving = _moving(files, navigation)
    if sum(moving) != 1:
        raise InputError(
            f"the rover of {folder} must be known by its name or as the receiver that moves, "
            f"{'both' if all(moving) else 'neither'} of {_listed(files)} moves: name them rover.obs and base.obs, or "
            "call lanebound rtk with --rover, --base and --nav"
        )
    rover = moving.index(True)
    return PairFiles(files[rover], files[1 - rover], navigation)


def _listed(files: list[Path]) -> str:
    return ", ".join(path.name for path in files) or "none"


def _moving(files: list[Path], navigation: list[Path]) -> list[bool]:
    """Whether each of two receivers moves, by positions from its codes."""
    table = Ephemerides.merged([read_navigation(path) for path in navigation])
    first, second = (read_observations(path) for path in files)
    choice = choose_signals(first, second, 1)
    return [
        CodePlaces(data, codes, choice, table).moves for data, codes in ((first, choice.rover), (second, choice.base))
    ]


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

    With ``service`` the recording runs through a navigator with these positioning services (:mod:`.service_drive`),
    and ``changes`` are those of its configuration.

    ``changes`` are overrides of the configuration of the kind: :class:`~.city.CityReplay`,
    :class:`~.outages.OutageConfig`, :class:`~.imu_outages.ImuOutageConfig` or :class:`~.baseline.BaselineConfig`.
    ``progress`` is called with the number of solved epochs and the total number. ``navigator`` names a filter, by kind
    or preset, in place of the method of the kind of data set; ``changes`` are then those of
    :class:`~.filter_drive.FilterReplayConfig`. With ``roads``, a map as GeoJSON, the context monitor judges the drive;
    ``changes`` are of :class:`~.context_drive.ContextReplayConfig`.

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
    from lanebound.integrity.replay.baseline_report import GivenBy, read_coordinates, run_baseline

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
