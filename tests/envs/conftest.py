"""Fixtures of environments.

highway-env's own intersection rewrites the class that drives there: after each test it is as before.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from highway_env.vehicle.behavior import IDMVehicle

from lanebound.envs import recordings

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


@pytest.fixture(scope="module")
def few_recordings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A few recorded episodes of other vehicles, kept apart from those of the user."""
    folder = tmp_path_factory.mktemp("recordings")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(recordings, "EPISODES", 4)
        patched.setattr(recordings, "cache_root", lambda: folder)
        recordings._recordings.cache_clear()
        yield
    recordings._recordings.cache_clear()
