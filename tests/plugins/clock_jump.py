"""Fault kind ``clock_jump``: the receiver clock jumps, and the ranges of all satellites with it."""

from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.fault_kinds import FaultKind, FaultMoment, FaultPrior, Magnitude
from lanebound.integrity.sensors.fault_registry import register_fault

METRES_PER_NS = 0.299792458  # speed of light


def clock_jump(effects: FaultEffects, now: FaultMoment) -> None:
    """The receiver clock jumps by t: code and phase ranges of all satellites grow by ``c t``."""
    effects.code_bias_m[now.rows] += METRES_PER_NS * now.magnitude
    effects.phase_bias_m[now.rows] += METRES_PER_NS * now.magnitude


CLOCK_JUMP = FaultKind(
    name="clock_jump",
    summary="the clock of the receiver: code and phase ranges of all satellites",
    apply=clock_jump,
    magnitudes=(Magnitude("ns"),),
    profiles=("step",),
    sizes_tried=(30.0, 300.0),
    prior=FaultPrior(per_h=0.01, median_s=60.0, low=10.0, high=1000.0),
)
register_fault(CLOCK_JUMP)
