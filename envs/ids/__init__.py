"""The environments: a class for each id, what it presets, and the registry of ids."""

from lanebound.envs.ids.guidance import Guidance
from lanebound.envs.ids.highway import Highway, Intersection, Merge, Racetrack, Roundabout
from lanebound.envs.ids.platoon import Platoon
from lanebound.envs.ids.preset import CONTINUOUS, META, Preset, has_engine, id_of, refuse_misplaced
from lanebound.envs.ids.priced import PRICED, PRICES
from lanebound.envs.ids.registry import (
    CLASSES,
    IDS,
    MORE,
    MORE_IDS,
    enter,
    every_id,
    every_preset,
    preset_of,
    presets,
    register_id,
    withdraw_id,
)
from lanebound.envs.ids.streets import CarFollowing, CityStreets, LaneKeeping, UrbanCanyon
from lanebound.envs.ids.tolling import Tolling
from lanebound.envs.ids.work_zone import WorkZone

__all__ = [
    "CLASSES",
    "CONTINUOUS",
    "IDS",
    "META",
    "MORE",
    "MORE_IDS",
    "PRICED",
    "PRICES",
    "CarFollowing",
    "CityStreets",
    "Guidance",
    "Highway",
    "Intersection",
    "LaneKeeping",
    "Merge",
    "Platoon",
    "Preset",
    "Racetrack",
    "Roundabout",
    "Tolling",
    "UrbanCanyon",
    "WorkZone",
    "enter",
    "every_id",
    "every_preset",
    "has_engine",
    "id_of",
    "preset_of",
    "presets",
    "refuse_misplaced",
    "register_id",
    "withdraw_id",
]
