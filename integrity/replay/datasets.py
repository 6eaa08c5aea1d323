"""A folder of a recorded data set, told by what it holds, replayed and written down."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.progress import Progress, silent

__all__ = ["kind_of", "replay_folder"]

KINDS = {
    "smartloc": "*_Input.txt(.gz) and *_GT.txt of smartLoc",
    "comma2k19": "global_pose, CAN and IMU of a comma2k19 segment",
    "rinex": "rover.obs, base.obs and base.nav (or rover.nav) in RINEX 3",
}
POSITION_FILE = "{}_position.txt"  # latitude and longitude [deg], ellipsoidal height [m]


def kind_of(folder: Path) -> str:
    """``smartloc``, ``comma2k19`` or ``rinex``.

    Raises
    ------
    InputError
        The folder is none of them.
    """
    if list(folder.glob("*_Input.txt*")):
        return "smartloc"
    if (folder / "global_pose").is_dir():
        return "comma2k19"
    if (folder / "rover.obs").is_file() and (folder / "base.obs").is_file():
        return "rinex"
    told = "; ".join(f"{what} ({name})" for name, what in KINDS.items())
    raise InputError(f"{folder} must be a folder of a recorded data set, is none: {told}")


def replay_folder(
    folder: Path,
    out: Path,
    changes: Mapping[str, Any] | None = None,
    told: Progress = silent,
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a data set; returns what was counted and the files written into ``out``.

    ``changes`` are those to the configuration of the kind: :class:`~.city_report.CityReplay`,
    :class:`~.outages.OutageConfig` or :class:`~.baseline.BaselineConfig`. ``told`` is called with the epochs solved and
    their number.

    Raises
    ------
    InputError
        The folder is of no known kind, a file is refused, or a change is.
    """
    kind, changed = kind_of(folder), dict(changes or {})
    if kind == "smartloc":
        from lanebound.integrity.replay.city_report import CityReplay, write_city

        return write_city(folder, out, CityReplay.build(None, changed), told)
    if kind == "comma2k19":
        from lanebound.integrity.replay.outages import OutageConfig
        from lanebound.integrity.replay.outages_report import write_outages

        return write_outages(folder, out, OutageConfig.build(None, changed))
    return _replay_rinex(folder, out, changed, told)


def _replay_rinex(
    folder: Path, out: Path, changes: dict[str, Any], told: Progress
) -> tuple[dict[str, Any], list[Path]]:
    """The pair of a folder, with the positions that lie beside it."""
    from lanebound.integrity.replay.baseline import BaselineConfig
    from lanebound.integrity.replay.baseline_report import read_coordinates, run_baseline

    navigation = [path for name in ("base.nav", "rover.nav") if (path := folder / name).is_file()]
    if not navigation:
        raise InputError(f"{folder} must hold base.nav or rover.nav beside rover.obs, has neither: add the messages")
    known = {}
    for who in ("base", "rover"):
        path = folder / POSITION_FILE.format(who)
        known[f"{who}_ecef_m"] = read_coordinates(str(path)) if path.is_file() else None
    config = BaselineConfig.build(None, changes)
    found, written = run_baseline(
        folder / "rover.obs", folder / "base.obs", navigation[0], out, base_ecef_m=known["base_ecef_m"],
        rover_ecef_m=known["rover_ecef_m"], config=config, told=told,
    )  # fmt: skip
    return {"dataset": "rinex", **found}, written
