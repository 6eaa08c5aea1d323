"""Declared changes of carriers against the process that is simulated."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.family.weighting import CodeBudget
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.sensors.broadcast import BroadcastConfig, change_rate, initial_broadcast, obliquity

STEP_S, COAST_S = 0.5, 30.0
LOW = np.radians(30.0)


def test_clocks_change_by_a_millimetre_in_half_a_second() -> None:
    errors = {"satellite_m": 1.1, "iono_zenith_m": 0.0, "tropo_zenith_m": 0.0}
    clock = CodeBudget(errors=CodeErrorBudget(**errors), carrier_m=0.0, coast_s=0.0)
    assert clock.carrier_step(LOW, STEP_S) == pytest.approx(1.1 * 2.146 / 1800.0 * 0.5, rel=1e-3)
    ionosphere = clock.replace(errors={"satellite_m": 0.0, "iono_zenith_m": 2.5, "iono_common": 0.0})
    assert ionosphere.carrier_step(LOW, STEP_S) == pytest.approx(
        2.5 * obliquity(np.sin(LOW)) * change_rate(1800.0) * STEP_S
    )


def test_steps_declared_cover_a_step_and_a_coast_of_the_simulated_process() -> None:
    """400 areas of 25 satellites: variances of changes over one step and over a coast, as monitors add them up."""
    config, streams = BroadcastConfig(), Streams(np.arange(400))
    state, common = initial_broadcast(25, streams), np.sqrt(config.iono_common)

    def slant() -> np.ndarray:
        alike, ionosphere = config.delays(state, np.full((400, 25), np.sin(LOW)), np.arange(400))
        zenith = config.tropo_zenith_m * state.common[:, 1:] - config.iono_zenith_m * common * state.common[:, :1]
        return alike - ionosphere - zenith  # of carriers, less what the clocks take of the common errors

    first = slant()
    config.advance(state, STEP_S, streams)
    step = slant() - first
    config.advance(state, COAST_S - STEP_S, streams)
    coast = slant() - first
    budget = CodeBudget(carrier_m=0.0)
    declared = float(budget.carrier_step(LOW, STEP_S))
    steps = COAST_S / STEP_S
    assert 1e-4 < step.std() < 0.004 < declared
    assert 0.4 * declared * np.sqrt(steps) < coast.std() < declared * np.sqrt(steps)
    assert coast.std() > 5.0 * step.std() * np.sqrt(steps)  # steps are alike: they do not add up as noise
