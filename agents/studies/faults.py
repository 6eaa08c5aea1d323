"""The fault campaign: how often kinds of faults of several sizes and lengths are noticed, and how often they mislead.

Vehicles drive a loop of city streets under an open sky. Each vehicle drives twice with the same noise: with a fault,
and without it. A fault of a satellite strikes another satellite for each vehicle. The declaration of a kind
(:class:`~lanebound.integrity.sensors.fault_kinds.FaultKind`) states its sizes, whether it is tried in a blackout of all
satellite signals, and whether it changes what the vehicle broadcasts: then the belief of the receivers counts.

The campaign also compares the power of detection and exclusion with theory, by the size of a bias
(:mod:`.fault_response`).
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydantic import field_validator
from scipy.stats import chi2

from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.bounding import rate_of, rate_over
from lanebound.agents.studies.fault_response import (
    Response,
    Run,
    as_broadcast,
    detectability,
    drive_run,
    measure_response,
)
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.fault_kinds import FaultKind, FaultTarget, Profile
from lanebound.integrity.sensors.fault_registry import BUILT_IN, KindName, fault_kind, fault_kinds, register_fault
from lanebound.integrity.sensors.faults import Fault
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.track import SkyTrack


def fault_rows(result: Mapping[str, Any]) -> Table:
    """One row for each fault: vehicles of all, but for the rate of HMI, which is of epochs."""
    columns = (
        "fault", "noticed", "after [s]", "once over", "excluded", "slipped", "alerted", "error > AL", "late alerts",
        "misled", "HMI", "HMI rate", "largest [m]", "lost at end",
    )  # fmt: skip
    return columns, [_fault_row(cell) for cell in result["faults"]]


def _fault_row(cell: Mapping[str, Any]) -> tuple[str, ...]:
    unit, of = cell["unit"], cell["vehicles"]
    size = f" {cell['size']:g} {unit}" if unit else ""
    after = cell["noticed_median_s"]
    profile = cell["profile"]
    if profile == "ramp":
        profile += f" of {cell['size'] / cell['ramp_s']:g} {unit}/s for {cell['ramp_s']:g} s"
    return (
        f"{cell['kind'].replace('_', ' ')}{size}, {profile}, {cell['duration_s']:g} s",
        f"{cell['noticed']['events']}/{of}",
        "-" if after is None else f"{after:.1f}",
        f"{cell['noticed_after']}/{of}",
        f"{cell['excluded']}/{of}",
        f"{cell['given_up']}/{of}",
        f"{cell['alerted']}/{of}",
        f"{cell['failed']}/{of}",
        f"{cell['failed_without_timely_alert']['events']}/{of}",
        f"{cell['misled_vehicles']['events']}/{of}",
        f"{cell['hazardous_vehicles']['events']}/{of}",
        f"{cell['hazardous']['rate']:.2g}",
        f"{cell['worst_m']:.2f}",
        f"{cell['lost']}/{of}",
    )


def consistency_rows(result: Mapping[str, Any]) -> Table:
    """Normalised squared errors by mode (their mean is 2 for a covariance that is exact), and how tight levels are."""
    rows = []
    for mode, found in result["control"]["modes"].items():
        if found is not None:
            tight = found["level_over_least_bound"]
            shown = (f"{tight[axis]:.2f}" if tight[axis] is not None else "-" for axis in ("along", "across"))
            rows.append(
                (mode, f"{found['epochs']:,}", f"{found['mean_nees']:.2f}", f"{found['beyond_95']:.3f}", *shown)
            )
    return ("mode", "epochs", "mean NEES", "beyond 95 %", "PL/least AT", "PL/least CT"), rows


def theory_rows(result: Mapping[str, Any]) -> Table:
    """The power of detection by the size of a bias, in minimal detectable ones, next to theory."""
    columns = ("satellites", "bias/MDB", "theory", "own test", "noticed", "excluded rightly", "epochs")
    rows = []
    for found in result["theory"]:
        for row in found["by_factor"]:
            shares = (f"{row[key]['rate']:.4f}" for key in ("own", "noticed", "right"))
            epochs = f"{row['noticed']['trials']:,}"
            rows.append((str(found["satellites"]), f"{row['factor']:g}", f"{row['theory']:.4f}", *shares, epochs))
    return columns, rows


def control_lines(result: Mapping[str, Any]) -> list[str]:
    """False alarms against their allocation, alerts and misleading epochs without faults."""
    control = result["control"]

    def share(name: str) -> str:
        found = control[name]
        return f"{found['rate']:.3g} of {found['trials']:,} epochs (correlated)"

    allocated = f"{control['allocated_false_alarm']:g} a test"
    return [
        f"Satellites excluded without a fault: {share('excluded')}; allocated {allocated}.",
        f"Alerts without a fault: {share('alerts')}. Error beyond its level: {share('misleading')}.",
    ]


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """The responses to all faults, the drive without faults, and theory."""
    noticed = "Faults: vehicles that noticed while it lasted, or once it was over"
    yield f"{noticed}, and what it did to them from its onset on", fault_rows(result)
    yield "Without faults: consistency of the position by mode", consistency_rows(result)
    yield "A bias of one satellite against theory; without one what is noticed is false", theory_rows(result)
    yield from control_lines(result)


PACKAGES = ("lanebound.integrity", "lanebound.agents.studies")
THEORY = "theory-"  # begins the names of parts that compare with theory
BLACKOUT_DB = 60.0
BLACKOUT_BEFORE_S = 1.0
LOWEST_RAD = np.deg2rad(25.0)  # a receiver tracks satellites above it under an open sky
SYSTEMS = (System.GPS, System.GALILEO)  # that faults of a system strike, in turn
SPREAD_S = 5.0


def _tried() -> tuple[str, ...]:
    """Kinds that the campaign tries."""
    return tuple(kind.name for kind in fault_kinds() if not kind.not_tried_because)


class FaultsConfig(Config):
    """How many vehicles meet each fault, and for how long.

    Raises
    ------
    ConfigError
        A kind is unknown, or declares why the campaign omits it.
    """

    vehicles: int = Field(64, ge=1, description="vehicles, and seeds, that meet each fault")
    first_seed: int = Field(1, ge=0, description="seed of the first")
    warm_up_s: float = Field(40.0, ge=10, description="before the fault; positions are fixed by then")
    after_s: float = Field(75.0, gt=0, description="after the fault; longer than RTK may be kept in quarantine")
    durations_s: tuple[float, ...] = Field((2.0, 20.0), min_length=1, description="lengths of faults")
    kinds: tuple[KindName, ...] = Field(
        default_factory=_tried, min_length=1, description="kinds of faults; by default all registered ones"
    )
    control_s: float = Field(600.0, gt=60, description="length of the drive without faults")
    theory_satellites: tuple[int, ...] = Field((7, 12), description="sizes of geometries that are put next to theory")
    theory_draws: int = Field(4000, ge=40, description="of each size and each bias, four times as many without one")
    navigator: NavigatorConfig = NavigatorConfig()

    @field_validator("kinds")
    @classmethod
    def _are_tried(cls, kinds: tuple[str, ...]) -> tuple[str, ...]:
        for kind in map(fault_kind, kinds):
            if kind.not_tried_because:
                raise ValueError(f"kinds must be tried in the campaign, got {kind.name!r}: {kind.not_tried_because}")
        return kinds


@dataclass(frozen=True)
class FaultCase:
    """One fault of the campaign."""

    kind: str
    size: float
    duration_s: float
    profile: Profile
    more: tuple[tuple[str, float], ...] = ()

    @property
    def declaration(self) -> FaultKind:
        """The declaration of its kind."""
        return fault_kind(self.kind)

    @property
    def name(self) -> str:
        """Name of its part."""
        return "-".join(
            [
                f"{self.kind}-{self.size:g}-{self.duration_s:g}s-{self.profile}",
                *(f"{field}={value:g}" for field, value in self.more),
            ]
        )

    @property
    def ramp_s(self) -> float:
        """Time in which a ramp reaches its size, which it has for the rest of the fault [s]."""
        return 0.5 * self.duration_s


def cells_of(config: FaultsConfig) -> list[FaultCase]:
    """Every kind x size x further fields x length x profile; a kind without a magnitude has the size 0."""
    return [
        FaultCase(kind.name, size, duration, profile, tuple(more.items()))
        for kind in map(fault_kind, config.kinds)
        for size in kind.sizes_tried or (0.0,)
        for more in kind.tried_with
        for duration in config.durations_s
        for profile in kind.profiles
    ]


def assess_faults(config: FaultsConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Drive the missing parts, and write ``results.json`` and the figures; returns the results.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files; or worker processes
        cannot import the effect function of a registered kind.
    """
    from lanebound.integrity.assessment.plotting import save

    registered = tuple(fault_kind(name) for name in config.kinds if name not in BUILT_IN)
    if jobs > 1:
        _require_importable(registered)
    ResultFolder(out, "fault campaign", config.to_dict(), _source(registered)).claim()
    cells = {cell.name: cell for cell in cells_of(config)}
    theory = [f"{THEORY}{satellites}" for satellites in config.theory_satellites]
    parts = run_parts(out, [*cells, "control", *theory], partial(work_part, config, registered), jobs, on_progress)
    faults, powers = [parts[name] for name in cells], [parts[name] for name in theory]
    result = {"config": config.to_dict(), "control": parts["control"], "theory": powers, "faults": faults}
    save(faults_figure(faults), out / "faults.svg")
    if powers:
        save(detectability_figure(powers), out / "detectability.svg")
    return stored(result, out)


