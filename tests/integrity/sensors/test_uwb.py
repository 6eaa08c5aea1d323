"""Ranges between vehicles: strings around bodies, diffraction, link budget, and the statistics of errors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2

from lanebound.envs.batch.records_kernel import CAR
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sensors import uwb_kernel as uk
from lanebound.integrity.sensors.uwb import RangingConfig

TAIL = 1e-6  # of tests of random numbers
QUIET = {"sigma_m": 0.0, "offset_sigma_m": 0.0, "late_share": 0.0, "loss": 0.0}


def shortest(line: float, corners: np.ndarray) -> float:
    """Excess of the shortest way past a convex quadrangle: all ways between end points and corners."""
    points = [np.zeros(2), np.array([line, 0.0]), *corners]
    ways = np.full((6, 6), np.inf)
    for i in range(6):
        for j in range(6):
            if i != j and not _inside(points[i], points[j], corners):
                ways[i, j] = np.linalg.norm(points[i] - points[j])
    for k in range(6):
        ways = np.minimum(ways, ways[:, k : k + 1] + ways[k : k + 1])
    return float(ways[0, 1] - line)


def _inside(p: np.ndarray, q: np.ndarray, corners: np.ndarray) -> bool:
    """Whether the way from p to q leads through the inside."""
    first, last = 0.0, 1.0
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]])
        reach, rate = normal @ (p - a), normal @ (q - p)
        if abs(rate) < 1e-12:
            if reach <= 1e-9:
                return False
        elif rate > 0.0:
            first = max(first, -reach / rate)
        else:
            last = min(last, -reach / rate)
    return last - first > 1e-7


def test_the_string_around_a_body_is_the_shortest_way() -> None:
    rng, tried = np.random.default_rng(4), 0
    while tried < 300:
        line, turned, length, width = rng.uniform(3, 40), rng.uniform(0, 6.28), rng.uniform(1, 6), rng.uniform(0.5, 3)
        cos, sin, middle = math.cos(turned), math.sin(turned), np.array([rng.uniform(0, line), rng.normal()])
        half = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
        corners = half @ np.array([[cos, sin], [-sin, cos]]) + middle
        ends = np.array([[0.0, 0.0], [line, 0.0]]) - middle
        along, across = ends @ np.array([cos, sin]), ends @ np.array([-sin, cos])
        if ((np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)).any():
            continue  # a module within the body
        tried += 1
        crosses = uk.crosses_body(-middle[0], -middle[1], line, 0.0, cos, sin, length, width)
        excess = uk.around(line, corners, np.zeros((6, 2))) if crosses else 0.0
        assert excess == pytest.approx(shortest(line, corners), abs=1e-9)


def test_loss_of_an_edge_and_the_delay_that_it_permits() -> None:
    figures = RangingConfig().figures(0.1)[0]
    for nu, loss_db in ((0.0, 6.03), (1.0, 13.93), (2.4, 20.54)):  # ITU-R P.526-15, figure 9
        assert uk.knife_edge_db((nu / 2.0) ** 2 * 0.07, 0.07) == pytest.approx(loss_db, abs=0.02)
    for distance in (3.0, 10.0, 30.0):
        margin = 20.0 * math.log10(91.44 / distance)
        assert uk.knife_edge_db(uk.most_excess(figures, distance), 0.07) == pytest.approx(margin)
    assert uk.most_excess(figures, 60.0) == 0.0  # no edge is heard over


class Ranger:
    """Ranges of one ego to vehicles in the slots 0, 1, ... at rest."""

    def __init__(self, cars: list[tuple[float, float]], walls: Any = (), tall: tuple[int, ...] = (), **config: Any):
        self.figures = RangingConfig.load(config).figures(0.1)[0]
        self.cars = np.zeros(len(cars) + 1, CAR)
        self.cars["x"][1:], self.cars["y"][1:] = np.transpose(cars)
        self.cars["length"], self.cars["width"], self.cars["slot"] = 5.0, 2.0, np.arange(-1, len(cars))
        n = len(cars)
        self.modules, self.links = np.zeros(n + 1, uk.MODULE), np.zeros((n, uk.PAIRS), uk.LINK)
        self.modules["height_m"] = [2.6 if i in tall else 1.5 for i in range(n + 1)]
        self.walls, self.rng, self.n = np.array(walls, dtype=np.float64).reshape(-1, 4), np.random.default_rng(3), n

    def __call__(self) -> np.ndarray:
        normal, uniform = self.rng.standard_normal((self.n + 1, 4)), self.rng.random((self.n + 1, 8))
        out, ahead, scratch = np.zeros((self.n, uk.PAIRS)), np.zeros((self.n + 1, 2)), np.zeros((10, 2))
        figures, cars, links = self.figures, self.cars, self.links
        uk.range_all(figures, cars, self.modules, links, self.walls, normal, uniform, ahead, scratch, out)
        return out


def test_exact_ranges_are_distances_of_modules() -> None:
    ranges = Ranger([(20.0, 0.0), (200.0, 0.0)], **QUIET)()
    across = math.hypot(20.0, 1.6)
    np.testing.assert_allclose(ranges[0], [20.0, across, across, 20.0])
    np.testing.assert_array_equal(ranges[1], -1.0)  # beyond the link budget


def test_a_van_in_the_way_delays_by_the_way_over_it_and_a_car_does_not() -> None:
    one = {"lever_arms_m": [[0.0, 0.0]], **QUIET}
    assert Ranger([(30.0, 0.0), (15.0, 0.0)], **one)()[0, 0] == 30.0
    blocked = Ranger([(30.0, 0.0), (15.0, 0.0)], tall=(1,), range_m=1000.0, **one)()[0, 0]
    assert blocked == pytest.approx(5.0 + 2.0 * math.hypot(12.5, 1.0))  # lower than the ways past its sides
    beside = Ranger([(30.0, 0.0), (15.0, 0.9)], tall=(1,), range_m=1000.0, **one)()[0, 0]
    assert beside == pytest.approx(5.0 + 2.0 * math.hypot(12.5, 0.1))  # its side is nearer to the line than its roof
    assert Ranger([(30.0, 0.0), (15.0, 0.0)], tall=(1,), **one)()[0, 0] == -1.0  # 6.9 dB and more of a margin of 9.7


def test_buildings_hide_but_for_what_goes_around_their_corners() -> None:
    one = {"lever_arms_m": [[0.0, 0.0]], **QUIET}
    house, there = [10.0, 14.0, -12.0, -8.0], [(24.0, -17.0)]
    assert Ranger(there, [house], **one)()[0, 0] == -1.0
    near = Ranger(there, [house], range_m=1000.0, **one)()[0, 0]
    assert near == pytest.approx(math.hypot(14.0, 8.0) + math.hypot(10.0, 9.0))
    assert near > math.hypot(24.0, 17.0)


def test_noise_late_paths_and_losses_have_the_stated_statistics() -> None:
    n = 20_000
    ranger = Ranger([(20.0, 0.0)], late_s=1e-3, offset_sigma_m=0.0)  # independent from range to range
    errors = np.array([ranger()[0] for _ in range(n)])[:, [0, 3]] - 20.0
    heard = errors > -20.0
    assert binom.ppf(TAIL, 2 * n, 0.95) <= heard.sum() <= binom.isf(TAIL, 2 * n, 0.95)
    errors = errors[heard]
    clear = errors[errors < 0.0] / 0.023  # a late range is seldom short
    low, high = chi2.ppf([TAIL, 1 - TAIL], clear.size)
    assert 0.98 * low < (clear**2).sum() < 1.02 * high
    far = errors > 0.15  # 6.5 sigma: late, with an excess above that
    share = 0.05 * math.exp(-0.15 / 0.4 + 0.5 * (0.023 / 0.4) ** 2)  # of an exponential and a normal together
    assert binom.ppf(TAIL, errors.size, share) <= far.sum() <= binom.isf(TAIL, errors.size, share)


def test_a_pair_stays_on_its_path_for_the_stated_time() -> None:
    ranger = Ranger([(20.0, 0.0)], late_share=0.5, late_mean_m=100.0, **{k: 0.0 for k in ("sigma_m", "loss")})
    errors = np.array([ranger()[0, 0] for _ in range(20_000)])
    same = np.diff(errors) == 0.0
    stays = math.exp(-0.1 / 0.5)
    share = stays + (1.0 - stays) * 0.25  # or a direct path follows another one
    assert abs(same.mean() - share) < 5.0 * math.sqrt(share * (1.0 - share) / 20_000)


def test_signal_strength_is_worse_than_time_of_arrival_and_both_than_uwb() -> None:
    spread = {}
    for kind in ("uwb", "toa", "rssi"):
        ranger = Ranger([(20.0, 0.0)], kind=kind, late_share=0.0, loss=0.0)
        spread[kind] = float(np.std([ranger()[0, 0] for _ in range(4000)]))
    assert spread["uwb"] == pytest.approx(0.023, rel=0.1)
    assert spread["toa"] == pytest.approx(3.0, rel=0.1)
    assert 4.0 < spread["rssi"] < 9.0  # 3 dB at an exponent of 2.27: 30 % of 20 m


@pytest.mark.parametrize("arms", [[], [[0, 0], [0, 0]], [[0, 0], [1, 0], [2, 0]]])
def test_modules_are_one_or_two_places(arms: list[list[float]]) -> None:
    with pytest.raises(ConfigError, match="1 or 2 different places"):
        RangingConfig.load({"lever_arms_m": arms})


def test_figures_follow_the_kind() -> None:
    config: Config = RangingConfig.load({"kind": "toa", "sigma_m": 1.0})
    assert config.figures(0.1)["sigma_m"] == 1.0  # type: ignore[attr-defined]
    assert config.figures(0.1)["range_m"] == 300.0  # type: ignore[attr-defined]
