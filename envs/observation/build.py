"""From the frame that the kernels fill to the vector or dict that an agent sees, with what came before."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.envs.observation.config import ObservationConfig
from lanebound.envs.observation.index import Entry, entries, group_slices

__all__ = ["Frame", "Observation", "Observer"]

Frame = NDArray[np.float32]
Observation = Frame | dict[str, Frame]


class Observer:
    """The forms of observations of one configuration, and the stack of one environment.

    Parameters
    ----------
    config : what to show

    Attributes
    ----------
    space : Gymnasium space of observations: a one-level Dict of Boxes or one Box, float32
    index : the entries of one observation in the order of the flat form
    slices : where each group lies in the flat form
    """

    def __init__(self, config: ObservationConfig | None = None) -> None:
        self.config = ObservationConfig() if config is None else config
        self.index: tuple[Entry, ...] = entries(self.config)
        self.slices = group_slices(self.config)
        self.space: spaces.Space[Any] = self._make_space()
        self._frames: list[Frame] = []

    def _make_space(self) -> spaces.Space[Any]:
        if self.config.form == "flat":
            return self._box(self.index)
        return spaces.Dict({group: self._box(self.index[part]) for group, part in self.slices.items()})

    def _box(self, shown: tuple[Entry, ...]) -> spaces.Box:
        low, high = np.array([(e.low, e.high) for e in shown], dtype=np.float32).T
        return spaces.Box(np.tile(low, self.config.history), np.tile(high, self.config.history), dtype=np.float32)

    def reset(self) -> None:
        """Forget the episode: the next observation is repeated to fill the history."""
        self._frames.clear()

    def observe(self, frame: Frame) -> Observation:
        """One observation, inside ``space``, of the newest frame (E,) and those before it; call it once a step."""
        frames = self._frames
        frames.extend([frame.copy()] * (1 if frames else self.config.history))
        del frames[: -self.config.history]
        if self.config.form == "flat":
            return np.concatenate(frames)
        return {group: np.concatenate([old[part] for old in frames]) for group, part in self.slices.items()}