def _require_importable(kinds: Sequence[FaultKind]) -> None:
    for kind in kinds:
        try:
            pickle.dumps(kind)
        except Exception as error:
            raise InputError(
                f"jobs must be 1 for fault kind {kind.name!r}, because worker processes cannot import it ({error}): "
                "define its effect function at the top level of a module"
            ) from None


def _source(kinds: Sequence[FaultKind]) -> str:
    """Digest of the code that the results follow from: the package's, and the files of registered kinds."""
    found = hashlib.blake2b(code_digest(*PACKAGES).encode(), digest_size=8)
    for kind in kinds:
        file = Path(getattr(getattr(kind.apply, "__code__", None), "co_filename", ""))
        found.update(f"{kind.name}{kind.sizes_tried}".encode() + (file.read_bytes() if file.is_file() else b""))
    return found.hexdigest()


def work_part(
    config: FaultsConfig, registered: Sequence[FaultKind], name: str, advance: Advance = ignore
) -> dict[str, Any]:
    """One cell, the drive without faults, or a comparison with theory; a worker process registers kinds first."""
    for kind in registered:
        register_fault(kind)
    if name == "control":
        return control(config)
    if name.startswith(THEORY):
        satellites = int(name.removeprefix(THEORY))
        return detectability(config.navigator.fde, satellites, config.theory_draws, config.first_seed)
    return work_cell(config, next(cell for cell in cells_of(config) if cell.name == name))


