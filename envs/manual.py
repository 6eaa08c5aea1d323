"""The page of the environments: ``manual.md`` with docstrings, configuration and the index of observations.

``python -m lanebound.envs.manual > docs/environments.md`` writes it.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable
from enum import Enum
from importlib.resources import files
from textwrap import fill
from typing import Any

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.ids import CLASSES, MORE, PRICED, Preset, id_of
from lanebound.envs.journeys.config import JourneyConfig
from lanebound.envs.journeys.env import Journey
from lanebound.envs.lane_sensor import LaneSensorConfig
from lanebound.envs.observation import GROUPS, OBSERVATION_INDEX
from lanebound.envs.observation.index import Entry
from lanebound.envs.registration import JOURNEY_ID, make_config
from lanebound.integrity.core.config import describe
from lanebound.integrity.sensors.fault_kinds import FaultKind
from lanebound.integrity.sensors.fault_registry import fault_kinds

__all__ = ["SECTIONS", "markdown"]

SECTIONS = (
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Costs",
    "Starting State",
    "Episode End",
    "Arguments",
    "Version History",
)
"""Of an environment's page, in Gymnasium's order."""


PAGED = (*CLASSES, *(kind for kind in MORE if kind not in PRICED))
"""Ids with a page of their own."""
PRICED_HEAD = ("id", "cost limit", "cost limit without prices", "more")


def _later(kind: type[Preset]) -> tuple[str, ...]:
    """The row of a priced id."""
    now, before = make_config(id_of(kind)), make_config(id_of(kind).replace("Priced", ""))
    more = f"`traffic.behind` {now.traffic.behind}" if now.traffic.behind else ""
    return f"`{id_of(kind)}`", f"{now.cost_limit:g}", f"{before.cost_limit:g}", more


def markdown() -> str:
    """The whole page in Markdown."""
    fields = LaneSensorConfig.model_fields.items()
    keys = ((f"`{name}`", f"{field.default:g}", str(field.description)) for name, field in fields)
    parts = {
        "CONTENTS": _contents(),
        "ALL": _page(DrivingEnv),
        "IDS": "\n\n".join(f"## {_name(kind)}\n\n{_short(kind)}" for kind in (*PAGED, Journey)),
        "JOURNEY_KEYS": _table(("key", "default", "meaning"), _journey_keys()),
        "PRICED": _table(PRICED_HEAD, map(_later, PRICED)),
        "FAULT_KINDS": _fault_table(),
        "LANE_SENSOR": _table(("key of `lane_sensor`", "default", "meaning"), keys),
        "KEYS": _keys(),
        "ENTRIES": str(len(OBSERVATION_INDEX)),
        "INDEX": _index(),
    }
    page = files("lanebound.envs").joinpath("manual.md").read_text(encoding="utf-8")
    for name, part in parts.items():
        page = page.replace(f"@{name}@", part)
    return page


SAME = re.compile(r"## [\w ]+\n(As above\.|\* v0: first version.*)(\n\n|$)")
"""A section of an id that says nothing of its own."""


def _page(kind: type[Any]) -> str:
    """A class's docstring with its headings one level lower, less the sections that say nothing of their own."""
    return SAME.sub("", (inspect.getdoc(kind) or "").strip()).strip().replace("## ", "### ")


def _name(kind: Any) -> str:
    """The name of an environment without version."""
    return "Journey" if kind is Journey else id_of(kind).removeprefix("lanebound/").removesuffix("-v0")


