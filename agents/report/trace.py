"""Errors and protection levels of one episode over time, both axes, with alerts and modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lanebound.agents.report.svg import Frame, Scale, axes, line, path_of, picture, tag
from lanebound.integrity.assessment.plotting import MODE_COLOURS
from lanebound.integrity.assessment.record import AXES, Axis, Record
from lanebound.integrity.positioning.modes import Mode

__all__ = ["Trace", "trace"]

WIDTH, PANEL, GAP = 340.0, 92.0, 42.0
LEFT, TOP, RIGHT = 30.0, 30.0, 336.0
STRIP_PX = 6.0
LEVEL_QUANTILE = 0.98  # of the levels within the scale
LIMITS_SHOWN = 3.0  # the scale goes no further than this many alert limits for levels alone


@dataclass(frozen=True)
class Trace:
    """An episode: belief and truth after every decision, and its alert limits [m]."""

    record: Record
    al_at_m: float
    al_ct_m: float

    def limit_m(self, axis: Axis) -> float:
        """The alert limit of an axis."""
        return self.al_at_m if axis == "at" else self.al_ct_m


def trace(episode: Trace, title: str) -> Markup:
    """Two panels over one time: error filled, level a line, alert limit dashed; strips above show modes and alerts."""
    height = TOP + 2 * PANEL + GAP + 32.0
    parts: list[Markup] = []
    for i, axis in enumerate(AXES):
        top = TOP + i * (PANEL + GAP)
        parts += _panel(episode, axis, Frame(LEFT, top, RIGHT, top + PANEL), "time (s)" if i else "")
    return picture(WIDTH, height, f"{title}. {_said(episode)}", *parts)


def _panel(episode: Trace, axis: Axis, frame: Frame, x_label: str) -> list[Markup]:
    record, al = episode.record, episode.limit_m(axis)
    time, error, pl = record.time_s, record.error(axis), record.pl(axis)
    x = frame.across(0.0, float(time[-1]))
    y = frame.up(0.0, _top(error, pl, al))
    outline = [(x(float(t)), y.held(float(e))) for t, e in zip(time, error, strict=True)]
    ground = [(outline[-1][0], frame.bottom), (outline[0][0], frame.bottom)]
    levels = [(x(float(t)), y.held(float(v))) for t, v in zip(time, pl, strict=True)]
    return [
        *_spans(record.alert, time, x, lambda a, b: _box(a, frame.top, b - a, frame.bottom - frame.top, "alerted")),
        *axes(frame, x, y, x_label, f"{axis.upper()} (m)", (6, 3)),
        tag("path", d=path_of([*outline, *ground]) + "z", class_="error"),
        tag("path", d=path_of(levels), class_="level"),
        line(frame.left, y.held(al), frame.right, y.held(al), "limit"),
        *_modes(record, time, x, frame.top - STRIP_PX),
    ]


def _top(error: NDArray[np.float64], pl: NDArray[np.float64], al: float) -> float:
    """Top of a panel: the alert limit, all errors, and all but the wildest levels."""
    finite = pl[np.isfinite(pl)]
    level = float(np.quantile(finite, LEVEL_QUANTILE)) if finite.size else 0.0
    return 1.08 * max(1.15 * al, float(error.max()), min(level, LIMITS_SHOWN * al))


def _spans(
    on: NDArray[np.bool_], time: NDArray[np.float64], x: Scale, draw: Callable[[float, float], Markup]
) -> list[Markup]:
    """What ``draw`` makes of each uninterrupted stretch, from the decision before it to its last [px]."""
    change = np.diff(np.concatenate([[0], np.asarray(on, dtype=int), [0]]))
    starts, ends = np.nonzero(change == 1)[0], np.nonzero(change == -1)[0]
    before = np.concatenate([[0.0], time])
    return [draw(x(float(before[a])), x(float(time[b - 1]))) for a, b in zip(starts, ends, strict=True)]


def _box(x: float, y: float, width: float, height: float, class_: str | None, fill: str | None = None) -> Markup:
    return tag("rect", x=x, y=y, width=width, height=height, class_=class_, fill=fill)


def _modes(record: Record, time: NDArray[np.float64], x: Scale, top: float) -> list[Markup]:
    """A strip of the colours of the modes."""
    return [
        piece
        for mode in Mode
        for piece in _spans(
            np.asarray(record.mode == mode),
            time,
            x,
            lambda a, b, mode=mode: _box(a, top, b - a, STRIP_PX, None, MODE_COLOURS[mode]),  # type: ignore[misc]
        )
    ]


def _said(episode: Trace) -> str:
    """The trace in words."""
    record, words = episode.record, []
    for axis in AXES:
        beyond = float((record.error(axis) > episode.limit_m(axis)).mean())
        unbounded = float((record.error(axis) > record.pl(axis)).mean())
        words.append(
            f"{axis.upper()}: error up to {record.error(axis).max():.2f} m, beyond the alert limit of "
            f"{episode.limit_m(axis):g} m {100 * beyond:.0f} % of the time, beyond its level {100 * unbounded:.0f} %"
        )
    shares = [f"{mode.label} {100 * float((record.mode == mode).mean()):.0f} %" for mode in _present(record)]
    alert = f"alert on {100 * float(record.alert.mean()):.0f} % of the time"
    return "; ".join([*words, "position from " + ", ".join(shares), alert])


def _present(record: Record) -> Sequence[Mode]:
    return [mode for mode in Mode if (record.mode == mode).any()]
