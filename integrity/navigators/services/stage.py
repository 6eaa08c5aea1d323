"""The stages of the services that a configuration names, and what they read in an epoch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.navigators.rtk_reckoning import parameters as figures
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.rtk_reckoning.stages import Point, SeparateStage
from lanebound.integrity.navigators.services.code_kernel import fill_code_ranges
from lanebound.integrity.navigators.services.config import CodeServiceConfig
from lanebound.integrity.navigators.services.coupling import (
    LASTING,
    PROPOSED,
    BeginCouplingStage,
    LengthenStage,
    SettleStage,
    coupling_parameters,
    coupling_rules,
    initial_coupling,
    proposals,
    with_rules,
)
from lanebound.integrity.navigators.services.fix_kernel import LEAST_ROWS, check_ranges, find_fix
from lanebound.integrity.navigators.services.label_kernel import begin_services, begin_without_rtk, label_services
from lanebound.integrity.navigators.services.loose_kernel import couple_fix
from lanebound.integrity.navigators.services.records_kernel import (
    PART,
    SERVICE_INPUT,
    SERVICE_LABEL,
    SERVICE_RULES,
    SERVICE_SATELLITE,
    SERVICE_SIGNAL,
    SERVICE_WORK,
    ServiceInputs,
    ServiceRows,
    ServiceState,
    ServiceTables,
)
from lanebound.integrity.navigators.services.table import Service, declared_of, service_named
from lanebound.integrity.navigators.services.zenith_kernel import CARRIER_RULES, ZENITH, CarrierTables
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.smoothing_kernel import HATCH
from lanebound.integrity.sky.systems import WAVELENGTH_M, System

if TYPE_CHECKING:
    from lanebound.integrity.navigators.navigator import Measurements
    from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig

__all__ = ["BeginStage", "FixStage", "LabelStage", "ServiceSet", "band_shares", "service_tables"]

Array = NDArray[np.float64]

INPUTS, RANGES = "inputs of services", "ranges of services"  # names of what the stages share
ZENITH_TAU_S = 1800.0  # of the troposphere, Joerger and Pervan 2016
LABELS = "service of the position"
RECENT = 1.5  # intervals of a service for which its position, moved by Doppler, still counts as its own


def band_shares(wavelength_m: Array, combined: bool) -> Array:
    """Shares of two bands in a range, (systems, 2) from wavelengths (systems, 2): the first, or ionosphere-free.

    ``a_1 = f_1^2 / (f_1^2 - f_2^2)`` and ``a_2 = 1 - a_1``: the delay ``(f_1 / f)^2`` of the bands cancels.
    """
    share = np.zeros(wavelength_m.shape)
    share[:, 0] = 1.0
    if combined:
        ratio = (wavelength_m[:, 1] / wavelength_m[:, 0]) ** 2
        share[:, 0] = ratio / (ratio - 1.0)
        share[:, 1] = -1.0 / (ratio - 1.0)
    return share


def service_tables(config: RtkReckoningConfig, service: Service, system: NDArray[np.int64]) -> ServiceTables:
    """The parameters of a code service for satellites of these systems (S,)."""
    declared = declared_of(config, service)
    share_of_risk = risk_share(config, declared)
    own = config.replace(
        risk={
            "integrity_risk": share_of_risk * config.risk.integrity_risk,
            "unmonitored_risk": share_of_risk * config.risk.unmonitored_risk,
            "constellation_prior": declared.constellation_prior,
            "spend_unsolvable": True,
        },
        more_levels=[
            case.replace(integrity_risk=share_of_risk * case.integrity_risk).to_dict() for case in config.more_levels
        ],
        positioning={"rtk": {"reflections": declared.reflections.to_dict(), "reference_bias_m": 0.0}},
    )
    wavelength = np.ones((len(WAVELENGTH_M), 2))
    bands = list(config.gnss.bands)
    wavelength[:, : len(bands)] = WAVELENGTH_M[:, bands]
    share = band_shares(wavelength, service.combined)[system]
    return ServiceTables(
        rules=service_rules(declared, service, config),
        parameters=figures.epoch_parameters(own),
        tables=figures.epoch_tables(own, system),
        satellites=_satellites(share, np.isin(system, [int(System[name]) for name in declared.systems])),
        later=np.array([int(service_named(name).mode) for name in _after(service, config)], dtype=np.int64),
    )


def _satellites(share: Array, allowed: NDArray[np.bool_]) -> Records:
    """SERVICE_SATELLITE (S,) of the shares of the bands (S, 2), and which satellites may be used (S,)."""
    out = np.zeros(len(share), SERVICE_SATELLITE)
    out["share"], out["noise"], out["allowed"] = share, np.sqrt((share**2).sum(-1)), allowed
    return out


def _after(service: Service, config: RtkReckoningConfig) -> tuple[str, ...]:
    """Names of the services that a configuration prefers less than this one."""
    names = [service_named(name).name for name in config.service]
    return tuple(config.service[names.index(service.name) + 1 :]) if service.name in names else ()


def risk_share(config: RtkReckoningConfig, declared: CodeServiceConfig) -> float:
    """Share of the risk for one fix: as declared, or ``1 / (1 + n)`` with n code services.

    The position of an epoch is chosen among that reckoned on and one of each service, by the lowest level. The bound of
    Bonferroni over these candidates holds whatever the choice depends on; exclusions make levels depend on errors.
    """
    if declared.risk_share is not None:
        return declared.risk_share
    return 1.0 / (1.0 + sum(not service_named(name).fixes for name in config.service))


def service_rules(declared: CodeServiceConfig, service: Service, config: RtkReckoningConfig) -> Records:
    """SERVICE_RULES (1,) of a service's declared figures."""
    d, errors, tight = declared, declared.errors, config.services.coupling.kind == "tight"
    if service.provider is not None:
        errors = errors.replace(satellite_m=0.0, iono_zenith_m=0.0)
    return one_record(
        SERVICE_RULES,
        mode=int(service.mode),
        combined=service.combined,
        least=2 if tight else LEAST_ROWS,
        interval=d.interval_s,
        smoothing=d.smoothing_s / config.dt_s,
        sin_mask=np.sin(np.deg2rad(d.elevation_mask_deg)),
        cn0_min=d.cn0_min_dbhz,
        max_hdop=d.max_hdop,
        preference=config.services.preference,
        errors=errors.rules()[0],
        bias=d.code_bias_m,
        max_age=d.max_age_s,
        zenith_max_age=d.zenith_max_age_s,
    )


