"""A rover that stands, said to do so: earlier fixes, right positions; one that moves is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from baselines import AXES, PLACE, navigation_text, observation_text, receiver, sky
from recordings import real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.replay.baseline import Baseline, BaselineConfig, solve_baseline
from lanebound.integrity.replay.baseline_report import run_baseline
from lanebound.integrity.sky.broadcast import read_navigation

ROVER = ecef_from_geodetic(np.radians(35.13 + 0.0005), np.radians(136.97 + 0.0003), 101.0)
TIMES = np.arange(0.0, 200.0, 5.0)


def first_band_of_gps(data: Observations) -> Observations:
    rows = data.rows["G"]
    second = np.array([code[1] == "2" for code in rows.codes])
    return replace(data, rows={"G": replace(rows, value=np.where(second, 0.0, rows.value))})


@cache
def solved(static: bool, seed: int) -> Baseline:
    table = sky(seed=seed, wanted=8)
    places = {"rover": ROVER, "base": PLACE}
    rover, base = (
        first_band_of_gps(receiver(table, TIMES, np.tile(place, (TIMES.size, 1)), clock_s=1e-4, seed=10 * seed + k))
        for k, place in enumerate(places.values(), start=1)
    )
    return solve_baseline(
        rover, base, table, PLACE, BaselineConfig.build(None, {"static": static, "rtk": {"posterior_margin": 1.25}})
    )


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_one_band_is_fixed_earlier_and_right(seed: int) -> None:
    moving, static = solved(False, seed), solved(True, seed)
    assert 0 < np.argmax(static.fixed) < np.argmax(moving.fixed)
    assert static.fixed[np.argmax(static.fixed) :].all()
    error = np.abs(static.enu_m - (ROVER - PLACE) @ AXES)[static.fixed]
    assert error[:, :2].max() < 0.03
    assert (error[:, [1, 0]] < static.pl_m[static.fixed]).all()  # heading 0: along is North


def test_a_rover_that_walks_is_refused(tmp_path: Path) -> None:
    """Two metres are too few for the codes and enough for the fixed positions."""
    table, time = sky(wanted=8), np.arange(0.0, 20.0)
    names = np.arange(len(table.prn)) % 90 + 1
    (tmp_path / "base.nav").write_text(navigation_text(replace(table, prn=names)))
    walk = ROVER + np.linspace(0.0, 2.0, time.size)[:, None] * AXES[:, 0]
    table = read_navigation(tmp_path / "base.nav")
    for name, places in (("rover", walk), ("base", np.tile(PLACE, (time.size, 1)))):
        data = receiver(table, time, places, clock_s=1e-4, seed=len(name))
        (tmp_path / f"{name}.obs").write_text(observation_text(data))
    files = tmp_path / "rover.obs", tmp_path / "base.obs", [tmp_path / "base.nav"], tmp_path / "out"
    run_baseline(*files, base_ecef_m=PLACE, config=BaselineConfig())
    with pytest.raises(InputError, match=r"fixed positions differ by 1\.. m, the bound is 0\.5 m"):
        run_baseline(*files, base_ecef_m=PLACE, config=BaselineConfig(static=True))


def test_a_car_is_refused(tmp_path: Path) -> None:
    folder = real("rtk_cssrlib_4p7km_doy265")
    files = folder / "SEPT265G.21O", folder / "3034265G.21O", [folder / "SEPT2650.21P"], tmp_path
    with pytest.raises(InputError, match=r"its codes say that it moves: .* lie 7\d m and more .*, the bound is 15 m"):
        run_baseline(*files, config=BaselineConfig(static=True))
    nagoya = ecef_from_geodetic(np.radians(35.3), np.radians(137.5), 100.0)
    with pytest.raises(
        InputError, match=r"--rover-position .* its codes say that it moves: .*the bound is 15 m; leave"
    ):
        run_baseline(*files, rover_ecef_m=nagoya)
