"""Where the figures of near objects come from: a recorded car's carriers and codes, fitted on its first half.

Above 20 degrees, over the factor of the elevation, less the mean of each satellite (atmosphere, base). A first-order
process of sigma s and length L beside white errors has the correlation ``s^2 / total^2 exp(-k v / L)`` after k seconds.
"""

from __future__ import annotations

import numpy as np
import pytest
from car_residuals import Residuals, residuals
from recordings import real

from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.replay.baseline import solve_baseline
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.broadcast import read_navigation

BASE = np.array([-3959400.631, 3385704.533, 3667523.111])
SPEED_MPS = 5.5


@pytest.fixture(scope="module")
def halves() -> tuple[Residuals, Residuals]:
    folder = real("rtk_cssrlib_4p7km_doy265")
    rover, base = (read_observations(folder / name) for name in ("SEPT265G.21O", "3034265G.21O"))
    table = read_navigation(folder / "SEPT2650.21P")
    solved = solve_baseline(rover, base, table, BASE)
    fit, judge = (residuals(rover, base, table, solved, part) for part in ((0.0, 0.5), (0.5, 1.0)))
    return fit, judge


def lasting(part: Residuals, name: str) -> tuple[float, float]:
    """Sigma and length of the first-order process, from the correlations after 1 and 3 s."""
    one, three = (part.correlation(name, lag, True) for lag in (1, 3))
    decay = np.sqrt(three / one)
    return part.sigma(name) * np.sqrt(one / decay), -SPEED_MPS / np.log(decay)


def test_the_first_half_gives_the_figures(halves: tuple[Residuals, Residuals]) -> None:
    """What the simulated receiver has itself is taken off: its 2 mm and 0.15 m."""
    config, fit = GnssConfig(), halves[0]
    for name, given, own, length in (
        ("carrier", config.near_objects.phase_m, config.phase_multipath_m, config.near_objects.phase_length_m),
        ("code", config.near_objects.code_m, config.code_multipath_m, config.near_objects.code_length_m),
    ):
        sigma, path = lasting(fit, name)
        assert np.hypot(given, own) == pytest.approx(sigma, rel=0.05)
        assert length == pytest.approx(path, rel=0.25)
    assert fit.correlation("carrier", 30, False) > 0.4  # at rest they last
    assert 0.2 < fit.correlation("code", 20, False) < 0.5


def test_the_second_half_is_as_simulated(halves: tuple[Residuals, Residuals]) -> None:
    """The whole error of a simulated direct signal with near objects, beside what was not fitted: within 15 %."""
    c, judge = GnssConfig(), halves[1]
    carrier = np.sqrt(c.phase_sigma_m**2 + c.phase_multipath_m**2 + c.near_objects.phase_m**2)
    code = np.sqrt(c.code_sigma_m**2 + c.code_multipath_m**2 + c.near_objects.code_m**2)
    assert carrier == pytest.approx(judge.sigma("carrier"), rel=0.15)
    assert code == pytest.approx(judge.sigma("code"), rel=0.2)
    assert judge.correlation("carrier", 1, True) == pytest.approx(halves[0].correlation("carrier", 1, True), abs=0.1)
