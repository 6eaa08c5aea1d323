"""What the instruments of a vehicle tell of one epoch, as records: the only input of positioning."""

from __future__ import annotations

from lanebound.integrity.core.records import record
from lanebound.integrity.sensors.arrival_kernel import BANDS

__all__ = ["OBSERVED_SIGNAL", "OBSERVED_VEHICLE"]

OBSERVED_SIGNAL = record(
    e=("f8", (3,), "unit vector to the satellite, East North Up"),
    tracked=("?", "the code is tracked"),
    reflected=("?", "a detector flags the signal as reflected; never without one"),
    lock_lost=("?", "the receiver detected a loss of carrier lock since the previous epoch"),
    cn0="carrier-to-noise density [dB-Hz]",
    range_rate="Doppler without the motion of the satellite [m/s]",
    code=("f8", (BANDS,), "rover minus reference, by band; 0 without tracking [m]"),
    phase=("f8", (BANDS,), "the same of the carrier; 0 without lock [m]"),
    integer_error=("i8", (BANDS,), "of a fault: cycles by which the integers are wrong that positioning fixes"),
)
"""A satellite's signal in an epoch, (B, S)."""

OBSERVED_VEHICLE = record(
    sight=("i8", "row of the directions to the satellites that this vehicle uses"),
    age="of the reference data, inf without data [s]",
    turn=("f8", (3,), "integrated angular rates, forward right down [rad]"),
    delta_v=("f8", (3,), "integrated specific force [m/s]"),
    speed="odometer, signed [m/s]",
    distance="odometer [m]",
    next_best=("f8", (2,), "of a fault: rank of the wrong integers accepted, 0 for none; their azimuth [rad]"),
)
"""The rest of an epoch, (B,)."""
