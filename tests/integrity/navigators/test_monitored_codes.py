"""Navigator kind ``monitored_codes``: codes under a monitor of the family."""

from __future__ import annotations

from dataclasses import fields, replace

import gymnasium
import numpy as np
import pytest
from typer.testing import CliRunner

import lanebound.envs  # noqa: F401 - registers the environments
from lanebound.agents.cli import app
from lanebound.integrity import Fault, FaultSchedule, Navigator, NavigatorConfig, SkyMask, SkyTrack, truth_between
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.outcome import MonitorVerdicts
from lanebound.integrity.navigators.monitored_codes import MonitoredCodesConfig, MonitoredCodesNavigator
from lanebound.integrity.navigators.navigator import Measurements
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode

DT, SPEED = 0.1, 10.0
REMEMBER = ("kipl", "eraim", "composite")


def config(monitor: str = "ibpl", **more: object) -> NavigatorConfig:
    return NavigatorConfig.load({"kind": "monitored_codes", "monitor": {"kind": monitor}, **more})


def drive(navigator: Navigator, epochs: int, first: int = 0) -> list[tuple[np.ndarray, Solution]]:
    """Errors (B,) and solutions of vehicles that drive to the North."""
    batch, found = navigator.batch, []
    velocity, heading = np.tile([0.0, SPEED], (batch, 1)), np.zeros(batch)
    for k in range(first, first + epochs):
        before, after = (np.column_stack([np.zeros(batch), np.full(batch, SPEED * DT * i)]) for i in (k, k + 1))
        s = navigator.step(truth_between((k + 1) * DT, DT, (before, after), (velocity, velocity), (heading, heading)))
        found.append((np.hypot(*(s.position_en_m - after).T), s))
    return found


@pytest.mark.parametrize("monitor", ["ibpl", "residual_fde", "separation_root", "sbas", *REMEMBER])
def test_a_vehicle_knows_its_position_within_its_level(monitor: str) -> None:
    navigator = Navigator.nominal(config(monitor), [1, 2, 3], duration_s=60.0)
    assert isinstance(navigator, MonitoredCodesNavigator)
    found = drive(navigator, 120)[15:]
    assert all((error <= s.pl_at_m).all() for error, s in found)
    last = found[-1][1]
    assert (last.mode == Mode.CODE).all()
    assert np.abs(last.heading_rad).max() < 0.05
    assert np.isfinite(last.pl_cases_m).all()
    assert (last.satellites == 0).any() or (last.satellites > 5).all()


def test_wheels_and_gyro_carry_on_without_codes_and_the_level_grows() -> None:
    c = config()
    track = SkyTrack.from_config(c.sky, 60.0)
    jammed = FaultSchedule((Fault(kind="jamming", start_s=6.0, duration_s=20.0, magnitude_db=60.0),))
    navigator = Navigator(c, track, SkyMask.open(), [1], faults=jammed)
    found = drive(navigator, 110)
    levels = np.array([s.pl_at_m[0] for _, s in found])
    assert (np.diff(levels[85:]) > 0.0).all()
    assert found[-1][1].mode[0] == Mode.IMU_ODOMETER
    assert all((error <= s.pl_at_m).all() for error, s in found[15:])


def test_the_deviation_of_the_heading_grows_with_bias_and_scale_of_the_gyro() -> None:
    c = config(positioning={"heading": {"gyro_scale": 0.02}})
    navigator = Navigator.nominal(c, [1], duration_s=30.0)
    navigator.place(np.zeros((1, 2)), np.zeros(1), sigma_m=0.5, sigma_heading_rad=0.01)
    still, turn = np.zeros((1, 2)), 0.2  # at rest there is no Doppler course
    for k in range(10):
        at = np.array([turn * k * DT]), np.array([turn * (k + 1) * DT])
        navigator.step(truth_between((k + 1) * DT, DT, (still, still), (still, still), at))
    grown = navigator.state.belief.sigma_heading_rad[0] - 0.01
    assert grown == pytest.approx(10 * DT * 2e-3 + 0.02 * turn * 10 * DT, rel=0.1)


def test_a_doppler_course_has_the_deviation_of_lasting_errors_and_a_test() -> None:
    """Range rates of a correlation time of up to 2 s count as white errors of many times their variance."""
    lasting = 1.0 / np.tanh(0.5 * DT / 2.0)
    navigators = [
        Navigator.nominal(config(positioning={"doppler": {"tau_range_s": tau}}), [1], duration_s=30.0)
        for tau in ((1e-3, 1e-3), (2.0, 2.0))
    ]
    sigma = []
    for navigator in navigators:
        belief, epoch = navigator.state.belief, 0
        while not np.isfinite(belief.since_calibration_s[0]) and epoch < 60:
            drive(navigator, 1, epoch)
            epoch += 1
        sigma.append(belief.sigma_heading_rad[0])
    assert max(sigma) < 0.5
    assert sigma[1] / sigma[0] == pytest.approx(np.sqrt(lasting), rel=0.05)


