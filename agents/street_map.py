"""What a street map or a city model holds, what was assumed and left out, and a picture of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lanebound.envs.records import enu_of
from lanebound.envs.worlds.street_maps import MapRoad, map_roads
from lanebound.integrity.assessment.plotting import legend, new_figure, save, tidy
from lanebound.integrity.sky.maps.city_models import CityModel, read_city_model
from lanebound.integrity.sky.maps.files import map_of
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.loops import through_buildings

if TYPE_CHECKING:
    from lanebound.integrity.sky.maps.records import StreetMap

__all__ = ["about_city_model", "about_map", "draw_city_model", "draw_map"]

WAYS = 8  # that are listed
HIGH_M = 40.0  # from which on all buildings have one colour
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7")


def about_map(name: str) -> tuple[dict[str, Any], list[MapRoad]]:
    """Figures of a map as plain data, and the roads of its longest closed ways.

    Raises
    ------
    InputError
        The map is refused.
    """
    streets, roads = map_of(name), map_roads(name, most=WAYS)
    graph = StreetGraph.of(streets)
    tops = [solid.top_m for solid in streets.solids]
    inside = through_buildings(streets, graph.edges)
    return {
        "map": name,
        "lat_deg": streets.frame.lat_deg,
        "lon_deg": streets.frame.lon_deg,
        "found": dict(streets.found),
        "assumed": dict(streets.assumed),
        "skipped": dict(streets.skipped),
        "junctions": len(graph.junctions),
        "pieces": len(graph.edges),
        "connected": len(graph.connected),
        "in_buildings": int((inside > 0.0).sum()),
        "solids": len(tops),
        "height_median_m": float(np.median(tops)) if tops else None,
        "height_max_m": max(tops, default=None),
        "ways": [
            {
                "length_m": road.length_m,
                "lanes": road.lanes,
                "limit_min_mps": min(limit for _, limit in road.roads),
                "limit_max_mps": max(limit for _, limit in road.roads),
            }
            for road in roads
        ],
    }, roads


def about_city_model(name: str) -> tuple[dict[str, Any], CityModel]:
    """Figures of a city model as plain data, and the model.

    Raises
    ------
    InputError
        The model is refused.
    """
    model = read_city_model(name)
    tops = np.zeros(model.city.buildings)
    np.maximum.at(tops, model.city.building, model.city.triangles_enu_m[..., 2].max(1))
    return {
        "map": name,
        "lat_deg": None if model.frame is None else model.frame.lat_deg,
        "lon_deg": None if model.frame is None else model.frame.lon_deg,
        "found": dict(model.found),
        "skipped": dict(model.skipped),
        "height_median_m": float(np.median(tops)),
        "height_max_m": float(tops.max()),
    }, model


def draw_city_model(model: CityModel, path: Path) -> Path:
    """Draw the surfaces of a city model from above by height, the highest last; returns the path."""
    from matplotlib.collections import PolyCollection

    figure = new_figure(9.0, 8.0)
    axes = figure.add_subplot()
    walls = model.city.triangles_enu_m
    height = walls[..., 2].max(1)
    upwards = np.argsort(height, kind="stable")
    faces = PolyCollection(list(walls[upwards, :, :2]), cmap="Greys", edgecolors="face", linewidths=0.3)
    faces.set_array(height[upwards])
    faces.set_clim(0.0, HIGH_M)
    axes.add_collection(faces)
    axes.autoscale_view()
    axes.set_aspect("equal")
    tidy(axes, xlabel="East [m]", ylabel="North [m]")
    figure.colorbar(faces, ax=axes, label="height of buildings [m]", shrink=0.6, extend="max")
    return save(figure, path)


def draw_map(streets: StreetMap, roads: Sequence[MapRoad], path: Path) -> Path:
    """Draw streets, buildings by height, trees and the first closed ways; returns the path."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection, PathCollection
    from matplotlib.colors import Normalize
    from matplotlib.path import Path as Outline

    figure = new_figure(9.0, 8.0)
    axes = figure.add_subplot()
    heights = ScalarMappable(Normalize(0.0, HIGH_M), "Greys")
    shapes = [Outline.make_compound_path(*map(Outline, solid.rings_en_m)) for solid in streets.solids]
    tops = heights.to_rgba(np.array([solid.top_m for solid in streets.solids]))
    axes.add_collection(PathCollection(shapes, facecolors=tops, edgecolors="#555555", linewidths=0.3))
    lines = [way.points_en_m for way in streets.streets]
    widths = [2.0 if way.lanes + way.lanes_back > 2 else 1.0 for way in streets.streets]
    axes.add_collection(LineCollection(lines, colors="#E69F00", linewidths=widths, label="streets"))
    if streets.trees:
        east, north = np.array([(tree.east_m, tree.north_m) for tree in streets.trees]).T
        axes.scatter(east, north, s=6, color="#66AA55", label="trees")
    for k, (road, colour) in enumerate(zip(roads, COLOURS, strict=False)):
        line = np.concatenate([_line(path) for path, _ in road.roads])
        axes.plot(*line.T, color=colour, linewidth=1.8, label=f"world.route {k}: {road.length_m:.0f} m")
    low, high = np.percentile(np.concatenate(lines), (1.0, 99.0), axis=0)  # streets lead on beyond the buildings
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    tidy(axes, xlabel="East [m]", ylabel="North [m]")
    legend(axes, loc="upper right")
    figure.colorbar(heights, ax=axes, label="height of buildings [m]", shrink=0.6, extend="max")
    figure.text(0.01, 0.005, "Map data: (c) OpenStreetMap contributors, ODbL 1.0", fontsize=7, color="#666666")
    return save(figure, path)


def _line(path: Any) -> Any:
    """Points of a path in East, North.  (n, 2) [m]."""
    poses = [path.pose_at(s) for s in np.linspace(0.0, path.length, int(path.length) + 2)]
    return enu_of(np.array([(pose.x, pose.y) for pose in poses]))
