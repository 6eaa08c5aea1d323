"""The true motion of a batch of vehicles during one navigation epoch, which is the only input of sensor models."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.core.records import Records, packed
from lanebound.integrity.motion.truth_kernel import END, TRUTH, between_rows

__all__ = ["Truth", "require_consistent", "truth_between"]

Array = NDArray[np.float64]

FREE_M, FREE_SHARE, FREE_MPS2 = 0.5, 0.5, 10.0  # by how much a displacement may differ from that of its velocities
MOVING_MPS, LARGEST_SLIP_RAD = 3.0, np.deg2rad(60.0)  # from this speed on a heading must fit the course


@dataclass(frozen=True)
class Truth:
    """The true motion of B vehicles over one epoch of length ``dt_s`` with the end ``time_s``.

    Attributes
    ----------
    position_enu_m, velocity_enu_mps : (B, 3) of the reference point of the vehicle, at the end of the epoch
    heading_rad : (B,) azimuth of the body's x axis, clockwise from North, at the end
    delta_theta_rad : (B, 3) rotation over the epoch in body axes (forward, right, down)
    delta_v_mps : (B, 3) integrated specific force over the epoch in the body axes at its middle
    distance_m : (B,) signed length of the chord; equal to the path length up to second order in the turn
    arc_m : (B,) position along the street's centre line, for the sky mask
    lane : (B,) lane index there, 0 is the rightmost
    given : records that the arrays are the fields of; None where they are arrays of the user's own
    """

    time_s: float
    dt_s: float
    position_enu_m: Array
    velocity_enu_mps: Array
    heading_rad: Array
    delta_theta_rad: Array
    delta_v_mps: Array
    distance_m: Array
    arc_m: Array
    lane: NDArray[np.int64]
    given: Records | None = field(default=None, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, time_s: float, dt_s: float, records: Records) -> Self:
        """The truth whose arrays are the fields of ``records``, (B,) of TRUTH (:mod:`.truth_kernel`)."""
        truth = cls(time_s, dt_s, *(records[name] for name in TRUTH.names or ()))
        object.__setattr__(truth, "given", records)
        return truth

    @property
    def records(self) -> Records:
        """The arrays as kernels take them, (B,) of TRUTH."""
        if self.given is not None:
            return self.given
        return packed(
            TRUTH, None, position=self.position_enu_m, velocity=self.velocity_enu_mps, heading=self.heading_rad,
            turn=self.delta_theta_rad, delta_v=self.delta_v_mps, distance=self.distance_m, arc=self.arc_m,
            lane=self.lane,
        )  # fmt: skip

    @property
    def batch(self) -> int:
        """Number of vehicles."""
        return int(self.heading_rad.shape[0])

    def at(self, forward_m: float, right_m: float) -> Self:
        """The motion of another point of the body at an offset from the reference point (position and velocity)."""
        sine, cosine = np.sin(self.heading_rad), np.cos(self.heading_rad)
        turning = self.delta_theta_rad[:, 2] / self.dt_s
        off = np.zeros_like(self.position_enu_m)
        off[:, 0], off[:, 1] = sine * forward_m + cosine * right_m, cosine * forward_m - sine * right_m
        moved = np.zeros_like(off)
        moved[:, 0], moved[:, 1] = turning * off[:, 1], -turning * off[:, 0]
        return replace(self, position_enu_m=self.position_enu_m + off, velocity_enu_mps=self.velocity_enu_mps + moved)

    @classmethod
    def between(
        cls,
        time_s: float,
        dt_s: float,
        position_m: tuple[Array, Array],
        velocity_mps: tuple[Array, Array],
        heading_rad: tuple[Array, Array],
        arc_m: Array,
        lane: NDArray[np.int64],
    ) -> Self:
        """:func:`truth_between` without checks, for finite float64 arrays of the correct shapes."""
        batch = heading_rad[1].shape[0]
        ends, records = np.empty((2, batch), END), np.empty(batch, TRUTH)
        ends["position"], ends["velocity"], ends["heading"] = position_m, velocity_mps, heading_rad
        records["arc"], records["lane"] = arc_m, lane
        between_rows(ends[0], ends[1], -GRAVITY_MPS2 * dt_s, records)
        return cls.of(time_s, dt_s, records)


def _plane_vectors(name: str, value: ArrayLike, batch: int) -> Array:
    """``value`` as (B, 2) East, North."""
    vectors = np.atleast_2d(require_finite(name, value))
    require_shape(name, vectors, (batch, 2))
    return vectors


def require_consistent(dt_s: float, moved_m: Array, mean_mps: Array, velocity_mps: Array, heading_rad: Array) -> None:
    """Refuse a displacement that the velocities do not explain, and a heading across the direction of motion.

    The bounds are generous: wrong units and swapped axes are beyond them, skids and steps of a simulator are not.

    Raises
    ------
    InputError
        With the vehicle, what was found and what is likely.
    """
    off = np.hypot(*(moved_m - dt_s * mean_mps).T)
    most = FREE_M + FREE_SHARE * dt_s * np.hypot(*mean_mps.T) + FREE_MPS2 * dt_s**2
    if (off > most).any():
        b = int(np.argmax(off - most))
        raise InputError(
            f"position_m must move by the mean velocity times dt_s = {dt_s:g} s to within {most[b]:.2f} m, got "
            f"{np.hypot(*moved_m[b]):.2f} m at {np.hypot(*mean_mps[b]):.2f} m/s for vehicle {b}: give metres, m/s and "
            "s; to begin elsewhere, use navigator.place"
        )
    speed = np.hypot(*velocity_mps.T)
    along = np.abs(velocity_mps[:, 0] * np.sin(heading_rad) + velocity_mps[:, 1] * np.cos(heading_rad))
    across = (speed > MOVING_MPS) & (along < np.cos(LARGEST_SLIP_RAD) * speed)
    if across.any():
        b = int(np.argmax(across))
        course = np.arctan2(velocity_mps[b, 0], velocity_mps[b, 1])
        raise InputError(
            f"heading_rad must lie within {np.rad2deg(LARGEST_SLIP_RAD):.0f} degrees of the direction of motion or its "
            f"reverse, got {heading_rad[b]:.2f} rad with a course of {course:.2f} rad for vehicle {b}: give azimuths "
            "in radians, clockwise from North, and vectors as East, North"
        )


def truth_between(
    time_s: float,
    dt_s: float,
    position_m: tuple[ArrayLike, ArrayLike],
    velocity_mps: tuple[ArrayLike, ArrayLike],
    heading_rad: tuple[ArrayLike, ArrayLike],
    arc_m: ArrayLike = 0.0,
    lane: ArrayLike = 0,
) -> Truth:
    """Compute the truth of an epoch from the (E, N) poses at its start and end, for vehicles on a plane.

    Parameters
    ----------
    position_m, velocity_mps : pairs of (B, 2) East, North at the start and at the end
    heading_rad : pair of (B,) azimuths at the start and at the end
    arc_m, lane : (B,) or scalar, place on the street at the end: in a city the sky is that of this place

    Raises
    ------
    InputError
        An entry is not finite, a shape does not fit the others, ``dt_s`` is not positive, or the motion contradicts
        itself (:func:`require_consistent`).
    """
    if not dt_s > 0.0:
        raise InputError(f"dt_s must be positive, got {dt_s}: pass the length of the epoch in seconds")
    h0, h1 = (np.atleast_1d(require_finite("heading_rad", h)) for h in heading_rad)
    require_shape("heading_rad", h0, (h1.size,))
    p0, p1 = (_plane_vectors("position_m", p, h1.size) for p in position_m)
    v0, v1 = (_plane_vectors("velocity_mps", v, h1.size) for v in velocity_mps)
    require_consistent(dt_s, p1 - p0, 0.5 * (v0 + v1), v1, h1)
    where = np.array(np.broadcast_to(require_finite("arc_m", arc_m), h1.shape))
    row = np.array(np.broadcast_to(np.asarray(lane, dtype=np.int64), h1.shape))
    return Truth.between(float(time_s), float(dt_s), (p0, p1), (v0, v1), (h0, h1), where, row)
