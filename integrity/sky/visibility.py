"""Signal reception in a street: line of sight, foliage, reflection or blockage of each satellite.

The obstacles are static: reception depends only on the position of the vehicle and the direction of the satellite. A
sky mask contains the reception for stations along the road, lanes and cells of the sky. A look-up costs a few
nanoseconds for each satellite.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_shape
from lanebound.integrity.core.records import Records, one_record, packed
from lanebound.integrity.sky.mask_kernel import (
    EDGE_LINE,
    FACE,
    MASK_RULES,
    PATH_BITS,
    RECEPTION,
    REFLECTION,
    STRONGEST,
    MaskRows,
    look_up_rows,
)
from lanebound.integrity.sky.raytrace_kernel import mask_rows
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, Faces, material_table, permittivities
from lanebound.integrity.sky.view import SkyView

__all__ = [
    "Reception", "SignalPath", "SkyMask", "antennas_along", "cell_centres", "cells_of", "distinct_antennas", "rows_in",
]  # fmt: skip

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


class SkyMask:
    """Reception by station, lane and cell of the sky.

    Parameters
    ----------
    path : (N, L, A E) uint8, values of :class:`SignalPath`; cell ``a E + e`` for azimuth bin a and elevation bin e
    excess_m : (N, L, A E) float32, shortest one-bounce excess, 0 for none
    azimuths, elevations : numbers of bins A over 2 pi and E over pi / 2
    spacing_m, length_m, closed : distance between stations, length of the road, whether the road is closed
    digest : digest of the inputs, see :meth:`digest_of`
    faces : what reflects and diffracts signals; without stations for a mask that is not made by ray casting

    Attributes
    ----------
    rows : the mask as kernels take it, and as it is held; the tables above are made of it when they are asked for

    Raises
    ------
    InputError
        More than 16383 cells of a station reflect.
    """

    def __init__(
        self,
        path: NDArray[np.uint8],
        excess_m: NDArray[np.float32],
        azimuths: int,
        elevations: int,
        spacing_m: float,
        length_m: float,
        closed: bool,
        digest: str = "",
        faces: Faces | None = None,
    ) -> None:
        rules = _rules(azimuths, elevations, spacing_m, length_m, closed)
        self.rows, self.digest = _packed(rules, path, excess_m, Faces.none() if faces is None else faces), digest

    @classmethod
    def of_rows(cls, rows: MaskRows, digest: str = "") -> Self:
        """The mask of rows."""
        mask = cls.__new__(cls)
        mask.rows, mask.digest = rows, digest
        return mask

    @property
    def path(self) -> NDArray[np.uint8]:
        """(N, L, A E) values of :class:`SignalPath`."""
        return (self.rows.cell & ((1 << PATH_BITS) - 1)).astype(np.uint8)

    @property
    def excess_m(self) -> NDArray[np.float32]:
        """(N, L, A E) shortest one-bounce excess, 0 for none."""
        return self._spread("excess", np.zeros(self.rows.cell.shape, np.float32))

    @property
    def faces(self) -> Faces:
        """What reflects and diffracts signals."""
        rows = self.rows
        if not rows.edge.shape[0]:
            return Faces.none()
        face = self._spread("face", np.full((*rows.cell.shape, STRONGEST), -1, np.int32))
        return Faces(face, rows.edge, rows.faces, rows.edges)

    @property
    def azimuths(self) -> int:
        """Number of bins over 2 pi."""
        return int(self.rows.rules["azimuths"][0])

    @property
    def elevations(self) -> int:
        """Number of bins over pi / 2."""
        return int(self.rows.rules["elevations"][0])

    @property
    def spacing_m(self) -> float:
        """Distance between stations."""
        return float(self.rows.rules["spacing"][0])

    @property
    def closed(self) -> bool:
        """Whether the road is closed."""
        return bool(self.rows.rules["closed"][0])

    @property
    def nbytes(self) -> int:
        """Memory of all this."""
        return sum(array.nbytes for array in self.rows)

    def _spread(self, name: str, out: NDArray[Any]) -> NDArray[Any]:
        """Fill ``out`` (N, L, A E, ...) with a field of the reflections of the cells that have one."""
        number = self.rows.cell >> PATH_BITS
        at = (self.rows.first[..., None] + number - 1)[number > 0]
        out[number > 0] = self.rows.reflection[name][at]
        return out

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
        digest = cls.digest_of(road, city, station_spacing_m, lanes, antenna_height_m, az_step_deg, el_step_deg)
        rules = _rules(azimuths, elevations, spacing, road.length_m, road.closed)
        return cls.of_rows(_cast(rules, city, antenna.reshape(-1, 3), rows), digest)

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
        rules = _rules(azimuths, elevations, spacing_m, spacing_m * rows.shape[0], False)
        return cls.of_rows(_cast(rules, city, each, rows), digest)

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

    def save(self, path: str | Path) -> None:
        """Write the mask to an ``.npz`` file."""
        np.savez(path, digest=np.array(self.digest), **self.rows._asdict())

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
                mask = cls.of_rows(rows_in(data), str(data["digest"]))
        except (OSError, EOFError, KeyError, ValueError, BadZipFile) as exc:
            raise InputError(
                f"sky mask {path} must be an .npz file written by save, got: {exc}; build it again"
            ) from exc
        if digest is not None and mask.digest != digest:
            raise InputError(f"sky mask {path} must be of inputs {digest}, got {mask.digest}: build it again")
        return mask


def rows_in(data: Mapping[str, NDArray[Any]]) -> MaskRows:
    """The rows of a mask from the arrays of a file.

    Raises
    ------
    KeyError, ValueError
        An array is missing, or does not fit the others.
    """
    given = {name: data[name] for name in MaskRows._fields}
    for name, kind in (("rules", MASK_RULES), ("reflection", REFLECTION), ("faces", FACE), ("edges", EDGE_LINE)):
        if given[name].dtype != kind:
            raise ValueError(f"{name} has other fields")
        given[name] = given[name].view(kind)  # files do not say that fields are aligned, which compiled kernels expect
    rows = MaskRows(**given)
    cells = int(rows.rules["azimuths"][0] * rows.rules["elevations"][0])
    if rows.cell.dtype != np.uint16 or rows.cell.shape != (*rows.first.shape, cells):
        raise ValueError(f"tables must hold (N, L, {cells}) cells, got {rows.cell.shape}")
    return rows


def _rules(azimuths: int, elevations: int, spacing_m: float, length_m: float, closed: bool) -> Records:
    figures = {"spacing": spacing_m, "length": length_m, "closed": closed}
    return one_record(MASK_RULES, **figures, azimuths=azimuths, elevations=elevations)


def _packed(rules: Records, path: NDArray[np.uint8], excess_m: NDArray[np.float32], faces: Faces) -> MaskRows:
    """The rows of tables (..., A E) of any number of antennas.

    Raises
    ------
    InputError
        Too many cells of an antenna reflect.
    """
    reflects = excess_m != 0.0
    if faces.face.size:
        reflects |= faces.face[..., 0] >= 0
    count = reflects.sum(-1)
    if (worst := int(count.max(initial=0))) >= 1 << (16 - PATH_BITS):
        raise InputError(
            f"a station must have below {1 << (16 - PATH_BITS)} reflecting cells, got {worst}: widen cells"
        )
    number = np.cumsum(reflects, -1, dtype=np.uint16)
    number *= reflects
    reflection = np.zeros(int(count.sum()), REFLECTION)
    reflection["excess"] = excess_m[reflects]
    reflection["face"] = faces.face[reflects] if faces.face.size else -1
    first = np.cumsum(count).reshape(count.shape) - count
    cell = path | (number << PATH_BITS)
    return MaskRows(rules, cell.astype(np.uint16), first, reflection, faces.edge, faces.table, faces.edges)


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


def _cast(rules: Records, city: City, antenna: Array, rows: NDArray[np.int64]) -> MaskRows:
    """Compute the rows of a mask for antennas (P, 3) and the index (N, L) of each in them."""
    azimuths, elevations, count = int(rules["azimuths"][0]), int(rules["elevations"][0]), antenna.shape[0]
    path = np.empty((count, azimuths * elevations), dtype=np.uint8)
    excess = np.empty(path.shape, dtype=np.float32)
    found = np.empty((*path.shape, STRONGEST), dtype=np.int32)
    edge = np.empty((count, azimuths), dtype=np.int32)
    cells = cell_centres(azimuths, elevations)
    permittivity = permittivities(material_table(), RAY_HZ)[city.material]
    arguments = cells, azimuths, elevations, permittivity, path, excess, found, edge
    run_rows(mask_rows, count, city.grid, antenna, *arguments, row_us=300.0)
    each = _packed(rules, path, excess, Faces.of_triangles(city, found, edge))
    return each._replace(cell=each.cell[rows], first=each.first[rows], edge=each.edge[rows])


def antennas_along(road: Road, arc_m: Array, lanes: int, height_m: float) -> Array:
    """Antenna positions (N, L, 3) [m] at arcs (N,) above L lanes."""
    lateral = road.lane_lateral_m(np.arange(lanes))
    en, _ = road.pose_at(arc_m[:, None], lateral[None, :])
    return np.concatenate([en, np.full((*en.shape[:2], 1), height_m)], -1)
