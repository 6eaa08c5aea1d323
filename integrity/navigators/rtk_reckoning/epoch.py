"""The epoch of ``rtk_reckoning``: one table of stages in their order, and the points where others attach."""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numba

from lanebound.integrity.core.compile_ahead import Ahead
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning import epoch_kernel as kernels
from lanebound.integrity.navigators.rtk_reckoning.drift_stage_kernel import watch_drift
from lanebound.integrity.navigators.rtk_reckoning.float_stage_kernel import add_to_filter
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.rtk_reckoning.stages import Point, SeparateStage, Stage
from lanebound.integrity.navigators.rtk_reckoning.wrong_stage_kernel import make_integers_wrong

if TYPE_CHECKING:
    from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
    from lanebound.integrity.navigators.services.stage import ServiceSet

__all__ = ["STAGES", "EpochCall", "EpochStages", "Listed", "carrier_stages"]

MODES = "modes"
"""Place of the positioning modes in the table: those that the configuration names, in its order."""


NOT_PLAIN = {"floats", "drift", "wrong integers"}
"""Stages that :func:`~.epoch_kernel.locate` leaves out; they run only if a configuration or a fault needs them."""

OF_CARRIERS = {"carriers", "floats", "integers", "wrong integers", "fix"}
"""Stages that are left out where no service uses carrier phases."""


class Listed(NamedTuple):
    """A stage of the table: its name, what it is, what it reads and what it writes, and the function."""

    name: str
    kind: str
    reads: str
    writes: str
    stage: Stage


STAGES: tuple[Listed | Point | str, ...] = (
    Listed("begin", "clock", "dt", "clocks, empty work", kernels.begin),
    Point.MEASURED,
    Listed("velocity", "estimator", "range rates", "velocity, faults.now", kernels.find_velocity),
    Point.VELOCITY,
    Listed("heading", "estimator", "gyro, velocity, odometer", "heading, step", kernels.find_attitude),
    Listed("admission", "monitor", "velocity, heading", "doppler_moves", kernels.admit_doppler),
    Listed("carriers", "estimator", "phases, lock, C/N0", "marks, ambiguities.held", kernels.follow_carriers),
    Listed("floats", "estimator", "codes, phases", "filters", add_to_filter),
    Listed("integers", "estimator", "codes, phases, filters", "ambiguities, fixed.status", kernels.resolve_integers),
    Listed("wrong integers", "fault", "next_best", "integer_error", make_integers_wrong),
    Listed("fix", "estimator, bound", "held phases", "fixed, fixed_levels", kernels.find_fixed_position),
    Point.FIX,
    Point.ESTIMATED,
    MODES,
    Listed("stay", "mode", "mode", "growth", kernels.advance_nothing),
    Listed("separation", "monitor", "faults.now, step, run", "faults", kernels.separate_doppler),
    Listed("odometer", "monitor", "speed, accelerations, velocity", "watch, unbounded", kernels.watch_speeds),
    Listed("histories", "monitor", "position, both headings", "doubt", kernels.follow_histories),
    Point.MOVED,
    Listed("reckoned levels", "bound", "growth, faults, starts", "levels", kernels.find_reckoned_levels),
    Point.OFFERED,
    Listed("drift", "monitor", "fixed, path", "drift, anchors, jump", watch_drift),
    Listed("jump", "monitor", "fixed, levels, backup", "accepted", kernels.judge_fix),
    Listed("heading doubt", "monitor", "fixed, both paths", "doubt, heading", kernels.judge_histories),
    Point.JUDGED,
    Listed("take", "position", "accepted, fixed", "position, starts, growth", kernels.take_fix),
    Point.TAKEN,
    Listed("widen", "monitor", "jump, fixed_levels", "levels", kernels.widen_levels),
    Point.BOUNDED,
    Listed("report", "output", "everything", "alert, out", kernels.report),
    Point.REPORTED,
)


class EpochStages:
    """The stages of a configuration, as callables ``stages(first, last, epoch, states)``; states (B,) by name.

    The plain configuration is one compiled function. With services, with plug-in modes or stages, with a drift
    watch or a filter of float ambiguities, the stages are called one after another from Python.
    """

    def __init__(self, config: RtkReckoningConfig, services: ServiceSet) -> None:
        rtk, modes = config.positioning.rtk, [mode.stage for mode in config.chosen_modes]
        of_services = services.stages
        at = {point: list(of_services.get(point, ())) for point in Point}
        for extra in config.extra_stages:
            for point, stage in extra.stages.items():
                at[point].append(stage)
        left_out = set() if rtk.float_solution.kind == "sequential" else {"floats"}
        left_out |= set() if rtk.drift.anchors else {"drift"}
        if not services.with_rtk:
            left_out |= OF_CARRIERS
            at[Point.FIX].clear()
        self._every = _listed(at, modes, left_out)
        self._faultless = _listed(at, modes, left_out | {"wrong integers"})
        if self._faultless == PLAIN:
            self._faultless = [kernels.locate]  # compiled as one function

    def compile_ahead(self, make: Callable[[], Epoch]) -> None:
        """Begin to compile the plain epoch, in a second process too, if it is not cached; ``make`` returns an epoch."""
        global _ahead
        if _ahead is not None or self._faultless != [kernels.locate] or kernels.locate.overloads:
            return
        if Ahead.helps([*PLAIN, kernels.locate]):
            _ahead = Ahead(PLAIN, (numba.int64, numba.int64, numba.typeof(make()))).start()

    def for_epoch(self, observed: Records) -> EpochCall:
        """The stages of an epoch, of which OBSERVED_VEHICLE (B,) is given; integers are made wrong only by a fault."""
        _finish_ahead()
        return EpochCall(self._every if observed["next_best"].any() else self._faultless)


class EpochCall(NamedTuple):
    """Stages that are called one after another."""

    stages: list[Any]

    @property
    def changes_signals(self) -> bool:
        """Whether a stage may exclude satellites or make integers wrong: then it needs a copy of the measurements."""
        return len(self.stages) > 1

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        for stage in self.stages:
            if isinstance(stage, SeparateStage):
                stage(first, last, epoch, states)
            else:
                stage(first, last, epoch)


def _listed(at: Mapping[Point, list[Any]], modes: list[Any], left_out: set[str]) -> list[Any]:
    """The stages of the table in their order, with those that attach ``at`` its points and without some."""
    found: list[Any] = []
    for part in STAGES:
        if isinstance(part, Point):
            found += at.get(part, [])
        elif part == MODES:
            found += modes
        elif isinstance(part, Listed) and part.name not in left_out:
            found.append(part.stage)
    return found


PLAIN = _listed({}, [kernels.advance_doppler, kernels.advance_imu_odometer], NOT_PLAIN)
"""The stages of :func:`~.epoch_kernel.locate`."""
_ahead: Ahead | None = None  # of this process


def _finish_ahead() -> None:
    """Wait once for the kernels that are compiled ahead."""
    global _ahead
    if _ahead is not None:
        _ahead.finish()
        _ahead = None


def carrier_stages(sequential: bool) -> list[Stage]:
    """The stages that follow carriers, resolve their integers and find the position by RTK."""
    left_out = {"wrong integers"} if sequential else {"wrong integers", "floats"}
    return [p.stage for p in STAGES if isinstance(p, Listed) and p.name in OF_CARRIERS - left_out]
