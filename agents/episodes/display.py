"""The driver's display in a drive: a light above the pictures, and a log of its changes."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.episodes.columns import Moment
from lanebound.envs.context import DriveContext
from lanebound.envs.core import DrivingEnv

__all__ = ["WARNING_FIELDS", "DriverDisplay"]

WARNING_FIELDS = ("episode", "time_s", "light", "reason", "phases", "score", "link_probability", "road")


class DriverDisplay:
    """Watches a drive with the context-aware monitor; stands in for the environment where pictures are taken.

    Parameters
    ----------
    env : an environment with ``navigator.gnss.undifferenced``
    """

    def __init__(self, env: DrivingEnv) -> None:
        self._env, self.context = env, DriveContext(env)
        self.rows: list[dict[str, Any]] = []
        self.seconds = {"green": 0.0, "amber": 0.0, "red": 0.0}

    def __getattr__(self, name: str) -> Any:
        """What the environment has."""
        return getattr(self._env, name)

    def note(self, moment: Moment) -> None:
        """A step was taken, or an episode begins."""
        if moment.step == 0:
            self.context.begin()
        known = len(self.context.log)
        now = self.context.look()
        self.seconds[now["light"]] += self._env.dt_s
        for row in self.context.log[known:]:
            self.rows.append({"episode": moment.episode, **{name: row[name] for name in WARNING_FIELDS[1:]}})

    def render(self) -> NDArray[np.uint8] | None:
        """The picture of the environment below the light."""
        from lanebound.envs.rendering.driver_display import with_display
        from lanebound.envs.rendering.theme import THEMES

        picture, now = self._env.render(), self.context.now
        if picture is None:
            return None
        theme = THEMES[self._env.config.rendering.theme]
        return with_display(picture, now["light"], self.context.advice, now["road"], now["score"], theme)

    def write(self, path: Path) -> None:
        """Write the changes of the light as CSV."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, WARNING_FIELDS)
            writer.writeheader()
            writer.writerows(self.rows)
