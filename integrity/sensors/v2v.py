"""Configuration of vehicle-to-vehicle broadcasts of estimated states over a radio channel with delay and loss.

The channel is :mod:`lanebound.envs.batch.perception_kernel`: it needs the vehicles around each receiver.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from lanebound.integrity.core.config import Config

__all__ = ["V2vConfig"]


class V2vConfig(Config):
    """The radio channel of one street."""

    messages: Literal["rate", "cam"] = Field(
        "rate",
        description="at rate_hz, or cooperative awareness messages as ETSI EN 302 637-2 asks for them: after 4 m, "
        "4 deg or 0.5 m/s, and after 1 s at the latest, rounded, with an ellipse of 95 % and the acceleration",
    )
    rate_hz: float = Field(
        10.0, gt=0, description="messages of a vehicle per second; SAE J2735 BSM, ETSI CAM up to 10 Hz"
    )
    latency_s: float = Field(
        0.05, ge=0, description="shortest delay of a message [s]; 3GPP TS 22.185 requires <= 100 ms"
    )
    jitter_s: float = Field(0.03, ge=0, description="mean of the additional exponential delay [s]; congestion")
    latency_max_s: float = Field(0.5, gt=0, description="messages with a longer delay are dropped [s]")
    loss: float = Field(0.05, ge=0, le=1, description="loss rate at close range [-]; C-V2X field tests: 90 % at 300 m")
    range_m: float = Field(300.0, gt=0, description="radio range [m]; urban street, line of sight")
