"""``python -m lanebound.agents.cli.static_write`` writes the static table of :mod:`.static` anew."""

from __future__ import annotations

import json
import typing
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lanebound.agents.cli.envs import facts
from lanebound.agents.cli.static import TABLE, StaticTable
from lanebound.agents.episodes.opening import open_env
from lanebound.envs.config import FaultLevel
from lanebound.envs.ids import CLASSES, METRE, PRICED, id_of
from lanebound.envs.info import INFO
from lanebound.envs.sky import SKIES

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

__all__ = ["made", "text_of"]

ROOTS = {
    "environment": "lanebound.envs.config:EnvConfig",
    "suite": "lanebound.agents.benchmark.suite:SuiteConfig",
    "experiment": "lanebound.agents.learning.experiment:ExperimentConfig",
}
NAVIGATOR = "lanebound.integrity.navigators.navigator:NavigatorConfig"
CHOSEN_BY_KIND = ("navigator",)
"""Keys of an environment that are those of a chosen kind: only keys that no kind has are refused early."""
SIGNS = ("gt", "ge", "lt", "le")


def made() -> StaticTable:
    """The table, from the environments and the configuration classes."""
    keys: dict[str, Any] = {root: _tree(_class(place)) for root, place in ROOTS.items()}
    keys["environment"] |= {key: _tree(_class(NAVIGATOR)) for key in CHOSEN_BY_KIND}
    return {
        "environments": [facts(open_env(id_of(kind))) for kind in CLASSES],
        "more_environments": [id_of(kind) for kind in (*PRICED, *METRE)],
        "info": dict(INFO),
        "skies": list(SKIES),
        "faults": [level.value for level in FaultLevel],
        "keys": keys,
    }


def text_of(table: StaticTable) -> str:
    """The table as it is stored: one key a line, so that changes of two keys merge."""
    return json.dumps(table, indent=1) + "\n"


def _class(place: str) -> Any:
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
        bounds = ((sign, getattr(item, sign)) for item in field.metadata for sign in SIGNS if hasattr(item, sign))
        return ", ".join(f"{sign} {json.dumps(bound)}" for sign, bound in bounds)
    return None


if __name__ == "__main__":
    path = Path(__file__).with_name(TABLE)
    path.write_text(text_of(made()), encoding="utf-8")
    print(path)
