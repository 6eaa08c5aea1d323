"""What the vehicles of an area have in common: atmosphere, satellites' clocks, the reference station and its network.

An area is a street or a quarter: vehicles so close to each other, against the kilometres to their station, that its
errors and the differential atmosphere are the same for all. That the rays to two vehicles 1 km apart differ by 1 km in
the air is left out; a decorrelation of ``iono_ppm`` of it is half a millimetre.

Each navigator keeps its area itself. Two of them agree bit for bit when their areas have the same seed, figures and
satellites, because an area always advances from epoch 0 of the clock, whenever it is first read.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import ZIGGURAT, Streams
from lanebound.integrity.sensors import area_kernel as kernel
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.augmentation import AugmentationAreas, advance_providers, initial_providers
from lanebound.integrity.sensors.broadcast import BroadcastState, initial_broadcast
from lanebound.integrity.sensors.clock import clock_gains
from lanebound.integrity.sensors.corrections import CorrectionsConfig, NetworkState, initial_network, link_parameters
from lanebound.integrity.sensors.corrections_kernel import advance_networks
from lanebound.integrity.sensors.draws_kernel import Draws
from lanebound.integrity.sensors.gnss import AreaSignals, GnssConfig

__all__ = ["AreaState", "advance_area", "initial_area"]

NO_GENERATORS, NOT_DRAWN = np.empty((len(kernel.AREA_STREAMS), 0, 4), np.uint64), np.empty((0, 0))


@dataclass
class AreaState:
    """One area for all vehicles, or one for each.

    Attributes
    ----------
    streams : of the areas, of which "atmosphere", "station", "network", "broadcast" and "augmentation" are drawn from
    signals : what the receivers get
    network : what carries the messages of the station; its epochs are the area's
    broadcast : errors that a difference cancels, where undifferenced observables are computed
    providers : of corrections, where there are any
    """

    streams: Streams
    signals: AreaSignals
    network: NetworkState
    broadcast: BroadcastState | None = None
    providers: AugmentationAreas | None = None

    @property
    def rows(self) -> kernel.Areas:
        """The areas as kernels take them."""
        return kernel.Areas(self.network.areas, self.signals.site, self.signals.memory, self.signals.message)

    def copy(self) -> AreaState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_area(
    config: GnssConfig, link: CorrectionsConfig, satellites: int, dt_s: float, streams: Streams
) -> AreaState:
    """``streams.batch`` areas at zero of the clock: stationary errors, the network as it is found at any time."""
    azimuth = 2.0 * np.pi * streams.uniform("station")
    slow = streams.normal("atmosphere", satellites, kernel.PROCESSES).view(gk.SLOW)[..., 0]
    noise = streams.normal("station", satellites, gk.STATION_NOISE.itemsize // 8).view(gk.STATION_NOISE)[..., 0]
    message = np.zeros(slow.shape, gk.STATION)
    for part, names in ((slow, ("code_multipath", "phase_multipath")), (noise, ("code", "phase"))):
        for name in names:
            message[name] = part[name]
    site = np.zeros(streams.batch, gk.SITE)
    site["reference"] = config.reference_offset_m * np.stack([np.sin(azimuth), np.cos(azimuth), 0.0 * azimuth], -1)
    signals = AreaSignals(memory=slow, message=message, site=site)
    broadcast = initial_broadcast(satellites, streams) if config.undifferenced else None
    given = config.augmentation
    providers = initial_providers(given, satellites, dt_s, streams) if given.providers else None
    return AreaState(streams, signals, initial_network(link, dt_s, streams), broadcast, providers)


def advance_area(config: GnssConfig, link: CorrectionsConfig, state: AreaState, time_s: float, dt_s: float) -> None:
    """Bring the areas to the epoch that ends at ``time_s`` of the clock, in place; never back.

    Ionosphere, satellites' clocks, troposphere and the station's multipath last for minutes: each epoch advances one of
    these processes in turn, by as many epochs as there are processes. The station's noise is new with each of its
    messages, which a receiver holds until it receives another (:mod:`.corrections`).
    """
    epoch, network, streams = round(time_s / dt_s), state.network, state.streams
    rules, link_rules = area_parameters(config, dt_s), link_parameters(link, dt_s)
    while network.epoch < epoch:
        network.epoch += 1
        if state.broadcast is not None:
            config.broadcast.advance(state.broadcast, dt_s, streams)
        generators = streams.together(kernel.AREA_STREAMS) if streams.draws_by_row else NO_GENERATORS
        if generators.shape[1] == network.areas.shape[0]:
            draws = Draws(generators, ZIGGURAT, streams.places, NOT_DRAWN)
            kernel.advance(network.epoch, rules, link_rules, state.rows, draws)
        else:
            _advance_drawn(state, rules, link_rules)
        if state.providers is not None and state.broadcast is not None:
            errors = config.broadcast, state.broadcast
            advance_providers(config.augmentation, errors, state.providers, network.own_epoch, dt_s, streams)


def _advance_drawn(state: AreaState, rules: Records, link_rules: Records) -> None:
    """Advance the areas by draws of streams that draw in a way of their own, or from one generator for all areas."""
    streams, network, slow = state.streams, state.network, state.signals.memory
    outages = streams.normal("network", 2) if link_rules[0]["outages"] else np.zeros((len(slow), 2))
    advance_networks(network.epoch, link_rules[0], outages, network.areas)
    noise, fresh = np.zeros(slow.shape, gk.STATION_NOISE), network.areas["fresh"]
    if fresh.any():
        drawn = streams.normal("station", slow.shape[1], kernel.NOISE, where=fresh)
        noise = drawn.view(gk.STATION_NOISE)[..., 0]
    atmosphere, clock = streams.normal("atmosphere", slow.shape[1]), streams.normal("station", 2)
    kernel.advance_all_drawn(network.epoch, rules, state.rows, atmosphere, noise, clock)


@lru_cache(maxsize=64)
def area_parameters(config: GnssConfig, dt_s: float) -> Records:
    """Decay and gain of each slow process over PROCESSES epochs, and the gains of the station's clock."""
    tau_s = {"iono": config.iono_tau_s, "age": config.age_tau_s, "tropo": config.tropo_tau_s}
    decay, gain = np.zeros(1, gk.SLOW), np.zeros(1, gk.SLOW)
    for name in gk.SLOW.names or ():
        steps = kernel.PROCESSES * dt_s / np.array(tau_s.get(name, config.station_multipath_tau_s))
        decay[name], gain[name] = np.exp(-steps), np.sqrt(-np.expm1(-2.0 * steps))
    clock_11, clock_21, clock_22 = clock_gains(config.station_clock_h0, config.station_clock_hm2, dt_s)
    return one_record(
        kernel.AREA_RULES, dt=dt_s, decay=decay, gain=gain, clock_11=clock_11, clock_21=clock_21, clock_22=clock_22
    )
