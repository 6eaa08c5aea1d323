"""The comparison of monitors as one page: a table and a sheet of Stanford diagrams for each place."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lanebound.agents.assess.monitor_campaign import campaign_rows
from lanebound.agents.assess.monitors import MonitorsConfig, monitor_rows, predicted_rows
from lanebound.agents.checkpointing.files import replace_file
from lanebound.integrity.assessment.events import Zone, classify
from lanebound.integrity.assessment.plotting import INK, new_figure
from lanebound.integrity.monitoring.family.kinds import FAMILY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["stanford_sheet", "write_page"]

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


def _table(heads: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
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
