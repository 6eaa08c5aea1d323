"""Signal reception in a street: line of sight, foliage, reflection or blockage of each satellite.

The obstacles are static: reception depends only on the position of the vehicle and the direction of the satellite. A
sky mask contains the reception for stations along the road, lanes and cells of the sky. A look-up costs a few
nanoseconds for each satellite.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_shape
from lanebound.integrity.core.records import Records, one_record, packed
from lanebound.integrity.sky.raytrace_kernel import (
    MASK_RULES,
    RECEPTION,
    STRONGEST,
    MaskRows,
    edge_rows,
    look_up_rows,
    mask_rows,
)
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, Faces, material_table, permittivities
from lanebound.integrity.sky.view import SkyView

__all__ = ["Reception", "SignalPath", "SkyMask", "antennas_along", "cell_centres", "cells_of", "distinct_antennas"]

Array = NDArray[np.float64]
RAY_HZ = 1575.42e6  # of the first band: which reflections are the strongest


class SignalPath(IntEnum):
    """Propagation path of a satellite signal to the antenna.

    Masks contain the first four. The receiver model finds the last two from faces and edges.
    """

    LOS = 0
    FOLIAGE = 1
    REFLECTED = 2
    BLOCKED = 3
    MULTIPATH = 4
    DIFFRACTED = 5


@dataclass(frozen=True)
class Reception:
    """Reception of S signals by B antennas.

    Attributes
    ----------
    path : (B, S) uint8, values of :class:`SignalPath`
    excess_m : (B, S) excess path of the strongest one-bounce reflection, 0 for none. A LOS signal with an excess has
        multipath; a REFLECTED signal is received only by this reflection.
    given : (B, S) of RECEPTION, of which path and excess are fields: also the faces that reflect and the edges that
        diffract; None for none of them
    """

    path: NDArray[np.uint8]
    excess_m: Array
    given: Records | None = None

    @classmethod
    def of(cls, records: Records) -> Self:
        """The reception of records (B, S) of RECEPTION."""
        return cls(records["path"], records["excess"], records)

    @property
    def records(self) -> Records:
        """The reception as kernels take it, (B, S) of RECEPTION."""
        if self.given is not None:
            return self.given
        out = packed(RECEPTION, None, path=self.path, excess=self.excess_m)
        out["face"] = out["edge"] = -1
        return out


@dataclass(frozen=True)
class SkyMask:
    """Reception by station, lane and cell of the sky.

    Attributes
    ----------
    path : (N, L, A E) uint8, values of :class:`SignalPath`; cell ``a E + e`` for azimuth bin a and elevation bin e
    excess_m : (N, L, A E) float32, shortest one-bounce excess, 0 for none
    azimuths, elevations : numbers of bins A over 2 pi and E over pi / 2
    spacing_m, length_m, closed : distance between stations, length of the road, whether the road is closed
    digest : digest of the inputs, see :meth:`digest_of`
    faces : what reflects and diffracts signals; without stations for a mask that is not made by ray casting
    """

    path: NDArray[np.uint8]
    excess_m: NDArray[np.float32]
    azimuths: int
    elevations: int
    spacing_m: float
    length_m: float
    closed: bool
    digest: str = ""
    faces: Faces = field(default_factory=Faces.none)

    @classmethod
    def open(cls) -> SkyMask:
        """The mask of a sky without obstacles, for any road."""
        return cls(np.zeros((1, 1, 1), dtype=np.uint8), np.zeros((1, 1, 1), dtype=np.float32), 1, 1, 1.0, 1.0, True)

    @classmethod
    def build(
        cls,
        road: Road,
        city: City,
        station_spacing_m: float = 5.0,
        lanes: int | None = None,
        antenna_height_m: float = 1.5,
        az_step_deg: float = 3.0,
        el_step_deg: float = 3.0,
    ) -> SkyMask:
        """Cast rays to the centre of every cell from every station and lane (S2 section 3).

        Reflections: the direction d of a blocked ray is mirrored at the first solid face, ``d' = d - 2 (d.n) n``. If
        the ray along d' is free, signals from the cell of d' arrive with the excess ``t (1 - d.d')``, t the distance to
        the face.

        Parameters
        ----------
        lanes : number of lanes from the right, by default all lanes of the road
        antenna_height_m : height above the road, which lies at height 0
        az_step_deg, el_step_deg : size of a cell; must divide 360 and 90 degrees

        Raises
        ------
        InputError
            A step does not divide 360 or 90 degrees, or a spacing or height is out of range.
        """
        require_in_range("station_spacing_m", station_spacing_m, 0.0, 1e4, low_open=True)
        require_in_range("antenna_height_m", antenna_height_m, 0.0, 50.0)
        azimuths, elevations = cells_of(az_step_deg, el_step_deg)
        lane_count = road.lane_count if lanes is None else lanes
        if not 1 <= lane_count <= road.lane_count:
            raise InputError(f"lanes must lie in [1, {road.lane_count}], got {lanes}: use the lanes of the road")
        count = max(1, int(np.ceil(road.length_m / station_spacing_m)))
        spacing = road.length_m / count
        arc = spacing * np.arange(count if road.closed else count + 1, dtype=np.float64)
        antenna = antennas_along(road, arc, lane_count, antenna_height_m)
        rows = np.arange(arc.size * lane_count).reshape(arc.size, lane_count)
        path, excess, faces = _cast(city, antenna.reshape(-1, 3), rows, azimuths, elevations)
        digest = cls.digest_of(road, city, station_spacing_m, lanes, antenna_height_m, az_step_deg, el_step_deg)
        return cls(
            path,
            excess,
            azimuths,
            elevations,
            spacing,
            road.length_m,
            road.closed,
            digest,
            faces,
        )

    @classmethod
    def of_stations(
        cls,
        antenna_enu_m: ArrayLike,
        city: City,
        spacing_m: float = 5.0,
        az_step_deg: float = 3.0,
        el_step_deg: float = 3.0,
        digest: str = "",
    ) -> SkyMask:
        """Compute the mask of given stations, antennas (N, L, 3) ENU [m] above the L lanes of each station.

        Station n lies at the arc ``n spacing_m``. Cells and reflections are those of :meth:`build`. Repeated antennas
        are computed once: if a station has fewer lanes than L, repeat one of them.

        Raises
        ------
        InputError
            Antennas are not finite or have another shape, a step does not divide 360 or 90 degrees, or the spacing is
            out of range.
        """
        each, rows = distinct_antennas(antenna_enu_m)
        require_in_range("spacing_m", spacing_m, 0.0, 1e4, low_open=True)
        azimuths, elevations = cells_of(az_step_deg, el_step_deg)
        path, excess, faces = _cast(city, each, rows, azimuths, elevations)
        length = spacing_m * rows.shape[0]
        return cls(path, excess, azimuths, elevations, spacing_m, length, False, digest, faces)

    @staticmethod
    def digest_of(
        road: Road,
        city: City,
        station_spacing_m: float = 5.0,
        lanes: int | None = None,
        antenna_height_m: float = 1.5,
        az_step_deg: float = 3.0,
        el_step_deg: float = 3.0,
    ) -> str:
        """Digest of the inputs of :meth:`build`, for file names of saved masks; equal inputs give equal digests."""
        h = hashlib.blake2b(digest_size=16)
        for array in (road.vertices_en_m, road.tangent_rad, city.triangles_enu_m, city.surface, city.material):
            h.update(np.ascontiguousarray(array).tobytes())
        lane_count = road.lane_count if lanes is None else lanes
        layout = (road.lane_count, road.lane_width_m, road.shift_m, road.closed, lane_count)
        casting = (station_spacing_m, antenna_height_m, az_step_deg, el_step_deg)
        h.update(repr((*map(float, layout), *map(float, casting))).encode())
        return h.hexdigest()

    def look(self, arc_m: ArrayLike, lane: ArrayLike, sky: SkyView) -> Reception:
        """Look up the reception of vehicles at ``arc_m`` (B,) in ``lane`` (B,), for the B rows of ``sky.index``.

        The nearest station is used; lanes are clamped to the existing ones; the arc of a closed road wraps. Satellites
        below the horizon are BLOCKED. The mask angle is not applied.

        Raises
        ------
        InputError
            An arc is not finite, shapes do not agree, or an index has no row.
        """
        arc = np.asarray(arc_m, dtype=np.float64)
        if not np.isfinite(arc).all():
            require_finite("arc_m", arc)
        batch = sky.index.shape
        lanes = np.asarray(lane, dtype=np.int64)
        try:
            if arc.shape != batch or lanes.shape != batch:  # broadcast_to costs microseconds
                arc, lanes = np.broadcast_to(arc, batch), np.broadcast_to(lanes, batch)
            arc, lanes = np.ascontiguousarray(arc), np.ascontiguousarray(lanes)
        except ValueError:
            raise InputError(f"arc_m and lane must have shape {batch}, got {arc.shape}, {np.shape(lane)}") from None
        rows = sky.azimuth_rad.shape[0]
        if batch[0] and not (sky.index.min() >= 0 and sky.index.max() < rows):
            raise InputError(f"sky.index must lie in [0, {rows - 1}], got {sky.index.max()}: name existing rows")
        out = np.zeros((batch[0], sky.azimuth_rad.shape[1]), RECEPTION)
        look_up_rows(self.rows, sky.rows, sky.index, arc, lanes, out)
        return Reception.of(out)

    @cached_property
    def rows(self) -> MaskRows:
        """The mask as kernels take it."""
        rules = one_record(
            MASK_RULES,
            spacing=self.spacing_m,
            length=self.length_m,
            closed=self.closed,
            azimuths=self.azimuths,
            elevations=self.elevations,
        )
        faces = self.faces
        return MaskRows(rules, self.path, self.excess_m, faces.face, faces.edge, faces.table, faces.edges)

    def save(self, path: str | Path) -> None:
        """Write the mask to an ``.npz`` file."""
        np.savez(
            path,
            path=self.path,
            excess_m=self.excess_m,
            bins=np.array([self.azimuths, self.elevations, int(self.closed)]),
            stations=np.array([self.spacing_m, self.length_m]),
            digest=np.array(self.digest),
            **self.faces.as_arrays(),
        )

    @classmethod
    def load(cls, path: str | Path, digest: str | None = None) -> SkyMask:
        """Read a mask from an ``.npz`` file; a given ``digest`` must agree with that of the file.

        Raises
        ------
        InputError
            The file cannot be read, contains no mask, or its digest differs.
        """
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
                table, excess, found = data["path"], data["excess_m"], str(data["digest"])
                azimuths, elevations, closed = (int(v) for v in data["bins"])
                spacing, length = (float(v) for v in data["stations"])
                faces = Faces.of_arrays(data)
        except (OSError, EOFError, KeyError, ValueError, BadZipFile) as exc:
            raise InputError(
                f"sky mask {path} must be an .npz file written by save, got: {exc}; build it again"
            ) from exc
        if digest is not None and found != digest:
            raise InputError(f"sky mask {path} must be of inputs {digest}, got {found}: build it again")
        if table.ndim != 3 or table.shape != excess.shape or table.shape[2] != azimuths * elevations:
            raise InputError(f"sky mask {path} must hold tables (N, L, {azimuths * elevations}), got {table.shape}")
        return cls(table, excess, azimuths, elevations, spacing, length, bool(closed), found, faces)


def distinct_antennas(antenna_enu_m: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
    """Find the distinct antennas (P, 3) among antennas (N, L, 3) [m], and the index (N, L) of each antenna in them.

    Raises
    ------
    InputError
        An entry is not finite, the shape is wrong, or there are no antennas.
    """
    antenna = require_finite("antenna_enu_m", antenna_enu_m)
    require_shape("antenna_enu_m", antenna, (None, None, 3))
    if antenna.ndim != 3 or antenna.size == 0:
        raise InputError(f"antenna_enu_m must be (N, L, 3) with N, L >= 1, got {antenna.shape}: add stations")
    each, which = np.unique(antenna.reshape(-1, 3), axis=0, return_inverse=True)
    return each, which.reshape(antenna.shape[:2])


def cells_of(az_step_deg: float, el_step_deg: float) -> tuple[int, int]:
    """Numbers of cells over 360 degrees of azimuth and 90 degrees of elevation.

    Raises
    ------
    InputError
        A step does not divide its range.
    """
    return _bins("az_step_deg", az_step_deg, 360.0), _bins("el_step_deg", el_step_deg, 90.0)


def _bins(name: str, step_deg: float, whole_deg: float) -> int:
    require_in_range(name, step_deg, 0.0, whole_deg, low_open=True)
    count = round(whole_deg / step_deg)
    if abs(count * step_deg - whole_deg) > 1e-9:
        raise InputError(f"{name} must divide {whole_deg:g} deg, got {step_deg}: choose a divisor")
    return count


def cell_centres(azimuths: int, elevations: int) -> Array:
    """Unit vectors ENU towards the cell centres, (A E, 3)."""
    az = 2.0 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    el = 0.5 * np.pi * (np.arange(elevations) + 0.5) / elevations
    c, s = np.cos(el), np.sin(el)
    out = np.empty((azimuths, elevations, 3))
    out[..., 0], out[..., 1], out[..., 2] = np.sin(az)[:, None] * c, np.cos(az)[:, None] * c, s
    return out.reshape(-1, 3)


def _cast(
    city: City, antenna: Array, rows: NDArray[np.int64], azimuths: int, elevations: int
) -> tuple[NDArray[np.uint8], NDArray[np.float32], Faces]:
    """Compute paths and excesses (N, L, A E), and faces, for antennas (P, 3) and the index (N, L) of each in them."""
    count = antenna.shape[0]
    path = np.empty((count, azimuths * elevations), dtype=np.uint8)
    excess = np.empty(path.shape, dtype=np.float32)
    found = np.empty((*path.shape, STRONGEST), dtype=np.int32)
    edge = np.empty((count, azimuths), dtype=np.int32)
    cells = cell_centres(azimuths, elevations)
    permittivity = permittivities(material_table(), RAY_HZ)[city.material]
    arguments = cells, azimuths, elevations, permittivity, path, excess, found
    run_rows(mask_rows, count, city.grid, antenna, *arguments, row_us=1000.0)
    run_rows(edge_rows, count, city.grid, antenna, azimuths, elevations, path, edge, row_us=300.0)
    return path[rows], excess[rows], Faces.of_triangles(city, found[rows], edge[rows])


def antennas_along(road: Road, arc_m: Array, lanes: int, height_m: float) -> Array:
    """Antenna positions (N, L, 3) [m] at arcs (N,) above L lanes."""
    lateral = road.lane_lateral_m(np.arange(lanes))
    en, _ = road.pose_at(arc_m[:, None], lateral[None, :])
    return np.concatenate([en, np.full((*en.shape[:2], 1), height_m)], -1)
