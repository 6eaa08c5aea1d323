"""Positioning services side by side under open, half-open and urban skies, next to what S2 and S4 print.

HDOP is that of the satellites of the service that are tracked above its mask, with the clocks of its systems; and that
of those in the line of sight alone, which is closer to a receiver that loses weak signals. A service is ``corrected``
while the corrections that the vehicle holds are not older than their time-outs.

S2 section 6: in the open, lane identification and collision alert could be done about 80 % of the time with SBAS DFMC
and nearly always with PPP; in the city hardly ever. S2 states no accuracy for them; here an application is possible
while the horizontal error is at most 1.5 m, the alert limit of S2 section 8, and ``bounded`` while both protection
levels are. S4 section III-A: a low-cost GPS receiver in the open without and with EGNOS, and how long EGNOS is
available on a mixed circuit and in the city, by its satellites alone and with SISNeT. The mixed circuit is here the
mean over the skies, of which the city of S4 is ``dense``. EGNOS is available while its corrections are not older than
their time-outs, and there is a position from satellites in the line of sight: S4 counts travelled time with corrected
positions. S4's receiver has one channel for EGNOS (NovAtel MiLLennium command descriptions OM-20000053, section 2.3.1:
10 GPS and 1 WAAS channels).

The drives are too short for PPP to converge: each begins with ``ppp_approach_s`` of driving under an open sky. How PPP
converges has a scenario of its own: vehicles at rest in the open for 30 minutes, at hours spread over a day.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.street_drives import StreetDrivesConfig, drive_of, mask_of, navigator_of
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig, NavigatorState
from lanebound.integrity.navigators.services.table import declared_of, service_named
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

APPROACH_MPS, BRAKING_S = 10.0, 5.0
HOUR_S, WEEK_S = 3600, 604_800
HOURS = 24
NO_DOP = 1e3
DOP_EVERY_S = 1.0  # satellites hardly move in a second, and a car passes a few metres


class ServiceMoment(NamedTuple):
    """An epoch of B vehicles: error (B, 2) along and across the track [m], solution, HDOP (B,) of what is tracked and
    of what is in the line of sight, corrected (B,). HDOP is NaN but once a second."""

    error_m: Array
    solution: Solution
    hdop: Array
    hdop_direct: Array
    corrected: Bools


@dataclass(frozen=True)
class ServiceStreet:
    """A street that is built and driven once, for all services that drive there.

    Attributes
    ----------
    sky, number : preset of the sky, number of the street
    mask : what its buildings leave of the sky
    truths : true motion in each epoch, the same under every sky
    arrived : what vehicles know when they arrive from an open sky, by their configuration and the length of the way;
        shared by the skies of a number
    """

    sky: str
    number: int
    mask: SkyMask
    truths: list[Truth]
    arrived: dict[tuple[NavigatorConfig, float], NavigatorState]


def streets_of(config: StreetDrivesConfig, number: int) -> Iterator[ServiceStreet]:
    """Street ``number`` under each sky."""
    dt_s = config.navigator.dt_s
    truths = list(islice(drive_of(config, number, dt_s), round(config.span_s / dt_s)))
    arrived: dict[tuple[NavigatorConfig, float], NavigatorState] = {}
    for sky in config.skies:
        yield ServiceStreet(sky, number, mask_of(config, sky, number), truths, arrived)


def drive_service_street(
    config: StreetDrivesConfig, street: ServiceStreet, approach_s: float = 0.0
) -> Iterator[ServiceMoment]:
    """The epochs of a street after the warm-up, for the first service of the navigator.

    ``config`` is that of the street but for the navigator, which has the same epochs. ``approach_s``: length of a
    straight drive under an open sky before the street, in which PPP converges [s].
    """
    longer = config.replace(warm_up_s=config.warm_up_s + approach_s)
    navigator, truths = navigator_of(longer, street.sky, street.number, street.mask), street.truths
    if approach_s > 0.0:
        _arrive(navigator, longer, street, approach_s)
        truths = [replace(truth, time_s=truth.time_s + approach_s) for truth in truths]
    first, sampled = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, DOP_EVERY_S))
    missing = np.full(config.vehicles, np.nan)
    for k, truth in enumerate(truths):
        measured = navigator.measure(truth)
        solution = navigator.locate(measured)
        if k < first:
            continue
        error, every, ours = solution.position_en_m - truth.position_enu_m[:, :2], missing, missing
        turned = np.einsum("bij,bj->bi", track_from_enu_matrix(truth.heading_rad), error)
        if (k - first) % sampled == 0:
            direct = navigator.mask.look(truth.arc_m, truth.lane, measured.sky).path == SignalPath.LOS
            every, ours = (hdop(navigator.config, measured, among) for among in (np.ones_like(direct), direct))
        yield ServiceMoment(turned, solution, every, ours, corrected(navigator.config, measured))


def _arrive(navigator: Navigator, config: StreetDrivesConfig, street: ServiceStreet, approach_s: float) -> None:
    """Let the vehicles arrive where the drive begins, from an approach under an open sky with an unbroken link.

    The link that they find in the street is that of a vehicle that is switched on there.
    """
    fitted = SkyLevel.named(street.sky).navigator(config.navigator)  # with the instruments of the sky
    afield = config.replace(navigator=fitted.replace(corrections=config.navigator.corrections.to_dict()))
    key = afield.navigator, approach_s
    if key not in street.arrived:
        other = navigator_of(afield, "open", street.number, SkyMask.open())
        for truth in approach(street.truths[0], approach_s, other.config.dt_s):
            other.step(truth)
        street.arrived[key] = other.snapshot()
    network, links = navigator.state.area.network, navigator.state.corrections
    navigator.restore(street.arrived[key])
    state = navigator.state
    state.area.network = replace(network, epoch=state.area.network.epoch)
    state.corrections = links


def approach(start: Truth, length_s: float, dt_s: float) -> Iterator[Truth]:
    """A straight drive that ends with the pose and speed at which another one starts."""
    epochs, heading = round(length_s / dt_s), start.heading_rad
    forward = np.stack([np.sin(heading), np.cos(heading)], -1)
    final = np.einsum("bi,bi->b", start.velocity_enu_mps[:, :2], forward)
    left_s = dt_s * np.arange(epochs, -1, -1)  # until the end, (T + 1,)
    speed = final + (APPROACH_MPS - final) * np.minimum(left_s / BRAKING_S, 1.0)[:, None]
    way = np.concatenate([[np.zeros_like(final)], np.cumsum(0.5 * dt_s * (speed[1:] + speed[:-1]), axis=0)])
    place = start.position_enu_m[:, :2] - dt_s * start.velocity_enu_mps[:, :2] + (way - way[-1])[..., None] * forward
    velocity = speed[..., None] * forward
    for k in range(epochs):
        yield truth_between(
            dt_s * (k + 1), dt_s, (place[k], place[k + 1]), (velocity[k], velocity[k + 1]), (heading, heading),
            start.arc_m, start.lane,
        )  # fmt: skip


def hdop(config: Any, m: Measurements, among: Bools) -> Array:
    """HDOP of those satellites of the first service that are among some (B, S), (B,); NO_DOP where they are too few."""
    service = service_named(config.service[0])
    systems, mask_deg = tuple(System.__members__), config.positioning.rtk.elevation_mask_deg
    if not service.fixes:
        declared = declared_of(config, service)
        systems, mask_deg = declared.systems, declared.elevation_mask_deg
    numbers = [int(System[name]) for name in systems]
    los = m.sky.los_enu[m.sky.index]
    used = m.gnss.tracked & among & np.isin(m.sky.system, numbers) & (los[..., 2] > np.sin(np.deg2rad(mask_deg)))
    clocks = (m.sky.system[:, None] == np.array(numbers)).astype(np.float64)
    design = np.concatenate([-los, np.broadcast_to(clocks, (*los.shape[:2], len(numbers)))], -1) * used[..., None]
    normal = np.swapaxes(design, 1, 2) @ design
    absent = np.einsum("bii->bi", normal) == 0.0  # clocks of systems without a satellite
    absent[:, :3] = False  # without any satellite there is no HDOP
    normal = normal + np.where(absent[:, :, None], np.eye(normal.shape[1]), 0.0)
    out = np.full(len(used), NO_DOP)
    good = np.linalg.cond(normal) < 1e10
    if good.any():
        cofactor = np.linalg.inv(normal[good])
        out[good] = np.sqrt(cofactor[:, 0, 0] + cofactor[:, 1, 1])
    return out


def corrected(config: Any, m: Measurements) -> Bools:
    """Whether the first service has what it needs of its provider, (B,); True without a provider."""
    service = service_named(config.service[0])
    if service.provider is None or m.gnss.corrections is None:
        return np.isfinite(m.gnss.corrections_age_s) if service.fixes else np.ones(len(m.gnss.tracked), np.bool_)
    held, declared = m.gnss.corrections[service.provider], declared_of(config, service)
    in_time = held.age_s <= declared.max_age_s
    return in_time & (held.zenith_age_s <= declared.zenith_max_age_s) if held.has_zenith else in_time


def converge(
    seed: int, hour: int, vehicles: int, minutes: int, every_s: int = 60, advance: Advance = ignore
) -> dict[str, list[float]]:
    """PPP of vehicles that stand under an open sky, by the minute since they were switched on.

    Returns lists by ``every_s``: the error on an axis (rms) and the largest on both axes [m], the median level of the
    larger axis [m], the share of vehicles with a position of PPP, and of errors beyond a level.
    """
    base = NavigatorConfig.preset("services/ppp").replace(dt_s=1.0, service=["ppp"])
    config = base.replace(sky={"week_second_s": (base.sky.week_second_s + HOUR_S * hour) % WEEK_S})
    seeds = [int(s) for s in np.random.SeedSequence([seed, hour]).generate_state(vehicles)]
    epochs = 60 * minutes
    navigator = Navigator.nominal(config, seeds=seeds, duration_s=epochs + 60.0)
    zero, still = np.zeros((vehicles, 2)), np.zeros(vehicles)
    navigator.place(zero, still, 30.0, 0.01)
    out: dict[str, list[float]] = {key: [] for key in ("rms_m", "largest_m", "level_m", "ppp", "beyond")}
    recent = np.zeros(vehicles, np.bool_)
    for k in range(epochs):
        solution = navigator.step(truth_between(k + 1.0, 1.0, (zero, zero), (zero, zero), (still, still)))
        recent |= solution.mode == Mode.PPP
        if (k + 1) % every_s == 0:
            error, level = np.abs(solution.position_en_m), np.stack([solution.pl_ct_m, solution.pl_at_m], -1)
            out["rms_m"].append(float(np.sqrt(np.mean(np.square(error)))))
            out["largest_m"].append(float(error.max()))
            out["level_m"].append(float(np.median(level.max(-1))))
            out["ppp"].append(float(recent.mean()))
            out["beyond"].append(float((error > level).any(-1).mean()))
            recent[:] = False
        advance((k + 1) / epochs)
    return out


AVAILABLE = "EGNOS available"
NO_LEVEL_M = 1e4  # in place of a missing level or error

PUBLISHED = {
    "spp": "1 to 6 m (S2 Table 1)",
    "dgps": "sub-metre to a few metres (S2 Table 1)",
    "sbas_l1": "sub-metre to 1.5 m (S2 Table 1); to more than 2 m (S2 6)",
    "sisnet": "as sbas_l1 (S4 II-A)",
    "sbas_dfmc": "slightly better than L1; applications 80 % in the open (S2 6)",
    "ppp": "below 0.1 m after up to 30 min (S2 Table 1); applications nearly always in the open (S2 6)",
    "rtk": "few cm (S2 Table 1)",
    "nrtk": "few cm (S2 Table 1)",
    "s4_gps": "open: CEP 3.2 m, HPE95 8.1 m; HDOP < 3 about 80 % urban, 95 % highway (S4 III-A)",
    "s4_egnos": "open: CEP 1.9 m, HPE95 5.2 m; available 64.8 % mixed, 60 % city (S4 III-A)",
    "s4_sisnet": "available 89.2 % mixed (S4 Table IV)",
}


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables, as far as their cases were run."""
    yield "Services, medians over streets; shares are means", service_rows(result)
    yield "EGNOS by its satellites alone and with SISNeT", mixed_rows(result)
    if "ppp" in result:
        yield "PPP at rest in the open, by the time since it was switched on", convergence_rows(result)
    yield "The papers line by line", published_rows(result)


