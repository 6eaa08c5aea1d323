"""Pictures of an episode: gathers what the viewer draws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.cockpit import Cockpit
from lanebound.envs.rendering import Bodies, EpisodeCost, Frame, RenderingConfig, Satellites, Tape, Viewer
from lanebound.integrity.sky.visibility import Path

__all__ = ["Pictures"]


class Pictures:
    """A viewer and the tape of the last seconds."""

    def __init__(self, config: RenderingConfig, title: str, fps: float, cost_limit: float) -> None:
        self.viewer = Viewer(config, title=title, fps=fps)
        self.tape = Tape(config.window_s)
        self._cost = EpisodeCost(0.0, 0.0, cost_limit)

    def note(self, cockpit: Cockpit, info: dict[str, Any]) -> None:
        """Record a step for the strip charts."""
        if cockpit.time_s == 0.0:
            self.tape.clear()
            self._cost = replace(self._cost, episode=0.0)
        cost = float(info["cost"])
        self._cost = replace(self._cost, step=cost, episode=self._cost.episode + cost)
        names = ("err_at_m", "pl_at_m", "al_at_m", "err_ct_m", "pl_ct_m", "al_ct_m", "alert")
        self.tape.add(cockpit.time_s, **{name: info[name] for name in names})

    def draw(self, cockpit: Cockpit, title: str) -> NDArray[np.uint8]:
        """The picture of now, (height, width, 3)."""
        return self.viewer.render(self._frame(cockpit, title))

    def show(self, cockpit: Cockpit, title: str) -> None:
        """The same in a window."""
        self.viewer.show(self._frame(cockpit, title))

    def close(self) -> None:
        """Close the window."""
        self.viewer.close()

    def _frame(self, cockpit: Cockpit, title: str) -> Frame:
        road = cockpit.world.road
        bodies = [*road.vehicles, *road.objects]
        return Frame(
            network=road.network,
            bodies=Bodies.of(bodies),
            ego=road.vehicles.index(cockpit.ego),
            belief=cockpit.belief(),
            time_s=cockpit.time_s,
            speed_mps=float(cockpit.ego.speed),
            traffic=cockpit.traffic,
            city=cockpit.around.street.city if len(cockpit.around.street.city) else None,
            satellites=_satellites(cockpit),
            trace=self.tape.trace,
            title=title,
            cost=self._cost,
        )


def _satellites(cockpit: Cockpit) -> Satellites | None:
    """The satellites above the horizon, and how their signals come."""
    m = cockpit.measurements
    if m is None:
        return None
    up = np.flatnonzero(m.sky.elevation_rad[0] > 0.0)
    ego = cockpit.ego
    arc, lane = cockpit.around.street.where(ego.lane_index, ego.lane.local_coordinates(ego.position)[0])
    path = cockpit.around.street.mask.look(np.array([arc]), np.array([lane]), m.sky).path[0]
    tracked = m.gnss.tracked[0] & (path != Path.BLOCKED)
    return Satellites(m.sky.azimuth_rad[0, up], m.sky.elevation_rad[0, up], path[up], tracked[up], m.sky.system[up])
