"""A positioning mode, a monitor and a kind of navigator from outside: registered, driven, taken back.

The modules stand in tests/plugins; docs/extending.md shows them.
"""

from __future__ import annotations

import importlib
import json
import pickle
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.agents.cli import app
from lanebound.agents.episodes import open_env
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import (
    Navigator,
    NavigatorConfig,
    navigator_class,
)
from lanebound.integrity.navigators.rtk_reckoning import extra_stages
from lanebound.integrity.navigators.rtk_reckoning.extension_kernel import (
    exclude_satellite,
    raise_alert,
    refuse_doppler,
    refuse_fix,
)
from lanebound.integrity.navigators.rtk_reckoning.extra_stages import Point
from lanebound.integrity.navigators.rtk_reckoning.modes import register_mode
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

DT_S, MPS = 0.1, 10.0
KEEPING = "lanebound/LaneKeeping-v0"


@pytest.fixture
def inertial() -> Mode:
    found: Mode = importlib.import_module("inertial").INERTIAL
    return found


@pytest.fixture
def interference() -> AlertReason:
    found: AlertReason = importlib.import_module("interference").REASON
    return found


@pytest.fixture
def odometer_gyro() -> ModuleType:
    return importlib.import_module("odometer_gyro")


def _drive(navigator: Navigator, epochs: range) -> list[Solution]:
    """Straight on to the North."""
    return [navigator.step(_truth(navigator.batch, epoch)) for epoch in epochs]


def _truth(batch: int, epoch: int) -> Truth:
    before, after = (np.tile([0.0, MPS * DT_S * n], (batch, 1)) for n in (epoch, epoch + 1))
    velocity, heading = np.tile([0.0, MPS], (batch, 1)), np.zeros(batch)
    arc = np.full(batch, MPS * DT_S * (epoch + 1))
    return truth_between((epoch + 1) * DT_S, DT_S, (before, after), (velocity, velocity), (heading, heading), arc_m=arc)


def _error_m(solution: Solution, epoch: int) -> NDArray[np.float64]:
    """Absolute errors (B, 2) along and across."""
    return np.abs(solution.position_en_m - [0.0, MPS * DT_S * (epoch + 1)])[:, ::-1]


def _tunnel(config: NavigatorConfig, seeds: list[int], faults: tuple[Fault, ...] = ()) -> Navigator:
    """An open road with a tunnel from 100 m on."""
    path = np.zeros((61, 1, 1), dtype=np.uint8)
    path[10:] = SignalPath.BLOCKED
    mask = SkyMask(path, np.zeros(path.shape, dtype=np.float32), 1, 1, 10.0, 600.0, False)
    return Navigator(config, SkyTrack.from_config(config.sky, 60.0), mask, seeds, faults=FaultSchedule(faults))


# A positioning mode


def test_a_mode_takes_its_place_among_the_others(inertial: Mode) -> None:
    config = NavigatorConfig.load({"modes": ["doppler", "inertial", "imu_odometer"]})
    run = _drive(_tunnel(config, [1, 2, 3]), range(200))
    used = np.array([s.mode for s in run])
    assert (used[60:90] == Mode.RTK).all()
    assert (used[100:140] == inertial).all()
    assert (used[150:] == Mode.IMU_ODOMETER).all()
    for epoch, solution in enumerate(run):
        level = np.stack([solution.pl_at_m, solution.pl_ct_m], -1)
        assert (_error_m(solution, epoch)[solution.mode != Mode.NONE] <= level[solution.mode != Mode.NONE]).all()
    assert (run[139].pl_at_m < np.inf).all()
    assert (run[139].pl_at_m > run[110].pl_at_m).all()


def test_its_state_is_kept_and_begins_anew_with_a_vehicle(inertial: Mode) -> None:
    navigator = _tunnel(NavigatorConfig.load({"modes": ["inertial", "imu_odometer"]}), [1, 2])
    _drive(navigator, range(50))
    np.testing.assert_allclose(navigator.state.extensions["mode inertial"]["speed"], MPS, atol=0.3)
    navigator.place(np.zeros((1, 2)), np.zeros(1), 0.1, 0.01, rows=np.array([1]))
    assert navigator.state.extensions["mode inertial"]["age"].tolist() == [0.0, np.inf]


