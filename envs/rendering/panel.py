"""The instruments to the right of the map, from top to bottom, and the legend of the colours.

The in-vehicle display is a light of green, amber or red and its reason, above the picture of a drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.records import EgoBelief
from lanebound.envs.rendering.camera import Camera
from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.config import RenderingConfig
from lanebound.envs.rendering.frame import CAUTION_SHARE, EpisodeCost, Frame, Satellites, Status
from lanebound.envs.rendering.map_view import (
    NORTH_RAD,
    SHOWN_LEVEL_M,
    body_corners,
    camera_of,
    perceived_corners,
    status_colour,
)
from lanebound.envs.rendering.theme import Colour, Theme, mix
from lanebound.envs.rendering.trace import Trace
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.visibility import SignalPath

__all__ = [
    "DISPLAY_PX",
    "PanelPlace",
    "draw_error_box",
    "draw_legend",
    "draw_panel",
    "draw_sky",
    "draw_strip",
    "with_display",
]


Array = NDArray[np.float64]

HEAD_PX = 14
LETTERS = {System.GPS: "G", System.GALILEO: "E", System.GLONASS: "R", System.BEIDOU: "C", System.QZSS: "J"}  # RINEX 4
BOX_REACH = 1.6  # range of the error box in alert limits
STRIP_REACH = 1.6
POINTER_PX, POINTER_STEP_PX = 6.0, 18.0


@dataclass(frozen=True)
class PanelPlace:
    """A rectangle on the picture [px]."""

    x: float
    y: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Right edge [px]."""
        return self.x + self.width

    @property
    def bottom(self) -> float:
        """Lower edge [px]."""
        return self.y + self.height

    @property
    def middle(self) -> float:
        """Vertical coordinate of the middle [px]."""
        return self.y + 0.5 * self.height

    @property
    def corners(self) -> Array:
        """(4, 2) clockwise from the upper left."""
        return np.array([[self.x, self.y], [self.right, self.y], [self.right, self.bottom], [self.x, self.bottom]])

    def below_head(self) -> PanelPlace:
        """The part below a line of text."""
        return PanelPlace(self.x, self.y + HEAD_PX, self.width, self.height - HEAD_PX)


def path_colour(path: int, theme: Theme) -> Colour:
    """Colour of a propagation path."""
    return {
        SignalPath.LOS: theme.ok,
        SignalPath.FOLIAGE: theme.caution,
        SignalPath.REFLECTED: theme.alert,
        SignalPath.BLOCKED: theme.muted,
    }[SignalPath(path)]


def draw_sky(canvas: Canvas, at: PanelPlace, satellites: Satellites | None, up_rad: float, theme: Theme) -> None:
    """Draw the sky plot with the zenith in the middle and the horizon at the ring, in the orientation of the map.

    Discs are received satellites (filled if tracked), crosses are blocked ones; letters are those of RINEX; the key is
    in the corners.
    """
    head = "sky" if satellites is None else f"sky: {int(satellites.tracked.sum())} of {len(satellites.tracked)} tracked"
    canvas.text(at.x, at.y + 4, head, 11, theme.muted)
    plot = at.below_head()
    middle, radius = np.array([plot.x + 0.5 * plot.width, plot.middle]), 0.5 * plot.width - 9.0
    canvas.circle(middle, radius, theme.plot)
    for share in (1.0, 2.0 / 3.0, 1.0 / 3.0):
        canvas.circle(middle, share * radius, theme.grid, 0.5)
    for k in range(4):
        spoke = radius * _toward(k * 0.5 * np.pi, up_rad)
        canvas.line([middle + 0.04 * spoke, middle + spoke], theme.grid, 0.5)
    north = middle + (radius + 6.0) * _toward(0.0, up_rad)
    canvas.text(north[0], north[1], "N", 10, theme.muted, anchor="centre", bold=True)
    _draw_sky_key(canvas, plot, theme)
    if satellites is not None:
        _draw_satellites(canvas, middle, radius, satellites, up_rad, theme)


def _draw_sky_key(canvas: Canvas, plot: PanelPlace, theme: Theme) -> None:
    upper, lower = plot.y + 5, plot.bottom - 5
    canvas.text(plot.x, upper, "LOS", 9, path_colour(SignalPath.LOS, theme))
    canvas.text(plot.right, upper, "leaves", 9, path_colour(SignalPath.FOLIAGE, theme), anchor="right")
    canvas.text(plot.x, lower, "NLOS", 9, path_colour(SignalPath.REFLECTED, theme))
    canvas.text(plot.right, lower, "× blocked", 9, path_colour(SignalPath.BLOCKED, theme), anchor="right")


