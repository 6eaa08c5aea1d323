"""A monitor that a user registers is a monitor like any other: listed, compared, and driven with."""

from __future__ import annotations

import importlib

import gymnasium
import numpy as np
import pytest
from code_geometry import quiet

import lanebound.envs  # noqa: F401
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.kinds import FAMILY, monitor_named, register_monitor, withdraw_monitor
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.significance import two_sided_factor
from lanebound.integrity.navigators.navigator import NavigatorConfig


@pytest.fixture
def registered() -> None:
    importlib.import_module("twice_normal")


def test_its_level_is_that_of_its_function(registered) -> None:
    """Twice that of the kind ``normal``, where neither raises an alarm."""
    risks = np.array([1e-3, 1e-5])
    mine, theirs = (
        watch(quiet(25, 10, 2, 40), monitor_named(name).config(), risks) for name in ("twice_normal", "normal")
    )
    both = np.isfinite(mine.hpl_m).all(-1) & np.isfinite(theirs.hpl_m).all(-1)
    assert both.sum() > 10
    np.testing.assert_allclose(
        mine.hpl_m[both, 1] / mine.hpl_m[both, 0], np.divide(*two_sided_factor(risks)[::-1]), rtol=1e-12
    )
    np.testing.assert_array_equal(mine.position_enu_m[both], theirs.position_enu_m[both])


def test_it_drives_by_its_bare_name_and_by_that_of_its_module() -> None:
    config = {"navigator": {"kind": "monitored_codes", "monitor": "twice_normal:twice_normal"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=config)
    env.reset(seed=1)
    for _ in range(5):
        info = env.step(env.action_space.sample())[4]
    env.close()
    assert np.isfinite(info["pl_ct_m"])
    assert NavigatorConfig.load({"kind": "monitored_codes", "monitor": "twice_normal"}).monitor.kind == "twice_normal"


def test_wrong_registrations_are_refused_and_leave_nothing() -> None:
    before = dict(FAMILY)
    with pytest.raises(InputError, match="must not be taken, got 'ibpl'"):
        register_monitor("ibpl", "", "", "")
    with pytest.raises(InputError, match=r"needs must be among .*, got 'radar'"):
        register_monitor("mine", "", "", "", needs=("radar",))
    with pytest.raises(InputError, match="level of monitor 'mine' must be a function of a LevelWork, got 3"):
        register_monitor("mine", "", "", "", level=3)
    with pytest.raises(InputError, match="name of a monitor must be an identifier, got 'my own'"):
        register_monitor("my own", "", "", "")
    with pytest.raises(ConfigError, match="false_alarm"):
        register_monitor("mine", "", "", "", false_alarm=2.0)
    with pytest.raises(ConfigError, match="own_level is required"):
        FamilyMonitorConfig.load({"level": "own"})
    with pytest.raises(InputError, match="the monitors of the package stay"):
        withdraw_monitor("ibpl")
    with pytest.raises(ConfigError, match="monitor must be one of the family, got 'mine'"):
        monitor_named("mine")
    assert before == FAMILY


@pytest.mark.parametrize(
    ("level", "message"),
    [
        (lambda work: -work.fit.major_m[:, None] * np.ones(2), "level of monitor 'mine' must be >= 0, got -"),
        (
            lambda work: np.nan * work.fit.major_m[:, None] * np.ones(2),
            "must be >= 0, got nan: inf stands for",
        ),
        (lambda work: work.fit.major_m, r"must have shape \(epochs, risks\) = \(25, 2\), got \(25,\)"),
        (lambda work: None, r"must have shape \(epochs, risks\) = \(25, 2\), got \(\)"),
    ],
)
def test_a_level_that_is_none_is_refused(level, message) -> None:
    register_monitor("mine", "", "", "", level=level, test="global")
    with pytest.raises(InputError, match=message):
        watch(quiet(25, 10, 2, 40), monitor_named("mine").config(), np.array([1e-3, 1e-5]))


def test_a_withdrawn_monitor_is_unknown(registered) -> None:
    withdraw_monitor("twice_normal")
    with pytest.raises(ConfigError, match="twice_normal"):
        NavigatorConfig.load({"kind": "monitored_codes", "monitor": "twice_normal"})


def test_the_former_key_of_stages_names_the_new_one() -> None:
    with pytest.raises(ConfigError, match="monitors must be named stages"):
        NavigatorConfig.load({"monitors": ["interference"]})
