"""Records of streets, of what is predicted on them, and of journeys, as kernels take them."""

from __future__ import annotations

from lanebound.integrity.core.records import record
from lanebound.integrity.sky.journeys.realised import (
    GAP_EDGES_S,
    LEVEL_CELLS,
    LEVEL_SHARES,
    MOST_SATELLITES,
    RUN_EDGES,
    RUNS,
)

__all__ = ["AHEAD", "CAR", "EDGE", "JOURNEY", "LAW", "MOST_STREETS", "STATION"]

MOST_STREETS = 4  # that leave a junction, less the one back; in generated cities at most 3 or 4

EDGE = record(
    first=("i8", "its first station"),
    last=("i8", "the station after its last one"),
    length_m="length",
    limit_mps="speed limit",
    east_m="where it ends, East",
    north_m="where it ends, North",
    azimuth_rad="direction of travel at its end",
    away_rad="direction of travel at its beginning",
    options=("i8", (MOST_STREETS,), "edges that may follow, from left to right; -1: none"),
    turn_s=("f8", (MOST_STREETS,), "time that the turn into each costs"),
)
"""A piece of a street in one direction."""

STATION = record(
    part_m="length of its part of the street",
    rtk_after=("f8", (2, RUNS), "probability of RTK, by RTK at the station before and class of its run"),
    usable_after=("f8", (2, RUNS), "with RTK, that of a usable position, by the one before and class of its run"),
    satellites=("i8", "row of the table of usable positions without RTK"),
)
"""A station in the true city at one hour (:class:`~lanebound.integrity.sky.journeys.realised.StationLaw`)."""

AHEAD = record(
    lost_s="expected time without a usable position at the speed limit",
    risk="probability of no usable position where it begins",
    leaves=("i8", "class of the gap at its end"),
    level_m=("f8", (2,), "median and 90 % quantile of PL_CT at its mean probability of a usable position"),
)
"""What is predicted of an edge (E, G), entered with a class of gaps."""

JOURNEY = record(
    origin=("i8", "place where it begins"),
    goal=("i8", "place where it ends"),
    host=("i8", "city"),
    hour=("i8", "number of the hour of departure; -1: not chosen yet"),
    edge=("i8", "edge at whose end it is; -1: at the origin"),
    arrived=("i8", "whether it is over"),
    rtk=("i8", "whether the last position is of RTK"),
    usable=("i8", "whether it is usable"),
    rtk_run=("i8", "stations for which RTK has been so"),
    usable_run=("i8", "stations for which a usable position has been so"),
    level_m="PL_CT there",
    score="normal score of that level",
    gap_s="time since RTK as experienced, or since the departure",
    time_s="since the departure",
    length_m="driven",
    energy_kwh="used",
    unusable_s="without a usable position",
    predicted_s="that was predicted for the streets driven so far, each as it was entered",
)
"""A journey."""

LAW = record(
    bridged=("f8", (2, RUNS, MOST_SATELLITES, GAP_EDGES_S.size + 1), "probability of a usable position without RTK"),
    gap_edges_s=("f8", GAP_EDGES_S.shape, "between classes of gaps"),
    run_edges=("i8", RUN_EDGES.shape, "between classes of runs"),
    level_edges=("f8", (2, LEVEL_CELLS - 1), "between cells of levels"),
    levels=("f8", (2, 2, LEVEL_CELLS, len(LEVEL_SHARES)), "quantiles of PL_CT"),
    correlation="of normal scores of levels at neighbouring stations",
)
"""The laws of :class:`~lanebound.integrity.sky.journeys.realised.RealisedLaw` that hold in all cities."""

CAR = record(
    rolling="energy against rolling resistance [kWh/m]",
    drag="energy against drag [kWh/m/(m/s)^2]",
    acceleration_mps2="comfortable acceleration",
    braking_mps2="comfortable braking",
)
"""A car."""