def service_rows(result: Mapping[str, Any]) -> Table:
    """Errors, levels and shares of each case under each sky, with what the papers print."""
    rows = []
    for case in result["config"]["cases"]:
        for sky, found in result["skies"].items():
            of = found[case]
            errors, own = (
                "-" if of[cep] >= NO_LEVEL_M else f"{_metres(of[cep])} / {_metres(of[hpe95])}"
                for cep, hpe95 in (("cep_m", "hpe95_m"), ("own_cep_m", "own_hpe95_m"))
            )
            levels = ["-" if of[key] >= NO_LEVEL_M else _metres(of[key]) for key in ("pl_at_m", "pl_ct_m")]
            shown = ("service", "corrected", "accurate", "bounded", "hdop_below_3", "direct_below_3")
            shares = [f"{100.0 * of[key]:.0f} %" for key in shown]
            beyond = f"{of['beyond']:.1e}" if of["beyond"] else "0"
            first = sky == next(iter(result["skies"]))
            rows.append((
                case if first else "", sky, errors, own, *levels, *shares, beyond,
                PUBLISHED[case] if first else "",
            ))  # fmt: skip
    heads = (
        "case", "sky", "CEP / HPE95 [m]", "of its mode [m]", "PL along", "PL across", "of its mode", "corrected",
        "error < 1.5 m", "levels < 1.5 m", "HDOP < 3", "of direct signals", "beyond", "published",
    )  # fmt: skip
    return heads, rows


