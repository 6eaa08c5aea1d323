"""Observation entry ``ego.elapsed_time``: time since the start of the episode, a field of the belief."""

from lanebound.envs.observation import Entry, register_entry

ELAPSED_TIME = Entry(
    name="elapsed_time",
    group="ego",
    unit="s",
    scale=60.0,
    low=0.0,
    high=1.0,
    meaning="time since the start of the episode",
    source="belief.time_s",
)
register_entry(ELAPSED_TIME)
