"""Stage ``velocity_switch``: S2's choice between the velocity of GNSS and that of heading and odometer.

S2 section 8: where the two velocity vectors differ by more than 0.25 m/s, the position moves by heading and odometer.
The modes of S1 compare speeds alone, with 0.5 m/s. ``navigator.stages`` adds this test by the name
``lanebound.integrity.navigators.services.velocity_switch:velocity_switch``. Both velocities are those at the end of an
epoch: the wheels give its mean speed, to which half of the accelerometer's increment is added, and the course is that
of the heading at the end. The course in its middle would differ by ``w dt / 2`` in a turn at rate w, 0.25 m/s at 10 m/s
and 0.5 rad/s. Before the first heading nothing is compared, nor while the odometer is doubted.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.rtk_reckoning.extension_kernel import refuse_doppler
from lanebound.integrity.navigators.rtk_reckoning.extra_stages import Point, register_stages

__all__ = ["LARGEST_MPS", "switch_velocity"]

LARGEST_MPS = 0.25  # difference of the two velocity vectors, S2 section 8


@jit
def switch_velocity(first: int, last: int, epoch: Any, own: Any) -> None:
    """Refuse the Doppler velocity where it differs from that of heading and odometer by more than LARGEST_MPS."""
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if not w.doppler_moves or vehicle.watch.doubted or not vehicle.since_calibration < math.inf:
            continue
        speed, course = epoch.observed[v].speed, vehicle.heading.angle + w.slip
        if not w.resting:
            speed += 0.5 * epoch.observed[v].delta_v[0]
        east, north = w.v_e - speed * math.sin(course), w.v_n - speed * math.cos(course)
        if east * east + north * north > LARGEST_MPS * LARGEST_MPS:
            refuse_doppler(w)


register_stages(
    "velocity_switch",
    "Doppler velocities that differ from heading and odometer by more than 0.25 m/s do not move the position (S2)",
    ("range_rate", "speed", "turn", "delta_v"),
    {Point.ESTIMATED: switch_velocity},
)
