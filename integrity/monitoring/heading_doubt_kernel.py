"""Two histories of the heading while gyro and Doppler contradict each other.

The Doppler course of a vehicle that does not slip follows the gyro. Where it does not, either the gyro has failed or
the velocity has: a facade that reflects most satellites in use mirrors the velocity, at the same speed, with small
residuals, for seconds. Neither sensor shows which. Both histories go on, whichever of them the position takes:

* the gyro's: the heading at the first course that was refused, and from then on the gyro alone;
* Doppler's: every course, and between two of them the gyro. A gyro is wrong by ``GYRO_FAULT_RADPS`` at most, so a
  course cannot be farther off the heading than that rate times the time since both agreed: what is beyond is no fault
  of the gyro.

1. ``OPEN``: courses are refused and do not move the position. The heading is the gyro's. A course that is accepted
   ends the doubt.
2. ``FOLLOWS``: once the gyro could have drifted as far (:func:`due`) the heading follows the courses. The doubt ends
   when both headings have agreed for a while.

In either, RTK positions decide which of the two was right as soon as the paths are ``DECISIVE_M`` apart. Each dead
reckoning carries by how much either history is off the path that was taken; exact levels add the larger on each axis
until the next RTK position, also after the doubt has ended. The axes of the other heading differ from those of the
reported one: the levels cover both (:func:`cover_axes`).

Not covered: a gyro that is wrong by a higher rate, and a vehicle that slides, whose heading and course differ.
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
    "find_difference",
    "follow_gyro",
    "follow_paths",
    "judge_by_path",
    "note_agreement",
    "note_course",
    "note_refusal",
    "shift_of_lever",
    "turn_to_doppler",
]

NONE, OPEN, FOLLOWS = 0, 1, 2
REACQUIRE_S = 1.0  # of Doppler courses refused for their jump, before the heading follows them, at least
GYRO_FAULT_RADPS = math.radians(30.0)  # error of a gyro that shows nothing in a turn of 12 m at 6 m/s
AGREE_S = 1.0  # of courses accepted while both headings are alike, until the doubt ends
DECISIVE_M = 1.0  # between the paths by two headings, until RTK decides; 20 times its level

HEADING_DOUBT = record(
    stage=("i8", "NONE, OPEN or FOLLOWS"),
    refuses=("?", "the last course was refused"),
    refused_s="how long Doppler courses have been refused for their jump [s]",
    agree_s="how long both headings have been alike [s]",
    gyro=(HEADING, "the heading of the gyro's history"),
    course="the heading of Doppler's history [rad]",
    difference="largest angle between the reported heading and either history [rad]",
    step_e="path of this epoch by the other history less that taken, of the antenna, East [m]",
    step_n="the same, North [m]",
    seen=("?", "the epoch before had an RTK position"),
    antenna_e="its antenna, East [m]",
    antenna_n="the same, North [m]",
    rtk_e="path of the antenna by RTK less that taken, since RTK lasts, East [m]",
    rtk_n="the same, North [m]",
    apart_e="path by the other history less that taken, since RTK lasts, East [m]",
    apart_n="the same, North [m]",
)
"""What is known while gyro and Doppler courses contradict each other."""


@jit
def _forget_paths(doubt: Any) -> None:
    """Begin anew to compare paths with RTK."""
    doubt.rtk_e, doubt.rtk_n, doubt.apart_e, doubt.apart_n, doubt.seen = 0.0, 0.0, 0.0, 0.0, False


@jit
def _end(doubt: Any) -> None:
    """Both headings are the same again, or one is known to be wrong."""
    doubt.stage, doubt.agree_s, doubt.refused_s, doubt.refuses, doubt.difference = NONE, 0.0, 0.0, False, 0.0
    _forget_paths(doubt)


@jit
def follow_gyro(delta_theta: float, rules: Any, dt: float, doubt: Any) -> None:
    """Advance both histories by the gyro increment [rad]; ``rules`` hold the noise of the gyro."""
    if doubt.stage != NONE:
        before = doubt.gyro.angle
        predict_heading(delta_theta, dt, rules.angle_random_walk, rules.bias_walk, doubt.gyro)
        doubt.course = wrap(doubt.course + doubt.gyro.angle - before)


@jit
def note_course(jump: float, since_s: float, heading: Any, doubt: Any) -> None:
    """A course of Doppler, ``jump`` [rad] off the heading, ``since_s`` after the last one that was accepted [s]."""
    limit = GYRO_FAULT_RADPS * since_s
    doubt.course = wrap(heading.angle + min(max(jump, -limit), limit))


@jit
def note_refusal(dt: float, heading: Any, doubt: Any) -> None:
    """The course of this epoch contradicts the heading."""
    doubt.refused_s += dt
    doubt.agree_s, doubt.refuses = 0.0, True
    if doubt.stage == NONE:
        doubt.stage = OPEN
        copy_heading(heading, doubt.gyro)
        _forget_paths(doubt)


@jit
def due(jump: float, doubt: Any) -> bool:
    """Whether courses off by ``jump`` [rad] have been refused for as long as a failed gyro needs to drift that far."""
    return bool(doubt.refused_s > max(REACQUIRE_S, abs(jump) / GYRO_FAULT_RADPS))


@jit
def turn_to_doppler(jump: float, rules: Any, heading: Any, doubt: Any) -> None:
    """Raise the variances of the heading so that it follows the courses; the gyro's history stays."""
    if doubt.stage == OPEN:
        doubt.stage = FOLLOWS
        _forget_paths(doubt)
    raise_uncertainty(jump, rules.bias_initial, rules.gyro_scale, heading)


