"""Double differences of the signals of one epoch, as conventional RTK forms them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["DifferenceRows", "RtkSignals", "double_differences"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

AXES = 3


class RtkSignals(NamedTuple):
    """Signals of S satellites at a vehicle: los (S, 3) unit vectors, elevation (S,) [rad], system (S,), cn0 (S,)
    [dB-Hz], tracked (S,), code and phase (S, F) single differences of F = 1 or 2 bands [m], 0 for none, wavelength
    (S, F) [m]."""

    los: Array
    elevation: Array
    system: Ints
    cn0: Array
    tracked: Bools
    code: Array
    phase: Array
    wavelength: Array


class DifferenceRows(NamedTuple):
    """Double differences: design (m, 3), y (m,) [m], covariance (m, m) [m^2]; satellite, reference and band (m,),
    wavelength (m,) [m]."""

    design: Array
    y: Array
    covariance: Array
    satellite: Ints
    reference: Ints
    band: Ints
    wavelength: Array


def double_differences(s: RtkSignals, values: Array, usable: Bools, variance: Array) -> DifferenceRows:
    """Double differences of ``values`` (S, F) against the highest satellite of each system and band.

    usable (S, F); variance (S,) of a single difference [m^2].
    """
    parts: list[tuple[Array, Array, Array, Ints, Ints, Ints, Array]] = []
    for band in range(values.shape[1]):
        for system in np.unique(s.system[usable[:, band]]):
            own = np.flatnonzero(usable[:, band] & (s.system == system))
            if own.size < 2:
                continue
            top = own[np.argmax(s.elevation[own])]
            rest = own[own != top]
            parts.append((
                s.los[top] - s.los[rest], values[rest, band] - values[top, band],
                np.diag(variance[rest]) + variance[top], rest, np.full(rest.size, top), np.full(rest.size, band),
                s.wavelength[rest, band],
            ))  # fmt: skip
    if not parts:
        none = np.zeros(0, np.int64)
        return DifferenceRows(np.zeros((0, AXES)), np.zeros(0), np.zeros((0, 0)), none, none, none, np.zeros(0))
    design, y, blocks, satellite, reference, bands, wavelength = zip(*parts, strict=True)
    return DifferenceRows(
        np.concatenate(design), np.concatenate(y), _block_diagonal(blocks), np.concatenate(satellite),
        np.concatenate(reference), np.concatenate(bands), np.concatenate(wavelength),
    )  # fmt: skip


def _block_diagonal(blocks: tuple[Array, ...]) -> Array:
    size, at = sum(len(block) for block in blocks), 0
    out = np.zeros((size, size))
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return out
