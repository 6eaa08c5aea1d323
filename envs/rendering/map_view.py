"""The map: roads, buildings, true vehicles as filled bodies, estimated vehicles as outlines with protection levels.

A box is the body at the estimated position, enlarged by the protection levels. The corridor is the swept width of the
body, enlarged by the alert limit. The true body is inside the box unless an error exceeds its level. The box is inside
the corridor while the cross-track level is below its limit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.records import Traffic
from lanebound.envs.rendering.camera import Camera, oriented_box, quads_along
from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.config import Orientation, RenderingConfig
from lanebound.envs.rendering.frame import Bodies, Frame, Status
from lanebound.envs.rendering.roads import RoadDrawing, corridor
from lanebound.envs.rendering.scenery import Scenery
from lanebound.envs.rendering.theme import Colour, Theme, mix

__all__ = ["SHOWN_LEVEL_M", "body_corners", "camera_of", "draw_map", "perceived_corners", "status_colour"]

Array = NDArray[np.float64]

NORTH_RAD = -0.5 * np.pi
EGO_FROM_TOP = 0.66  # with heading up, more of the road ahead is visible than behind
TALL_M = 45.0  # height above which a roof has the brightest colour
SHADOW_M = 0.14  # per metre of height
SHADOW_MAX_M = 4.0
BEHIND_M, AHEAD_M = 12.0, 45.0
SHOWN_LEVEL_M = 12.0  # larger levels are drawn with this size as dashed lines
ROUND = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 17)[:-1]), np.sin(np.linspace(0.0, 2.0 * np.pi, 17)[:-1])], -1)


def camera_of(frame: Frame, config: RenderingConfig) -> Camera:
    """Camera at the true ego."""
    w, h = config.map_width_px, config.height_px
    turning = config.orientation is Orientation.HEADING_UP
    up = frame.ego_heading_rad if turning else NORTH_RAD
    anchor = (0.5 * w, (EGO_FROM_TOP if turning else 0.5) * h)
    return Camera(frame.ego_position_m, up, config.scale_px_per_m, anchor, (w, h))


def status_colour(status: Status, theme: Theme) -> Colour:
    """Colour of the status: green, amber or red."""
    return {Status.NORMAL: theme.ok, Status.CAUTION: theme.caution, Status.ALERT: theme.alert}[status]


def draw_map(
    canvas: Canvas, frame: Frame, camera: Camera, roads: RoadDrawing, scenery: Scenery | None, theme: Theme
) -> None:
    """Draw all layers, from the ground up."""
    with canvas.clip(0, 0, *camera.size_px):
        canvas.fill(theme.ground)
        if scenery is not None:
            _draw_shadows(canvas, scenery, camera, theme)
        canvas.polygons(roads.kerb.seen_px(camera), theme.kerb)
        canvas.polygons(roads.asphalt.seen_px(camera), theme.road)
        canvas.polygons(roads.marking.seen_px(camera), theme.marking)
        if scenery is not None:
            _draw_roofs(canvas, scenery, camera, theme)
            _draw_trees(canvas, scenery, camera, theme)
        _draw_corridor(canvas, frame, camera, theme)
        _draw_level(canvas, frame, camera, theme)
        _draw_bodies(canvas, frame, camera, theme)
        _draw_traffic(canvas, frame, camera, theme)
        _draw_belief(canvas, frame, camera, theme)
        if scenery is not None:
            _draw_overhead(canvas, scenery, camera, theme)


def _draw_shadows(canvas: Canvas, scenery: Scenery, camera: Camera, theme: Theme) -> None:
    """Draw shadows to the lower right of the picture for all orientations."""
    which = _standing(scenery, camera)
    cast = np.minimum(SHADOW_M * scenery.height_m[which], SHADOW_MAX_M) * camera.scale_px_per_m
    canvas.polygons(camera.px(scenery.roof_m[which]) + cast[:, None, None] * np.array([0.8, 0.6]), theme.shadow)


def _draw_roofs(canvas: Canvas, scenery: Scenery, camera: Camera, theme: Theme) -> None:
    """Draw roofs; higher ones are brighter."""
    which = _standing(scenery, camera)
    for triangle, height in zip(camera.px(scenery.roof_m[which]), scenery.height_m[which], strict=True):
        canvas.polygons(triangle[None], mix(theme.building_low, theme.building_high, height / TALL_M))
    for ends in camera.px(scenery.edge_m[which[scenery.edge_roof]]):
        canvas.line(ends, theme.building_edge, 0.5)


def _standing(scenery: Scenery, camera: Camera) -> NDArray[np.bool_]:
    """Roofs of objects on the ground that are on the map or whose shadows are."""
    seen = camera.sees(scenery.middle_m, scenery.radius_m + SHADOW_MAX_M)
    return np.asarray(seen & ~scenery.leaves & ~scenery.overhead)


def _draw_overhead(canvas: Canvas, scenery: Scenery, camera: Camera, theme: Theme) -> None:
    """Draw overpasses transparently over the road."""
    seen = camera.sees(scenery.middle_m, scenery.radius_m)
    canvas.blend(camera.px(scenery.roof_m[seen & scenery.overhead]), theme.overhead, 0.3)


def _draw_trees(canvas: Canvas, scenery: Scenery, camera: Camera, theme: Theme) -> None:
    """Draw crowns transparently over the road; vehicles are drawn above them."""
    seen = camera.sees(scenery.middle_m, scenery.radius_m)
    canvas.blend(camera.px(scenery.roof_m[seen & scenery.leaves]), theme.tree, 0.5)
    near = camera.sees(scenery.crown_m, scenery.crown_radius_m)
    crown, radius = scenery.crown_m[near], scenery.crown_radius_m[near, None, None]
    canvas.blend(camera.px(crown[:, None] + radius * ROUND), theme.tree, 0.5)
    canvas.blend(camera.px(crown[:, None] + 0.55 * radius * ROUND), theme.tree, 0.4)


def _draw_corridor(canvas: Canvas, frame: Frame, camera: Camera, theme: Theme) -> None:
    """Draw the corridor: the ego's body at its estimated lateral offset, enlarged by the alert limit."""
    b = frame.belief
    half = 0.5 * float(frame.bodies.width_m[frame.ego]) + b.al_ct_m
    near, far = b.longitudinal_m - BEHIND_M, b.longitudinal_m + AHEAD_M
    sides = np.array([b.lateral_m - half, b.lateral_m + half])
    left, right = camera.px(corridor(frame.network, b.lane_index, frame.route, near, far, sides))
    if len(left) > 1:
        canvas.blend(quads_along(left, right), theme.limit, 0.10)
        for side in (left, right):
            canvas.line(side, theme.road, 2.5)  # covers the lane marking where both coincide
            canvas.dashes(side, theme.limit, 2.0, on_px=6.0)


