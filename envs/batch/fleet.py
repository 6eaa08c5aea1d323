"""Navigation of a fleet: the vehicles of one environment, each of which is the ego of a row of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.motion_kernel import MOTION
from lanebound.envs.batch.navigation import Approach, Flags, NavigationBatch, Rows, Starts
from lanebound.envs.batch.sky_ahead_kernel import SkyAhead, SkyRows
from lanebound.integrity.core.records import Records

__all__ = ["FleetNavigation", "order_of"]


def order_of(vehicles: int) -> Rows:
    """Numbers of the vehicles in the row of each of them, which is the first there; the others keep their order."""
    return np.array([[k, *(i for i in range(vehicles) if i != k)] for k in range(vehicles)])


class FleetNavigation(NavigationBatch):
    """One navigator locates the M vehicles of an environment once; their M rows take over its solutions.

    What a vehicle believes of itself is therefore what it broadcasts to the others. Vehicle 0 draws as the ego of a
    single environment does, and vehicles 1 and up as the others there.
    """

    def _make(self) -> None:
        super()._make()
        self._order = order_of(self.vehicles)
        self.motions = np.zeros((self.vehicles, self.vehicles), MOTION)  # of the first row; the others are not read

    def by_ego(self, of_vehicles: NDArray[Any]) -> NDArray[Any]:
        """What there is of all vehicles (M, ...) as (M, M, ...), the ego of each row first, then the others by slot."""
        return of_vehicles[self._order]

    @property
    def ahead(self) -> SkyAhead:
        """What satellites ahead of the egos are predicted from: all are in one city, below one sky."""
        where = self.where._replace(city=np.repeat(self.where.city, self.vehicles))
        sky: Any = (np.repeat(part[:1], self.vehicles, axis=0) for part in self.sky)
        return SkyAhead(where, self.forecast, SkyRows(*sky))

    def begin(self, rows: Rows, seeds: Sequence[int], starts: Starts, cars: Records, there: Flags) -> Approach:
        """As :meth:`.NavigationBatch.begin`, by the draws of the first row."""
        first: Any = (part[:1] for part in starts)
        one = super().begin(rows[:1], seeds[:1], Starts(*first), cars, there[:1])
        heard = [(time_s, self.by_ego(fixes).ravel()) for time_s, fixes in one.heard]
        return Approach(heard[-1][1], heard)

    def sense(self, rows: Rows, cars: Records, egos: Records) -> None:
        """As :meth:`.NavigationBatch.sense`, of the first row."""
        super().sense(rows[:1], cars, egos)
