"""Positioning services side by side under open, half-open and urban skies, beside what S2 and S4 print.

S2 section 6: in the open, lane identification and collision alert could be done about 80 % of the time with SBAS DFMC
and nearly always with PPP; in the city hardly ever. S2 states no accuracy for them; here an application is possible
while the horizontal error is at most 1.5 m, the alert limit of S2 section 8, and ``bounded`` while both protection
levels are. S4 section III-A: a low-cost GPS receiver in the open without and with EGNOS, and how long EGNOS is
available on a mixed circuit and in the city, by its satellites alone and with SISNeT. The mixed circuit is here the
mean over the skies, of which the city of S4 is ``dense``. EGNOS is available while its corrections are not older than
their time-outs, and there is a position from satellites in the line of sight: S4 counts travelled time with corrected
positions. S4's receiver has one channel for EGNOS (NovAtel MiLLennium command
descriptions OM-20000053, section 2.3.1: 10 GPS and 1 WAAS channels).

The drives are too short for PPP to converge: each begins with ``ppp_approach_s`` of driving under an open sky. How PPP
converges has a scenario of its own: vehicles at rest in the open for 30 minutes, at hours spread over a day.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.agents.assess.street_drives import StreetDrivesConfig
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.reproduce.service_drives import (
    HOURS,
    NO_DOP,
    ServiceStreet,
    converge,
    drive_service_street,
    streets_of,
)
from lanebound.agents.reproduce.service_tables import NO_LEVEL_M
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode

__all__ = [
    "CASES",
    "ServiceStudyConfig",
    "run_services",
    "work_street",
]

PACKAGES = ("lanebound.integrity", "lanebound.envs.sky", "lanebound.agents.assess", "lanebound.agents.reproduce")
NEEDED_M = 1.5  # of the applications, S2 section 8
MURCIA = {"lat_deg": 38.0, "lon_deg": -1.13, "height_m": 50.0, "galileo": 0, "glonass": 0, "beidou": 0, "qzss": 0}
LOW_COST = {
    "gnss": {
        "code_sigma_m": 1.0,
        "code_multipath_m": 1.0,
        "augmentation": {"geo_longitude_deg": [-15.5]},  # PRN 120 of EGNOS, one channel
    },
    "sky": MURCIA,
    "services": {
        "spp": {"systems": ["GPS"], "errors": {"reflections_m": 2.0}, "constellation_prior": [0.0] * 5},
        "sbas_l1": {"errors": {"reflections_m": 2.0}},
    },
}
"""The GPS receiver of S4, of some metres of code error, in Murcia."""

CASES: dict[str, tuple[str, Mapping[str, Any]]] = {
    "spp": ("services/spp", {}),
    "dgps": ("services/dgps", {}),
    "sbas_l1": ("services/sbas_l1", {}),
    "sisnet": ("services/sisnet", {}),
    "sbas_dfmc": ("services/sbas_dfmc", {}),
    "ppp": ("services/ppp", {}),
    "rtk": ("navigators/consumer", {}),
    "nrtk": ("services/nrtk", {}),
    "s4_gps": ("services/spp", LOW_COST),
    "s4_egnos": ("services/sbas_l1", LOW_COST),
    "s4_sisnet": ("services/sisnet", LOW_COST),
}
"""Preset of each case and what differs from it."""


class ServiceStudyConfig(Config):
    """Which services, skies and drives."""

    seeds: int = Field(100, ge=1, le=10_000, description="streets of each sky; a part is one under all skies")
    cases: tuple[str, ...] = Field(tuple(CASES), min_length=1, description="services and receivers")
    skies: tuple[str, ...] = Field(
        ("open", "suburban", "urban", "dense"), min_length=1, description="presets of the sky"
    )
    vehicles: int = Field(4, ge=1, le=256, description="vehicles in a street, each in an hour of its street")
    duration_s: float = Field(60.0, gt=0, description="length of a drive after the warm-up [s]")
    warm_up_s: float = Field(20.0, ge=0, description="time before the first epoch that counts [s]")
    ppp_approach_s: float = Field(
        300.0, ge=0, le=3600, description="drive under an open sky before a street, in which PPP converges [s]"
    )
    ppp_hours: int = Field(8, ge=0, le=HOURS, description="hours of the day at which PPP converges; 0: not at all")
    ppp_minutes: int = Field(30, ge=1, le=120, description="time at rest of PPP [min]; S2 Table 1: up to 30")
    geo_reacquire_s: float = Field(
        3.0, ge=0, description="from the end of an obstruction to the next message of a GEO [s]; S4 prints none"
    )
    street_m: float = Field(
        2000.0, ge=500, le=20_000, description="length of a street [m]; vehicles begin all along it"
    )
    first_seed: int = Field(401, ge=0, description="of the drives; nothing was fitted there")

    @model_validator(mode="after")
    def _cases_and_skies_are_known(self) -> ServiceStudyConfig:
        unknown = [case for case in self.cases if case not in CASES]
        if unknown:
            raise ConfigError(f"cases must be among {', '.join(CASES)}, got {unknown[0]!r}: correct the name")
        for sky in self.skies:
            SkyLevel.named(sky)
        return self

    def drives(self) -> StreetDrivesConfig:
        """The streets and their vehicles, with any navigator."""
        return StreetDrivesConfig(
            skies=self.skies,
            faults=None,
            vehicles=self.vehicles,
            duration_s=self.duration_s,
            warm_up_s=self.warm_up_s,
            length_m=self.street_m,
            seed=self.first_seed,
        )


def run_services(
    config: ServiceStudyConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing streets, and write ``services.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    ResultFolder(out, "services study", config.to_dict(), code_digest(*PACKAGES)).claim()
    names = [str(number) for number in range(config.seeds)]
    names += [f"ppp-{hour * HOURS // config.ppp_hours}" for hour in range(config.ppp_hours)]
    parts = run_parts(out, names, partial(work_street, config), jobs, on_progress)
    result: dict[str, Any] = {"config": config.to_dict(), "skies": {}}
    alone = [part for name, part in parts.items() if name.startswith("ppp-")]
    if alone:
        result["ppp"] = _convergence(alone)
    streets = [part for name, part in parts.items() if not name.startswith("ppp-")]
    for sky in config.skies:
        result["skies"][sky] = {case: _medians([part[sky][case] for part in streets]) for case in config.cases}
    write_json(out / "services.json", result)
    return result


def work_street(config: ServiceStudyConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """One street under each sky with each service in turn, or PPP at one hour; it does not depend on others."""
    if name.startswith("ppp-"):
        hour = int(name.removeprefix("ppp-"))
        return converge(config.first_seed, hour, config.vehicles, config.ppp_minutes, advance=advance)
    found: dict[str, Any] = {sky: {} for sky in config.skies}
    drives = len(config.skies) * len(config.cases)
    for k, street in enumerate(streets_of(config.drives(), int(name))):
        for n, case in enumerate(config.cases):
            found[street.sky][case] = _drive(config, street, case)
            advance((k * len(config.cases) + n + 1) / drives)
    return found


def _drive(config: ServiceStudyConfig, street: ServiceStreet, case: str) -> dict[str, float]:
    """Figures of a drive: errors and levels [m], and shares of the epochs."""
    preset, changes = CASES[case]
    navigator = NavigatorConfig.preset(preset).replace(**changes)
    drives = config.drives().replace(
        navigator=navigator.replace(gnss={"augmentation": {"geo_reacquire_s": config.geo_reacquire_s}})
    )
    rows = [
        np.column_stack(
            [
                np.hypot(*moment.error_m.T),
                np.abs(moment.error_m),
                np.minimum(np.stack([moment.solution.pl_at_m, moment.solution.pl_ct_m], -1), NO_LEVEL_M),
                moment.solution.mode,
                moment.hdop,
                moment.corrected,
                moment.hdop_direct,
            ]
        )
        for moment in drive_service_street(drives, street, config.ppp_approach_s if case == "ppp" else 0.0)
    ]
    return _figures(np.concatenate(rows), _mode_of(case))


def _mode_of(case: str) -> Mode:
    """The mode of the service that a case is about."""
    service = {"s4_gps": "spp", "s4_egnos": "sbas_l1", "s4_sisnet": "sbas_l1", "sisnet": "sbas_l1"}.get(case, case)
    return Mode.named(service)


def _figures(rows: NDArray[np.float64], mode: Mode) -> dict[str, float]:
    """Statistics of epochs (N, 9): horizontal error, errors and levels along and across, mode, HDOP, corrected, HDOP of
    the line of sight. Epochs without a position have no error; they are not accurate. HDOP is NaN where it is not
    sampled."""
    sampled = rows[np.isfinite(rows[:, 6])]
    error, both, levels, modes, hdop = rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5], sampled[:, 6]
    own, located = modes == int(mode), modes != int(Mode.NONE)
    return {
        "cep_m": float(np.median(error[located])) if located.any() else NO_LEVEL_M,
        "hpe95_m": float(np.quantile(error[located], 0.95)) if located.any() else NO_LEVEL_M,
        "own_cep_m": float(np.median(error[own])) if own.any() else NO_LEVEL_M,
        "own_hpe95_m": float(np.quantile(error[own], 0.95)) if own.any() else NO_LEVEL_M,
        "pl_at_m": float(np.median(levels[:, 0])),
        "pl_ct_m": float(np.median(levels[:, 1])),
        "service": float(own.mean()),
        "accurate": float((located & (error <= NEEDED_M)).mean()),
        "bounded": float((levels <= NEEDED_M).all(-1).mean()),
        "beyond": float((both > levels).any(-1).mean()),
        "hdop_below_3": float((hdop < 3.0).mean()),
        "direct_below_3": float((sampled[:, 8] < 3.0).mean()),
        "corrected": float(rows[:, 7].mean()),
        "available": float(((sampled[:, 7] > 0.0) & (sampled[:, 8] < NO_DOP)).mean()),
    }


def _medians(parts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Medians over streets; of shares the mean, as a median of few zeros and ones hides them."""
    shares = (
        "service", "accurate", "bounded", "beyond", "hdop_below_3", "direct_below_3", "corrected", "available"
    )  # fmt: skip
    return {key: float((np.mean if key in shares else np.median)([part[key] for part in parts])) for key in parts[0]}


def _convergence(parts: Sequence[Mapping[str, list[float]]]) -> dict[str, list[float]]:
    """Over the hours: root mean square, largest error, median level, shares, by the minute."""
    table = {key: np.array([part[key] for part in parts]) for key in parts[0]}
    return {
        "rms_m": np.sqrt(np.mean(np.square(table["rms_m"]), 0)).tolist(),
        "largest_m": table["largest_m"].max(0).tolist(),
        "level_m": np.median(table["level_m"], 0).tolist(),
        "ppp": table["ppp"].mean(0).tolist(),
        "beyond": table["beyond"].mean(0).tolist(),
    }
