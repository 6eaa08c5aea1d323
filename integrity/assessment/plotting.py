"""Figures in one style: a colour-blind safe palette, plain axes, output without a display.

The Stanford diagram has level against error with the zones of S3 Fig. 4, for each axis. Others are errors and levels
over time by mode (as in S1 Figs. 3-4), and a map coloured by mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.assessment.record import AXES, Axis, Record, Zone, classify
from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Array = NDArray[np.float64]

# Okabe and Ito (2008), distinguishable with every common colour vision deficiency.
MODE_COLOURS = {
    Mode.NONE: "#9A9A9A",
    Mode.RTK: "#009E73",
    Mode.DOPPLER: "#E69F00",
    Mode.IMU_ODOMETER: "#CC79A7",
    Mode.CODE: "#56B4E9",
    Mode.SPP: "#8B5E3C",
    Mode.DGPS: "#C9A227",
    Mode.SBAS_L1: "#5E81AC",
    Mode.SBAS_DFMC: "#2F4B7C",
    Mode.PPP: "#6A3D9A",
    Mode.NRTK: "#1B7837",
}
FURTHER_COLOURS = ("#8C564B", "#17BECF", "#BCBD22", "#7F3C8D")
PL_COLOUR = "#0072B2"
LIMIT_COLOUR = "#D55E00"
INK = "#2B2B2B"
GRID = "#DDDDDD"
DPI = 150


def mode_colour(mode: Mode) -> str:
    """Colour of a mode; those that users add take further ones in turn."""
    further = FURTHER_COLOURS[int(mode) % len(FURTHER_COLOURS)]
    return MODE_COLOURS.get(mode, further)


def new_figure(width_in: float, height_in: float) -> Figure:
    """Create a figure without pyplot: no display, no global state, no close necessary."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes, **labels: str) -> None:
    """Apply the common style to axes (frame, grid, ticks); ``labels`` are passed to ``Axes.set``."""
    axes.set(**labels)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#888888")
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=INK)
    axes.xaxis.label.set(size=9, color=INK)
    axes.yaxis.label.set(size=9, color=INK)


def legend(axes: Axes, **options: Any) -> Legend:
    """Add a small legend with a light frame."""
    return axes.legend(**({"fontsize": 8, "framealpha": 0.9, "edgecolor": GRID, "fancybox": False} | options))


def mode_key(figure: Figure, modes: Iterable[Mode], lead: str, loc: Any) -> None:
    """Add a legend of the mode colours to the figure, in one line after the text ``lead``."""
    from matplotlib.patches import Patch

    handles = [Patch(facecolor="none", edgecolor="none", label=lead)]
    handles += [Patch(facecolor=mode_colour(mode), label=mode.label) for mode in modes]
    look: dict[str, Any] = {"fontsize": 9, "frameon": False, "handlelength": 1.6, "handleheight": 0.7}
    figure.legend(handles=handles, loc=loc, ncols=len(handles), columnspacing=1.4, **look)


def risk_text(risk: float | None) -> str:
    """Suffix of a title, for example ``", integrity risk 10^-6"``; "" for None."""
    if risk is None:
        return ""
    exponent = round(math.log10(risk))
    power = f"$10^{{{exponent}}}$" if math.isclose(risk, 10.0**exponent) else f"{risk:g}"
    return f", integrity risk {power}"


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure and create its folder if necessary; returns the path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=DPI)
    return target


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


BUILDING = "#DAD6CF"
RTK_SCALE_M = 0.5  # S1 section 5: the RTK panels have a smaller error scale
AXIS_TITLES = {"at": "along track (AT)", "ct": "cross track (CT)"}
GAP = 2.5  # median distances between epochs: further apart there is no line, and a mode does not last
SPARSE = 0.1  # a mode used less than this is drawn with dots: single epochs make no line
PANELS = (Mode.RTK, Mode.DOPPLER, Mode.IMU_ODOMETER)  # of S1; a drive by code shows the modes that it used instead