def _seeds(config: FaultsConfig) -> list[int]:
    return list(range(config.first_seed, config.first_seed + config.vehicles))


def _onsets(config: FaultsConfig) -> np.ndarray:
    """Onsets of the faults, spread over some seconds, at ends of epochs.  (B,) [s]."""
    steps = np.round(np.linspace(0.0, SPREAD_S, config.vehicles) / config.navigator.dt_s)
    return np.asarray(config.warm_up_s + steps * config.navigator.dt_s)


def work_cell(config: FaultsConfig, cell: FaultCase) -> dict[str, Any]:
    """Drive with and without the fault and sum up the response."""
    kind, onset = cell.declaration, _onsets(config)
    duration = config.warm_up_s + SPREAD_S + cell.duration_s + config.after_s
    dark = _blackouts(onset, cell.duration_s) if kind.in_blackout else []
    sound, faults = _sound(config.to_json(), duration, cell.duration_s if dark else None), _maker(cell, onset, dark)
    if kind.broadcast:
        track = SkyTrack.from_config(config.navigator.sky, duration)
        faulty = as_broadcast(sound, config.navigator, faults(track))
    else:
        faulty = drive_run(config.navigator, _seeds(config), duration, faults)
    limits = config.navigator.alert.limits
    found = measure_response(faulty, sound, onset, cell.duration_s, (limits.al_at_m, limits.al_ct_m))
    place = asdict(cell) | {
        "more": dict(cell.more),
        "unit": kind.unit,
        "ramp_s": cell.ramp_s,
        "in_blackout": bool(dark),
    }
    return place | _summed(found, config.navigator.alert.time_to_alert_s)


