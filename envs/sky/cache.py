"""Cache of streets: a few in memory, more on disk next to the compiled kernels.

The name of a file is a digest of all inputs of the street, including the sources of both sky packages. Without a
writable directory, or with a damaged file, streets are built again.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import zlib
from collections import OrderedDict
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.sky.corridors import edges_of
from lanebound.envs.sky.level import SkyLevel
from lanebound.envs.sky.street import LaneMap, Street
from lanebound.integrity import sky
from lanebound.integrity.core.kernel_cache import cache_root
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.visibility import SkyMask, rows_in

__all__ = ["folder", "key_of", "load", "remember", "save", "sources_digest", "write"]

IN_MEMORY = 32
ON_DISK_BYTES = 2**30  # some hundred cities of each id, at about 1 to 5 MB
SAMPLES = 12  # poses by which a lane is recognised

_recent: OrderedDict[str, Street] = OrderedDict()


def key_of(network: RoadNetwork, level: SkyLevel, *more: Any) -> str:
    """Digest of the inputs of a street; equal inputs give equal digests."""
    h = hashlib.blake2b(digest_size=16)
    h.update(repr((sources_digest(), np.__version__, level.to_json(), more)).encode())
    for edge, lanes in edges_of(network):
        for lane in lanes:
            length = float(lane.length)
            poses = [(*lane.position(s, 0.0), lane.width_at(s)) for s in np.linspace(0.0, length, SAMPLES).tolist()]
            h.update(repr((edge, length)).encode() + np.array(poses, dtype=np.float64).tobytes())
    return h.hexdigest()


@cache
def sources_digest() -> str:
    """Digest of the code that builds streets."""
    h = hashlib.blake2b(digest_size=8)
    for module in (__file__, str(sky.__file__)):
        for source in sorted(Path(module).parent.rglob("*.py")):
            h.update(source.read_bytes())
    return h.hexdigest()


def remember(key: str, street: Street | None = None) -> Street | None:
    """Store ``street``, if given, under a key in memory, and return the stored street of the key."""
    if street is not None:
        _recent[key] = street
    if key in _recent:
        _recent.move_to_end(key)
    while len(_recent) > IN_MEMORY:
        _recent.popitem(last=False)
    return _recent.get(key)


def folder(name: str = "streets") -> Path | None:
    """Directory on disk of streets, or of what else is kept; None without a writable directory."""
    root = cache_root()
    return None if root is None else root / name


def load(key: str, lanes: LaneMap) -> Street | None:
    """Load the street of a key from disk, None if there is no readable file."""
    place = folder()
    if place is None or not (place / f"{key}.npz").exists():
        return None
    try:
        with (place / f"{key}.npz").open("rb") as file, np.load(file, allow_pickle=False) as data:
            city = City(data["triangles"], data["surface"], material=data["material"])
            mask = SkyMask.of_rows(rows_in(data), key)
            forecast = SkyForecast(data["free"], mask.azimuths, mask.elevations, mask.spacing_m)
        with suppress(OSError):
            os.utime(place / f"{key}.npz")  # those used last are kept
    except (OSError, EOFError, KeyError, ValueError, BadZipFile, zlib.error):
        return None
    return Street(mask, forecast, city, lanes)


def save(key: str, street: Street) -> None:
    """Write a street to disk atomically; only the files used last are kept, up to 1 GiB."""
    write(
        folder(), key, free=street.forecast.free, triangles=street.city.triangles_enu_m, surface=street.city.surface,
        material=street.city.material, **street.mask.rows._asdict(),
    )  # fmt: skip


def write(place: Path | None, key: str, **arrays: NDArray[Any]) -> None:
    """Write arrays as a file of a folder atomically; only the files used last are kept, up to 1 GiB."""
    if place is None:
        return
    with suppress(OSError):
        place.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=place, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
            os.replace(name, place / f"{key}.npz")
        except OSError:
            Path(name).unlink(missing_ok=True)
            return
        kept = sorted(place.glob("*.npz"), key=lambda file: file.stat().st_mtime)
        sizes = np.cumsum([file.stat().st_size for file in kept[::-1]])[::-1]
        for old, size in zip(kept[:-1], sizes.tolist(), strict=False):
            if size > ON_DISK_BYTES:
                old.unlink(missing_ok=True)