def _short(kind: type[Any]) -> str:
    """The page of an id: a paragraph for each section, which its name begins."""

    def filled(part: str) -> str:
        return part if part[0] == "|" else fill(part, 120, break_long_words=False, break_on_hyphens=False)

    text = re.sub(r"### ([\w ]+)\n", r"**\1.** ", _page(kind)).removeprefix("**Description.** ")
    return "\n\n".join(map(filled, text.split("\n\n")))


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    names = list(head)
    lines = [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


# Ids


def _contents() -> str:
    head = ("id", "world", "action", "sky", "cost limit")
    rows = [_line(kind, EnvConfig.build(kind.PRESET)) for kind in PAGED]
    limit = f"{JourneyConfig().cost_limit:g}"
    return _table(head, [*rows, [f"[{JOURNEY_ID}](#journey)", "streets of a city", "at junctions", "urban", limit]])


def _journey_keys() -> list[list[str]]:
    """Every key of journeys with its default, less the one that must keep it."""
    return [
        [f"`{key}`", f"{_plain(value)} {unit if value is not None else ''}".strip(), _without_source(text)]
        for key, value, unit, text in describe(JourneyConfig())
        if key != "cities.vary"
    ]


def _line(kind: type[Preset], c: EnvConfig) -> list[str]:
    name, action = f"[{id_of(kind)}](#{_name(kind).lower()})", f"{c.action.value}, {c.policy_hz} Hz"
    return [name, f"`{c.base}`", action, c.sky, f"{c.cost_limit:g}"]


# Configuration


SHORT = re.compile(r"(perception|rendering|observation|wander|cost|cost_limits|actuators|traffic|budget)\.")
"""Keys without a meaning of their own in the table: other sections of the page document them."""


def _keys() -> str:
    """Every key of the configuration with its default, less weights, which have tables, and keys of the package."""
    rows: list[list[str]] = []
    short: dict[str, list[str]] = {}
    for key, value, unit, text in describe(EnvConfig(base="highway-v0")):
        default = "needed" if key == "base" else f"{_plain(value)} {unit if value is not None else ''}".strip()
        if text.startswith("weight of") or key.startswith("reward.") or "an environment sets it" in text:
            continue
        if SHORT.match(key):
            group, _, name = key.rpartition(".")
            short.setdefault(group, []).append(f"`{name}` {default}")
        else:
            rows.append([f"`{key}`", default, _without_source(text).replace("|", "\\|")])
    parts = [
        "## Configuration keys",
        'A dot separates levels: `cost.response_s` is `config={"cost": {"response_s": 0.5}}`. The defaults are those\n'
        "before the preset of an id.",
        _table(("key", "default", "meaning"), rows),
        "Weights are keys such as `reward.progress` and `cost.lane` (of `cost_lane`), with the defaults of the tables\n"
        "of [rewards](#rewards) and [costs](#costs). Keys that other sections describe (`budget`: [terms and\n"
        "sources](results/alert-limits.md#the-budget)), and scales of observations:",
        _table(("group", "keys and defaults"), ([f"`{group}`", ", ".join(keys)] for group, keys in short.items())),
    ]
    return "\n\n".join(parts)


def _without_source(text: str) -> str:
    """A description without the parts that only say where a number comes from."""
    first, *more = text.split("; ")
    return "; ".join([first, *(part for part in more if ":" in part or part.startswith(("must", "not ", "or ")))])


def _plain(value: Any) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_plain, value))}]"
    if value == {}:
        return "empty"
    return f"{value:g}" if isinstance(value, float) else str(value)


# Faults


def _fault_table() -> str:
    """A row for each registered kind of fault."""
    return _table(("`kind`", "effect", "magnitude", "profiles", "needs"), map(_fault_row, fault_kinds()))


def _fault_row(kind: FaultKind) -> list[str]:
    magnitudes = " or ".join(f"`{m.field}` [{m.unit}], {m.bounds}" for m in kind.magnitudes) or "-"
    needs = ", ".join(f"`{name}`" for name in kind.needs) or "-"
    return [f"`{kind.name}`", kind.summary, magnitudes, ", ".join(kind.profiles), needs]


# Observations


def _index() -> str:
    """Every entry of the default observation; entries that repeat for vehicles, distances and sides stand once."""
    members: dict[tuple[str, str], list[Entry]] = {}
    for entry in OBSERVATION_INDEX:
        members.setdefault((entry.group, _pattern(entry.name)), []).append(entry)
    parts = []
    for group in GROUPS:
        rows = [_row(pattern, entries) for (of, pattern), entries in members.items() if of == group]
        parts += [f"### {group}", _table(("entry", "range", "meaning"), rows)]
    return "\n\n".join(parts)


DISTANCE = re.compile(r"(?<=_)(\d+)(?=m(_|$))")
AXIS = re.compile(r"^(v\{i\}_)?(pl|al|ratio|margin|trend)_(at|ct)(?=_|$)")
SIDE = re.compile(r"^left(?=_exists)|^right(?=_exists)|(?<=^target_)(left|right)|(?<=^sky_\{d\}m_)\w+")
ONE_OF = re.compile(r"^(reason|mode)_(\w+)$")


def _pattern(name: str) -> str:
    """A name without the number of a vehicle or distance, the axis, the side, or the case of which one flag is set."""
    plain = ONE_OF.sub(r"\1_{case}", re.sub(r"^v\d+_", "v{i}_", name))
    return SIDE.sub("{side}", DISTANCE.sub("{d}", AXIS.sub(r"\1\2_{axis}", plain)))


def _row(pattern: str, members: list[Entry]) -> list[str]:
    entry = members[0]
    meaning = entry.meaning
    if pattern.endswith("_{case}"):
        cases = ", ".join(f"`{member.name.partition('_')[2]}`" for member in members)
        return [f"`{pattern}`", "flag", f"one flag for each {pattern[:-7]}: {cases}"]
    found = DISTANCE.search(entry.name)
    if found is not None:
        meaning = meaning.replace(f"{found[1]} m", "d")
    if "{axis}" in pattern:
        meaning = meaning.replace("along track", "on the axis").replace("along the heading of the car", "on the axis")
    if "{side}" in pattern:
        meaning = re.sub(r"\bleft\b", "{side}", meaning)
    scale = f"{entry.scale:.4g}" if len({other.scale for other in members}) == 1 else "d"
    reach = f"0 to {scale}" if entry.low == 0.0 else f"±{scale}"
    is_flag = (entry.low, entry.scale, entry.unit) == (0.0, 1.0, "") and not entry.name.endswith("_share")
    shown = "flag" if is_flag else f"{reach} {entry.unit}".strip()
    return [f"`{pattern}`", shown, meaning]


if __name__ == "__main__":
    sys.stdout.write(markdown())
