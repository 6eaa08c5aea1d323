"""From solution to solution by wheel speed and yaw rate, and whether the next one agrees with what was carried on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.risk import RiskConfig, upper_quantile
from lanebound.integrity.replay.bridge import Bridge, BridgeConfig
from lanebound.integrity.replay.reckoning import turned
from lanebound.integrity.replay.window import PSI

__all__ = ["Carrier", "Place", "Witness"]

Array = NDArray[np.float64]


class Place(NamedTuple):
    """A position: the unknowns of a window, heading [rad], levels and sigmas (2,) on AT and CT [m]; a solution's
    covariance (2, 2) in E and N [m^2]."""

    x: Array
    heading_rad: float
    levels_m: Array
    sigma_m: Array
    covariance_m2: Array | None = None


class Carrier:
    """A solution carried on, with levels that grow (:mod:`.bridge`)."""

    def __init__(self, config: BridgeConfig, risk: RiskConfig, found: Place) -> None:
        assert found.covariance_m2 is not None
        self.risk, self.x = risk, found.x
        self.bridge = Bridge(config, risk, found.covariance_m2, found.levels_m, found.sigma_m, found.heading_rad)

    def step(self, dt_s: float, way_m: Array, heading_rad: float) -> Place:
        """``dt_s`` later, after a way (2,) and at a heading on the reckoned path."""
        way = turned(way_m, float(self.x[PSI]))
        self.x = self.x.copy()
        self.x[:2] += way
        self.x[3] += self.x[4] * dt_s
        heading = float(self.x[PSI] + heading_rad)
        levels, sigma = self.bridge.step(dt_s, float(np.linalg.norm(way)) / dt_s, heading)
        return Place(self.x, heading, levels, sigma)

    def contradicts(self, found: Place, carried: Place) -> bool:
        """Whether a solution is farther from where it was ``carried`` than their noise and its bias allow, on an axis.

        Both share signals of their windows, so that without a fault they differ by less than by independent noise, and
        false alarms are rarer than the ``false_alarm`` of the levels.
        """
        factor = float(upper_quantile(self.risk.false_alarm / 4.0))  # two axes, two sides
        allowed = factor * np.hypot(found.sigma_m, carried.sigma_m) + self.bridge.grown(found.heading_rad)
        return bool((_apart(found, carried) > allowed).any())


class Witness:
    """The last solution that none contradicted: while others contradict it, levels cover whichever is right.

    One of the two is wrong, and nothing tells which. A contradiction that outlasts ``most_s``, a window, is settled for
    the solutions, which then hold no signal from before it.
    """

    def __init__(self, most_s: float) -> None:
        self.most_s = most_s
        self.carrier: Carrier | None = None
        self.until_s = 0.0

    def heard(self, found: Place, latest: tuple[Carrier, Place], his: Place | None, time_s: float) -> Place:
        """A solution at a time, its levels widened where it contradicts him, or else the ``latest`` one."""
        carrier, expected = latest if self.carrier is None or his is None else (self.carrier, his)
        if not carrier.contradicts(found, expected):
            self.carrier = None
            return found
        if self.carrier is None:
            self.carrier, self.until_s = carrier, time_s + self.most_s
        if time_s >= self.until_s:
            self.carrier = None
            return found
        return found._replace(levels_m=np.maximum(found.levels_m, _apart(found, expected) + expected.levels_m))


def _apart(found: Place, carried: Place) -> Array:
    """Distance of two positions (2,) on the AT and CT of the first [m]."""
    return np.asarray(np.abs(track_from_enu_matrix(found.heading_rad) @ (found.x[:2] - carried.x[:2])))
