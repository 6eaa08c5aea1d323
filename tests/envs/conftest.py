"""highway-env's own intersection rewrites the class that drives there: after each test it is as before."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from highway_env.vehicle.behavior import IDMVehicle

REWRITTEN = ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")
CONSTANTS = {name: vars(IDMVehicle)[name] for name in REWRITTEN}


@pytest.fixture(autouse=True)
def _drivers_as_they_were() -> Iterator[None]:
    _restore()
    yield
    _restore()


def _restore() -> None:
    for name, value in CONSTANTS.items():
        setattr(IDMVehicle, name, value)
