"""RTK of a real drive of an hour on one band, against its reference (data of UCR, see its README)."""

from __future__ import annotations

from pathlib import Path

import pytest
from recordings import real

from lanebound.integrity.replay.baseline_report import read_coordinates, run_baseline

BASE = "-2430697.699,-4704189.201,3544329.103"  # of the authors of the recording


@pytest.mark.slow
def test_an_hour_on_one_band_is_fixed_and_no_fixed_epoch_is_beyond_its_level(tmp_path: Path) -> None:
    data = real("ucr_riverside_drive_l1")
    found, _ = run_baseline(
        data / "COM3_200712.obs.gz", data / "rbst0711base.obs.gz", [data / "COM3_200712.nav"], tmp_path,
        base_ecef_m=read_coordinates(BASE), truth=data / "groundtruth.csv",
    )  # fmt: skip
    assert (found["epochs"], found["first_fix_s"]) == (3810, 0.0)
    assert found["fixed_share"] > 0.98
    errors = found["errors"]["fixed"]
    assert errors["horizontal_max_m"] < 0.05
    assert errors["at"]["exceeded"] == errors["ct"]["exceeded"] == 0
