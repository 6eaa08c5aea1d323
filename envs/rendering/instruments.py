"""Three plots: sky plot, error box and strip charts of the last seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.frame import Frame, Satellites
from lanebound.envs.rendering.map_view import NORTH_RAD, status_colour
from lanebound.envs.rendering.theme import Colour, Theme, mix
from lanebound.envs.rendering.trace import Trace
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.visibility import SignalPath

__all__ = ["PanelPlace", "draw_error_box", "draw_sky", "draw_strip"]

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