def carrier_rules(declared: CodeServiceConfig) -> Records:
    """CARRIER_RULES (1,) of a service's declared figures."""
    d = declared
    return one_record(
        CARRIER_RULES,
        zenith=d.zenith_state,
        zenith_sigma=d.errors.tropo_zenith_m,
        zenith_tau=ZENITH_TAU_S,
        lasting=max(2.0 * d.errors.multipath_tau_s / max(d.interval_s, 1e-3), 1.0),
    )


@dataclass(frozen=True)
class BeginStage(SeparateStage):
    """No service has offered a position yet; without RTK among them there is no RTK position either."""

    with_rtk: bool

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        (begin_services if self.with_rtk else begin_without_rtk)(first, last, epoch, states[LABELS])


@dataclass(frozen=True)
class FixStage(SeparateStage):
    """The position of one service."""

    name: str
    tables: ServiceTables
    carrier: Records
    coupling: tuple[Records, Records] | None = None

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        state = ServiceState(states[f"hatch {self.name}"], states[f"since {self.name}"])
        ranges: ServiceRows = states[RANGES]
        carrier = CarrierTables(self.carrier, states[f"zenith {self.name}"])
        inputs: ServiceInputs = states[INPUTS][self.name]
        fill_code_ranges(first, last, epoch, self.tables, inputs, state, ranges, carrier)
        check_ranges(first, last, epoch, self.tables, ranges, carrier)
        if self.coupling is None:
            find_fix(first, last, epoch, self.tables, inputs, ranges)
        else:
            coupling = with_rules(states, *self.coupling)
            couple_fix(first, last, epoch, self.tables, inputs, ranges, coupling)


@dataclass(frozen=True)
class LabelStage(SeparateStage):
    """The mode of the service that the position came from."""

    network: bool
    recent_s: float

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        label_services(first, last, epoch, states[LABELS], self.network, self.recent_s)