def mixed_rows(result: Mapping[str, Any]) -> Table:
    """How long corrections and corrected positions are available on the mean of all skies, next to S4 Table IV."""
    printed = {"s4_egnos": "64.8 %", "s4_sisnet": "89.2 %"}
    rows: list[tuple[str, ...]] = []
    for case in (case for case in printed if case in result["config"]["cases"]):
        of = [sky[case] for sky in result["skies"].values()]
        shares = (f"{100.0 * np.mean([found[key] for found in of]):.1f} %" for key in ("corrected", "available"))
        rows.append((case, *shares, f"{100.0 * of[-1]['available']:.1f} %", printed[case]))
    last = result["config"]["skies"][-1]
    heads = ("case", "corrected, mean of skies", "and a position", f"the same, {last}", "S4, mixed circuit")
    return heads, rows


def convergence_rows(result: Mapping[str, Any]) -> Table:
    """Error and level of PPP by the time at rest; S2 Table 1: below 0.1 m after up to 30 min."""
    found, last = result["ppp"], result["config"]["ppp_minutes"]
    rows: list[tuple[str, ...]] = [
        (
            f"{minute}", *(_metres(found[key][minute - 1]) for key in ("rms_m", "largest_m", "level_m")),
            f"{100.0 * found['beyond'][minute - 1]:.1f} %",
        )
        for minute in sorted({1, 2, 5, 10, 15, 20, 30, last})
        if minute <= last
    ]  # fmt: skip
    return ("time [min]", "error on an axis, rms [m]", "largest [m]", "median level [m]", "beyond"), rows


