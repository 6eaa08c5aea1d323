"""Contents of one picture: true states (filled shapes), estimated states (outlines), and their differences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.records import EgoBelief, LaneIndex, Traffic
from lanebound.envs.rendering.trace import Trace
from lanebound.integrity.core.angles_kernel import ROUNDING_M
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.scene import City

__all__ = ["CAUTION_SHARE", "Bodies", "EpisodeCost", "Frame", "Satellites", "Status"]

Array = NDArray[np.float64]

CAUTION_SHARE = 0.75  # share of an alert limit above which a protection level is shown as close to it


class Status(Enum):
    """The three states of the panel's status light; the value is the displayed word."""

    NORMAL = "NORMAL"
    CAUTION = "NEAR LIMIT"
    ALERT = "ALERT"


@dataclass(frozen=True)
class EpisodeCost:
    """The weighted cost ``info["cost"]`` [-] of the last step, its sum since the reset, and the limit of that sum."""

    step: float
    episode: float
    limit: float


@dataclass(frozen=True)
class Bodies:
    """True vehicles.

    Attributes
    ----------
    position_m : (N, 2) x, y of the middle; heading_rad, length_m, width_m : (N,); crashed : (N,) bool
    """

    position_m: Array
    heading_rad: Array
    length_m: Array
    width_m: Array
    crashed: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n = self.heading_rad.shape[0]
        shapes = {self.length_m.shape, self.width_m.shape, self.crashed.shape}
        if self.position_m.shape != (n, 2) or shapes != {(n,)}:
            raise InputError(f"bodies must have one row each for all {n} headings, positions with 2 columns: reshape")

    def __len__(self) -> int:
        return int(self.heading_rad.shape[0])

    @classmethod
    def of(cls, vehicles: Iterable[Any]) -> Bodies:
        """Copy the current states of highway-env's vehicles (or other objects of its road)."""
        rows = list(vehicles)
        return cls(
            np.array([v.position for v in rows], dtype=np.float64).reshape(-1, 2),
            np.array([v.heading for v in rows], dtype=np.float64),
            np.array([v.LENGTH for v in rows], dtype=np.float64),
            np.array([v.WIDTH for v in rows], dtype=np.float64),
            np.array([v.crashed for v in rows], dtype=np.bool_),
        )


@dataclass(frozen=True)
class Satellites:
    """Satellites and their reception at the receiver.

    Attributes
    ----------
    azimuth_rad : (S,) clockwise from North; elevation_rad : (S,)
    path : (S,) values of :class:`lanebound.integrity.sky.visibility.SignalPath`
    tracked : (S,) bool, measured by the receiver; the number used for the position is in the estimated state
    system : (S,) values of :class:`lanebound.integrity.sky.systems.System`
    """

    azimuth_rad: Array
    elevation_rad: Array
    path: NDArray[np.integer[Any]]
    tracked: NDArray[np.bool_]
    system: NDArray[np.integer[Any]]


@dataclass(frozen=True)
class Frame:
    """Contents of one picture.

    Attributes
    ----------
    network : highway-env's RoadNetwork; its lanes are traced once for each network object
    bodies : the true vehicles; ego : index of the ego in them
    belief, traffic : estimated state of the ego, and perceived states of other vehicles
    route : lanes of the ego after its current lane, for the corridor of the alert limit; taken from the map if empty
    city : buildings, in East and North of the plane (E = x, N = -y); satellites : current reception
    trace : error, protection level and alert limit of the last seconds
    title : the environment's id; time_s : since the reset; speed_mps : true; cost : None to hide it
    incident : what has happened to the true car, such as ``CRASHED``; "" for nothing
    """

    network: Any
    bodies: Bodies
    ego: int
    belief: EgoBelief
    time_s: float
    speed_mps: float
    traffic: Traffic = field(default_factory=Traffic.none)
    route: Sequence[LaneIndex] = ()
    city: City | None = None
    satellites: Satellites | None = None
    trace: Trace = field(default_factory=Trace.empty)
    title: str = ""
    cost: EpisodeCost | None = None
    incident: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.ego < len(self.bodies):
            raise InputError(f"ego must be a row of the {len(self.bodies)} bodies, got {self.ego}: correct the index")

    @property
    def ego_position_m(self) -> Array:
        """True centre of the ego, (2,) [m]."""
        return np.asarray(self.bodies.position_m[self.ego])

    @property
    def ego_heading_rad(self) -> float:
        """True heading of the ego [rad]."""
        return float(self.bodies.heading_rad[self.ego])

    @property
    def error_m(self) -> tuple[float, float]:
        """Estimate minus truth along and across the true track [m], positive to the right."""
        east, south = self.belief.position_m - self.ego_position_m
        c, s = np.cos(self.ego_heading_rad), np.sin(self.ego_heading_rad)
        return float(c * east + s * south), float(c * south - s * east)

    @property
    def exceeds_level(self) -> bool:
        """Whether an error exceeds its protection level while the position is declared available.

        Errors beyond the alert limit count too: ``mi`` and ``hmi`` of ``info`` tell the two apart.
        """
        at, ct = self.error_m
        b = self.belief
        return b.available and (abs(at) > b.pl_at_m + ROUNDING_M or abs(ct) > b.pl_ct_m + ROUNDING_M)

    @property
    def status(self) -> Status:
        """State of the status light: alert, a level close to its limit, or neither."""
        b = self.belief
        if b.alert or not b.available:
            return Status.ALERT
        near = max(b.pl_at_m / b.al_at_m, b.pl_ct_m / b.al_ct_m) > CAUTION_SHARE
        return Status.CAUTION if near else Status.NORMAL
