"""Alert limits and the timing of alerts, by hand-written sequences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring import alerts_kernel
from lanebound.integrity.monitoring.alerts import (
    ALERT_LIMITS,
    AlertConfig,
    AlertLimits,
    AlertReason,
    AlertState,
    AlertStatus,
    alert_parameters,
    step,
)

DT = 0.1


def quiet(vehicles: int = 1) -> AlertState:
    """A vehicle that has long been trusted."""
    state = AlertState.initial(vehicles)
    state.alert[:] = False
    state.reason[:] = 0
    state.clear_s[:] = 100.0
    return state


def play(config: AlertConfig, pl_ct: list[float], state: AlertState | None = None) -> tuple[str, list[AlertStatus]]:
    """Alert flags of a sequence of cross-track levels as text, ``#`` alerted and ``.`` not."""
    state = quiet() if state is None else state
    statuses = [step(config, state, np.array([0.2]), np.array([level]), DT) for level in pl_ct]
    return "".join("#" if s.alert[0] else "." for s in statuses), statuses


def test_presets() -> None:
    assert (AlertLimits.named("s1").al_at_m, AlertLimits.named("s2").al_ct_m, ALERT_LIMITS["s5"].al_at_m) == (
        1,
        1.5,
        15,
    )
    freeway, local = ALERT_LIMITS["reid2019_freeway"], ALERT_LIMITS["reid2019_local"]
    assert (freeway.al_ct_m, freeway.al_at_m, local.al_ct_m, local.al_at_m) == (0.57, 1.40, 0.29, 0.29)
    with pytest.raises(ConfigError, match="s1, s2"):
        AlertLimits.named("s3")


def test_alert_is_raised_at_once_and_cleared_after_the_hold_time() -> None:
    config = AlertConfig(clear_margin=0.9, clear_hold_s=0.3)
    text, statuses = play(config, [0.5, 1.0, 1.01, 0.95, 0.8, 0.8, 0.8, 0.8])
    #                              inside, at AL, over, not below margin, then 0.1, 0.2, 0.3 s below it
    assert text == "..####.."
    reasons = [AlertReason.from_code(int(s.reason[0])).name for s in statuses]
    assert reasons[2:7] == ["PL_CT", "HOLDING", "HOLDING", "HOLDING", "NONE"]
    assert [bool(s.available[0]) for s in statuses] == [True, True, False, True, True, True, True, True]


def test_a_touch_of_the_margin_restarts_the_hold() -> None:
    text, _ = play(AlertConfig(clear_hold_s=0.3), [2.0, 0.5, 0.5, 0.95, 0.5, 0.5, 0.5])
    assert text == "######."


def test_no_hysteresis_when_configured_away() -> None:
    text, _ = play(AlertConfig(clear_margin=1.0, clear_hold_s=0.0), [2.0, 0.99, 2.0, 1.0])
    assert text == "#.#."


def test_time_to_alert_accounting() -> None:
    """A short excess stays silent, a lasting one alerts within the time to alert."""
    config = AlertConfig(raise_after_s=0.2, time_to_alert_s=0.5, clear_hold_s=0.0)
    text, statuses = play(config, [2.0, 2.0, 0.5, 2.0, 2.0, 2.0, 2.0])
    assert text == ".....##"
    assert [float(s.tta_left_s[0]) for s in statuses] == pytest.approx([0.5, 0.4, 0.5, 0.5, 0.4, 0.5, 0.5])
    with pytest.raises(ConfigError, match="raise_after_s"):
        AlertConfig(raise_after_s=2.0, time_to_alert_s=1.0)


def test_a_new_vehicle_is_alerted_until_it_has_earned_trust() -> None:
    text, _ = play(AlertConfig(clear_hold_s=0.2), [np.inf, 0.5, 0.5, 0.5], AlertState.initial(1))
    assert text == "##.."