class ServiceSet:
    """The services of a navigator, without RTK from one station.

    Parameters
    ----------
    config : of the navigator
    system : (S,) system of each satellite
    """

    def __init__(self, config: RtkReckoningConfig, system: NDArray[np.int64]) -> None:
        chosen = [service_named(name) for name in config.service]
        self._coded = [service for service in chosen if not service.fixes]
        self._satellites = len(system)
        self._barometer = config.services.barometer
        self._declared = {s.name: declared_of(config, s) for s in self._coded}
        self.with_rtk = any(service.fixes for service in chosen)
        self._network = any(service.name == "nrtk" for service in chosen)
        self._cases, self._dt = len(config.cases), config.dt_s
        self._coupling = config.services.coupling if self._coded and config.services.coupling.kind != "none" else None
        self._tables = {service.name: service_tables(config, service, system) for service in self._coded}
        if self._coupling is not None:
            for name, t in self._tables.items():
                rules = coupling_rules(self._coupling, self._declared[name], self._dt)
                self._tables[name] = t._replace(parameters=coupling_parameters(t.parameters, t.tables.cases, rules))

    @property
    def active(self) -> bool:
        """Whether there is a service other than RTK from one station."""
        return bool(self._coded) or self._network

    @property
    def stages(self) -> dict[Point, list[SeparateStage]]:
        """The stages of the services, by the point of the epoch where they run; positions in order of preference."""
        if not self.active:
            return {}
        recent = RECENT * max((declared.interval_s for declared in self._declared.values()), default=0.0)
        fixes: list[SeparateStage] = [
            FixStage(s.name, self._tables[s.name], carrier_rules(self._declared[s.name]), self._rules_of(s.name))
            for s in self._coded
        ]
        found: dict[Point, list[SeparateStage]] = {
            Point.MEASURED: [BeginStage(self.with_rtk)],
            Point.OFFERED: fixes,
            Point.REPORTED: [LabelStage(self._network, recent)],
        }
        if self._coupling:
            found[Point.MEASURED].append(BeginCouplingStage())
            found[Point.MOVED], found[Point.TAKEN] = [LengthenStage()], [SettleStage()]
        return found

    def forget(self, states: Mapping[str, Any], rows: NDArray[np.int64] | slice) -> None:
        """Vehicles that are placed anew hold no code errors."""
        if self._coupling:
            states[LASTING]["active"][rows] = False

    def _rules_of(self, name: str) -> tuple[Records, Records] | None:
        if self._coupling is None:
            return None
        return coupling_rules(self._coupling, self._declared[name], self._dt), self._tables[name].parameters

    def initial(self, batch: int) -> dict[str, NDArray[Any]]:
        """What lasts of the services, by name."""
        if not self.active:
            return {}
        out: dict[str, NDArray[Any]] = {LABELS: np.zeros(batch, SERVICE_LABEL)}
        for service in self._coded:
            out[f"hatch {service.name}"] = np.zeros((batch, self._satellites), HATCH)
            out[f"since {service.name}"] = np.full(batch, np.inf)
            out[f"zenith {service.name}"] = np.zeros(batch, ZENITH)
        return out | (initial_coupling(batch, self._cases) if self._coupling else {})

    def with_inputs(self, m: Measurements, states: Mapping[str, Any]) -> Mapping[str, Any]:
        """The states, and what the services measure and hold in this epoch."""
        if not self.active:
            return states
        inputs = {service.name: self._inputs(service, m) for service in self._coded}
        shared: dict[str, Any] = {INPUTS: inputs, RANGES: self._ranges(states[LABELS])}
        if self._coupling:
            first = self._coded[0].name
            rules, modes = self._rules_of(first), self._tables[first].tables.prior.size
            assert rules is not None
            shared[PROPOSED] = proposals(*rules, states, modes)
        return {**states, **shared}

    def _ranges(self, labels: Records) -> ServiceRows:
        shape = labels.size, self._satellites
        work = np.zeros(labels.size, SERVICE_WORK)
        work["least"] = np.inf
        return ServiceRows(np.zeros(shape, ROW), np.zeros(shape, PART), work, labels)

    def _inputs(self, service: Service, m: Measurements) -> ServiceInputs:
        g = m.gnss
        assert g.raw_code_m is not None, "gnss.undifferenced is on wherever a service needs it"
        assert g.raw_phase_m is not None
        signals, vehicles = np.zeros(g.tracked.shape, SERVICE_SIGNAL), np.zeros(len(g.tracked), SERVICE_INPUT)
        signals["code"], signals["phase"] = g.raw_code_m, g.raw_phase_m
        vehicles["height"], vehicles["height_variance"] = self._height(m)
        if service.provider is None:
            signals["declared"] = self._declared[service.name].errors.satellite_m
            return ServiceInputs(signals, vehicles)
        assert g.corrections is not None, "its provider is simulated"
        held = g.corrections[service.provider]
        signals["satellite"], signals["zenith"] = held.satellite_m, held.zenith_m
        signals["declared"], vehicles["zenith_declared"] = held.declared_m, held.zenith_declared_m
        vehicles["age"], vehicles["zenith_age"] = held.age_s, held.zenith_age_s if held.has_zenith else 0.0
        return ServiceInputs(signals, vehicles)

    def _height(self, m: Measurements) -> tuple[Array, Array]:
        """Height by the barometer and its variance (B,); an infinite variance without one."""
        if m.barometer is None:
            return np.zeros(m.gnss.tracked.shape[0]), np.full(m.gnss.tracked.shape[0], np.inf)
        return m.barometer.height_m, self._barometer.variance_m2(m.time_s, m.odometer.speed_mps)