def series_figure(
    record: Record, *, risk: float | None = None, al_at_m: float | None = None, al_ct_m: float | None = None
) -> Figure:
    """Plot absolute error and protection level of one vehicle over time: AT left, CT right; all modes, then each mode.

    The modes are the three of the paper; for code positions and services the modes that occur. Lines end and the strip
    of modes is grey where epochs are further apart than ``GAP`` times their usual distance.

    Raises
    ------
    InputError
        The record has more than one vehicle.
    """
    if np.ndim(record.error_at_m) != 1:
        raise InputError(
            f"record must hold one vehicle, (T,), got {np.shape(record.error_at_m)}: select a column first"
        )
    broken = bool(gaps_of(_minutes(record))[0].any())
    used = [mode for mode in Mode if (record.mode == mode).any() or (broken and mode is Mode.NONE)]
    own = [m for m in used if m is Mode.CODE or m.is_service]
    panels = [*own, *(m for m in PANELS if m in used and m not in own)] if own else PANELS
    figure = new_figure(11.0, 1.8 + 1.9 * (1 + len(panels)))
    figure.suptitle("Position error and protection level (PL)" + risk_text(risk), fontsize=12, color=INK)
    mode_key(
        figure,
        used,
        "mode, as in the strip above the first row:",
        loc="outside lower center",
    )
    grid = figure.subplots(1 + len(panels), 2, sharex=True, squeeze=False)
    for column, (axis, al) in enumerate(zip(AXES, (al_at_m, al_ct_m), strict=True)):
        top = _scale(record, axis, record.mode != Mode.NONE, al)
        _all_modes(grid[0, column], record, axis, al, top)
        for row, mode in enumerate(panels, start=1):
            _one_mode(grid[row, column], record, axis, mode)
        grid[-1, column].set_xlabel("time (min)", fontsize=9)
        grid[0, column].set_title(f"{AXIS_TITLES[axis]}", fontsize=11, color=INK, loc="left")
        grid[0, column].set_xlim(0.0, max(float(_minutes(record)[-1]), 1e-3))
    return figure


def _minutes(record: Record) -> Array:
    return np.asarray((record.time_s - record.time_s[0]) / 60.0)


def _scale(record: Record, axis: Axis, keep: NDArray[np.bool_], al: float | None = None) -> float:
    """Upper limit of a panel: contains 99.5 % of the levels, all errors, and the alert limit."""
    error, pl = record.error(axis)[keep], record.pl(axis)[keep]
    finite = pl[np.isfinite(pl)]
    highest = [1e-3, 1.2 * al if al else 0.0]
    if error.size:
        highest.append(float(error.max()))
    if finite.size:
        highest.append(float(np.quantile(finite, 0.995)))
    return 1.08 * max(highest)


def _all_modes(axes: Axes, record: Record, axis: Axis, al: float | None, top: float) -> None:
    minutes = _minutes(record)
    _draw(axes, minutes, record.error(axis), record.pl(axis), record.mode != Mode.NONE, INK, "error")
    if al:
        axes.axhline(al, color=LIMIT_COLOUR, linewidth=1.0, linestyle="--", label=f"alert limit {al:g} m")
    _mode_strip(axes, minutes, record)
    tidy(axes, ylabel=f"all modes, {axis.upper()} (m)", ylim=(0, top))  # type: ignore[arg-type]
    legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=3, frameon=False)


def _mode_strip(axes: Axes, minutes: Array, record: Record) -> None:
    """A band of mode colours along the top of the panel."""
    gaps, usual = gaps_of(minutes)
    begins = np.flatnonzero(np.diff(record.mode, prepend=-1).astype(bool) | gaps)  # a mode lasts until the next epoch
    ends = np.append(minutes[begins[1:]], minutes[-1])
    after = np.append(gaps[begins[1:]], False)
    ends[after] = minutes[begins[1:] - 1][after[:-1]] + usual
    for mode in Mode:
        bars = [(minutes[k], end - minutes[k]) for k, end in zip(begins, ends, strict=True) if record.mode[k] == mode]
        if mode is Mode.NONE:
            bars += [(minutes[k - 1] + usual, minutes[k] - minutes[k - 1] - usual) for k in np.flatnonzero(gaps)]
        axes.broken_barh(
            bars, (0.965, 0.035), linewidth=0, color=mode_colour(mode), transform=axes.get_xaxis_transform(), zorder=4
        )


