"""Traffic of the vector engine that moves as it is told to: the cars of a single environment, step by step."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.belief_kernel import take_given
from lanebound.envs.batch.ego_kernel import decide
from lanebound.envs.batch.records_kernel import Cars, cars_of
from lanebound.envs.batch.rows_kernel import carry_on, follow_motion
from lanebound.envs.vector.drivers_kernel import command_ego, drivers_of
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle

FIELDS = ("x", "y", "heading", "speed", "lane", "crashed")


def written(steps: list[Cars]) -> NDArray[np.float64]:
    """The poses of simulation steps, one after another."""
    return np.concatenate([np.concatenate([getattr(step, name)[0] for name in FIELDS]) for step in steps])


@jit(borrows=True)
def run_replay(first, last, rows, frames, actions, batch, traffic, motions, tracks):  # type: ignore[no-untyped-def]
    """As :func:`lanebound.envs.vector.drive_kernel.run_course`; ``profile`` holds what :func:`written` makes."""
    a, t = unbundle(batch), unbundle(traffic)
    lanes, rules = a.lanes, a.rules[0]
    for n in range(first, last):
        e = rows[n]
        car, drv, b, sc = cars_of(a.cars, e), drivers_of(t.drivers, e), a.ego.belief[e], a.ego.score[e]
        if actions is not None:
            decide(b, actions[e], lanes, t.speeds)
        for frame in range(frames):
            command_ego(b, a.ego.command[e], car, drv, lanes, rules)
            places = car.x.shape[0]
            steps = t.profile.shape[1] // (6 * places)
            begin = (sc.steps % steps) * 6 * places
            for i in range(car.present):
                car.x[i], car.y[i] = t.profile[e, begin + i], t.profile[e, begin + places + i]
                car.heading[i], car.speed[i] = (
                    t.profile[e, begin + 2 * places + i],
                    t.profile[e, begin + 3 * places + i],
                )
                car.lane[i] = int(t.profile[e, begin + 4 * places + i])
                car.crashed[i] = int(t.profile[e, begin + 5 * places + i])
            sc.steps += 1
            if tracks is None:
                take_given(b, cars_of(a.cars, e), lanes, rules.step_s, rules)
            elif frame + 1 < frames:
                carry_on(tracks[e], b, lanes, rules)
            if motions is not None:
                if frame + 1 < frames:
                    follow_motion(motions, a.cars, e)


def replayed(single: Any, steps: list[Cars]) -> None:
    """Note the cars of a single environment after each of its simulation steps."""
    loop = single.belief_loop
    look = loop.look

    def noting() -> None:
        before = loop._seen
        look()
        if loop._seen > before:
            loop.seats.read(full=True)
            steps.append(Cars(*(array.copy() for array in loop.episodes.cars)))

    loop.look = noting
