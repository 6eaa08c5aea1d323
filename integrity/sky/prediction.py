"""Prediction of satellites and their geometry along a street before a journey (S2 section 3).

Its four steps: places along the road in the lane that sees the least, satellites by almanac at the time of departure,
buildings of the *mapped* city, and the lines of sight that no building cuts (equations 1 and 2, :mod:`.forecast`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.view import SkyView

__all__ = ["StreetPrediction", "pdop", "predict_street"]

Array = NDArray[np.float64]
SPACE = 3  # unknowns of a position
WEAKEST = 1e-9  # least eigenvalue of a geometry that determines a position


class StreetPrediction(NamedTuple):
    """What the mapped city leaves of the satellites at N stations of a street, in the lane that sees the fewest.

    Attributes
    ----------
    satellites : (N,) satellites in line of sight
    pdop : (N,) position dilution of precision [-], infinite where they determine no position
    """

    satellites: NDArray[np.int64]
    pdop: Array


def predict_street(forecast: SkyForecast, sky: SkyView) -> StreetPrediction:
    """Satellites and PDOP at the stations of a street at one time, that of the first row of ``sky.index``."""
    seen = forecast.in_sight(sky)
    number = seen.sum(-1)
    lane = number.argmin(1)
    stations = np.arange(len(lane))
    row = int(sky.index[0])
    return StreetPrediction(number[stations, lane], pdop(sky.los_enu[row], sky.system, seen[stations, lane]))


def pdop(los: ArrayLike, system: ArrayLike, used: ArrayLike) -> Array:
    """Position dilution of precision, ``sqrt(tr((G' G)^-1))`` over the three coordinates, with a clock for each system.

    Parameters
    ----------
    los : (S, 3) unit vectors to the satellites
    system : (S,) system of each
    used : (N, S) which satellites are used at N places

    Returns
    -------
    (N,) [-], infinite where the satellites do not determine a position

    Raises
    ------
    InputError
        Shapes that do not fit.
    """
    e, of, use = np.asarray(los, float), np.asarray(system), np.asarray(used, dtype=np.bool_)
    if e.ndim != 2 or use.ndim != 2 or e.shape != (use.shape[1], SPACE) or of.shape != (use.shape[1],):
        raise InputError(f"los, system, used must be (S, 3), (S,), (N, S), got {e.shape}, {of.shape}, {use.shape}")
    weight = use.astype(float)
    normal = np.einsum("ns,si,sj->nij", weight, e, e)
    for one in np.unique(of):
        own = weight * (of == one)
        number, total = own.sum(1), own @ e
        # a clock is as good as differences to the mean of its system
        normal -= np.einsum("ni,nj->nij", total, total) / np.maximum(number, 1.0)[:, None, None]
    values = np.linalg.eigvalsh(normal)
    with np.errstate(divide="ignore"):
        found = np.sqrt((1.0 / np.maximum(values, 0.0)).sum(-1))
    return np.where(values[:, 0] > WEAKEST, found, np.inf)
