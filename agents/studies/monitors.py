"""All monitors of the family on the same epochs, recorded or simulated: what each one promises, holds and permits.

Units of a rate are streets of a sky; of one recorded drive they are blocks of 20 s, which are not independent drives,
so that its intervals are too narrow.

The page of the comparison has a table and a sheet of Stanford diagrams for each place.
"""

from __future__ import annotations

import base64
import io
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.files import replace_file
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.in_the_loop import NO_LEVEL_M, rate_by_street
from lanebound.agents.studies.monitored_drives import (
    CampaignConfig,
    FitErrorsConfig,
    campaign_rows,
    fit_errors,
    run_campaign,
    simulated_epochs,
)
from lanebound.agents.studies.street_drives import PACKAGES, StreetDrivesConfig
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.assessment.plotting import INK, new_figure
from lanebound.integrity.assessment.record import Zone, classify
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.error_classes import FittedErrors
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import FAMILY, MonitorKind, applicable, monitor_named
from lanebound.integrity.monitoring.family.levels import predicted_level
from lanebound.integrity.monitoring.family.monitor import BY_ALL_RISKS, watch
from lanebound.integrity.monitoring.family.outcome import MonitorVerdicts
from lanebound.integrity.replay.city import read_city
from lanebound.integrity.replay.code_epochs import TrackedEpochs, recorded_epochs
from lanebound.integrity.sky.systems import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

COLUMNS = 5
BINS = 60
STYLE = """body{font:14px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:80rem;padding:0 1rem;color:#222}
table{border-collapse:collapse;font-size:12px}th,td{padding:.2rem .5rem;border-bottom:1px solid #ddd;text-align:right}
th:first-child,td:first-child{text-align:left}div{overflow-x:auto}img{width:100%}caption{text-align:left}"""
NOTE = (
    "Exceedances are rates of errors beyond the level among the usable epochs that have a level at that risk, over the "
    "risk: above 1 breaks a promise. With a level: shares of these epochs at the risks of the exceedances. "
    "In brackets the 95 % interval by street, or by block of one recorded drive, which is too narrow. "
    "Levels and errors: median / 95 %. HMI: largest rate over the alert limits. An alarm is false if the position is "
    "within the largest alert limit. us: microseconds for an epoch on one core."
)
CAMPAIGN_NOTE = (
    "Vehicles that notice the fault, and the median time to that; vehicles whose error exceeds the alert limit, and "
    "the longest time in which it did so while the position was declared available."
)


def write_page(config: MonitorsConfig, result: Mapping[str, Any], out: Path) -> list[Path]:
    """Write ``report.html`` and the sheets as PNG into ``out``."""
    written, body = [], []
    for k, (place, found) in enumerate(result["places"].items()):
        if not found["monitors"]:
            continue
        figure = stanford_sheet(config, found)
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=110)
        path = out / f"stanford-{k}.png"
        _write(path, picture.getvalue())
        written.append(path)
        source = base64.b64encode(picture.getvalue()).decode()
        title = f"{place}: {found['epochs']:,} epochs, {found['satellites']:.1f} satellites"
        body.append(f"<h2>{escape(title)}</h2><div>{_table(*monitor_rows(config, found, True))}</div>")
        body.append(f'<img alt="Stanford diagrams" src="data:image/png;base64,{source}">')
    heads, rows = predicted_rows(result)
    if rows:
        body.append(f"<h2>Predicted HPL within 50 m</h2><div>{_table(heads, rows)}</div>")
    for place, tried in result.get("campaign", {}).items():
        body.append(f"<h2>{escape(place)}: faults</h2><p>{CAMPAIGN_NOTE}</p><div>{_table(*campaign_rows(tried))}</div>")
    kinds = [(k.name, k.group, k.summary, k.source, ", ".join(k.needs), k.promise) for k in FAMILY.values()]
    table = _table(("monitor", "group", "does", "source", "needs", "promise"), kinds)
    body.append(f"<h2>The monitors</h2><div>{table}</div>")
    head = f"<!doctype html><meta charset=utf-8><title>Monitors</title><style>{STYLE}</style>"
    _write(out / "report.html", (head + f"<h1>Monitors</h1><p>{NOTE}</p>" + "".join(body)).encode())
    return [out / "report.html", *written]


