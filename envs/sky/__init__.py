"""Signal reception on lane networks: levels of difficulty, and generated streets with their sky masks."""

from lanebound.envs.sky.build import Section, build_street
from lanebound.envs.sky.level import RECORDING, SKIES, SKY_LEVELS, SkyLevel
from lanebound.envs.sky.street import LaneMap, Street

__all__ = ["RECORDING", "SKIES", "SKY_LEVELS", "LaneMap", "Section", "SkyLevel", "Street", "build_street"]
