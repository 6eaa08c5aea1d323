"""Navigation of a fleet that cooperates: the local level of each vehicle, and what the network adds (S2 Figure 1).

>>> fleet = Fleet(FleetConfig(estimators=("ekf", "split")), 2, system, places_m)   # two vehicles, roadside units
>>> fleet.start(position_m, heading_rad)
>>> fleet.move(measured)                                                          # in each epoch of the instruments
>>> found = fleet.share(measured, pairs, ranges)                                  # in each epoch of the network

The nodes are the vehicles, and after them the roadside units; measurements have a row for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.cooperative.exclusion import ExclusionConfig, NodeBank
from lanebound.integrity.positioning.cooperative.factors import Factors
from lanebound.integrity.positioning.cooperative.joint_filter import (
    MOVING_MPS,
    Codes,
    JointFilter,
    JointFilterConfig,
    JointState,
)
from lanebound.integrity.positioning.cooperative.network import Local, Network, NetworkBelief, NetworkConfig
from lanebound.integrity.positioning.cooperative.particles import Ranges
from lanebound.integrity.positioning.cooperative.shared_codes import double_differences
from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["Fleet", "FleetConfig", "Placed"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Estimator = Literal["ekf", "spawn", "md_spawn", "mdpc", "gaussian", "split"]


class FleetConfig(Config):
    """Estimators of a fleet, and what they are told of the errors."""

    estimators: tuple[Estimator, ...] = Field(("ekf",), description="that run next to each other")
    local: JointFilterConfig = Field(JointFilterConfig(), description="of each vehicle, and of the centralised EKF")
    network: NetworkConfig = Field(NetworkConfig(), description="of estimators that pass on positions")
    exclusion: ExclusionConfig | None = Field(None, description="of the centralised EKF: search for a faulty node")
    dt_s: float = Field(0.1, gt=0, le=1, description="epoch of the instruments [s]")
    epoch_s: float = Field(1.0, gt=0, le=10, description="time between codes that are shared [s]")
    mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation of codes [deg]")
    least_dbhz: float = Field(
        36.0, ge=0, description="weakest codes in use [dB-Hz]; reflections_m declares those above"
    )
    share_codes: bool = Field(
        True, description="nodes share their codes; else ranges and positions, and the EKF has none of the units' codes"
    )


@dataclass(frozen=True)
class Placed:
    """What an estimator knows of V vehicles.

    position_m (V, 3), covariance_m2 (V, 3, 3); level_m (V, 2) East and North, of the EKF with a search for faults.
    """

    position_m: Array
    covariance_m2: Array
    level_m: Array | None = None


class Fleet:
    """``vehicles`` V and roadside units at ``places_m`` (G, 3), under satellites of ``system`` (S,)."""

    def __init__(self, config: FleetConfig, vehicles: int, system: Ints, places_m: Array, seed: int = 0) -> None:
        self.config, self.vehicles, self.system, self.places_m = config, vehicles, system, places_m
        nothing = np.empty((0, 3))
        self._alone = JointFilter(config.local, 1, system, nothing, config.epoch_s)
        self._units = JointFilter(config.local, 0, system, places_m, config.epoch_s)
        self._joint = JointFilter(config.local, vehicles, system, places_m, config.epoch_s, config.share_codes)
        self._networks = {
            name: Network(config.network.replace(estimator=name), places_m, named_generator(seed, f"particles-{name}"))
            for name in config.estimators
            if name != "ekf"
        }
        self._beliefs: dict[str, NetworkBelief] = {}
        self.bank: NodeBank | None = None

    def start(self, position_m: Array, heading_rad: Array) -> None:
        """Positions (V, 3) and headings (V,) as each vehicle knows them, to the declared sigmas of the start."""
        units = len(self.places_m)
        self._local = self._alone.start(position_m[:, None], heading_rad[:, None])
        self._known = self._units.start(np.empty((units, 0, 3)), np.empty((units, 0)))
        self._before, self._beliefs, self.bank = position_m, {}, None
        self._state = self._joint.start(position_m[None], heading_rad[None])
        if self.config.exclusion is not None:
            self.bank = NodeBank.start(self.config.exclusion, self._joint, position_m, heading_rad)
            self._state = self.bank.state

    def move(self, m: Measurements) -> None:
        """Dead reckoning of an epoch of the instruments."""
        turn, speed = m.imu.delta_theta_rad[: self.vehicles, 2], m.odometer.speed_mps[: self.vehicles]
        self._alone.predict(self._local, turn[:, None], speed[:, None], self.config.dt_s)
        self._known.since_s += self.config.dt_s
        if "ekf" in self.config.estimators:
            rows = (len(self._state.mean), self.vehicles)
            turns, speeds = np.broadcast_to(turn, rows), np.broadcast_to(speed, rows)
            self._joint.predict(self._state, turns, speeds, self.config.dt_s)

    def share(self, m: Measurements, pairs: Ints, ranges: Ranges) -> dict[str, Placed]:
        """One epoch of the network; returns what each estimator knows, ``local`` that of each vehicle alone.

        Parameters
        ----------
        m : measurements of the nodes (N,), with undifferenced codes
        pairs : (E, 2) nodes that hear each other
        ranges : between pairs of nodes

        Raises
        ------
        InputError
            The measurements have no undifferenced codes, or another number of nodes.
        """
        codes = self._codes(m)
        los = m.sky.los_enu[m.sky.index[0]]
        local, v, before = self._local_level(), self.vehicles, self._local.copy()
        used = self._gate(los, codes)
        factors = self._factors(los, codes, used, pairs) if self.config.share_codes else Factors.none()
        found = {
            "local": Placed(self._alone.positions(self._local)[:, 0], self._alone.covariances(self._local)[:, 0, :, 0])
        }
        for name, network in self._networks.items():
            if name not in self._beliefs:
                self._beliefs[name] = network.start(local)
            network.step(self._beliefs[name], local, factors, ranges)
            position, covariance = network.positions(self._beliefs[name])
            found[name] = Placed(position[:v], covariance[:v])
        if "ekf" in self.config.estimators:
            found["ekf"] = self._centralised(m.time_s, los, codes, ranges, before)
        self._before = found["local"].position_m
        return found

    def _codes(self, m: Measurements) -> Codes:
        """The codes of the first band above the mask."""
        nodes = self.vehicles + len(self.places_m)
        if m.gnss.raw_code_m is None:
            raise InputError("m must have undifferenced codes, got none: set gnss.undifferenced of the navigator")
        if len(m.gnss.tracked) != nodes:
            raise InputError(f"m must have {nodes} nodes, vehicles and roadside units, got {len(m.gnss.tracked)}")
        high = m.sky.los_enu[m.sky.index[0]][:, 2] > np.sin(np.deg2rad(self.config.mask_deg))
        used = m.gnss.tracked & high & (m.gnss.cn0_dbhz >= self.config.least_dbhz)
        return Codes(m.gnss.raw_code_m[..., 0], m.gnss.range_rate_mps, m.gnss.cn0_dbhz, used)

    def _local_level(self) -> Local:
        """What each vehicle knows of itself before the codes of the epoch."""
        position = self._alone.positions(self._local)[:, 0]
        way = position - self._before
        return Local(position, self._alone.covariances(self._local)[:, 0, :, 0], way,
                     self._alone.way_covariance(self._local, way[:, None], self.config.epoch_s)[:, 0])  # fmt: skip

    def _gate(self, los: Array, codes: Codes) -> Bools:
        """Update what vehicles and units know by their own codes; returns the codes that each uses (N, S)."""
        v = self.vehicles
        own = self._alone.update(self._local, los, codes.each(lambda x: x[:v, None]))[:, 0]
        if not len(self.places_m):
            return own
        units = np.eye(len(self.places_m), dtype=np.bool_)
        theirs = self._units.update(self._known, los, codes.each(lambda x: x[v:]), units)
        return np.concatenate([own, theirs[units]])

    def _factors(self, los: Array, codes: Codes, used: Bools, pairs: Ints) -> Factors:
        """Double differences of pairs of which one at least is a vehicle: units know where they are."""
        moving = np.concatenate([self._local.speed_mps[:, 0] > MOVING_MPS, np.zeros(len(self.places_m), np.bool_)])[
            :, None
        ]
        _, white, lasting = self._joint.errors(los, codes.cn0_dbhz, moving)
        return double_differences(
            pairs[(pairs < self.vehicles).any(-1)], los, codes.code_m, white, used, self.system, lasting
        )

    def _centralised(self, time_s: float, los: Array, codes: Codes, ranges: Ranges, alone: JointState) -> Placed:
        """The EKF of all, and its search for a faulty node."""
        joint, state, bank = self._joint, self._state, self.bank
        if bank is None:
            joint.update(state, los, codes)
            joint.update_ranges(state, ranges.ends, ranges.range_m, ranges.sigma_m)
            level = None
        else:
            bank.judge_codes(time_s, los, codes, alone)
            uses = bank.uses
            joint.update(state, los, codes, uses.codes)
            joint.update_ranges(state, ranges.ends, ranges.range_m, ranges.sigma_m, uses.ranges)
            bank.judge(time_s, self._local)
            level = bank.levels(time_s)
        every = np.arange(self.vehicles)
        covariance = joint.covariances(state)[0][every, :, every, :]
        return Placed(joint.positions(state)[0, : self.vehicles], covariance, level)
