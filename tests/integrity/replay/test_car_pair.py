"""RTK of a recorded car 5 km from its base by the default settings, whole and in parts, beside RTKLIB."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from recordings import real

from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef
from lanebound.integrity.recorded.rinex_observation import Observations, read_observations
from lanebound.integrity.replay.baseline import Baseline, BaselineConfig, solve_baseline
from lanebound.integrity.sky.broadcast import read_navigation
from lanebound.integrity.sky.systems import System

BASE = np.array([-3959400.631, 3385704.533, 3667523.111])
AXES = ecef_from_enu_matrix(*geodetic_from_ecef(BASE)[:2])
RTKLIB = {
    282600.0: (-3961953.0194, 3381199.0469, 3668915.4187),
    282620.0: (-3961953.0113, 3381199.0409, 3668915.4142),
    282639.0: (-3961954.2949, 3381199.8701, 3668913.3311),
    282645.0: (-3961962.8459, 3381204.4907, 3668899.7220),
}
"""Fixed positions of rnx2rtkp 2.4.3 b34 (Debian), by time of week: kinematic, l1+2, forward, elevation mask 10 degrees,
broadcast ephemerides, GPS, Galileo and QZSS, continuous, ratio 3."""


@cache
def recorded(folder: Path) -> tuple[Observations, Observations]:
    return read_observations(folder / "SEPT265G.21O"), read_observations(folder / "3034265G.21O")


def solved(drop: str = "", **changes: object) -> Baseline:
    """The solution without the systems ``drop``."""
    folder = real("rtk_cssrlib_4p7km_doy265")
    parts = [
        replace(data, rows={letter: rows for letter, rows in data.rows.items() if letter not in drop})
        for data in recorded(folder)
    ]
    table = read_navigation(folder / "SEPT2650.21P")
    return solve_baseline(parts[0], parts[1], table, BASE, BaselineConfig.build(None, changes))


@pytest.fixture(scope="module")
def whole() -> Baseline:
    return solved()


def test_the_car_is_fixed_at_the_default_risk(whole: Baseline) -> None:
    assert whole.fixed[30:].mean() >= 0.95
    assert whole.wrong_fix_risk.max() <= 1e-6
    assert whole.choice.rover == {"G": ("1C", "2L", "5Q"), "E": ("1C", "5Q", "7Q"), "J": ("1C", "5Q")}
    assert whole.choice.wavelength_m[System.QZSS, 0] < 0.2


def test_positions_are_those_of_rtklib(whole: Baseline) -> None:
    for tow, place in RTKLIB.items():
        k = int(np.flatnonzero(whole.tow_s == tow)[0])
        off = (whole.ecef_m[k] - np.array(place)) @ AXES
        assert np.hypot(off[0], off[1]) < 0.01, tow
        assert abs(off[2]) < 0.02, tow


@pytest.mark.parametrize(
    ("drop", "changes", "share"),
    [
        ("E", {}, 0.94),
        ("J", {}, 0.96),
        ("G", {}, 0.86),
        ("EJ", {}, 0.7),
        ("GJ", {}, 0.7),
        ("", {"rtk": {"elevation_mask_deg": 20.0}}, 0.96),
        ("", {"rtk": {"float_solution": {"kind": "epoch"}}}, 0.94),
        ("", {"bands": 1}, 0.85),
        ("", {"bands": 2}, 0.96),
    ],
)
def test_parts_of_the_signals_give_the_same_positions(
    whole: Baseline, drop: str, changes: dict[str, object], share: float
) -> None:
    part = solved(drop, **changes)
    both = part.fixed & whole.fixed
    assert both.mean() > share
    off = np.abs(part.enu_m - whole.enu_m)[both]
    sine, cosine = np.abs(np.sin(part.heading_rad[both])), np.abs(np.cos(part.heading_rad[both]))
    assert (off[:, 0] * sine + off[:, 1] * cosine < part.pl_m[both, 0]).all()
    assert (off[:, 0] * cosine + off[:, 1] * sine < part.pl_m[both, 1]).all()


def test_epochs_that_do_not_converge_say_what_they_lack() -> None:
    from lanebound.integrity.replay.baseline_report import summarise

    found = summarise(solved("GJ"))["not_converged"]  # five satellites of Galileo
    assert found["failure_rate_median"] > found["failure_limit"] == pytest.approx(5e-7)
    assert "signals was" in found["what"]
    assert "its limit is 5.0e-07, which what was measured did not meet either: more satellites" in found["what"]
    assert found["what"].endswith(", a shorter baseline or a longer time lower it")
