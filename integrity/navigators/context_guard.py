"""The context-aware monitor beside a navigator of any kind: ``navigator.context`` in its configuration.

Once in ``interval_s`` it positions each vehicle by undifferenced codes, and judges position, speed and link of the map.
Its verdict is :attr:`.Solution.context`; with ``alerts`` a warning is an alert of the navigator too.

>>> from lanebound.integrity.navigators.navigator import NavigatorConfig
>>> NavigatorConfig.load({"context": {"matching": {"kind": "hidden_markov"}, "alerts": True}}).context.alerts
True
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Field
from lanebound.integrity.core.row_memory import Memory, Rows
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.context.code_fix import code_fix
from lanebound.integrity.monitoring.context.monitor import (
    ContextConfig,
    ContextMonitor,
    ContextReason,
    ContextVerdict,
    Light,
)
from lanebound.integrity.navigators.solution import ContextReport, Solution
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.road_map import RoadMap

if TYPE_CHECKING:
    from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["CONTEXT", "ContextGuard", "ContextGuardConfig", "GuardState", "WarningLight"]

Array = NDArray[np.float64]

CONTEXT = "context"  # name of the monitor where a kind of navigator has one of several


class WarningLight(StrEnum):
    """The light from which on the driver counts as warned."""

    AMBER = "amber"
    RED = "red"


class ContextGuardConfig(ContextConfig):
    """The context-aware monitor of a navigator, its map, and what its warnings do."""

    interval_s: float = Field(1.0, gt=0, le=60, description="time between two verdicts [s]; S5: 1 Hz")
    map_errors: MapErrorsConfig = Field(
        MapErrorsConfig(), description="errors of the vehicle's map, the same in all episodes; default: none"
    )
    map_seed: int = Field(1, ge=0, description="of the draws of the map's errors [-]")
    warns_at: WarningLight = Field(
        WarningLight.AMBER, description="amber: also where nothing is promised (S5); red: only where a test failed"
    )
    alerts: bool = Field(False, description="a warning raises the alert of the navigator")


@dataclass
class GuardState:
    """What lasts of B vehicles: memory of the monitor; epochs (B,) since the last verdict; wheels_mps (B,) sum of the
    wheel speeds since; last: the fields of the last report."""

    monitor: dict[str, Memory]
    epochs: NDArray[np.int64]
    wheels_mps: Array
    last: Memory


class ContextGuard:
    """The monitor of a batch of vehicles on one map; what lasts is in a :class:`GuardState`.

    Parameters
    ----------
    config : ContextGuardConfig
    road_map : the true map; the vehicles have it with the errors of the configuration
    dt_s : length of an epoch of the navigator
    one_in : vehicles 0, one_in, 2 one_in, ... have a monitor, the others none [-]
    """

    def __init__(self, config: ContextGuardConfig, road_map: RoadMap, dt_s: float, one_in: int = 1) -> None:
        self.config, self._one_in = config, one_in
        self.road_map = with_errors(road_map, config.map_errors, named_generator(config.map_seed, "map"))
        self.every = max(1, round(config.interval_s / dt_s))
        self._interval_s = self.every * dt_s
        self._monitor = self._of(1)

    def _of(self, batch: int) -> ContextMonitor:
        return ContextMonitor(self.config, self.road_map, batch, self._interval_s)

    def initial(self, batch: int) -> GuardState:
        """The state of vehicles that have just been switched on; their first verdict comes after an interval."""
        last = {name: value.copy() for name, value in ContextReport.none(batch)._asdict().items()}
        last["context_warning"][:], last["light"][:] = self.config.warns_at is WarningLight.AMBER, int(Light.AMBER)
        last["reason"][:] = ContextReason.COLLECTING.code
        return GuardState(self._of(batch).memory, np.zeros(batch, np.int64), np.zeros(batch), last)

    def forget(self, state: GuardState, rows: Rows) -> None:
        """Begin anew with these vehicles."""
        fresh = self.initial(state.epochs[rows].size)
        _put(vars(state), vars(fresh), rows)

    def judge(self, state: GuardState, m: Measurements, solution: Solution) -> Solution:
        """The solution with the report of the monitor after the measurements of an epoch."""
        state.epochs += 1
        state.wheels_mps += m.odometer.speed_mps
        due = np.flatnonzero(state.epochs >= self.every)
        due = due[due % self._one_in == 0] if self._one_in > 1 else due
        if due.size:
            self._look(state, m, due)
        report = ContextReport(**{name: value.copy() for name, value in state.last.items()})
        solution = replace(solution, context=report)
        return _alerted(solution, report.context_warning) if self.config.alerts else solution

    def _look(self, state: GuardState, m: Measurements, due: NDArray[np.int64]) -> None:
        """The verdicts of the vehicles that are due."""
        self._monitor.memory = state.monitor
        wheels = state.wheels_mps[due] / state.epochs[due]
        verdict = self._monitor.step(code_fix(m, self.config.codes, due), wheels, rows=due)
        state.epochs[due], state.wheels_mps[due] = 0, 0.0
        for name, value in self._report(verdict)._asdict().items():
            state.last[name][due] = value

    def _report(self, v: ContextVerdict) -> ContextReport:
        light = v.light
        warned = light >= int(Light.RED if self.config.warns_at is WarningLight.RED else Light.AMBER)
        return ContextReport(warned, v.phases, v.score, v.match.probability, light, v.reason, v.link)


def _alerted(solution: Solution, warned: NDArray[np.bool_]) -> Solution:
    """The solution with an alert where the driver is warned."""
    new = warned & ~solution.alert
    failed = AlertReason.INTEGRITY_TEST_FAILED.code
    return replace(
        solution, alert=solution.alert | warned, available=solution.available & ~warned,
        reason=np.where(new, failed, solution.reason),
    )  # fmt: skip


def _put(mine: Any, fresh: Any, rows: Rows) -> None:
    """Copy fresh arrays into the rows of those of the same names."""
    for name, value in fresh.items():
        if isinstance(value, dict):
            _put(mine[name], value, rows)
        else:
            mine[name][rows] = value
