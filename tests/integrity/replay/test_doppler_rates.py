"""Range rates of recorded receivers: Doppler observables and changes of carriers give the velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from baselines import AXES, CODES, PLACE, receiver, sky

from lanebound.integrity.positioning.code_solution import solve_ranges
from lanebound.integrity.recorded.rinex_observation import Observations, SystemRows
from lanebound.integrity.replay.differences import carrier_rates, doppler_rates
from lanebound.integrity.replay.service_epochs import epochs_of_receiver
from lanebound.integrity.sky.klobuchar import Klobuchar
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

TABLE = sky(wanted=8)
TIME = np.arange(8.0)
VELOCITY = np.array([6.0, -9.0, 0.5])
NO_IONOSPHERE = Klobuchar((0.0,) * 4, (0.0,) * 4)


def places(time_s: np.ndarray) -> np.ndarray:
    return PLACE + (time_s[:, None] * VELOCITY) @ AXES.T


def with_doppler(noise: float = 0.0) -> Observations:
    """A receiver with Doppler observables, which are the changes of its ranges over a tenth of a second."""
    made = receiver(TABLE, TIME, places(TIME), clock_s=1e-4, seed=1, code_m=1e-9, phase_m=1e-6)
    later, earlier = (
        receiver(TABLE, TIME + s, places(TIME + s), clock_s=1e-4, seed=1, code_m=1e-9) for s in (0.05, -0.05)
    )
    rng, rows = np.random.default_rng(2), {}
    for letter, own in made.rows.items():
        change = (later.rows[letter].value[:, 0] - earlier.rows[letter].value[:, 0]) / 0.1
        hertz = -change / (SPEED_OF_LIGHT_MPS / 1575.42e6) + noise * rng.standard_normal(len(change))
        zero = np.zeros((len(hertz), 1), np.bool_)
        rows[letter] = SystemRows(
            (*CODES[letter], "D1C"), own.epoch, own.satellite, np.column_stack([own.value, hertz]),
            np.hstack([own.lost, zero]), np.hstack([own.half, zero]),
        )  # fmt: skip
    return replace(made, rows=rows)


def test_doppler_observables_give_the_velocity() -> None:
    """Left out: the change of the travel time and of the Earth's turn by the receiver's motion, some 1e-5 of it."""
    observations = with_doppler()
    rates = doppler_rates(observations, {letter: ("1C",) for letter in CODES}, TABLE, places(TIME))
    e = epochs_of_receiver(observations, TABLE, NO_IONOSPHERE)
    assert e.rate_mps is not None
    np.testing.assert_allclose(e.rate_mps, rates, atol=1e-3)  # at code positions, some metres aside
    fit = solve_ranges(e.los_enu, rates, 1.0, rates != 0.0, np.zeros_like(e.system))
    np.testing.assert_allclose(fit.x_m, np.tile(VELOCITY, (8, 1)), atol=1e-3)
    assert np.abs(fit.residual_m).max() < 1e-3


def test_changes_of_carriers_give_the_mean_velocity() -> None:
    observations = receiver(
        TABLE, TIME, places(TIME), clock_s=1e-4, seed=1, code_m=0.3, phase_m=1e-4, slips={(2, 4): 12.0}
    )
    e = epochs_of_receiver(observations, TABLE, NO_IONOSPHERE)
    assert e.rate_mps is None
    codes = solve_ranges(e.los_enu, e.code_m, 1.0, e.tracked, e.system)
    rates = carrier_rates(e.time_s, e.los_enu, e.phase_m, e.lost, e.tracked, codes.x_m)
    assert not rates[0].any()
    assert rates[4, 2] == 0.0  # the receiver says that it lost lock
    assert (rates[1:] != 0.0).sum() == 7 * len(e.system) - 1
    fit = solve_ranges(e.los_enu, rates, 1.0, rates != 0.0, np.zeros_like(e.system))
    np.testing.assert_allclose(fit.x_m[1:], np.tile(VELOCITY, (7, 1)), atol=5e-3)


@pytest.mark.parametrize("gap", [2, 4])
def test_carriers_over_a_long_gap_are_no_rate(gap) -> None:
    time = np.array([0.0, 1.0, 1.0 + gap])
    los = np.tile(np.eye(3)[None], (3, 1, 1))
    phase, there = np.cumsum(np.ones((3, 3)), 0), np.ones((3, 3), np.bool_)
    rates = carrier_rates(time, los, phase, ~there, there, np.zeros((3, 3)))
    assert rates[1].all()
    assert rates[2].any() == (gap <= 2)
