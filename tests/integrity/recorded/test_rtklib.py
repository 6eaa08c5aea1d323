"""Solution files of RTKLIB and reference trajectories: what is read, and which damage is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import RTK_REFERENCE, RTK_SOLUTION, real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.recorded.rtklib import FIXED, FLOAT, read_reference, read_rtk_solution


def written(folder: Path, text: str) -> Path:
    path = folder / "drive"
    path.write_text(text)
    return path


def test_a_small_solution(tmp_path: Path) -> None:
    found = read_rtk_solution(written(tmp_path, RTK_SOLUTION))
    assert found.stopped is None
    assert found.tow_s.tolist() == [194670.0, 194670.2]
    assert found.quality.tolist() == [FIXED, FLOAT]
    assert found.satellites.tolist() == [16, 9]
    assert found.ratio.tolist() == [6.4, 1.2]
    latitude, longitude, height = geodetic_from_ecef(found.position_ecef_m[0])
    assert np.degrees([latitude, longitude]) == pytest.approx([35.165360868, 136.88140954], abs=1e-9)
    assert float(height) == pytest.approx(41.4082, abs=1e-4)


def test_a_small_reference_is_sorted_by_time(tmp_path: Path) -> None:
    head, *rows = RTK_REFERENCE.splitlines()
    found = read_reference(written(tmp_path, "\n".join([head, *reversed(rows)]) + "\n"))
    assert found.tow_s.tolist() == [194670.0, 194670.2]
    np.testing.assert_allclose(found.position_ecef_m[0], [-3810228.582, 3567868.547, 3652903.300])
    assert np.isnan(found.heading_rad).all()
    headed = read_reference(written(tmp_path, RTK_REFERENCE.replace("Roll", "Heading")))
    np.testing.assert_allclose(np.degrees(headed.heading_rad), [0.329, 0.331])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("35.165360868", "95.0", "line 3, latitude must lie in"),
        ("   0.03    6.4", "", "line 3, must have more than 14 columns, got 13"),
        (" 1  16 ", " x  16 ", "line 3, Q must be a number"),
    ],
)
def test_damage_of_a_solution_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_rtk_solution(written(tmp_path, RTK_SOLUTION.replace(old, new, 1)))


def test_damage_of_a_reference_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 1 must name a column 'ECEF Y"):
        read_reference(written(tmp_path, RTK_REFERENCE.replace("ECEF Y (m)", "Y")))
    with pytest.raises(InputError, match=r"line 2, ECEF X .* must be a number"):
        read_reference(written(tmp_path, RTK_REFERENCE.replace("-3810228.582", "far", 1)))
    with pytest.raises(InputError, match="must hold at least one position"):
        read_reference(written(tmp_path, RTK_REFERENCE.splitlines()[0] + "\n"))


def test_the_nagoya_drive() -> None:
    folder = real("nagoya_drive_rtk")
    solution, truth = read_rtk_solution(folder / "rover_rtk.pos"), read_reference(folder / "reference.csv")
    assert (solution.tow_s.size, truth.tow_s.size) == (2519, 3075)
    assert [(solution.quality == q).sum() for q in (FIXED, FLOAT)] == [1019, 1500]
