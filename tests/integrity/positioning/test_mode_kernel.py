import math

import pytest

from lanebound.integrity.positioning.config import ModeConfig, mode_parameters
from lanebound.integrity.positioning.mode_kernel import doppler_usable, rtk_usable

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