def _toward(azimuth_rad: float, up_rad: float) -> Array:
    """Unit vector on the screen in the direction of an azimuth, (2,)."""
    turn = azimuth_rad + NORTH_RAD - up_rad
    return np.array([np.sin(turn), -np.cos(turn)])


def _draw_satellites(
    canvas: Canvas, middle: Array, radius: float, satellites: Satellites, up_rad: float, theme: Theme
) -> None:
    s = satellites
    for row in np.flatnonzero(s.elevation_rad > 0.0):
        share = 1.0 - float(s.elevation_rad[row]) / (0.5 * np.pi)
        x, y = (middle + 0.95 * share * radius * _toward(float(s.azimuth_rad[row]), up_rad)).tolist()
        colour = path_colour(int(s.path[row]), theme)
        if s.path[row] == SignalPath.BLOCKED:
            for sign in (-1.0, 1.0):
                canvas.line([[x - 3, y - 3 * sign], [x + 3, y + 3 * sign]], colour, 1.0)
            continue
        canvas.circle((x, y), 5.5, colour if s.tracked[row] else theme.plot)
        canvas.circle((x, y), 5.5, colour, 1.5)
        ink = theme.panel if s.tracked[row] else colour
        canvas.text(x, y, LETTERS[System(int(s.system[row]))], 8, ink, anchor="centre", bold=True)


def draw_error_box(canvas: Canvas, at: PanelPlace, frame: Frame, theme: Theme) -> None:
    """The estimate in the middle with its levels and limits; the dot is the truth, ahead is up.

    Each axis has its own scale: the limits always form the same square. Triangles mark what lies beyond the edge.
    """
    outside = frame.exceeds_level
    head, ink = ("truth is outside PL", theme.crashed) if outside else ("truth in PL", theme.muted)
    canvas.text(at.x, at.y + 4, head if frame.belief.available else "truth", 11, ink, bold=outside)
    plot, b = at.below_head(), frame.belief
    canvas.box(plot.x, plot.y, plot.width, plot.height, theme.plot, round_px=4)
    middle, reach = np.array([plot.x + 0.5 * plot.width, plot.middle]), 0.5 * plot.width
    canvas.line([[plot.x, plot.middle], [plot.right, plot.middle]], theme.grid, 0.5)
    canvas.line([[middle[0], plot.y], [middle[0], plot.bottom]], theme.grid, 0.5)
    limit = reach / BOX_REACH
    level = np.array([b.pl_ct_m / b.al_ct_m, b.pl_at_m / b.al_at_m]) * limit
    half = np.minimum(level, reach - 1.0)
    colour = status_colour(frame.status, theme)
    canvas.blend(_square(middle, *half)[None], colour, 0.3)
    canvas.line(_square(middle, *half), colour, 1.5, closed=True)
    canvas.dashes(_square(middle, limit, limit), theme.limit, 1.0, on_px=4.0, closed=True)
    canvas.text(middle[0] + limit - 3, middle[1] - limit - 6, "AL", 9, theme.limit, anchor="right")
    at_m, ct_m = frame.error_m
    offset = np.array([-ct_m / b.al_ct_m, at_m / b.al_at_m]) * limit
    shown = np.clip(offset, 10.0 - reach, reach - 10.0)
    dot = middle + shown
    canvas.circle(dot, 5.0, theme.crashed if outside else theme.plot)
    canvas.circle(dot, 4.0 if not outside else 3.0, theme.ego)
    for axis, unit in enumerate(np.eye(2)):
        if level[axis] > half[axis]:
            for sign in (-1.0, 1.0):
                draw_pointer(canvas, middle + sign * (reach - 1.0) * unit, sign * unit, colour)
        if offset[axis] != shown[axis]:
            sign = float(np.sign(offset[axis]))
            draw_pointer(canvas, dot + sign * 10.0 * unit, sign * unit, theme.ego)


def draw_pointer(canvas: Canvas, tip_px: Array, toward: Array, colour: Colour) -> None:
    """A triangle with its tip at a point: what it marks lies beyond, in the direction of a unit vector (2,)."""
    base = tip_px - POINTER_PX * toward
    across = 0.6 * POINTER_PX * np.array([-toward[1], toward[0]])
    canvas.polygons(np.stack([tip_px, base + across, base - across])[None], colour)


def _square(middle: Array, half_x: float, half_y: float) -> Array:
    return np.asarray(middle + np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]]))


