"""Pictures of an episode: gathers what the viewer draws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.belief_loop import BeliefLoop
from lanebound.envs.rendering import Bodies, EpisodeCost, Frame, RenderingConfig, Satellites, Tape, Viewer
from lanebound.integrity.sky.visibility import SignalPath

__all__ = ["Pictures"]


INCIDENTS = {"crashed": "CRASHED", "off_road": "OFF ROAD", "wrong_way": "WRONG WAY"}
"""What is shown of the true car, by the entry of ``info``."""


class Pictures:
    """A viewer and the tape of the last seconds."""

    def __init__(self, config: RenderingConfig, title: str, fps: float, cost_limit: float) -> None:
        self.viewer = Viewer(config, title=title, fps=fps)
        self.tape = Tape(config.window_s)
        self._cost = EpisodeCost(0.0, 0.0, cost_limit)
        self._incident = ""

    def note(self, loop: BeliefLoop, info: dict[str, Any]) -> None:
        """Record a step for the strip charts."""
        if loop.time_s == 0.0:
            self.tape.clear()
            self._cost = replace(self._cost, episode=0.0)
        self._incident = next((word for name, word in INCIDENTS.items() if info[name]), "")
        cost = float(info["cost"])
        self._cost = replace(self._cost, step=cost, episode=self._cost.episode + cost)
        names = ("err_at_m", "pl_at_m", "al_at_m", "err_ct_m", "pl_ct_m", "al_ct_m", "alert")
        self.tape.add(loop.time_s, **{name: info[name] for name in names})

    def draw(self, loop: BeliefLoop, title: str) -> NDArray[np.uint8]:
        """The picture of now, (height, width, 3)."""
        return self.viewer.render(self._frame(loop, title))

    def show(self, loop: BeliefLoop, title: str) -> None:
        """The same in a window."""
        self.viewer.show(self._frame(loop, title))

    def close(self) -> None:
        """Close the window."""
        self.viewer.close()

    def _frame(self, loop: BeliefLoop, title: str) -> Frame:
        road = loop.world.road
        bodies = [*road.vehicles, *road.objects]
        return Frame(
            network=road.network,
            bodies=Bodies.of(bodies),
            ego=road.vehicles.index(loop.ego),
            belief=loop.belief(),
            time_s=loop.time_s,
            speed_mps=float(loop.ego.speed),
            traffic=loop.traffic,
            city=loop.street.city if len(loop.street.city) else None,
            satellites=_satellites(loop),
            trace=self.tape.trace,
            title=title,
            cost=self._cost,
            incident=self._incident,
        )


def _satellites(loop: BeliefLoop) -> Satellites | None:
    """The satellites above the horizon, and how their signals come."""
    m = loop.measurements
    if m is None:
        return None
    up = np.flatnonzero(m.sky.elevation_rad[0] > 0.0)
    ego = loop.ego
    arc, lane = loop.street.where(ego.lane_index, ego.lane.local_coordinates(ego.position)[0])
    path = loop.street.mask.look(np.array([arc]), np.array([lane]), m.sky).path[0]
    tracked = m.gnss.tracked[0] & (path != SignalPath.BLOCKED)
    return Satellites(m.sky.azimuth_rad[0, up], m.sky.elevation_rad[0, up], path[up], tracked[up], m.sky.system[up])
