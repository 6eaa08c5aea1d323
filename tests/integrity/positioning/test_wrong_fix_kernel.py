"""Wrong integers of a rank by fit: against a search of all small vectors, and by the position that they mean."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.stats import chi2
from signal_records import records_of, rows_of

from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters
from lanebound.integrity.positioning.rtk_kernel import SATELLITE, Carriers
from lanebound.integrity.positioning.wrong_fix_kernel import displacement_of, next_best_integers
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import WAVELENGTH_M, System

RULES = epoch_parameters(RtkReckoningConfig())["rtk"][0]


def carriers_of(n: int, seed: int) -> Carriers:
    rng = np.random.default_rng(seed)
    az, el = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.3, 1.5, n)
    los = np.stack([np.sin(az) * np.cos(el), np.cos(az) * np.cos(el), np.sin(el)], -1)
    satellites = np.zeros(n, SATELLITE)
    satellites["system"], satellites["fixable"], satellites["prior"] = System.GPS, True, 1e-5
    satellites["wavelength"] = WAVELENGTH_M[System.GPS, :2]
    return Carriers(satellites, records_of(OBSERVED_SIGNAL, n, e=los), 0.5 * (1.0 + 1.0 / los[:, 2] ** 2))


def rows_in(carriers: Carriers, used: object = True) -> Records:
    """Rows of the carriers, of which some are used."""
    return rows_of(carriers.signals["e"], carriers.satellites["system"], used)


def misfit(z: np.ndarray, carriers: Carriers) -> float:
    """Least weighted squares of code and carrier together when the carriers have the integers z (S, 2): none of it is
    clock or position."""
    los, factor = carriers.signals["e"], carriers.variance
    n = len(factor)
    design, y, weight = [], [], []
    for b in range(2):
        for k, (values, sigma) in enumerate(
            [(np.zeros(n), RULES["sigma_code"]), (WAVELENGTH_M[System.GPS, b] * z[:, b], RULES["sigma_phase"])]
        ):
            clock = np.zeros((n, 4))
            clock[:, 2 * b + k] = 1.0
            design.append(np.hstack([los, clock]))
            y.append(values)
            weight.append(1.0 / (factor * sigma**2))
    root = np.sqrt(np.concatenate(weight))
    a, v = np.vstack(design) * root[:, None], np.concatenate(y) * root
    return float(np.sum((v - a @ np.linalg.lstsq(a, v, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("seed", range(4))
def test_ranks_are_those_of_the_fit_of_code_and_carrier(seed: int) -> None:
    """Each rank fits worse than the one before, and no vector of a wide neighbourhood fits between."""
    carriers, used = carriers_of(5, seed), True
    found = []
    for rank in range(1, 9):
        z = np.zeros((5, 2), np.int64)
        assert next_best_integers(carriers, rows_in(carriers, used), rank, 0.3, RULES, z)
        found.append(z)
    fits = [misfit(z, carriers) for z in found]
    assert all(a <= b * (1.0 + 1e-9) for a, b in pairwise(fits))
    centred = [np.concatenate([(z - z[:1])[1:].ravel()]) for z in found]  # of the first satellite: it is clock
    known = {tuple(z) for z in centred} | {tuple(-z) for z in centred}
    assert len(known) == 16
    for steps in product((-1, 0, 1), repeat=3):  # sums of the best three are lattice vectors, too
        z = sum(s * one for s, one in zip(steps, found[:3], strict=True))
        if np.any(z) and misfit(z, carriers) < fits[-1] * (1.0 - 1e-9):
            assert tuple((z - z[:1])[1:].ravel()) in known
    rng = np.random.default_rng(seed)
    for _ in range(20_000):
        z = rng.integers(-2, 3, (5, 2))
        z[0] = 0
        if z.any() and misfit(z, carriers) < fits[-1] * (1.0 - 1e-9):
            assert tuple(z[1:].ravel()) in known


def test_a_wrong_candidate_moves_the_position_to_the_side_of_the_azimuth() -> None:
    carriers, used = carriers_of(8, 3), np.ones(8, np.bool_)
    used[5] = False
    moved = []
    for azimuth in (0.3, 0.3 + np.pi):
        z, d = np.full((8, 2), 9, np.int64), np.zeros(3)
        assert next_best_integers(carriers, rows_in(carriers, used), 1, azimuth, RULES, z)
        assert not z[5].any()
        assert displacement_of(z, carriers, rows_in(carriers, used), 2, d)
        assert d[0] * np.sin(azimuth) + d[1] * np.cos(azimuth) > 0.0
        moved.append(d)
    np.testing.assert_allclose(moved[0], -moved[1], atol=1e-12)
    e, root = carriers.signals["e"][used], 1.0 / np.sqrt(carriers.variance[used])
    y = -np.mean(z[used] * WAVELENGTH_M[System.GPS, :2], 1)  # what positioning makes of phases -e.x + clock at x = 0
    design = np.column_stack([-e, np.ones(len(e))])
    np.testing.assert_allclose(
        np.linalg.lstsq(design * root[:, None], y * root, rcond=None)[0][:3], moved[1], atol=1e-9
    )


def test_too_few_satellites_have_no_wrong_candidate() -> None:
    carriers, used = carriers_of(5, 0), np.array([True, True, True, False, False])
    assert not next_best_integers(carriers, rows_in(carriers, used), 1, 0.0, RULES, np.zeros((5, 2), np.int64))


@pytest.mark.parametrize(("n", "least", "most"), [(7, 0.1, 1.0), (20, 0.0, 0.05)])
def test_wrong_candidates_pass_the_test_of_few_satellites_and_not_of_many(n: int, least: float, most: float) -> None:
    """Share of geometries whose second best integers pass the global test (0.5 %) and are off by 10 cm and more."""
    passed, used = [], True
    for seed in range(100, 140):
        carriers, z, d = carriers_of(n, seed), np.zeros((n, 2), np.int64), np.zeros(3)
        assert next_best_integers(carriers, rows_in(carriers, used), 1, 0.0, RULES, z)
        assert displacement_of(z, carriers, rows_in(carriers, used), 2, d)
        e, root = carriers.signals["e"], 1.0 / np.sqrt(carriers.variance * RULES["sigma_phase"] ** 2 / 2.0)
        design, y = np.column_stack([e, np.ones(n)]) * root[:, None], root * np.mean(z * WAVELENGTH_M[0, :2], 1)
        left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        passed.append(left @ left < chi2.isf(0.005, n - 4) and np.hypot(d[0], d[1]) > 0.1)
    assert least <= np.mean(passed) <= most
