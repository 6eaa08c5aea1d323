"""The vehicles that each ego perceives: by broadcasts of their beliefs, by its own sensor, or as they truly are.

A broadcast says where its sender believes to be on the globe; a sensor tells where another vehicle is from here. The
first is wrong by the sender's error, the second is put on the ego's believed pose and shares its error, so that the
geometry between the two vehicles stays right. Truth enters as radio range and echoes alone.

What one source knows of a vehicle is a SIGHTING; each of C slots of vehicles has one of the radio and one of the
sensor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.sensors.uwb_kernel import crosses_body, crosses_wall

__all__ = ["CAM", "CAM_MOST_S", "CLAIM", "PICTURE", "RADIO", "SENSOR", "SIGHTING", "SLOT", "TRACKING",
           "PerceptionArrays", "Radio", "Ranging", "behind_wall", "claim", "forget_slot", "hear", "in_sight", "look",
           "see_truth", "silence", "sum_up"]  # fmt: skip

ROUNDING = 1e-9
COURSE_FROM_MPS = 2.0  # below, Doppler noise turns the course by degrees
CAM_LEAST_S, CAM_MOST_S, CAM_SLOW = 0.1, 1.0, 3  # ETSI EN 302 637-2 V1.4.1, 6.1.3: T_GenCam and N_GenCam
CAM_M, CAM_RAD, CAM_MPS = 4.0, math.radians(4.0), 0.5  # there: changes after which a message is sent
STEP_M, STEP_RAD, STEP_MPS, STEP_MPS2 = 0.0111, math.radians(0.1), 0.01, 0.1  # ETSI TS 102 894-2: 0.1 microdegrees, ...
ELLIPSE_STEP_M, ELLIPSE_MOST_M, MOST_MPS2 = 0.01, 40.93, 16.0  # there: axes of the ellipse, acceleration
ELLIPSE_SIGMAS = math.sqrt(-2.0 * math.log(0.05))  # half axes of 95 % in the plane, over standard deviations

CLAIM = record(
    x_m="believed position",
    y_m="believed position",
    heading_rad="course, or the heading at low speed and in reverse",
    speed_mps="by the odometer",
    pl_at_m="protection level along the heading, inf when missing",
    pl_ct_m="protection level across the heading, inf when missing",
    sends=("i8", "1 where the vehicle has a position and broadcasts it"),
)
SIGHTING = record(
    x_m="position at the time of the measurement",
    y_m="position at the time of the measurement",
    heading_rad="then",
    speed_mps="then",
    pl_at_m="bound along the heading",
    pl_ct_m="bound across the heading",
    time_s="of the measurement; its age in what the sensor holds",
    acceleration_mps2="along the heading then, as a CAM says; else 0",
    lag_s="by which the speed is older than the position",
)
SLOT = record(
    key=("i8", "name of the vehicle that has the slot, or had it last; never given twice"),
    length_m="its length",
    width_m="its width",
)
RADIO = record(
    latency_s="shortest delay of a message",
    jitter_s="mean of the exponential delay on top",
    latency_max_s="later messages are dropped",
    loss="share lost at close range",
    range_m="nothing is heard beyond",
    rate_hz="messages of a vehicle in a second",
    epoch_s="length of an epoch",
    cam=("i8", "1 where CAM are sent, when ETSI EN 302 637-2 asks for one, in the place of the rate"),
    level_sigmas="standard deviations in a level",
)
CAM = record(
    x_m="position in the last message",
    y_m="position in the last message",
    heading_rad="in the last message",
    speed_mps="in the last message",
    time_s="of the last message, -inf before the first",
    gap_s="time after which the next one is sent at the latest",
    slow=("i8", "messages since the last one by a change"),
)
SENSOR = record(
    range_m="farthest vehicle seen",
    half_view_rad="half of the opening of the cone, centred ahead",
    range_sigma_m="error of the distance",
    bearing_sigma_rad="error of the bearing",
    lateral_bias_sigma_m="error across the ego, constant in an episode",
    speed_sigma_mps="error of the relative speed",
    heading_sigma_rad="error of the relative heading",
    bound_sigmas="standard deviations that bound an error",
    epoch_s="length of an epoch",
)
TRACKING = record(
    drop_after_s="a track that is older is left out",
    along_mps2="acceleration of another along its heading at most",
    across_mps2="acceleration of another across its heading at most",
    course_sin="sine of the largest angle between its course and the heading known of it",
)
PICTURE = record(
    seen=("i8", "how many vehicles are perceived"),
    epoch=("i8", "epochs since the radio was switched on"),
    sent=("i8", "number of the newest transmission slot used"),
    last_x_m="where the sensor looked from last",
    last_y_m="where the sensor looked from last",
    bias_m="error of the sensor across the ego, to the right, of this episode",
    excluded=("i8", "senders that ranges exclude now"),
    reason=("i8", "why the last of these was excluded, see cooperative_kernel"),
)


class Radio(NamedTuple):
    """Messages under way to N egos from C slots each, and held by them.

    broadcasts (N, L, C) SIGHTING: messages of the last L epochs; arriving (N, L, C): epoch of origin of the message
    that arrives in a coming epoch, -1 for none; origin (N, C): epoch of origin of the message held, -1 for none; held
    (N, C) SIGHTING: for none, levels of inf and a time of -inf; cams (N, C) CAM.
    """

    broadcasts: Records
    arriving: NDArray[np.int64]
    origin: NDArray[np.int64]
    held: Records
    cams: Records


class Ranging(NamedTuple):
    """Ranges between N egos and C slots, of none without cooperative perception; types in the kernels of both.

    modules (N, C + 1) MODULE; links (N, C, PAIRS) LINK; ranges (N, C, PAIRS); relations (N, C) RELATION; of_ranges (1,)
    RANGING and of_relations (1,) COOPERATION: figures.
    """

    modules: Records
    links: Records
    ranges: NDArray[np.float64]
    relations: Records
    of_ranges: Records
    of_relations: Records


class PerceptionArrays(NamedTuple):
    """The vehicles that N egos perceive.

    picture (N,) PICTURE; perceived (N, P) PERCEIVED, nearest first; tracks (N, C + 1) SIGHTING of the sensor; slots
    (N, C + 1) SLOT; spoken (N, C) CLAIM and radio: of C slots, of none where the ego has no radio; of_radio (1,) RADIO,
    of_sensor (1,) SENSOR, of_tracks (1,) TRACKING: figures; walls (W, 4): least and largest x, least and largest y of
    buildings that hide vehicles from the sensors [m]; ranging: of cooperative perception.
    """

    picture: Records
    perceived: Records
    tracks: Records
    slots: Records
    spoken: Records
    radio: Radio
    of_radio: Records
    of_sensor: Records
    of_tracks: Records
    walls: NDArray[np.float64]
    ranging: Ranging


@jit(borrows=True)
def silence(sighting, time):  # type: ignore[no-untyped-def]
    """Clear a sighting: levels of inf; a time of -inf for messages, an age of inf for the sensor."""
    sighting.x_m = sighting.y_m = sighting.heading_rad = sighting.speed_mps = 0.0
    sighting.acceleration_mps2, sighting.lag_s, sighting.pl_at_m, sighting.pl_ct_m = 0.0, 0.0, math.inf, math.inf
    sighting.time_s = time


@jit(borrows=True)
def forget_slot(radio, tracks, e, slot):  # type: ignore[no-untyped-def]
    """Clear the sightings and the messages under way of a slot, for another vehicle."""
    if slot < radio.origin.shape[1]:
        radio.arriving[e, :, slot] = -1
        radio.origin[e, slot] = -1
        silence(radio.held[e, slot], -math.inf)
        radio.cams[e, slot].time_s, radio.cams[e, slot].gap_s = -math.inf, CAM_MOST_S
    silence(tracks[e, slot], math.inf)


@jit(borrows=True)
def claim(fix, c):  # type: ignore[no-untyped-def]
    """What a vehicle of this solution would broadcast, in the plane."""
    east, north = fix.velocity_en_mps[0], fix.velocity_en_mps[1]
    azimuth = math.atan2(east, north) if fix.speed_mps > COURSE_FROM_MPS else fix.heading_rad
    c.x_m, c.y_m = fix.position_en_m[0], -fix.position_en_m[1]
    c.heading_rad, c.speed_mps = azimuth - 0.5 * math.pi, fix.speed_mps
    c.pl_at_m, c.pl_ct_m = fix.pl_at_m, fix.pl_ct_m
    c.sends = 1 if fix.mode != 0 else 0


@jit(inline=True)
def _rounded(value, step):  # type: ignore[no-untyped-def]
    """The nearest multiple of a step."""
    return step * math.floor(value / step + 0.5)


@jit(borrows=True)
def _encode(said, before, figures, fresh):  # type: ignore[no-untyped-def]
    """Put a message into the fields of a CAM: rounded, with the acceleration since the one ``before``, 0 for the first.

    Levels are sent as the ellipse of 95 %, half axes ``2.45 sigma`` rounded up, and are gone where these are above
    40.93 m.
    """
    change = 0.0 if fresh else (said.speed_mps - before.speed_mps) / figures.epoch_s
    said.acceleration_mps2 = _rounded(min(max(change, -MOST_MPS2), MOST_MPS2), STEP_MPS2)
    said.x_m, said.y_m = _rounded(said.x_m, STEP_M), _rounded(said.y_m, STEP_M)
    said.heading_rad = _rounded(said.heading_rad, STEP_RAD)
    said.speed_mps = _rounded(said.speed_mps, STEP_MPS)
    said.pl_at_m, said.pl_ct_m = _by_ellipse(said.pl_at_m, figures), _by_ellipse(said.pl_ct_m, figures)


@jit(borrows=True)
def _by_ellipse(level, figures):  # type: ignore[no-untyped-def]
    """A level after its way through the ellipse of a CAM."""
    sigmas = ELLIPSE_SIGMAS / figures.level_sigmas
    if not level * sigmas <= ELLIPSE_MOST_M:
        return math.inf
    return math.ceil(level * sigmas / ELLIPSE_STEP_M - ROUNDING) * ELLIPSE_STEP_M / sigmas


@jit(borrows=True)
def _asks_for_cam(cam, said):  # type: ignore[no-untyped-def]
    """Whether a CAM is sent now, of what it would say; notes it as the last one. ETSI EN 302 637-2, 6.1.3."""
    gap = said.time_s - cam.time_s
    if gap < CAM_LEAST_S - ROUNDING:
        return False
    turn = said.heading_rad - cam.heading_rad
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    x, y, speed = said.x_m - cam.x_m, said.y_m - cam.y_m, said.speed_mps - cam.speed_mps
    if math.hypot(x, y) > CAM_M or abs(turn) > CAM_RAD or abs(speed) > CAM_MPS:
        cam.gap_s, cam.slow = min(gap, CAM_MOST_S), 0
    elif gap >= cam.gap_s - ROUNDING:
        cam.slow += 1
        if cam.slow >= CAM_SLOW:
            cam.gap_s = CAM_MOST_S
    else:
        return False
    cam.x_m, cam.y_m, cam.heading_rad = said.x_m, said.y_m, said.heading_rad
    cam.speed_mps, cam.time_s = said.speed_mps, said.time_s
    return True


@jit(borrows=True)
def hear(picture, radio, e, figures, time, claims, cars, u, lies):  # type: ignore[no-untyped-def]
    """One epoch of the radio to one ego: send, carry, receive.

    claims (C,) CLAIM by slot; u (C + 1, 2) uniform draws; lies (N, C, 4): displacement East, North, up [m] and factor
    on the levels of what each says, or None for honest vehicles. A message gets through within the range with ``P =
    (1 - loss) (1 - (d / range)^4)``; one that takes longer than an epoch arrives in a later one, and the newer replaces
    one that would arrive with it.
    """
    slots, count = radio.arriving.shape[1:]
    picture.epoch += 1
    epoch = picture.epoch
    at, due = epoch % slots, math.floor(epoch * figures.epoch_s * figures.rate_hz + ROUNDING)
    for i in range(count):
        said, c = radio.broadcasts[e, at, i], claims[i]
        said.x_m, said.y_m, said.heading_rad, said.speed_mps = c.x_m, c.y_m, c.heading_rad, c.speed_mps
        said.pl_at_m, said.pl_ct_m, said.time_s = c.pl_at_m, c.pl_ct_m, time
        if lies is not None:
            said.x_m += lies[e, i, 0]
            said.y_m -= lies[e, i, 1]
            said.pl_at_m *= lies[e, i, 3]
            said.pl_ct_m *= lies[e, i, 3]
        if figures.cam != 0:
            fresh = math.isinf(radio.cams[e, i].time_s)
            _encode(said, radio.broadcasts[e, (epoch + slots - 1) % slots, i], figures, fresh)
    if due > picture.sent or figures.cam != 0:
        picture.sent = max(due, picture.sent)
        for v in range(1, cars.shape[0]):
            i = cars[v].slot
            if i < 0 or i >= count or claims[i].sends == 0:
                continue
            if figures.cam != 0 and not _asks_for_cam(radio.cams[e, i], radio.broadcasts[e, at, i]):
                continue
            delay = figures.latency_s - figures.jitter_s * math.log1p(-u[i, 1])
            x, y = (cars[0].x - cars[v].x) / figures.range_m, (cars[0].y - cars[v].y) / figures.range_m
            fade = min(x * x + y * y, 1.0)
            if delay <= figures.latency_max_s and u[i, 0] < (1.0 - figures.loss) * (1.0 - fade * fade):
                wait = math.ceil(delay / figures.epoch_s - ROUNDING)
                radio.arriving[e, (epoch + wait) % slots, i] = epoch
    for i in range(count):
        if radio.arriving[e, at, i] > radio.origin[e, i]:
            radio.origin[e, i] = radio.arriving[e, at, i]
            radio.held[e, i] = radio.broadcasts[e, radio.origin[e, i] % slots, i]
        radio.arriving[e, at, i] = -1


@jit(borrows=True)
def in_sight(cars, ahead, i):  # type: ignore[no-untyped-def]
    """Whether the line from the middle of the ego to that of vehicle ``i`` crosses no third vehicle.

    ``ahead`` (V, 2) are the unit vectors of the headings.
    """
    x, y = cars[0].x, cars[0].y
    line_x, line_y = cars[i].x - x, cars[i].y - y
    for j in range(1, cars.shape[0]):
        if j == i or cars[j].slot < 0:
            continue
        start_x, start_y, car = x - cars[j].x, y - cars[j].y, cars[j]
        if crosses_body(start_x, start_y, line_x, line_y, ahead[j, 0], ahead[j, 1], car.length, car.width):
            return False
    return True


@jit(borrows=True)
def behind_wall(cars, walls, i):  # type: ignore[no-untyped-def]
    """Whether the line from the middle of the ego to that of vehicle ``i`` crosses a building of ``walls`` (W, 4)."""
    for k in range(walls.shape[0]):
        if crosses_wall(cars[0].x, cars[0].y, cars[i].x - cars[0].x, cars[i].y - cars[0].y, walls[k]):
            return True
    return False


@jit(borrows=True)
def look(picture, tracks, figures, b, cars, noise, ahead, walls):  # type: ignore[no-untyped-def]
    """One epoch of the sensor of one ego: tracks move with the ego's odometry, and those in sight are measured anew.

    So a jump of the ego's solution moves ego and tracks alike. Along and across the measured heading, which the line of
    sight leaves by psi, the errors of distance (sigma_r) and bearing (sigma_b) give ``sigma_at^2 = (sigma_r cos psi)^2
    + (r sigma_b sin psi)^2``, and sigma_ct with cos and sin exchanged. The constant error across the ego (sigma_y),
    from whose heading that of the other differs by theta, adds ``(sigma_y sin theta)^2`` and ``(sigma_y cos theta)^2``.
    The ego's error of its own speed enters by the cosine of the angle between the headings.

    tracks (C,) SIGHTING by slot, with ages; noise (C, 4) standard normal; ahead (V, 2) is scratch; walls (W, 4): see
    :class:`PerceptionArrays`.
    """
    travelled = b.speed_mps * figures.epoch_s
    east, south = math.cos(b.heading_rad) * travelled, math.sin(b.heading_rad) * travelled
    for i in range(tracks.shape[0]):
        tracks[i].x_m += b.x_m - picture.last_x_m - east
        tracks[i].y_m += b.y_m - picture.last_y_m - south
        tracks[i].time_s += figures.epoch_s
    picture.last_x_m, picture.last_y_m = b.x_m, b.y_m
    for v in range(1, cars.shape[0]):
        ahead[v, 0], ahead[v, 1] = math.cos(cars[v].heading), math.sin(cars[v].heading)
    for v in range(1, cars.shape[0]):
        gap_x, gap_y = cars[v].x - cars[0].x, cars[v].y - cars[0].y
        distance = math.sqrt(gap_x * gap_x + gap_y * gap_y)
        bearing = math.atan2(gap_y, gap_x) - cars[0].heading
        off_axis = abs(bearing - 2.0 * math.pi * round(bearing / (2.0 * math.pi)))
        if cars[v].slot < 0 or distance > figures.range_m or off_axis > figures.half_view_rad:
            continue
        if not in_sight(cars, ahead, v) or behind_wall(cars, walls, v):
            continue
        n, track = noise[cars[v].slot], tracks[cars[v].slot]
        r = distance + figures.range_sigma_m * n[0]
        line = b.heading_rad + bearing + figures.bearing_sigma_rad * n[1]
        turned = cars[v].heading - cars[0].heading
        heading = b.heading_rad + turned + figures.heading_sigma_rad * n[3]
        cos, sin = math.cos(line - heading), math.sin(line - heading)
        sigma_r, sigma_c = figures.range_sigma_m, abs(r) * figures.bearing_sigma_rad
        track.x_m = b.x_m + r * math.cos(line) - picture.bias_m * math.sin(b.heading_rad)
        track.y_m = b.y_m + r * math.sin(line) + picture.bias_m * math.cos(b.heading_rad)
        track.heading_rad = heading
        doubt = (b.speed_mps - cars[0].speed) * math.cos(turned)
        track.speed_mps = cars[v].speed + doubt + figures.speed_sigma_mps * n[2]
        theta, sigma_y = heading - b.heading_rad, figures.lateral_bias_sigma_m
        along, across = sigma_y * math.sin(theta), sigma_y * math.cos(theta)
        track.pl_at_m = figures.bound_sigmas * math.hypot(math.hypot(sigma_r * cos, sigma_c * sin), along)
        track.pl_ct_m = figures.bound_sigmas * math.hypot(math.hypot(sigma_r * sin, sigma_c * cos), across)
        track.time_s = 0.0


@jit(borrows=True)
def sum_up(radio, tracks, slots, e, figures, time, b, square, seen):  # type: ignore[no-untyped-def]
    """The newer of two sightings of each slot, the sensor's if equally old, moved to now, nearest to the ego first.

    A position is brought forward at constant velocity from its measurement, ``age`` ago, with levels grown by ``a_at
    age^2 / 2`` and ``a_ct age^2 / 2 + v age sin(course)``. Fills ``seen`` (C,) PERCEIVED and returns how many there
    are; square (C,) is scratch.
    """
    count, heard = 0, radio.origin.shape[1]
    for slot in range(tracks.shape[0]):
        age = tracks[slot].time_s
        heard_s = time - radio.held[e, slot].time_s if slot < heard else math.inf
        sensed = age <= heard_s + ROUNDING
        source = tracks[slot]
        if not sensed:
            source, age = radio.held[e, slot], heard_s
        if not age <= figures.drop_after_s + ROUNDING:
            continue
        driven = source.speed_mps * age + 0.5 * source.acceleration_mps2 * age * age
        x = source.x_m + driven * math.cos(source.heading_rad)
        y = source.y_m + driven * math.sin(source.heading_rad)
        distance2 = (x - b.x_m) ** 2 + (y - b.y_m) ** 2
        at = count
        while at > 0 and square[at - 1] > distance2:
            square[at] = square[at - 1]
            seen[at] = seen[at - 1]
            at -= 1
        square[at], row = distance2, seen[at]
        row.x_m, row.y_m, row.heading_rad, row.speed_mps = x, y, source.heading_rad, source.speed_mps
        row.pl_at_m = source.pl_at_m + 0.5 * figures.along_mps2 * age * age
        growth = (0.5 * figures.across_mps2 * age + figures.course_sin * abs(source.speed_mps)) * age
        row.pl_ct_m = source.pl_ct_m + growth
        row.age_s, row.relative, row.key = age + source.lag_s, 1 if sensed else 0, slots[slot].key
        row.length_m, row.width_m = slots[slot].length_m, slots[slot].width_m
        count += 1
    return count


@jit(borrows=True)
def see_truth(cars, x, y, every, seen):  # type: ignore[no-untyped-def]
    """Fill ``seen`` (V - 1,) PERCEIVED with the others as they are, nearest to (x, y) first; returns how many.

    Of two at one distance the first in the world comes first. ``every``: also those that have no slot.
    """
    count = 0
    for i in range(1, cars.shape[0]):
        if cars[i].slot < 0 and not every:
            continue
        dx, dy = cars[i].x - x, cars[i].y - y
        square, at = dx * dx + dy * dy, count
        while at > 0 and seen[at - 1].age_s > square:  # the age holds the square of the distance until all are sorted
            seen[at].age_s, seen[at].key = seen[at - 1].age_s, seen[at - 1].key
            at -= 1
        seen[at].age_s, seen[at].key = square, i
        count += 1
    for n in range(count):
        row = seen[n]
        car = cars[row.key]
        row.x_m, row.y_m, row.heading_rad, row.speed_mps = car.x, car.y, car.heading, car.speed
        row.pl_at_m = row.pl_ct_m = row.age_s = 0.0
        row.length_m, row.width_m, row.relative = car.length, car.width, 0
    return count
