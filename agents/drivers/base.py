"""The interface of drivers, that of stable-baselines3's policies, and a reader of observations by name."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.observation import Entry, ObservationConfig, entries, group_slices
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["Driver", "Reader", "Starts", "StatelessDriver", "States", "in_a_row"]

Array = NDArray[np.float64]
States = tuple[NDArray[Any], ...] | None
Starts = NDArray[np.bool_] | None
Observation = NDArray[np.float32] | Mapping[str, NDArray[np.float32]]
PREVIEW = re.compile(r"preview_(.+)m_ahead")


class Driver(Protocol):
    """Decides by observations alone; has the interface of a policy of stable-baselines3."""

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """The action for an observation, or one for each of a batch, and the state of the next call."""


class StatelessDriver(ABC):
    """A driver whose action depends on the observation alone."""

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """The action for an observation, or one for each of a batch, and the unchanged state."""
        return self.act(observation), state

    @abstractmethod
    def act(self, observation: Any) -> Any:
        """The action for an observation, or one for each of a batch."""


def in_a_row(observation: Observation, history: int = 1) -> NDArray[np.float32]:
    """The flat form (..., n) of an observation that may be a dict of its groups, of which ``history`` are stacked."""
    if not isinstance(observation, Mapping):
        return np.asarray(observation, dtype=np.float32)
    parts = [np.asarray(part, dtype=np.float32) for part in observation.values()]
    frames = [part.reshape(*part.shape[:-1], history, -1) for part in parts]
    return np.concatenate(frames, axis=-1).reshape(*parts[0].shape[:-1], -1)


class Reader:
    """Reads quantities of an observation by the names of the published index, in their units.

    Works on single observations and on batches (any leading axes), as dicts or flat; of stacked observations it reads
    the newest.

    Parameters
    ----------
    config : of the observations

    Attributes
    ----------
    previews_m : distances of the previews of the route, nearest first
    """

    def __init__(self, config: ObservationConfig) -> None:
        self.config = config
        index, slices = entries(config), group_slices(config)
        self._flat = config.form == "flat"
        self._entries: dict[str, Entry] = {entry.column: entry for entry in index}
        self._place: dict[str, int] = {}
        for place, entry in enumerate(index):
            group = slice(0, len(index)) if self._flat else slices[entry.group]
            newest = (config.history - 1) * (group.stop - group.start)
            self._place[entry.column] = newest + place - group.start
        found = (PREVIEW.search(column) for column in self._entries)
        self.previews_m: tuple[float, ...] = tuple(sorted(float(match[1]) for match in found if match))

    @property
    def columns(self) -> tuple[str, ...]:
        """Every name, such as ``ego.speed``."""
        return tuple(self._entries)

    def require(self, columns: Iterable[str]) -> None:
        """Refuse an observation without these entries.

        Raises
        ------
        InputError
            The message names the first missing entry and the nearest known one.
        """
        for column in columns:
            if column not in self._entries:
                raise InputError(f"observation must show '{column}', got none: {self._remedy(column)}")

    def _remedy(self, column: str) -> str:
        """How to add an entry."""
        group = column.partition(".")[0]
        hidden = group == "integrity" and not self.config.shows_levels
        if not hidden and any(entry.group == group for entry in self._entries.values()):
            return nearest(column, self._entries)
        if group == "integrity":
            return "set observation.integrity to full, or for a driver that is imitated imitation.observation.integrity"
        return f"let it show the group '{group}'"

    def scale(self, column: str) -> float:
        """The quantity at which an entry reads 1."""
        return self._entries[column].scale

    def value(self, observation: Observation, column: str) -> Array:
        """A quantity in its unit, shaped as the leading axes of the observation."""
        entry = self._entries[column]
        vector = observation if isinstance(observation, np.ndarray) else observation[entry.group]
        return np.asarray(vector[..., self._place[column]], dtype=np.float64) * entry.scale

    def rows(self, observation: Observation, name: str) -> Array:
        """A quantity of all K vehicles of the traffic, (..., K)."""
        return np.stack([self.value(observation, f"traffic.v{k}_{name}") for k in range(self.config.vehicles)], axis=-1)
