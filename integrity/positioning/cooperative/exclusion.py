"""Which node contradicts the others, and levels that hold until it is found: solution separation over a fleet.

Next to the filter of all nodes runs one for each hypothesis k: without a node (a vehicle lies or its receiver is wrong,
a unit has a wrong place), or without the ranges to a vehicle (its module is wrong, or ranged around a body). For a
vehicle and an axis, with P and P_k the variances of both filters (S3 section IV-B, solution separation; R. Brown and P.
McBurney 1988)::

    T_k = K_fa sqrt(P_k - P),   level = max(K_0 sqrt(P), max_k T_k + K_k sqrt(P_k))
    |x - x_k| > T_k on some axis of some vehicle: there is a fault

Of the hypotheses whose separation exceeds its threshold, that one is taken as true under which the remaining
measurements fit best: separations say that there is a fault, not whose. What it leaves out stays out. That may be the
wrong node, so the filters of the other hypotheses begin anew from what each vehicle knows alone, without any other
node. Their separations then have another history, and ``T_k = K_fa (sqrt(P_k) + sqrt(P))``. A node is left out, too,
whose codes alone show for some epochs that it is elsewhere (:meth:`~.joint_filter.JointFilter.shifts`): the gate that
leaves out the codes of a jump also hides it from separations. One fault at a time is searched for; what the prior
leaves for two is taken off the risk.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.stats import chi2

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.cooperative.joint_filter import OWN, Codes, JointFilter, JointState

__all__ = ["Exclusion", "ExclusionConfig", "NodeBank", "Uses"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class ExclusionConfig(Config):
    """Risks of the levels and of the test."""

    integrity_risk: float = Field(1e-5, gt=0, lt=1, description="of the levels of a vehicle, both axes together [-]")
    prior: float = Field(1e-4, gt=0, lt=1, description="that a node is faulty [-]; chosen, higher than any receiver's")
    false_alarm: float = Field(
        1e-5, gt=0, lt=1, description="of an epoch of the fleet, without faults and with the declared errors [-]"
    )

    def two_faults(self, hypotheses: int) -> float:
        """Probability of two faults among as many hypotheses."""
        return 0.5 * (hypotheses * self.prior) ** 2


class Exclusion(NamedTuple):
    """What was left out, all of a node or the ranges to it; when; and why.

    A ``separation`` of solutions, or a ``shift`` of all codes of the node.
    """

    node: int
    what: Literal["node", "ranges"]
    time_s: float
    reason: Literal["separation", "shift"]


class Uses(NamedTuple):
    """Nodes whose codes and whose ranges each row uses, (F, N) each."""

    codes: Bools
    ranges: Bools


@dataclass
class NodeBank:
    """The filters of one fleet: row 0 with all that is in use, row 1 + k under hypothesis k.

    Attributes
    ----------
    config : ExclusionConfig
    joint : JointFilter of the fleet
    state : of the rows
    excluded : what is left out, in the order it was found
    shifted_s : (N,) how long the codes of a node have said that it is elsewhere [s]
    """

    config: ExclusionConfig
    joint: JointFilter
    state: JointState
    excluded: list[Exclusion]
    shifted_s: Array

    @classmethod
    def start(cls, config: ExclusionConfig, joint: JointFilter, position_m: Array, heading_rad: Array) -> NodeBank:
        """A bank from positions (V, 3) and headings (V,).

        Raises
        ------
        InputError
            Two faults at once are likelier than the risk.
        """
        rows, two = 1 + len(_hypotheses(joint)), config.two_faults(len(_hypotheses(joint)))
        if two >= config.integrity_risk:
            raise InputError(
                f"prior must be so small that two faults are rarer than integrity_risk {config.integrity_risk:g}, got "
                f"{config.prior:g}, with {two:.1e} for {rows - 1} hypotheses: lower it"
            )
        state = joint.start(np.repeat(position_m[None], rows, 0), np.repeat(heading_rad[None], rows, 0))
        return cls(config, joint, state, [], np.zeros(joint.nodes))

    @property
    def uses(self) -> Uses:
        """What each row uses."""
        hypotheses = _hypotheses(self.joint)
        uses = Uses(*np.ones((2, 1 + len(hypotheses), self.joint.nodes), np.bool_))
        for k, (node, kind) in enumerate(hypotheses, 1):
            uses.codes[k, node] &= kind == "ranges"
            uses.ranges[k, node] = False
        for found in self.excluded:
            uses.codes[:, found.node] &= found.what == "ranges"
            uses.ranges[:, found.node] = False
        return uses

    def judge_codes(self, time_s: float, los_enu: Array, codes: Codes, alone: JointState) -> None:
        """Before an epoch's updates: leave out a node whose codes say that it is elsewhere.

        alone : states of the filters of each vehicle alone, V fleets of one
        """
        gain, left = self.joint.shifts(self.state, los_enu, codes)
        inside = self.uses.codes[0]
        told = inside & (gain > chi2.isf(self.config.false_alarm / self.joint.nodes, 3)) & (left < FITS)
        self.shifted_s = np.where(told, self.shifted_s + self.joint.epoch_s, 0.0)
        if time_s > SETTLED_S and (self.shifted_s >= SHIFTED_S).any():
            node = int(np.argmax(np.where(self.shifted_s >= SHIFTED_S, gain, 0.0)))
            self._leave_out(Exclusion(node, "node", time_s, "shift"), alone)

    def judge(self, time_s: float, alone: JointState) -> None:
        """After an epoch's updates: leave out what contradicts the rest; ``alone`` as before."""
        hypotheses = _hypotheses(self.joint)
        known = {(found.node, found.what) for found in self.excluded}
        separation, threshold, _ = self._separations()
        free = [(node, kind) not in known and (node, "node") not in known for node, kind in hypotheses]
        exceeds = (separation > threshold).any((1, 2)) & np.array(free)
        if time_s > SETTLED_S and exceeds.any():
            node, kind = hypotheses[int(np.argmin(np.where(exceeds, self.state.misfit[1:], np.inf)))]
            self._leave_out(Exclusion(node, kind, time_s, "separation"), alone)

    def _leave_out(self, found: Exclusion, alone: JointState) -> None:
        self.excluded.append(found)
        self.shifted_s[found.node] = 0.0
        state, row = self.state, 1 + _hypotheses(self.joint).index((found.node, found.what))
        for values in (state.mean, state.covariance, state.misfit):
            values[0] = values[row]
        own = OWN * self.joint.vehicles
        state.mean[1:], state.covariance[1:], state.misfit[1:] = 0.0, 0.0, state.misfit[row]
        state.mean[1:, :own] = alone.mean[:, :OWN].reshape(-1)
        # The vehicles and the errors of the area are correlated: n times n diagonal blocks bound any joint covariance.
        blocks = self.joint.vehicles + 1
        for v in range(self.joint.vehicles):
            mine = slice(OWN * v, OWN * (v + 1))
            state.covariance[1:, mine, mine] = blocks * alone.covariance[v, :OWN, :OWN]
        area = np.arange(own, state.mean.shape[-1])
        state.covariance[1:, area, area] = blocks

    def levels(self, time_s: float) -> Array:
        """Levels (V, 2) of the vehicles, East and North [m]; inf before anything is judged.

        That a vehicle itself is wrong is no hypothesis of its own level: what it measures, its own receiver watches.
        """
        if time_s <= SETTLED_S:  # a level counts on a test that would have found the fault
            return np.full((self.joint.vehicles, 2), np.inf)
        c, hypotheses = self.config, _hypotheses(self.joint)
        _, threshold, sigma = self._separations()
        risk = (c.integrity_risk - c.two_faults(len(hypotheses))) / 8.0  # half with a fault, two axes, two sides
        free = NormalDist().inv_cdf(1.0 - risk) * self._sigma()[0]
        tail = min(0.5, risk / (len(hypotheses) * c.prior))
        faulty = threshold + NormalDist().inv_cdf(1.0 - tail) * sigma
        known = {(found.node, found.what) for found in self.excluded}
        for k, (node, kind) in enumerate(hypotheses):
            if (node, kind) in known or (node, "node") in known:
                faulty[k] = 0.0  # what it supposes wrong is in no filter any more
            elif kind == "node" and node < self.joint.vehicles:
                faulty[k, node] = 0.0
        return np.asarray(np.maximum(free, faulty.max(0)))

    def _separations(self) -> tuple[Array, Array, Array]:
        """|x - x_k|, T_k and sigma_k (K, V, 2) of the hypotheses."""
        place, sigma = self.joint.positions(self.state)[:, : self.joint.vehicles, :2], self._sigma()
        tests = 4.0 * sigma[1:].shape[0] * self.joint.vehicles  # two sides, two axes
        factor = NormalDist().inv_cdf(1.0 - self.config.false_alarm / tests)
        apart = np.sqrt(np.maximum(np.square(sigma[1:]) - np.square(sigma[0]), TINY_M2))
        if self.excluded:  # filters that began anew have another history, so that any correlation is possible
            apart = sigma[1:] + sigma[0]
        return np.abs(place[1:] - place[0]), factor * apart, sigma[1:]

    def _sigma(self) -> Array:
        """Standard deviations (F, V, 2) East and North [m]."""
        at = OWN * np.arange(self.joint.vehicles)[:, None] + np.arange(2)
        return np.sqrt(self.state.covariance[:, at, at])


def _hypotheses(joint: JointFilter) -> list[tuple[int, Literal["node", "ranges"]]]:
    """What may be wrong: node and kind."""
    return [*((node, "node") for node in range(joint.nodes)), *((v, "ranges") for v in range(joint.vehicles))]


SHIFTED_S = 3.0  # how long codes say that their node is elsewhere before it is left out; chosen
FITS = 2.0  # largest misfit, over its expectation, of codes that are taken to be shifted as a whole; chosen
SETTLED_S = 10.0  # nothing is judged before: filters that begin alike have no separations; chosen
TINY_M2 = 1e-2  # filters gate and linearise differently, so that a decimetre separates nothing; chosen
