"""The filter of conventional users: the single-epoch solution as its limit, batch least squares, slips and motion."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.assessment.conventional_rtk import (
    ConventionalRtkConfig,
    KinematicConfig,
    KinematicFilter,
    RtkOutcome,
    RtkSignals,
    solve_epoch,
)
from tests.helpers.rtk_signals import TRUE_M, signals

CONFIG = ConventionalRtkConfig()
EPOCH = KinematicConfig(ambiguities="instantaneous", dynamics=False)
NONE_LOST = np.zeros(16, bool)


def series(count: int, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), noise: float = 1.0) -> list[RtkSignals]:
    """Epochs 0.2 s apart of one set of integers and clocks, with new errors in each; the receiver moves."""
    first = signals(seed=7, noise=0.0)
    sigma = noise * np.sqrt(2.0) * 0.003 * np.sqrt(1.0 + 1.0 / np.sin(first.elevation) ** 2)[:, None]
    rng, out = np.random.default_rng(11), []
    for k in range(count):
        moved = -(first.los @ (0.2 * k * np.array(velocity)))[:, None]
        code, phase = rng.standard_normal((2, 16, 2))
        out.append(
            first._replace(code=first.code + moved + 100.0 * sigma * code, phase=first.phase + moved + sigma * phase)
        )
    return out


@pytest.mark.parametrize("seed", range(8))
def test_without_memory_it_is_the_single_epoch_solution(seed: int) -> None:
    """Priors of 30 m weigh 1e-3 of the codes: floats agree to millimetres, ratios to a tenth."""
    s = signals(seed)
    alone = solve_epoch(CONFIG, s)
    found = KinematicFilter(EPOCH, CONFIG, 16).step(s, NONE_LOST, 0.2)
    assert found.outcome == alone.outcome
    assert found.satellites == alone.satellites
    assert found.ratio == pytest.approx(alone.ratio, rel=0.1)
    np.testing.assert_allclose(found.position_m, alone.position_m, atol=5e-3)


def test_floats_are_those_of_one_adjustment_of_all_epochs() -> None:
    """Continuous ambiguities, positions free in each epoch: the last float position against batch least squares."""
    data = series(6)
    config = CONFIG.replace(ratio_min=1e9)
    own = KinematicFilter(KinematicConfig(dynamics=False, ambiguity_walk_m=0.0), config, 16)
    for s in data:
        found = own.step(s, NONE_LOST, 0.2)
    np.testing.assert_allclose(found.position_m, _batch(data), atol=2e-3)


def _batch(data: list[RtkSignals]) -> np.ndarray:
    """Last position of least squares: 3 coordinates an epoch, clocks of each system, band and observable, ambiguities
    with the prior of their start (30 m); single differences, one clock an epoch for what is common."""
    n, s0 = len(data), data[0]
    variance = 2.0 * 0.003**2 * (1.0 + 1.0 / np.sin(s0.elevation) ** 2)
    groups = {key: i for i, key in enumerate(sorted({(int(c), b) for c in s0.system for b in range(2)}))}
    clocks, size = 2 * len(groups), 3 * n + 2 * len(groups) * n + 32
    normal, right = np.zeros((size, size)), np.zeros(size)
    for k, s in enumerate(data):
        for j in range(16):
            for b in range(2):
                for phase in (False, True):
                    row = np.zeros(size)
                    row[3 * k : 3 * k + 3] = -s.los[j]
                    row[3 * n + clocks * k + 2 * groups[int(s.system[j]), b] + phase] = 1.0
                    if phase:
                        row[size - 32 + 2 * j + b] = 1.0
                    weight = 1.0 / (variance[j] * (1.0 if phase else 1e4))
                    y = (s.phase if phase else s.code)[j, b]
                    normal += weight * np.outer(row, row)
                    right += weight * y * row
    normal[range(size - 32, size), range(size - 32, size)] += 1.0 / 30.0**2
    right[size - 32 :] += (data[0].phase - data[0].code).ravel() / 30.0**2
    normal[range(3 * n), range(3 * n)] += 1.0 / 30.0**2
    right[: 3 * n] += np.tile(TRUE_M, n) / 30.0**2
    return np.asarray(np.linalg.solve(normal, right)[3 * n - 3 : 3 * n])


def test_ambiguities_that_last_make_the_float_better() -> None:
    config, data = CONFIG.replace(ratio_min=1e9), series(150)
    own = KinematicFilter(KinematicConfig(dynamics=False), config, 16)
    errors = [np.linalg.norm(own.step(s, NONE_LOST, 0.2).position_m - TRUE_M) for s in data]
    alone = [np.linalg.norm(solve_epoch(config, s).position_m - TRUE_M) for s in data]
    assert errors[-1] < 0.35 * np.median(alone)


def test_motion_is_followed() -> None:
    velocity = (8.0, -5.0, 0.0)
    config = CONFIG.replace(ratio_min=1e9)
    own = KinematicFilter(KinematicConfig(ambiguities="instantaneous"), config, 16)
    data = series(100, velocity)
    off = [own.step(s, NONE_LOST, 0.2).position_m - TRUE_M - 0.2 * k * np.array(velocity) for k, s in enumerate(data)]
    alone = [solve_epoch(config, s).position_m - TRUE_M - 0.2 * k * np.array(velocity) for k, s in enumerate(data)]
    assert np.median(np.linalg.norm(off[50:], axis=1)) < 0.6 * np.median(np.linalg.norm(alone[50:], axis=1))


@pytest.mark.parametrize("announced", [True, False])
def test_a_slip_begins_a_new_ambiguity(announced: bool) -> None:
    """Told by the receiver, or seen as a jump of one band against the other; the next fix is right again."""
    data = series(40)
    own = KinematicFilter(KinematicConfig(), CONFIG, 16)
    lost = NONE_LOST.copy()
    for k, s in enumerate(data):
        phase = s.phase.copy()
        if k >= 20:
            phase[3, 0] += 3.0 * s.wavelength[3, 0]
        lost[3] = announced and k == 20
        found = own.step(s._replace(phase=phase), lost, 0.2)
        assert found.outcome == RtkOutcome.FIXED
        assert np.abs(found.position_m - TRUE_M).max() < 0.03


def test_a_slip_on_both_bands_that_nobody_sees_misleads() -> None:
    """The same cycles in length on both bands leave no jump: what conventional RTK cannot see."""
    data = series(40)
    own = KinematicFilter(KinematicConfig(), CONFIG.replace(ratio_min=1e9), 16)
    shift = np.zeros((16, 2))
    shift[[2, 3]] = 3.0
    for k, s in enumerate(data):
        found = own.step(s._replace(phase=s.phase + (shift if k >= 20 else 0.0)), NONE_LOST, 0.2)
    assert np.linalg.norm(found.position_m - TRUE_M) > 0.3


def test_no_solution_without_satellites() -> None:
    own = KinematicFilter(KinematicConfig(), CONFIG, 16)
    s = signals()
    assert own.step(s, NONE_LOST, 0.2).outcome == RtkOutcome.FIXED
    gone = own.step(s._replace(tracked=np.arange(16) < 3), NONE_LOST, 0.2)
    assert gone.outcome == RtkOutcome.NONE
    assert own.step(s, NONE_LOST, 0.2).outcome == RtkOutcome.FIXED
