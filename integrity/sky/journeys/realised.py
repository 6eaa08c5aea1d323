"""The course of RTK, usable positions and levels along streets, as a Markov chain from station to station.

What a planner predicts are probabilities; a drive is one draw. The chain has the memory that drives have: RTK that
holds tends to hold, the longer the more; a position that is lost stays lost for a while; and the time since RTK is that
which was experienced. Its laws are fitted on drives of the whole navigator (``lanebound reproduce availability``), with
the satellites and PDOP that the *true* city leaves at each station:

- RTK, given RTK at the station before and for how many stations that had been so (logistic regressions on satellites
  and PDOP);
- a usable position, given RTK here, and likewise given the station before (satellites, and PDOP with RTK or the time
  since RTK without it);
- PL_CT: quantiles for each state by the satellites, with RTK, or the time since RTK; shares keep a normal-score
  correlation from station to station.

Stations lie about 10 m apart (:mod:`.streets`), so the memory is one of distance. With the station before alone, as in
a Markov chain of first order, the spread of journeys held out is a fifth too small.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from lanebound.integrity.sky.availability import FEWEST_FOR_RTK, FILE, Fit, gaps_along

__all__ = ["RUN_EDGES", "DrivenWay", "RealisedLaw", "StationLaw", "packaged_law"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Fits = tuple[tuple[Fit, ...], tuple[Fit, ...]]

MOST_SATELLITES = 64  # of the table of usable positions; the nominal constellations have at most 60 in view
GAP_EDGES_S = 2.0 ** np.arange(-1.0, 9.25, 0.25)  # between classes of the table of usable positions; chosen
RUN_EDGES = np.array([1, 3, 8])  # stations, largest of each class of runs but the last; chosen on training cities
RUNS = len(RUN_EDGES) + 1
LEVEL_CELLS = 6  # of satellites or of times since RTK, whose levels are alike; chosen
LEVEL_SHARES = tuple((k + 0.5) / 10.0 for k in range(10))


class DrivenWay(NamedTuple):
    """A drive at the N stations of a way, in order.

    Attributes
    ----------
    satellites, pdop : (N,) that the true city leaves
    part_s : (N,) time at each station
    rtk, usable : (N,) in passing
    pl_ct_m : (N,)
    """

    satellites: Array
    pdop: Array
    part_s: Array
    rtk: Flags
    usable: Flags
    pl_ct_m: Array

    @property
    def gap_s(self) -> Array:
        """Time since the last station with RTK, or since the beginning, (N,)."""
        return gaps_along(self.rtk, np.cumsum(self.part_s) - 0.5 * self.part_s, 0.0)


class StationLaw(NamedTuple):
    """The chain at N stations of one city at one hour.

    Attributes
    ----------
    rtk_after : (N, 2, R) probability of RTK, by RTK at the station before and the class of its run
    usable_after : (N, 2, R) probability of a usable position with RTK, by the one before and the class of its run
    satellites : (N,) row of ``bridged``
    """

    rtk_after: Array
    usable_after: Array
    satellites: NDArray[np.int64]


class RealisedLaw(NamedTuple):
    """The laws of the chain.

    Attributes
    ----------
    rtk : without and with RTK at the station before, by class of run, from satellites and the logarithm of PDOP
    usable : with RTK, without and with a usable position before, by class of run, from the same
    bridged : without RTK, likewise, from satellites and the logarithm of 1 s plus the time since RTK
    level_edges : (2, C - 1) between cells of the time since RTK [s], without RTK, and of satellites, with RTK
    levels : (2, 2, C, 10) quantiles of PL_CT [m] by RTK, usable position and cell
    correlation : of normal scores of levels at neighbouring stations
    """

    rtk: Fits
    usable: Fits
    bridged: Fits
    level_edges: Array
    levels: Array
    correlation: float

    @classmethod
    def fitted(cls, ways: Sequence[DrivenWay]) -> Self:
        """The laws of drives, of at least two stations each."""

        def now(name: str) -> Array:
            return np.concatenate([getattr(way, name)[1:] for way in ways])

        def before(name: str) -> tuple[Flags, NDArray[np.int64]]:
            of = [getattr(way, name) for way in ways]
            return np.concatenate([one[:-1] for one in of]), np.concatenate([_runs(one)[:-1] for one in of])

        def fits(of: Flags, second: Array, name: str, happens: Flags) -> Fits:
            was, run = before(name)
            cells = ([of & (was == state) & (run == r) for r in range(RUNS)] for state in (False, True))
            a, b = (tuple(Fit.of(satellites[o], second[o], happens[o]) for o in row) for row in cells)
            return a, b

        satellites, y = now("satellites"), np.log(now("pdop"))
        rtk, usable = now("rtk") > 0, now("usable") > 0
        edges, levels, correlation = _levels(ways)
        return cls(
            fits(satellites >= FEWEST_FOR_RTK, y, "rtk", rtk),
            fits(rtk, y, "usable", usable),
            fits(~rtk, np.log1p(now("gap_s")), "usable", usable),
            edges,
            levels,
            correlation,
        )

    def at(self, satellites: Array, pdop: Array) -> StationLaw:
        """The chain at stations whose true satellites and PDOP are known.  (N,), (N,)."""
        y, enough = np.log(pdop), satellites >= FEWEST_FOR_RTK
        rtk, usable = (
            np.array([[fit.at(satellites, y) for fit in row] for row in of]).transpose(2, 0, 1)
            for of in (self.rtk, self.usable)
        )
        row = np.minimum(satellites, MOST_SATELLITES - 1).astype(np.int64)
        return StationLaw(rtk * enough[:, None, None], usable, row)

    def bridged_table(self) -> Array:
        """Probability of a usable position without RTK, by the one before, its run, satellites and class of the gap.

        -> (2, R, 64, C), class c for gaps between ``GAP_EDGES_S[c - 1]`` and ``GAP_EDGES_S[c]``.
        """
        middles = np.concatenate([[0.0], np.sqrt(GAP_EDGES_S[:-1] * GAP_EDGES_S[1:]), GAP_EDGES_S[-1:]])
        number, gap = (a.ravel() for a in np.meshgrid(np.arange(MOST_SATELLITES, dtype=float), middles, indexing="ij"))
        shape = MOST_SATELLITES, middles.size
        return np.array([[fit.at(number, np.log1p(gap)).reshape(shape) for fit in row] for row in self.bridged])

    def to_dict(self) -> dict[str, Any]:
        """The laws as plain data."""
        fits = {
            name: [[fit.to_dict() for fit in row] for row in of]
            for name, of in (("rtk", self.rtk), ("usable", self.usable), ("bridged", self.bridged))
        }
        return {
            **fits,
            "level_edges": self.level_edges.tolist(),
            "levels": self.levels.tolist(),
            "correlation": self.correlation,
        }

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Self:
        """The laws of :meth:`to_dict`."""
        rtk, usable, bridged = (
            (tuple(map(Fit.from_dict, data[name][0])), tuple(map(Fit.from_dict, data[name][1])))
            for name in ("rtk", "usable", "bridged")
        )
        edges, levels = np.array(data["level_edges"]), np.array(data["levels"])
        return cls(rtk, usable, bridged, edges, levels, float(data["correlation"]))


def _runs(states: Flags) -> NDArray[np.int64]:
    """Class of the number of stations for which each state has been so, (N,); the first one had been so for long."""
    begins = np.concatenate([[True], states[1:] != states[:-1]])
    at = np.arange(states.size)
    since = np.maximum.accumulate(np.where(begins, at, 0))
    run = np.where(since > 0, at - since + 1, RUN_EDGES[-1] + 1)
    return np.asarray(np.searchsorted(RUN_EDGES, run), dtype=np.int64)


def _levels(ways: Sequence[DrivenWay]) -> tuple[Array, Array, float]:
    """Edges between cells, quantiles of each cell, and the correlation of neighbouring normal scores."""
    rtk, usable, level, satellites = (
        np.concatenate([getattr(way, name) for way in ways]) for name in ("rtk", "usable", "pl_ct_m", "satellites")
    )
    first = np.concatenate([np.arange(way.rtk.size) == 0 for way in ways])
    by = np.where(rtk, satellites, np.concatenate([way.gap_s for way in ways]))
    inner = np.linspace(0.0, 1.0, LEVEL_CELLS + 1)[1:-1]
    edges = np.stack([np.quantile(by[of], inner) for of in (~rtk, rtk)])
    cell = np.where(rtk, np.searchsorted(edges[1], by), np.searchsorted(edges[0], by))
    levels, score = np.empty((2, 2, LEVEL_CELLS, len(LEVEL_SHARES))), np.zeros(rtk.size)
    for r in range(2):
        for u in range(2):
            state = (rtk == r) & (usable == u)
            for c in range(LEVEL_CELLS):
                own = state & (cell == c)
                levels[r, u, c] = np.quantile(level[own if own.any() else state], LEVEL_SHARES)
                rank = np.argsort(np.argsort(level[own], kind="stable"))
                score[own] = norm.ppf((rank + 0.5) / max(own.sum(), 1))
    pairs = ~first[1:]
    return edges, levels, float(np.corrcoef(score[:-1][pairs], score[1:][pairs])[0, 1])


@cache
def packaged_law() -> RealisedLaw:
    """The laws that were fitted on generated training cities (``lanebound reproduce availability``)."""
    text = resources.files("lanebound.configs").joinpath(FILE).read_text(encoding="utf-8")
    return RealisedLaw.of(json.loads(text)["realised"])