def gaps_of(time: Array) -> tuple[NDArray[np.bool_], float]:
    """Whether an epoch (T,) comes after a gap, and the usual distance of epochs."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    return np.concatenate([[False], steps > GAP * usual]), usual


def _one_mode(axes: Axes, record: Record, axis: Axis, mode: Mode) -> None:
    keep = np.asarray(record.mode == mode)
    top = RTK_SCALE_M if mode is Mode.RTK else _scale(record, axis, keep)
    _draw(axes, _minutes(record), record.error(axis), record.pl(axis), keep, mode_colour(mode), "error")
    tidy(axes, ylabel=f"{mode.label}, {axis.upper()} (m)", ylim=(0, top))  # type: ignore[arg-type]
    none = keep & ~np.isfinite(record.pl(axis))
    above = int((keep & ~none & ((record.error(axis) > top) | (record.pl(axis) > top))).sum())
    share = f"{100.0 * keep.mean():.1f} % of epochs" + (f", {above:,} above the scale" if above else "")
    share += f", {int(none.sum()):,} without a level" if none.any() else ""
    axes.set_title(share, fontsize=8, color=INK, loc="left", pad=3)
    if not keep.any():
        axes.text(0.5, 0.5, "mode not used", transform=axes.transAxes, ha="center", fontsize=9, color="#777777")


def _draw(
    axes: Axes, minutes: Array, error: Array, pl: Array, keep: NDArray[np.bool_], colour: str, label: str
) -> None:
    """Draw the level as a line over the filled error, with gaps at epochs of other modes and where there are none."""
    at = np.flatnonzero(gaps_of(minutes)[0])
    dots = {"marker": ".", "markersize": 2.2} if keep.mean() < SPARSE or at.size else {}
    times = np.insert(minutes, at, minutes[at])
    shown = np.insert(np.where(keep, error, np.nan), at, np.nan)
    levels = np.insert(np.where(keep & np.isfinite(pl), pl, np.nan), at, np.nan)
    axes.fill_between(times, 0.0, shown, color=colour, alpha=0.35, linewidth=0, step="mid")
    axes.plot(times, shown, color=colour, linewidth=0.7, label=label, **dots)  # type: ignore[arg-type]
    axes.plot(times, levels, color=PL_COLOUR, linewidth=1.1, label="PL", **dots)  # type: ignore[arg-type]


def map_figure(
    position_en_m: ArrayLike,
    mode: ArrayLike,
    *,
    title: str = "",
    obstacles: Iterable[ArrayLike] = (),
    alert: ArrayLike | None = None,
    truth_en_m: ArrayLike | None = None,
) -> Figure:
    """Plot a trajectory coloured by mode over building outlines, with start and end.

    position_en_m (T, 2) East, North; mode (T,); obstacles are outlines (P, 2) [m]; alert (T,) marks epochs with a ring;
    truth_en_m (K, 2) is the true trajectory, drawn as a line above all.

    Raises
    ------
    InputError
        Shapes do not fit, or positions are not finite.
    """
    position, modes = require_finite("position_en_m", position_en_m), np.asarray(mode)
    require_shape("mode", modes, (position.shape[0],))
    require_shape("position_en_m", position, (modes.shape[0], 2))
    outlines = [np.asarray(outline, dtype=np.float64) for outline in obstacles]
    figure = new_figure(*_map_size(np.concatenate([position, *outlines])))
    axes = figure.add_subplot()
    axes.plot(*position.T, color="#BBBBBB", linewidth=0.8, zorder=2)
    for present in sorted({Mode(int(code)) for code in np.unique(modes)}, key=lambda m: -int((modes == m).sum())):
        at = modes == present
        label = f"{present.label} ({100.0 * at.mean():.1f} %)"
        axes.scatter(
            position[at, 0], position[at, 1], s=12, color=mode_colour(present), linewidths=0, label=label, zorder=3
        )
    if alert is not None and np.any(alert):
        on = np.asarray(alert, dtype=np.bool_)
        axes.scatter(
            position[on, 0],
            position[on, 1],
            s=26,
            facecolors="none",
            edgecolors=LIMIT_COLOUR,
            linewidths=0.6,
            label="alert",
        )
    _mark_ends(axes, position)
    if truth_en_m is not None:
        truth = require_finite("truth_en_m", truth_en_m)
        require_shape("truth_en_m", truth, (truth.shape[0], 2))
        axes.plot(*truth.T, color=INK, linewidth=0.8, linestyle="--", label="truth", zorder=4)
    if outlines:
        _draw_obstacles(axes, outlines)
    tidy(axes, xlabel="East (m)", ylabel="North (m)")
    axes.set_title(title, fontsize=11, color=INK, loc="left")
    axes.set_aspect("equal", adjustable="datalim")
    names = legend(axes, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    for handle in names.legend_handles[: np.unique(modes).size]:
        handle.set_sizes([40.0])  # type: ignore[union-attr]  # the dots of the track are too small to tell colours
    return figure


def _draw_obstacles(axes: Axes, outlines: list[Array]) -> None:
    """Draw obstacles as grey shapes below everything, without gaps between them."""
    from matplotlib.collections import PolyCollection

    look = {"facecolor": BUILDING, "edgecolor": BUILDING, "linewidth": 0.4, "zorder": 0.5}
    axes.add_collection(PolyCollection(outlines, label="buildings, overpasses", **look))  # type: ignore[arg-type]


def _mark_ends(axes: Axes, position: Array) -> None:
    """Mark start and end of the drive."""
    for at, marker, label in ((position[0], "o", "first estimate"), (position[-1], "s", "last estimate")):
        look: dict[str, Any] = {"s": 64, "facecolors": "white", "edgecolors": INK, "linewidths": 1.6, "zorder": 5}
        axes.scatter(at[0], at[1], marker=marker, label=label, **look)


def _map_size(position: Array) -> tuple[float, float]:
    """Figure size [inch] for the extent of a trajectory."""
    east, north = np.maximum(np.ptp(position, axis=0), 1.0)
    height = float(np.clip(7.5 * north / east, 3.5, 9.0))
    return float(np.clip(height * east / north, 4.0, 7.5)) + 2.2, height
