"""Monitors with memory: filters with steps, noise and bias, anchors carried on by carriers."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import directions, quiet, sky, with_everything
from scipy.stats import binom

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.outcome import MonitorOutcome
from lanebound.integrity.monitoring.family.weighting import CodeBudget


def at_rest(y: np.ndarray, los: np.ndarray, used: np.ndarray | bool = True, sigma_m: float = 2.0) -> CodeEpochs:
    """A vehicle that stands, with exact carriers and almost exact steps."""
    e = CodeEpochs.of(y, los, sigma_m, used)
    return CodeEpochs(**{
        **vars(e), "step_enu_m": np.zeros((e.count, 3)), "step_sigma_m": np.full(e.count, 1e-3),
        "carrier_step_m": np.zeros(y.shape), "carrier_sigma_m": np.full(y.shape, 1e-3),
        "carrier_kept": np.broadcast_to(np.asarray(used), y.shape).copy(),
    })  # fmt: skip


def test_kipl_begins_as_ibpl_and_holds_errors_that_do_not_change() -> None:
    rng, risk, drives, length = np.random.default_rng(1), 0.05, 300, 20
    constant = rng.normal(size=(drives, 1, 9)) * 10.0 ** rng.uniform(-1, 1, (drives, 1, 1))
    y = np.broadcast_to(constant, (drives, length, 9)).reshape(-1, 9)
    e = at_rest(y, sky(np.random.default_rng(2), 9, len(y)))
    e = CodeEpochs(**{**vars(e), "drive": np.repeat(np.arange(drives), length)})
    kalman, snapshot = (watch(e, monitor_named(name).config(), risk) for name in ("kipl", "ibpl"))
    first = e.starts()
    np.testing.assert_allclose(kalman.hpl_m[first], snapshot.hpl_m[first])
    last = np.roll(first, -1)
    error = np.hypot(*kalman.position_enu_m[last, :2].T)
    assert (error > kalman.hpl_m[last, 0]).mean() <= risk  # a bound: not an equality


def test_kipl_averages_noise_and_coasts_without_codes() -> None:
    e = quiet(60, 9, 1, 3)
    used = np.ones((60, 9), bool)
    used[40:] = False
    found = watch(at_rest(e.y_m, e.los_enu, used), monitor_named("kipl").config(), 1e-2)
    plain = watch(at_rest(e.y_m, e.los_enu), monitor_named("ibpl").config(), 1e-2)
    assert np.hypot(*found.position_enu_m[20:40, :2].T).mean() < np.hypot(*plain.position_enu_m[20:40, :2].T).mean()
    assert found.usable[40:].all()
    assert (np.diff(found.hpl_m[40:, 0]) > 0.0).all()


def test_the_composite_tells_a_lasting_error_from_noise() -> None:
    rng = np.random.default_rng(4)
    noisy, los = 2.0 * rng.normal(size=(200, 9)), sky(np.random.default_rng(5), 9, 200)
    lasting = 0.1 * noisy.copy()
    lasting[:, 2] += 20.0
    short = {"window_s": 10.0}
    a, b = (watch(CodeEpochs.of(y, los, 2.0), monitor_named("composite").config(short), 1e-5) for y in (noisy, lasting))
    error = np.hypot(*b.position_enu_m[100:, :2].T)
    assert (error <= b.hpl_m[100:, 0]).all()
    smaller = watch(CodeEpochs.of(0.1 * noisy, los, 2.0), monitor_named("composite").config(short), 1e-5)
    assert smaller.hpl_m[-1, 0] < 0.3 * a.hpl_m[-1, 0]  # the stated deviation is forgotten


@pytest.mark.parametrize("name", ["rraim_position", "rraim_range"])
def test_rraim_carries_a_good_level_through_a_loss_of_geometry(name: str) -> None:
    e = quiet(40, 12, 1, 6)
    used = np.ones((40, 12), bool)
    used[15:30, 7:] = False  # seven satellites are left, their carriers held
    drive = at_rest(e.y_m, e.los_enu, used)
    relative = watch(drive, monitor_named(name).config(), 1e-3)
    snapshot = watch(drive, monitor_named("separation_fde").config(), 1e-3)
    inside = slice(15, 30)
    assert (relative.hpl_m[inside] <= snapshot.hpl_m[inside] + 1e-9).all()
    error = np.hypot(*relative.position_enu_m[:, :2].T)
    assert (error <= relative.hpl_m[:, 0]).all()
    if name == "rraim_position":
        assert relative.hpl_m[20, 0] < 0.7 * snapshot.hpl_m[20, 0]


def test_a_cycle_slip_does_not_pass_unnoticed() -> None:
    e = quiet(20, 12, 1, 7)
    drive = at_rest(e.y_m, e.los_enu)
    assert drive.carrier_step_m is not None
    drive.carrier_step_m[10, 3] += 5.0
    relative = watch(drive, monitor_named("rraim_position").config(), 1e-3)
    assert (np.hypot(*relative.position_enu_m[:, :2].T) <= relative.hpl_m[:, 0]).all()


def test_eraim_begins_as_separation_and_alarms_at_a_new_fault() -> None:
    e = quiet(30, 9, 1, 8)
    y = e.y_m.copy()
    y[20:, 1] += 80.0
    plain = {"rejection": "none"}
    found = watch(at_rest(y, e.los_enu), monitor_named("eraim").config(plain), 1e-3)
    root = watch(at_rest(y, e.los_enu), monitor_named("separation_root").config({"test": "none"}), 1e-3)
    assert found.hpl_m[0, 0] == pytest.approx(root.hpl_m[0, 0], abs=2e-3)
    assert not found.alarm[:20].any()
    assert found.alarm[25:].all()


def test_methods_with_memory_do_not_look_ahead_or_into_other_drives() -> None:
    e = with_everything(quiet(40, 10, 2, 9))
    e = CodeEpochs(**{**vars(e), "drive": np.repeat([0, 1], 20)})
    for name in ("kipl", "composite", "eraim", "rraim_position", "rraim_range"):
        config = monitor_named(name).config()
        both, first, second = (watch(part, config, 1e-3) for part in (e, e.take(slice(0, 13)), e.take(slice(20, 40))))
        np.testing.assert_array_equal(both.hpl_m[:13], first.hpl_m, name)
        np.testing.assert_array_equal(both.hpl_m[20:], second.hpl_m, name)


FIVE = directions([0, 70, 150, 220, 300], [20, 50, 30, 60, 75])
NINE = directions(np.linspace(0, 330, 9), [20, 70, 35, 15, 50, 65, 25, 40, 30])


@pytest.mark.parametrize("codes", [5, 9])
def test_eraim_keeps_its_alarm_and_its_level_when_codes_vanish(codes: int) -> None:
    """A fault at epoch 6, no codes from epoch 9 on: the error is in the filter, and so is the alarm. Without a fault
    the level never shrinks for want of codes."""
    los = FIVE if codes == 5 else NINE
    y, used = np.zeros((12, codes)), np.ones((12, codes), bool)
    used[9:] = False
    config = monitor_named("eraim").config({"rejection": "none" if codes == 9 else "separation"})
    sights = np.broadcast_to(los, (12, codes, 3))
    level = watch(at_rest(y, sights, used), config, 1e-5).hpl_m[:, 0]
    assert np.isfinite(level).all()
    assert (np.diff(level) >= -1e-9).all()
    y[6:, 1] = 80.0
    found = watch(at_rest(y, sights, used), config, 1e-3)
    assert np.hypot(*found.position_enu_m[9:, :2].T).min() > 5.0
    assert not found.alarm[:6].any()
    assert found.alarm[6:].all()


def test_eraim_counts_a_code_that_left_as_a_mode_until_the_next_drive() -> None:
    """A code leaves after epoch 4; the next drive never had it."""
    y, used = np.zeros((12, 9)), np.ones((12, 9), bool)
    used[4:, 3] = False
    e = at_rest(y, np.broadcast_to(NINE, (12, 9, 3)), used)
    e = CodeEpochs(**{**vars(e), "drive": np.repeat([0, 1], 6)})
    level = watch(e, monitor_named("eraim").config(), 1e-5).hpl_m[:, 0]
    without = watch(e.take(slice(6, 12)), monitor_named("eraim").config(), 1e-5).hpl_m[:, 0]
    np.testing.assert_array_equal(level[6:], without)
    assert level[5] >= level[0] - 1e-6


def test_false_alarms_of_eraim_are_within_their_allocation() -> None:
    """200 drives of 10 epochs, each code there in 70 %: drives with an alarm, at 1e-2 an epoch, by chance above the
    bound once in 1,000 runs."""
    rng, drives, length = np.random.default_rng(12), 200, 10
    y, used = 2.0 * rng.normal(size=(drives * length, 9)), rng.random((drives * length, 9)) < 0.7
    e = at_rest(y, np.broadcast_to(NINE, (*y.shape, 3)), used)
    e = CodeEpochs(**{**vars(e), "drive": np.repeat(np.arange(drives), length)})
    found = watch(e, monitor_named("eraim").config({"rejection": "none", "false_alarm": 1e-2}), 1e-3)
    assert found.alarm.reshape(drives, length).any(-1).sum() <= binom.ppf(0.999, drives, 1e-2 * length)


@pytest.mark.parametrize("name", ["rraim_position", "rraim_range"])
def test_rraim_has_no_anchor_where_codes_fail_their_test(name: str) -> None:
    """Five codes, one off by 200 m at the first epoch, which five cannot exclude; later codes are worse but right."""
    y, sigma = np.zeros((6, 5)), np.full((6, 5), 4.0)
    y[0, 1], sigma[0] = 200.0, 2.0
    e = at_rest(y, np.broadcast_to(FIVE, (6, 5, 3)))
    e = CodeEpochs(**{**vars(e), "sigma_m": sigma})
    found = watch(e, monitor_named(name).config(), 1e-3)
    assert found.alarm.tolist() == [True] + [False] * 5
    assert found.usable[1:].all()
    assert np.hypot(*found.position_enu_m[1:, :2].T).max() < 1.0


@pytest.mark.parametrize("name", ["rraim_position", "rraim_range"])
@pytest.mark.parametrize("spacing_s", [1.0, 0.1])
def test_rraim_bounds_carriers_that_drift(name: str, spacing_s: float) -> None:
    """Ramps of 0.05 to four deviations of a step in each satellite, over a coast of 29 s."""
    step = CodeBudget().carrier_step(np.arcsin(NINE[:, 2]), spacing_s)
    n = int(29.0 / spacing_s) + 1
    sigma = np.full((n, 9), 9.0)
    sigma[0] = 1.0
    coasted, kind = 0, monitor_named(name).config()
    for satellite in range(0, 9, 1 if spacing_s == 1.0 else 4):
        for times in (0.05, 0.2, 1.0, 4.0):
            change = np.zeros((n, 9))
            change[1:, satellite] = times * step[satellite]
            e = at_rest(np.zeros((n, 9)), np.broadcast_to(NINE, (n, 9, 3)))
            found = watch(CodeEpochs(**{
                **vars(e), "time_s": spacing_s * np.arange(n), "sigma_m": sigma, "carrier_step_m": change,
                "carrier_sigma_m": np.broadcast_to(step, (n, 9)),
            }), kind, 1e-3)  # fmt: skip
            error = np.hypot(*found.position_enu_m[:, :2].T)
            assert (error <= found.hpl_m[:, 0])[found.usable].all()
            coasted += int((found.hpl_m[-1, 0] < 20.0) & (error[-1] > 0.0))
    assert coasted > 0


@pytest.mark.parametrize("name", ["rraim_position", "rraim_range", "eraim", "kipl", "araim", "separation_root"])
def test_a_level_is_that_of_its_own_risk(name: str) -> None:
    e = with_everything(quiet(30, 12, 2, 14))
    config = monitor_named(name).config()
    alone, among = watch(e, config, 1e-3).hpl_m[:, 0], watch(e, config, [1e-2, 1e-3, 1e-7]).hpl_m[:, 1]
    np.testing.assert_allclose(among, alone, rtol=1e-12)


def test_before_their_first_epoch_methods_say_so() -> None:
    e = quiet(6, 9, 1, 15)
    used = np.ones((6, 9), bool)
    used[:2], used[4] = False, False
    for name in ("kipl", "eraim", "rraim_position", "rraim_range"):
        found = watch(at_rest(e.y_m, e.los_enu, used), monitor_named(name).config(), 1e-3)
        assert found.outcome[:2].tolist() == [MonitorOutcome.NOT_BEGUN.code] * 2, name
        assert found.usable[[2, 3, 5]].all(), name
        if name in ("kipl", "eraim"):
            assert found.usable[4], name  # it coasts


def test_what_is_missing_is_named() -> None:
    for name, words in (("kipl", "step_enu_m must be known"), ("rraim_range", "carrier_step_m must be known")):
        with pytest.raises(InputError, match=words):
            watch(quiet(3), monitor_named(name).config(), 1e-3)
