"""Traffic of the vector engine that takes given poses, in place of vehicles that drive."""

from __future__ import annotations

from lanebound.envs.batch.belief_kernel import take_given
from lanebound.envs.batch.ego_kernel import decide
from lanebound.envs.batch.records_kernel import cars_of
from lanebound.envs.batch.rows_kernel import carry_on, follow_motion
from lanebound.envs.vector.drivers_kernel import command_ego, drivers_of
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle

__all__ = ["FIELDS", "run_replay"]

FIELDS = ("x", "y", "heading", "speed", "lane", "crashed")


@jit(borrows=True)
def run_replay(first, last, rows, frames, actions, batch, traffic, motions, tracks):  # type: ignore[no-untyped-def]
    """As :func:`lanebound.envs.vector.drive_kernel.run_course`, with poses from ``profile`` (N, S 6 V).

    The profile has S simulation steps, after which it begins again; of each the ``FIELDS`` of V vehicles.
    """
    a, t = unbundle(batch), unbundle(traffic)
    lanes, rules, places = a.lanes, a.rules[0], a.cars.x.shape[1]
    steps = t.profile.shape[1] // (6 * places)
    for n in range(first, last):
        e = rows[n]
        car, drv, b, sc = cars_of(a.cars, e), drivers_of(t.drivers, e), a.ego.belief[e], a.ego.score[e]
        if actions is not None:
            decide(b, actions[e], lanes, t.speeds)
        for frame in range(frames):
            command_ego(b, a.ego.command[e], car, drv, lanes, rules)
            poses = t.profile[e].reshape(steps, 6, places)[sc.steps % steps]
            for i in range(car.present):
                car.x[i], car.y[i], car.heading[i], car.speed[i] = poses[0, i], poses[1, i], poses[2, i], poses[3, i]
                car.lane[i], car.crashed[i] = int(poses[4, i]), int(poses[5, i])
            sc.steps += 1
            if tracks is None:
                take_given(b, car, lanes, rules.step_s, rules)
            elif frame + 1 < frames:
                carry_on(tracks[e], b, lanes, rules)
            if motions is not None:
                if frame + 1 < frames:
                    follow_motion(motions, a.cars, e)
