"""The published index: every entry of an observation with its unit, scale, bounds and meaning.

An entry is ``clip(quantity / scale, low, high)``, float32; nothing is NaN or infinite. What is missing reads as said in
its meaning: a missing protection level is the clipped maximum with its ``exists`` flag 0, never 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from lanebound.envs.observation.config import ObservationConfig
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["GROUPS", "LANES", "OBSERVATION_INDEX", "STEERING_MAX_RAD", "Entry", "describe", "entries", "group_slices"]

GROUPS = ("ego", "integrity", "road", "traffic")
LANES = ("left", "own", "right")
STEERING_MAX_RAD = pi / 3  # ControlledVehicle.MAX_STEERING_ANGLE of highway-env


@dataclass(frozen=True)
class Entry:
    """One number of an observation: ``clip(quantity / scale, low, high)``.

    Attributes
    ----------
    name, group : what it is called, unique in its group, and the group it belongs to
    unit : of the quantity, "" for a pure number
    scale : of which one is shown [unit]
    low, high : bounds of the entry
    meaning : what it is, its sign, and how it reads when missing
    """

    name: str
    group: str
    unit: str
    scale: float
    low: float
    high: float
    meaning: str

    @property
    def column(self) -> str:
        """Name that is unique in the whole observation, ``ego.speed``."""
        return f"{self.group}.{self.name}"


def _signed(group: str, name: str, unit: str, scale: float, meaning: str) -> Entry:
    return Entry(name, group, unit, scale, -1.0, 1.0, meaning)


def _positive(group: str, name: str, unit: str, scale: float, meaning: str) -> Entry:
    return Entry(name, group, unit, scale, 0.0, 1.0, meaning)


def _flag(group: str, name: str, meaning: str) -> Entry:
    return Entry(name, group, "", 1.0, 0.0, 1.0, meaning)


def _ego(config: ObservationConfig) -> list[Entry]:
    c, g = config, "ego"
    return [
        _signed(g, "speed", "m/s", c.speed_max_mps, "speed by the odometer"),
        _signed(g, "target_speed", "m/s", c.speed_max_mps, "speed set by meta-actions, else the speed itself"),
        _signed(g, "acceleration", "m/s^2", c.acceleration_max_mps2, "along the heading"),
        _signed(g, "yaw_rate", "rad/s", c.yaw_rate_max_radps, "positive turning right"),
        _signed(g, "steering", "rad", STEERING_MAX_RAD, "angle commanded last, positive right"),
        _signed(g, "heading_sin", "", 1.0, "sine of the heading less the lane's, positive pointing right"),
        _signed(g, "heading_cos", "", 1.0, "cosine of the heading less the lane's"),
        _signed(g, "lateral_offset", "m", c.offset_max_m, "from the lane's centreline, positive right"),
        _signed(g, "lateral_share", "", 2.0, "lateral offset over half the lane's width"),
        _positive(g, "lane_width", "m", c.lane_width_max_m, "width of the lane"),
        _positive(g, "lane_share", "", 1.0, "lane number over the road's last one: 0 leftmost or alone, 1 rightmost"),
        _flag(g, "left_exists", "a lane that may be entered lies to the left"),
        _flag(g, "right_exists", "a lane that may be entered lies to the right"),
        _flag(g, "target_left", "a change to a lane on the left is commanded"),
        _flag(g, "target_right", "a change to a lane on the right is commanded"),
    ]


def _integrity(config: ObservationConfig) -> list[Entry]:
    return [*_levels(config), *_outcome(config), *_sources(config)]


def _levels(c: ObservationConfig) -> list[Entry]:
    g, pl, change = "integrity", c.pl_max_m, f"change of the clipped level in the last {c.trend_window_s:g} s"
    out = []
    for axis, name in (("at", "along track"), ("ct", "across track")):
        out += [
            _positive(g, f"pl_{axis}", "m", pl, f"protection level {name}; 1 when missing"),
            _flag(g, f"pl_{axis}_exists", f"there is a protection level {name}"),
            _positive(g, f"al_{axis}", "m", pl, f"alert limit {name}"),
            _positive(g, f"ratio_{axis}", "", c.ratio_max, f"PL / AL {name}; 1 when missing"),
            _signed(g, f"margin_{axis}", "m", pl, f"AL - PL {name}, safe when >= 0; -1 when missing"),
            _signed(g, f"trend_{axis}", "m", pl, f"{change}, {name}; the first one counts as constant before"),
        ]
    return out


def _outcome(c: ObservationConfig) -> list[Entry]:
    g = "integrity"
    return [
        _flag(g, "available", "no protection level exceeds its limit now"),
        _flag(g, "alert", "the alert is on"),
        _positive(g, "alert_age", "s", c.elapsed_max_s, "how long the alert has been on; 0 without"),
        *(_flag(g, f"reason_{reason.name.lower()}", reason.value) for reason in AlertReason),
        *(_flag(g, f"mode_{mode.key}", f"source of the position: {mode.label}") for mode in Mode),
        *(_flag(g, f"rtk_{status.name.lower()}", status.value) for status in RtkStatus),
    ]


def _sources(c: ObservationConfig) -> list[Entry]:
    g, most = "integrity", c.elapsed_max_s
    return [
        _positive(g, "since_rtk", "s", most, "time since the last RTK position; 1 when never"),
        _positive(g, "since_calibration", "s", most, "time since the heading was calibrated; 1 when never"),
        _positive(g, "corrections_age", "s", most, "age of the reference data; 1 when the link is out"),
        _positive(g, "satellites", "", c.satellites_max, "used by RTK"),
        _positive(g, "satellites_doppler", "", c.satellites_max, "used by the velocity"),
        _positive(g, "excluded", "", c.excluded_max, "satellites excluded by fault detection in this epoch"),
        _positive(g, "hdop", "", c.hdop_max, "horizontal dilution of precision; 1 without satellites"),
    ]


def _road(config: ObservationConfig) -> list[Entry]:
    c, g = config, "road"
    out = [
        _positive(g, "speed_limit", "m/s", c.speed_max_mps, "of the lane; 1 when the map gives none"),
        _positive(g, "junction", "m", c.range_m, "distance to the end of the lane's own stretch of road"),
        _positive(g, "lane_end", "m", c.range_m, "distance to where no lane goes on from this one; 1 if beyond reach"),
    ]
    for d in c.preview_m:
        where = f"of the route's centreline {d:g} m ahead"
        out += [
            _flag(g, f"preview_{d:g}m_exists", f"the map goes on {d:g} m ahead; else the road is drawn on straight"),
            _signed(g, f"preview_{d:g}m_ahead", "m", d, f"point {where}, along the ego's heading"),
            _signed(g, f"preview_{d:g}m_right", "m", d, f"point {where}, to the ego's right"),
            _signed(g, f"preview_{d:g}m_heading", "rad", pi, f"direction {where} less the ego's heading"),
            _signed(g, f"preview_{d:g}m_curvature", "1/m", c.curvature_max_per_m, f"{where}, positive turning right"),
        ]
    for d in c.satellites_m:
        text = f"satellites predicted in line of sight {d:g} m ahead; -1 without a prediction or without that lane"
        out += [_signed(g, f"sky_{d:g}m_{lane}", "", c.satellites_max, f"{lane} lane: {text}") for lane in LANES]
    return out


def _traffic(config: ObservationConfig) -> list[Entry]:
    return [entry for row in range(config.vehicles) for entry in _vehicle(config, row)]


def _vehicle(c: ObservationConfig, row: int) -> list[Entry]:
    g, p = "traffic", f"v{row}_"
    kept = [
        _flag(g, p + "present", "a vehicle is perceived here; else ahead, lane_gap, age and levels read 1, the rest 0"),
        _signed(g, p + "ahead", "m", c.range_m, "middle to middle along the ego's heading"),
        _signed(g, p + "right", "m", c.range_m, "middle to middle to the ego's right"),
        _signed(g, p + "velocity_ahead", "m/s", c.speed_max_mps, "relative velocity along the ego's heading"),
        _signed(g, p + "velocity_right", "m/s", c.speed_max_mps, "relative velocity to the ego's right"),
        _signed(g, p + "heading_sin", "", 1.0, "sine of its heading less the ego's"),
        _signed(g, p + "heading_cos", "", 1.0, "cosine of its heading less the ego's"),
        _signed(g, p + "lane_gap", "m", c.range_m, "middle to middle along the ego's route; +-1 when not beside it"),
        _signed(g, p + "lane_offset", "m", c.offset_max_m, "from the route's centreline; +-1 when not beside it"),
        _flag(g, p + "own_lane", "within half a lane width of the route's centreline"),
        _flag(g, p + "left_lane", "within the next lane width to the left, whichever way that lane goes"),
        _flag(g, p + "right_lane", "within the next lane width to the right"),
        _positive(g, p + "length", "m", c.length_max_m, "of the vehicle"),
        _positive(g, p + "width", "m", c.width_max_m, "of the vehicle"),
        _positive(g, p + "age", "s", c.age_max_s, "since the measurement behind it"),
        _flag(g, p + "sensor", "seen by the ego's own sensor, else by its broadcasts"),
    ]
    if not c.shows_levels:
        return kept
    text = "the ego's level (not for a vehicle seen by sensor) and half the extent of its own box on that axis"
    return [
        *kept,
        _flag(g, p + "pl_exists", "both have the protection levels that the next two need"),
        _positive(g, p + "pl_at", "m", 2.0 * c.pl_max_m, f"along the ego's heading, {text}; 1 when missing"),
        _positive(g, p + "pl_ct", "m", 2.0 * c.pl_max_m, f"across the ego's heading, {text}; 1 when missing"),
    ]


def entries(config: ObservationConfig) -> tuple[Entry, ...]:
    """Every entry of one observation, in the order of the flat form."""
    integrity = _integrity(config) if config.shows_levels else []
    return (*_ego(config), *integrity, *_road(config), *_traffic(config))


def group_slices(config: ObservationConfig) -> dict[str, slice]:
    """Where each group that has entries lies in the flat form."""
    groups = [entry.group for entry in entries(config)]
    starts = {group: groups.index(group) for group in GROUPS if group in groups}
    return {group: slice(start, start + groups.count(group)) for group, start in starts.items()}


def describe(config: ObservationConfig | None = None) -> str:
    """The index as a table in Markdown: position in the flat form, position in its group, and the entry."""
    config = ObservationConfig() if config is None else config
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
