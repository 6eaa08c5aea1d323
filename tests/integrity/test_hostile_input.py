"""Damaged almanacs, meshes, navigation files and configurations: read or refused with a message, never anything else.

Warnings are errors here, an example has seconds at most, and the long form counts memory.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from navigation_texts import GPS_RECORD, HEADER

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import parse_assignments, parse_yaml
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sky import almanac as almanac_room
from lanebound.integrity.sky import city as mesh_room
from lanebound.integrity.sky import rinex_navigation
from lanebound.integrity.sky.almanac import parse_yuma, read_yuma
from lanebound.integrity.sky.city import city_from_mesh
from lanebound.integrity.sky.rinex_navigation import parse_navigation, read_navigation

ALMANAC = """\
******** Week 38 almanac for PRN-01 ********
ID:                         01
Health:                     000
Eccentricity:               0.9E-002
Time of Applicability(s):   40000.0000
Orbital Inclination(rad):   0.97
Rate of Right Ascen(r/s):   -0.8E-008
SQRT(A)  (m 1/2):           5153.6
Right Ascen at Week(rad):   0.5
Argument of Perigee(rad):   0.25
Mean Anom(rad):             -0.125
Af0(s):                     -0.1E-004
Af1(s/s):                   0
week:                       38
"""
NAVIGATION = HEADER + GPS_RECORD + GPS_RECORD.replace("G04", "E11")
YAML = "dt_s: 0.1\nrisk:\n  integrity_risk: 1.0e-5\n  satellite_prior: [1.0e-5, 1.0e-5, 1.0e-4, 1.0e-5, 1.0e-5]\n"
LETTERS = "0123456789.eEdD+-: \n\t#[]{}&*!|>'\"%@`\\\x00\u2028GERCinfa"
GIBIBYTE = 2**30
QUICK = settings(max_examples=60, deadline=4000, suppress_health_check=[HealthCheck.function_scoped_fixture])
LONG = settings(max_examples=20_000, deadline=4000, suppress_health_check=list(HealthCheck))


@st.composite
def damaged(draw: Callable[..., object], text: str) -> str:
    """A text with up to eight places cut out, doubled or written over."""
    for _ in range(draw(st.integers(1, 8))):  # type: ignore[call-overload]
        at, length = draw(st.integers(0, len(text))), draw(st.integers(0, 40))
        put = draw(st.one_of(st.text(LETTERS, max_size=20), st.just(text[at : at + length] * 2), st.just("")))
        text = text[:at] + put + text[at + length :]  # type: ignore[operator,index]
    return text


@st.composite
def damaged_bytes(draw: Callable[..., object], data: bytes) -> bytes:
    """The same of bytes, numbers of counts and offsets among them."""
    for _ in range(draw(st.integers(1, 6))):  # type: ignore[call-overload]
        at, length = draw(st.integers(0, len(data))), draw(st.integers(0, 16))
        put = draw(st.one_of(st.binary(max_size=8), st.just(b"\xff" * 4), st.just(b"999999999"), st.just(b"")))
        data = data[:at] + put + data[at + length :]  # type: ignore[operator,index]
    return data


def refused_or(read: Callable[[], object]) -> str | None:
    """The message of a refusal, None where the thing was read; anything else fails the test."""
    try:
        read()
    except InputError as refusal:
        return str(refusal)
    return None


def almanac(text: str) -> None:
    message = refused_or(lambda: parse_yuma(text, date(2020, 1, 3)))
    assert message is None or "almanac" in message


def navigation(text: str) -> None:
    message = refused_or(lambda: parse_navigation(text))
    assert message is None or "navigation file" in message


def configuration(text: str) -> None:
    def read() -> None:
        data = parse_yaml(text, "text")
        NavigatorConfig.load(data if isinstance(data, dict) else {"risk": data})

    message = refused_or(read)
    assert message is None or len(message) > 10


def json_configuration(text: str) -> None:
    message = refused_or(lambda: RiskConfig.from_json(text))
    assert message is None or len(message) > 10


def assignment(text: str) -> None:
    message = refused_or(lambda: NavigatorConfig.build(None, parse_assignments([text])))
    assert message is None or len(message) > 10


def mesh_bytes(suffix: str) -> bytes:
    return (
        bytes(trimesh.creation.box(extents=(10.0, 6.0, 8.0)).export(file_type=suffix))
        if suffix != "obj"
        else (trimesh.creation.box(extents=(10.0, 6.0, 8.0)).export(file_type="obj").encode())
    )


def mesh(folder: Path, suffix: str, data: bytes) -> None:
    file = folder / f"house.{suffix}"
    file.write_bytes(data)
    found = []
    message = refused_or(lambda: found.append(city_from_mesh(file)))
    assert message is None or "mesh" in message
    if found:
        assert np.isfinite(found[0].triangles_enu_m).all()


@QUICK
@given(damaged(ALMANAC + ALMANAC.replace("01", "02")))
def test_almanacs(text: str) -> None:
    almanac(text)


@QUICK
@given(damaged(NAVIGATION))
def test_navigation_files(text: str) -> None:
    navigation(text)


@QUICK
@given(damaged(YAML))
def test_configurations(text: str) -> None:
    configuration(text)


@QUICK
@given(damaged(RiskConfig().to_json()))
def test_configurations_as_json(text: str) -> None:
    json_configuration(text)


@QUICK
@given(damaged("risk.integrity_risk=1e-6"))
def test_assignments(text: str) -> None:
    assignment(text)


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb", "stl"])
@QUICK
@given(data=st.data())
def test_meshes(tmp_path: Path, suffix: str, data: st.DataObject) -> None:
    mesh(tmp_path, suffix, data.draw(damaged_bytes(mesh_bytes(suffix))))


@pytest.mark.parametrize("count", [10**7, 10**9, 10**15])
def test_a_mesh_that_promises_much_takes_no_memory(tmp_path: Path, count: int) -> None:
    before = memory_bytes()
    text = mesh_bytes("ply")
    mesh(tmp_path, "ply", text.replace(b"element vertex 8", f"element vertex {count}".encode()))
    stl = mesh_bytes("stl")
    mesh(tmp_path, "stl", stl[:80] + min(count, 2**32 - 1).to_bytes(4, "little") + stl[84:])
    assert memory_bytes() - before < GIBIBYTE


def test_nesting_without_end_is_refused() -> None:
    for text in ("[" * 5000, "a: " * 5000, "{a: " * 5000, "&a [*a]", "a: &b {c: *b}"):
        configuration(text)
        json_configuration(text)
    with pytest.raises(ConfigError):
        RiskConfig.from_json("[" * 100_000)


def test_a_billion_values_from_few_aliases_are_refused() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    with pytest.raises(ConfigError, match="at most 20000 values"):
        parse_yaml("\n".join(lines), "the text")
    many = f"a: &a [{', '.join(['1'] * 3000)}]\nb: [{', '.join(['*a'] * 3000)}]"
    with pytest.raises(ConfigError, match="at most 20000 values"):
        parse_yaml(many, "the text")
    with pytest.raises(ConfigError, match="at most 50 levels"):
        parse_yaml("&a [*a]", "the text")


def memory_bytes() -> int:
    """The most memory that this process has had."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@pytest.mark.parametrize(
    ("name", "most", "read"),
    [
        ("city.ply", mesh_room.LARGEST_BYTES, city_from_mesh),
        ("base.nav", rinex_navigation.LARGEST_BYTES, read_navigation),
        ("yuma.txt", almanac_room.LARGEST_BYTES, lambda path: read_yuma(path, date(2020, 1, 3))),
    ],
)
def test_files_that_would_fill_the_memory_are_refused(
    tmp_path: Path, name: str, most: int, read: Callable[[Path], object]
) -> None:
    file, before = tmp_path / name, memory_bytes()
    with file.open("wb") as stream:
        stream.truncate(most + 1)
    with pytest.raises(InputError, match=f"at most {most} bytes"):
        read(file)
    assert memory_bytes() - before < GIBIBYTE // 16


