"""S2's switch between the velocity of GNSS and that of heading and odometer."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode

NAME = "lanebound.integrity.navigators.services.velocity_switch:velocity_switch"


def _modes(stages: list[str], scale: float) -> NDArray[np.int64]:
    """Modes (K, B) of cars that drive North at 10 m/s without a station; odometers show ``1 + scale`` of the speed."""
    config = NavigatorConfig(
        stages=stages, corrections={"outage_per_h": 0.0}, positioning={"mode": {"doppler_when": "usable"}},
        gnss={"range_rate_sigma_mps": 0.02}, odometer={"scale_sigma": 0.0},
    )  # fmt: skip
    navigator = Navigator.nominal(config, seeds=[1, 2, 3, 4], duration_s=60.0)
    navigator.place(np.zeros((4, 2)), np.zeros(4), 1.0, 0.01)
    speed, heading, position, out = np.tile([0.0, 10.0], (4, 1)), np.zeros(4), np.zeros((4, 2)), []
    for k in range(60):
        before, position = position, position + 0.1 * speed
        truth = truth_between(0.1 * (k + 1), 0.1, (before, position), (speed, speed), (heading, heading))
        m = navigator.measure(truth)
        m.odometer.speed_mps[:] *= 1.0 + scale
        m.gnss.corrections_age_s[:] = np.inf  # no RTK
        out.append(navigator.locate(m).mode.copy())
    return np.array(out)[30:]


@pytest.mark.parametrize(("scale", "share"), [(0.0, 1.0), (0.04, 0.0)])
def test_doppler_that_differs_by_more_than_a_quarter_of_a_metre_per_second_is_not_used(
    scale: float, share: float
) -> None:
    assert (_modes([], scale) == Mode.DOPPLER).mean() > 0.9  # 0.4 m/s are within the 0.5 m/s of S1
    found = (_modes([NAME], scale) == Mode.DOPPLER).mean()
    assert found == pytest.approx(share, abs=0.1)
