"""Corrections that providers of positioning services broadcast, and their reception by vehicles.

A provider measures the errors of satellites and sends what it finds as messages. A vehicle holds the newest messages
that it has received. What remains in a corrected range follows from the same error processes (:mod:`.broadcast`):

- **Common errors cancel.** Corrections of satellites have rates, so that what is common to all times cancels; they age
  with the clocks of the satellites, ``age_rate age u`` with a process u of each satellite, as those of RTK do. The
  ionosphere has no rate: what has changed since it was measured remains.
- **A residual remains** at age 0: that of the provider's own estimates, a Gauss-Markov process for each satellite and
  for the ionosphere.
- **DGPS** measures at one station: satellite, ionosphere and troposphere in one number, less what differs over the
  distance to the vehicle.
- **SBAS L1** sends satellite corrections and, more seldom, a grid of vertical ionospheric delays. **SBAS DFMC** and
  **PPP** send satellite corrections for ionosphere-free ranges.

Messages come from geostationary satellites (GEO), which buildings hide, or by the mobile network, with the outages of
the reference link (:mod:`.corrections`); SISNeT sends the messages of EGNOS that way. A receiver that has just been
switched on holds the newest messages (``warm``) or none.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors.broadcast import BroadcastConfig, BroadcastState, mapping, obliquity
from lanebound.integrity.sky.systems import System

__all__ = [
    "NEVER_S",
    "PROVIDERS",
    "AugmentationAreas",
    "AugmentationConfig",
    "AugmentationHeld",
    "Corrections",
    "DgpsConfig",
    "MessageConfig",
    "NetworkRtkConfig",
    "SbasConfig",
    "advance_providers",
    "corrections_of",
    "initial_held",
    "initial_providers",
    "receive_messages",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

PROVIDERS = ("dgps", "sbas_l1", "sbas_dfmc", "ppp")
DGPS, SBAS_L1 = 0, 1
SATELLITE, IONOSPHERE = 0, 1  # kinds of messages
NEVER_S = np.inf
NEVER = -(2**40)  # epoch of a message that was never received


class MessageConfig(Config):
    """Satellite corrections of one provider: their true residual, what the provider declares of it, and messages."""

    systems: tuple[str, ...] = Field(
        ("GPS", "GALILEO"), min_length=1, description="systems that the provider corrects; others have no correction"
    )
    residual_m: float = Field(0.25, ge=0, description="satellite error that remains at age 0, 1 sigma [m]")
    residual_tau_s: float = Field(900.0, gt=0, description="its correlation time [s]; chosen: arcs over a network")
    declared_m: float = Field(0.5, gt=0, description="1 sigma of it that the provider declares [m]")
    interval_s: float = Field(6.0, gt=0, description="time between messages [s]")
    latency_s: float = Field(3.0, ge=0, description="from the measurement to the end of the message [s]")
    delivery: Literal["geo", "link", "both"] = Field(
        "geo", description="geo: geostationary satellites; link: mobile network (SISNeT, NTRIP); both: either"
    )

    @model_validator(mode="after")
    def _messages_in_time(self) -> MessageConfig:
        if not self.latency_s < self.interval_s:
            raise ConfigError(
                f"latency_s must be < interval_s = {self.interval_s:g}, got {self.latency_s:g}: a message is sent "
                "before the next one is measured"
            )
        unknown = [name for name in self.systems if name not in System.__members__]
        if unknown:
            known = ", ".join(System.__members__)
            raise ConfigError(f"systems must be among {known}, got {unknown[0]!r}: correct the name")
        return self

    def corrected(self, system: Ints) -> Bools:
        """Which satellites of these systems the provider corrects."""
        return _among(self.systems, system.tobytes())


class SbasConfig(MessageConfig):
    """SBAS on L1: the satellite corrections of DO-229, and its ionospheric grid."""

    systems: tuple[str, ...] = Field(("GPS",), min_length=1, description="systems corrected; GPS alone, DO-229D")
    residual_m: float = Field(
        0.4, ge=0, description="satellite error that remains at age 0, 1 sigma [m]; declared UDREI 5 is 2.3 times that"
    )
    declared_m: float = Field(0.912, gt=0, description="sigma_UDRE [m]; UDREI 5, root of 0.8315, DO-229D table A-6")
    iono_residual_m: float = Field(
        0.4, ge=0, description="vertical delay of the grid that is wrong, 1 sigma on L1 [m]; declared GIVEI 9 is 2.3x"
    )
    iono_residual_tau_s: float = Field(1800.0, gt=0, description="its correlation time [s]; chosen")
    iono_declared_m: float = Field(
        0.912, gt=0, description="sigma_GIVE [m]; GIVEI 9, root of 0.8315, DO-229D table A-17"
    )
    iono_interval_s: float = Field(300.0, gt=0, description="time between grids [s]; DO-229D table A-25")


class DgpsConfig(MessageConfig):
    """Corrections of ranges by one reference station."""

    systems: tuple[str, ...] = Field(
        ("GPS", "GALILEO", "GLONASS", "BEIDOU", "QZSS"), min_length=1, description="systems that the station corrects"
    )
    residual_m: float = Field(0.15, ge=0, description="the station's smoothed code and its multipath, 1 sigma [m]")
    residual_tau_s: float = Field(120.0, gt=0, description="its correlation time [s]; multipath at a fixed antenna")
    declared_m: float = Field(0.3, gt=0, description="1 sigma that the station declares [m]; UDRE of RTCM 10402.3")
    interval_s: float = Field(1.0, gt=0, description="time between messages [s]; by mobile network")
    latency_s: float = Field(0.5, ge=0, description="delay of a message [s]")
    delivery: Literal["geo", "link", "both"] = Field("link", description="link: mobile network")
    baseline_km: float = Field(30.0, ge=0, description="distance to the station [km]")
    iono_ppm: float = Field(1.0, ge=0, description="change of the vertical ionosphere with distance, 1 sigma [mm/km]")
    tropo_ppm: float = Field(0.4, ge=0, description="change of the zenith troposphere with distance, 1 sigma [mm/km]")
    orbit_ppm: float = Field(0.05, ge=0, description="change of the orbit error with distance [mm/km]; 1 m over range")


class NetworkRtkConfig(Config):
    """What remains of the differential atmosphere at a virtual station: its errors are interpolated in the network."""

    iono_mm: float = Field(
        2.5, ge=0, description="vertical ionosphere, 1 sigma [mm]; chosen: stations 50 km apart on a quiet day"
    )
    tropo_mm: float = Field(3.0, ge=0, description="zenith troposphere, 1 sigma [mm]; the same, chosen")
    orbit_mm: float = Field(0.5, ge=0, description="orbit error, 1 sigma [mm]; a tenth of 1 m over 50 km of baseline")


class AugmentationConfig(Config):
    """Providers of corrections, GEO satellites, and what a receiver holds when it is switched on."""

    providers: tuple[Literal["dgps", "sbas_l1", "sbas_dfmc", "ppp"], ...] = Field(
        (), description="providers that are simulated; a navigator adds those of its services"
    )
    dgps: DgpsConfig = DgpsConfig()
    sbas_l1: SbasConfig = SbasConfig()
    sbas_dfmc: MessageConfig = Field(MessageConfig(), description="satellite corrections for L1/L5, GPS and Galileo")
    ppp: MessageConfig = Field(
        MessageConfig(
            residual_m=0.03, residual_tau_s=1800.0, declared_m=0.05, interval_s=5.0, latency_s=2.0, delivery="link"
        ),
        description="precise orbits and clocks; 2 to 5 cm, real-time products of the IGS",
    )
    network: NetworkRtkConfig = Field(NetworkRtkConfig(), description="virtual stations of network RTK")
    geo_longitude_deg: tuple[float, ...] = Field(
        (127.0, 137.0),
        min_length=1,
        description="GEO satellites [deg East]; MSAS by QZS-3 at 127, and one at 137, which is chosen",
    )
    geo_reacquire_s: float = Field(
        3.0, ge=0, description="from the end of an obstruction to a whole message [s]; 1 s of data, lock, frame: chosen"
    )
    warm: bool = Field(True, description="the receiver was on before: it holds the newest messages at the start")


@dataclass
class AugmentationAreas:
    """Providers over A areas.

    residual (A, S, P) and ionosphere (A, S) Gauss-Markov processes of unit variance, of each satellite; troposphere
    (A,) of the zenith at the station. Messages measured and sent, the last axis: satellite (A, S, P, 2), what is wrong
    of its correction [m]; zenith (A, S, P, 2) and tropo (A, P, 2) [m]. measured, sent (A, P, 2 kinds): epoch of the
    area at which their content was measured; fresh (A, P, 2): sent in this epoch; phase (A, P, 2): epochs by which
    messages come earlier than at multiples of their interval.
    """

    residual: Array
    ionosphere: Array
    troposphere: Array
    satellite: Array
    zenith: Array
    tropo: Array
    measured: Ints
    sent: Ints
    fresh: Bools
    phase: Ints

    def copy(self) -> AugmentationAreas:
        """An independent copy."""
        return copy.deepcopy(self)


@dataclass
class AugmentationHeld:
    """Messages that B vehicles hold: satellite (what is wrong of it) and zenith (B, S, P), tropo (B, P) [m], epoch
    (B, P, 2) of the area at which they were measured, NEVER without one; geo_s (B, G) time since each GEO satellite is
    in view."""

    satellite: Array
    zenith: Array
    tropo: Array
    epoch: Ints
    geo_s: Array

    def copy(self) -> AugmentationHeld:
        """An independent copy."""
        return copy.deepcopy(self)


@dataclass(frozen=True)
class Corrections:
    """What a vehicle holds of one provider in an epoch.

    satellite_m (B, S) to be subtracted from code and phase of every band; zenith_m (B, S) vertical ionosphere on the
    first band; declared_m (S,) 1 sigma of a satellite that the provider declares, inf for satellites that it does not
    correct; zenith_declared_m the same of zenith_m, 0 where declared_m holds it; has_zenith: the ionosphere is
    corrected, in zenith_m or, DGPS, within satellite_m; age_s, zenith_age_s (B,) since they were measured, inf
    without a message.
    """

    satellite_m: Array
    zenith_m: Array
    declared_m: Array
    zenith_declared_m: float
    has_zenith: bool
    age_s: Array
    zenith_age_s: Array


def initial_providers(config: AugmentationConfig, satellites: int, dt_s: float, streams: Streams) -> AugmentationAreas:
    """Stationary residuals; messages are found at any time of their interval, and hold nothing before the first epoch.

    Stream "augmentation" of the areas.
    """
    areas, count = streams.batch, len(PROVIDERS)
    own = streams.normal("augmentation", satellites, count + 1)
    common = streams.uniform("augmentation", count * 2 + 1)
    period, _ = _periods(config, dt_s)
    phase = np.floor(common[:, :-1].reshape(areas, count, 2) * period).astype(np.int64)
    return AugmentationAreas(
        residual=own[..., :count].copy(),
        ionosphere=own[..., count].copy(),
        troposphere=streams.normal("augmentation"),
        satellite=np.zeros((areas, satellites, count, 2)),
        zenith=np.zeros((areas, satellites, count, 2)),
        tropo=np.zeros((areas, count, 2)),
        measured=np.full((areas, count, 2), NEVER, np.int64),
        sent=np.full((areas, count, 2), NEVER, np.int64),
        fresh=np.zeros((areas, count, 2), np.bool_),
        phase=phase,
    )


def advance_providers(
    config: AugmentationConfig,
    broadcast: tuple[BroadcastConfig, BroadcastState],
    areas: AugmentationAreas,
    own_epoch: Ints,
    dt_s: float,
    streams: Streams,
) -> None:
    """Advance residuals by an epoch, measure and send what is due, in place; after the errors of the broadcast.

    own_epoch (A,) epochs of each area's own clock. The first epoch of an area measures and sends everything.
    """
    satellites, count = areas.residual.shape[1:]
    own, common = streams.normal("augmentation", satellites, count + 1), streams.normal("augmentation")
    tau = _taus(config)
    for k, values in enumerate((areas.residual, areas.ionosphere[..., None], areas.troposphere[:, None, None])):
        z = (own[..., :count], own[..., count:], common[:, None, None])[k]
        values *= np.exp(-dt_s / tau[k])
        values += np.sqrt(-np.expm1(-2.0 * dt_s / tau[k])) * z
    period, latency = _periods(config, dt_s)
    since = (own_epoch[:, None, None] + areas.phase) % period
    first = areas.sent[:, :, SATELLITE] == NEVER
    for kind in (SATELLITE, IONOSPHERE):
        due = (since[..., kind] == 0) | first
        if due.any():
            _measure(config, broadcast, areas, kind, due)
            areas.measured[..., kind] = np.where(due, own_epoch[:, None], areas.measured[..., kind])
        fresh = ((since[..., kind] == latency[:, kind]) & (areas.measured[..., kind] != NEVER)) | first
        areas.fresh[..., kind] = fresh
        if fresh.any():
            part = (areas.satellite, areas.zenith)[kind]
            part[..., 1] = np.where(fresh[:, None, :], part[..., 0], part[..., 1])
            areas.sent[..., kind] = np.where(fresh, areas.measured[..., kind], areas.sent[..., kind])
            if kind == SATELLITE:
                areas.tropo[..., 1] = np.where(fresh, areas.tropo[..., 0], areas.tropo[..., 1])
    _send_station(areas)


def _send_station(areas: AugmentationAreas) -> None:
    """A station sends satellite, ionosphere and troposphere in one message."""
    fresh = areas.fresh[:, DGPS, SATELLITE]
    areas.fresh[:, DGPS, IONOSPHERE] = fresh
    areas.sent[:, DGPS, IONOSPHERE] = areas.sent[:, DGPS, SATELLITE]
    areas.zenith[:, :, DGPS, 1] = np.where(fresh[:, None], areas.zenith[:, :, DGPS, 0], areas.zenith[:, :, DGPS, 1])


def _measure(
    config: AugmentationConfig,
    broadcast: tuple[BroadcastConfig, BroadcastState],
    areas: AugmentationAreas,
    kind: int,
    due: Bools,
) -> None:
    """Write what providers find of the errors of an epoch, where a measurement of this kind is due (A, P)."""
    errors, state = broadcast
    zenith = errors.zenith_delays(state)  # (A, S)
    if kind == SATELLITE:
        found = areas.residual * _residuals(config)
        areas.satellite[..., 0] = np.where(due[:, None, :], found, areas.satellite[..., 0])
        d = config.dgps
        apart = 1e-3 * d.baseline_km * d.iono_ppm * areas.ionosphere
        here = due[:, None, DGPS]
        areas.zenith[:, :, DGPS, 0] = np.where(here, zenith + apart, areas.zenith[:, :, DGPS, 0])
        tropo = errors.tropo_zenith_m * state.common[:, 1] + 1e-3 * d.baseline_km * d.tropo_ppm * areas.troposphere
        areas.tropo[:, DGPS, 0] = np.where(due[:, DGPS], tropo, areas.tropo[:, DGPS, 0])
    else:
        grid = zenith + config.sbas_l1.iono_residual_m * areas.ionosphere
        areas.zenith[:, :, SBAS_L1, 0] = np.where(due[:, None, SBAS_L1], grid, areas.zenith[:, :, SBAS_L1, 0])


def initial_held(config: AugmentationConfig, satellites: int, batch: int) -> AugmentationHeld:
    """Vehicles that hold no message yet; where ``warm`` they take what their area sends first."""
    count = len(PROVIDERS)
    return AugmentationHeld(
        satellite=np.zeros((batch, satellites, count)),
        zenith=np.zeros((batch, satellites, count)),
        tropo=np.zeros((batch, count)),
        epoch=np.full((batch, count, 2), NEVER, np.int64),
        geo_s=np.full((batch, len(config.geo_longitude_deg)), config.geo_reacquire_s if config.warm else 0.0),
    )


def receive_messages(
    config: AugmentationConfig,
    areas: AugmentationAreas,
    held: AugmentationHeld,
    in_view: Bools,
    up: Bools,
    dt_s: float,
) -> None:
    """Vehicles take the messages of this epoch that they receive, in place.

    in_view (B, G): GEO satellites in view; up (B,): the mobile network carries messages
    """
    held.geo_s[:] = np.where(in_view, held.geo_s + dt_s, 0.0)
    geo = (held.geo_s > config.geo_reacquire_s - 0.5 * dt_s).any(-1)
    ways = {"geo": geo, "link": up, "both": geo | up}
    hears = np.stack([ways[getattr(config, name).delivery] for name in PROVIDERS], -1)  # (B, P)
    row = np.arange(hears.shape[0]) % areas.sent.shape[0]
    fresh = areas.fresh[row] & hears[..., None]
    if config.warm:
        fresh |= (held.epoch == NEVER) & (areas.sent[row] != NEVER)
    if not fresh.any():
        return
    satellite, zenith = fresh[:, None, :, SATELLITE], fresh[:, None, :, IONOSPHERE]
    held.satellite[:] = np.where(satellite, areas.satellite[row, ..., 1], held.satellite)
    held.zenith[:] = np.where(zenith, areas.zenith[row, ..., 1], held.zenith)
    held.tropo[:] = np.where(fresh[..., SATELLITE], areas.tropo[row, ..., 1], held.tropo)
    held.epoch[:] = np.where(fresh, areas.sent[row], held.epoch)


def corrections_of(
    config: AugmentationConfig, provider: str, held: AugmentationHeld, own_epoch: Ints, sky: tuple[Array, Ints],
    satellite: tuple[Array, Array], dt_s: float,
) -> Corrections:  # fmt: skip
    """What vehicles hold of a provider.

    own_epoch (A,) of their areas; sky: sine of elevations (B, S) and system (S,); satellite (A, S) each: errors of the
    broadcast now [m], and how fast corrections of each satellite age [m/s]
    """
    sine, system = sky
    p, declared = PROVIDERS.index(provider), getattr(config, provider)
    row = np.arange(sine.shape[0]) % own_epoch.shape[0]
    age = np.where(held.epoch[:, p] == NEVER, NEVER_S, dt_s * (own_epoch[row, None] - held.epoch[:, p]))
    since = np.where(np.isfinite(age[:, SATELLITE]), age[:, SATELLITE], 0.0)[:, None]
    corrected, zenith = satellite[0][row] + held.satellite[:, :, p] - since * satellite[1][row], held.zenith[:, :, p]
    if p == DGPS:
        corrected = corrected + obliquity(sine) * zenith + mapping(sine) * held.tropo[:, DGPS, None]
        zenith = np.zeros_like(zenith)
    return Corrections(
        satellite_m=np.ascontiguousarray(corrected),
        zenith_m=np.ascontiguousarray(zenith),
        declared_m=np.where(declared.corrected(system), declared.declared_m, np.inf),
        zenith_declared_m=declared.iono_declared_m if isinstance(declared, SbasConfig) else 0.0,
        has_zenith=p in (DGPS, SBAS_L1),
        age_s=age[:, SATELLITE],
        zenith_age_s=age[:, IONOSPHERE],
    )


@lru_cache(maxsize=64)
def _among(names: tuple[str, ...], system: bytes) -> Bools:
    """Which of these systems (S,) are among the named ones; never written."""
    return np.isin(np.frombuffer(system, np.int64), [int(System[name]) for name in names])


@lru_cache(maxsize=16)
def _periods(config: AugmentationConfig, dt_s: float) -> tuple[Ints, Ints]:
    """Epochs between messages, and from their measurement to their end, (P, 2 kinds)."""
    period, latency = np.ones((2, len(PROVIDERS), 2), np.int64)
    for p, name in enumerate(PROVIDERS):
        c = getattr(config, name)
        period[p, SATELLITE] = max(round(c.interval_s / dt_s), 1)
        latency[p, SATELLITE] = min(round(c.latency_s / dt_s), period[p, SATELLITE] - 1)
        grid = c.iono_interval_s if isinstance(c, SbasConfig) else c.interval_s
        period[p, IONOSPHERE] = max(round(grid / dt_s), 1)
        latency[p, IONOSPHERE] = min(round(c.latency_s / dt_s), period[p, IONOSPHERE] - 1)
    return period, latency


@lru_cache(maxsize=16)
def _residuals(config: AugmentationConfig) -> Array:
    """1 sigma of each provider's residual (P,); that of DGPS with the orbit error over its distance."""
    d = config.dgps
    out = np.array([getattr(config, name).residual_m for name in PROVIDERS])
    out[DGPS] = np.hypot(out[DGPS], 1e-3 * d.baseline_km * d.orbit_ppm)
    return out


@lru_cache(maxsize=16)
def _taus(config: AugmentationConfig) -> tuple[Array, float, float]:
    """Correlation times of residuals (P,), of the ionosphere's and of the troposphere's."""
    return (
        np.array([getattr(config, name).residual_tau_s for name in PROVIDERS]),
        config.sbas_l1.iono_residual_tau_s,
        1800.0,
    )
