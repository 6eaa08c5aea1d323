"""What commands know before their slow imports: environments, names, keys and bounds, as one static table.

``python -m lanebound.agents.cli.static_write`` writes the table anew from the environments and configurations, after a
default, an id, a field or a bound has changed.
"""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import Any, TypedDict

__all__ = ["TABLE", "StaticTable", "static_table"]

TABLE = "static.json"


class StaticTable(TypedDict):
    """The table.

    ``environments`` are rows as ``lanebound envs`` lists them, ``more_environments`` the ids that it does not list,
    ``info`` the meanings of its entries, ``skies`` and ``faults`` the names of levels. In ``keys`` a configuration is a
    mapping of its keys, a text the bounds of a number (``"gt 0, le 1"``), and null what has keys of its own.
    """

    environments: list[dict[str, Any]]
    more_environments: list[str]
    info: dict[str, str]
    skies: list[str]
    faults: list[str]
    keys: dict[str, Any]


@cache
def static_table() -> StaticTable:
    """The table, read once."""
    text = resources.files("lanebound.agents.cli").joinpath(TABLE).read_text(encoding="utf-8")
    table: StaticTable = json.loads(text)
    return table
