"""From belief, perceived traffic, map and predicted sky to the bounded vector or dict that an agent sees."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import isnan
from struct import pack
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.envs.observation.config import ObservationConfig
from lanebound.envs.observation.groups import ego_values, integrity_values, road_values, traffic_values
from lanebound.envs.observation.index import Entry, entries, group_slices
from lanebound.envs.observation.path import RoadMap, Step
from lanebound.envs.records import EgoBelief, Traffic
from lanebound.integrity.core.errors import InputError

__all__ = ["Observation", "Observer"]

Vector = NDArray[np.float32]
Observation = Vector | dict[str, Vector]

EPS_S = 1e-6  # a window of 1 s holds ten epochs of 0.1 s, whatever they sum to


class Observer:
    """Builds observations; remembers what stacking and trends need, so call it once a step and ``reset`` each episode.

    Parameters
    ----------
    config : what to show

    Attributes
    ----------
    space : Gymnasium space of ``observe``: a one-level Dict of Boxes or one Box, float32
    index : the entries of one observation in the order of the flat form
    satellites_m : where ``street_ahead`` is to be predicted, ahead of the ego along its route
    """

    def __init__(self, config: ObservationConfig | None = None) -> None:
        self.config = ObservationConfig() if config is None else config
        self.index: tuple[Entry, ...] = entries(self.config)
        self.satellites_m = np.array(self.config.satellites_m)
        self._slices = group_slices(self.config)
        self._factor = 1.0 / np.array([e.scale for e in self.index])
        self._format = f"{len(self.index)}d"
        self._low = np.array([e.low for e in self.index])
        self._high = np.array([e.high for e in self.index])
        self.space: spaces.Space[Any] = self._make_space()
        self._roads: RoadMap | None = None
        self._frames: deque[Vector] = deque(maxlen=self.config.history)
        self._levels: deque[tuple[float, float, float]] = deque()

    @property
    def slices(self) -> dict[str, slice]:
        """Where each group lies in the flat form."""
        return self._slices

    def _make_space(self) -> spaces.Space[Any]:
        if self.config.form == "flat":
            return self._box(slice(None))
        return spaces.Dict({group: self._box(part) for group, part in self._slices.items()})

    def _box(self, part: slice) -> spaces.Box:
        low, high = (np.tile(bound[part].astype(np.float32), self.config.history) for bound in (self._low, self._high))
        return spaces.Box(low, high, dtype=np.float32)

    def reset(self) -> None:
        """Forget the episode: the next observation is repeated to fill the history, and trends start at 0."""
        self._frames.clear()
        self._levels.clear()

    def observe(
        self,
        belief: EgoBelief,
        traffic: Traffic,
        street_ahead: NDArray[np.generic] | None,
        network: Any,
        route: Sequence[Step] | None = None,
    ) -> Observation:
        """One observation, inside ``space``.

        Parameters
        ----------
        belief, traffic : what the ego knows; the true state for ``integrity: oracle``
        street_ahead : (D, 3) line-of-sight satellites predicted at ``satellites_m`` on the lanes left, own and right of
            the believed pose; negative: no prediction; None: none at all
        network : the ego's map, a road network of highway-env; not changed while it is in use
        route : lanes to be followed, as in highway-env; None: wherever the lane leads

        Raises
        ------
        InputError
            An input is NaN, or ``street_ahead`` has another shape.
        """
        frame = self._frame(belief, traffic, street_ahead, network, route)
        if self.config.history == 1:
            return frame if self.config.form == "flat" else {g: frame[part] for g, part in self._slices.items()}
        return self._stacked(frame)

    def _stacked(self, frame: Vector) -> Observation:
        frames = self._frames
        frames.extend([frame] * (1 if frames else self.config.history))
        if self.config.form == "flat":
            return np.concatenate(frames)
        return {group: np.concatenate([old[part] for old in frames]) for group, part in self._slices.items()}

    def _frame(
        self,
        belief: EgoBelief,
        traffic: Traffic,
        street_ahead: NDArray[np.generic] | None,
        network: Any,
        route: Sequence[Step] | None,
    ) -> Vector:
        config = self.config
        path = self._map_of(network).path(belief.lane_index, route)
        values = ego_values(belief, path)
        if config.shows_levels:
            values += integrity_values(belief, self._trends(belief), config.integrity == "oracle")
        values += road_values(config, belief, path, street_ahead)
        values += traffic_values(config, belief, traffic, path)
        return self._bounded(values)

    def _map_of(self, network: Any) -> RoadMap:
        if self._roads is None or self._roads.network is not network:
            reach = max(self.config.range_m, *self.config.preview_m, 0.0)
            self._roads = RoadMap(network, behind_m=self.config.range_m, ahead_m=reach)
        return self._roads

    def _trends(self, belief: EgoBelief) -> tuple[float, float]:
        """Change of the clipped levels AT and CT over the last window [m]."""
        if self.config.integrity == "oracle":
            return 0.0, 0.0
        most, levels, now = self.config.pl_max_m, self._levels, belief.time_s
        at, ct = min(belief.pl_at_m, most), min(belief.pl_ct_m, most)
        levels.append((now, at, ct))
        since = now - self.config.trend_window_s + EPS_S
        while len(levels) > 1 and levels[1][0] <= since:
            levels.popleft()
        return at - levels[0][1], ct - levels[0][2]

    def _bounded(self, values: list[float]) -> Vector:
        scaled = np.frombuffer(pack(self._format, *values)) * self._factor  # half the time of np.array
        np.maximum(scaled, self._low, out=scaled)
        np.minimum(scaled, self._high, out=scaled)
        if isnan(scaled.dot(scaled)):
            names = [e.column for e, bad in zip(self.index, np.isnan(scaled), strict=True) if bad]
            raise InputError(f"{', '.join(names)} must be a number, got nan: mend the belief, traffic or map behind it")
        return scaled.astype(np.float32)
