"""How the ego perceives traffic: what others broadcast of themselves, what its own sensor sees, or both.

A broadcast says where its sender believes to be on the globe; a sensor tells where another vehicle is from here. The
first is wrong by the sender's error, the second is put on the ego's believed pose and shares its error, so that the
geometry between the two vehicles stays right. Truth enters through :class:`Vehicles` alone: radio range and echoes.
"""

from lanebound.envs.perception.config import PerceptionConfig, SensorConfig
from lanebound.envs.perception.perception import Perception
from lanebound.envs.perception.vehicles import Claims, Vehicles

__all__ = ["Claims", "Perception", "PerceptionConfig", "SensorConfig", "Vehicles"]