@pytest.mark.parametrize(
    ("pl_at", "pl_ct", "sigma", "cause", "expected"),
    [
        (0.5, 0.5, 0.0, AlertReason.NONE, AlertReason.NONE),
        (1.5, 0.5, 0.0, AlertReason.NONE, AlertReason.PL_AT),
        (0.5, 1.5, 0.0, AlertReason.NONE, AlertReason.PL_CT),
        (1.5, 1.5, 0.0, AlertReason.NONE, AlertReason.BOTH),
        (np.inf, 0.5, 0.0, AlertReason.NONE, AlertReason.PL_AT),
        (np.inf, np.inf, 0.0, AlertReason.NONE, AlertReason.NO_SOLUTION),
        (np.nan, np.nan, 0.0, AlertReason.NONE, AlertReason.NO_SOLUTION),
        (0.5, 0.5, 0.3, AlertReason.NONE, AlertReason.ACCURACY),
        (0.5, 0.5, np.nan, AlertReason.NONE, AlertReason.ACCURACY),
        (0.5, 0.5, 0.0, AlertReason.INTEGRITY_TEST_FAILED, AlertReason.INTEGRITY_TEST_FAILED),
        (1.5, 0.5, 0.0, AlertReason.INITIALISING, AlertReason.INITIALISING),
    ],
)
def test_reasons(pl_at: float, pl_ct: float, sigma: float, cause: AlertReason, expected: AlertReason) -> None:
    config = AlertConfig(limits=AlertLimits(accuracy_at_m=0.5, accuracy_ct_m=0.5))
    status = step(config, quiet(), [pl_at], [pl_ct], DT, sigma_at_m=[sigma], sigma_ct_m=[0.1], cause=[cause.code])
    assert AlertReason.from_code(int(status.reason[0])) is expected
    assert bool(status.alert[0]) is (expected is not AlertReason.NONE)
    assert bool(status.available[0]) is (expected is AlertReason.NONE)


def test_accuracy_threshold_is_1_96_sigma() -> None:
    config = AlertConfig(limits=AlertLimits(accuracy_at_m=0.196))
    status = step(config, quiet(2), [0.5, 0.5], [0.5, 0.5], DT, sigma_at_m=[0.0999, 0.1001])
    assert status.alert.tolist() == [False, True]


def test_kernel_codes_are_the_enums() -> None:
    for name in ("NONE", "PL_AT", "PL_CT", "BOTH", "NO_SOLUTION", "ACCURACY", "INITIALISING", "HOLDING"):
        assert getattr(alerts_kernel, name) == AlertReason[name].code
    assert AlertReason.INTEGRITY_TEST_FAILED.code == alerts_kernel.TEST_FAILED


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_kernel_equals_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = AlertLimits(accuracy_at_m=0.5, accuracy_ct_m=0.7)
    config = AlertConfig(limits=limits, clear_hold_s=0.3, raise_after_s=0.2)
    B = 20
    ours, theirs, rules = AlertState.initial(B), np.zeros(B, alerts_kernel.ALERT), alert_parameters(config)[0]
    for field in theirs.dtype.names:
        theirs[field] = getattr(ours, field)
    available = np.empty(B, dtype=bool)
    for _ in range(12):
        pl = rng.choice([0.5, 0.95, 1.2, np.inf, np.nan], (2, B), p=[0.5, 0.2, 0.1, 0.1, 0.1])
        sigma = rng.choice([0.1, 0.4, np.nan], (2, B), p=[0.8, 0.1, 0.1])
        cause = rng.choice([0, 5, 7], B, p=[0.8, 0.1, 0.1])
        status = step(config, ours, *pl, DT, sigma_at_m=sigma[0], sigma_ct_m=sigma[1], cause=cause)
        for i in range(B):
            available[i] = alerts_kernel.alert_step(cause[i], *pl[:, i], *sigma[:, i], DT, rules, theirs[i])
        for field in theirs.dtype.names:
            assert np.array_equal(getattr(ours, field), theirs[field]), field
        assert np.array_equal(status.available, available)


def test_state_copies_and_refuses() -> None:
    state = AlertState.initial(2)
    other = state.copy()
    step(AlertConfig(), other, [0.1, 0.1], [0.1, 0.1], DT)
    assert not state.clear_s.any()
    with pytest.raises(InputError, match="dt_s"):
        step(AlertConfig(), state, [0.1, 0.1], [0.1, 0.1], 0.0)
