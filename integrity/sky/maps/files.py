"""Street maps by name: packaged ones of ``configs/maps``, and files."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from pathlib import Path

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest
from lanebound.integrity.sky.maps.osm import SUFFIXES, read_osm
from lanebound.integrity.sky.maps.records import StreetMap

__all__ = ["map_of", "packaged_maps"]

FOLDER = "maps"


def packaged_maps() -> dict[str, Path]:
    """The packaged maps by name."""
    folder = Path(str(resources.files("lanebound.configs").joinpath(FOLDER)))
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {file.name.partition(".")[0]: file for file in files if file.name.endswith(SUFFIXES)}


def map_of(name: str) -> StreetMap:
    """The map of a name or of a file; a file is read again only after a change.

    Raises
    ------
    InputError
        There is none, or its reader refuses it.
    """
    packaged = packaged_maps()
    file = packaged.get(name, Path(name))
    try:
        state = file.stat()
    except OSError as error:
        known = nearest(name, packaged) if packaged else "pass a file"
        raise InputError(f"map must be a packaged one or a file, got {name!r}: {known}, and generated:SEED") from error
    return _read(str(file), state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=4)
def _read(path: str, changed_ns: int, size: int) -> StreetMap:
    return read_osm(path)