@lru_cache(maxsize=4)
def _sound(text: str, duration_s: float, dark_s: float | None) -> Run:
    """The drive without the fault, in a blackout of ``dark_s`` or in none: the same for many faults."""
    config = FaultsConfig.from_json(text)
    dark = [] if dark_s is None else _blackouts(_onsets(config), dark_s)
    return drive_run(config.navigator, _seeds(config), duration_s, dark)


def _maker(cell: FaultCase, onset: np.ndarray, dark: Sequence[Fault]) -> Callable[[SkyTrack], list[Fault]]:
    """The faults of all vehicles, once the sky is known."""

    def faults(track: SkyTrack) -> list[Fault]:
        sky = track.at(track.start_s + float(onset[0]), np.zeros(len(onset), dtype=np.int64))
        high = np.flatnonzero(sky.elevation_rad[0] > LOWEST_RAD)
        return [*dark, *(_fault(cell, row, float(t), sky, high) for row, t in enumerate(onset))]

    return faults


def _fault(cell: FaultCase, row: int, onset_s: float, sky: Any, high: np.ndarray) -> Fault:
    """The fault of one vehicle: satellites, systems and directions change from vehicle to vehicle."""
    kind = cell.declaration
    data: dict[str, Any] = {
        "kind": kind.name, "start_s": onset_s, "duration_s": cell.duration_s, "profile": cell.profile,
        "ramp_s": cell.ramp_s, "vehicle": row, "azimuth_deg": 67.0 * row % 360.0, **dict(cell.more),
    }  # fmt: skip
    if kind.magnitude is not None:
        data[kind.magnitude.field] = cell.size
    if kind.target is FaultTarget.SATELLITE:
        satellite = high[row % len(high)]
        data |= {"system": System(int(sky.system[satellite])), "prn": int(sky.prn[satellite])}
    if kind.target is FaultTarget.SYSTEM:
        data["system"] = SYSTEMS[row % len(SYSTEMS)]
    return Fault.load(data)


def _blackouts(onset: np.ndarray, duration_s: float) -> list[Fault]:
    """Jamming of all signals from just before the fault until its end."""
    return [
        Fault.load(
            {
                "kind": "jamming",
                "start_s": float(t) - BLACKOUT_BEFORE_S,
                "vehicle": row,
                "duration_s": duration_s + BLACKOUT_BEFORE_S,
                "magnitude_db": BLACKOUT_DB,
            }
        )
        for row, t in enumerate(onset)
    ]


def _summed(found: Response, time_to_alert_s: float) -> dict[str, Any]:
    """Plain figures of a cell; intervals are of vehicles, because the epochs of one vehicle are correlated."""
    noticed, of = np.isfinite(found.noticed_s), len(found.noticed_s)

    def vehicles(which: np.ndarray) -> dict[str, Any]:
        return rate_of(int(which.sum()), of)

    return {
        "vehicles": of,
        "noticed": vehicles(noticed),
        "noticed_median_s": float(np.median(found.noticed_s[noticed])) if noticed.any() else None,
        "noticed_after": int(found.noticed_after.sum()),
        "excluded": int(found.excluded.sum()),
        "given_up": int(found.given_up.sum()),
        "alerted": int(found.alerted.sum()),
        "failed": int(found.failed.sum()),
        "failed_without_timely_alert": vehicles(found.late_s > time_to_alert_s),
        "longest_late_s": float(found.late_s.max()),
        "hazardous": rate_over(found.hazardous.astype(float), found.epochs.astype(float)),
        "hazardous_vehicles": vehicles(found.hazardous > 0),
        "misleading": rate_over(found.misleading.astype(float), found.epochs.astype(float)),
        "misled_vehicles": vehicles(found.misleading > 0),
        "worst_m": float(found.worst_m.max()),
        "lost": int(found.lost.sum()),
    }


