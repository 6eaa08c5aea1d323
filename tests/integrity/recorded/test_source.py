"""Lines of hostile files."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import Lines, finite_number, whole_number
from lanebound.integrity.sky.rinex_navigation import read_navigation


def test_plain_and_compressed_lines_are_the_same(tmp_path: Path) -> None:
    text = b"one\r\ntwo\n\nfour\n"
    (tmp_path / "a").write_bytes(text)
    (tmp_path / "b").write_bytes(gzip.compress(text))
    for name in "ab":
        lines = Lines(tmp_path / name)
        assert list(lines) == ["one", "two", "", "four"]
        assert lines.number == 4
        assert lines.stop is None


def test_a_last_line_without_end_is_doubted(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"one\ntw")
    lines = Lines(tmp_path / "a")
    assert list(lines) == ["one"]
    assert lines.stop is not None
    assert lines.stop.line == 2


def test_a_cut_compressed_file_gives_what_was_read(tmp_path: Path) -> None:
    import random

    rng = random.Random(0)
    text = "".join(f"{rng.random()}\n" for _ in range(20_000)).encode()
    packed = gzip.compress(text)
    (tmp_path / "a").write_bytes(packed[: len(packed) // 2])
    lines = Lines(tmp_path / "a")
    found = list(lines)
    assert 5_000 < len(found) < 15_000
    assert found == text.decode().splitlines()[: len(found)]
    assert lines.stop is not None
    assert "is damaged" in str(lines.stop)


def test_a_file_that_unpacks_to_gigabytes_is_refused_early(tmp_path: Path) -> None:
    (tmp_path / "bomb").write_bytes(gzip.compress(b"0123456789\n" * 2_000_000))
    with pytest.raises(InputError, match="at most 1000000 bytes"):
        list(Lines(tmp_path / "bomb", max_bytes=1_000_000))


def test_an_endless_line_ends_reading(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"one\n" + b"x" * 1_000_000)
    lines = Lines(tmp_path / "a")
    assert list(lines) == ["one"]
    assert "longer than" in str(lines.stop)


def test_a_folder_or_nothing_is_named(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match="must be a readable file"):
            list(Lines(path))


@pytest.mark.parametrize("text", ["nan", "inf", "1e999", "x", "", "2.5", "11", "1_0 0"])
def test_numbers_are_refused_with_what_was_expected(text: str) -> None:
    with pytest.raises(ValueError, match="must"):
        whole_number(text, 0, 10)


def test_numbers_within_bounds() -> None:
    assert whole_number(" 7", 0, 10) == 7
    assert finite_number("1e-3 ") == 1e-3


@pytest.mark.parametrize(("start", "what", "program"), [
    (b"\x1f\x9d\x90", r"compressed by compress \(\.Z\)", "gzip -d"), (b"PK\x03\x04", "a zip archive", "unzip"),
    (b"BZh9", "compressed by bzip2", "bzip2 -d"), (b"\xfd7zXZ\0", "compressed by xz", "xz -d"),
    ("\ufeffa".encode("utf-16-le"), "UTF-16 text", "iconv"),
])  # fmt: skip
def test_other_packings_are_named_with_what_unpacks_them(tmp_path: Path, start: bytes, what: str, program: str) -> None:
    path = tmp_path / "file.obs"
    path.write_bytes(start + bytes(200))
    for read in (lambda: list(Lines(path)), lambda: read_navigation(path)):
        with pytest.raises(InputError, match=f"must be plain text or gzip, is {what}: unpack it with '{program}"):
            read()
