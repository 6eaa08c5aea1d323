"""A column of the logs of episodes from outside, tests/plugins/headway_column.py, which docs/extending.md shows."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.agents.episodes.columns import COLUMNS, Column, Moment, _is_of, columns, register_column, withdraw_column
from lanebound.integrity.core.errors import InputError


def test_a_column_is_logged() -> None:
    module = importlib.import_module("headway_column")
    try:
        assert columns() == (*COLUMNS, columns()[-1])
        env, log = open_env("CarFollowing", {"sky": "open", "duration_s": 2.0}, None), EpisodeLog()
        drive(env, make_agent("cruise", env), [1], [log])
        env.close()
        table = log.to_table()
        assert table.schema.field("headway_s").metadata[b"unit"] == b"s"
        found, gap = (table[name].to_numpy() for name in ("headway_s", "gap_m"))
        assert (found > 0.0).all()
        near = gap < 100.0
        np.testing.assert_allclose((found * table["speed_mps"].to_numpy())[near], gap[near])
        with pytest.raises(InputError, match="name of a column must not be taken, got 'headway_s'"):
            register_column(columns()[-1])
    finally:
        withdraw_column("headway_s")
    assert columns() == COLUMNS
    assert module.headway_s
    with pytest.raises(InputError, match="column must be a registered one, got 'headway_s': none are known"):
        withdraw_column("headway_s")


@pytest.mark.parametrize(
    ("take", "message"),
    [
        (lambda m: m.info["nope"], "must return a value, got KeyError: 'nope' at seed 1, step 0: correct the function"),
        (lambda m: "fast", "must return a value of kind float, got 'fast' at seed 1, step 0: convert it, or declare"),
        (lambda m: True, "must return a value of kind float, got True at seed 1, step 0"),
    ],
)
def test_a_column_whose_function_fails_is_named(take: Callable[[Moment], Any], message: str) -> None:
    register_column(Column("mine", "float", "", "a column with a mistake", take))
    env = open_env("LaneKeeping", {"sky": "open", "duration_s": 1.0}, None)
    try:
        with pytest.raises(InputError, match=f"^the function of column 'mine' {message}"):
            drive(env, make_agent("nominal", env), [1], [EpisodeLog()])
    finally:
        env.close()


def test_values_of_a_list_column_are_checked_one_by_one() -> None:
    good, bad = ([1.0, 2], np.zeros(2), ()), (3.0, "12", [True], ["a"], None)
    assert all(_is_of(value, "floats") for value in good)
    assert not any(_is_of(value, "floats") for value in bad)


def test_a_column_of_an_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match=r"kind of column 'mine' must be one of int, .*, got 'flt': known are"):
        register_column(Column("mine", "flt", "", "", lambda m: 0.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="take of column 'mine' must be a function of a Moment, got 'speed_mps'"):
        register_column(Column("mine", "float", "", "", "speed_mps"))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="name of a column must be an identifier, got 'my speed'"):
        register_column(Column("my speed", "float", "", "", lambda m: 0.0))