def body_corners(bodies: Bodies) -> Array:
    """Corners of the true vehicles, (N, 4, 2) [m]."""
    return oriented_box(bodies.position_m, bodies.heading_rad, 0.5 * bodies.length_m, 0.5 * bodies.width_m)


def perceived_corners(traffic: Traffic) -> Array:
    """Corners of the perceived vehicles without their levels, (V, 4, 2) [m]."""
    return oriented_box(traffic.position_m, traffic.heading_rad, 0.5 * traffic.length_m, 0.5 * traffic.width_m)


def _draw_bodies(canvas: Canvas, frame: Frame, camera: Camera, theme: Theme) -> None:
    bodies = frame.bodies
    corners = camera.px(body_corners(bodies))
    seen = camera.sees(bodies.position_m, bodies.length_m)
    for row in np.flatnonzero(seen):
        colour = theme.ego if row == frame.ego else theme.other
        _draw_car(canvas, corners[row], theme.crashed if bodies.crashed[row] else colour, theme)


def _draw_car(canvas: Canvas, corners: Array, colour: Colour, theme: Theme) -> None:
    """Draw a body with cut corners, a windscreen and a rear window."""
    canvas.polygons(_cut(corners)[None], colour)
    canvas.polygons(_across(corners, 0.24, 0.38, 0.12)[None], theme.glass)
    canvas.polygons(_across(corners, 0.80, 0.88, 0.14)[None], theme.glass)


