"""Signal reception on lane networks: levels of difficulty, and generated streets with their sky masks."""

from lanebound.envs.sky.build import Section, build_street
from lanebound.envs.sky.cities import CitiesConfig, Split
from lanebound.envs.sky.level import RECORDING, SKIES, SKY_LEVELS, SkyLevel
from lanebound.envs.sky.street import LaneMap, Street

__all__ = ["RECORDING", "SKIES", "SKY_LEVELS", "CitiesConfig", "LaneMap", "Section", "SkyLevel", "Split", "Street",
           "build_street"]  # fmt: skip
