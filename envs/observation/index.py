"""The published index: every entry of an observation with its unit, scale, bounds, meaning and source.

An entry is ``clip(quantity / scale, low, high)``, float32, never NaN or infinite. Its meaning states the value of a
missing quantity: a missing protection level is 1 with its ``exists`` flag 0.

The source of an entry names a field of a record: ``belief.speed_mps`` (BELIEF of :mod:`..batch.records_kernel`),
``view.ratio_at`` (VIEW of the same), ``preview[2].ahead_m`` (AHEAD at the third preview distance),
``sky[4]`` (satellites predicted: left, own and right lane of each distance in turn), ``vehicle[0].age_s`` (BESIDE of
the nearest vehicle). ``belief.mode == 2`` is 1 where the code has that value. A new entry is a line here; a quantity
that is in no record needs a field in VIEW or BESIDE and its formula there first.

:func:`register_entry` adds an entry from outside; its source may also be a function of :class:`Observed`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import inf, nan, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch import view_kernel as vk
from lanebound.envs.batch.ego_kernel import STEERING_MOST_RAD
from lanebound.envs.batch.records_kernel import BELIEF, EGO, VIEW
from lanebound.envs.batch.toll_kernel import WINDOW_S
from lanebound.envs.observation.config import ObservationConfig
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest, remove_registered, require_new
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus

__all__ = ["GROUPS", "LANES", "OBSERVATION_INDEX", "Entry", "Observed", "Source", "describe", "entries", "group_slices",
           "register_entry", "sources_of", "withdraw_entry"]  # fmt: skip

GROUPS = ("ego", "integrity", "road", "traffic")
LANES = ("left", "own", "right")
RTK_MORE = {
    RtkStatus.FIXED: "; used where mode_rtk is 1",
    RtkStatus.FAULT: "; or the jump monitor refused it",
}
"""What the advice of a status does not say of its flag."""


class Observed(NamedTuple):
    """Inputs of the entries of N environments: records (N,) BELIEF and VIEW, (N, D) AHEAD, (N, R) BESIDE.

    sky (N, 3 D): satellites predicted on the lanes left, own and right, negative for unknown. states: records (N,) of
    plug-in stages and modes of the egos' navigators, as ``"stage interference"`` or ``"mode inertial"``.
    """

    belief: Records
    view: Records
    preview: Records
    sky: NDArray[np.float64]
    vehicles: Records
    states: Mapping[str, NDArray[Any]]


Source = str | Callable[[Observed], NDArray[np.float64]]
"""Source of an entry: the name of a field, or a function that returns (N,) numbers for N environments."""


@dataclass(frozen=True)
class Entry:
    """One number of an observation: ``clip(quantity / scale, low, high)``.

    Attributes
    ----------
    name, group : name, unique in its group, and the group
    unit : of the quantity, "" for a pure number
    scale : quantity at which the entry is 1 [unit]
    low, high : bounds of the entry
    meaning : the quantity, its sign, and its value when missing
    source : source of the quantity
    """

    name: str
    group: str
    unit: str
    scale: float
    low: float
    high: float
    meaning: str
    source: Source

    @property
    def column(self) -> str:
        """Name that is unique in the whole observation, ``ego.speed``."""
        return f"{self.group}.{self.name}"


class _Group:
    """Makes the entries of a group."""

    def __init__(self, name: str) -> None:
        self.name = name

    def signed(self, name: str, unit: str, scale: float, meaning: str, source: str) -> Entry:
        return Entry(name, self.name, unit, scale, -1.0, 1.0, meaning, source)

    def positive(self, name: str, unit: str, scale: float, meaning: str, source: str) -> Entry:
        return Entry(name, self.name, unit, scale, 0.0, 1.0, meaning, source)

    def flag(self, name: str, meaning: str, source: str) -> Entry:
        return Entry(name, self.name, "", 1.0, 0.0, 1.0, meaning, source)


def _ego(c: ObservationConfig) -> list[Entry]:
    g = _Group("ego")
    fast = c.speed_max_mps
    return [
        g.signed("speed", "m/s", fast, "speed by the odometer", "belief.speed_mps"),
        g.signed("target_speed", "m/s", fast, "target speed of meta-actions; the speed itself under continuous actions",
                 "belief.target_speed_mps"),
        g.signed("acceleration", "m/s^2", c.acceleration_max_mps2, "acceleration along the heading",
                 "belief.acceleration_mps2"),
        g.signed("yaw_rate", "rad/s", c.yaw_rate_max_radps, "yaw rate, positive for right turns",
                 "belief.yaw_rate_radps"),
        g.signed("steering", "rad", STEERING_MOST_RAD, "last commanded steering angle, positive to the right",
                 "belief.steering_rad"),
        g.signed("heading_sin", "", 1.0, "sine of the heading relative to the lane, positive to the right",
                 "view.heading_sin"),
        g.signed("heading_cos", "", 1.0, "cosine of the heading relative to the lane", "view.heading_cos"),
        g.signed("lateral_offset", "m", c.offset_max_m, "offset from the centreline of the lane, positive to the right",
                 "belief.lateral_m"),
        g.signed("lateral_share", "", 2.0, "lateral offset divided by half the width of the lane",
                 "view.lateral_share"),
        g.positive("lane_width", "m", c.lane_width_max_m, "width of the lane", "belief.lane_width_m"),
        g.positive("lane_share", "", 1.0, "position among the lanes of the road: 0 leftmost or single, 1 rightmost",
                   "view.lane_share"),
        g.flag("left_exists", "the car may change to a lane on its left", "view.left_exists"),
        g.flag("right_exists", "the car may change to a lane on its right", "view.right_exists"),
        g.flag("target_left", "a lane change to the left is commanded", "view.target_left"),
        g.flag("target_right", "a lane change to the right is commanded", "view.target_right"),
    ]  # fmt: skip


def _integrity(c: ObservationConfig) -> list[Entry]:
    if c.integrity == "blind":
        return []
    if c.integrity == "clock":
        return [entry for entry in _levels(c) if entry.name.startswith(CLOCK)]
    return _levels(c)


def _levels(c: ObservationConfig) -> list[Entry]:
    g, pl, most = _Group("integrity"), c.pl_max_m, c.elapsed_max_s
    change = f"change of the protection level, limited to {pl:g} m, in {c.trend_window_s:g} s"
    out = []
    for axis, name in (("at", "along track"), ("ct", "across track")):
        out += [
            g.positive(f"pl_{axis}", "m", pl, f"protection level {name}; 1 when missing", f"view.pl_{axis}_m"),
            g.flag(f"pl_{axis}_exists", f"a protection level {name} exists", f"view.pl_{axis}_exists"),
            g.positive(f"al_{axis}", "m", pl, f"alert limit {name}", f"belief.al_{axis}_m"),
            g.positive(f"ratio_{axis}", "", c.ratio_max, f"PL / AL {name}; 1 when missing", f"view.ratio_{axis}"),
            g.signed(f"margin_{axis}", "m", pl, f"AL - PL {name}, safe when >= 0; -1 when missing",
                     f"view.margin_{axis}_m"),
            g.signed(f"trend_{axis}", "m", pl, f"{change}, {name}",
                     f"view.trend_{axis}_m"),
        ]  # fmt: skip
    return [
        *out,
        g.flag("available", "no protection level exceeds its alert limit", "view.available"),
        g.flag("alert", "the alert is on", "view.alert"),
        g.positive("alert_age", "s", most, "time since the start of the alert; 0 without an alert", "view.alert_age_s"),
        *(g.flag(f"reason_{r.name.lower()}", r.value, f"view.reason == {r.code}") for r in AlertReason
          if r is not AlertReason.CONTEXT_WARNING or c.context),
        *(g.flag(f"mode_{m.key}", f"source of the position: {m.label}", f"belief.mode == {int(m)}")
          for m in Mode if not m.is_service or m.key in c.shown_services),
        *(g.flag(f"rtk_{r.name.lower()}", r.value + RTK_MORE.get(r, ""), f"belief.rtk == {r.code}") for r in RtkStatus),
        g.positive("since_rtk", "s", most,
                   "time since the last position of RTK or of a service; 1 before the first one",
                   "belief.since_rtk_s"),
        g.positive("since_calibration", "s", most, "time since the last heading calibration; 1 before the first one",
                   "belief.since_calibration_s"),
        g.positive("corrections_age", "s", most,
                   "age of the data of the reference station; 1 during an outage of the link",
                   "belief.corrections_age_s"),
        g.positive("satellites", "", c.satellites_max, "satellites used by RTK", "belief.satellites"),
        g.positive("satellites_doppler", "", c.satellites_max, "satellites used for the Doppler velocity",
                   "belief.satellites_doppler"),
        g.positive("excluded", "", c.excluded_max, "satellites excluded by fault detection in this epoch",
                   "belief.excluded"),
        g.positive("hdop", "", c.hdop_max, "horizontal dilution of precision; 1 without satellites", "belief.hdop"),
        *([g.positive("sdop", "", c.sdop_max, "speed dilution of precision of the Doppler velocity; 1 without one",
                      "belief.sdop")] if c.speed_geometry else []),
        *([g.positive("permitted_speed", "m/s", c.speed_max_mps, "speed permitted, by the levels under an alert; 1 "
                      "if the map has no limit", "view.permitted_mps")] if c.permitted_speed else []),
        *([g.positive("possible_limit", "m/s", c.speed_max_mps, "least speed limit of the roads that the levels leave "
                      "possible", "belief.possible_mps"),
           g.flag("roads_agree", "these roads ask for the same change of lanes", "belief.roads_agree")]
          if c.roads else []),
        *(_context(g) if c.context else ()),
        *(_filters(c, g) if c.filters else ()),
    ]  # fmt: skip


def _context(g: _Group) -> list[Entry]:
    """What the context monitor says; see docs/context.md."""
    return [
        g.flag("context_warning", "the context monitor warns", "belief.context_warning"),
        g.positive("context_phases", "", 3.0, "number of its phases passed: position, speed, map",
                   "belief.context_phases"),
        g.positive("context_score", "", 100.0, "integrity score of the matched link; 0 without a link",
                   "belief.context_score"),
        g.positive("link_probability", "", 1.0, "probability of the matched link; 0 without a link",
                   "belief.link_probability"),
    ]  # fmt: skip


def _filters(c: ObservationConfig, g: _Group) -> list[Entry]:
    nis, missing = "normalised innovation squared of the last", "0 before the first"
    return [
        g.positive("model_curved", "", 1.0, "probability of the curved vehicle model; 0 without that model",
                   "belief.model_curved"),
        g.positive("nis_position", "", c.nis_max, f"{nis} GNSS position; {missing}", "belief.nis_position"),
        g.positive("nis_wheels", "", c.nis_max, f"{nis} wheel speed; {missing}", "belief.nis_wheels"),
        g.positive("nis_gyro", "", c.nis_max, f"{nis} integrated gyro; {missing}", "belief.nis_gyro"),
        g.positive("nis_steering", "", c.nis_max, f"{nis} steering angle; {missing} and where not fitted",
                   "belief.nis_steering"),
        g.positive("nis_slip", "", c.nis_max, f"{nis} slip by the geometry; {missing}", "belief.nis_slip"),
        g.positive("nis_compass", "", c.nis_max, f"{nis} compass heading; {missing} and where not fitted",
                   "belief.nis_compass"),
        g.positive("trust", "m", c.pl_max_m, "horizontal trust level of the filter; 1 when missing", "belief.trust_m"),
    ]  # fmt: skip


def _road(c: ObservationConfig) -> list[Entry]:
    g = _Group("road")
    out = [
        g.positive("speed_limit", "m/s", c.speed_max_mps, "speed limit of the lane; 1 if the map has none",
                   "view.speed_limit_mps"),
        g.positive("junction", "m", c.range_m, "distance to the end of this section of the road",
                   "view.junction_m"),
        g.positive("lane_end", "m", c.range_m,
                   "distance to the end of the lane without a continuation; 1 beyond the range",
                   "view.lane_end_m"),
        *([g.flag("lane_seen", "the lane sensor sees the markings", "belief.lane_seen"),
           g.signed("route_shift", "", 4.0, "lanes to change to the right for the goal, negative to the left",
                    "belief.route_shift"),
           g.signed("offset", "m", c.other_road_max_m, "position of the navigator to the right of where the camera has "
                    "the car in the lane of the believed road", "belief.road_offset_m"),
           g.positive("other_road", "m", c.other_road_max_m, "from that position to the nearest other road beside it; "
                      "1 without one", "belief.other_road_m"),
           g.positive("other_limit", "m/s", c.speed_max_mps, "speed limit of that road; 1 without one",
                      "belief.other_limit_mps")] if c.roads else []),
    ]  # fmt: skip
    out += _closure(c, g) if c.closure else []
    out += _tolls(c, g) if c.tolls else []
    for n, d in enumerate(c.preview_m):
        where = f"of the route {d:g} m ahead"
        out += [
            g.flag(f"preview_{d:g}m_exists", f"the map has the route {d:g} m ahead; else it is extended straight",
                   f"preview[{n}].exists"),
            g.signed(f"preview_{d:g}m_ahead", "m", d, f"centreline {where}: along the heading of the car",
                     f"preview[{n}].ahead_m"),
            g.signed(f"preview_{d:g}m_right", "m", d, f"centreline {where}: to the right of the car",
                     f"preview[{n}].right_m"),
            g.signed(f"preview_{d:g}m_heading", "rad", pi, f"direction {where} relative to the heading of the car",
                     f"preview[{n}].heading_rad"),
            g.signed(f"preview_{d:g}m_curvature", "1/m", c.curvature_max_per_m,
                     f"curvature {where}, positive for right turns", f"preview[{n}].curvature_pm"),
        ]  # fmt: skip
    for n, d in enumerate(c.satellites_m):
        text = f"satellites predicted in line of sight {d:g} m ahead; -1 without a prediction or lane"
        out += [
            g.signed(f"sky_{d:g}m_{lane}", "", c.satellites_max, f"{lane} lane: {text}", f"sky[{3 * n + k}]")
            for k, lane in enumerate(LANES)
        ]
    return out


def _closure(c: ObservationConfig, g: _Group) -> list[Entry]:
    """A lane that closes, as a roadside unit has announced it in coordinates of the map."""
    return [
        g.flag("closure_known", "a message says that a lane closes; before it the next six are 1, 1, 0, 0, 0, 1",
               "belief.closure"),
        g.signed("closure_start", "m", c.range_m, "distance from the middle of the car to the start of the closure",
                 "belief.closure_start_m"),
        g.signed("closure_end", "m", c.range_m, "distance from the middle of the car to the end of the closure",
                 "belief.closure_end_m"),
        *(g.flag(f"closure_{name}", f"the {name} lane closes", f"belief.closure_side == {side}")
          for name, side in zip(LANES, (-1, 0, 1), strict=True)),
        g.positive("closure_limit", "m/s", c.speed_max_mps, "speed limit announced beside the closure",
                   "belief.closure_limit_mps"),
    ]  # fmt: skip


def _tolls(c: ObservationConfig, g: _Group) -> list[Entry]:
    """The geo-object that is open: see :mod:`lanebound.envs.batch.toll_kernel`."""
    far, links = c.other_road_max_m, "links of the geo-object"
    return [
        g.flag("toll_open", "a geo-object is open and not decided", "view.toll_open"),
        g.flag("toll_inside", f"the believed place is on one of the {links}", "view.toll_inside"),
        g.positive("toll_distance", "m", far, "across from the position to the lane of the tolled link, less the bound "
                   "of the camera; after it is passed as before; 1 without an open object", "view.toll_m"),
        g.positive("toll_free_distance", "m", far, f"likewise to the nearest of the other {links}", "view.toll_free_m"),
        g.positive("toll_share", "", 1.0, f"of the positions on the {links} so far, nearest to the tolled one",
                   "view.toll_share"),
        g.positive("toll_passed", "s", WINDOW_S, f"since the {links} were left; it closes at 1", "view.toll_passed_s"),
    ]  # fmt: skip


def _traffic(c: ObservationConfig) -> list[Entry]:
    return [entry for row in range(c.vehicles) for entry in _vehicle(c, row)]


def _vehicle(c: ObservationConfig, row: int) -> list[Entry]:
    g, p, v = _Group("traffic"), f"v{row}_", f"vehicle[{row}]"
    text = "own level (0 if seen by the sensor) plus half the extent of its levels"
    out = [
        g.flag(p + "present", "a vehicle is perceived; if not: ahead, lane_gap, age and levels are 1, the rest 0",
               f"{v}.present"),
        g.signed(p + "ahead", "m", c.range_m, "distance of its middle along the heading of the car",
                 f"{v}.ahead_m"),
        g.signed(p + "right", "m", c.range_m, "distance of its middle to the right of the car", f"{v}.right_m"),
        g.signed(p + "velocity_ahead", "m/s", c.speed_max_mps, "relative velocity along the heading of the car",
                 f"{v}.velocity_ahead_mps"),
        g.signed(p + "velocity_right", "m/s", c.speed_max_mps, "relative velocity to the right of the car",
                 f"{v}.velocity_right_mps"),
        g.signed(p + "heading_sin", "", 1.0, "sine of its heading relative to the car", f"{v}.heading_sin"),
        g.signed(p + "heading_cos", "", 1.0, "cosine of its heading relative to the car", f"{v}.heading_cos"),
        g.signed(p + "lane_gap", "m", c.range_m,
                 "distance of its middle along the route; -1 or 1 if not alongside the route",
                 f"{v}.lane_gap_m"),
        g.signed(p + "lane_offset", "m", c.offset_max_m,
                 "offset from the centreline of the route; -1 or 1 if not alongside the route",
                 f"{v}.lane_offset_m"),
        g.flag(p + "own_lane", "within half a lane width of the centreline of the route", f"{v}.own_lane"),
        g.flag(p + "left_lane", "within the next lane width to the left, whatever the direction of that lane",
               f"{v}.left_lane"),
        g.flag(p + "right_lane", "within the next lane width to the right", f"{v}.right_lane"),
        g.positive(p + "length", "m", c.length_max_m, "length of the vehicle", f"{v}.length_m"),
        g.positive(p + "width", "m", c.width_max_m, "width of the vehicle", f"{v}.width_m"),
        g.positive(p + "age", "s", c.age_max_s, "age of the measurement", f"{v}.age_s"),
        g.flag(p + "sensor", "1: perceived by a sensor or by ranges of the car; 0: by broadcasts", f"{v}.sensor"),
        g.flag(p + "pl_exists", "the two protection levels below exist", f"{v}.pl_exists"),
        g.positive(p + "pl_at", "m", 2.0 * c.pl_max_m, f"along the heading of the car: {text}; 1 when missing",
                   f"{v}.pl_at_m"),
        g.positive(p + "pl_ct", "m", 2.0 * c.pl_max_m, f"across the heading of the car: {text}; 1 when missing",
                   f"{v}.pl_ct_m"),
    ]  # fmt: skip
    return out if c.shows_levels else out[:-3]


CLOCK = ("mode_", "since_rtk")
"""Names, or their beginnings, of the entries of integrity that an observation shows as a clock."""
DECLARED = {"ego": _ego, "integrity": _integrity, "road": _road, "traffic": _traffic}
_registered: list[Entry] = []


def register_entry(entry: Entry) -> None:
    """Add an entry to the end of its group, for all environments that are made from now on.

    Raises
    ------
    InputError
        An unknown group or field, a name that is taken or no identifier, bounds or a scale out of range, or a source of
        another kind.
    """
    if entry.group not in GROUPS:
        raise InputError(
            f"group must be one of {', '.join(GROUPS)}, got {entry.group!r}: {nearest(entry.group, GROUPS)}"
        )
    taken = [other.name for other in entries(ObservationConfig(vehicles=64)) if other.group == entry.group]
    require_new(f"an entry of {entry.group}", entry.name, taken)
    if not (0.0 < entry.scale < inf and -inf < entry.low < entry.high < inf):
        raise InputError(
            f"scale must be > 0 and low < high, all finite, got {entry.scale}, {entry.low}, {entry.high}: correct them"
        )
    if isinstance(entry.source, str):
        _word_of(entry.source)
    elif not callable(entry.source):
        raise InputError(
            f"source of entry {entry.column} must be the name of a field or a function, got {entry.source!r}: "
            "write it as 'belief.speed_mps'"
        )
    _registered.append(entry)


def withdraw_entry(column: str) -> None:
    """Remove a registered entry, ``group.name``; environments that exist already still show it.

    Raises
    ------
    InputError
        There is none of this name.
    """
    remove_registered("entry", column, _registered, lambda entry: entry.column)


def entries(config: ObservationConfig) -> tuple[Entry, ...]:
    """Every entry of one observation, in the order of the flat form.

    Raises
    ------
    InputError
        A registered entry shows a point or vehicle that this configuration does not have.
    """
    return _entries(config, tuple(_registered), tuple(m.key for m in Mode))


@lru_cache(maxsize=64)
def _entries(config: ObservationConfig, registered: tuple[Entry, ...], modes: tuple[str, ...]) -> tuple[Entry, ...]:
    """:func:`entries`, with those that were registered; they depend on the registered modes as well."""
    for entry in registered:
        _require_shown(config, entry)
    out: list[Entry] = []
    for group in GROUPS:
        shown = DECLARED[group](config)
        hidden = group == "integrity" and not config.shows_levels
        out += shown if hidden else [*shown, *(entry for entry in registered if entry.group == group)]
    return tuple(out)


def _require_shown(config: ObservationConfig, entry: Entry) -> None:
    """Refuse an entry of a point, lane or vehicle beyond those of a configuration, which the kernel would read."""
    found = SOURCE.fullmatch(entry.source) if isinstance(entry.source, str) else None
    sizes = {"preview": len(config.preview_m), "sky": 3 * len(config.satellites_m), "vehicle": config.vehicles}
    if found is None or found[1] not in sizes:
        return
    if int(found[2] or 0) >= sizes[found[1]]:
        raise InputError(
            f"source of entry {entry.column} must be among the {sizes[found[1]]} of {found[1]}, got {entry.source!r}: "
            "count from 0, or make observation.preview_m, satellites_m or vehicles longer"
        )


def group_slices(config: ObservationConfig) -> dict[str, slice]:
    """Where each group that has entries lies in the flat form."""
    groups = [entry.group for entry in entries(config)]
    starts = {group: groups.index(group) for group in GROUPS if group in groups}
    return {group: slice(start, start + groups.count(group)) for group, start in starts.items()}


# Sources, as the kernel reads them

SOURCE = re.compile(r"(\w+)(?:\[(\d+)\])?(?:\.(\w+))?(?: == (-?\d+))?")
BLOCKS = {"belief": (vk.EGO_NUMBER, BELIEF, "shown"), "view": (vk.EGO_NUMBER, VIEW, "own"),
          "preview": (vk.PREVIEW, vk.AHEAD, ""), "vehicle": (vk.VEHICLE, vk.BESIDE, "")}  # fmt: skip
"""Of each name: block, record, and the field of EGO that holds it."""
WORD = 8  # bytes


def _word_of(source: str) -> tuple[int, int, float]:
    """Block, word and code of a source.

    Raises
    ------
    InputError
        No such record or field.
    """
    match = SOURCE.fullmatch(source)
    if match is None:
        raise InputError(f"source must be as 'belief.speed_mps' or 'vehicle[0].age_s', got {source!r}: correct it")
    name, row, field, code = match[1], int(match[2] or 0), match[3], nan if match[4] is None else float(match[4])
    if name == "sky" and field is None:
        return vk.SKY, row, code
    if name not in BLOCKS:
        known = (*BLOCKS, "sky")
        raise InputError(f"source must name one of {', '.join(known)}, got {source!r}: {nearest(name, known)}")
    block, record, held = BLOCKS[name]
    fields: Mapping[str, Any] = record.fields or {}
    if field not in fields:
        raise InputError(
            f"source must name a field of {name}, got {source!r}: {nearest(str(field), record.names or ())}"
        )
    kind, offset = fields[field][:2]
    if kind.kind == "i":
        block = vk.EGO_WHOLE
    ego: Mapping[str, Any] = EGO.fields or {}
    begin = ego[held][1] if held else row * record.itemsize
    return block, (begin + offset) // WORD, code


@lru_cache(maxsize=64)
def sources_of(index: tuple[Entry, ...]) -> Records:
    """The table by which the kernel fills a frame, (E,) SOURCE; entries of functions are filled outside of it.

    The array is shared: do not write it.
    """
    table = np.zeros(len(index), vk.SOURCE)
    for row, entry in zip(table, index, strict=True):
        row["block"], row["word"], row["code"] = -1, 0, nan
        if isinstance(entry.source, str):
            row["block"], row["word"], row["code"] = _word_of(entry.source)
        row["factor"], row["low"], row["high"] = 1.0 / entry.scale, entry.low, entry.high
    return table


def describe(config: ObservationConfig | None = None) -> str:
    """The index as a table in Markdown: position in the flat form, position in its group, and the entry.

    Raises
    ------
    InputError
        ``config`` is another configuration, such as that of an environment.
    """
    config = ObservationConfig() if config is None else config
    if not isinstance(config, ObservationConfig):
        raise InputError(
            f"config must be an ObservationConfig, got {type(config).__name__}: "
            "pass that of an environment, env.unwrapped.config.observation"
        )
    slices = group_slices(config)
    lines = ["| flat | group | at | entry | unit | scale | bounds | meaning |", "|" + "---|" * 8]
    for place, e in enumerate(entries(config)):
        bounds = f"[{e.low:g}, {e.high:g}]"
        at = place - slices[e.group].start
        lines.append(
            f"| {place} | {e.group} | {at} | {e.name} | {e.unit or '-'} | {e.scale:.4g} | {bounds} | {e.meaning} |"
        )
    return "\n".join(lines)


OBSERVATION_INDEX: tuple[Entry, ...] = entries(ObservationConfig())
