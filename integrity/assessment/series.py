"""Errors and protection levels over time, mode by mode (the form of S1 Figs. 3-4), and a map coloured by mode."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.assessment.plotting import (
    INK,
    LIMIT_COLOUR,
    MODE_COLOURS,
    PL_COLOUR,
    legend,
    new_figure,
    tidy,
)
from lanebound.integrity.assessment.record import AXES, Axis, Record
from lanebound.integrity.errors import InputError, require_finite, require_shape
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["map_figure", "series_figure"]

Array = NDArray[np.float64]

RTK_SCALE_M = 0.5  # S1 section 5: the RTK panels have a smaller error scale
PANELS = (Mode.RTK, Mode.DOPPLER, Mode.IMU_ODOMETER)


def series_figure(
    record: Record, *, risk: float | None = None, al_at_m: float | None = None, al_ct_m: float | None = None
) -> Figure:
    """Absolute error and protection level of one vehicle against time: AT left, CT right; all modes, then each of them.

    Raises
    ------
    InputError
        The record holds more than one vehicle.
    """
    if np.ndim(record.error_at_m) != 1:
        raise InputError(
            f"record must hold one vehicle, (T,), got {np.shape(record.error_at_m)}: select a column first"
        )
    figure = new_figure(11.0, 9.0)
    title = "Position error and protection level" + (f", integrity risk {_power_of_ten(risk)}" if risk else "")
    figure.suptitle(title, fontsize=12, color=INK)
    grid = figure.subplots(1 + len(PANELS), 2, sharex=True, squeeze=False)
    for column, (axis, al) in enumerate(zip(AXES, (al_at_m, al_ct_m), strict=True)):
        top = _scale(record, axis, record.mode != Mode.NONE, al)
        _all_modes(grid[0, column], record, axis, al, top)
        for row, mode in enumerate(PANELS, start=1):
            _one_mode(grid[row, column], record, axis, mode)
        grid[-1, column].set_xlabel("time (min)", fontsize=9)
        grid[0, column].set_title(f"{'along' if axis == 'at' else 'cross'} track", fontsize=10, color=INK, loc="left")
        grid[0, column].set_xlim(0.0, max(float(_minutes(record)[-1]), 1e-3))
    return figure


def _minutes(record: Record) -> Array:
    return np.asarray((record.time_s - record.time_s[0]) / 60.0)


def _scale(record: Record, axis: Axis, keep: NDArray[np.bool_], al: float | None = None) -> float:
    """Top of a panel: everything but the wildest 0.5 % of the levels, all errors, and the alert limit."""
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
    for mode in Mode:
        axes.fill_between(
            minutes, 0.965, 1.0, where=(record.mode == mode).tolist(), step="post", linewidth=0,
            color=MODE_COLOURS[mode], transform=axes.get_xaxis_transform(), zorder=4,
        )  # fmt: skip


def _one_mode(axes: Axes, record: Record, axis: Axis, mode: Mode) -> None:
    keep = np.asarray(record.mode == mode)
    top = RTK_SCALE_M if mode is Mode.RTK else _scale(record, axis, keep)
    _draw(axes, _minutes(record), record.error(axis), record.pl(axis), keep, MODE_COLOURS[mode], "error")
    tidy(axes, ylabel=f"{mode.label}, {axis.upper()} (m)", ylim=(0, top))  # type: ignore[arg-type]
    above = int((keep & ((record.error(axis) > top) | (record.pl(axis) > top))).sum())
    share = f"{100.0 * keep.mean():.1f} % of epochs" + (f", {above:,} above the scale" if above else "")
    backdrop = {"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.5}
    axes.text(0.01, 0.96, share, transform=axes.transAxes, fontsize=8, color=INK, va="top", zorder=5, bbox=backdrop)
    if not keep.any():
        axes.text(0.5, 0.5, "mode not used", transform=axes.transAxes, ha="center", fontsize=9, color="#777777")


def _draw(
    axes: Axes, minutes: Array, error: Array, pl: Array, keep: NDArray[np.bool_], colour: str, label: str
) -> None:
    """Level as a line over the filled error; epochs of other modes leave gaps."""
    shown = np.where(keep, error, np.nan)
    axes.fill_between(minutes, 0.0, shown, color=colour, alpha=0.35, linewidth=0, step="mid")
    axes.plot(minutes, shown, color=colour, linewidth=0.7, label=label)
    axes.plot(minutes, np.where(keep & np.isfinite(pl), pl, np.nan), color=PL_COLOUR, linewidth=1.1, label="PL")


def _power_of_ten(risk: float) -> str:
    exponent = round(float(np.log10(risk)))
    return f"$10^{{{exponent}}}$" if np.isclose(risk, 10.0**exponent) else f"{risk:g}"


def map_figure(
    position_en_m: ArrayLike,
    mode: ArrayLike,
    *,
    title: str = "",
    obstacles: Iterable[ArrayLike] = (),
    alert: ArrayLike | None = None,
) -> Figure:
    """Trajectory coloured by mode over building outlines.

    position_en_m (T, 2) East, North; mode (T,); obstacles are outlines (P, 2) [m]; alert (T,) marks epochs with a ring.

    Raises
    ------
    InputError
        Shapes that do not fit, or non-finite positions.
    """
    position, modes = require_finite("position_en_m", position_en_m), np.asarray(mode)
    require_shape("mode", modes, (position.shape[0],))
    require_shape("position_en_m", position, (modes.shape[0], 2))
    figure = new_figure(*_map_size(position))
    axes = figure.add_subplot()
    for outline in obstacles:
        axes.fill(*np.asarray(outline, dtype=np.float64).T, color="#E4E1DC", edgecolor="#C9C4BC", linewidth=0.4)
    axes.plot(*position.T, color="#BBBBBB", linewidth=0.8, zorder=2)
    for present in sorted({Mode(int(code)) for code in np.unique(modes)}, key=lambda m: -int((modes == m).sum())):
        at = modes == present
        label = f"{present.label} ({100.0 * at.mean():.1f} %)"
        axes.scatter(
            position[at, 0], position[at, 1], s=9, color=MODE_COLOURS[present], linewidths=0, label=label, zorder=3
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
    tidy(axes, xlabel="East (m)", ylabel="North (m)")
    axes.set_title(title, fontsize=11, color=INK, loc="left")
    axes.set_aspect("equal", adjustable="datalim")
    legend(axes, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False, markerscale=2.0)
    return figure


def _map_size(position: Array) -> tuple[float, float]:
    """Inches that suit the extent of a trajectory."""
    east, north = np.maximum(np.ptp(position, axis=0), 1.0)
    height = float(np.clip(7.5 * north / east, 3.5, 9.0))
    return float(np.clip(height * east / north, 4.0, 7.5)) + 2.2, height
