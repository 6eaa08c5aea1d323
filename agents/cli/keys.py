"""Refusal of wrong keys and numbers of ``--set`` before the slow imports, by the static table."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from lanebound.agents.cli.static import static_table

__all__ = ["refuse_keys"]


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
