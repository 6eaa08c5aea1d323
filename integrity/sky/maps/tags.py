"""Values of OpenStreetMap tags as numbers with units; a value that cannot be read, or is out of range, is None.

Sources: pages ``Key:height``, ``Key:maxspeed``, ``Key:lanes`` and ``Simple 3D Buildings`` of the OpenStreetMap wiki.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import inf, isfinite

__all__ = [
    "DEFAULT_KMH",
    "DRIVABLE",
    "OF_LANES",
    "Tags",
    "direction",
    "integer",
    "lanes",
    "metres",
    "no_motor_cars",
    "speed_mps",
]

Tags = Mapping[str, str]

FOOT_M, INCH_M = 0.3048, 0.0254
MILE_KM = 1.609344
KMH = 1.0 / 3.6  # [m/s]
TALLEST_M = 830.0  # Burj Khalifa, 828 m, is the highest building
MOST_LANES = 8
WALK_KMH = 7.0  # German courts: 4 to 10 km/h

DRIVABLE = (
    "motorway", "trunk", "primary", "secondary", "tertiary", "unclassified", "residential", "living_street",
    "motorway_link", "trunk_link", "primary_link", "secondary_link", "tertiary_link",
)  # fmt: skip
"""Classes of ``highway`` on which cars drive through; service roads, paths and roads under construction are not."""

DEFAULT_KMH = {"motorway": 130.0, "trunk": 100.0, "living_street": WALK_KMH}
"""Speed where none is tagged; 50 km/h of towns (StVO section 3) for all other classes."""
TOWN_KMH = 50.0
OF_ZONE = {"urban": 50.0, "rural": 100.0, "motorway": 130.0, "living_street": WALK_KMH, "walk": WALK_KMH, "none": 130.0}

_METRES = re.compile(r"^\s*(\d+(?:[.,]\d+)?)\s*(m|metres?|meters?|ft|feet)?\s*$", re.ASCII)
_FEET = re.compile(r"^\s*(\d+)\s*'\s*(?:(\d+(?:\.\d+)?)\s*\")?\s*$", re.ASCII)
_SPEED = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(km/h|kmh|kph|mph)?\s*$", re.ASCII)
OF_LANES = re.compile(r"(lanes:(bus|psv)|(bus|psv|turn|access|vehicle):lanes|placement)(:|$)")
"""Keys that say which lanes are for buses or turns, or where lanes lie in the carriageway; not read further."""


def metres(text: str | None, low: float = 0.0, high: float = TALLEST_M) -> float | None:
    """A length: ``12``, ``12.5 m``, ``40 ft``, ``7'4"``.

    >>> metres("12,5 m"), metres("10'"), metres("1e6"), metres("very high")
    (12.5, 3.048, None, None)
    """
    if text is None or len(text) > 32:
        return None
    plain, feet = _METRES.match(text), _FEET.match(text)
    if plain:
        value = float(plain[1].replace(",", ".")) * (FOOT_M if (plain[2] or "m")[0] == "f" else 1.0)
    elif feet:
        value = float(feet[1]) * FOOT_M + float(feet[2] or 0.0) * INCH_M
    else:
        return None
    return value if isfinite(value) and low <= value <= high else None


def integer(text: str | None, low: int, high: int) -> int | None:
    """A whole number within bounds; of ``3;2`` the first."""
    value = None if text is None else metres(text.split(";")[0], -inf, inf)
    return int(value) if value is not None and low <= value <= high else None


def speed_mps(tags: Tags) -> tuple[float, bool]:
    """The speed limit [m/s], and whether it is tagged; otherwise it is that of the class of the street."""
    text = tags.get("maxspeed", "")
    found = _SPEED.match(text.split(";")[0])
    kmh = None
    if found:
        kmh = float(found[1]) * (MILE_KM if found[2] == "mph" else 1.0)
    elif text:
        zone = text.split(":")[-1]
        kmh = OF_ZONE.get(zone) or (float(zone.removeprefix("zone")) if zone.removeprefix("zone").isdecimal() else None)
    if kmh is not None and 5.0 <= kmh <= 150.0:
        return kmh * KMH, True
    return DEFAULT_KMH.get(tags.get("highway", ""), TOWN_KMH) * KMH, False


def direction(tags: Tags) -> int:
    """1 for a street of one direction along its points, -1 against them, 0 for both directions."""
    oneway = tags.get("oneway", "")
    if oneway in ("yes", "true", "1"):
        return 1
    if oneway in ("-1", "reverse"):
        return -1
    implied = tags.get("junction") in ("roundabout", "circular") or tags.get("highway") in ("motorway", "motorway_link")
    return 1 if implied and oneway not in ("no", "false", "0") else 0


def lanes(tags: Tags) -> tuple[int, int, bool]:
    """Lanes along and against the points of a street, and whether they are tagged; else one for each direction."""
    way = direction(tags)
    total = integer(tags.get("lanes"), 1, MOST_LANES)
    if way:
        count = total or 1
        return (count, 0, total is not None) if way > 0 else (0, count, total is not None)
    ahead, back = (integer(tags.get(f"lanes:{side}"), 1, MOST_LANES) for side in ("forward", "backward"))
    if total is not None and ahead is None:
        ahead = max(total - back, 1) if back is not None else max(total // 2, 1)
    if total is not None and back is None and ahead is not None:
        back = max(total - ahead, 1)
    return ahead or 1, back or 1, total is not None or ahead is not None


def no_motor_cars(tags: Tags) -> bool:
    """Whether private cars may not drive here: the most special key of access counts."""
    for key in ("motorcar", "motor_vehicle", "vehicle", "access"):
        if key in tags:
            return tags[key] in ("no", "private", "forestry", "agricultural", "delivery", "emergency", "customers")
    return False
