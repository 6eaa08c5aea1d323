"""Stanford diagrams: protection level against error, with the zones and counts of the assessment."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lanebound.agents.report.svg import Frame, axes, line, picture, tag
from lanebound.integrity.assessment.events import Zone
from lanebound.integrity.assessment.record import Axis, Record
from lanebound.integrity.assessment.stanford import ZoneCounts, count_zones

__all__ = ["AXIS_NAMES", "share_text", "stanford"]

WIDTH, HEIGHT = 176.0, 190.0
FRAME = Frame(27.0, 22.0, 171.0, 157.0)
EXTENT = 2.0  # how many alert limits are shown
CELLS = 48  # of the density, along each axis
LEVELS = 5
AXIS_NAMES: dict[Axis, str] = {"at": "along the track", "ct": "across the track"}


def stanford(agent: str, record: Record, axis: Axis, al_m: float) -> tuple[Markup, ZoneCounts]:
    """The diagram of one axis up to twice the alert limit, and the epochs in each zone."""
    zones = count_zones(record, axis, al_m)
    top = EXTENT * al_m
    x, y = FRAME.across(0.0, top), FRAME.up(0.0, top)
    parts = [_polygon(zone, outline) for zone, outline in _outlines(x(al_m), y(al_m)).items()]
    parts += axes(FRAME, x, y, "error (m)", f"PL {axis.upper()} (m)", (3, 4))
    parts += _density(np.minimum(record.error(axis), top), np.minimum(record.pl(axis), top), top)
    parts += [
        line(x(0.0), y(0.0), x(top), y(top), "rule"),
        line(x(0.0), y(al_m), x(top), y(al_m), "limit"),
        line(x(al_m), y(0.0), x(al_m), y(al_m), "limit"),
    ]
    said = ", ".join(f"{zone.label} {share_text(zones.rate(zone))}" for zone in Zone)
    label = f"Stanford diagram of {agent} {AXIS_NAMES[axis]}, alert limit {al_m:g} m: {said}"
    return picture(WIDTH, HEIGHT, label, *parts, class_="chart stanford"), zones


def _outlines(x_al: float, y_al: float) -> dict[Zone, list[tuple[float, float]]]:
    """Corners of the zones [px]."""
    left, top, right, bottom = FRAME.left, FRAME.top, FRAME.right, FRAME.bottom
    return {
        Zone.NOMINAL: [(left, bottom), (x_al, y_al), (left, y_al)],
        Zone.MISLEADING: [(left, bottom), (x_al, bottom), (x_al, y_al)],
        Zone.HAZARDOUS: [(x_al, bottom), (right, bottom), (right, y_al), (x_al, y_al)],
        Zone.UNAVAILABLE: [(left, y_al), (x_al, y_al), (right, top), (left, top)],
        Zone.UNAVAILABLE_MISLEADING: [(x_al, y_al), (right, y_al), (right, top)],
    }


def _polygon(zone: Zone, outline: list[tuple[float, float]]) -> Markup:
    return tag("polygon", points=" ".join(f"{x:.1f},{y:.1f}" for x, y in outline), class_=f"z{int(zone)}")


def _density(error_m: NDArray[np.float64], pl_m: NDArray[np.float64], top_m: float) -> list[Markup]:
    """Cells by the logarithm of their epochs, one path for each level; a single epoch stays visible.

    A path runs along the middles of its cells, and is as wide as they are: half as long as outlines would be.
    """
    edges = np.linspace(0.0, top_m, CELLS + 1)
    counts, _, _ = np.histogram2d(pl_m.ravel(), error_m.ravel(), bins=[edges, edges])
    most = max(10.0, float(counts.max()))
    with np.errstate(divide="ignore"):
        level = np.where(counts > 0, np.floor(LEVELS * np.log(counts) / np.log(most)), -1.0)
    level = np.minimum(level, LEVELS - 1).astype(int)
    paths = [tag("path", d=_runs(level == k), class_=f"d{k}") for k in range(LEVELS) if (level == k).any()]
    width, height = (FRAME.right - FRAME.left) / CELLS, (FRAME.bottom - FRAME.top) / CELLS
    place = f"translate({FRAME.left:g} {FRAME.bottom - height / 2:.3f}) scale({width:.3f} {-height:.3f})"
    return [tag("g", *paths, transform=place, class_="density")]


def _runs(cells: NDArray[np.bool_]) -> str:
    """A path over the cells (row, column), neighbours in a row in one stroke."""
    pieces = []
    for row in np.nonzero(cells.any(axis=1))[0]:
        change = np.diff(np.concatenate([[0], cells[row].astype(int), [0]]))
        for start, end in zip(np.nonzero(change == 1)[0], np.nonzero(change == -1)[0], strict=True):
            pieces.append(f"M{start} {row}h{end - start}")
    return "".join(pieces)


def share_text(rate: float) -> str:
    """A share as a percentage with enough digits to tell a rare event from none."""
    if rate in (0.0, 1.0):
        return f"{100.0 * rate:.0f} %"
    return f"{100.0 * rate:.1f} %" if 0.001 <= rate <= 0.999 else f"{100.0 * rate:.3g} %"
