"""The Stanford diagram: protection level against error with the zones of S3 Fig. 4, for each axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.events import Zone, classify
from lanebound.integrity.assessment.plotting import INK, legend, new_figure, risk_text, tidy
from lanebound.integrity.assessment.record import AXES, Axis, Record
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["ZoneCounts", "count_zones", "stanford_figure"]

ZONE_COLOURS = {
    Zone.NOMINAL: "#E3F3EC",
    Zone.MISLEADING: "#FBE3B5",
    Zone.HAZARDOUS: "#F2B9A0",
    Zone.UNAVAILABLE: "#DFE9F3",
    Zone.UNAVAILABLE_MISLEADING: "#E7DFEE",
}
AXIS_NAMES = {"at": "along track", "ct": "cross track"}


@dataclass(frozen=True)
class ZoneCounts:
    """Numbers of epochs in each zone of one axis."""

    counts: dict[Zone, int]

    @property
    def total(self) -> int:
        """Number of all epochs."""
        return sum(self.counts.values())

    def rate(self, zone: Zone) -> float:
        """Share of the epochs in a zone."""
        return self.counts[zone] / self.total

    def to_dict(self) -> dict[str, dict[str, float]]:
        """``{zone: {"count", "rate"}}`` with lower-case zone names, as JSON data."""
        return {z.name.lower(): {"count": n, "rate": self.rate(z)} for z, n in self.counts.items()}


def count_zones(record: Record, axis: Axis, al_m: float) -> ZoneCounts:
    """Count the epochs of a record in each zone of one axis; epochs without position are unavailable.  al_m [m]."""
    pl = np.where(record.mode == Mode.NONE, np.inf, record.pl(axis))
    zone = classify(record.error(axis), pl, al_m)
    return ZoneCounts({z: int((zone == z).sum()) for z in Zone})


def stanford_figure(
    record: Record, al_at_m: float, al_ct_m: float, *, title: str = "Stanford diagram", risk: float | None = None,
    extent: float = 2.0, counted: str = "epochs",
) -> Figure:  # fmt: skip
    """Plot both axes side by side, up to ``extent`` alert limits; ``counted`` is the name of the counted units."""
    figure = new_figure(13.0, 4.9)
    figure.suptitle(title + risk_text(risk), fontsize=12, color=INK)
    for column, (axis, al) in enumerate(zip(AXES, (al_at_m, al_ct_m), strict=True)):
        _panel(figure.add_subplot(1, 2, column + 1), record, axis, al, extent * al, counted)
    return figure


def _panel(axes: Axes, record: Record, axis: Axis, al: float, top: float, counted: str) -> None:
    zones = count_zones(record, axis, al)
    _paint_zones(axes, zones, al, top)
    error, pl = record.error(axis).ravel(), record.pl(axis).ravel()
    _density(axes, np.minimum(error, top), np.minimum(pl, top), top)
    beyond = int(((error > top) | (pl > top)).sum())
    note = f"{zones.total:,} {counted}, darker where more" + (
        f"; {beyond:,} beyond the scale at its edge" if beyond else ""
    )
    axes.set_title(f"{AXIS_NAMES[axis]}, alert limit {al:.3g} m\n{note}", fontsize=9, color=INK, loc="left")
    tidy(axes, xlabel="absolute position error (m)", ylabel="protection level (m)")
    axes.grid(False)
    axes.set(xlim=(0, top), ylim=(0, top), box_aspect=1.0)
    legend(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.4, handlelength=1.2, frameon=False)


def _paint_zones(axes: Axes, zones: ZoneCounts, al: float, top: float) -> None:
    """Draw polygons of the zones in the (error, PL) plane, labelled with counts and rates."""
    outlines = {
        Zone.NOMINAL: [(0, 0), (al, al), (0, al)],
        Zone.MISLEADING: [(0, 0), (al, 0), (al, al)],
        Zone.HAZARDOUS: [(al, 0), (top, 0), (top, al), (al, al)],
        Zone.UNAVAILABLE: [(0, al), (al, al), (top, top), (0, top)],
        Zone.UNAVAILABLE_MISLEADING: [(al, al), (top, al), (top, top)],
    }
    for zone, outline in outlines.items():
        label = f"{zone.label}\n{zones.counts[zone]:,}  ({_percent(zones.rate(zone))})"
        axes.fill(*zip(*outline, strict=True), color=ZONE_COLOURS[zone], linewidth=0, label=label, zorder=0)
    line = {"color": INK, "linewidth": 0.8, "zorder": 3}
    axes.plot([0, top], [0, top], **line)  # type: ignore[arg-type]
    axes.plot([0, top], [al, al], **line)  # type: ignore[arg-type]
    axes.plot([al, al], [0, al], **line)  # type: ignore[arg-type]


def _density(axes: Axes, error: NDArray[np.float64], pl: NDArray[np.float64], top: float) -> None:
    """Draw counts of epochs for each cell on a logarithmic scale; single epochs are visible."""
    from matplotlib.colors import LogNorm

    edges = np.linspace(0.0, top, 91)
    counts, _, _ = np.histogram2d(error, pl, bins=[edges, edges])
    shown = np.ma.masked_less(counts.T, 1)
    norm = LogNorm(vmin=0.5, vmax=max(10.0, float(counts.max())))
    axes.pcolormesh(edges, edges, shown, cmap="viridis_r", norm=norm, zorder=2, rasterized=True)


def _percent(rate: float) -> str:
    """A share as a percentage with enough digits to distinguish a rare event from none."""
    if rate == 0.0 or rate == 1.0:
        return f"{100.0 * rate:.0f} %"
    return f"{100.0 * rate:.1f} %" if 0.001 <= rate <= 0.999 else f"{100.0 * rate:.3g} %"
