"""Multipath by near objects, an option of the signal model: its figures, and where they come from.

They are fitted on the first half of a recorded car (``rtk_cssrlib_4p7km_doy265``: a car on loops of 100 m in an open
place, 5.5 m/s in the median, 1 Hz), on what its carriers and codes leave at the fixed position above 20 degrees, less
the mean of each satellite: docs/results/signals.md.
"""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.sensors.near_objects_kernel import NEAR_RULES

__all__ = ["NearObjectsConfig", "near_rules"]


class NearObjectsConfig(Config):
    """Multipath of a vehicle's surroundings, for each satellite and band, on top of that of the receiver."""

    kind: Literal["none", "vehicle"] = Field("none", description="none, or the roof of a car and what is beside it")
    phase_m: float = Field(
        0.0029,
        ge=0,
        le=0.02,
        description="carrier, zenith, 1 sigma [m]; a recorded car's 3.5 mm less phase_multipath_m; Joerger and Pervan "
        "2016: 5 mm",
    )
    code_m: float = Field(
        0.09,
        ge=0,
        le=5,
        description="code, zenith, 1 sigma [m]; its 0.175 m less code_multipath_m; Joerger and Pervan 2016: 0.5 m",
    )
    phase_length_m: float = Field(14.0, gt=0, description="path in which the carrier's decays to 1/e [m]; that car")
    code_length_m: float = Field(21.0, gt=0, description="path in which the code's decays to 1/e [m]; that car")
    phase_tau_s: float = Field(100.0, gt=0, description="correlation time of the carrier's at rest [s]; that car")
    code_tau_s: float = Field(25.0, gt=0, description="correlation time of the code's at rest [s]; that car")

    @property
    def fitted(self) -> bool:
        """Whether there are near objects."""
        return self.kind != "none"


def near_rules(config: NearObjectsConfig, dt_s: float) -> Records:
    """The figures as the kernel takes them, (1,) of NEAR_RULES."""
    return one_record(
        NEAR_RULES,
        fitted=config.fitted,
        dt=dt_s,
        code=config.code_m,
        phase=config.phase_m,
        code_rest=math.exp(-dt_s / config.code_tau_s),
        phase_rest=math.exp(-dt_s / config.phase_tau_s),
        code_per_m=1.0 / config.code_length_m,
        phase_per_m=1.0 / config.phase_length_m,
    )
