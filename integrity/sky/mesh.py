"""City models from mesh files: OBJ, PLY, GLB and STL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.sky.scene import City, Surface

__all__ = ["MESH_SUFFIXES", "city_from_mesh"]

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".stl")
LEAST_AREA_M2 = 1e-10
LARGEST_BYTES = 48 * 2**20  # about 2.5 million triangles of a binary file; reading needs 0.9 GiB


def city_from_mesh(
    path: str | Path,
    *,
    y_up: bool = False,
    origin_enu_m: ArrayLike = (0.0, 0.0, 0.0),
    surface: Surface = Surface.SOLID,
) -> City:
    """Read obstacles from a mesh file in metres: x East, y North, z up.

    Parameters
    ----------
    path : an OBJ, PLY, GLB or STL file
    y_up : the file has x East, y up, z South, as GLB prescribes
    origin_enu_m : (3,) position of the file's origin in the frame of the street
    surface : surface of all triangles

    Faces without area are removed.

    Raises
    ------
    InputError
        The file is missing, of another format, too large, truncated, empty, or without a face of positive area. A
        truncated file is refused because a part of the city would leave too much sky free.
    """
    file = Path(path)
    offset = require_finite("origin_enu_m", origin_enu_m)
    require_shape("origin_enu_m", offset, (3,))
    if file.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"mesh {file} must end in one of {MESH_SUFFIXES}, got {file.suffix!r}: convert it")
    if not file.is_file():
        raise InputError(f"mesh {file} must be a file, which does not exist: check the path")
    if (size := file.stat().st_size) > LARGEST_BYTES:
        raise InputError(f"mesh {file} must have at most {LARGEST_BYTES} bytes, has {size}: cut the city into parts")
    vertices, faces = _load(file)
    if faces.size == 0:
        raise InputError(f"mesh {file} must hold triangles, got none: is the file empty or truncated?")
    if faces.min() < 0 or faces.max() >= vertices.shape[0]:
        raise InputError(
            f"mesh {file}: faces must refer to vertices 0..{vertices.shape[0] - 1}, got {faces.max()}: is it truncated?"
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


def _load(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) of a file, all parts of its scene merged."""
    import trimesh

    try:
        mesh: Any = trimesh.load(file, force="mesh", process=False)
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as exc:  # the readers of trimesh raise errors of many types
        raise InputError(f"mesh {file} must be a valid {file.suffix} file, got: {exc or type(exc).__name__}") from exc
    return vertices, faces
