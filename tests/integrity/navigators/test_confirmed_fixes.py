"""New integers are held only where every hypothesis of doubtful carriers finds the same ones."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import _agree
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY, SATELLITE

BANDS, SYSTEM = 2, np.array([0, 0, 0, 1, 1, 1])


def integers(rng: np.random.Generator) -> Records:
    ambiguities = np.zeros(SYSTEM.size, AMBIGUITY)
    ambiguities["held"], ambiguities["integers"] = True, rng.integers(-50, 50, (SYSTEM.size, 2))
    return ambiguities


def agree(found: Records, trial: Records, rest: np.ndarray | None = None, before: Records | None = None) -> bool:
    satellites = np.zeros(SYSTEM.size, SATELLITE)
    satellites["system"] = SYSTEM
    everything, nothing = np.ones(SYSTEM.size, np.bool_), np.zeros(SYSTEM.size, AMBIGUITY)
    rest, before = everything if rest is None else rest, nothing if before is None else before
    return bool(_agree(satellites, rest, trial, before, found, BANDS))


def test_integers_may_differ_by_those_of_another_reference() -> None:
    found = integers(np.random.default_rng(1))
    trial = found.copy()
    trial["integers"] += np.array([[3.0, -2.0], [7.0, 4.0]])[SYSTEM]  # of each system and band
    assert agree(found, trial)
    assert found["held"].all()


@pytest.mark.parametrize(("satellite", "band"), [(0, 0), (2, 1), (4, 0)])
def test_one_other_integer_refutes_the_fix(satellite: int, band: int) -> None:
    found = integers(np.random.default_rng(2))
    trial = found.copy()
    trial["integers"][satellite, band] += 1.0
    assert not agree(found, trial)


def test_a_new_satellite_that_a_hypothesis_cannot_fix_is_released_and_a_held_one_stays() -> None:
    found = integers(np.random.default_rng(3))
    trial, before = found.copy(), np.zeros(SYSTEM.size, AMBIGUITY)
    before[2], trial["held"][[1, 2]] = found[2], False
    assert agree(found, trial, before=before)
    assert found["held"].tolist() == [True, False, True, True, True, True]


def test_the_satellites_of_the_hypothesis_are_not_judged() -> None:
    found, rest = integers(np.random.default_rng(4)), np.ones(SYSTEM.size, np.bool_)
    trial = found.copy()
    rest[5], trial["held"][5] = False, False
    assert agree(found, trial, rest)
    assert found["held"].all()
