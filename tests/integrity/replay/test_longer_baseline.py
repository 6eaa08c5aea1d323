"""A pair 12 km apart, with an ionosphere of its own for each satellite."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from baselines import AXES, PLACE, TOW, WEEK, navigation_text, observation_text, receiver, sky, slant

from lanebound.integrity.core.frames import ecef_from_geodetic
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.replay.baseline import Baseline, BaselineConfig, solve_baseline
from lanebound.integrity.sky.rinex_navigation import parse_navigation, read_navigation

EPOCHS = 60
ROVER = ecef_from_geodetic(np.radians(35.13 + 0.09), np.radians(136.97 + 0.08), 100.0)  # 12 km to the North-East
FAR_M = float(np.linalg.norm(ROVER - PLACE))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rover.obs, base.obs and base.nav."""
    out, wide, time = tmp_path_factory.mktemp("pair"), sky(wanted=8), np.arange(float(EPOCHS))
    names = np.arange(len(wide.prn)) % 90 + 1
    (out / "base.nav").write_text(navigation_text(replace(wide, prn=names)))
    table = parse_navigation((out / "base.nav").read_text())
    delay = slant(table, np.random.default_rng(5).normal(0.0, 0.5e-6 * FAR_M, len(table.satellites)))
    rover = receiver(table, time, np.tile(ROVER, (EPOCHS, 1)), clock_s=2e-4, seed=1, delay_m=delay)
    base = receiver(table, time, np.tile(PLACE, (EPOCHS, 1)), clock_s=-1e-4, seed=2)
    for name, data in (("rover", rover), ("base", base)):
        (out / f"{name}.obs").write_text(observation_text(data))
    return out


def solved(folder: Path, kind: str, **changes: Any) -> Baseline:
    config = BaselineConfig.build(None, {"rtk": {"float_solution": {"kind": kind}}, **changes})
    files = [read_observations(folder / f"{name}.obs") for name in ("rover", "base")]
    return solve_baseline(files[0], files[1], read_navigation(folder / "base.nav"), PLACE, config)


def test_the_files_hold_the_session(folder: Path) -> None:
    found = read_observations(folder / "rover.obs")
    assert found.epochs == EPOCHS
    assert (int(found.week[0]), float(found.tow_s[0])) == (WEEK, TOW)
    assert 11e3 < FAR_M < 13e3


def test_the_sequential_filter_fixes_and_one_epoch_does_not(folder: Path) -> None:
    sequential, epoch = solved(folder, "sequential"), solved(folder, "epoch")
    true = (ROVER - PLACE) @ AXES
    for found in (sequential, epoch):  # nothing fixed is wrong, and no level is exceeded
        error = np.abs(found.enu_m - true)[found.fixed]
        assert not error.size or np.hypot(error[:, 0], error[:, 1]).max() < 0.06
        assert (error[:, :2][:, ::-1] < found.pl_m[found.fixed]).all()  # heading 0: along is North
    assert sequential.fixed[30:].all()
    assert sequential.wrong_fix_risk.max() <= 1e-6
    assert epoch.fixed.sum() < 0.1 * EPOCHS
