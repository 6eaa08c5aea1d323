"""How often the hard rules changed actions, in steps and over episodes of N environments."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.agents.drivers.rules import RULES, Projected

__all__ = ["INTERVENTIONS_KEY", "Interventions"]

INTERVENTIONS_KEY = "episode_interventions"


class Interventions:
    """Counts of the running episodes.

    Parameters
    ----------
    count : number N of environments
    """

    def __init__(self, count: int) -> None:
        self._totals = np.zeros((count, 2 + len(RULES)), dtype=np.int64)
        self._step = np.zeros((count, 2 + len(RULES)), dtype=np.int64)

    def add(self, found: Projected) -> None:
        """Add the decisions of N environments."""
        none = np.zeros_like(found.changed)
        rows = [~none, found.changed, *(found.by.get(name, none) for name in RULES)]
        self._step = np.stack([np.atleast_1d(row) for row in rows], axis=-1).astype(np.int64)
        self._totals += self._step

    def write(self, info: dict[str, Any], row: int, ended: bool) -> None:
        """Write the last decision of an environment into its info, and the counts of an episode that ended.

        ``intervened`` whether a rule changed the action; ``intervened_by`` the names of these rules;
        ``episode_interventions`` a dict of ``decisions``, ``intervened`` and each rule.
        """
        changed = self._step[row]
        info["intervened"] = bool(changed[1])
        info["intervened_by"] = tuple(name for name, one in zip(RULES, changed[2:], strict=True) if one)
        if ended:
            totals = self._totals[row].tolist()
            info[INTERVENTIONS_KEY] = dict(zip(("decisions", "intervened", *RULES), totals, strict=True))
            self._totals[row] = 0

    def clear(self) -> None:
        """Begin the counts of all environments."""
        self._totals[:] = 0
