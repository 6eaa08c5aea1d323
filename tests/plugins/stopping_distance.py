"""Observation entry ``ego.stopping_distance``: how far the car drives until it stands, braking gently."""

from lanebound.envs.observation import Entry, register_entry

DECELERATION_MPS2 = 3.0

STOPPING_DISTANCE = Entry(
    name="stopping_distance",
    group="ego",
    unit="m",
    scale=50.0,
    low=0.0,
    high=1.0,
    meaning="distance until the car stands at 3 m/s2, by the speed of the odometer",
    source=lambda seen: seen.belief["speed_mps"] ** 2 / (2.0 * DECELERATION_MPS2),
)
register_entry(STOPPING_DISTANCE)
