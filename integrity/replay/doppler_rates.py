"""Range rates of a recorded receiver, less the motion of satellites and their clocks: ``y = -e.v + drift`` [m/s].

From the receiver's Doppler observables, or, where it records none, from the changes of its carriers between epochs,
which are the mean rates over that time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.recorded.rinex_observation import WEEK_S, Observations
from lanebound.integrity.replay.sagnac import ranges_and_sights
from lanebound.integrity.replay.signal_choice import LETTERS
from lanebound.integrity.sky.broadcast import Ephemerides, positions
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, WAVELENGTH_M

__all__ = ["carrier_rates", "doppler_rates"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FIRST_TRAVEL_S = 0.075
HALF_S = 0.5  # to each side of an epoch, over which the rate of a range is its mean
LONGEST_S = 2.0  # between epochs, over which a carrier's change is a rate


def doppler_rates(
    observations: Observations, codes: dict[str, tuple[str, ...]], table: Ephemerides, place_ecef_m: Array
) -> Array:
    """Range rates (T, S) at places (T, 3) from the Doppler observables of the codes' first band; 0 for none.

    A Doppler shift is positive for a satellite that approaches: ``-lambda D`` is the rate (RINEX 3.04 section 5.3).
    """
    rate = _recorded(observations, codes, table)
    if not rate.any():
        return rate
    time = observations.week * WEEK_S + observations.tow_s
    later, earlier = (_model(table, time, shift, place_ecef_m) for shift in (HALF_S, -HALF_S))
    there = (rate != 0.0) & np.isfinite(later) & np.isfinite(earlier)
    return np.where(there, rate - (later - earlier) / (2.0 * HALF_S), 0.0)


def _recorded(observations: Observations, codes: dict[str, tuple[str, ...]], table: Ephemerides) -> Array:
    """``-lambda D`` (T, S) [m/s], 0 for none."""
    out = np.zeros((observations.epochs, len(table.satellites)))
    for letter, names in codes.items():
        rows, system = observations.rows[letter], LETTERS[letter]
        where = {int(prn): i for i, (s, prn) in enumerate(table.satellites) if s == system}
        column = np.array([where.get(int(prn), -1) for prn in rows.satellite], dtype=np.int64)
        keep = column >= 0
        out[rows.epoch[keep], column[keep]] = -WAVELENGTH_M[system, 0] * rows.column(f"D{names[0]}")[keep]
    return out


def _model(table: Ephemerides, time_s: Array, shift_s: float, place_ecef_m: Array) -> Array:
    """Range less satellite clock (T, S) [m] a little later, from the same places; NaN without a message."""
    shape = (time_s.size, len(table.satellites))
    at, travel = np.broadcast_to(time_s[:, None], shape), np.full(shape, FIRST_TRAVEL_S)
    for _ in range(3):
        states = positions(table, at, travel - shift_s)
        known = states.usable[..., None]
        far = np.where(known, states.position_ecef_m, 4.0 * place_ecef_m[:, None, :])
        distance, _ = ranges_and_sights(far, place_ecef_m[:, None, :])
        travel = distance / SPEED_OF_LIGHT_MPS
    return np.where(states.usable, distance - SPEED_OF_LIGHT_MPS * states.clock_s, np.nan)


def carrier_rates(
    time_s: Array, los_enu: Array, phase_m: Array, lost: Bools, tracked: Bools, place_enu_m: Array
) -> Array:
    """Mean range rates (E, S) over the time since the epoch before; 0 for none.

    ``(phase_k - phase_j + (e_k - e_j).x_j) / dt``, with carriers ``phase = -e.x + clock + constant`` and the position
    x_j before, of which metres of error move a rate by a millimetre per second.

    Parameters
    ----------
    time_s : (E,)
    los_enu, phase_m, lost, tracked : (E, S, 3), (E, S) each; a phase is 0 for none
    place_enu_m : (E, 3)
    """
    out, dt = np.zeros(phase_m.shape), np.diff(time_s)
    whole = tracked & (phase_m != 0.0)
    both = whole[1:] & whole[:-1] & ~lost[1:] & (dt <= LONGEST_S)[:, None]
    turned = ((los_enu[1:] - los_enu[:-1]) * place_enu_m[:-1, None, :]).sum(-1)
    rate = (phase_m[1:] - phase_m[:-1] + turned) / dt[:, None]
    out[1:] = np.where(both, np.where(rate == 0.0, 1e-12, rate), 0.0)
    return out
