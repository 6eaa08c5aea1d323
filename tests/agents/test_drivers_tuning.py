"""The cautious driver's margins are as much care as it takes to do no more harm, found on training seeds alone."""

from __future__ import annotations

from typing import Any

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.drivers import tuning
from lanebound.agents.drivers.tuning import Measured, cautious_at, tune_cautious
from lanebound.integrity.errors import InputError


def test_caution_slows_and_widens():
    assert cautious_at(0.0).speed_share == 1.0
    assert cautious_at(0.0).gap_m == 0.0
    assert cautious_at(1.0).speed_share == pytest.approx(0.3)
    assert cautious_at(1.0).gap_m == 10.0


@pytest.mark.parametrize(("harm", "caution"), [(0.5, 0.5), (0.3, 0.75), (0.0, 1.0)])
def test_the_least_caution_with_no_more_harm_is_found(monkeypatch, harm, caution):
    """Harm falls with the speed: 1 - caution, against a goal."""

    def measured(env: Any, agent: Any, seeds: Any, tell: Any) -> Measured:
        share = getattr(agent.plan.config, "speed_share", None)
        value = harm if share is None else 1.0 - (1.0 - share) / 0.7
        return Measured(value, 0.0, 0.0, value, 5.0, len(seeds))

    monkeypatch.setattr(tuning, "measure", measured)
    found = tune_cautious("CarFollowing", "open", range(1000, 1002), halvings=2)
    assert found["caution"] == caution
    assert found["matched"] == (caution < 1.0)
    assert len(found["tried"]) == 2


def test_seeds_kept_for_tests_are_refused():
    with pytest.raises(InputError, match="others are kept for tests"):
        tune_cautious("CarFollowing", "open", range(10_000, 10_002))
    result = CliRunner().invoke(app, ["tune", "cautious", "CarFollowing", "--first-seed", "1999", "--seeds", "2"])
    assert result.exit_code != 0
