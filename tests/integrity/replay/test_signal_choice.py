"""Signals that two receivers share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from baselines import PLACE, receiver, sky

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.replay.signal_choice import choose_signals
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
        choice.wavelength_m[System.BEIDOU], SPEED_OF_LIGHT_MPS / np.array([1561.098e6, 1575.42e6]), rtol=1e-12
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
