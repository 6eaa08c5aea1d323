"""A recorded sky along a lane network: the obstacles beside the recorded car are placed beside the lanes.

The recorded drive is repeated as a loop, with a start drawn by the layout seed. Distance along the road replaces the
distance driven, and the direction of the lane replaces the direction of travel. Each cell of the sky has the recorded
signal that is nearest in place and direction. All lanes of an edge have the same sky.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.sky.corridors import Corridor, edges_of
from lanebound.envs.sky.street import LaneMap, Street
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.recorded.sky_recording import SkyRecording, read_sky_recording
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

__all__ = ["recorded_street", "recording_of"]

Array = NDArray[np.float64]

AZIMUTHS, ELEVATIONS = 60, 18  # cells of 6 by 5 degrees: a recording of some 20 satellites has nothing finer


def recording_of(path: str) -> SkyRecording:
    """Read the recording of a file; a file is read again only after a change.

    Raises
    ------
    InputError
        The file cannot be read, or is truncated.
    """
    try:
        state = Path(path).stat()
    except OSError as error:
        raise InputError(f"sky must name a recorded sky, got {path}, which cannot be read: {error}") from error
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=4)
def _read(path: str, changed_ns: int, size: int) -> SkyRecording:
    recording = read_sky_recording(path)
    if recording.stopped is not None:
        raise InputError(f"sky must be a whole recording, got {path}, {recording.stopped}: write it again")
    return recording


def recorded_street(
    network: RoadNetwork, members: list[Corridor], lanes: LaneMap, recording: SkyRecording, layout_seed: int,
    widest: int = 0,
) -> Street:  # fmt: skip
    """Build the street of a network with the sky of a recording; ``widest``: number of lanes at least.

    The forecast for a planner is the recording itself: an earlier drive is used as the map.
    """
    chains = max(corridor.chain for corridor in members) + 1
    phase_m = recording.length_m * named_generator(layout_seed, "city").random(chains)
    begin_m = {c.edge: float(phase_m[c.chain]) + c.start_m for c in members}
    arc, heading = [], []
    for edge, group in edges_of(network):
        s = lanes.spacing_m * np.arange(lanes.stations(edge, len(group)), dtype=np.float64)
        arc.append(begin_m[edge] + s)
        heading.append(_headings(group[0], s))
    path, excess = _tables(recording, np.concatenate(arc), np.concatenate(heading))
    widest = max(widest, *(len(group) for _, group in edges_of(network)))
    path, excess = np.repeat(path[:, None], widest, 1), np.repeat(excess[:, None], widest, 1)
    length = lanes.spacing_m * len(path)
    mask = SkyMask(path, excess, AZIMUTHS, ELEVATIONS, lanes.spacing_m, length, False, recording.digest)
    free = (path == SignalPath.LOS) | (path == SignalPath.FOLIAGE)
    return Street(mask, SkyForecast(free, AZIMUTHS, ELEVATIONS, lanes.spacing_m), City.empty(), lanes)


def _headings(lane: AbstractLane, longitudinal_m: Array) -> Array:
    """Direction of a lane from North, clockwise [rad].  (n,) -> (n,). ``E = x``, ``N = -y`` of highway-env."""
    reach = np.minimum(longitudinal_m, float(lane.length))
    return 0.5 * np.pi + np.array([float(lane.heading_at(float(s))) for s in reach])


def _tables(recording: SkyRecording, arc_m: Array, heading_rad: Array) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Paths and excesses (N, A E) at N stations."""
    azimuth = np.repeat(2.0 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS, ELEVATIONS)
    elevation = np.tile(0.5 * np.pi * (np.arange(ELEVATIONS) + 0.5) / ELEVATIONS, AZIMUTHS)
    row = np.stack([
        recording.nearest(np.full(azimuth.size, arc), azimuth - heading, elevation)
        for arc, heading in zip(arc_m, heading_rad, strict=True)
    ])  # fmt: skip
    return recording.path[row], recording.excess_m[row].astype(np.float32)
