"""The instruments to the right of the map, from top to bottom, and the legend of the colours."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lanebound.envs.records import EgoBelief
from lanebound.envs.rendering.camera import Camera
from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.config import RenderingConfig
from lanebound.envs.rendering.frame import CAUTION_SHARE, EpisodeCost, Frame, Status
from lanebound.envs.rendering.instruments import PanelPlace, draw_error_box, draw_sky, draw_strip
from lanebound.envs.rendering.map_view import (
    SHOWN_LEVEL_M,
    body_corners,
    camera_of,
    perceived_corners,
    status_colour,
)
from lanebound.envs.rendering.theme import Colour, Theme, mix
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["draw_legend", "draw_panel"]

MARGIN = 10
LEAST_STRIP_PX = 56
FIGURES_PX = 98
HEAD_GAP_PX = 12
REASONS = {
    AlertReason.PL_AT: "along-track PL over limit",
    AlertReason.PL_CT: "cross-track PL over limit",
    AlertReason.BOTH: "both PLs over limit",
    AlertReason.NO_SOLUTION: "no solution",
    AlertReason.INTEGRITY_TEST_FAILED: "integrity test failed",
    AlertReason.ACCURACY: "accuracy not met",
    AlertReason.INITIALISING: "initialising",
    AlertReason.NOT_CONVERGED: "not converged",
    AlertReason.HOLDING: "holding",
    AlertReason.CONTEXT_WARNING: "context monitor warns",
}
RTK_WORDS = {
    RtkStatus.FIXED: "fixed, waiting",
    RtkStatus.NO_CORRECTIONS: "no corrections",
    RtkStatus.TOO_FEW: "too few satellites",
    RtkStatus.NOT_CONVERGED: "not converged",
    RtkStatus.RATIO_FAILED: "ratio test failed",
    RtkStatus.FAULT: "refused by a test",
    RtkStatus.SEARCH_FAILED: "search failed",
}
"""Why the position is not RTK; a jump that the jump monitor refuses is a failed test too."""


class LegendEntry(NamedTuple):
    """One key of the legend: its name, how the map draws it, and its colour."""

    name: str
    kind: str
    colour: Colour


def draw_panel(canvas: Canvas, frame: Frame, config: RenderingConfig, theme: Theme) -> None:
    """Draw status, figures, sky plot, error box and strip charts, as far as the height allows."""
    if not config.panel_width_px:
        return
    x, width, height = config.map_width_px, config.panel_width_px, config.height_px
    canvas.box(x, 0, width, height, theme.panel)
    x, width = x + MARGIN, width - 2 * MARGIN
    _draw_head(canvas, PanelPlace(x, 8, width, 16), frame, theme)
    _draw_badge(canvas, PanelPlace(x, 30, width, 34), frame, theme)
    _draw_figures(canvas, PanelPlace(x, 72, width, FIGURES_PX), frame, theme)
    side, plots = 0.5 * (width - MARGIN), 80 + FIGURES_PX
    plots_end = plots + side + 14
    if plots_end <= height:
        up = camera_of(frame, config).up_rad
        draw_sky(canvas, PanelPlace(x, plots, side, side + 14), frame.satellites, up, theme)
        draw_error_box(canvas, PanelPlace(x + side + MARGIN, plots, side, side + 14), frame, theme)
    each = 0.5 * (height - plots_end - 8) - 8
    if each >= LEAST_STRIP_PX:
        t, now = frame.trace, frame.time_s
        for k, (name, series) in enumerate(
            (
                ("along track", (t.err_at_m, t.pl_at_m, t.al_at_m)),
                ("cross track", (t.err_ct_m, t.pl_ct_m, t.al_ct_m)),
            )
        ):
            place = PanelPlace(x, plots_end + 8 + k * (each + 8), width, each)
            draw_strip(canvas, place, name, t, series, now, config.window_s, theme)


def _draw_head(canvas: Canvas, at: PanelPlace, frame: Frame, theme: Theme) -> None:
    """The time on the right, the incident left of it, and as much of the title as the rest of the line holds."""
    right = at.right - HEAD_GAP_PX
    right -= canvas.text(at.right, at.middle, f"{frame.time_s:.1f} s", 12, theme.muted, anchor="right")
    if frame.incident:
        right -= canvas.text(right, at.middle, frame.incident, 12, theme.alert, anchor="right", bold=True) + HEAD_GAP_PX
    title = _fitting(canvas, frame.title, right - at.x)
    canvas.text(at.x, at.middle, title, 12, theme.text, bold=True)


def _fitting(canvas: Canvas, title: str, width: float) -> str:
    """A title, without its namespace where that is too wide, and cut where that is too wide as well."""
    _, _, short = title.rpartition("/")
    cut = (f"{short[:n]}…" for n in range(len(short) - 1, -1, -1))
    return next((words for words in (title, short, *cut) if canvas.width_of(words, 12, bold=True) <= width), "")


def _draw_badge(canvas: Canvas, at: PanelPlace, frame: Frame, theme: Theme) -> None:
    """Draw the status light with its word and reason: of the navigation only, from the estimated state."""
    status = frame.status
    colour = status_colour(status, theme)
    canvas.box(at.x, at.y, at.width, at.height, mix(theme.panel, colour, 0.28), round_px=6)
    canvas.box(at.x, at.y, 6, at.height, colour, round_px=3)
    width = canvas.text(at.x + 16, at.middle, status.value, 15, theme.text, bold=True)
    left = at.width - width - 40
    why = _reason(frame)
    size = 11 if canvas.width_of(why, 11) <= left else 10
    canvas.text(at.right - 10, at.middle, why, size, theme.text, anchor="right")


def _reason(frame: Frame) -> str:
    b = frame.belief
    if frame.status is Status.CAUTION:
        return f"a PL is over {CAUTION_SHARE:.0%} of its limit"
    if frame.status is Status.NORMAL:
        return "navigation within limits"
    reason = AlertReason.from_code(b.reason)
    return REASONS.get(reason, "position not available")


def _draw_figures(canvas: Canvas, at: PanelPlace, frame: Frame, theme: Theme) -> None:
    """Two columns of names and values; costs have no unit."""
    b, cost = frame.belief, frame.cost
    left = (
        ("speed", f"{3.6 * frame.speed_mps:.0f} km/h", theme.text),
        ("PL AT", _level(b.pl_at_m, b.al_at_m), _level_colour(b.pl_at_m, b.al_at_m, theme)),
        ("PL CT", _level(b.pl_ct_m, b.al_ct_m), _level_colour(b.pl_ct_m, b.al_ct_m, theme)),
        ("last RTK", _ago(b), theme.text),
        ("cost, last step", "–" if cost is None else f"{cost.step:.2f}", theme.text),
        ("cost, episode", "–" if cost is None else f"{cost.episode:.2f}", _cost_colour(cost, theme)),
    )
    right = (
        ("mode", Mode(b.mode).label, theme.text),
        ("RTK", _rtk(b), theme.text),
        ("satellites used", f"{_used(b)}", theme.text),
        ("corrections", _age(b.corrections_age_s), theme.text),
        ("cost limit", "–" if cost is None else f"{cost.limit:g}", theme.text),
        ("", "", theme.text),
    )
    row = at.height / len(left)
    half = 0.5 * (at.width - 2 * MARGIN)
    for x, column in ((at.x, left), (at.right - half, right)):
        for k, (name, value, colour) in enumerate(column):
            y = at.y + (k + 0.5) * row
            canvas.text(x, y, name, 11, theme.muted)
            canvas.text(x + half, y, value, 11, colour, anchor="right")


def _cost_colour(cost: EpisodeCost | None, theme: Theme) -> Colour:
    return theme.alert if cost is not None and cost.episode > cost.limit else theme.text


def _used(b: EgoBelief) -> int:
    """Number of satellites used for the position; none between fixes with IMU and odometer."""
    if Mode(b.mode).is_service:
        return b.satellites
    return {Mode.RTK: b.satellites, Mode.DOPPLER: b.satellites_doppler}.get(Mode(b.mode), 0)


def _level(pl_m: float, al_m: float) -> str:
    shown = "none" if math.isinf(pl_m) else f"{pl_m:.2f}"
    return f"{shown} / {al_m:.2f} m"


def _level_colour(pl_m: float, al_m: float, theme: Theme) -> Colour:
    if pl_m > al_m:
        return theme.alert
    return theme.caution if pl_m > CAUTION_SHARE * al_m else theme.text


def _rtk(b: EgoBelief) -> str:
    """Whether the position is RTK, else why not."""
    return "fixed" if b.mode == Mode.RTK else RTK_WORDS[RtkStatus.from_code(b.rtk)]


def _ago(b: EgoBelief) -> str:
    return "never" if math.isinf(b.since_rtk_s) else f"{b.since_rtk_s:.1f} s ago"


def _age(age_s: float) -> str:
    return "none" if math.isinf(age_s) else f"{age_s:.1f} s old"


def draw_legend(canvas: Canvas, frame: Frame, camera: Camera, config: RenderingConfig, theme: Theme) -> None:
    """The key to what is on the map, at its foot, in one or two lines; none where two lines do not hold it."""
    lines: list[list[tuple[LegendEntry, int]]] = [[]]
    left = most = config.map_width_px - 22
    for entry in legend_entries(frame, camera, theme):
        width = canvas.width_of(entry.name, 11) + 34
        if width > left:
            lines, left = [*lines, []], most
        lines[-1].append((entry, width))
        left -= width
    if len(lines) > 2 or not all(lines):
        return
    for k, line in enumerate(reversed(lines)):
        y, x = config.height_px - 19.0 - 24.0 * k, 8.0
        canvas.box(x, y - 11, sum(width for _, width in line) + 6, 22, theme.panel, round_px=5)
        x += 10
        for entry, width in line:
            _draw_key(canvas, PanelPlace(x, y - 4.5, 16, 9), entry.kind, entry.colour, theme)
            canvas.text(x + 21, y, entry.name, 11, theme.text)
            x += width


def legend_entries(frame: Frame, camera: Camera, theme: Theme) -> list[LegendEntry]:
    """What the map shows, and how it is drawn."""
    b, bodies, t = frame.belief, frame.bodies, frame.traffic
    shown, status = camera.shows(body_corners(bodies)), status_colour(frame.status, theme)
    perceived = camera.shows(perceived_corners(t))
    bounded = np.isfinite(t.pl_at_m + t.pl_ct_m)
    level = max(b.pl_at_m, b.pl_ct_m)
    name = "no PL" if math.isinf(level) else "its PL" if level <= SHOWN_LEVEL_M else f"its PL, over {SHOWN_LEVEL_M:g} m"
    others = np.arange(len(bodies)) != frame.ego
    entries = (
        (not bodies.crashed[frame.ego], LegendEntry("ego", "body", theme.ego)),
        (True, LegendEntry("believed", "outline", theme.ego_belief)),
        (True, LegendEntry(name, "blend" if level <= SHOWN_LEVEL_M else "broken", status)),
        (True, LegendEntry("alert limit", "dashes", theme.limit)),
        ((shown & others & ~bodies.crashed).any(), LegendEntry("traffic", "body", theme.other)),
        ((perceived & bounded).any(), LegendEntry("perceived + PL", "levels", theme.other_belief)),
        ((perceived & ~bounded).any(), LegendEntry("perceived, no PL", "broken", theme.other_belief)),
        ((shown & bodies.crashed).any(), LegendEntry("crashed", "body", theme.crashed)),
    )
    return [entry for present, entry in entries if present]


def _draw_key(canvas: Canvas, at: PanelPlace, kind: str, colour: Colour, theme: Theme) -> None:
    """Draw a symbol of the legend as on the map, on the colour of the road."""
    if kind != "body":
        canvas.box(at.x - 2, at.y - 2, at.width + 4, at.height + 4, theme.road)
    if kind == "body":
        canvas.box(at.x, at.y, at.width, at.height, colour, round_px=2)
    elif kind == "outline":
        canvas.line(at.corners, colour, 1.5, closed=True)
    elif kind == "broken":
        canvas.dashes(at.corners, colour, 1.5, on_px=3.0, closed=True)
    elif kind == "blend":
        canvas.blend(at.corners[None], colour, 0.3)
        canvas.line(at.corners, colour, 1.5, closed=True)
    elif kind == "levels":
        canvas.box(at.x + 3, at.y + 2, at.width - 6, at.height - 4, theme.other)
        canvas.blend(at.corners[None], colour, 0.12)
        canvas.line(at.corners, colour, 0.5, closed=True)
        inner = PanelPlace(at.x + 3, at.y + 2, at.width - 6, at.height - 4)
        canvas.line(inner.corners, colour, 1.5, closed=True)
    else:
        canvas.blend(at.corners[None], colour, 0.10)
        for y in (at.y, at.bottom):
            canvas.dashes([[at.x, y], [at.right, y]], colour, 2.0, on_px=3.5)