def test_without_any_mode_a_moving_vehicle_has_no_level_between_fixes() -> None:
    run = _drive(_tunnel(NavigatorConfig.load({"modes": []}), [1, 2]), range(130))
    assert (run[-1].mode == Mode.NONE).all()
    assert np.isinf(run[-1].pl_cases_m).all()
    assert (run[-1].reason == AlertReason.NO_SOLUTION.code).all()


def test_environments_and_the_engine_show_the_mode(inertial: Mode) -> None:
    config = {"sky": "open", "navigator": {"modes": ["inertial:inertial"]}, "observation": {"form": "flat"}}
    column = [entry.column for entry in entries(ObservationConfig())].index("integrity.mode_inertial")
    loss = [{"kind": "jamming", "start_s": 0.0, "magnitude_db": 40.0}]
    env = gymnasium.make(KEEPING, config=config)
    env.reset(seed=1, options={"faults": loss})
    steps = [env.step(np.zeros(2, dtype=np.float32)) for _ in range(4)]
    env.close()
    assert [bool(obs[column]) for obs, *_ in steps] == [info["mode"] == inertial for *_, info in steps]
    assert any(info["mode"] == inertial for *_, info in steps)
    engine = gymnasium.make_vec(KEEPING, num_envs=2, config=config)
    engine.reset(seed=1)
    obs, _, _, _, info = engine.step(np.zeros((2, 2), dtype=np.float32))
    engine.close()
    assert (obs[:, column] == (info["mode"] == inertial)).all()
    assert set(info["mode"].tolist()) <= {int(Mode.RTK), int(inertial)}


def test_a_mode_that_is_not_registered_is_refused_with_the_way_to_do_so() -> None:
    with pytest.raises(ConfigError, match=r"modes must be among doppler, imu_odometer, got 'inertal': import the modu"):
        NavigatorConfig.load({"modes": ["doppler", "inertal"]})
    with pytest.raises(ConfigError, match=r"modes must name each one once, got \['doppler', 'doppler'\]"):
        NavigatorConfig.load({"modes": ["doppler", "doppler"]})


# A monitor


def _jammed(db: float) -> tuple[Fault, ...]:
    return (Fault.load({"kind": "jamming", "magnitude_db": db, "start_s": 8.0, "vehicle": 1}),)


def test_a_monitor_raises_levels_and_alerts_with_its_own_reason(interference: AlertReason) -> None:
    plain_config = NavigatorConfig.load({"positioning": {"rtk": {"fade_db": 20.0}}})  # RTK goes on while jammed
    config = plain_config.replace(stages=["interference"])
    watched, plain = (_tunnel(c, [1, 2], _jammed(8.0)) for c in (config, plain_config))
    runs = _drive(watched, range(88)), _drive(plain, range(88))
    for with_it, without in zip(*runs, strict=True):
        np.testing.assert_array_equal(with_it.position_en_m, without.position_en_m)
        assert (with_it.pl_cases_m >= without.pl_cases_m).all()
    with_it, without = (run[-1] for run in runs)
    assert with_it.reason.tolist() == [AlertReason.NONE.code, interference.code]
    assert with_it.alert.tolist() == [False, True]
    assert not with_it.available[1]
    assert with_it.pl_at_m[1] > 1.5 * without.pl_at_m[1]
    assert AlertReason.from_code(int(with_it.reason[1])).value.startswith("the signals lose strength")


def test_a_monitor_excludes_satellites(interference: AlertReason, monkeypatch: pytest.MonkeyPatch) -> None:
    navigator = _tunnel(NavigatorConfig.load({"stages": ["interference"]}), [1])
    _drive(navigator, range(60))
    m = navigator.measure(_truth(1, 60))
    strongest = int(m.gnss.cn0_dbhz[0].argmax())
    m.gnss.cn0_dbhz[0, strongest] = 60.0
    before = m.gnss.tracked.copy()
    solution = navigator.locate(m)
    assert solution.excluded.tolist() == [1]
    assert not solution.held[0, strongest]
    assert solution.mode[0] == Mode.RTK
    np.testing.assert_array_equal(m.gnss.tracked, before)  # the measurements stay as they are


