"""The signals of a pair of receivers as entries of the RTK stages, and the slips that one signal shows of another.

The difference of two phases of a satellite contains neither its range nor the receivers' motion. From one epoch to the
next it changes by the ionosphere alone; the constant differences of the receivers are in its median over the satellites
of a system. A jump beyond ``k`` standard deviations marks both signals as having lost their lock.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.navigators.rtk_reckoning.records_kernel import MARK
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.cycle_slips_kernel import MIN_COMMON
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import weigh
from lanebound.integrity.replay.differences import Arc, Reduced
from lanebound.integrity.replay.rtk_stages import Entries, Signals
from lanebound.integrity.replay.signal_choice import LETTERS, Choice
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import FIXABLE

__all__ = ["SlipComparison", "code_rows", "entries_of", "signals_of"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

PLENTY = 7  # satellites with two signals that make the better position
ENOUGH = 0.5  # share of the epochs of a second code of a band in which the first one makes it unnecessary


def entries_of(choice: Choice, rover: Arc, base: Arc, satellites: Ints, cn0_min_dbhz: float) -> Entries:
    """The signals that both receivers have tracked; ``satellites`` (S, 2) are system and PRN.

    Every satellite with a further signal has an entry of its first one, too, which may be without measurements. A
    second code of a band is an entry of the satellites that lack the first one.
    """
    tracked = [
        ((arc.code_m != 0.0) & (arc.phase_m != 0.0) & (arc.cn0_dbhz >= cn0_min_dbhz) & arc.known[..., None]).sum(0)
        for arc in (rover, base)
    ]
    epochs = np.minimum(tracked[0] / max(len(rover.known), 1), tracked[1] / max(len(base.known), 1))
    wanted = np.zeros(epochs.shape, np.bool_)
    for letter, names in choice.rover.items():
        own = satellites[:, 0] == LETTERS[letter]
        for k, name in enumerate(names):
            wanted[own, k] = epochs[own, k] > 0.0
            for earlier in range(k):
                if names[earlier][0] == name[0]:
                    wanted[own, k] &= epochs[own, earlier] < ENOUGH * epochs[own, k]
    wanted[:, 0] |= wanted.any(-1)
    satellite, column = np.nonzero(wanted)
    system = satellites[satellite, 0]
    first = np.full(len(satellites), -1)
    first[satellite[column == 0]] = np.flatnonzero(column == 0)
    return Entries(
        satellite, column, choice.clock[system, column], first[satellite], choice.wavelength_m[system, column],
        np.asarray(FIXABLE[system]),
    )  # fmt: skip


def signals_of(reduced: Reduced, entries: Entries, rtk: RtkConfig) -> Signals:
    """The signals of one epoch."""
    at = entries.satellite, entries.column
    los, tracked, cn0 = np.ascontiguousarray(reduced.sight_enu[at[0]]), reduced.tracked[at], reduced.cn0_dbhz[at]
    quality = _weighed(los, tracked, cn0, rtk)
    return Signals(los, quality, tracked, cn0, reduced.code_m[at], reduced.phase_m[at], reduced.lost[at])


def _weighed(los: Array, tracked: Bools, cn0: Array, rtk: RtkConfig) -> Array:
    """Variance factors (N,) of signals."""
    signals, marks = np.zeros(len(los), OBSERVED_SIGNAL), np.zeros(len(los), MARK)
    signals["e"], signals["tracked"], signals["cn0"] = los, tracked, cn0
    weigh(signals, rtk.cn0_knee_dbhz, marks)
    return marks["quality"].copy()


def code_rows(reduced: Reduced, los: Array, rtk: RtkConfig) -> tuple[Ints, Array, Array]:
    """Satellites (n,) whose codes make a position, their codes [m] and variances [m^2], of one clock for each system.

    The mean of the first two signals where enough satellites have both, otherwise the first one: means and single codes
    do not have the same clock.
    """
    both = np.asarray(reduced.tracked[:, :2].all(-1))
    for columns, tracked in ((2, both), (1, np.ascontiguousarray(reduced.tracked[:, 0]))):
        cn0 = -10.0 * np.log10((10.0 ** (-0.1 * reduced.cn0_dbhz[:, :columns])).mean(-1))
        quality, high = _weighed(los, tracked, cn0, rtk), los[:, 2] > np.sin(np.deg2rad(rtk.elevation_mask_deg))
        rows = np.flatnonzero(tracked & high & (cn0 >= rtk.cn0_min_dbhz))
        if rows.size >= PLENTY:
            break
    return rows, reduced.code_m[rows, :columns].mean(-1), quality[rows] * rtk.sigma_code_m**2 / columns


class SlipComparison:
    """Compares the phases of each satellite's signals with those of the epoch before."""

    def __init__(self, entries: Entries, rtk: RtkConfig, slips: CycleSlipConfig) -> None:
        self._pairs = _pairs_of(entries)
        self._sigma, self._slips = rtk.sigma_phase_m, slips
        self._last = np.zeros(len(entries.clock))
        clock = entries.clock[self._pairs]
        self._kind = clock[:, 0] * 256 + clock[:, 1]

    def lost(self, signals: Signals, dt_s: float) -> Bools:
        """Which signals (N,) have lost their lock: by their flags, or by a jump against another of the satellite."""
        here = signals.tracked & (signals.phase != 0.0)
        lost = signals.lost.copy()
        if len(self._pairs):
            known = here & (self._last != 0.0) & ~lost
            pairs = np.flatnonzero(known[self._pairs].all(-1))
            one, other = self._pairs[pairs].T
            moved = signals.phase - self._last
            change = moved[one] - moved[other]
            variance = 2.0 * self._sigma**2 * (signals.quality[one] + signals.quality[other])
            limit = self._slips.threshold * np.sqrt(variance + (self._slips.ionosphere_rate_mps * dt_s) ** 2)
            for kind in np.unique(self._kind[pairs]):
                same = self._kind[pairs] == kind
                if np.count_nonzero(same) >= MIN_COMMON:
                    change[same] -= np.median(change[same])
            jumped = np.abs(change) > limit
            lost[one[jumped]] = lost[other[jumped]] = True
        self._last = np.where(here, signals.phase, 0.0)
        return lost


def _pairs_of(entries: Entries) -> Ints:
    """Pairs of entries (P, 2) of the same satellite."""
    found = [pair for host in np.unique(entries.host) for pair in combinations(np.flatnonzero(entries.host == host), 2)]
    return np.array(found, dtype=np.int64).reshape(-1, 2)
