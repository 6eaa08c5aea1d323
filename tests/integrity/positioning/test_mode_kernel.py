import math

import numpy as np
import pytest

from lanebound.integrity.positioning.config import ModeConfig
from lanebound.integrity.positioning.mode_kernel import doppler_usable, rtk_usable, speed_dilution
from lanebound.integrity.positioning.parameters import mode_parameters

LIMITS = mode_parameters(ModeConfig())[0]  # S1 table 1
USABLE = {"solved": True, "v_gnss": 10.0, "v_ss": 10.0, "hdop": 1.0}


def test_rtk_needs_its_geometry():
    assert rtk_usable(2.999, LIMITS)
    assert not rtk_usable(3.0, LIMITS)
    assert not rtk_usable(math.inf, LIMITS)


@pytest.mark.parametrize(
    ("changes", "inside", "outside"),
    [
        ({}, ("v_gnss", 10.499), ("v_gnss", 10.5)),
        ({}, ("v_gnss", 9.501), ("v_gnss", 9.5)),
        ({"v_ss": -10.0}, ("v_gnss", 10.499), ("v_gnss", 10.5)),
        ({}, ("hdop", 1.499), ("hdop", 1.5)),
        ({}, ("hdop", 1.0), ("hdop", math.inf)),
        ({}, ("v_gnss", 10.0), ("v_gnss", math.nan)),
        ({}, ("solved", True), ("solved", False)),
    ],
)
def test_each_condition_of_doppler_on_both_sides(changes, inside, outside):
    assert doppler_usable(*(USABLE | changes | dict([inside])).values(), LIMITS)
    assert not doppler_usable(*(USABLE | changes | dict([outside])).values(), LIMITS)


def test_speed_dilution_is_that_of_the_speed_alone() -> None:
    """By brute force: deviation of the length of the velocity, over that of one range rate at the zenith."""
    rng = np.random.default_rng(1)
    root = np.array([[0.2, 0.0, 0.0], [0.1, 0.05, 0.0], [0.0, 0.1, 0.3]])
    q = root @ root.T
    velocity = np.array([6.0, 8.0, 0.0])
    lengths = np.linalg.norm((velocity + rng.normal(size=(200_000, 3)) @ root.T)[:, :2], axis=1)
    found = speed_dilution(6.0, 8.0, 0.0, 1.0, q, 0.1)
    assert found == pytest.approx(lengths.std() / 0.1, rel=0.01)
    assert speed_dilution(0.0, 0.0, 0.0, 1.0, q, 0.1) == pytest.approx(np.sqrt(q[1, 1]) / 0.1)  # at rest: the heading
