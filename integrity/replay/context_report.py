"""Files of a recorded drive under the context monitor: statistics, verdicts, changes of the light, and a map."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.plotting import INK, legend, new_figure, save, tidy
from lanebound.integrity.assessment.warning_rates import WarningCounts, sweep_thresholds
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.monitoring.context.monitor import ContextReason, Light
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK
from lanebound.integrity.recorded.road_file import read_roads
from lanebound.integrity.replay.context_drive import ReplayedContext, drive_context
from lanebound.integrity.replay.context_epochs import ContextReplayConfig, read_context_epochs

__all__ = ["summarise_context", "write_context"]

PHASES = ("position", "speed", "map")
HEAD = (
    "time_s", "light", "reason", "phases", "score", "link", "road", "link_probability", "hpl_m", "east_m", "north_m",
    "speed_mps", "error_m", "true_road", "right",
)  # fmt: skip
CHANGES = ("time_s", "light", "reason", "phases", "score", "link_probability", "road")
COLOURS = {Light.GREEN: "#1a9850", Light.AMBER: "#f59f00", Light.RED: "#d73027"}
CAUTION = (
    "right: on the road of the map on which the reference drives (its likeliest sequence of roads). A map drawn from "
    "the reference itself says nothing of how often a matched road is wrong. One drive is one drive"
)


def write_context(
    folder: Path, kind: str, roads: Path, out: Path, changes: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Judge a recording on a map; writes ``context.json``, ``context.csv``, ``warnings.csv`` and ``context.png``.

    Parameters
    ----------
    kind : of the recording, as :func:`~.datasets.kind_of` finds it
    roads : the map, GeoJSON as :mod:`~lanebound.integrity.recorded.road_file` reads it
    changes : overrides of :class:`~.context_epochs.ContextReplayConfig`

    Raises
    ------
    InputError
        The map or the recording cannot be used, or a change is invalid.
    """
    config, lines = ContextReplayConfig.build(None, changes), read_roads(roads)
    epochs, stopped = read_context_epochs(folder, kind, config)
    stopped |= (
        {roads.name: f"{lines.malformed} malformed ways left out, the first: {lines.first}"} if lines.first else {}
    )
    drive = drive_context(epochs, lines, config, progress)
    summary = {
        "dataset": "context", "recording": kind, "stopped": stopped or None, **summarise_context(drive),
        "left_out": {"features that are no lines": lines.others, "ways without cars": lines.without_cars,
                     "malformed ways": lines.malformed, "speed limits, taken as 50 km/h": lines.limits},
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    written = [out / name for name in ("context.json", "context.csv", "warnings.csv")]
    written[0].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    rows = _rows(drive)
    _write(written[1], HEAD, rows)
    _write(written[2], CHANGES, [row for k, row in enumerate(rows) if k == 0 or _differ(row, rows[k - 1])])
    return summary, [*written, _draw(drive, out / "context.png")]


def summarise_context(drive: ReplayedContext) -> dict[str, Any]:
    """Statistics of a drive as JSON data."""
    e, interval = drive.epochs, drive.config.interval_s
    found: dict[str, Any] = {
        "epochs": int(e.time_s.size),
        "located": int(e.fix.located.sum()),
        "roads": {"links": drive.network.road_map.links, "nodes": len(drive.network.road_map.node_en_m)},
        "skipped": e.skipped, "notes": list(e.notes),
        "light_s": {light.name.lower(): interval * int((drive.light == light).sum()) for light in Light},
        "reasons": {name: n for name, n in ContextReason.count(drive.reason).items() if n},
        "matched": float((drive.link != NO_LINK).mean()),
    }  # fmt: skip
    if "position" not in e.skipped:
        level = np.where(np.isfinite(drive.level_m), drive.level_m, np.inf)
        found["level"] = {
            "median_m": _finite(float(np.quantile(level, 0.5, method="lower"))),
            "within_limit": float((level <= drive.config.position.alert_limit_m).mean()),
        }
    if not drive.judged.any():
        return found
    errors = drive.errors_m()
    found["error"] = {"median_m": float(np.median(errors)), "p95_m": float(np.quantile(errors, 0.95))}
    if "position" not in e.skipped:
        known = e.known & e.fix.located
        over, level = errors > drive.level_m[known], drive.level_m[known]
        found["error"] |= {"beyond_level": int(over.sum()), "with_level": int(np.isfinite(level).sum())}
    return found | {"judged": int(drive.judged.sum()), "rates": _rates(drive), "caution": CAUTION}


def _rates(drive: ReplayedContext) -> dict[str, Any]:
    """Counts of the monitor, of rules that need none, and where its sweep of the threshold crosses."""
    never, reached = np.zeros_like(drive.warn), _reached(drive)
    rules = {"all phases": drive.warn, "never warn": never, "always warn": ~never}
    sweep = sweep_thresholds(drive.score, ~drive.right, np.arange(101.0), drive.judged & reached)
    third = WarningCounts.of(drive.phases < len(PHASES), ~drive.right, drive.judged & reached)
    return {
        **{name: _counts(drive.counts(warn)) for name, warn in rules.items()},
        "third phase, of points that reach it": _counts(third), "threshold_crossing": sweep.crossing(),
    }  # fmt: skip


def _reached(drive: ReplayedContext) -> NDArray[np.bool_]:
    """Points (E,) that pass the first two phases."""
    return np.asarray(drive.phases >= len(PHASES) - 1)


def _counts(c: WarningCounts) -> dict[str, Any]:
    return {
        "points": c.points, "wrong": c.wrong, "false_alarms": c.false_alarms, "missed": c.missed, "far": c.far,
        "mdr": c.mdr, "ocdr": c.ocdr,
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _rows(drive: ReplayedContext) -> list[dict[str, Any]]:
    """A row for each epoch; empty cells for what is not known."""
    e, names = drive.epochs, (*drive.network.names, "")
    out = []
    for k in range(e.time_s.size):
        there, known = bool(e.fix.located[k]), bool(e.known[k])
        east, north = e.fix.position_en_m[k]
        error = float(np.hypot(*(e.fix.position_en_m[k] - e.truth_en_m[k])))
        out.append({
            "time_s": f"{e.time_s[k]:.2f}", "light": Light(int(drive.light[k])).name.lower(),
            "reason": ContextReason.from_code(int(drive.reason[k])).name, "phases": int(drive.phases[k]),
            "score": f"{drive.score[k]:.1f}", "link": int(drive.link[k]), "road": names[drive.link[k]],
            "link_probability": f"{drive.probability[k]:.3f}",
            "hpl_m": f"{drive.level_m[k]:.2f}" if np.isfinite(drive.level_m[k]) else "",
            "east_m": f"{east:.2f}" if there else "", "north_m": f"{north:.2f}" if there else "",
            "speed_mps": f"{e.wheel_mps[k]:.2f}", "error_m": f"{error:.2f}" if there and known else "",
            "true_road": names[drive.true_link[k]], "right": int(drive.right[k]) if drive.judged[k] else "",
        })  # fmt: skip
    return out


def _differ(row: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    return bool((row["light"], row["reason"]) != (before["light"], before["reason"]))


def _write(path: Path, head: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, head, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def _draw(drive: ReplayedContext, path: Path) -> Path:
    """The roads, the positions in the colours of the light, and the reference."""
    figure, e = new_figure(7.0, 6.0), drive.epochs
    axes = figure.subplots()
    for link in range(drive.network.road_map.links):
        axes.plot(*drive.network.road_map.line(link).T, color="#bbbbbb", linewidth=1.0, zorder=1)
    if e.known.any():
        axes.plot(*e.truth_en_m[e.known].T, color=INK, linewidth=0.8, zorder=2, label="reference")
    for light in Light:
        at = (drive.light == light) & e.fix.located
        if at.any():
            name = light.name.lower()
            east, north = e.fix.position_en_m[at].T
            axes.scatter(east, north, s=9, color=COLOURS[light], zorder=3, label=name)
    places = e.fix.position_en_m[e.fix.located] if e.fix.located.any() else np.zeros((1, 2))
    low, high = places.min(0) - 60.0, places.max(0) + 60.0
    tidy(axes, title="Context monitor on a recorded drive", xlabel="East [m]", ylabel="North [m]")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    legend(axes)
    return save(figure, path)
