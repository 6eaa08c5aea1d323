"""The log of an episode: which columns a row has, in which unit, and what they mean.

Row 0 of an episode is its start, before any action; every other row is the state after a decision was carried out.
Poses are in the plane of the world: x ahead along the first road, y to its right, headings clockwise from x.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lanebound.envs.core import DrivingEnv
from lanebound.envs.costs import CAUSES
from lanebound.envs.records import EgoBelief
from lanebound.envs.rewards import TERMS
from lanebound.envs.truth import true_lead
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest, remove_registered, require_new
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus

__all__ = ["COLUMNS", "Column", "Moment", "columns", "describe_columns", "register_column", "row_of",
           "withdraw_column"]  # fmt: skip

RTK_NAMES = {status.code: status.name.lower() for status in RtkStatus}
GAP_REACH_M = 100.0  # nobody follows a vehicle that is further ahead
Kind = Literal["int", "float", "bool", "text", "floats"]
TYPES: dict[str, tuple[type, ...]] = {
    "int": (int, np.integer),
    "float": (float, int, np.floating, np.integer),
    "bool": (bool, np.bool_),
    "text": (str,),
    "floats": (list, tuple, np.ndarray),
}
"""Types of the values of a column by its kind; ``floats`` holds values of ``float``."""


@dataclass(frozen=True)
class Moment:
    """All there is to log of one step; ``action`` is None in the first row of an episode."""

    env: DrivingEnv
    belief: EgoBelief
    episode: int
    seed: int
    step: int
    action: Any
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]

    @property
    def numbers(self) -> list[float]:
        """The action as numbers."""
        return [] if self.action is None else np.atleast_1d(np.asarray(self.action, dtype=np.float64)).tolist()

    @property
    def word(self) -> str | None:
        """The name of a meta-action."""
        labels = getattr(self.env.world.action_type, "actions", None)
        return None if self.action is None or labels is None else str(labels[int(self.action)])


@dataclass(frozen=True)
class Column:
    """One column: its name, type, unit and meaning, and how it is taken from a moment."""

    name: str
    kind: Kind
    unit: str
    meaning: str
    take: Callable[[Moment], Any]


def _lane(index: Any) -> str:
    return f"{index[0]}>{index[1]}:{index[2]}"


def _gap(env: DrivingEnv) -> float:
    """True gap to the vehicle ahead in the ego's lane, inf without one within reach."""
    assert env.belief_loop is not None
    lead = true_lead(env.belief_loop)
    return lead.gap_m if lead is not None and lead.gap_m <= GAP_REACH_M else math.inf


def _perceived(env: DrivingEnv) -> int:
    """Number of vehicles that the ego perceives."""
    return 0 if env.belief_loop is None else env.belief_loop.traffic.count


def _belief(name: str, kind: Kind, unit: str, meaning: str, field: str) -> Column:
    return Column(name, kind, unit, meaning, lambda m: getattr(m.belief, field))


def _info(name: str, kind: Kind, unit: str, meaning: str) -> Column:
    return Column(name, kind, unit, meaning, lambda m: m.info[name])


def _reward(term: str) -> Column:
    return Column(f"reward_{term}", "float", "", "unweighted", lambda m: m.info["rewards"][term])