def test_the_state_of_a_monitor_is_kept_restored_and_handed_over(interference: AlertReason) -> None:
    navigator = _tunnel(NavigatorConfig.load({"stages": ["interference"]}), [1, 2])
    _drive(navigator, range(40))
    kept = pickle.loads(pickle.dumps(navigator.snapshot()))
    first = _drive(navigator, range(40, 60))
    usual = navigator.state.extensions["stage interference"]["usual"].copy()
    assert (usual > 40.0).all()
    navigator.restore(kept)
    again = _drive(navigator, range(40, 60))
    np.testing.assert_array_equal(first[-1].pl_cases_m, again[-1].pl_cases_m)
    np.testing.assert_array_equal(navigator.state.extensions["stage interference"]["usual"], usual)
    other = navigator.another(Streams([8, 9]))
    assert not other.state.extensions["stage interference"]["usual"].any()
    other.adopt(np.array([0]), navigator, np.array([1]))
    assert other.state.extensions["stage interference"]["usual"].tolist() == [usual[1], 0.0]


def test_threads_share_the_work_of_a_monitor(interference: AlertReason) -> None:
    config, seeds = NavigatorConfig.load({"stages": ["interference"]}), list(range(32))
    alone, shared = (_tunnel(config, seeds, _jammed(8.0)) for _ in range(2))
    with serial():
        one = _drive(alone, range(88))[-1]
    many = _drive(shared, range(88))[-1]
    np.testing.assert_array_equal(one.pl_cases_m, many.pl_cases_m)
    assert one.reason[1] == many.reason[1] == interference.code


def test_a_level_that_a_monitor_lowers_is_refused() -> None:
    def lower(first: int, last: int, epoch: object, own: object) -> None:
        epoch.levels[first:last] = 0.0  # type: ignore[attr-defined]

    extra_stages.register_stages("optimist", "nothing", (), {Point.BOUNDED: lower})
    navigator = _tunnel(NavigatorConfig.load({"stages": ["optimist"]}), [1])
    with pytest.raises(InputError, match=r"after 'stage optimist' .* inf m, or more .* got 0.000 m"):
        _drive(navigator, range(1))


@pytest.mark.parametrize("point", [Point.MEASURED, Point.FIX, Point.JUDGED])
def test_levels_are_raised_at_the_end_alone(point: Point) -> None:
    def widen(first: int, last: int, epoch: object, own: object) -> None:
        epoch.levels[first:last] = 7.0 + np.abs(np.nan_to_num(epoch.levels[first:last], posinf=1e9))  # type: ignore[attr-defined]

    extra_stages.register_stages("early", "nothing", (), {point: widen})
    navigator = _tunnel(NavigatorConfig.load({"stages": ["early"]}), [1])
    with pytest.raises(InputError, match=r"after 'stage early'"):
        _drive(navigator, range(20))


def test_levels_of_rtk_are_not_lowered_by_a_monitor() -> None:
    def shrink(first: int, last: int, epoch: object, own: object) -> None:
        epoch.fixed_levels[first:last] *= 0.01  # type: ignore[attr-defined]

    extra_stages.register_stages("shrinking", "nothing", (), {Point.ESTIMATED: shrink})
    navigator = _tunnel(NavigatorConfig.load({"stages": ["shrinking"]}), [1])
    with pytest.raises(InputError, match="levels of the RTK position may only grow"):
        _drive(navigator, range(60))


def test_a_monitor_that_does_nothing_changes_nothing_and_one_without_a_reason_is_refused() -> None:
    extra_stages.register_stages("idle", "nothing", (), {Point.MEASURED: lambda first, last, epoch, own: None})
    with_it = _drive(_tunnel(NavigatorConfig.load({"stages": ["idle"]}), [1]), range(5))
    without = _drive(_tunnel(NavigatorConfig(), [1]), range(5))
    np.testing.assert_array_equal([s.pl_ct_m for s in with_it], [s.pl_ct_m for s in without])
    with pytest.raises(InputError, match="reason of 'mute' must not be NONE"):
        extra_stages.register_stages("mute", "", (), {Point.BOUNDED: lambda *_: None}, reason=AlertReason.NONE)


def test_a_withdrawn_monitor_is_unknown() -> None:
    extra_stages.register_stages("idle", "nothing", (), {Point.MEASURED: lambda first, last, epoch, own: None})
    extra_stages.withdraw_stages("idle")
    with pytest.raises(ConfigError, match="stages must be among"):
        NavigatorConfig.load({"stages": ["idle"]})
    with pytest.raises(InputError, match="'idle'"):
        extra_stages.withdraw_stages("idle")


