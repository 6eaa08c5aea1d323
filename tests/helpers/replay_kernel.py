"""Traffic of the vector engine that takes given poses, in place of vehicles that drive."""

from __future__ import annotations

import numpy as np

from lanebound.envs.batch.ego_kernel import decide, follow_road
from lanebound.envs.batch.next_lane_kernel import keep_to_route
from lanebound.envs.batch.records_kernel import GIVEN
from lanebound.envs.batch.rows_kernel import carry_on
from lanebound.envs.vector.drivers_kernel import NUMBERS, WHOLES, command_ego, load, vehicles_in
from lanebound.envs.vector.world_kernel import judge
from lanebound.integrity.core.accel import jit

__all__ = ["FIELDS", "run_replay"]

FIELDS = ("x", "y", "heading", "speed", "lane", "crashed", "onward")


@jit
def run_replay(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, rules, traffic):  # type: ignore[no-untyped-def]
    """A kernel as in :mod:`lanebound.envs.vector.drive_kernel`, with poses from ``profile`` (N, S 7 V).

    The profile has S simulation steps, after which it begins again; of each the ``FIELDS`` of V vehicles.
    """
    places, lanes = cars.shape[1], traffic.lanes
    numbers, wholes = np.empty((NUMBERS, places)), np.empty((WHOLES, places), np.int64)
    steps = traffic.profile.shape[1] // (7 * places)
    for e in rows[first:last]:
        ego = egos[e]
        here = cars[e, : ego.vehicles]
        v = vehicles_in(numbers, wholes, ego.vehicles)
        if codes.size > 0:
            follow_road(ego, lanes, traffic.roads.routes, rules[0])
            decide(ego.belief, codes[e], lanes, traffic.speeds)
        for frame in range(frames):
            load(here, drivers[e], v)
            command_ego(ego, v, lanes, traffic.roads.routes, rules[0])
            poses = traffic.profile[e].reshape(steps, 7, places)[ego.score.steps % steps]
            for i in range(here.shape[0]):
                car = here[i]
                car.x, car.y, car.heading, car.speed = poses[0, i], poses[1, i], poses[2, i], poses[3, i]
                car.lane, car.crashed, car.onward = int(poses[4, i]), int(poses[5, i]), int(poses[6, i])
            ego.score.steps += 1
            carry_on(ego, here, motions[e], lanes, rules[0], frame + 1 == frames)
            if rules[0].source == GIVEN or frame + 1 < frames:
                keep_to_route(ego, lanes, traffic.roads.routes, rules[0])
        if ends:
            judge(here, drivers[e], ego, lanes, rules[0], traffic.world[0], False)
