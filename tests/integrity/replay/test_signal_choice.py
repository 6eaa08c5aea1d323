"""Signals that two receivers share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from baselines import PLACE, receiver, sky

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.replay.baseline import entries_of
from lanebound.integrity.replay.differences import arc_of
from lanebound.integrity.replay.signal_choice import choose_signals, strength_dbhz
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System


def renamed(observations: Observations, names: dict[str, tuple[str, ...]]) -> Observations:
    rows = {letter: replace(observations.rows[letter], codes=codes) for letter, codes in names.items()}
    return replace(observations, rows=rows)


@pytest.fixture(scope="module")
def one() -> Observations:
    return receiver(sky(), np.arange(3.0), np.tile(PLACE, (3, 1)), clock_s=0.0, seed=1)


def test_two_bands_of_each_system(one: Observations) -> None:
    choice = choose_signals(one, one)
    assert choice.bands == 2
    assert choice.rover == choice.base == {"G": ("1C", "2W"), "E": ("1C", "5Q")}
    assert choice.wavelength_m[System.GALILEO, 1] == pytest.approx(SPEED_OF_LIGHT_MPS / 1176.45e6)


def test_receivers_may_track_a_band_differently(one: Observations) -> None:
    other = renamed(one, {"G": ("C1C", "L1C", "S1C", "C2L", "L2L", "S2L"), "E": one.rows["E"].codes})
    choice = choose_signals(one, other)
    assert (choice.rover["G"], choice.base["G"]) == (("1C", "2W"), ("1C", "2L"))


def test_one_band_where_there_is_no_second(one: Observations) -> None:
    single = renamed(one, {"G": ("C1C", "L1C", "S1C", "C5X", "D5X", "S5X")})
    choice = choose_signals(single, one)
    assert (choice.bands, choice.rover) == (1, {"G": ("1C",)})
    assert choose_signals(one, one, 1).rover == {"G": ("1C",), "E": ("1C",)}


def test_nothing_in_common_is_told(one: Observations) -> None:
    glonass = replace(one, rows={"R": one.rows["G"]})
    with pytest.raises(InputError, match="must share a band of G, E, C, J"):
        choose_signals(glonass, one)


def beidou(one: Observations, version: float, *names: str) -> Observations:
    """The GPS rows as BeiDou's of two bands, in a file of a version."""
    codes = tuple(f"{kind}{name}" for name in names for kind in "CLS")
    header = replace(one.header, version=version, codes={"C": codes})
    return replace(one, header=header, rows={"C": replace(one.rows["G"], codes=codes)})


def test_b1i_and_b1c_of_beidou_have_frequencies_of_their_own(one: Observations) -> None:
    new = beidou(one, 3.04, "2I", "1P")
    choice = choose_signals(new, new)
    assert choice.rover == {"C": ("2I", "1P")}
    np.testing.assert_allclose(
        choice.wavelength_m[System.BEIDOU, :2], SPEED_OF_LIGHT_MPS / np.array([1561.098e6, 1575.42e6]), rtol=1e-12
    )


@pytest.mark.parametrize(("version", "names"), [(3.03, ("2I",)), (3.04, ("2I", "1X")), (4.0, ("2I", "1X"))])
def test_1x_is_b1c_only_in_versions_that_say_so(one: Observations, version: float, names: tuple[str, ...]) -> None:
    found = beidou(one, version, "2I", "1X")
    assert choose_signals(found, found).rover == {"C": names}


def test_phases_that_are_missing_do_not_count(one: Observations) -> None:
    rows = one.rows["G"]
    value = rows.value.copy()
    value[:, 4] = 0.0  # L2W never there
    bare = replace(one, rows={"G": replace(rows, value=value)})
    assert choose_signals(bare, one).rover == {"G": ("1C",)}
    assert np.count_nonzero(bare.rows["G"].column("L2W")) == 0


def with_second(one: Observations, strength: dict[str, float], prns: dict[str, list[int]]) -> Observations:
    """GPS rows with L1 and further codes of the second band, of these strengths, for these satellites."""
    rows = one.rows["G"]
    codes, columns = ["C1C", "L1C", "S1C"], [rows.value[:, :3]]
    for name, cn0 in strength.items():
        tracked = np.isin(rows.satellite, prns[name])[:, None]
        codes += [f"C{name}", f"L{name}", f"S{name}"]
        columns.append(np.where(tracked, [2e7, 8e7, cn0], 0.0))
    value = np.concatenate(columns, axis=1)
    none = np.zeros(value.shape, np.bool_)
    return replace(one, rows={"G": replace(rows, codes=tuple(codes), value=value, lost=none, half=none)})