def test_a_monitor_of_a_taken_name_or_without_measurements_or_stages_is_refused(interference: AlertReason) -> None:
    for name, needs, message in (
        ("interference", (), "must not be taken"), ("own", ("radar",), "needs must be among"),
        ("own", ("cn0", "delta_v"), "must hold one"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            extra_stages.register_stages(name, "", needs, {})


def _nothing(first: int, last: int, epoch: object, own: object) -> None:
    pass


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"name": "my own"}, "name of stages must be an identifier, got 'my own'"),
        ({"stages": {"BOUNDED": _nothing}}, "points of stages 'own' must be members of Point, got 'BOUNDED'"),
        ({"stages": {Point.BOUNDED: 3}}, "stage of stages 'own' must be a function .*, got 3"),
        (
            {"stages": {Point.BOUNDED: lambda a, b, c: None}},
            "must be a function .*, own.*too many",
        ),
        (
            {"initial": {"a": 1.0}},
            r"initial of stages 'own' must be a record \(1,\), got .'a': 1.0.: make",
        ),
        ({"initial": np.zeros(1)}, r"must be a record \(1,\)"),
        ({"initial": np.zeros(2, [("a", "f8")])}, r"must be a record \(1,\)"),
        ({"reason": "jam"}, "reason of 'own' must be an AlertReason, got 'jam'"),
    ],
)
def test_stages_of_another_form_are_refused(given: dict[str, Any], message: str) -> None:
    right: dict[str, Any] = {"name": "own", "about": "", "needs": (), "stages": {Point.BOUNDED: _nothing}}
    with pytest.raises(InputError, match=message):
        extra_stages.register_stages(**(right | given))


def _exclude(epoch: Any, v: int) -> None:
    for s in range(epoch.signals.shape[1]):
        exclude_satellite(epoch, v, s)


@pytest.mark.parametrize(
    ("point", "call", "message"),
    [
        (Point.ESTIMATED, _exclude, "exclude_satellite must be called at Point.MEASURED, got a call in 'stage late'"),
        (Point.MEASURED, lambda epoch, v: refuse_fix(epoch.work[v]), "refuse_fix must be called at Point.ESTIMATED"),
        (Point.BOUNDED, lambda epoch, v: refuse_doppler(epoch.work[v]), "refuse_doppler must be called at Point.ESTIM"),
        (Point.REPORTED, lambda epoch, v: raise_alert(epoch.work[v], 5), "raise_alert must be called at Point.BOUNDED"),
    ],
)
def test_a_call_where_it_has_no_effect_is_refused(point: Point, call: Any, message: str) -> None:
    def stage(first: int, last: int, epoch: Any, own: object) -> None:
        for v in range(first, last):
            call(epoch, v)

    extra_stages.register_stages("late", "", (), {point: stage})
    navigator = Navigator.nominal(NavigatorConfig.load({"stages": ["late"]}), [1], duration_s=10.0)
    with pytest.raises(InputError, match=message):
        _drive(navigator, range(30))


@pytest.mark.parametrize("code", [1, 77])
def test_a_mode_writes_its_own_code_alone(code: int) -> None:
    def pretend(first: int, last: int, epoch: Any, own: Any) -> None:
        epoch.work["mode"][first:last] = code

    own = register_mode("pretend", "pretend", pretend)
    navigator = Navigator.nominal(NavigatorConfig.load({"modes": ["doppler", "pretend"]}), [1], duration_s=10.0)
    message = f"w.mode after 'mode pretend' must be own.code = {int(own)} where it was UNDECIDED, .*got {code} in place"
    with pytest.raises(InputError, match=message):
        _drive(navigator, range(5))


def test_a_mode_of_another_form_is_refused() -> None:
    with pytest.raises(InputError, match="name of a mode must be an identifier, got 'my mode'"):
        register_mode("my mode", "", _nothing)
    with pytest.raises(InputError, match="stage of mode 'mine' must be a function"):
        register_mode("mine", "", None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="name of AlertReason must be an identifier, got 'too weak'"):
        AlertReason.register("too weak", "")


# A kind of navigator


