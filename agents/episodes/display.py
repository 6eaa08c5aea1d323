"""The driver's display in a drive: a log of its light's changes, and the light above the pictures."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.episodes.columns import Moment
from lanebound.envs.context import ShownContext, context_of
from lanebound.envs.core import DrivingEnv

__all__ = ["WARNING_FIELDS", "DriverDisplay"]

WARNING_FIELDS = ("episode", "time_s", *ShownContext._fields)


class DriverDisplay:
    """Watches the context monitor in a drive; stands in for the environment where pictures are taken.

    Parameters
    ----------
    env : an environment with ``navigator.context``

    Attributes
    ----------
    rows : the first light of each episode, and each change of light or reason, by the time of the episode
    changes : number of changes of the light
    seconds : time for which each light was on
    """

    def __init__(self, env: DrivingEnv) -> None:
        self._env = env
        self.rows: list[dict[str, Any]] = []
        self.changes = 0
        self.seconds = {"green": 0.0, "amber": 0.0, "red": 0.0}
        self._now: ShownContext | None = None

    def __getattr__(self, name: str) -> Any:
        """What the environment has."""
        return getattr(self._env, name)

    def note(self, moment: Moment) -> None:
        """A step was taken, or an episode begins."""
        before, now = None if moment.step == 0 else self._now, context_of(self._env)
        if before is not None:
            self.seconds[before.light] += self._env.dt_s
            self.changes += now.light != before.light
        if before is None or (now.light, now.reason) != (before.light, before.reason):
            time_s = round(float(moment.belief.time_s), 6)
            self.rows.append({"episode": moment.episode, "time_s": time_s, **now._asdict()})
        self._now = now

    def render(self) -> NDArray[np.uint8] | None:
        """The picture of the environment below the light."""
        from lanebound.envs.rendering.panel import with_display
        from lanebound.envs.rendering.theme import THEMES

        picture, now = self._env.render(), self._now or context_of(self._env)
        if picture is None:
            return None
        theme = THEMES[self._env.config.rendering.theme]
        return with_display(picture, now.light, now.advice, now.road, now.score, theme)

    def write(self, path: Path) -> None:
        """Write the changes of light and reason as CSV."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, WARNING_FIELDS)
            writer.writeheader()
            writer.writerows(self.rows)
