"""Table of the positioning services: those of S2 Table 1, and those that users register.

A configuration names the services in their order of preference, ``service: [rtk, sbas_dfmc, spp]``. Each epoch takes
the first one whose level is at most ``services.preference`` times that of those after it, if it is lower than that of
the position reckoned on; in between, Doppler and dead reckoning go on. A service is a record: its mode, the provider of
its corrections, and how it combines the bands.
:func:`register_service` adds one from outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import find
from lanebound.integrity.core.presets import require_new, require_registered
from lanebound.integrity.navigators.services.config import CodeServiceConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.augmentation import PROVIDERS

if TYPE_CHECKING:
    from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig

__all__ = ["SERVICES", "Service", "declared_of", "register_service", "service_named", "withdraw_service"]


@dataclass(frozen=True)
class Service:
    """A positioning service.

    Attributes
    ----------
    name, mode, about : in configurations; the code of its positions; what it uses
    provider : of its corrections, a name of :data:`~lanebound.integrity.sensors.augmentation.PROVIDERS`; None: none
    second : bands that may be its second one, next to L1 (1: L2, 2: L5); empty: it needs none
    combined : ranges are free of the ionosphere
    fixes : integers of carriers against a reference, real or virtual
    declared : its declared figures, where ``services`` of a configuration has none
    """

    name: str
    mode: Mode
    about: str
    provider: str | None = None
    second: tuple[int, ...] = ()
    combined: bool = False
    fixes: bool = False
    declared: CodeServiceConfig | None = None


L2, L5 = 1, 2
SERVICES = {
    service.name: service
    for service in (
        Service("rtk", Mode.RTK, "code and phase against one reference station, integers fixed", fixes=True),
        Service("nrtk", Mode.NRTK, "the same against a virtual station of a network", fixes=True),
        Service("ppp", Mode.PPP, "precise orbits and clocks, float ambiguities", "ppp", (L2, L5), combined=True),
        Service(
            "sbas_dfmc", Mode.SBAS_DFMC, "SBAS corrections, ionosphere-free codes", "sbas_dfmc", (L5,), combined=True
        ),
        Service("sbas_l1", Mode.SBAS_L1, "SBAS corrections and ionospheric grid, L1 codes", "sbas_l1"),
        Service("dgps", Mode.DGPS, "corrections of one station, L1 codes", "dgps"),
        Service("spp", Mode.SPP, "broadcast ephemerides and models, L1 codes"),
    )
}
BUILT_IN = tuple(SERVICES)


def service_named(name: str) -> Service:
    """A service of the table, or ConfigError. ``package.module:name`` imports the module first."""
    return find(name, SERVICES, "service")


def declared_of(config: RtkReckoningConfig, service: Service) -> CodeServiceConfig:
    """The declared figures of a service that positions by codes."""
    if service.declared is not None:
        return service.declared
    found: CodeServiceConfig = getattr(config.services, service.name)
    return found


def register_service(
    name: str,
    label: str,
    about: str,
    declared: CodeServiceConfig,
    provider: str | None = None,
    second: tuple[int, ...] = (),
    combined: bool = False,
) -> Mode:
    """Add a service that positions by codes, which configurations may then name; returns the mode of its positions.

    Parameters
    ----------
    name : in configurations and in observation entries, for instance ``galileo``
    label : in tables and figures
    about, provider, second, combined : as of :class:`Service`
    declared : its declared errors, priors and limits

    Raises
    ------
    InputError
        The name is taken, there is no such provider, or ranges without ionosphere have no second band.
    """
    require_new("a service", name, SERVICES)
    if provider is not None and provider not in PROVIDERS:
        raise InputError(f"provider must be among {', '.join(PROVIDERS)} or None, got {provider!r}: correct it")
    if combined and not second:
        raise InputError("second must name a band where combined is set, got none: add 1 (L2) or 2 (L5)")
    mode = Mode.register(name, label, serves=True)
    SERVICES[name] = Service(name, mode, about, provider, second, combined, declared=declared)
    return mode


def withdraw_service(name: str) -> None:
    """Remove the service that was registered last.

    Raises
    ------
    InputError
        There is none of this name, it is a service of the package, or another mode was registered after it.
    """
    if name in BUILT_IN:
        raise InputError(f"a service of the package cannot be removed, got {name!r}: remove registered services alone")
    require_registered("service", name, [service for service in SERVICES if service not in BUILT_IN])
    Mode.withdraw(SERVICES[name].mode)
    del SERVICES[name]
