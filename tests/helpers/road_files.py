"""Road maps in GeoJSON, written by tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef

__all__ = ["collection", "line", "roads_at"]


def line(lon_lat: Any, **properties: Any) -> dict[str, Any]:
    """A LineString."""
    places = np.asarray(lon_lat, np.float64).tolist()
    return {
        "type": "Feature", "properties": properties, "geometry": {"type": "LineString", "coordinates": places}
    }  # fmt: skip


def collection(path: Path, *features: dict[str, Any], **more: Any) -> Path:
    """A file with features."""
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features), **more}), encoding="utf-8")
    return path


def roads_at(origin_ecef_m: np.ndarray, *lines: tuple[Any, dict[str, Any]]) -> list[dict[str, Any]]:
    """Lines with vertices in E, N of a place [m], and their properties, as features."""
    latitude, longitude, _ = geodetic_from_ecef(origin_ecef_m)
    axes = ecef_from_enu_matrix(latitude, longitude)
    out = []
    for places, properties in lines:
        enu = np.column_stack([np.asarray(places, np.float64), np.zeros(len(places))])
        lat, lon, _ = geodetic_from_ecef(origin_ecef_m + enu @ axes.T)
        out.append(line(np.degrees(np.column_stack([lon, lat])).round(9), **properties))
    return out
