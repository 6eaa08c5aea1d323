"""The instruments to the right of the map, from top to bottom, and the legend of the colours."""

from __future__ import annotations

import math

from lanebound.envs.records import EgoBelief
from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.config import RenderingConfig
from lanebound.envs.rendering.frame import CAUTION_SHARE, Frame, Status
from lanebound.envs.rendering.instruments import PanelPlace, draw_error_box, draw_sky, draw_strip
from lanebound.envs.rendering.map_view import camera_of, status_colour
from lanebound.envs.rendering.theme import Colour, Theme, mix
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["draw_legend", "draw_panel"]

MARGIN = 10
LEAST_STRIP_PX = 56
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
}


def draw_panel(canvas: Canvas, frame: Frame, config: RenderingConfig, theme: Theme) -> None:
    """Draw status, figures, sky plot, error box and strip charts, as far as the height allows."""
    if not config.panel_width_px:
        return
    x, width, height = config.map_width_px, config.panel_width_px, config.height_px
    canvas.box(x, 0, width, height, theme.panel)
    x, width = x + MARGIN, width - 2 * MARGIN
    _draw_head(canvas, PanelPlace(x, 8, width, 16), frame, theme)
    _draw_badge(canvas, PanelPlace(x, 30, width, 34), frame, theme)
    _draw_figures(canvas, PanelPlace(x, 72, width, 66), frame, theme)
    side = 0.5 * (width - MARGIN)
    plots_end = 146 + side + 14
    if plots_end <= height:
        up = camera_of(frame, config).up_rad
        draw_sky(canvas, PanelPlace(x, 146, side, side + 14), frame.satellites, up, theme)
        draw_error_box(canvas, PanelPlace(x + side + MARGIN, 146, side, side + 14), frame, theme)
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
    canvas.text(at.x, at.middle, frame.title, 12, theme.text, bold=True)
    canvas.text(at.right, at.middle, f"{frame.time_s:.1f} s", 12, theme.muted, anchor="right")


def _draw_badge(canvas: Canvas, at: PanelPlace, frame: Frame, theme: Theme) -> None:
    """Draw the status light with its word and reason, from the estimated state."""
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
        return "PLs within limits"
    reason = AlertReason.from_code(b.reason)
    return REASONS.get(reason, "position not available")


def _draw_figures(canvas: Canvas, at: PanelPlace, frame: Frame, theme: Theme) -> None:
    """Draw two columns of names and values."""
    b = frame.belief
    left = (
        ("speed", f"{3.6 * frame.speed_mps:.0f} km/h", theme.text),
        ("PL AT", _level(b.pl_at_m, b.al_at_m), _level_colour(b.pl_at_m, b.al_at_m, theme)),
        ("PL CT", _level(b.pl_ct_m, b.al_ct_m), _level_colour(b.pl_ct_m, b.al_ct_m, theme)),
        ("cost", "–" if frame.cost is None else f"{frame.cost:.2f}", theme.text),
    )
    right = (
        ("mode", Mode(b.mode).label, theme.text),
        ("RTK", _rtk(b), theme.text),
        ("satellites used", f"{_used(b)}", theme.text),
        ("corrections", _age(b.corrections_age_s), theme.text),
    )
    row = at.height / 4.0
    half = 0.5 * (at.width - 2 * MARGIN)
    for x, column in ((at.x, left), (at.right - half, right)):
        for k, (name, value, colour) in enumerate(column):
            y = at.y + (k + 0.5) * row
            canvas.text(x, y, name, 11, theme.muted)
            canvas.text(x + half, y, value, 11, colour, anchor="right")


def _used(b: EgoBelief) -> int:
    """Number of satellites used for the position; none between fixes with IMU and odometer."""
    return {Mode.RTK: b.satellites, Mode.DOPPLER: b.satellites_doppler}.get(Mode(b.mode), 0)


def _level(pl_m: float, al_m: float) -> str:
    shown = "none" if math.isinf(pl_m) else f"{pl_m:.2f}"
    return f"{shown} / {al_m:.2f} m"


def _level_colour(pl_m: float, al_m: float, theme: Theme) -> Colour:
    if pl_m > al_m:
        return theme.alert
    return theme.caution if pl_m > CAUTION_SHARE * al_m else theme.text


def _rtk(b: EgoBelief) -> str:
    if RtkStatus.from_code(b.rtk) is RtkStatus.FIXED and b.mode == Mode.RTK:
        return "fixed"
    return "never fixed" if math.isinf(b.since_rtk_s) else f"{b.since_rtk_s:.1f} s ago"


def _age(age_s: float) -> str:
    return "none" if math.isinf(age_s) else f"{age_s:.1f} s old"


def draw_legend(canvas: Canvas, status: Status, config: RenderingConfig, theme: Theme) -> None:
    """Draw the legend in one line at the bottom of the map, in the colours of the picture."""
    entries = (
        ("ego", "body", theme.ego),
        ("believed", "outline", theme.ego_belief),
        ("its PL", "blend", status_colour(status, theme)),
        ("alert limit", "dashes", theme.limit),
        ("traffic", "body", theme.other),
        ("perceived + PL", "levels", theme.other_belief),
        ("crashed", "body", theme.crashed),
    )
    widths = [canvas.width_of(name, 11) + 34 for name, _, _ in entries]
    total = sum(widths) + 6
    if total > config.map_width_px - 16:
        return
    y, x = config.height_px - 19.0, 8.0
    canvas.box(x, y - 11, total, 22, theme.panel, round_px=5)
    x += 10
    for (name, kind, colour), width in zip(entries, widths, strict=True):
        _draw_key(canvas, PanelPlace(x, y - 4.5, 16, 9), kind, colour, theme)
        canvas.text(x + 21, y, name, 11, theme.text)
        x += width


def _draw_key(canvas: Canvas, at: PanelPlace, kind: str, colour: Colour, theme: Theme) -> None:
    """Draw a symbol of the legend as on the map, on the colour of the road."""
    if kind != "body":
        canvas.box(at.x - 2, at.y - 2, at.width + 4, at.height + 4, theme.road)
    if kind == "body":
        canvas.box(at.x, at.y, at.width, at.height, colour, round_px=2)
    elif kind == "outline":
        canvas.line(at.corners, colour, 1.5, closed=True)
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
