"""The manual of the environments, put together from their docstrings, the fault kinds and the index of observations.

``python -m lanebound.envs.manual > docs/environments.md`` writes it.
"""

from __future__ import annotations

import inspect
import sys

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.ids import CLASSES, Preset, id_of
from lanebound.envs.observation import GROUPS, ObservationConfig, describe, group_slices
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

HEAD = """# Environments

Made from the docstrings by `python -m lanebound.envs.manual > docs/environments.md`. First what all environments share,
then a page for each id with what is particular, the kinds of faults, and every entry of an observation."""


def markdown() -> str:
    """The whole manual in Markdown."""
    parts = [HEAD, _contents(), "## What all share", _page(DrivingEnv)]
    for kind in CLASSES:
        parts += [f"## {kind.__name__}", f"`{id_of(kind)}`", _page(kind)]
    parts += ["## Fault kinds", _fault_table(), "## Observation index", _index()]
    return "\n\n".join(parts) + "\n"


def _page(kind: type[DrivingEnv]) -> str:
    """A class's docstring with its headings one level lower."""
    return (inspect.getdoc(kind) or "").strip().replace("## ", "### ")


def _contents() -> str:
    lines = ["| id | world | action | decisions a second | sky |", "|---|---|---|---|---|"]
    for kind in CLASSES:
        lines.append(_line(kind, EnvConfig.build(kind.PRESET)))
    return "\n".join(lines)


def _line(kind: type[Preset], c: EnvConfig) -> str:
    name = f"[{id_of(kind)}](#{kind.__name__.lower()})"
    return f"| {name} | `{c.base}` | {c.action.value} | {c.policy_hz} | {c.sky} |"


def _fault_table() -> str:
    """A row for each registered kind of fault."""
    head = [
        'Kinds that `reset(options={"faults": [...]})` takes. A kind without ramps has its whole size at once in any '
        "profile. A kind of your own is a `FaultKind` (`lanebound.integrity.sensors.fault_kinds`), given to "
        "`register_fault` (`lanebound.integrity.sensors.fault_registry`).\n",
        "| kind | what it changes | magnitude | profiles | needs |",
        "|---|---|---|---|---|",
    ]
    return "\n".join([*head, *map(_fault_row, fault_kinds())])


def _fault_row(kind: FaultKind) -> str:
    magnitudes = " or ".join(f"`{m.field}` [{m.unit}], {m.bounds}" for m in kind.magnitudes) or "-"
    needs = ", ".join(f"`{name}`" for name in kind.needs) or "-"
    return f"| `{kind.name}` | {kind.summary} | {magnitudes} | {', '.join(kind.profiles)} | {needs} |"


def _index() -> str:
    config = ObservationConfig()
    sizes = {group: part.stop - part.start for group, part in group_slices(config).items()}
    told = ", ".join(f"{group} {sizes[group]}" for group in GROUPS)
    return f"{sum(sizes.values())} entries: {told}. The same from Python: `describe(config)`.\n\n{describe(config)}"


if __name__ == "__main__":
    sys.stdout.write(markdown())
