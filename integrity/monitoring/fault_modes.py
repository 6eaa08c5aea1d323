"""Fault modes as subsets of the satellites: which ones fail together, how likely, and what is left unmonitored.

A primary event is a fault of one satellite or of one constellation. A mode is a set of events that happen at once, and
removes every satellite that they touch (WG-C ARAIM ADD v3.1, section 3.2 and appendix B).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_in_range, require_shape
from lanebound.integrity.monitoring.risk import multiple_fault_risk

__all__ = ["FaultModes", "enumerate_faults"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_MODES = 100_000


@dataclass(frozen=True)
class FaultModes:
    """M modes over m satellites: ``removes`` (M, m) bool, ``prior`` (M,) [-], ``unmonitored`` [-] of all others."""

    removes: Bools
    prior: Array
    unmonitored: float = 0.0

    def __len__(self) -> int:
        return int(self.prior.size)

    def take(self, rows: ArrayLike) -> FaultModes:
        """Some of the modes, by mask or by index."""
        which = np.asarray(rows)
        return FaultModes(self.removes[which], self.prior[which], self.unmonitored)

    @property
    def several(self) -> Bools:
        """Which modes remove more than one satellite.  (M,)."""
        return np.asarray(self.removes.sum(-1) > 1)


def enumerate_faults(
    group: ArrayLike,
    satellite_prior: ArrayLike,
    constellation_prior: ArrayLike = 0.0,
    *,
    unmonitored_below: float = 8e-8,
    at_once: int = 3,
) -> FaultModes:
    """Modes of one, two, ... events until what is left is less likely than ``unmonitored_below``.

    Parameters
    ----------
    group : (m,) constellation of each satellite.
    satellite_prior : (m,) or scalar fault probability of each satellite [-].
    constellation_prior : (C,) of the constellations present in ascending order, or scalar; 0 leaves them out.
    unmonitored_below : P_THRES of WG-C ARAIM ADD v3.1, table 3-2 [-].
    at_once : the most events of one mode, reached or not.

    Modes that remove the same satellites are one mode with the sum of their priors. A mode's prior is the product of
    its events': the probability that at least these happen.

    Raises
    ------
    InputError
        Probabilities outside [0, 1), ``at_once`` below 1, or more than 100,000 modes.
    """
    owner = np.atleast_1d(np.asarray(group, dtype=np.int64))
    present = np.unique(owner)
    single = np.broadcast_to(require_in_range("satellite_prior", satellite_prior, 0, 1, high_open=True), owner.shape)
    whole = require_in_range("constellation_prior", constellation_prior, 0, 1, high_open=True)
    whole = np.broadcast_to(whole, present.shape) if whole.ndim == 0 else whole
    require_shape("constellation_prior", whole, (present.size,))
    if at_once < 1:
        raise InputError(f"at_once must be at least 1, got {at_once}: a mode has at least one event")
    touches = np.concatenate([np.eye(owner.size, dtype=bool), owner == present[:, None]])
    chance = np.concatenate([single, whole])
    events = np.flatnonzero(chance > 0.0)
    found: dict[bytes, tuple[Bools, float]] = {}
    unmonitored = float(1.0 - np.prod(1.0 - chance[events]))
    for size in range(1, at_once + 1):
        if unmonitored < unmonitored_below:
            break
        for together in combinations(events, size):
            _add(found, np.asarray(touches[list(together)].any(0)), float(np.prod(chance[list(together)])))
            if len(found) > MOST_MODES:
                raise InputError(f"at_once must give at most {MOST_MODES} modes, got more: lower it from {at_once}")
        unmonitored = _beyond(chance[events], size)
    removes = np.array([mode for mode, _ in found.values()], dtype=bool).reshape(-1, owner.size)
    return FaultModes(removes, np.array([prior for _, prior in found.values()]), unmonitored)


def _add(found: dict[bytes, tuple[Bools, float]], removed: Bools, prior: float) -> None:
    """Add a mode, or its prior to the mode that removes the same satellites."""
    key = removed.tobytes()
    found[key] = (removed, prior + (found[key][1] if key in found else 0.0))


def _beyond(chance: Array, size: int) -> float:
    """Probability of more than ``size`` of independent events at once."""
    if size == 1:
        return float(multiple_fault_risk(chance))
    more = np.zeros(size + 2)
    more[0] = 1.0
    for p in chance:
        gained = more * p
        more[:-1] -= gained[:-1]
        more[1:] += gained[:-1]
    return float(more[-1])
