"""The GNSS receiver with its reference station: what it puts out each epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["GnssEpoch"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GnssEpoch:
    """A receiver's output at one epoch; every entry is finite, untracked ones are 0.

    ``x`` is the rover's ENU position from the street's origin, ``e`` the unit vector to the satellite:
    ``code = -e.x + clk[sys, band] + errors``, ``phase = -e.x + clk'[sys, band] + lambda N + errors``,
    ``range_rate = -e.v + drift + errors``.

    Attributes
    ----------
    tracked : (B, S) bool, the code is tracked
    code_m, phase_m : (B, S, 2) rover minus reference single differences by band; a band that the receiver lacks is 0,
        and a phase is 0 where the carrier is not locked
    range_rate_mps : (B, S) Doppler with the satellite's motion taken out
    cn0_dbhz : (B, S) carrier-to-noise density
    lock_lost : (B, S) bool, carrier lock was interrupted since the previous epoch, as far as the receiver knows
    corrections_age_s : (B,) age of the reference data, inf when the link is out
    """

    tracked: NDArray[np.bool_]
    code_m: Array
    phase_m: Array
    range_rate_mps: Array
    cn0_dbhz: Array
    lock_lost: NDArray[np.bool_]
    corrections_age_s: Array
