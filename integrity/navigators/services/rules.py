"""What a configuration must have for the services that it names; nothing is left out in silence.

A service on a band that the receiver does not track, on systems that its provider does not correct, or with messages
that come too seldom would give a worse position, or none, without a word.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.services.table import Service, declared_of, service_named
from lanebound.integrity.sensors.augmentation import MessageConfig

if TYPE_CHECKING:
    from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig

__all__ = ["require_fitting_services"]

LONGEST_COUPLED_S = 300.0
LARGEST_SHARE = 0.9
BAND_NAMES = ("L1", "L2", "L5")


def require_fitting_services(config: RtkReckoningConfig) -> None:
    """Refuse services that the rest of a configuration does not serve, and names that do not go together.

    Raises
    ------
    ConfigError
        With path, bound, value and remedy.
    """
    chosen = [service_named(name) for name in config.service]
    names = [service.name for service in chosen]
    if len(set(names)) < len(names) or {"rtk", "nrtk"} <= set(names):
        raise ConfigError(f"service must name each one once, and rtk or nrtk, got {names}: remove one of them")
    if any(service.fixes for service in chosen[1:]):
        raise ConfigError(f"service must name rtk or nrtk first, got {names}: their level is the lowest by far")
    for service in chosen:
        if service.name == "nrtk":
            _require_atmosphere(config)
        if service.fixes:
            continue
        _require_coupling(config, service)
        _require_bands(config, service)
        _require_systems(config, service)
        if service.provider is not None:
            _require_messages(config, service, getattr(config.gnss.augmentation, service.provider))


def _require_coupling(config: RtkReckoningConfig, service: Service) -> None:
    """Means over minutes are not averaged again, and noise keeps a share of the risk."""
    if config.services.coupling.kind == "none":
        return
    declared, path = declared_of(config, service), f"services.{service.name}"
    if declared.smoothing_s > LONGEST_COUPLED_S:
        raise ConfigError(
            f"{path}.smoothing_s must be <= {LONGEST_COUPLED_S:g} with services.coupling, got "
            f"{declared.smoothing_s:g}: its codes are means of minutes already; set services.coupling none"
        )
    if declared.risk_share is not None and not declared.risk_share <= LARGEST_SHARE:
        raise ConfigError(
            f"{path}.risk_share must be <= {LARGEST_SHARE} with services.coupling, got {declared.risk_share:g}: the "
            "rest of the risk is that of noise"
        )


def _require_bands(config: RtkReckoningConfig, service: Service) -> None:
    """L1 first, and the second band that the service needs."""
    bands = list(config.gnss.bands)
    remedy = f"set [0, {service.second[-1]}]" if service.second else "set [0, 1]"
    if bands[0] != 0:
        raise ConfigError(f"gnss.bands must begin with 0 (L1) for the service {service.name}, got {bands}: {remedy}")
    if service.second and not (len(bands) > 1 and bands[1] in service.second):
        wanted = " or ".join(f"{band} ({BAND_NAMES[band]})" for band in service.second)
        raise ConfigError(
            f"gnss.bands must have {wanted} as its second band for the service {service.name}, got {bands}: {remedy}, "
            f"or take the preset of the service"
        )


def _require_atmosphere(config: RtkReckoningConfig) -> None:
    """The float solution has what the network leaves of the atmosphere as states; else its integers contradict."""
    floats, left = config.positioning.rtk.float_solution, config.gnss.augmentation.network
    for key, mm in (("ionosphere_m", left.iono_mm), ("troposphere_m", left.tropo_mm)):
        if floats.kind != "sequential" or getattr(floats, key) < 1e-3 * mm:
            raise ConfigError(
                f"positioning.rtk.float_solution must be sequential with {key} >= {1e-3 * mm:g} for the service nrtk, "
                f"got {floats.kind} with {getattr(floats, key):g}: take the preset services/nrtk"
            )


def _require_systems(config: RtkReckoningConfig, service: Service) -> None:
    """Satellites of one system of the service at least are simulated."""
    systems = declared_of(config, service).systems
    if all(getattr(config.sky, name.lower()) == 0 for name in systems):
        raise ConfigError(
            f"sky must have satellites of {' or '.join(systems)} for the service {service.name}, got none: raise "
            f"sky.{systems[0].lower()}, or change services.{service.name}.systems"
        )


def _require_messages(config: RtkReckoningConfig, service: Service, sent: MessageConfig) -> None:
    """The provider corrects all systems of the service, and its messages come before the last one is too old."""
    declared, path = declared_of(config, service), f"services.{service.name}"
    missing = [name for name in declared.systems if name not in sent.systems]
    if missing:
        raise ConfigError(
            f"{path}.systems must be among those of gnss.augmentation.{service.provider}, {', '.join(sent.systems)}, "
            f"got {missing[0]!r}: remove it, or let the provider correct it"
        )
    if declared.max_age_s < sent.interval_s + sent.latency_s:
        raise ConfigError(
            f"{path}.max_age_s must be >= {sent.interval_s + sent.latency_s:g}, the interval and latency of the "
            f"messages, got {declared.max_age_s:g}: the service would end before each message"
        )
