"""Positioning service ``galileo``: ionosphere-free E1/E5a codes of Galileo with its broadcast orbits and clocks.

An example: S3 Table III gives the errors of broadcast clocks and orbits of GPS; those of Galileo are declared alike.
"""

from lanebound.integrity.navigators.services.config import CodeServiceConfig
from lanebound.integrity.navigators.services.table import register_service
from lanebound.integrity.positioning.code_errors import CodeErrorBudget

L5 = 2
DECLARED = CodeServiceConfig(
    systems=("GALILEO",),
    errors=CodeErrorBudget(reflections_m=1.0, iono_zenith_m=0.0),  # ranges are free of the ionosphere
    smoothing_s=100.0,
    max_hdop=6.0,
)
GALILEO = register_service(
    "galileo", "Galileo", "broadcast ephemerides, codes of Galileo", DECLARED, second=(L5,), combined=True
)
