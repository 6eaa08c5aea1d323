"""What commands know and refuse before their slow imports, by one static table: environments, names, keys and bounds.

``python -m lanebound.agents.cli.static_write`` writes the table anew from the environments and configurations, after a
default, an id, a field or a bound has changed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypedDict

from lanebound.agents.drivers import AGENTS, bare_name, unknown_agent

TABLE = "static.json"


class StaticTable(TypedDict):
    """The table.

    ``environments`` are rows as ``lanebound envs`` lists them, ``more`` the other ids of ours, ``info`` the meanings of
    its entries, ``skies`` and ``faults`` the names of levels. In ``keys`` a configuration is a mapping of its keys, a
    text the bounds of a number (``"gt 0, le 1"``), and null what has keys of its own.
    """

    environments: list[dict[str, Any]]
    more: list[str]
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


def refuse_keys(root: str, changes: Mapping[str, Any]) -> None:
    """Refuse keys that a configuration does not have, and numbers out of their bounds; all else is checked later.

    Parameters
    ----------
    root : ``environment``, ``suite`` or ``experiment``
    changes : as :func:`~lanebound.agents.cli.options.changes` returns them

    Raises
    ------
    ConfigError
        As the configuration itself would refuse it later.
    """
    from lanebound.integrity.core.errors import ConfigError

    known = _known()
    for key in changes:
        if "overrides" in known[root] and key not in known[root] and key in known["environment"]:
            raise ConfigError(f"{key} is a key of an environment, not of the {root}: write overrides.{key}")
    _refuse(known[root], changes, "")


def _refuse(known: Mapping[str, Any], changes: Mapping[str, Any], path: str) -> None:
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.core.presets import nearest

    for key, value in changes.items():
        dotted = f"{path}.{key}" if path else str(key)
        if key not in known:
            advice = nearest(str(key), known)
            offered = advice.replace("did you mean '", f"did you mean '{path}.") if path else advice
            raise ConfigError(f"{dotted} is not a known key: {offered}")
        inside = known[key]
        if isinstance(inside, Mapping) and isinstance(value, Mapping) and ":" not in str(value.get("kind", "")):
            _refuse(inside, value, dotted)
        elif isinstance(inside, str):
            _refuse_number(_bounds(inside), value, dotted)


def _bounds(text: str) -> dict[str, float]:
    """Bounds of a number by their signs, from ``"gt 0, le 1"``."""
    pairs = (bound.split(" ") for bound in text.split(", ") if bound)
    return {sign: float(limit) if "." in limit or "e" in limit else int(limit) for sign, limit in pairs}


def _refuse_number(limits: Mapping[str, float], value: Any, dotted: str) -> None:
    from lanebound.integrity.core.config_errors import bound_text
    from lanebound.integrity.core.errors import ConfigError

    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    fits = {
        "gt": lambda limit: value > limit,
        "ge": lambda limit: value >= limit,
        "lt": lambda limit: value < limit,
        "le": lambda limit: value <= limit,
    }
    if not all(fits[sign](limit) for sign, limit in limits.items()):
        raise ConfigError(f"{dotted} must {bound_text(limits)}, got {value!r}: correct that value")


@cache
def _known() -> dict[str, Any]:
    tables = dict(static_table()["keys"])
    for root in ("suite", "experiment"):
        tables[root] = {**tables[root], "overrides": tables["environment"]}
    return tables


FILES = (".zip", ".onnx", ".npz", ".csv", ".yaml", ".yml")


def refuse_early(
    env: str | None = None,
    agent: str | None = None,
    sky: str | None = None,
    faults: str | None = None,
    changes: Mapping[str, Any] | None = None,
) -> None:
    """Refuse the name of an environment, agent, sky, file or level of faults that does not exist.

    ``changes`` of an environment's configuration are refused for unknown keys and numbers out of bounds.

    An environment with a module (``package:id``) or with a version may be registered elsewhere, and passes.

    Raises
    ------
    InputError
        As the command itself would raise it later.
    """
    if env is not None:
        _require_env(env)
    agent = None if agent is None else bare_name(agent)
    if agent is not None and agent not in AGENTS and ":" not in agent:
        if not agent.endswith(FILES):
            raise unknown_agent(agent)
        _require_file("agent", agent, "correct the path")
    if sky is not None and sky.endswith(".csv"):
        _require_file("sky", sky, "make it by 'lanebound record-sky'")
    elif sky is not None and not sky.endswith(FILES) and "/" not in sky:
        _require(
            "sky",
            sky,
            static_table()["skies"],
            ", or a file",
            " (files: .csv of 'lanebound record-sky', .yaml of your own)",
        )
    if changes:
        refuse_keys("environment", changes)
    if faults is not None:
        own = "; lanebound drive takes your own, too: kind=jamming,start_s=5,magnitude_db=40"
        _require("faults", faults, static_table()["faults"], how=own)


def known_skies(names: list[str] | None) -> list[str] | None:
    """The skies that ``--sky`` gives; None without any.

    Raises
    ------
    ConfigError, InputError
        One of them is no sky, or its file is refused.
    """
    from lanebound.integrity.core.errors import ConfigError, InputError

    for name in names or ():
        try:
            refuse_early(sky=name)
        except (ConfigError, InputError) as error:
            raise type(error)(f"--{error}") from None
        if "/" in name and not name.endswith(FILES):
            refuse_preset("--sky", "skies/", name)
    return names or None


def refuse_film(video: Path | None) -> None:
    """Refuse the name of a film that is no .mp4."""
    if video is not None and video.suffix != ".mp4":
        from lanebound.integrity.core.errors import InputError

        raise InputError(f"video must end in .mp4, got {video.name}: rename it")


def _require_file(what: str, name: str, remedy: str) -> None:
    from lanebound.integrity.core.errors import InputError

    if not Path(name).is_file():
        raise InputError(f"{what} must be a file that exists, got {name}: {remedy}")


def refuse_preset(what: str, folder: str, name: str, called: str | None = None) -> None:
    """Refuse a preset that does not exist, as :func:`~lanebound.agents.presets.load_named`; files are read later."""
    if not name.endswith((".yaml", ".yml")):
        from lanebound.agents.presets import require_named

        require_named(what, folder, name, called)


def _require_env(name: str) -> None:
    from lanebound.agents.presets import refuse_journey
    from lanebound.integrity.core.errors import InputError
    from lanebound.integrity.core.presets import nearest

    refuse_journey(name)
    table = static_table()
    ids = [name.partition("/")[2] for name in (*(row["id"] for row in table["environments"]), *table["more"])]
    short = name.removeprefix("lanebound/")
    ours = name != short or "-v" not in name
    if ours and ":" not in name and short.partition("-v")[0].lower() not in {i.partition("-v")[0].lower() for i in ids}:
        raise InputError(f"environment '{name}' is unknown: {nearest(short, ids)}")


def _require(what: str, name: str, known: Sequence[str], also: str = "", how: str = "") -> None:
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.core.presets import nearest

    if name not in known:
        raise ConfigError(f"{what} must be one of {', '.join(known)}{also}, got {name!r}: {nearest(name, known)}{how}")
