"""What really happens to a batch of vehicles during one navigation epoch: the only input that sensors may read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.errors import InputError, require_finite, require_shape
from lanebound.integrity.frames import wrap_angle

__all__ = ["GRAVITY_MPS2", "Truth", "truth_between"]

GRAVITY_MPS2 = 9.80665  # ISO 80000-3, standard gravity
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """The true motion of B vehicles over one epoch of length ``dt_s`` that ends at ``time_s``.

    Attributes
    ----------
    position_enu_m, velocity_enu_mps : (B, 3), at the end of the epoch
    heading_rad : (B,) azimuth of the body's x axis, clockwise from North, at the end
    delta_theta_rad : (B, 3) rotation over the epoch in body axes (forward, right, down)
    delta_v_mps : (B, 3) integrated specific force over the epoch in the body axes of its middle
    distance_m : (B,) signed length of the chord, which is the path's to second order in the turn
    arc_m : (B,) position along the street's centre line, for the sky mask
    lane : (B,) lane index there, 0 is the rightmost
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

    @property
    def batch(self) -> int:
        """Number of vehicles."""
        return int(self.heading_rad.shape[0])


def _plane_vectors(name: str, value: ArrayLike, batch: int) -> Array:
    """``value`` as (B, 2) East, North."""
    vectors = np.atleast_2d(require_finite(name, value))
    require_shape(name, vectors, (batch, 2))
    return vectors


def truth_between(
    time_s: float,
    dt_s: float,
    position_m: tuple[ArrayLike, ArrayLike],
    velocity_mps: tuple[ArrayLike, ArrayLike],
    heading_rad: tuple[ArrayLike, ArrayLike],
    arc_m: ArrayLike = 0.0,
    lane: ArrayLike = 0,
) -> Truth:
    """Truth of an epoch from the (E, N) poses at its two ends, for vehicles on a plane.

    Parameters
    ----------
    position_m, velocity_mps : pairs of (B, 2) East, North at the start and at the end
    heading_rad : pair of (B,) azimuths at the start and at the end
    arc_m, lane : (B,) or scalar, where on the street the epoch ends

    Raises
    ------
    InputError
        When an entry is not finite, a shape does not fit the others, or ``dt_s`` is not positive.
    """
    if not dt_s > 0.0:
        raise InputError(f"dt_s must be positive, got {dt_s}: pass the length of the epoch in seconds")
    h0, h1 = (np.atleast_1d(require_finite("heading_rad", h)) for h in heading_rad)
    require_shape("heading_rad", h0, (h1.size,))
    p0, p1 = (_plane_vectors("position_m", p, h1.size) for p in position_m)
    v0, v1 = (_plane_vectors("velocity_mps", v, h1.size) for v in velocity_mps)
    turn = wrap_angle(h1 - h0)
    middle = h0 + 0.5 * turn
    s, c = np.sin(middle), np.cos(middle)
    dv, dp = v1 - v0, p1 - p0
    zero = np.zeros_like(h1)
    forward = s * dp[:, 0] + c * dp[:, 1]
    return Truth(
        time_s=float(time_s),
        dt_s=float(dt_s),
        position_enu_m=np.column_stack([p1, zero]),
        velocity_enu_mps=np.column_stack([v1, zero]),
        heading_rad=wrap_angle(h1),
        delta_theta_rad=np.column_stack([zero, zero, turn]),
        delta_v_mps=np.column_stack(
            [s * dv[:, 0] + c * dv[:, 1], c * dv[:, 0] - s * dv[:, 1], zero - GRAVITY_MPS2 * dt_s]
        ),
        distance_m=np.copysign(np.hypot(dp[:, 0], dp[:, 1]), forward),
        arc_m=np.broadcast_to(require_finite("arc_m", arc_m), h1.shape),
        lane=np.broadcast_to(np.asarray(lane, dtype=np.int64), h1.shape),
    )