def test_a_strong_signal_of_fewer_satellites_comes_before_a_weak_one(one: Observations) -> None:
    """Semi-codeless L2W of every satellite at 20 dB-Hz, L2L of all but one at 45."""
    prns = np.unique(one.rows["G"].satellite).tolist()
    found = with_second(one, {"2W": 20.0, "2L": 45.0}, {"2W": prns, "2L": prns[1:]})
    assert choose_signals(found, found, cn0_min_dbhz=30.0).rover == {"G": ("1C", "2L")}
    strong = with_second(one, {"2W": 44.0, "2L": 45.0}, {"2W": prns, "2L": prns[3:]})
    assert choose_signals(strong, strong, cn0_min_dbhz=30.0).rover == {"G": ("1C", "2W")}


def test_the_weaker_receiver_decides(one: Observations) -> None:
    prns = np.unique(one.rows["G"].satellite).tolist()
    both = {"2W": prns, "5Q": prns}
    rover, base = with_second(one, {"2W": 40.0, "5Q": 50.0}, both), with_second(one, {"2W": 40.0, "5Q": 25.0}, both)
    assert choose_signals(rover, base, cn0_min_dbhz=30.0).rover == {"G": ("1C", "2W")}


def test_two_near_bands_are_worth_less_than_two_far_ones(one: Observations) -> None:
    rows = one.rows["E"]
    value = np.concatenate([rows.value[:, :3] * [1, 1, 38 / 45], rows.value[:, 3:], rows.value[:, 3:]], axis=1)
    codes = ("C1C", "L1C", "S1C", "C5Q", "L5Q", "S5Q", "C7Q", "L7Q", "S7Q")
    none = np.zeros(value.shape, np.bool_)
    found = replace(one, rows={"E": replace(rows, codes=codes, value=value, lost=none, half=none)})
    assert choose_signals(found, found, 2).rover == {"E": ("1C", "5Q")}
    choice = choose_signals(found, found)  # the third band comes after them, with a clock of its own
    assert (choice.rover, choice.bands) == ({"E": ("1C", "5Q", "7Q")}, 3)
    assert len(set(choice.clock[System.GALILEO, :3].tolist())) == 3


def test_satellites_without_the_civil_code_have_the_other_one_with_its_own_clock(one: Observations) -> None:
    prns = np.unique(one.rows["G"].satellite).tolist()
    found = with_second(one, {"2W": 34.0, "2L": 45.0}, {"2W": prns, "2L": prns[2:]})
    choice = choose_signals(found, found, cn0_min_dbhz=30.0)
    assert choice.rover == {"G": ("1C", "2L", "2W")}
    assert (choice.bands, len(set(choice.clock[System.GPS, :3].tolist()))) == (2, 3)
    assert choice.wavelength_m[System.GPS, 1] == choice.wavelength_m[System.GPS, 2]
    table = sky()
    arcs = [arc_of(found, choice.rover, choice, table) for _ in range(2)]
    entries = entries_of(choice, *arcs, table.satellites, 30.0)
    second = {int(table.satellites[s, 1]): int(c) for s, c in zip(entries.satellite, entries.column, strict=True) if c}
    assert second == {prn: 2 if prn in prns[:2] else 1 for prn in prns}
    assert (entries.column[entries.host] == 0).all()
    assert (entries.satellite[entries.host] == entries.satellite).all()


def test_no_more_clocks_are_used_than_there_are(one: Observations) -> None:
    rows = one.rows["G"]
    names = {"G": ("1C", "2L", "5Q"), "E": ("1C", "5Q", "7Q"), "C": ("2I", "7I", "6I"), "J": ("1C", "2L", "5Q")}
    value = np.concatenate([rows.value[:, :3]] * 3, axis=1)
    none = np.zeros(value.shape, np.bool_)
    full = {
        letter: replace(rows, codes=tuple(f"{k}{n}" for n in codes for k in "CLS"), value=value, lost=none, half=none)
        for letter, codes in names.items()
    }
    choice = choose_signals(replace(one, rows=full), replace(one, rows=full))
    assert sum(len(codes) for codes in choice.rover.values()) == MAX_GROUPS
    used = [
        choice.clock[System(s), c]
        for s, n in ((0, "G"), (1, "E"), (3, "C"), (4, "J"))
        for c in range(len(choice.rover[n]))
    ]
    assert len(set(used)) == len(used)


def test_strengths_of_1_to_9_are_indicators(one: Observations) -> None:
    """Level n begins at 6 n dB-Hz; files of C/N0 are as they are."""
    rows = one.rows["G"]
    column = rows.codes.index("S1C")
    for written, read in ((7.0, 42.0), (9.0, 54.0), (10.0, 10.0), (45.0, 45.0), (0.0, 0.0)):
        value = rows.value.copy()
        value[:, column] = written
        assert set(strength_dbhz(replace(rows, value=value), "1C")) == {read}