@pytest.mark.parametrize("rate_mps", [0.0, 5.0])
def test_inconsistent_range_rates_give_no_course(rate_mps: float, monkeypatch: pytest.MonkeyPatch) -> None:
    navigator = Navigator.nominal(config(), [1, 2, 3, 4], duration_s=30.0)
    assert isinstance(navigator, MonitoredCodesNavigator)
    given = navigator._calibrate

    def spoilt(m: Measurements) -> np.ndarray:
        rates = m.gnss.range_rate_mps.copy()
        rates[np.arange(4), m.gnss.tracked.argmax(-1)] += rate_mps
        return given(replace(m, gnss=replace(m.gnss, range_rate_mps=rates)))

    monkeypatch.setattr(navigator, "_calibrate", spoilt)
    drive(navigator, 30)
    since = navigator.state.belief.since_calibration_s
    assert (since < 2.5 * DT).all() if rate_mps == 0.0 else np.isinf(since).all()


@pytest.mark.parametrize("monitor", ["ibpl", *REMEMBER])
def test_a_snapshot_goes_on_with_the_same_bits(monitor: str) -> None:
    navigator = Navigator.nominal(config(monitor), [4, 5], duration_s=60.0)
    drive(navigator, 30)
    kept = navigator.snapshot()
    first = drive(navigator, 15, 30)[-1][1]
    navigator.restore(kept)
    again = drive(navigator, 15, 30)[-1][1]
    np.testing.assert_array_equal(first.position_en_m, again.position_en_m)
    np.testing.assert_array_equal(first.pl_cases_m, again.pl_cases_m)


@pytest.mark.parametrize("monitor", ["ibpl", *REMEMBER])
def test_rows_of_a_batch_are_independent(monitor: str) -> None:
    both = drive(Navigator.nominal(config(monitor), [7, 8], duration_s=60.0), 40)[-1][1]
    alone = drive(Navigator.nominal(config(monitor), [8], duration_s=60.0), 40)[-1][1]
    np.testing.assert_array_equal(both.position_en_m[1], alone.position_en_m[0])
    np.testing.assert_array_equal(both.pl_at_m[1], alone.pl_at_m[0])


@pytest.mark.parametrize("monitor", REMEMBER)
def test_the_memory_of_a_vehicle_is_that_of_its_recorded_epochs(monitor: str) -> None:
    """Levels of a drive, epoch by epoch in a batch, are those of the epochs of each vehicle one after another; codes
    vanish for a while."""
    c = config(monitor)
    jammed = FaultSchedule((Fault(kind="jamming", start_s=4.0, duration_s=3.0, magnitude_db=60.0),))
    navigator = Navigator(c, SkyTrack.from_config(c.sky, 60.0), SkyMask.open(), [1, 2], faults=jammed)
    assert isinstance(navigator, MonitoredCodesNavigator)
    asked: list[tuple[CodeEpochs, MonitorVerdicts]] = []
    given = navigator._asked

    def noted(epochs: CodeEpochs, due: np.ndarray) -> MonitorVerdicts:
        b = navigator.state.belief
        step = np.concatenate([b.step_m, np.zeros((2, 1))], 1)
        moved = replace(epochs, step_enu_m=step, step_sigma_m=b.step_sigma_m.copy())
        asked.append((moved, given(epochs, due)))
        return asked[-1][1]

    navigator._asked = noted  # type: ignore[method-assign]
    drive(navigator, 90)
    risks = [case.integrity_risk for case in c.cases]
    for vehicle in range(2):
        parts = [epochs.take(slice(vehicle, vehicle + 1)) for epochs, _ in asked]
        names = [f.name for f in fields(CodeEpochs) if f.name != "system" and getattr(parts[0], f.name) is not None]
        joined = replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
        alone = watch(joined, navigator._monitor, risks)
        together = np.concatenate([found.hpl_m[vehicle : vehicle + 1] for _, found in asked])
        np.testing.assert_allclose(together, alone.hpl_m, rtol=1e-12)
        assert np.isfinite(alone.hpl_m[:, 0]).sum() > 4


@pytest.mark.parametrize("monitor", ["kipl", "eraim"])
def test_a_prior_pose_begins_the_memory_anew(monitor: str) -> None:
    navigator = Navigator.nominal(config(monitor), [1, 2], duration_s=60.0)
    drive(navigator, 30)
    navigator.place(np.array([[0.0, 30.0]]), np.zeros(1), sigma_m=0.5, sigma_heading_rad=0.01, rows=np.array([1]))
    assert np.isinf(navigator.state.belief.step_sigma_m[1])
    assert np.isfinite(navigator.state.belief.step_sigma_m[0])
    assert all((error <= s.pl_at_m).all() for error, s in drive(navigator, 20, 30))


