"""Positions of a fleet from what nodes tell each other: the estimators of S2 section 7 that pass on positions.

As in S2 Figure 1 each vehicle first has a position of its own (local level: INS and GNSS). The network's belief of a
node is its last one, moved by dead reckoning, met by its local position, and updated by the factors of the epoch. The
local position stems from the same history as the belief: they are fused by covariance intersection, and errors of dead
reckoning may be correlated with those of the belief. Local positions have the errors of satellites in common. ``mdpc``
and ``split`` allow for that; SPAWN in its three forms takes beliefs as independent: its covariances are too small.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.positioning.cooperative.factors import Factors
from lanebound.integrity.positioning.cooperative.messages import sum_product
from lanebound.integrity.positioning.cooperative.particles import Ranges, mdpc, particle_messages
from lanebound.integrity.positioning.cooperative.split import correlated_sum, intersection, split_messages

__all__ = ["Network", "NetworkBelief", "NetworkConfig"]

Array = NDArray[np.float64]


class NetworkConfig(Config):
    """How nodes combine what they know."""

    estimator: Literal["spawn", "md_spawn", "mdpc", "gaussian", "split"] = Field(
        "split",
        description="SPAWN and MD-SPAWN with particles, centralised MDPC, SPAWN with Gaussian messages, or split "
        "covariance intersection",
    )
    particles: int = Field(500, ge=10, le=1_000_000, description="of a node; of MDPC, of the fleet")
    rounds: int = Field(3, ge=1, le=100, description="rounds of Gaussian messages in an epoch")
    survey_m: float = Field(0.02, gt=0, description="places of roadside units, 1 sigma [m]; RTK")


@dataclass
class NetworkBelief:
    """What the network believes of its nodes, vehicles first: mean (K, D) and covariance (K, D, D).

    K nodes of D = 3, or of MDPC one state of all nodes.
    """

    mean: Array
    covariance: Array

    def copy(self) -> NetworkBelief:
        """An independent copy."""
        return copy.deepcopy(self)


class Local(NamedTuple):
    """The local level of V vehicles before the epoch's codes: position (V, 3), its covariance (V, 3, 3), the way since
    the last epoch (V, 3) by dead reckoning, and the covariance of its error (V, 3, 3)."""

    position_m: Array
    covariance_m2: Array
    way_m: Array
    way_m2: Array


class Network:
    """A fleet of vehicles and roadside units.

    Parameters
    ----------
    config : NetworkConfig
    places_m : (G, 3) surveyed places of the roadside units
    rng : of the particles
    """

    def __init__(self, config: NetworkConfig, places_m: Array, rng: np.random.Generator) -> None:
        self.config, self.places_m, self.rng = config, places_m, rng
        self._surveyed = np.broadcast_to(config.survey_m**2 * np.eye(3), (len(places_m), 3, 3))
        self._update: Callable[[NetworkBelief, Factors, Ranges], tuple[Array, Array]] = {
            "spawn": self._particles, "md_spawn": self._particles, "mdpc": self._mdpc,
            "gaussian": self._gaussian, "split": self._split,
        }[config.estimator]  # fmt: skip

    @property
    def joint(self) -> bool:
        """Whether all nodes are one state."""
        return self.config.estimator == "mdpc"

    def start(self, local: Local) -> NetworkBelief:
        """The belief that the local level has."""
        return self._of(local.position_m, local.covariance_m2, self._surveyed)

    def step(self, belief: NetworkBelief, local: Local, factors: Factors, ranges: Ranges) -> None:
        """One epoch, in place: dead reckoning, the local level, factors and ranges between nodes."""
        still = np.zeros_like(self._surveyed)
        moved = self._of(local.way_m, local.way_m2, still, np.zeros_like(self.places_m))
        met = self._of(local.position_m, local.covariance_m2, self._surveyed)
        mean, covariance = intersection(
            belief.mean + moved.mean, correlated_sum(belief.covariance, moved.covariance), met.mean, met.covariance
        )
        if len(factors.ends) or len(ranges.ends):
            mean, covariance = self._update(NetworkBelief(mean, covariance), factors, ranges)
        belief.mean, belief.covariance = self._surely_surveyed(mean, covariance)

    def positions(self, belief: NetworkBelief) -> tuple[Array, Array]:
        """Positions (N, 3) of the nodes and their covariances (N, 3, 3)."""
        if not self.joint:
            return belief.mean, belief.covariance
        every = np.arange(belief.mean.size // 3)
        return belief.mean.reshape(-1, 3), belief.covariance.reshape(len(every), 3, len(every), 3)[every, :, every, :]

    def _of(self, vehicles: Array, vehicles_m2: Array, units_m2: Array, units: Array | None = None) -> NetworkBelief:
        """A belief of the vehicles and of the roadside units, at their places by default."""
        mean = np.concatenate([vehicles, self.places_m if units is None else units])
        covariance = np.concatenate([vehicles_m2, units_m2])
        if not self.joint:
            return NetworkBelief(mean, covariance)
        whole, every = np.zeros((len(mean), 3, len(mean), 3)), np.arange(len(mean))
        # Correlated in unknown ways: as many times the blocks as there are vehicles bound the whole.
        whole[every, :, every, :] = max(len(vehicles), 1) * covariance
        return NetworkBelief(mean.reshape(1, -1), whole.reshape(1, mean.size, mean.size))

    def _surely_surveyed(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """With the places of the units as surveyed: what moves about them learns nothing of where they are."""
        if self.joint or not len(self.places_m):
            return mean, covariance
        vehicles = len(mean) - len(self.places_m)
        return np.concatenate([mean[:vehicles], self.places_m]), np.concatenate([covariance[:vehicles], self._surveyed])

    def _particles(self, prior: NetworkBelief, factors: Factors, ranges: Ranges) -> tuple[Array, Array]:
        c = self.config
        return particle_messages(
            prior.mean, prior.covariance, factors, ranges, c.particles, c.estimator == "md_spawn", self.rng
        )

    def _mdpc(self, prior: NetworkBelief, factors: Factors, ranges: Ranges) -> tuple[Array, Array]:
        mean, covariance = mdpc(
            prior.mean.reshape(-1, 3), prior.covariance[0], factors, ranges, self.config.particles, self.rng
        )
        return mean.reshape(1, -1), covariance[None]

    def _gaussian(self, prior: NetworkBelief, factors: Factors, ranges: Ranges) -> tuple[Array, Array]:
        linear = factors.joined(ranges.factors(prior.mean, prior.covariance))
        return sum_product(prior.mean, prior.covariance, linear, self.config.rounds)

    def _split(self, prior: NetworkBelief, factors: Factors, ranges: Ranges) -> tuple[Array, Array]:
        return split_messages(
            prior.mean, prior.covariance, factors.joined(ranges.factors(prior.mean, prior.covariance))
        )
