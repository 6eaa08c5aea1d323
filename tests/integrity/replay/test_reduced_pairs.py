"""RTK of the static pair, 1 m long and 31 s, reduced to one system, by the default settings.

RTKLIB 2.4.3 (kinematic, ratio 3) fixes all 31 epochs of each of these. L1 of GPS alone has a risk above ours with it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recordings import real

from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef
from lanebound.integrity.recorded.rinex_observation import Observations, read_observations
from lanebound.integrity.replay.baseline import Baseline, solve_baseline
from lanebound.integrity.replay.baseline_report import read_coordinates, summarise
from lanebound.integrity.sky.broadcast import read_navigation


@cache
def recorded(name: str) -> Observations:
    return read_observations(real("rtk_matrtklib_1m_static_30s") / f"{name}.obs")


def reduced(name: str, letter: str, without: tuple[str, ...]) -> Observations:
    """One receiver with one system, and without some of its signals."""
    data = recorded(name)
    rows = data.rows[letter]
    value = np.where([code[1:].startswith(without) if without else False for code in rows.codes], 0.0, rows.value)
    return replace(data, rows={letter: replace(rows, value=value)})


def solved(letter: str, rover: tuple[str, ...] = (), base: tuple[str, ...] = ()) -> tuple[Baseline, np.ndarray]:
    """The solution and its errors in E, N, U (T, 3)."""
    folder = real("rtk_matrtklib_1m_static_30s")
    place, true = (read_coordinates(str(folder / f"{name}_position.txt")) for name in ("base", "rover"))
    pair = reduced("rover", letter, rover), reduced("base", letter, base)
    found = solve_baseline(*pair, read_navigation(folder / "base.nav"), place)
    axes = ecef_from_enu_matrix(*geodetic_from_ecef(place)[:2])
    return found, found.enu_m - (true - place) @ axes


@pytest.mark.parametrize(
    ("letter", "without", "first", "signals"),
    [
        ("G", (), 0, ("1C", "2L", "5Q", "2W")),
        ("G", ("2L", "5"), 0, ("1C", "2W")),
        ("E", (), 0, ("1C", "7Q", "5Q")),
        ("C", (), 0, ("2I", "6I", "7I")),
    ],
)
def test_one_system_is_fixed_and_right(
    letter: str, without: tuple[str, ...], first: int, signals: tuple[str, ...]
) -> None:
    found, error = solved(letter, without, without)
    assert found.choice.rover == {letter: signals}
    assert found.fixed[first:].all()
    assert found.wrong_fix_risk.max() <= 1e-6
    there = np.abs(error[found.fixed])
    assert np.hypot(there[:, 0], there[:, 1]).max() < 0.01
    assert (there[:, [1, 0]] < found.pl_m[found.fixed]).all()  # heading 0: along is North


@pytest.mark.parametrize(("rover", "base"), [(("2W", "5"), ("2L", "5")), (("2L", "5"), ("2W", "5"))])
def test_receivers_with_different_codes_of_a_band(rover: tuple[str, ...], base: tuple[str, ...]) -> None:
    """L2L against L2W: their difference is the clock's. The failure rate, 7e-7 to 3e-5, is above its limit."""
    found, error = solved("G", rover, base)
    assert {found.choice.rover["G"][1], found.choice.base["G"][1]} == {"2L", "2W"}
    assert found.fixed.all()
    assert 1e-15 < found.wrong_fix_risk.max() <= 5e-7
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.01
    assert (np.abs(error[:, [1, 0]]) < found.pl_m).all()


def test_one_band_of_gps_is_not_fixed_at_this_risk() -> None:
    found, error = solved("G", ("2", "5"), ("2", "5"))
    assert not found.fixed.any()
    assert summarise(found)["not_converged"]["failure_rate_median"] > 1e-2
    assert np.abs(error[:, :2]).max() < 1.0
