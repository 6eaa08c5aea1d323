"""comma2k19 segments, whole, cut and damaged."""

from __future__ import annotations

import pickle
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import comma_folder, real, survives

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.comma import read_comma, read_rows


def test_a_small_segment(tmp_path: Path) -> None:
    segment = read_comma(comma_folder(tmp_path))
    assert segment.fixes is None
    assert segment.reference.position_ecef_m.shape == (8, 3)
    assert segment.speed.at(np.array([0.02]))[0] == 8.0
    assert segment.wheel_speed.at(np.array([0.0, 0.1])).shape == (2, 4)
    expected = np.random.default_rng(1).normal(size=(8, 3))  # stored column by column
    np.testing.assert_array_equal(segment.acceleration.value, expected)


def test_files_without_ending_as_published(tmp_path: Path) -> None:
    for path in comma_folder(tmp_path).rglob("*.npy"):
        path.rename(path.with_suffix(""))
    assert read_comma(tmp_path).reference.time_s.size == 8


def test_a_cut_array_is_refused(tmp_path: Path) -> None:
    path = comma_folder(tmp_path) / "global_pose/frame_positions.npy"
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match=r"frame_positions\.npy must be a complete NumPy array file \(\.npy\), got: "):
        read_comma(tmp_path)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((8, 4)), "must have shape"),
        (np.array([[np.nan] * 3]), "must be finite"),
        (np.zeros((8, 3), complex), "must hold real numbers, got complex128: save them as float64"),
        (np.zeros((0, 3)), "must hold at least one row"),
    ],
)
def test_wrong_arrays_are_named(tmp_path: Path, array: np.ndarray, message: str) -> None:
    np.save(comma_folder(tmp_path) / "global_pose/frame_positions.npy", array)
    with pytest.raises(InputError, match=rf"frame_positions\S* .*{message}"):
        read_comma(tmp_path)


def test_pickles_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="must be a complete NumPy array file"):
        read_rows(tmp_path / "a.npy", None)
    (tmp_path / "b.npy").write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(InputError, match="must be a complete NumPy array file"):
        read_rows(tmp_path / "b.npy", None)
    np.savez(tmp_path / "c.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="must hold real numbers, got NpzFile"):
        read_rows(tmp_path / "c.npz", None)


def test_one_column_counts_as_rows_and_whole_numbers_are_read(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.arange(3, dtype=">i2")[:, None])
    np.testing.assert_array_equal(read_rows(tmp_path / "a.npy", None), [0.0, 1.0, 2.0])
    with pytest.raises(InputError, match="must have at most 100 bytes, has"):
        read_rows(tmp_path / "a.npy", None, max_bytes=100)


def test_missing_parts_and_disorder_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="frame_times"):
        read_comma(tmp_path)
    np.save(comma_folder(tmp_path) / "global_pose/frame_times.npy", np.zeros(8))
    with pytest.raises(InputError, match="7 of 8 rows repeat a time with other values, row 2"):
        read_comma(tmp_path)


@pytest.mark.parametrize("name", ["IMU/gyro/value", "CAN/speed/t", "global_pose/frame_velocities"])
def test_arrays_of_unequal_length_are_refused_with_both(tmp_path: Path, name: str) -> None:
    path = comma_folder(tmp_path) / f"{name}.npy"
    np.save(path, np.load(path)[:-2])
    with pytest.raises(InputError, match=r"must have as many rows as each other, got (8 and 6|6 and 8): one .* is cut"):
        read_comma(tmp_path)


def test_a_header_that_promises_too_much_costs_nothing(tmp_path: Path) -> None:
    head = np.lib.format.magic(1, 0)
    text = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117) + "\n"
    (tmp_path / "a.npy").write_bytes(head + len(text).to_bytes(2, "little") + text.encode() + b"\0" * 24)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="must be a complete NumPy array file"):
            read_rows(tmp_path / "a.npy", None)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()


@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_damage_hangs_or_crashes(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.arange(30.0).reshape(10, 3))
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw)))
        raw[at : at + data.draw(st.integers(0, 30))] = data.draw(st.binary(max_size=30))
    path.write_bytes(bytes(raw))
    survives(lambda: read_rows(path, 3))


def test_the_highway_segment() -> None:
    segment = read_comma(real("comma2k19_segment40"))
    assert segment.reference.time_s.size == 1200
    assert segment.speed.time_s.size == 4974
    assert segment.fixes is not None
    assert segment.fixes.time_s.size == 579