@jit
def note_agreement(dt: float, limit: float, heading: Any, doubt: Any) -> None:
    """A course is accepted: a doubt ends at once before the heading follows Doppler, and later when both are alike.

    ``limit`` is the difference of headings that are alike [rad].
    """
    doubt.refused_s, doubt.refuses = 0.0, False
    if doubt.stage == OPEN:
        _end(doubt)
    elif doubt.stage == FOLLOWS:
        doubt.course = heading.angle
        alike = abs(wrap(heading.angle - doubt.gyro.angle)) < limit
        doubt.agree_s = doubt.agree_s + dt if alike else 0.0
        if doubt.agree_s > AGREE_S:
            _end(doubt)


@jit
def find_difference(angle: float, doubt: Any) -> None:
    """The largest angle between the reported heading [rad] and either history."""
    doubt.difference = max(abs(wrap(doubt.course - angle)), abs(wrap(doubt.gyro.angle - angle)))


@jit
def shift_of_lever(angle: float, turned: float, lever: Any) -> tuple[float, float]:
    """How far an antenna moves by the lever when the heading turns by ``turned`` to ``angle`` [rad], East and North."""
    sine, cosine = math.sin(angle) - math.sin(angle - turned), math.cos(angle) - math.cos(angle - turned)
    return sine * lever.forward + cosine * lever.right, cosine * lever.forward - sine * lever.right


@jit
def follow_paths(
    taken: tuple[float, float], run: float, middle: float, reckoned: float, turned: float, lever: Any, doubt: Any,
    growth: Any,
) -> None:  # fmt: skip
    """Add an epoch to the paths of both histories.

    The vehicle was moved by ``taken`` (East, North) [m], and ran ``run`` [m] by the odometer; ``middle`` is the course
    in the middle of the epoch and ``reckoned`` the heading at its end, by the gyro from the heading before; ``turned``
    is the turn of the epoch [rad].
    """
    by_gyro, by_course = wrap(doubt.gyro.angle - reckoned), wrap(doubt.course - reckoned)
    doppler_e = run * math.sin(middle + by_course) - taken[0]
    doppler_n = run * math.cos(middle + by_course) - taken[1]
    gyro_e, gyro_n = run * math.sin(middle + by_gyro) - taken[0], run * math.cos(middle + by_gyro) - taken[1]
    for k in range(growth.shape[0]):
        g = growth[k]
        g.doppler_e, g.doppler_n = g.doppler_e + doppler_e, g.doppler_n + doppler_n
        g.gyro_e, g.gyro_n = g.gyro_e + gyro_e, g.gyro_n + gyro_n
    by_other = by_course if doubt.stage == OPEN else by_gyro
    other_e, other_n = shift_of_lever(reckoned + by_other, turned, lever)
    own_e, own_n = shift_of_lever(reckoned, turned, lever)
    step_e, step_n = (doppler_e, doppler_n) if doubt.stage == OPEN else (gyro_e, gyro_n)
    doubt.step_e, doubt.step_n = step_e + other_e - own_e, step_n + other_n - own_n


@jit
def judge_by_path(antenna: tuple[float, float], path: tuple[float, float], heading: Any, doubt: Any) -> None:
    """Let RTK decide, one epoch after the other: its antenna (East, North) [m] and the path taken of it [m].

    Where the other history was right the heading becomes the gyro's, or follows the next course.
    """
    if doubt.seen:
        doubt.rtk_e += antenna[0] - doubt.antenna_e - path[0]
        doubt.rtk_n += antenna[1] - doubt.antenna_n - path[1]
        doubt.apart_e, doubt.apart_n = doubt.apart_e + doubt.step_e, doubt.apart_n + doubt.step_n
    doubt.seen, doubt.antenna_e, doubt.antenna_n = True, antenna[0], antenna[1]
    if not math.hypot(doubt.apart_e, doubt.apart_n) > DECISIVE_M:
        return
    off = math.hypot(doubt.rtk_e, doubt.rtk_n)
    wrong = math.hypot(doubt.rtk_e - doubt.apart_e, doubt.rtk_n - doubt.apart_n) < off
    if doubt.stage == OPEN:
        doubt.refused_s = math.inf if wrong else 0.0
        _forget_paths(doubt)
        return
    if wrong:
        copy_heading(doubt.gyro, heading)
    _end(doubt)


@jit
def aside(sine: float, cosine: float, g: Any) -> float:
    """How far the farther of the two histories is off the path taken, on an axis of these E and N components [m]."""
    doppler, gyro = sine * g.doppler_e + cosine * g.doppler_n, sine * g.gyro_e + cosine * g.gyro_n
    return float(max(abs(doppler), abs(gyro)))


@jit
def cover_axes(between: float, pl: Any) -> None:
    """Raise exact levels pl (2,) AT, CT so that they hold on axes turned by up to ``between`` [rad] as well.

    Along axes turned by an angle t, an error within the levels is at most ``cos t AT + sin t CT``, largest at ``tan t =
    CT / AT``.
    """
    at, ct = pl[0], pl[1]
    if at < math.inf and ct < math.inf:
        t = min(between, math.atan2(ct, at))
        u = min(between, math.atan2(at, ct))
        pl[0], pl[1] = math.cos(t) * at + math.sin(t) * ct, math.cos(u) * ct + math.sin(u) * at
