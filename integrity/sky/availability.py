"""Probability of a usable position and quantiles of protection levels, from what a map predicts along a way.

Two stages. The first one gives the probability of an RTK position from satellites in line of sight and PDOP. The second
one gives that of a usable position from the satellites and the gap: the time since an RTK position was last more likely
than not, which dead reckoning has to bridge. Both are logistic regressions on splines (:mod:`..core.splines`). Levels
are quantiles of PL_CT of fitted samples of similar probability.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from lanebound.integrity.core.splines import Basis, fit_logistic

__all__ = [
    "LONGEST_GAP_S",
    "NO_LEVEL_M",
    "WORST_PDOP",
    "AvailabilityModel",
    "Fit",
    "gaps_along",
    "likely",
    "packaged_model",
]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FEWEST_FOR_RTK = 5  # satellites (S2 section 3)
WORST_PDOP = 20.0  # in place of a larger one: no position
LONGEST_GAP_S = 600.0  # a gap whose beginning is not known
LIKELY = 0.5
NO_LEVEL_M = 1e4  # in place of a missing level
GROUPS = 10  # of probabilities whose levels are alike
FILE = "maps/availability.json"  # of configs; written by lanebound reproduce availability


class Fit(NamedTuple):
    """A logistic regression of two variables: its basis and coefficients."""

    basis: Basis
    coefficients: Array

    @classmethod
    def of(cls, x: Array, y: Array, happens: Flags) -> Self:
        """The fit of samples (n,)."""
        basis = Basis(x, y)
        return cls(basis, fit_logistic(basis.at(x, y), happens))

    def at(self, x: Array, y: Array) -> Array:
        """Probabilities (n,)."""
        return np.asarray(expit(self.basis.at(x, y) @ self.coefficients))

    def to_dict(self) -> dict[str, Any]:
        """The fit as plain data."""
        return {"x": self.basis.x.tolist(), "y": self.basis.y.tolist(), "coefficients": self.coefficients.tolist()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The fit of :meth:`to_dict`."""
        return cls(Basis.of(np.array(data["x"]), np.array(data["y"])), np.array(data["coefficients"]))


class AvailabilityModel(NamedTuple):
    """Both stages, and quantiles of levels.

    Attributes
    ----------
    fix : RTK, from satellites and the logarithm of PDOP
    use : a usable position, from satellites and the logarithm of 1 s plus the gap
    edges : (G - 1,) probabilities between groups
    shares : (Q,) of the quantiles
    levels : (G, Q) quantiles of PL_CT of each group [m]
    """

    fix: Fit
    use: Fit
    edges: Array
    shares: Array
    levels: Array

    @classmethod
    def fitted(
        cls, satellites: Array, pdop: Array, rtk: Flags, usable: Flags, pl_ct_m: Array,
        gap_of: Callable[[Fit], Array], shares: Sequence[float],
    ) -> Self:  # fmt: skip
        """The model of samples (n,); ``gap_of`` gives their gaps [s] by the first stage."""
        fix = Fit.of(satellites, np.log(pdop), rtk)
        gap = np.log1p(gap_of(fix))
        use = Fit.of(satellites, gap, usable)
        probability = use.at(satellites, gap)
        edges = np.unique(np.quantile(probability, np.linspace(0.0, 1.0, GROUPS + 1)[1:-1], method="lower"))
        edges = edges[edges < probability.max()]  # so that no group is empty
        group = np.searchsorted(edges, probability)
        levels = [np.quantile(pl_ct_m[group == g], shares) for g in range(edges.size + 1)]
        return cls(fix, use, edges, np.array(shares), np.array(levels))

    def probability(self, satellites: ArrayLike, gap_s: ArrayLike) -> Array:
        """Probability of a usable position.  (N,), (N,) [s] -> (N,)."""
        return self.use.at(np.asarray(satellites, float), np.log1p(np.asarray(gap_s, float)))

    def quantiles(self, probability: Array) -> Array:
        """Quantiles of PL_CT at probabilities (N,).  -> (N, Q) [m]."""
        return np.asarray(self.levels[np.searchsorted(self.edges, probability)])

    def to_dict(self) -> dict[str, Any]:
        """The model as plain data."""
        fits = {"fix": self.fix.to_dict(), "use": self.use.to_dict()}
        return {**fits, **{name: getattr(self, name).tolist() for name in ("edges", "shares", "levels")}}

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Self:
        """The model of :meth:`to_dict`."""
        fix, use = (Fit.from_dict(data[name]) for name in ("fix", "use"))
        return cls(fix, use, *(np.array(data[name]) for name in ("edges", "shares", "levels")))


@cache
def packaged_model() -> AvailabilityModel:
    """The model that was fitted on generated training cities (``lanebound reproduce availability``)."""
    text = resources.files("lanebound.configs").joinpath(FILE).read_text(encoding="utf-8")
    return AvailabilityModel.of(json.loads(text)["model"])


def likely(fix: Fit, satellites: Array, pdop: Array) -> Flags:
    """Whether RTK is more likely than not, and there are the five satellites that it needs.  (N,), (N,) -> (N,)."""
    return np.asarray((fix.at(satellites, np.log(pdop)) >= LIKELY) & (satellites >= FEWEST_FOR_RTK))


def gaps_along(good: Flags, at_s: ArrayLike, begin_s: float = LONGEST_GAP_S) -> Array:
    """The time since a station where RTK was likely, at stations in order of travel.

    Parameters
    ----------
    good : (N,) whether RTK is likely there
    at_s : (N,) time of each station
    begin_s : gap at time 0
    """
    time_s = np.asarray(at_s, dtype=np.float64)
    last = np.maximum.accumulate(np.where(good, np.arange(good.size), -1))
    return np.where(last >= 0, time_s - time_s[last], begin_s + time_s)
