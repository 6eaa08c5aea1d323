"""Two histories of the heading while gyro and Doppler contradict each other.

The Doppler course of a vehicle that turns its wheels without slipping follows the gyro. Where it does not, either the
gyro has failed or the velocity has: a facade that reflects most satellites in use mirrors the velocity, at the same
speed, with small residuals, for seconds. Neither sensor shows which. The navigator follows the gyro at first and the
courses once the gyro could have drifted as far (:func:`due`); the other history runs on beside it, by the gyro alone.

1. ``OPEN``: courses are refused. The heading follows the gyro, the other one Doppler, and Doppler does not move the
   position. Courses that return to the heading end the doubt: a gyro that has failed does not come back by itself.
   RTK positions may show before that which of them is right, by paths that are ``DECISIVE_M`` apart.
2. ``FOLLOWS``: the heading follows Doppler, the other one the gyro as it was. The doubt ends when the two headings have
   agreed for a while, because the courses went back to the gyro, or when RTK positions decide.

Each dead reckoning carries by how much either history is off the path that was taken, ``lead`` and ``by_doppler`` of
Doppler's and ``by_gyro`` of the gyro's; exact levels add the larger on each axis until the next RTK position. The axes
of the other heading differ from those of the reported one: the levels cover both (:func:`cover_axes`).
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import record
from lanebound.integrity.positioning.heading_kernel import HEADING, copy_heading, predict_heading, raise_uncertainty

__all__ = [
    "FOLLOWS",
    "HEADING_DOUBT",
    "NONE",
    "OPEN",
    "aside",
    "cover_axes",
    "due",
    "follow_gyro",
    "follow_paths",
    "judge_by_path",
    "note_agreement",
    "note_refusal",
    "turn_to_doppler",
]

NONE, OPEN, FOLLOWS = 0, 1, 2
REACQUIRE_S = 1.0  # of Doppler courses refused for their jump, before the heading follows them, at least
GYRO_FAULT_RADPS = math.radians(30.0)  # error of a gyro that shows nothing in a turn of 12 m at 6 m/s
AGREE_S = 1.0  # of courses accepted while both headings are alike, until the doubt ends
DECISIVE_M = 1.0  # between the paths by two headings, until RTK decides; 20 times its level

HEADING_DOUBT = record(
    stage=("i8", "NONE, OPEN or FOLLOWS"),
    refused_s="how long Doppler courses have been refused for their jump [s]",
    refuses=("?", "the last course was refused"),
    agree_s="how long both headings have been alike [s]",
    other=(HEADING, "the heading of the other history"),
    step_e="path of this epoch by the other heading less that taken, East [m]",
    step_n="the same, North [m]",
    rtk_e="RTK positions less the path taken, since RTK lasts, East [m]",
    rtk_n="the same, North [m]",
    apart_e="path by the other heading less that taken, since RTK lasts, East [m]",
    apart_n="the same, North [m]",
)
"""What is known while gyro and Doppler courses contradict each other."""


@jit(borrows=True)
def _forget_paths(doubt: Any) -> None:
    """Begin anew to compare paths with RTK."""
    doubt.rtk_e, doubt.rtk_n, doubt.apart_e, doubt.apart_n = 0.0, 0.0, 0.0, 0.0


@jit(borrows=True)
def follow_gyro(delta_theta: float, rules: Any, dt: float, doubt: Any) -> None:
    """Advance the other heading by the gyro increment [rad]; ``rules`` hold the noise of the gyro."""
    if doubt.stage != NONE:
        predict_heading(delta_theta, dt, rules.angle_random_walk, rules.bias_walk, doubt.other)


@jit(borrows=True)
def note_refusal(dt: float, azimuth: float, doubt: Any) -> None:
    """A course [rad] contradicts the heading."""
    doubt.refused_s += dt
    doubt.agree_s, doubt.refuses = 0.0, True
    if doubt.stage == NONE:
        doubt.stage = OPEN
    if doubt.stage == OPEN:
        doubt.other.angle = azimuth


@jit(borrows=True)
def due(jump: float, doubt: Any) -> bool:
    """Whether courses off by ``jump`` [rad] have been refused for as long as a failed gyro needs to drift that far."""
    return bool(doubt.refused_s > max(REACQUIRE_S, abs(jump) / GYRO_FAULT_RADPS))


@jit(borrows=True)
def turn_to_doppler(jump: float, rules: Any, heading: Any, doubt: Any, growth: Any) -> None:
    """Raise the variances of the heading so that it follows the courses; the other history keeps the gyro's."""
    if doubt.stage == OPEN:
        doubt.stage = FOLLOWS
        _forget_paths(doubt)
        copy_heading(heading, doubt.other)
        for k in range(growth.shape[0]):
            g = growth[k]
            g.doppler_e, g.doppler_n = g.doppler_e + g.lead_e, g.doppler_n + g.lead_n
            g.lead_e, g.lead_n = 0.0, 0.0
    raise_uncertainty(jump, rules.bias_initial, rules.gyro_scale, heading)