def draw_strip(
    canvas: Canvas,
    at: PanelPlace,
    name: str,
    trace: Trace,
    series: tuple[Array, Array, Array],
    now_s: float,
    window_s: float,
    theme: Theme,
) -> None:
    """|error| as an area, PL as a line, AL in dashes; times of alert have a tinted ground.

    Triangles at the upper edge mark the times of an error or a level above the scale.
    """
    head = canvas.text(at.x, at.y + 4, name, 11, theme.muted)
    plot = at.below_head()
    canvas.box(plot.x, plot.y, plot.width, plot.height, theme.plot, round_px=4)
    error, pl, al = series
    top = STRIP_REACH * float(al[-1]) if len(al) else 1.0
    x = plot.right - (now_s - trace.time_s) / window_s * plot.width
    with canvas.clip(plot.x, plot.y, plot.width, plot.height):
        _draw_alerts(canvas, plot, x, trace.alert, theme)
        _draw_scale(canvas, plot, top, theme)
        y_pl, y_error = (_height(plot, values, top) for values in (pl, np.abs(error)))
        upper, lower = np.stack([x, y_error], 1), np.stack([x, np.full_like(x, plot.bottom)], 1)
        if len(x) > 1:
            canvas.polygons(np.concatenate([upper, lower[::-1]])[None], mix(theme.plot, theme.ego, 0.6))
        canvas.dashes(np.stack([x, _height(plot, al, top)], 1), theme.limit, 1.0)
        canvas.line(np.stack([x, y_pl], 1), theme.caution, 1.75)
        _draw_pointers(canvas, plot.y + 2.0, x[pl > top], theme.caution)
        _draw_pointers(canvas, plot.y + POINTER_PX + 4.0, x[np.abs(error) > top], theme.ego)
    key = at.right
    pl_key = "PL (▲ above)" if (pl > top).any() else "PL"
    for words, colour in (("AL", theme.limit), (pl_key, theme.caution), ("|error|", theme.ego)):
        key -= canvas.text(key, at.y + 4, words, 10, colour, anchor="right") + 8
    if len(al):
        canvas.text(at.x + head + 8, at.y + 4, f"0 to {top:.1f} m, {window_s:g} s", 10, theme.muted)


def _draw_pointers(canvas: Canvas, y: float, x: Array, colour: Colour) -> None:
    """Triangles upwards at some of these places, not closer than ``POINTER_STEP_PX``."""
    last = -np.inf
    for place in x[::-1]:  # from now backwards
        if abs(place - last) >= POINTER_STEP_PX:
            draw_pointer(canvas, np.array([place - 0.6 * POINTER_PX, y]), np.array([0.0, -1.0]), colour)
            last = place


def _draw_alerts(canvas: Canvas, plot: PanelPlace, x: Array, alert: NDArray[np.bool_], theme: Theme) -> None:
    change = np.flatnonzero(np.diff(np.concatenate([[False], alert, [False]]).astype(np.int8)))
    for begin, end in change.reshape(-1, 2):
        left = x[begin]
        right = x[end] if end < len(x) else plot.right
        canvas.box(left, plot.y, right - left, plot.height, mix(theme.plot, theme.alert, 0.28))


def _draw_scale(canvas: Canvas, plot: PanelPlace, top: float, theme: Theme) -> None:
    """Draw a line at each whole or half metre."""
    step = 0.5 if top < 3.0 else np.ceil(top / 5.0)
    for value in np.arange(step, top, step):
        y = float(plot.bottom - value / top * plot.height)
        canvas.line([[plot.x, y], [plot.right, y]], theme.grid, 0.5)


def _height(plot: PanelPlace, values: Array, top: float) -> Array:
    """Vertical coordinates of values; values above the scale are at the upper edge."""
    return np.asarray(plot.bottom - np.minimum(values / top, 1.0 - 1.5 / plot.height) * plot.height)


DISPLAY_PX = 44  # a multiple of 4, which video codecs want


def with_display(
    picture: NDArray[np.uint8], light: str, advice: str, road: str, score: float, theme: Theme
) -> NDArray[np.uint8]:
    """The picture (H, W, 3) below a bar (DISPLAY_PX, W, 3): light, what it means, road and score."""
    width = picture.shape[1]
    colour = {"green": theme.ok, "amber": theme.caution, "red": theme.alert}[light]
    canvas = Canvas(width, DISPLAY_PX, 2)
    canvas.fill(mix(theme.panel, colour, 0.25))
    canvas.box(10, 10, DISPLAY_PX - 20, DISPLAY_PX - 20, colour, round_px=0.5 * DISPLAY_PX - 10)
    _write(canvas, advice, f"{road or 'no road'}   score {score:.0f}", theme)
    canvas.finish()
    return np.concatenate([canvas.pixels(), picture])


def _write(canvas: Canvas, advice: str, right: str, theme: Theme) -> None:
    """Write the advice next to the light, and road and score at the right."""
    width, middle = canvas.size_px[0], 0.5 * DISPLAY_PX
    canvas.text(DISPLAY_PX + 4, middle, advice, 13, theme.text, bold=True)
    canvas.text(width - 12, middle, right, 11, theme.text, anchor="right")


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
