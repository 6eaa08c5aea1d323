"""City models from files: OBJ, PLY, GLB and STL."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.sky.scene import City, Surface

__all__ = ["MESH_SUFFIXES", "city_from_mesh"]

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".stl")
LEAST_AREA_M2 = 1e-10
LARGEST_BYTES = 48 * 2**20  # read in 0.9 GiB, which is some 2.5 million triangles of a binary file


def city_from_mesh(
    path: str | FilePath,
    *,
    y_up: bool = False,
    origin_enu_m: ArrayLike = (0.0, 0.0, 0.0),
    surface: Surface = Surface.SOLID,
) -> City:
    """Obstacles from a mesh file in metres: x East, y North, z up.

    Parameters
    ----------
    path : an OBJ, PLY, GLB or STL file
    y_up : the file has x East, y up, z South, as GLB prescribes
    origin_enu_m : (3,) where the file's origin lies in the street's frame
    surface : what all its triangles are

    Faces without area are dropped.

    Raises
    ------
    InputError
        The file is missing, of another kind, too large, cut short, empty, or without a face of positive area. What a
        cut file still holds is not taken: the sky of half a city would look too free.
    """
    file = FilePath(path)
    offset = require_finite("origin_enu_m", origin_enu_m)
    require_shape("origin_enu_m", offset, (3,))
    if file.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"mesh {file} must end in one of {MESH_SUFFIXES}, got {file.suffix!r}: convert it")
    if not file.is_file():
        raise InputError(f"mesh {file} must be a file, got none there: check the path")
    if (size := file.stat().st_size) > LARGEST_BYTES:
        raise InputError(f"mesh {file} must have at most {LARGEST_BYTES} bytes, has {size}: cut the city into parts")
    vertices, faces = _load(file)
    if faces.size == 0:
        raise InputError(f"mesh {file} must hold triangles, got none: is the file empty or cut short?")
    if faces.min() < 0 or faces.max() >= vertices.shape[0]:
        raise InputError(
            f"mesh {file}: faces must name vertices 0..{vertices.shape[0] - 1}, got {faces.max()}: is it cut short?"
        )
    corners = require_finite(f"mesh {file.name} vertices", vertices)
    if y_up:
        corners = np.stack([corners[:, 0], -corners[:, 2], corners[:, 1]], -1)
    triangles = (corners + offset)[faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sound = 0.5 * np.linalg.norm(cross, axis=-1) > LEAST_AREA_M2
    if not sound.any():
        raise InputError(
            f"mesh {file} must hold a face of positive area, got {faces.shape[0]} flat ones: check its units"
        )
    return City.of(triangles[sound], surface)


def _load(file: FilePath) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) with all parts of a scene merged."""
    import trimesh

    try:
        mesh: Any = trimesh.load(file, force="mesh", process=False)
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as exc:  # each of trimesh's readers fails in its own ways
        raise InputError(f"mesh {file} must be a sound {file.suffix} file, got: {exc or type(exc).__name__}") from exc
    return vertices, faces
