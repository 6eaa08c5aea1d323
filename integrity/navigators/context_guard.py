"""The context-aware monitor next to a navigator of any kind: ``navigator.context`` in its configuration.

Once in ``interval_s`` it judges position, speed and link of the map. The position is that of the navigator, with its
levels and tests (``judges: vehicle``), or one of its own by codes under weighted RAIM (``codes``, S5). The
speed is by range rates in both. Its verdict is :attr:`.Solution.context`; with ``alerts`` a warning is an alert of the
navigator too.

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
from lanebound.integrity.monitoring.context.code_fix import VehicleFix, code_fix, doppler_fit
from lanebound.integrity.monitoring.context.monitor import (
    ContextConfig,
    ContextMonitor,
    ContextReason,
    ContextVerdict,
    Light,
)
from lanebound.integrity.monitoring.context.position_phase import PositionTest
from lanebound.integrity.navigators.solution import ContextReport, Solution
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["CONTEXT", "ContextGuard", "ContextGuardConfig", "GuardState", "Judged", "WarningLight", "judged_position"]

Array = NDArray[np.float64]

CONTEXT = "context"  # name of the monitor where a kind of navigator has one of several


class WarningLight(StrEnum):
    """The light from which on the driver counts as warned."""

    AMBER = "amber"
    RED = "red"


class Judged(StrEnum):
    """The position that is judged."""

    VEHICLE = "vehicle"
    CODES = "codes"


class ContextGuardConfig(ContextConfig):
    """The context-aware monitor of a navigator, its map, and what its warnings do."""

    judges: Judged = Field(
        Judged.VEHICLE,
        description="vehicle: the navigator's position, levels and tests; codes: a code position under weighted RAIM",
    )
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
    radial : each of the navigator's two levels bounds the whole horizontal error
    """

    def __init__(
        self, config: ContextGuardConfig, road_map: RoadMap, dt_s: float, one_in: int = 1, radial: bool = False
    ) -> None:
        self.config, self._one_in, self._radial = config, one_in, radial
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
            self._look(state, m, solution, due)
        report = ContextReport(**{name: value.copy() for name, value in state.last.items()})
        solution = replace(solution, context=report)
        return _alerted(solution, report.context_warning) if self.config.alerts else solution

    def _look(self, state: GuardState, m: Measurements, solution: Solution, due: NDArray[np.int64]) -> None:
        """The verdicts of the vehicles that are due."""
        self._monitor.memory, c = state.monitor, self.config
        wheels = state.wheels_mps[due] / state.epochs[due]
        if c.judges is Judged.CODES:
            verdict = self._monitor.step(code_fix(m, c.codes, due), wheels, rows=due)
        else:
            mine = solution.rows(due)
            rates = doppler_fit(m, c.codes, due)
            fix = VehicleFix(
                mine.mode != int(Mode.NONE), mine.position_en_m, mine.covariance_en_m2, rates.solved,
                rates.x_m[:, :2], rates.cofactor[:, :2, :2],
            )  # fmt: skip
            verdict = self._monitor.step(
                fix, wheels, judged_position(mine, c.position.alert_limit_m, self._radial), rows=due
            )
        state.epochs[due], state.wheels_mps[due] = 0, 0.0
        for name, value in self._report(verdict)._asdict().items():
            state.last[name][due] = value

    def _report(self, v: ContextVerdict) -> ContextReport:
        light = v.light
        warned = light >= int(Light.RED if self.config.warns_at is WarningLight.RED else Light.AMBER)
        return ContextReport(warned, v.phases, v.score, v.match.probability, light, v.reason, v.link)


def judged_position(solution: Solution, alert_limit_m: float, radial: bool = False) -> PositionTest:
    """The first phase by the levels of the navigator against the alert limit, and by its own tests.

    ``sqrt(PL_AT^2 + PL_CT^2)`` bounds the horizontal error at the navigator's risk, which both axes share. With
    ``radial`` either of them does.
    """
    at, ct = solution.pl_at_m, solution.pl_ct_m
    level = np.minimum(at, ct) if radial else np.hypot(at, ct)
    consistent = solution.reason != AlertReason.INTEGRITY_TEST_FAILED.code
    return PositionTest(
        level, np.zeros(level.size), np.full(level.size, np.inf), level <= alert_limit_m, np.asarray(consistent)
    )


def _alerted(solution: Solution, warned: NDArray[np.bool_]) -> Solution:
    """The solution with an alert where the driver is warned."""
    new = warned & ~solution.alert
    return replace(
        solution, alert=solution.alert | warned, available=solution.available & ~warned,
        reason=np.where(new, AlertReason.CONTEXT_WARNING.code, solution.reason),
    )  # fmt: skip


def _put(mine: Any, fresh: Any, rows: Rows) -> None:
    """Copy fresh arrays into the rows of those of the same names."""
    for name, value in fresh.items():
        if isinstance(value, dict):
            _put(mine[name], value, rows)
        else:
            mine[name][rows] = value