def control(config: FaultsConfig) -> dict[str, Any]:
    """The drive without faults: false alarms, bounding, consistency and how tight the levels are."""
    run = drive_run(config.navigator, _seeds(config), config.warm_up_s + config.control_s)
    begun = run.time_s > config.warm_up_s
    return {
        "allocated_false_alarm": config.navigator.fde.alpha,
        "excluded": rate_of(int((run.excluded[begun] > 0).sum()), int(run.excluded[begun].size)),
        "alerts": rate_of(int(run.alert[begun].sum()), int(run.alert[begun].size)),
        "misleading": rate_of(
            int(((np.abs(run.error_m) > run.level_m).any(-1) & run.available)[begun].sum()),
            int(run.available[begun].size),
        ),
        "modes": {mode.key: _consistency(run, (run.mode == mode) & begun[:, None]) for mode in Mode},
    }


def _consistency(run: Run, here: np.ndarray) -> dict[str, Any] | None:
    """Normalised squared errors (two degrees of freedom) and level over the smallest bound of all errors."""
    if not here.any():
        return None
    squared, size, level = run.squared[here], np.abs(run.error_m)[here], run.level_m[here]
    return {
        "epochs": int(here.sum()),
        "mean_nees": float(squared.mean()),
        "beyond_95": float((squared > chi2.isf(0.05, 2)).mean()),
        "level_over_least_bound": {
            axis: float(np.median(level[:, a]) / size[:, a].max()) for a, axis in enumerate(("along", "across"))
        },
    }


COLUMNS = 4
SHOWN = {"noticed": "noticed while it lasts", "misled_vehicles": "error above its level"}


def faults_figure(cells: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of vehicles by size of the fault, all lengths together: steps drawn through, ramps dashed."""
    kinds = list(dict.fromkeys(cell["kind"] for cell in cells))
    rows = -(-len(kinds) // COLUMNS)
    figure = Figure(figsize=(3.2 * COLUMNS, 2.6 * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    for axis, kind in zip(axes, kinds, strict=False):
        here = [cell for cell in cells if cell["kind"] == kind]
        sizes = sorted({cell["size"] for cell in here})
        for profile, line in (("step", "o-"), ("ramp", "^--")):
            for name, colour in (("noticed", "tab:green"), ("misled_vehicles", "tab:red")):
                shares = [_share(here, size, profile, name) for size in sizes]
                if None not in shares:
                    axis.plot(range(len(sizes)), shares, line, color=colour, label=f"{SHOWN[name]}, {profile}")
        unit = f" [{here[0]['unit']}]" if here[0]["unit"] else ""
        axis.set_title(kind.replace("_", " ") + unit, fontsize=9)
        axis.set_xticks(range(len(sizes)), [f"{size:g}" if size else "" for size in sizes])
        axis.set_ylim(-0.05, 1.05)
    for axis in axes[len(kinds) :]:
        axis.set_axis_off()
    axes[0].set_ylabel("share of vehicles")
    axes[0].legend(fontsize=7)
    return figure


def _share(cells: Sequence[Mapping[str, Any]], size: float, profile: str, name: str) -> float | None:
    """Mean share of vehicles in the cells of a size and profile; None without any."""
    found = [cell[name]["rate"] for cell in cells if (cell["size"], cell["profile"]) == (size, profile)]
    return float(np.mean(found)) if found else None


def detectability_figure(powers: Sequence[Mapping[str, Any]]) -> Figure:
    """Theory and what detection and exclusion do, by the size of a bias; a panel for each number of satellites."""
    figure = Figure(figsize=(4.2 * len(powers), 3.4), layout="constrained")
    for axis, found in zip(np.atleast_1d(figure.subplots(1, len(powers), squeeze=False).ravel()), powers, strict=True):
        rows = found["by_factor"]
        factor = [row["factor"] for row in rows]
        axis.plot(factor, [row["theory"] for row in rows], "k-", label="its own test, theory")
        for key, mark, label in (
            ("own", "k+", "its own test"),
            ("noticed", "g^-", "noticed"),
            ("right", "bv-", "excluded"),
        ):
            axis.plot(factor, [row[key]["rate"] for row in rows], mark, label=label)
        axis.set_title(f"{found['satellites']} satellites, redundancy {found['redundancy']}", fontsize=9)
        axis.set_xlabel("bias over the minimal detectable one")
        axis.set_ylim(-0.05, 1.05)
        axis.set_ylabel("share of epochs")
        axis.legend(fontsize=8)
    return figure