@jit(borrows=True)
def note_agreement(dt: float, limit: float, heading: Any, doubt: Any, growth: Any) -> None:
    """A course is accepted: the doubt ends at once before the heading follows Doppler, and later when both are alike.

    ``limit`` is the difference of headings that are alike [rad].
    """
    doubt.refused_s, doubt.refuses = 0.0, False
    if doubt.stage == OPEN:
        doubt.stage = NONE
        _forget_paths(doubt)
        for k in range(growth.shape[0]):
            growth[k].lead_e, growth[k].lead_n = 0.0, 0.0
    elif doubt.stage == FOLLOWS:
        alike = abs(wrap(heading.angle - doubt.other.angle)) < limit
        doubt.agree_s = doubt.agree_s + dt if alike else 0.0
        if doubt.agree_s > AGREE_S:
            doubt.stage, doubt.agree_s = NONE, 0.0


@jit(borrows=True)
def follow_paths(east: float, north: float, run: float, middle: float, angle: float, doubt: Any, growth: Any) -> None:
    """Add an epoch to the paths: the vehicle was moved by (east, north) [m], and ran ``run`` [m] by the odometer.

    ``middle`` is the course in the middle of the epoch and ``angle`` the heading at its end [rad], both by the gyro
    from the heading before.
    """
    course = middle + wrap(doubt.other.angle - angle)
    doubt.step_e, doubt.step_n = run * math.sin(course) - east, run * math.cos(course) - north
    for k in range(growth.shape[0]):
        g = growth[k]
        if doubt.stage == OPEN:
            g.lead_e, g.lead_n = g.lead_e + doubt.step_e, g.lead_n + doubt.step_n
        else:
            g.gyro_e, g.gyro_n = g.gyro_e + doubt.step_e, g.gyro_n + doubt.step_n


@jit(borrows=True)
def judge_by_path(east: float, north: float, lasting: bool, heading: Any, doubt: Any) -> None:
    """Let an RTK position decide that lies (east, north) [m] off the path taken in this epoch.

    ``lasting``: the epoch before had one as well, so that the difference is that of this epoch's path.
    """
    if not lasting:
        _forget_paths(doubt)
        return
    doubt.rtk_e, doubt.rtk_n = doubt.rtk_e + east, doubt.rtk_n + north
    doubt.apart_e, doubt.apart_n = doubt.apart_e + doubt.step_e, doubt.apart_n + doubt.step_n
    if not math.hypot(doubt.apart_e, doubt.apart_n) > DECISIVE_M:
        return
    off = math.hypot(doubt.rtk_e, doubt.rtk_n)
    wrong = math.hypot(doubt.rtk_e - doubt.apart_e, doubt.rtk_n - doubt.apart_n) < off
    _forget_paths(doubt)
    if doubt.stage == OPEN:
        doubt.refused_s = math.inf if wrong else 0.0
        return
    if wrong:
        copy_heading(doubt.other, heading)
    doubt.stage, doubt.agree_s, doubt.refused_s = NONE, 0.0, 0.0


@jit(borrows=True)
def aside(sine: float, cosine: float, g: Any) -> float:
    """How far the farther of the two histories is off the path taken, on an axis of these E and N components [m]."""
    doppler = sine * (g.doppler_e + g.lead_e) + cosine * (g.doppler_n + g.lead_n)
    return float(max(abs(doppler), abs(sine * g.gyro_e + cosine * g.gyro_n)))


@jit(borrows=True)
def cover_axes(between: float, pl: Any) -> None:
    """Raise exact levels pl (2,) AT, CT so that they hold on axes turned by ``between`` [rad] as well."""
    s, c = abs(math.sin(between)), abs(math.cos(between))
    at, ct = pl[0], pl[1]
    if at < math.inf and ct < math.inf:
        pl[0], pl[1] = max(at, c * at + s * ct), max(ct, s * at + c * ct)
