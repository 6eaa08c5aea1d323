"""The epoch of ``rtk_reckoning``: one table of stages in their order, and the points where others attach."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from lanebound.integrity.navigators.rtk_reckoning import epoch_kernel as kernels
from lanebound.integrity.navigators.rtk_reckoning.float_stage_kernel import add_to_filter
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.rtk_reckoning.stages import Point, SeparateStage, Stage

if TYPE_CHECKING:
    from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
    from lanebound.integrity.navigators.services.stage import ServiceSet

__all__ = ["STAGES", "EpochStages", "Part", "carrier_stages"]

MODES = "modes"
"""Place of the positioning modes in the table: those that the configuration names, in its order."""


class Part(NamedTuple):
    """A stage of the table: its name, what it is, what it reads and what it writes, and the function."""

    name: str
    kind: str
    reads: str
    writes: str
    stage: Stage


STAGES: tuple[Part | Point | str, ...] = (
    Part("begin", "clock", "dt", "clocks, empty work", kernels.begin),
    Point.MEASURED,
    Part("velocity", "estimator", "range rates", "velocity, faults.now", kernels.find_velocity),
    Point.VELOCITY,
    Part("heading", "estimator", "gyro, velocity, odometer", "heading, step, measured", kernels.find_attitude),
    Part("carriers", "rtk", "phases, lock, C/N0", "marks, ambiguities.held", kernels.follow_carriers),
    Part("floats", "rtk, sequential", "codes, phases", "filters", add_to_filter),
    Part("integers", "rtk", "codes, phases, filters", "ambiguities, fixed.status", kernels.resolve_integers),
    Part("fix", "rtk", "held phases", "fixed, fixed_levels", kernels.find_fixed_position),
    Point.FIX,
    Point.ESTIMATED,
    MODES,
    Part("stay", "mode", "mode", "growth", kernels.advance_nothing),
    Part("separation", "monitor", "faults.now, step, run", "faults", kernels.separate_doppler),
    Part("odometer", "monitor", "speed, accelerations, velocity", "watch, unbounded", kernels.watch_speeds),
    Part("histories", "monitor", "position, both headings", "doubt", kernels.follow_histories),
    Point.MOVED,
    Part("levels", "bound", "growth, faults, starts", "levels", kernels.find_levels),
    Point.OFFERED,
    Part("drift", "monitor", "fixed, path", "drift, anchors, jump", kernels.watch_drift),
    Part("jump", "monitor", "fixed, levels, backup", "accepted", kernels.judge_fix),
    Part("heading doubt", "monitor", "fixed, both paths", "doubt, heading", kernels.judge_histories),
    Point.JUDGED,
    Part("take", "position", "accepted, fixed", "position, starts, growth", kernels.take_fix),
    Point.TAKEN,
    Part("widen", "monitor", "jump, fixed_levels", "levels", kernels.widen_levels),
    Point.BOUNDED,
    Part("report", "output", "everything", "alert, out", kernels.report),
    Point.REPORTED,
)


class EpochStages:
    """The stages of a configuration as one callable: ``stages(first, last, epoch, states)``.

    The plain configuration is one compiled function. With services, or with modes or monitors from outside, the stages
    are called one after another from Python. states (B,) of records by name.
    """

    def __init__(self, config: RtkReckoningConfig, services: ServiceSet) -> None:
        at = {point: list(services.stages.get(point, ())) for point in Point}
        for monitor in config.chosen_monitors:
            for point, stage in monitor.stages.items():
                at[point].append(stage)
        modes = tuple(mode.stage for mode in config.chosen_modes)
        left_out = set() if config.positioning.rtk.float_solution.kind == "sequential" else {"floats"}
        if not services.with_rtk:
            left_out |= {part.name for part in STAGES if isinstance(part, Part) and "rtk" in part.kind}
            at[Point.FIX].clear()
        plain = modes == (kernels.advance_doppler, kernels.advance_imu_odometer) and not any(at.values())
        self._stages: list[Any] = []
        if plain and left_out == {"floats"}:
            self._stages.append(kernels.locate)
            return
        for part in STAGES:
            if isinstance(part, Point):
                self._stages += at[part]
            elif part == MODES:
                self._stages += modes
            elif isinstance(part, Part) and part.name not in left_out:
                self._stages.append(part.stage)

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        for stage in self._stages:
            if isinstance(stage, SeparateStage):
                stage(first, last, epoch, states)
            else:
                stage(first, last, epoch)


def carrier_stages(sequential: bool) -> list[Stage]:
    """The stages that follow carriers, resolve their integers and find the position by RTK."""
    left_out = "" if sequential else "floats"
    return [p.stage for p in STAGES if isinstance(p, Part) and "rtk" in p.kind and p.name != left_out]