@pytest.mark.parametrize("suffix", ["ply", "glb", "stl"])
def test_meshes_cut_short_are_refused_wherever_the_cut_is(tmp_path: Path, suffix: str) -> None:
    """OBJ has no counts: there a cut between two lines cannot be told."""
    whole = mesh_bytes(suffix)
    for length in range(1, len(whole) - 1, 7):
        file = tmp_path / f"house.{suffix}"
        file.write_bytes(whole[:length])
        with pytest.raises(InputError, match="mesh"):
            city_from_mesh(file)


@pytest.fixture
def within_a_gibibyte() -> Iterator[None]:
    """The test takes no more memory at any moment than was taken before it, and 1 GiB."""
    before = memory_bytes()
    yield
    assert memory_bytes() - before < GIBIBYTE


@pytest.mark.slow
@pytest.mark.usefixtures("within_a_gibibyte")
class TestAtLength:
    """A hundred thousand damaged inputs of all kinds; each has 4 s."""

    @LONG
    @given(damaged(ALMANAC + ALMANAC.replace("01", "02")))
    def test_almanacs(self, text: str) -> None:
        almanac(text)

    @LONG
    @given(damaged(NAVIGATION))
    def test_navigation_files(self, text: str) -> None:
        navigation(text)

    @LONG
    @given(damaged(YAML))
    def test_configurations(self, text: str) -> None:
        configuration(text)

    @LONG
    @given(damaged(RiskConfig().to_json()))
    def test_configurations_as_json(self, text: str) -> None:
        json_configuration(text)

    @pytest.mark.parametrize("suffix", ["obj", "ply", "glb", "stl"])
    @settings(LONG, max_examples=5000)
    @given(data=st.data())
    def test_meshes(self, tmp_path: Path, suffix: str, data: st.DataObject) -> None:
        mesh(tmp_path, suffix, data.draw(damaged_bytes(mesh_bytes(suffix))))

    def test_the_largest_navigation_file(self) -> None:
        text = HEADER + GPS_RECORD * ((rinex_navigation.LARGEST_BYTES - len(HEADER)) // len(GPS_RECORD))
        assert len(parse_navigation(text)) > 100_000
