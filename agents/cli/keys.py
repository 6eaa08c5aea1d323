"""Keys and bounds of what ``--set`` changes, as a static table: a wrong one is refused before the slow imports.

``python -m lanebound.agents.cli.keys > agents/cli/keys.json`` writes the table from the configuration classes. In it a
configuration is a mapping of its keys, a value a list of its bounds, and null what has keys of its own.
"""

from __future__ import annotations

import json
import typing
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

__all__ = ["TABLE", "refuse_keys", "table"]

TABLE = "keys.json"
ROOTS = {
    "environment": "lanebound.envs.config:EnvConfig",
    "suite": "lanebound.agents.benchmark.suite:SuiteConfig",
    "experiment": "lanebound.agents.learning.experiment:ExperimentConfig",
}
NAVIGATOR = "lanebound.integrity.navigators.navigator:NavigatorConfig"
CHOSEN_BY_KIND = ("navigator",)
"""Keys of an environment that are those of a chosen kind: only keys that no kind has are refused here."""


def refuse_keys(root: str, changes: Mapping[str, Any]) -> None:
    """Refuse keys that a configuration does not have, and numbers out of their bounds; all else is checked later.

    Parameters
    ----------
    root : a key of ``ROOTS``
    changes : as :func:`~lanebound.agents.cli.options.changes` returns them

    Raises
    ------
    ConfigError
        As the configuration itself would refuse it later.
    """
    _refuse(_known()[root], changes, "")


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
        elif isinstance(inside, list):
            _refuse_number(dict(inside), value, dotted)


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
    text = resources.files("lanebound.agents.cli").joinpath(TABLE).read_text(encoding="utf-8")
    tables: dict[str, Any] = json.loads(text)
    for root in ("suite", "experiment"):
        tables[root]["overrides"] = tables["environment"]
    return tables


def table() -> dict[str, Any]:
    """The table, from the configuration classes."""
    found: dict[str, Any] = {root: _tree(_class(place)) for root, place in ROOTS.items()}
    found["environment"] |= {key: _tree(_class(NAVIGATOR)) for key in CHOSEN_BY_KIND}
    return found


def _class(place: str) -> Any:
    from importlib import import_module

    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def _tree(model: Any) -> dict[str, Any] | None:
    """Keys of a configuration, or of all kinds of a family; None where any key is allowed."""
    if model.model_config.get("extra") == "allow":
        return None
    family: Any = getattr(model, "family", None)
    kinds = list(model.all_kinds().values()) if family is model else [model]
    tree: dict[str, Any] = {}
    for kind in kinds:
        for name, field in kind.model_fields.items():
            here = _leaf(field)
            if name in tree and tree[name] != here:
                here = {**tree[name], **here} if isinstance(here, dict) and isinstance(tree[name], dict) else None
            tree[name] = here
    return dict(sorted(tree.items()))


def _leaf(field: FieldInfo) -> Any:
    """The keys inside a field, the bounds of a number, or None."""
    from lanebound.integrity.core.config import Config

    kinds = [field.annotation, *typing.get_args(field.annotation)]
    plain = not typing.get_args(field.annotation) or type(None) in kinds
    inside = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Config)]
    if plain and inside:
        return _tree(inside[0])
    if plain and {int, float} & set(kinds):
        signs = ("gt", "ge", "lt", "le")
        return [[sign, getattr(item, sign)] for item in field.metadata for sign in signs if hasattr(item, sign)]
    return None


if __name__ == "__main__":
    print(json.dumps(table(), separators=(",", ":"), sort_keys=True))