def published_rows(result: Mapping[str, Any]) -> Table:
    """Each figure of S2 Table 1, S2 section 6 and S4 III-A next to that of this study, as far as its cases were run."""
    return ("figure", "sky", "published", "here"), [*_error_rows(result), *_share_rows(result)]


def _error_rows(result: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Errors, 50 % and 95 %, under the easiest and the hardest sky but ``dense``, and of PPP at rest."""
    printed = (
        ("spp", "1 to 6 m, S2"), ("dgps", "sub-metre to a few metres, S2"), ("sbas_l1", "sub-metre to 1.5 m, S2"),
        ("sbas_dfmc", "slightly better than L1, S2"), ("rtk", "few cm, S2"), ("nrtk", "few cm, S2"),
        ("s4_gps", "3.2 / 8.1 m, S4"), ("s4_egnos", "1.9 / 5.2 m, S4"),
    )  # fmt: skip
    for case, text in printed:
        for sky in ("open",) if case.startswith("s4") else ("open", "urban"):
            found = result["skies"].get(sky, {}).get(case)
            if found is not None:
                yield (
                    f"{case}, error 50 / 95 %",
                    sky,
                    text,
                    f"{_metres(found['cep_m'])} / {_metres(found['hpe95_m'])} m",
                )
    if "ppp" in result:
        rms = result["ppp"]["rms_m"]
        below = next((str(k + 1) for k, value in enumerate(rms) if value < 0.1), "never")
        text = f"{_metres(rms[-1])} m after {len(rms)} min, below 0.1 m after {below} min"
        yield "ppp at rest, error on an axis, rms", "open", "below 0.1 m after up to 30 min, S2", text


def _share_rows(result: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Shares of the time [%]: applications, HDOP and EGNOS."""
    printed = (
        ("sbas_dfmc", "accurate", "open", "about 80 %, S2"), ("sbas_dfmc", "accurate", "dense", "low, S2"),
        ("ppp", "accurate", "open", "nearly always, S2"), ("ppp", "accurate", "dense", "low, S2"),
        ("s4_gps", "direct_below_3", "open", "95 % on the highway, S4"),
        ("s4_gps", "direct_below_3", "urban", "about 80 % in the city, S4"),
        ("s4_egnos", "available", "dense", "about 60 % in the city, S4"),
    )  # fmt: skip
    names = {
        "accurate": "error < 1.5 m",
        "direct_below_3": "HDOP < 3 by direct signals",
        "available": "EGNOS available",
    }
    for case, key, sky, text in printed:
        found = result["skies"].get(sky, {}).get(case)
        if found is not None:
            yield f"{case}, {names[key]}", sky, text, f"{100.0 * found[key]:.1f} %"
    for case, _, available, _, text in mixed_rows(result)[1]:
        yield f"{case}, {AVAILABLE}", "mean of all", f"{text}, S4", available


def _metres(value: float) -> str:
    """A length with three significant digits, and no fewer than those before the point.

    >>> _metres(0.0412), _metres(0.5), _metres(15.83), _metres(1234.5)
    ('0.0412', '0.500', '15.8', '1234')
    """
    return f"{value:.0f}" if value >= 999.5 else f"{value:#.3g}".rstrip(".")


PACKAGES = ("lanebound.integrity", "lanebound.envs.sky", "lanebound.agents.studies")
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
    claim(out, "services study", config, PACKAGES)
    names = [str(number) for number in range(config.seeds)]
    names += [f"ppp-{hour * HOURS // config.ppp_hours}" for hour in range(config.ppp_hours)]
    parts = parts_of(config, work_street, names, out, jobs, on_progress)
    result: dict[str, Any] = {"config": config.to_dict(), "skies": {}}
    alone = [part for name, part in parts.items() if name.startswith("ppp-")]
    if alone:
        result["ppp"] = _convergence(alone)
    streets = [part for name, part in parts.items() if not name.startswith("ppp-")]
    for sky in config.skies:
        result["skies"][sky] = {case: _medians([part[sky][case] for part in streets]) for case in config.cases}
    return stored(result, out, "services.json")


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
