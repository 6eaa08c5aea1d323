"""The files of a RINEX pair in a folder: which receiver is the rover, which the base, and the navigation.

Files are recognized by their first line. Two observation files are told apart by their names (``rover``, ``rov``,
``mobile``; ``base``, ``ref``, ``station``) and otherwise by their positions: the receiver that moves is the rover.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.packed import CRINEX_REMEDY
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.recorded.source import Lines
from lanebound.integrity.replay.code_places import CodePlaces
from lanebound.integrity.replay.signal_choice import choose_signals
from lanebound.integrity.sky.broadcast import Ephemerides, read_navigation

__all__ = ["PairFiles", "find_pair", "navigation_files", "observation_files"]

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
