"""A column of the logs of episodes from outside, tests/plugins/headway_column.py, which docs/extending.md shows."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.agents.episodes.columns import COLUMNS, columns, register_column, withdraw_column
from lanebound.integrity.core.errors import InputError


def _load(name: str) -> ModuleType:
    """Import a plug-in anew, as a first import does."""
    sys.modules.pop(name, None)
    return importlib.import_module(name)


def test_a_column_is_logged() -> None:
    module = _load("headway_column")
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