def test_a_prior_pose_has_the_level_of_its_deviation() -> None:
    navigator = Navigator.nominal(config(), [1], duration_s=30.0)
    navigator.place(np.zeros((1, 2)), np.zeros(1), sigma_m=0.5, sigma_heading_rad=0.01)
    error, s = drive(navigator, 1)[0]
    assert 0.5 * 4.0 < s.pl_at_m[0] < 0.5 * 6.0
    assert error[0] < 0.1


def test_the_configuration_asks_for_what_it_needs() -> None:
    c = config()
    assert isinstance(c, MonitoredCodesConfig)
    assert c.gnss.undifferenced
    assert NavigatorConfig.load(c.to_dict()) == c
    assert NavigatorConfig().replace(kind="monitored_codes").gnss.undifferenced
    for kind in ("rraim_position", "rraim_range"):
        with pytest.raises(ConfigError, match=r"a monitor of codes without an anchor, got .* which needs codes and"):
            config(kind)
    with pytest.raises(ConfigError, match="antenna_right_m must be 0"):
        config(positioning={"antenna_forward_m": 1.0})
    with pytest.raises(ConfigError, match="did you mean"):
        config("ibpll")
    with pytest.raises(ConfigError, match="errors must be given for 'classes'"):
        config("classes")


def test_a_preset_of_fitted_errors_gives_the_deviations() -> None:
    chosen = {"kind": "classes_normal", "errors": "errors/berlin_potsdamer"}
    c = NavigatorConfig.load({"kind": "monitored_codes", "monitor": chosen})
    assert isinstance(c, MonitoredCodesConfig)
    laws = c.monitor.config().classes
    assert laws is not None
    assert len(laws.laws) == 15
    wide = drive(Navigator.nominal(c, [1], duration_s=30.0), 15)[-1][1]
    narrow = drive(Navigator.nominal(config("normal"), [1], duration_s=30.0), 15)[-1][1]
    assert wide.pl_at_m[0] > 3.0 * narrow.pl_at_m[0]


def test_the_kind_drives_environments_the_engine_and_the_command() -> None:
    chosen = {"sky": "urban", "navigator": {"kind": "monitored_codes", "monitor": {"kind": "ibpl"}}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=chosen)
    env.reset(seed=5)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=2, config=chosen)
    engine.reset(seed=5)
    for _ in range(6):
        info = env.step(np.zeros(2, dtype=np.float32))[4]
        infos = engine.step(np.zeros((2, 2), dtype=np.float32))[4]
        assert infos["pl_ct_m"][0] == info["pl_ct_m"]
        assert infos["err_ct_m"][0] == info["err_ct_m"]
    assert abs(info["err_ct_m"]) <= info["pl_ct_m"]
    assert info["mode"] == Mode.CODE
    env.close()
    engine.close()
    arguments = ["--set", "navigator.kind=monitored_codes", "--set", "navigator.monitor.kind=araim"]
    done = CliRunner().invoke(app, ["drive", "LaneKeeping", *arguments, "--set", "duration_s=2", "--json"])
    assert done.exit_code == 0, done.output


def test_the_monitor_is_by_default_the_one_of_several_reflected_codes_and_may_be_named_alone() -> None:
    assert NavigatorConfig.load({"kind": "monitored_codes"}).monitor.kind == "odds"
    assert NavigatorConfig.load({"kind": "monitored_codes", "monitor": "ibpl"}) == config("ibpl")
    assert NavigatorConfig.load({"kind": "monitored_codes", "monitor": "context"}).monitor.kind == "weighted"
    for data, words in (
        ({"monitor": "ibpl"}, "monitor is a key of kind monitored_codes, not of rtk_reckoning: leave it out"),
        ({"kind": "filter", "service": "spp"}, "service is a key of kind rtk_reckoning, not of filter"),
        ({"kind": "monitored_codes", "monitor": []}, "monitor must be a mapping, got .*: write keys and values"),
    ):
        with pytest.raises(ConfigError, match=words):
            NavigatorConfig.load(data)


def test_weak_codes_are_left_out_and_counted_as_not_used() -> None:
    navigator = Navigator.nominal(config("odds"), [1], duration_s=30.0)
    assert isinstance(navigator, MonitoredCodesNavigator)
    given = navigator._fix

    def weakened(m: Measurements) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cn0 = m.gnss.cn0_dbhz.copy()
        cn0[:, ::4] -= 12.0
        return given(replace(m, gnss=replace(m.gnss, cn0_dbhz=cn0)))

    drive(navigator, 20)
    navigator._fix = weakened  # type: ignore[method-assign]
    found = [s for _, s in drive(navigator, 12, 20) if s.satellites[0]]
    shown = [s for _, s in drive(Navigator.nominal(config("odds"), [1], duration_s=30.0), 20) if s.satellites[0]]
    assert found[-1].satellites[0] < shown[-1].satellites[0]
    assert found[-1].excluded[0] == 0
