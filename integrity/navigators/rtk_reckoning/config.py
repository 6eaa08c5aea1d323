"""Configuration of the kind ``rtk_reckoning``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.exclusion import FdeConfig, Search
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.extra_stages import ExtraStages, stages_named
from lanebound.integrity.navigators.rtk_reckoning.modes import PositioningMode, mode_named
from lanebound.integrity.navigators.services.config import ServicesConfig
from lanebound.integrity.navigators.services.rules import require_fitting_services
from lanebound.integrity.navigators.services.table import service_named
from lanebound.integrity.sensors.gnss import GnssConfig

__all__ = ["RtkReckoningConfig"]

UNTOLD_SIGMA_M = 10.0  # larger than that of any service


class RtkReckoningConfig(NavigatorConfig):
    """RTK, bridged by Doppler and by dead reckoning with odometer and gyro (S1 figure 1); the default kind."""

    kind: Literal["rtk_reckoning"] = Field("rtk_reckoning", description="kind of the navigator")
    modes: tuple[str, ...] = Field(
        ("doppler", "imu_odometer"), description="positioning modes between RTK positions, in order of preference"
    )
    stages: tuple[str, ...] = Field((), description="plug-in stages, in addition to those of the package")
    service: tuple[str, ...] = Field(
        ("rtk",),
        min_length=1,
        description="positioning services, in order of preference; S2 Table 1",
    )
    services: ServicesConfig = Field(ServicesConfig(), description="what is declared of services other than RTK")

    @model_validator(mode="before")
    @classmethod
    def _stages_were_monitors(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "monitors" in data:
            raise ConfigError(f"monitors must be named stages, got {data['monitors']!r}: write stages in its place")
        return data

    @field_validator("service", mode="before")
    @classmethod
    def _one_service_is_a_list(cls, value: Any) -> Any:
        if isinstance(value, list | tuple):
            return value
        if not isinstance(value, str):
            raise ConfigError(f"service must be a name or a list of names, got {value!r}: write spp, or [rtk, spp]")
        return (value,)

    @model_validator(mode="after")
    def _services_fit(self) -> Self:
        require_fitting_services(self)
        return self

    @model_validator(mode="after")
    def _modes_and_stages_are_known(self) -> Self:
        for what, names in (("modes", self.modes), ("stages", self.stages)):
            if len(set(names)) < len(names):
                raise ConfigError(f"{what} must name each one once, got {list(names)}: remove the repeated one")
        _ = self.chosen_modes, self.extra_stages
        return self

    @property
    def told_sigma_m(self) -> float:
        """As that of any navigator; without RTK so large that any service is better.

        Dead reckoning from a position known to centimetres is better than code services for minutes.
        """
        fixes = any(service_named(name).fixes for name in self.service)
        return super().told_sigma_m if fixes else UNTOLD_SIGMA_M

    @cached_property
    def receiver(self) -> GnssConfig:
        """``gnss``, with the undifferenced observables and the providers that the services need.

        Against a virtual station of a network the differential errors are those of its interpolation.
        """
        chosen, gnss = [service_named(name) for name in self.service], self.gnss
        if any(service.name == "nrtk" for service in chosen):
            left = gnss.augmentation.network
            gnss = gnss.replace(
                baseline_km=1.0, iono_ppm=left.iono_mm, tropo_ppm=left.tropo_mm, orbit_ppm=left.orbit_mm
            )
        if all(service.fixes for service in chosen):
            return gnss
        needed = [service.provider for service in chosen if service.provider is not None]
        providers = list(dict.fromkeys([*gnss.augmentation.providers, *needed]))
        return gnss.replace(undifferenced=True, augmentation={"providers": providers})

    @property
    def chosen_modes(self) -> list[PositioningMode]:
        """The records of ``modes``."""
        return [mode_named(name) for name in self.modes]

    @property
    def extra_stages(self) -> list[ExtraStages]:
        """The records of ``stages``."""
        return [stages_named(name) for name in self.stages]

    @property
    def tests(self) -> FdeConfig:
        """The fault tests: ``fde``, which ``risk.direction_test`` lets search in the direction of maximum error."""
        return self.fde.replace(search=Search.DIRECTION) if self.risk.direction_test else self.fde
