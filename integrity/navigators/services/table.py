"""Table of the positioning services of S2 Table 1.

A configuration names the services in their order of preference, ``service: [rtk, sbas_dfmc, spp]``. Each epoch takes
the first one that has a position with a level below that of the position reckoned on; in between, Doppler and dead
reckoning go on. A service is a record: its mode, the provider of its corrections, and how it combines the bands.
"""

from __future__ import annotations

from dataclasses import dataclass

from lanebound.integrity.positioning.modes import Mode

__all__ = ["SERVICES", "Service"]


@dataclass(frozen=True)
class Service:
    """A positioning service.

    Attributes
    ----------
    name, mode, about : in configurations; the code of its positions; what it uses
    provider : of its corrections, a name of :data:`~lanebound.integrity.sensors.augmentation.PROVIDERS`; None: none
    bands : bands that it needs
    combined : ranges are free of the ionosphere
    fixes : integers of carriers against a reference, real or virtual
    """

    name: str
    mode: Mode
    about: str
    provider: str | None = None
    bands: int = 1
    combined: bool = False
    fixes: bool = False


SERVICES = {
    service.name: service
    for service in (
        Service("rtk", Mode.RTK, "code and phase against one reference station, integers fixed", bands=1, fixes=True),
        Service("nrtk", Mode.NRTK, "the same against a virtual station of a network", bands=1, fixes=True),
        Service("ppp", Mode.PPP, "precise orbits and clocks, float ambiguities", "ppp", bands=2, combined=True),
        Service("sbas_dfmc", Mode.SBAS_DFMC, "SBAS corrections, ionosphere-free codes", "sbas_dfmc", 2, combined=True),
        Service("sbas_l1", Mode.SBAS_L1, "SBAS corrections and ionospheric grid, L1 codes", "sbas_l1"),
        Service("dgps", Mode.DGPS, "corrections of one station, L1 codes", "dgps"),
        Service("spp", Mode.SPP, "broadcast ephemerides and models, L1 codes"),
    )
}
