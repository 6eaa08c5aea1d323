"""What the vehicles of an area have in common: atmosphere, satellites' clocks, the reference station and its network.

An area is a street or a quarter: vehicles so close to each other, against the kilometres to their station, that its
errors and the differential atmosphere are the same for all. That the rays to two vehicles 1 km apart differ by 1 km in
the air is left out; a decorrelation of ``iono_ppm`` of it is half a millimetre.

Each navigator keeps its area itself. Two of them agree bit for bit when their areas have the same seed, figures and
satellites, for an area advances with the clock, epoch by epoch from zero, whoever asks and from when on.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors import area_kernel as kernel
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.clock import clock_gains
from lanebound.integrity.sensors.corrections import CorrectionsConfig, NetworkState, advance_network, initial_network
from lanebound.integrity.sensors.gnss import AreaSignals, GnssConfig

__all__ = ["AreaState", "advance_area", "initial_area"]

Array = NDArray[np.float64]
NO_NOISE = np.empty((0, 0, gk.N_NOISE))  # of the station, between two messages


@dataclass
class AreaState:
    """One area for all vehicles, or one for each.

    Attributes
    ----------
    streams : of the areas, of which "atmosphere", "station" and "network" are drawn from
    signals : what the receivers get
    network : what carries the messages of the station; its epochs are the area's
    """

    streams: Streams
    signals: AreaSignals
    network: NetworkState

    def copy(self) -> AreaState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_area(
    config: GnssConfig, link: CorrectionsConfig, satellites: int, dt_s: float, streams: Streams
) -> AreaState:
    """``streams.batch`` areas at zero of the clock: stationary errors, the network as it is found at any time."""
    azimuth = 2.0 * np.pi * streams.uniform("station")
    memory, noise = (
        streams.normal("atmosphere", satellites, gk.N_SLOW),
        streams.normal("station", satellites, gk.N_NOISE),
    )
    signals = AreaSignals(
        memory=memory,
        message=np.concatenate([memory[..., gk.A_CODE_MP :], noise], -1),
        clock=np.zeros((streams.batch, 2)),
        reference_enu_m=config.reference_offset_m
        * np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], -1),
    )
    return AreaState(streams, signals, initial_network(link, dt_s, streams))


def advance_area(config: GnssConfig, link: CorrectionsConfig, state: AreaState, time_s: float, dt_s: float) -> None:
    """Bring the areas to the epoch that ends at ``time_s`` of the clock, in place; never back.

    Ionosphere, satellites' clocks, troposphere and the station's multipath last for minutes: one of them advances in
    each epoch, by as many epochs as there are of them. The station's noise is new with each of its messages, which a
    receiver keeps until it receives another (:mod:`.corrections`).
    """
    epoch = round(time_s / dt_s)
    while state.network.epoch < epoch:
        _advance(config, link, state, dt_s)


def _advance(config: GnssConfig, link: CorrectionsConfig, state: AreaState, dt_s: float) -> None:
    advance_network(link, state.network, dt_s, state.streams)
    signals, network, satellites = state.signals, state.network, state.signals.memory.shape[1]
    decays, gains, clock = _figures(config, dt_s)
    noise = NO_NOISE
    if network.fresh.any():
        noise = state.streams.normal("station", satellites, gk.N_NOISE, where=network.fresh)
    kernel.advance(
        signals.memory, signals.message, signals.clock, dt_s, network.own_epoch % gk.N_SLOW, decays, gains,
        state.streams.normal("atmosphere", satellites), network.fresh, noise, *clock,
        state.streams.normal("station", 2),
    )  # fmt: skip


@lru_cache(maxsize=64)
def _figures(config: GnssConfig, dt_s: float) -> tuple[Array, Array, tuple[float, float, float]]:
    """Decay and gain of each slow state over N_SLOW epochs, and the gains of the station's clock."""
    tau_s = np.full(gk.N_SLOW, config.station_multipath_tau_s)
    tau_s[[gk.A_IONO, gk.A_AGE, gk.A_TROPO]] = config.iono_tau_s, config.age_tau_s, config.tropo_tau_s
    steps = gk.N_SLOW * dt_s / tau_s
    clock = clock_gains(config.station_clock_h0, config.station_clock_hm2, dt_s)
    return np.exp(-steps), np.sqrt(-np.expm1(-2.0 * steps)), clock