def _write(path: Path, content: bytes) -> None:
    with replace_file(path) as draft:
        draft.write_bytes(content)


def _table(heads: Iterable[Any], rows: Iterable[Sequence[Any]]) -> str:
    head = "".join(f"<th>{escape(str(h))}</th>" for h in heads)
    lines = "".join("<tr>" + "".join(f"<td>{escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{lines}</table>"


def stanford_sheet(config: MonitorsConfig, place: Mapping[str, Any]) -> Figure:
    """One small Stanford diagram for each monitor: level over error at the largest alert limit."""
    from matplotlib.colors import LogNorm

    names, al = list(place["monitors"]), config.alert_limits_m[-1]
    rows, top = -(-len(names) // COLUMNS), 2.0 * al
    figure = new_figure(3.0 * COLUMNS, 2.9 * rows)
    edges = np.linspace(0.0, top, BINS + 1)
    for i, name in enumerate(names):
        found, axes = place["monitors"][name], figure.add_subplot(rows, COLUMNS, i + 1)
        error, level = np.asarray(found["sample_error_m"]), np.asarray(found["sample_level_m"])
        zone = classify(error, level, al)
        counts, _, _ = np.histogram2d(np.minimum(error, top), np.minimum(level, top), bins=[edges, edges])
        shown = np.ma.masked_less(counts.T, 1)
        axes.pcolormesh(edges, edges, shown, cmap="viridis_r", norm=LogNorm(0.5, max(10.0, float(counts.max()))))
        for line in (([0, top], [0, top]), ([0, top], [al, al]), ([al, al], [0, al])):
            axes.plot(*line, color=INK, linewidth=0.7)
        misleading, hazard = int((zone == Zone.MISLEADING).sum()), int((zone == Zone.HAZARDOUS).sum())
        axes.set_title(f"{name}: {error.size:,}, MI {misleading}, HMI {hazard}", fontsize=8, color=INK, loc="left")
        axes.set(xlim=(0, top), ylim=(0, top), box_aspect=1.0)
        axes.tick_params(labelsize=6)
    figure.supxlabel("horizontal error [m]", fontsize=9)
    figure.supylabel(f"level [m], alert limit {al:g} m", fontsize=9)
    return figure


WHOLE, AFTER = "whole drive", "after training"
PREDICTED = {"GPS": (System.GPS,), "GPS and Galileo": (System.GPS, System.GALILEO), "all": tuple(System)}
PUBLISHED_HAL_M, PUBLISHED_FALSE_ALARM, PUBLISHED_MISSED = 50.0, 5e-3, 5e-5  # S3 V-B1 [17], toll collection
MOST_SAMPLES = 4000  # epochs of a part that diagrams show


class MonitorsConfig(Config):
    """Which monitors, on which epochs, and what is counted."""

    skies: tuple[str, ...] = Field((), description="levels of sky that are simulated; none with a data set")
    monitors: tuple[str, ...] = Field((), description="kinds of the family; none: all that the epochs allow")
    risks: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = Field(
        (1e-2, 1e-3, 1e-4, 1e-5), min_length=1, description="risks at which exceedances are counted [-]"
    )
    operative: int = Field(1, ge=0, description="number of the risk of levels, availability and diagrams, from 0")
    alert_limits_m: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        (0.5, 1.5, 5.0, 10.0, 15.0, 25.0), min_length=1, description="alert limits [m]; lanes to the 25 m of a city"
    )
    streets: int = Field(6, ge=1, description="streets of each sky")
    every: int = Field(5, ge=1, description="every n-th epoch of simulated drives is used")
    changes: dict[str, Any] = Field({}, description="of the configuration of every monitor: changes.inlier_sigmas=2")
    block_s: float = Field(20.0, gt=0, description="length of a block of a recorded drive [s]")
    errors: str | None = Field(None, description="preset or file of fit-errors, in place of a fit")
    fit: FitErrorsConfig = FitErrorsConfig()
    drives: StreetDrivesConfig = StreetDrivesConfig(vehicles=8, duration_s=60.0)
    campaign: CampaignConfig = Field(CampaignConfig(), description="faults under each sky; cases=[all] for all of them")

    def kinds(self, tracked: TrackedEpochs, fitted: bool) -> list[MonitorKind]:
        """The kinds that are wanted and apply."""
        found = applicable(tracked.epochs, fitted)
        wanted = [monitor_named(name).name for name in self.monitors]
        return [kind for kind in found if not wanted or kind.name in wanted]


def assess_monitors(
    config: MonitorsConfig, folder: Path | None, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Fit errors, run all monitors, and write ``results.json``; returns its data.

    Raises
    ------
    InputError
        Neither a data set nor a sky is given, or both; the folder holds no drive; ``out`` cannot be claimed.
    """
    if (folder is None) == (not config.skies):
        raise InputError("assess monitors must have --data or --sky, got both or none: name one")
    if config.operative >= len(config.risks):
        raise InputError(f"operative must be < {len(config.risks)}, got {config.operative}: risks are numbered from 0")
    claimed = {**config.to_dict(), "data": None if folder is None else folder.name}
    ResultFolder(out, "monitors", claimed, code_digest(*PACKAGES)).claim()
    places = [WHOLE, AFTER] if folder is not None else list(config.skies)
    fits = run_parts(out, _fit_names(config, folder), partial(fit_part, config, folder), jobs, on_progress)
    names = [f"{k}-{i}" for k in range(len(places)) for i in range(1 if folder is not None else config.streets)]
    parts = run_parts(out, names, partial(work_part, config, folder, fits), jobs, on_progress)
    chosen = config.campaign.chosen if folder is None else []
    tried = [f"campaign-{k}" for k in range(len(config.skies))] if chosen else []
    campaigns = run_parts(out, tried, partial(campaign_part, config, fits), jobs, on_progress)
    result = {
        "config": claimed,
        "places": {
            place: _summary(config, [part for name, part in parts.items() if name.startswith(f"{k}-")])
            for k, place in enumerate(places)
        },
        "fits": fits,
        "campaign": {config.skies[int(name.rpartition("-")[2])]: found for name, found in campaigns.items()},
    }
    return stored(result, out)


def _fit_names(config: MonitorsConfig, folder: Path | None) -> list[str]:
    return [f"fit-{k}" for k in range(1 if folder is not None else len(config.skies))]


def fit_part(config: MonitorsConfig, folder: Path | None, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """The errors that monitors with fitted laws assume: of the first part of a drive, or of other streets of a sky."""
    if config.errors is not None:
        return {"fitted": FittedErrors.named(config.errors).to_dict()}
    sky = None if folder is not None else config.skies[int(name.rpartition("-")[2])]
    fitted, found = fit_errors(folder, sky, config.fit)
    advance(1.0)
    return {"fitted": fitted.to_dict(), **found}


def work_part(
    config: MonitorsConfig, folder: Path | None, fits: Mapping[str, Any], name: str, advance: Advance = ignore
) -> dict[str, Any]:
    """All monitors on one street, or on a part of a recorded drive; it depends on no other part."""
    place, number = (int(text) for text in name.split("-"))
    if folder is not None:
        tracked = recorded_epochs(read_city(folder))
        fitted = FittedErrors.load(fits["fit-0"]["fitted"]) if place or config.errors else None
        tracked = _after(tracked, config.fit.training_share) if place else tracked
        unit = ((tracked.epochs.time_s - tracked.epochs.time_s[0]) // config.block_s).astype(np.int64)
    else:
        tracked = simulated_epochs(
            config.drives, config.skies[place], number, config.every, lambda share: advance(0.5 * share)
        )
        fitted = FittedErrors.load(fits[f"fit-{place}"]["fitted"])
        unit = np.zeros(tracked.epochs.count, np.int64)
    kinds, found = config.kinds(tracked, fitted is not None), {}
    for k, kind in enumerate(kinds):
        changes = fitted.changes() if fitted is not None and "fit" in kind.needs else {}
        found[kind.name] = place_counts(config, tracked, kind, changes, unit)
        advance(0.5 + 0.5 * (k + 1) / len(kinds))
    return {
        "epochs": tracked.epochs.count,
        "satellites": float(tracked.epochs.used.sum(-1).mean()),
        "predicted": {} if folder is not None else predicted_availability(tracked),
        "monitors": found,
    }


def campaign_part(
    config: MonitorsConfig, fits: Mapping[str, Any], name: str, advance: Advance = ignore
) -> dict[str, Any]:
    """The fault campaign under one sky."""
    place = int(name.rpartition("-")[2])
    fitted = FittedErrors.load(fits[f"fit-{place}"]["fitted"])
    wanted = [monitor_named(kind).name for kind in config.monitors]
    kinds = [kind for kind in FAMILY.values() if not wanted or kind.name in wanted]
    return run_campaign(
        config.campaign, config.drives, config.skies[place], kinds, fitted.changes(), config.risks[config.operative],
        advance,
    )  # fmt: skip


def predicted_availability(tracked: TrackedEpochs) -> dict[str, float]:
    """Share of epochs whose predicted HPL is below the published alert limit, by systems (S3: 50 m, 5e-3, 5e-5)."""
    e, out = tracked.epochs, {}
    for name, systems in PREDICTED.items():
        fit = solve_codes(e.with_codes(used=e.used & np.isin(e.system, [int(s) for s in systems])))
        level = predicted_level(fit, PUBLISHED_FALSE_ALARM, np.array([PUBLISHED_MISSED]))[:, 0]
        out[name] = float((fit.solved & (level <= PUBLISHED_HAL_M)).mean())
    return out


def _after(tracked: TrackedEpochs, share: float) -> TrackedEpochs:
    """The part of a drive after its training."""
    clock = tracked.epochs.time_s
    own = clock >= clock[0] + share * (clock[-1] - clock[0])
    return TrackedEpochs(tracked.epochs.take(own), tracked.truth_enu_m[own], tracked.known[own])


def place_counts(
    config: MonitorsConfig, tracked: TrackedEpochs, kind: MonitorKind, changes: dict[str, Any], unit: NDArray[np.int64]
) -> dict[str, Any]:
    """Counts of one monitor by unit, and samples of errors and operative levels [m].

    An epoch without truth does not count. An alarm is false if the position is within the largest alert limit. Levels
    at a risk are counted where the position is usable and has a finite one at that risk.
    """
    begun = time.perf_counter()
    verdicts = _verdicts(config, tracked.epochs, kind.config({"vertical": True, **config.changes, **changes}))
    cost_us = 1e6 * (time.perf_counter() - begun) / max(tracked.epochs.count * len(verdicts), 1)
    v, limits = verdicts[config.operative % len(verdicts)], np.array(config.alert_limits_m)
    errors = [np.hypot(*(one.position_enu_m - tracked.truth_enu_m)[:, :2].T) for one in verdicts]
    columns = range(len(config.risks))
    by_risk = np.stack([errors[r % len(verdicts)] for r in columns], -1)
    levels = np.concatenate([one.hpl_m for one in verdicts], -1)
    usable_at = np.stack([verdicts[r % len(verdicts)].usable for r in columns], -1) & tracked.known[:, None]
    shown = usable_at & np.isfinite(levels)
    error, height = by_risk[:, config.operative], np.abs(v.position_enu_m[:, 2] - tracked.truth_enu_m[:, 2])
    level, usable = levels[:, config.operative], usable_at[:, config.operative]
    up = v.vpl_m[:, config.operative if len(verdicts) == 1 else 0]
    upward, alarm = np.isfinite(up) & usable, v.alarm & tracked.known
    available = usable[:, None] & (level[:, None] <= limits)
    per_epoch = {
        "epochs": tracked.known,
        "usable": usable,
        "shown": shown,
        "exceed": shown & (by_risk > levels),
        "upward": upward,
        "exceed_up": upward & (height > up),
        "alarms": alarm,
        "false_alarms": alarm & (error <= limits[-1]),
        "available": available,
        "hmi": available & (error[:, None] > limits),
        "excluded": v.excluded.any(-1) & tracked.known,
    }
    count = int(unit.max(initial=0)) + 1
    totals = {name: _by_unit(values, unit, count) for name, values in per_epoch.items()}
    sample = np.flatnonzero(tracked.known)
    sample = sample[:: max(1, -(-sample.size // MOST_SAMPLES))]
    return totals | {
        "cost_us": cost_us,
        "stated_false_alarm": float(v.false_alarm.mean()),
        "sample_error_m": np.round(error[sample], 3).tolist(),
        "sample_level_m": np.round(np.minimum(level, NO_LEVEL_M)[sample], 3).tolist(),
        "sample_shown": shown[sample, config.operative].tolist(),
        "sample_vpl_m": np.round(np.minimum(up, NO_LEVEL_M)[sample], 3).tolist(),
    }


def _verdicts(config: MonitorsConfig, epochs: CodeEpochs, monitor: FamilyMonitorConfig) -> list[MonitorVerdicts]:
    """Verdicts at all risks; one after another where the position or the alarm follows from all risks asked."""
    if monitor.level in BY_ALL_RISKS:
        return [watch(epochs, monitor, risk) for risk in config.risks]
    return [watch(epochs, monitor, config.risks)]


def _by_unit(values: NDArray[np.bool_], unit: NDArray[np.int64], count: int) -> list[Any]:
    out = np.zeros((count, *values.shape[1:]), np.int64)
    np.add.at(out, unit, values)
    found: list[Any] = out.tolist()
    return found


def _summary(config: MonitorsConfig, parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Figures of all monitors at a place."""
    names = list(parts[0]["monitors"]) if parts else []
    return {
        "epochs": sum(part["epochs"] for part in parts),
        "satellites": float(np.mean([part["satellites"] for part in parts])),
        "predicted": {key: float(np.mean([part["predicted"][key] for part in parts])) for key in parts[0]["predicted"]},
        "monitors": {name: _figures(config, [part["monitors"][name] for part in parts]) for name in names},
    }


def _figures(config: MonitorsConfig, parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rates with intervals, availability, levels and cost of one monitor."""

    def joined(name: str) -> NDArray[np.int64]:
        return np.concatenate([np.asarray(part[name], dtype=np.int64) for part in parts])

    epochs, usable, total = joined("epochs"), joined("usable"), max(int(joined("epochs").sum()), 1)
    shown, exceed, hmi, available = joined("shown"), joined("exceed"), joined("hmi"), joined("available")
    error, level, up, good = (np.concatenate([np.asarray(part[f"sample_{name}"]) for part in parts])
                              for name in ("error_m", "level_m", "vpl_m", "shown"))  # fmt: skip
    good = good.astype(bool)
    return {
        "usable": float(usable.sum() / total),
        "alarms": float(joined("alarms").sum() / total),
        "false_alarms": rate_by_street(joined("false_alarms"), epochs),
        "stated_false_alarm": float(np.mean([part["stated_false_alarm"] for part in parts])),
        "excluded": float(joined("excluded").sum() / total),
        "shown": {f"{risk:g}": float(shown[:, r].sum() / total) for r, risk in enumerate(config.risks)},
        "exceed": {f"{risk:g}": rate_by_street(exceed[:, r], shown[:, r]) for r, risk in enumerate(config.risks)},
        "available": {f"{limit:g}": float(available[:, a].sum() / total)
                      for a, limit in enumerate(config.alert_limits_m)},
        "hmi": {f"{limit:g}": rate_by_street(hmi[:, a], epochs) for a, limit in enumerate(config.alert_limits_m)},
        "level_m": _quantiles(level[good]),
        "vpl_m": _quantiles(up[good]) if joined("upward").any() else None,
        "exceed_up": rate_by_street(joined("exceed_up"), joined("upward")),
        "error_m": _quantiles(error[good]),
        "cost_us": float(np.mean([part["cost_us"] for part in parts])),
        "sample_error_m": error[good].tolist(),
        "sample_level_m": level[good].tolist(),
    }  # fmt: skip


def _quantiles(values: Array) -> list[float] | None:
    """Median and 95 %; None without values."""
    return [float(q) for q in np.quantile(values, (0.5, 0.95))] if values.size else None


def shown(config: MonitorsConfig, result: Mapping[str, Any]) -> Iterator[Shown]:
    """The monitors at each place, faults, and predicted availability."""
    for place, found in result["places"].items():
        if found["monitors"]:
            title = f"{place}, {found['epochs']:,} epochs: rate of errors beyond the level over the risk"
            yield title, monitor_rows(config, found)
    for place, tried in result["campaign"].items():
        limit = f"{config.campaign.alert_limit_m:g} m"
        title = f"{place}, faults: noticed, median; vehicles off by more than {limit}, longest time to alert"
        yield title, campaign_rows(tried)
    title = "Predicted HPL within 50 m, P_FA 5e-3, P_MD 5e-5; S3: GPS 50 to 7 %, two systems 100 to 55 %"
    yield title, predicted_rows(result)


def monitor_rows(config: MonitorsConfig, place: Mapping[str, Any], bands: bool = False) -> Table:
    """One row for each monitor: exceedances over the risk, with ``bands`` their intervals, levels, availability at
    three limits, alarms, HMI, cost."""
    limits = [f"{limit:g}" for limit in config.alert_limits_m]
    shown = limits[-3:]
    risk = f"{config.risks[config.operative]:g}"
    rows: list[tuple[Any, ...]] = []
    for name, f in place["monitors"].items():
        rates = [_over(f["exceed"][key], float(key), bands) for key in f["exceed"]]
        level = "-" if f["level_m"] is None else " / ".join(_metres(v) for v in f["level_m"])
        up = "-" if f["vpl_m"] is None else " / ".join(_metres(v) for v in f["vpl_m"])
        up += "" if f["vpl_m"] is None else f", {_over(f['exceed_up'], config.risks[config.operative], bands)}"
        error = "-" if f["error_m"] is None else " / ".join(_metres(v) for v in f["error_m"])
        shares = [f"{100.0 * f['available'][limit]:.0f}" for limit in shown]
        hmi = max(f["hmi"][limit]["rate"] for limit in limits)
        rows.append((
            name, *rates, level, up, error, " / ".join(shares),
            " / ".join(f"{100.0 * share:.0f}" for share in f["shown"].values()),
            f"{100.0 * f['alarms']:.1f} ({100.0 * f['false_alarms']['rate']:.1f})", f"{hmi:.2g}", f"{f['cost_us']:.0f}",
        ))  # fmt: skip
    heads = (
        "monitor", *(f"at {key}" for key in next(iter(place["monitors"].values()))["exceed"]), f"HPL at {risk} [m]",
        "VPL [m], over risk", "error [m]",
        f"at AL {' / '.join(shown)} m [%]", "with a level [%]", "alarms (false) [%]", "HMI", "us",
    )  # fmt: skip
    return heads, rows


def predicted_rows(result: Mapping[str, Any]) -> Table:
    """Predicted availability by place and systems, next to the published figures; no rows for recorded drives."""
    rows = [
        (place, *(f"{100.0 * found['predicted'][key]:.1f} %" for key in PREDICTED))
        for place, found in result["places"].items()
        if found["predicted"]
    ]
    return ("sky", *PREDICTED), rows


def _metres(value: float) -> str:
    return "none" if value >= NO_LEVEL_M else f"{value:.1f}"


def _over(rate: Mapping[str, Any], risk: float, bands: bool) -> str:
    """Rate over the risk, with its interval if wanted; 0 where none was exceeded."""
    if not rate["events"]:
        return "0"
    band = "" if rate["low"] is None or not bands else f" ({rate['low'] / risk:.2g} .. {rate['high'] / risk:.2g})"
    return f"{rate['rate'] / risk:.2g}{band}"
