"""The study of recorded UWB ranges: the law is found again in ranges drawn from it, and the recording is read."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from lanebound.agents.studies.ranging import fit_law, read_errors, run_ranging, shown, tail
from lanebound.integrity.core.errors import InputError


def test_the_law_is_found_again() -> None:
    rng, n = np.random.default_rng(2), 20_000
    late = rng.random(n) < 0.1
    law = fit_law(0.12 + rng.normal(0.0, 0.05, n) + late * rng.exponential(0.4, n))
    assert law["offset_m"] == pytest.approx(0.12, abs=0.003)
    assert law["sigma_m"] == pytest.approx(0.05, rel=0.05)
    assert law["late_share"] == pytest.approx(0.1, rel=0.1)
    assert law["late_mean_m"] == pytest.approx(0.4, rel=0.1)


def test_tail_of_the_law() -> None:
    rng, n = np.random.default_rng(3), 1_000_000
    errors = rng.normal(0.0, 0.05, n) + (rng.random(n) < 0.1) * rng.exponential(0.4, n)
    for x in (0.05, 0.2, 1.0):
        share = float(tail(np.array(x), 0.05, 0.1, 0.4))
        assert abs((errors > x).mean() - share) < 5.0 * np.sqrt(share / n)


def _recording(folder: Path, offset_m: float = 0.1) -> Path:
    """A robot at (0, 0) that goes to (2, 0), and modules at (0, 3) and (4, 0)."""
    folder.mkdir()
    times, rng = np.arange(0.0, 20.0, 0.1), np.random.default_rng(1)
    points = [f"point2 {t} {0.1 * t} 0.0 0 0 0 0" for t in times]
    lines = ["odom2diff 0.0 0 0 0 0.08 0 0 0"]
    for i, t in enumerate(times):
        x, y, name = (0.0, 3.0, 7) if i % 2 else (4.0, 0.0, 9)
        lines.append(f"range2 {t} {np.hypot(x - 0.1 * t, y) + offset_m + rng.normal(0, 0.02)} 0.01 {x} {y} {name} 0")
    (folder / "Indoor_UWB_GT.txt").write_text("\n".join(points))
    (folder / "Indoor_UWB_Input.txt").write_text("\n".join(lines))
    return folder


def test_errors_are_those_of_the_interpolated_truth(tmp_path: Path) -> None:
    module, distance, errors = read_errors(_recording(tmp_path / "data"))
    assert {*module.tolist()} == {7, 9}
    assert distance[0] == pytest.approx(4.0)
    assert errors.mean() == pytest.approx(0.1, abs=0.01)
    result = run_ranging(tmp_path / "data", tmp_path / "out")
    assert result["modules"]["7"]["offset_m"] == pytest.approx(0.1, abs=0.01)
    assert result["all"]["core_sigma_m"] == pytest.approx(0.02, rel=0.3)
    assert len([*shown(result)]) == 3


def test_a_folder_without_the_files_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Indoor_UWB_Input\.txt is missing"):
        read_errors(tmp_path)
    for name in ("Indoor_UWB_Input.txt", "Indoor_UWB_GT.txt"):
        (tmp_path / name).write_text("other 1 2 3\n")
    with pytest.raises(InputError, match="lines range2 and point2"):
        read_errors(tmp_path)


@pytest.mark.skipif("LANEBOUND_DATA" not in os.environ, reason="needs recorded data in the folder LANEBOUND_DATA")
def test_the_recording(tmp_path: Path) -> None:
    result = run_ranging(Path(os.environ["LANEBOUND_DATA"]) / "uwb_indoor", tmp_path / "out")
    assert result["ranges"] == 233
    assert 0.05 < result["all"]["core_sigma_m"] < 0.1
    assert result["all"]["late_share"] > 3.0 * result["all"]["short_share"]  # ranges are too long, seldom too short
    for row in result["bounds"]:  # the form of the law fits
        assert row["share_95"][0] <= row["wanted"] <= row["share_95"][1]