def test_a_kind_drives_within_its_levels(odometer_gyro: ModuleType) -> None:
    config = NavigatorConfig.load({"kind": "odometer_gyro", "scale": 0.03})
    assert NavigatorConfig.from_json(config.to_json()) == config
    navigator = Navigator.nominal(config, [1, 2, 3], duration_s=30.0)
    assert isinstance(navigator, odometer_gyro.OdometerGyroNavigator)
    assert np.isinf(_drive(navigator, range(1))[0].pl_at_m).all()
    navigator.place(np.zeros((3, 2)), np.zeros(3), 0.05, 0.005)
    run = _drive(navigator, range(100))
    for epoch, solution in enumerate(run):
        assert (_error_m(solution, epoch) <= solution.pl_ct_m[:, None]).all()
    assert (run[-1].pl_ct_m > run[0].pl_ct_m).all()
    assert run[-1].pl_ct_m.max() < 40.0


def test_a_configuration_derived_from_one_of_a_kind_makes_a_navigator_of_that_kind(odometer_gyro: ModuleType) -> None:
    class Derived(odometer_gyro.OdometerGyroConfig):  # type: ignore[name-defined, misc]
        pass

    assert type(Navigator.nominal(Derived(), [1], duration_s=10.0)) is odometer_gyro.OdometerGyroNavigator
    with pytest.raises(ConfigError, match=r"config must be of .*OdometerGyroConfig.* or of a class"):
        navigator_class(int)


def test_a_kind_drives_environments_the_engine_and_the_command(odometer_gyro: ModuleType) -> None:
    config = {"navigator": {"kind": "odometer_gyro"}}
    env = gymnasium.make(KEEPING, config=config)
    env.reset(seed=1)
    info = [env.step(np.zeros(2, dtype=np.float32))[4] for _ in range(3)][-1]
    env.close()
    assert info["mode"] == Mode.IMU_ODOMETER
    assert abs(info["err_at_m"]) <= info["pl_at_m"] < 10.0
    engine = gymnasium.make_vec(KEEPING, num_envs=3, config=config)
    engine.reset(seed=1)
    for _ in range(3):
        infos = engine.step(np.zeros((3, 2), dtype=np.float32))[4]
    engine.close()
    assert (np.abs(infos["err_ct_m"]) <= infos["pl_ct_m"]).all()
    np.testing.assert_allclose(infos["pl_ct_m"][0], info["pl_ct_m"], rtol=1e-3)
    done = CliRunner().invoke(
        app, ["drive", "LaneKeeping", "--set", "navigator=odometer_gyro", "--set", "duration_s=2", "--json"]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["all"]["share of imu_odometer"] == 1.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "filter", "service": "spp"}, "service is a key of kind rtk_reckoning, not of filter: leave it out, "),
        ({"monitor": "ibpl"}, "monitor is a key of kind monitored_codes, not of rtk_reckoning: leave it out, or ch"),
        ({"kind": "filter", "alrt": 1}, r"alrt is not a known key: did you mean 'alert'\?"),
    ],
)
def test_a_key_of_another_kind_is_told_as_such(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^{message}"):
        NavigatorConfig.load(given)
    with pytest.raises(ConfigError, match=rf"^navigator\.{message}"):
        open_env("LaneKeeping", {"navigator": given})


def test_an_unknown_kind_is_refused_with_the_way_to_register_it() -> None:
    kinds = "filter, monitored_codes, rtk_reckoning"
    for given, message in (
        ("compass", rf"^navigator must be a kind \({kinds}\) or a preset \(.*\), got 'compass': import"),
        ({"kind": "compass"}, rf"kind must be one of {kinds}, got 'compass': import"),
        ({"kind": "spp"}, rf"kind must be one of {kinds}, got 'spp': it is a preset, give services/spp without 'kind'"),
        ("services/sp", r"^navigator must be a kind .*, got 'services/sp': did you mean 'services/spp'\?"),
        ("skies/open", r"^navigator must be a kind .*, got 'skies/open': did you mean 'services/ppp_open'"),
    ):
        with pytest.raises(ConfigError, match=message):
            gymnasium.make(KEEPING, config={"navigator": given}).reset(seed=1)
    with pytest.raises(ConfigError, match="'no_such:kind' must name a module that can be imported"):
        NavigatorConfig.load({"kind": "no_such:kind"})