WHEN = (
    Column("episode", "int", "", "number of the episode, from 0", lambda m: m.episode),
    Column("seed", "int", "", "seed that the episode was reset with", lambda m: m.seed),
    Column("step", "int", "", "number of the decision; 0 is the start", lambda m: m.step),
    Column("time_s", "float", "s", "since the start of the episode", lambda m: m.belief.time_s),
    Column(
        "action", "floats", "", "code of the meta-action, or continuous action; empty in row 0", lambda m: m.numbers
    ),
    Column(
        "action_name", "text", "", "name of the meta-action; null for continuous actions and in row 0", lambda m: m.word
    ),
)
TRUTH = (
    Column("true_x_m", "float", "m", "true centre of the car", lambda m: float(m.env.world.vehicle.position[0])),
    Column("true_y_m", "float", "m", "true centre of the car", lambda m: float(m.env.world.vehicle.position[1])),
    Column("true_heading_rad", "float", "rad", "true heading", lambda m: float(m.env.world.vehicle.heading)),
    _info("speed_mps", "float", "m/s", "true speed"),
    Column(
        "true_lane", "text", "", "lane nearest to the true position", lambda m: _lane(m.env.world.vehicle.lane_index)
    ),
    Column(
        "gap_m",
        "float",
        "m",
        "true gap between bumpers to the vehicle ahead in lane; inf if beyond 100 m",
        lambda m: _gap(m.env),
    ),
)
BELIEF = (
    Column("est_x_m", "float", "m", "estimated centre of the car", lambda m: float(m.belief.position_m[0])),
    Column("est_y_m", "float", "m", "estimated centre of the car", lambda m: float(m.belief.position_m[1])),
    _belief("est_heading_rad", "float", "rad", "estimated heading", "heading_rad"),
    _belief("est_speed_mps", "float", "m/s", "speed by the odometer", "speed_mps"),
    Column("est_lane", "text", "", "lane nearest to the estimate", lambda m: _lane(m.belief.lane_index)),
    _belief("est_lateral_m", "float", "m", "believed offset from its centreline, positive right", "lateral_m"),
    Column("perceived", "int", "", "vehicles perceived", lambda m: _perceived(m.env)),
)
INTEGRITY = (
    _info("err_at_m", "float", "m", "estimate less truth along (at) and across (ct, positive right) the true heading"),
    _info("err_ct_m", "float", "m", "estimate less truth along (at) and across (ct, positive right) the true heading"),
    _info("pl_at_m", "float", "m", "protection level along (at) and across (ct) the track; inf without one"),
    _info("pl_ct_m", "float", "m", "protection level along (at) and across (ct) the track; inf without one"),
    _info("al_at_m", "float", "m", "alert limit along (at) and across (ct) the track"),
    _info("al_ct_m", "float", "m", "alert limit along (at) and across (ct) the track"),
    Column("mode", "text", "", "source of the position", lambda m: Mode(m.info["mode"]).key),
    Column("rtk", "text", "", "why RTK holds or not", lambda m: RTK_NAMES[m.belief.rtk]),
    _info("alert", "bool", "", "the alert is on"),
    Column("reason", "text", "", "reason of the alert", lambda m: AlertReason.from_code(m.info["reason"]).name.lower()),
    _info("available", "bool", "", "no protection level exceeds its limit"),
    _info("tta_s", "float", "s", "time left to react to the alert, 1 s less its age; all of it without one"),
    _info("mi", "bool", "", "misleading information: available, an error above its level and within its limit"),
    _info("hmi", "bool", "", "hazardously misleading information: available, an error above its limit"),
    _belief("satellites", "int", "", "used by RTK", "satellites"),
    _belief("hdop", "float", "", "horizontal dilution of precision; inf without satellites", "hdop"),
    _belief("since_rtk_s", "float", "s", "time since the last RTK position; inf before the first", "since_rtk_s"),
    _belief("corrections_age_s", "float", "s", "age of the reference data; inf without", "corrections_age_s"),
)
SCORE = (
    _info("cost", "float", "", "weighted sum of the costs"),
    *(_info(cause, "float", "", "unweighted") for cause in CAUSES),
    Column("reward", "float", "", "weighted sum of the terms", lambda m: m.reward),
    *(_reward(term) for term in TERMS),
    _info("crashed", "bool", "", "the true car has crashed"),
    _info("off_road", "bool", "", "the true centre of the car is off the road"),
    _info("wrong_way", "bool", "", "the car has driven against its lane for 1 s"),
    _info("is_success", "bool", "", "the episode ends well here"),
    Column("terminated", "bool", "", "the episode ends here by an event", lambda m: m.terminated),
    Column("truncated", "bool", "", "the episode ends here because its time is up", lambda m: m.truncated),
)
COLUMNS: tuple[Column, ...] = (*WHEN, *TRUTH, *BELIEF, *INTEGRITY, *SCORE)
"""The columns of this package."""
_registered: list[Column] = []


def columns() -> tuple[Column, ...]:
    """All columns: those of this package, and those that were registered."""
    return (*COLUMNS, *_registered)


def register_column(column: Column) -> None:
    """Add a column to the logs of episodes from now on, those that a benchmark stores included.

    Raises
    ------
    InputError
        The name is taken or no identifier, there is no such kind, or no function to take it.
    """
    require_new("a column", column.name, {other.name for other in columns()})
    if column.kind not in TYPES:
        raise InputError(
            f"kind of column {column.name!r} must be one of {', '.join(TYPES)}, got {column.kind!r}: "
            f"{nearest(column.kind, TYPES)}"
        )
    if not callable(column.take):
        raise InputError(
            f"take of column {column.name!r} must be a function of a Moment, got {column.take!r}: give one"
        )
    _registered.append(column)


def withdraw_column(name: str) -> None:
    """Remove a registered column.

    Raises
    ------
    InputError
        There is none of this name.
    """
    remove_registered("column", name, _registered, lambda column: column.name)


def row_of(moment: Moment) -> dict[str, Any]:
    """One row of the log.

    Raises
    ------
    InputError
        The function of a registered column fails, or returns a value of another kind than the column declares.
    """
    row = {column.name: column.take(moment) for column in COLUMNS}
    return row | {column.name: _taken(column, moment) for column in _registered}


def _taken(column: Column, moment: Moment) -> Any:
    """The value of a registered column, checked."""
    try:
        value = column.take(moment)
    except Exception as exc:
        raise InputError(
            f"the function of column {column.name!r} must return a value, got {type(exc).__name__}: {exc} at seed "
            f"{moment.seed}, step {moment.step}: correct the function"
        ) from exc
    if value is not None and not _is_of(value, column.kind):
        raise InputError(
            f"the function of column {column.name!r} must return a value of kind {column.kind}, got {value!r} at seed "
            f"{moment.seed}, step {moment.step}: convert it, or declare another kind"
        )
    return value


def _is_of(value: Any, kind: Kind) -> bool:
    """Whether a value can be stored in a column of a kind."""
    if kind == "floats":
        return isinstance(value, list | tuple | np.ndarray) and all(_is_of(number, "float") for number in value)
    return isinstance(value, TYPES[kind]) and (kind == "bool" or not isinstance(value, bool))


def describe_columns() -> str:
    """The columns as a table in Markdown."""
    lines = ["| column | type | unit | meaning |", "|---|---|---|---|"]
    lines += [f"| {c.name} | {c.kind} | {c.unit or '-'} | {c.meaning} |" for c in columns()]
    return "\n".join(lines) + "\n"