def _cut(corners: Array) -> Array:
    """An octagon: each corner replaced by two points close to it.  (4, 2) -> (8, 2)."""
    before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    width = min(np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[2] - corners[1]))

    def toward(other: Array) -> Array:
        step = other - corners
        length = np.linalg.norm(step, axis=1, keepdims=True)
        return np.asarray(corners + 0.22 * width * step / np.maximum(length, 1e-9))

    return np.stack([toward(before), toward(after)], 1).reshape(-1, 2)


def _across(corners: Array, begin: float, end: float, inset: float) -> Array:
    """A band across a body between two shares of its length from the front, narrower by ``inset`` on each side."""
    left, right = corners[3] - corners[0], corners[2] - corners[1]
    side = corners[1] - corners[0]
    a, b = corners[0] + inset * side, corners[1] - inset * side
    return np.stack([a + begin * left, b + begin * right, b + end * right, a + end * left])


def _draw_traffic(canvas: Canvas, frame: Frame, camera: Camera, theme: Theme) -> None:
    """Perceived vehicles: an outline and a box grown by its levels, or an outline in dashes when there are none.

    The edge of the box is in dashes where a level is larger than the box shows.
    """
    t = frame.traffic
    half = 0.5 * t.length_m, 0.5 * t.width_m
    outline = camera.px(perceived_corners(t))
    grown = camera.px(
        oriented_box(t.position_m, t.heading_rad, half[0] + _shown(t.pl_at_m), half[1] + _shown(t.pl_ct_m))
    )
    bounded = np.isfinite(t.pl_at_m + t.pl_ct_m)
    clipped = np.maximum(t.pl_at_m, t.pl_ct_m) > SHOWN_LEVEL_M
    for row in np.flatnonzero(camera.sees(t.position_m, t.length_m + SHOWN_LEVEL_M)):
        if bounded[row]:
            canvas.line(outline[row], theme.other_belief, 1.5, closed=True)
            canvas.blend(grown[row][None], theme.other_belief, 0.12)
            if clipped[row]:
                canvas.dashes(grown[row], theme.other_belief, 1.0, on_px=6.0, closed=True)
            else:
                canvas.line(grown[row], theme.other_belief, 0.5, closed=True)
        else:
            canvas.dashes(outline[row], theme.other_belief, 1.5, on_px=3.0, closed=True)


def _draw_level(canvas: Canvas, frame: Frame, camera: Camera, theme: Theme) -> None:
    """Draw the coloured area of the ego's box, if the ego has levels."""
    if np.isfinite([frame.belief.pl_at_m, frame.belief.pl_ct_m]).all():
        canvas.blend(_ego_box(frame, camera)[None], status_colour(frame.status, theme), 0.3)


def _draw_belief(canvas: Canvas, frame: Frame, camera: Camera, theme: Theme) -> None:
    """Draw the estimated ego with its heading, and the edge of its box, dashed if a level is missing or very large."""
    b, colour = frame.belief, status_colour(frame.status, theme)
    box = _ego_box(frame, camera)
    if max(b.pl_at_m, b.pl_ct_m) <= SHOWN_LEVEL_M:
        canvas.line(box, colour, 1.5, closed=True)
    else:
        canvas.dashes(box, colour, 1.5, on_px=6.0, closed=True)
    half = 0.5 * float(frame.bodies.length_m[frame.ego]), 0.5 * float(frame.bodies.width_m[frame.ego])
    ghost = camera.px(oriented_box(b.position_m, b.heading_rad, *half))[0]
    canvas.line(_cut(ghost), theme.ego_belief, 1.5, closed=True)
    nose = 0.5 * (ghost[0] + ghost[1])
    canvas.line([0.5 * (nose + 0.5 * (ghost[2] + ghost[3])), nose], theme.ego_belief, 1.0)


def _ego_box(frame: Frame, camera: Camera) -> Array:
    """The estimated body enlarged by its levels along and across the true track, (4, 2) [px]."""
    b = frame.belief
    at, ct = _shown(np.array([b.pl_at_m, b.pl_ct_m]))
    half = 0.5 * float(frame.bodies.length_m[frame.ego]) + at, 0.5 * float(frame.bodies.width_m[frame.ego]) + ct
    return np.asarray(camera.px(oriented_box(b.position_m, frame.ego_heading_rad, *half))[0])


def _shown(level_m: Array) -> Array:
    """A level limited to the size of the map."""
    return np.minimum(level_m, SHOWN_LEVEL_M)
