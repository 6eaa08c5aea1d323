"""Against RTKLIB: its program rnx2rtkp (Debian's package rtklib) on the recorded pair, and its LAMBDA and DOP.

The latter by ``pip install pyrtklib==0.2.7``. What is not installed is passed over.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recordings import real
from rtklib_solution import read_solution

from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef
from lanebound.integrity.positioning.least_squares import design_matrix
from lanebound.integrity.replay.baseline_report import read_coordinates, run_baseline
from lanebound.integrity.sky.broadcast import positions, read_navigation
from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, rotated_with_earth
from lanebound.integrity.sky.systems import PRN_BEFORE, System
from plain_ambiguity import integer_least_squares
from plain_least_squares import dilution

Program = Callable[..., Path]
LETTERS = {"G": System.GPS, "E": System.GALILEO, "C": System.BEIDOU, "J": System.QZSS}
GPS, ALL = 1, 57  # RTKLIB's numbers of systems: 57 are GPS, Galileo, QZSS and BeiDou
WEEK_S, TRAVEL_S = 604_800.0, 0.075
PRINTED_DEG = 0.05  # half of the last digit


@pytest.fixture
def rnx2rtkp(tmp_path: Path) -> Program:
    """Runs the program on the recorded pair with options; returns the file of its solutions."""
    found = shutil.which("rnx2rtkp")
    if found is None:
        pytest.skip("RTKLIB's rnx2rtkp is not installed")
    folder = real("rtk_matrtklib_1m_static_30s")

    def run(*arguments: str, files: tuple[str, ...] = ("rover.obs", "base.nav"), **options: object) -> Path:
        settings, out = tmp_path / "options.conf", tmp_path / "found.pos"
        lines = [f"{key.replace('_', '-', 1)} ={value}" for key, value in options.items()]
        settings.write_text("\n".join(["pos1-sateph =brdc", "pos1-ionoopt =brdc", "pos1-tropopt =saas", *lines, ""]))
        command = [found, "-k", str(settings), *arguments, "-o", str(out), *(str(folder / name) for name in files)]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        return out

    return run


def base_place() -> np.ndarray:
    return read_coordinates(str(real("rtk_matrtklib_1m_static_30s") / "base_position.txt"))


def sights(place: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
    """Unit vectors E, N, U to all satellites of the messages that come with the pair."""
    table = read_navigation(real("rtk_matrtklib_1m_static_30s") / "base.nav")
    states = positions(table, np.array([time_s]), TRAVEL_S)
    axes = ecef_from_enu_matrix(*geodetic_from_ecef(place)[:2])
    there = rotated_with_earth(states.position_ecef_m[0], np.full(len(states.satellite), EARTH_RATE_RADPS * TRAVEL_S))
    sight = (there - place) @ axes
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    letters = {system: letter for letter, system in LETTERS.items()}
    return {
        f"{letter}{prn - PRN_BEFORE.get(letter, 0):02d}": sight[k]
        for k, (letter, prn) in enumerate((letters[System(int(system))], prn) for system, prn in states.satellite)
        if states.usable[0, k]
    }


def test_the_fixed_baseline(rnx2rtkp: Program, tmp_path: Path) -> None:
    folder, (x, y, z) = real("rtk_matrtklib_1m_static_30s"), base_place()
    options = {"pos1_posmode": "kinematic", "pos1_frequency": "l1+2", "pos1_elmask": 15, "pos1_navsys": ALL}
    options |= {"pos2_armode": "continuous", "out_solformat": "xyz", "ant2_postype": "xyz"}
    options |= {"ant2_pos1": x, "ant2_pos2": y, "ant2_pos3": z}
    time_s, theirs, quality = read_solution(rnx2rtkp(files=("rover.obs", "base.obs", "base.nav"), **options))
    assert (quality == 1).all()
    run_baseline(folder / "rover.obs", folder / "base.obs", [folder / "base.nav"], tmp_path, base_ecef_m=base_place())
    ours = np.genfromtxt(tmp_path / "solution.csv", delimiter=",", skip_header=1, usecols=(1, 4, 5, 6))
    np.testing.assert_allclose(ours[:, 0] % 86_400.0, time_s)
    assert np.linalg.norm(ours[:, 1:] - theirs, axis=1).max() < 0.015


def test_directions_of_broadcast_satellites(rnx2rtkp: Program) -> None:
    found = rnx2rtkp("-y", "2", pos1_posmode="single", pos1_elmask=5, pos1_navsys=ALL, out_solformat="xyz")
    rows = [line.split(",") for line in Path(f"{found}.stat").read_text().splitlines()]
    first = next(row for row in rows if row[0] == "$POS")
    ours = sights(np.array([float(v) for v in first[4:7]]), WEEK_S * int(first[1]) + float(first[2]))
    systems = set()
    for row in (r for r in rows if r[0] == "$SAT" and r[2] == first[2] and r[3] in ours):
        e, azimuth, elevation = ours[row[3]], float(row[5]), float(row[6])
        off = (np.degrees(np.arctan2(e[0], e[1])) - azimuth + 180.0) % 360.0 - 180.0
        assert abs(off) < PRINTED_DEG + 0.005, row[3]
        assert abs(np.degrees(np.arcsin(e[2])) - elevation) < PRINTED_DEG + 0.005, row[3]
        systems.add(row[3][0])
    assert systems == set(LETTERS)


def test_dilution_of_the_first_epoch(rnx2rtkp: Program) -> None:
    common = {"pos1_posmode": "single", "pos1_elmask": 15, "pos1_navsys": GPS}
    told = rnx2rtkp("-n", **common).read_text().splitlines()
    theirs = float(next(line for line in told if "GGA" in line).split(",")[8])
    stat = Path(f"{rnx2rtkp('-y', '2', **common, out_solformat='xyz')}.stat").read_text().splitlines()
    first = next(line for line in stat if line.startswith("$POS")).split(",")
    used = [
        row[3]
        for row in (line.split(",") for line in stat)
        if row[0] == "$SAT" and row[2] == first[2] and row[3][0] == "G"
    ]
    ours = sights(np.array([float(v) for v in first[4:7]]), WEEK_S * int(first[1]) + float(first[2]))
    los = np.array([ours[name] for name in used])
    high = los[:, 2] > np.sin(np.deg2rad(15.0))
    design = design_matrix(los[high], np.zeros(int(high.sum()), np.int64), 1)
    assert float(dilution(design, np.eye(len(design))).hdop) == pytest.approx(theirs, abs=0.05)


@pytest.mark.parametrize("n", [2, 5, 9, 14, 20])
def test_integer_least_squares(n: int) -> None:
    library = pytest.importorskip("pyrtklib", reason="RTKLIB's library is not installed")
    search = getattr(library, "lambda")
    rng = np.random.default_rng(n)
    for _ in range(20):
        root = rng.standard_normal((n, n))
        covariance, real_valued = 0.1 * (root @ root.T) + 0.01 * np.eye(n), rng.uniform(-50.0, 50.0, n)
        a, q = library.Arr1Ddouble(n), library.Arr1Ddouble(n * n)
        best, norms = library.Arr1Ddouble(2 * n), library.Arr1Ddouble(2)
        for i in range(n):
            a[i] = real_valued[i]
            for j in range(n):
                q[i + n * j] = covariance[i, j]
        assert search(n, 2, a, q, best, norms) == 0
        ours = integer_least_squares(real_valued, covariance)
        np.testing.assert_array_equal(ours.candidates[0], np.rint([best[i] for i in range(n)]))
        np.testing.assert_array_equal(ours.candidates[1], np.rint([best[n + i] for i in range(n)]))
        np.testing.assert_allclose(ours.norms, [norms[0], norms[1]], rtol=1e-6)


@pytest.mark.parametrize("n", [4, 8, 20])
def test_dilution_of_precision(n: int) -> None:
    library = pytest.importorskip("pyrtklib", reason="RTKLIB's library is not installed")
    rng = np.random.default_rng(n)
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi, n), np.arcsin(rng.uniform(0.2, 1.0, n))
    directions, theirs = library.Arr1Ddouble(2 * n), library.Arr1Ddouble(4)
    for i in range(n):
        directions[2 * i], directions[2 * i + 1] = azimuth[i], elevation[i]
    library.dops(n, directions, 0.0, theirs)
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    ours = dilution(design_matrix(los, np.zeros(n, np.int64), 1), np.eye(n))
    assert float(ours.pdop) == pytest.approx(theirs[1], rel=1e-9)
    assert float(ours.hdop) == pytest.approx(theirs[2], rel=1e-9)
