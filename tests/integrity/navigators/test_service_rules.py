"""Services by key: what the rest of a configuration does not serve is refused; services from outside."""

from __future__ import annotations

import importlib
import pickle
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.observation import entries
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.services.config import CodeServiceConfig
from lanebound.integrity.navigators.services.table import SERVICES, register_service, withdraw_service
from lanebound.integrity.positioning.modes import Mode

DFMC: dict[str, Any] = {"service": "sbas_dfmc", "gnss": {"bands": [0, 2]}}
KEEPING = "lanebound/LaneKeeping-v0"


@pytest.fixture
def galileo() -> ModuleType:
    return importlib.import_module("galileo")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"service": "sbas_dfmc"}, r"gnss\.bands must have 2 \(L5\) as its second band .*sbas_dfmc, got \[0, 1\]: set"),
        ({"service": "sbas_dfmc", "gnss": {"bands": [2, 0]}}, r"gnss\.bands must begin with 0 \(L1\)"),
        ({"service": "ppp", "gnss": {"bands": [0]}}, r"1 \(L2\) or 2 \(L5\) as its second band .*got \[0\]"),
        ({"service": "spp", "gnss": {"bands": [1]}}, r"must begin with 0 \(L1\) for the service spp, got \[1\]"),
        ({"service": ["rtk", "dgps"], "gnss": {"bands": [1, 2]}}, r"must begin with 0 \(L1\) for the service dgps"),
        ({"service": "rtk", "gnss": {"bands": [0, 0]}}, r"gnss.bands.* must differ, got \[0, 0\]: name each one once"),
        (DFMC | {"services": {"sbas_dfmc": {"systems": ["GLONASS"]}}}, r"sbas_dfmc\.systems must be among .*'GLONASS'"),
        ({"service": "sbas_l1", "services": {"sbas_l1": {"systems": ["GPS", "BEIDOU"]}}}, "got 'BEIDOU': remove it"),
        ({"service": "sbas_l1", "services": {"sbas_l1": {"max_age_s": 8.0}}}, r"max_age_s must be >= 9, .*got 8"),
        ({"service": "nrtk"}, r"float_solution must be sequential with ionosphere_m >= 0\.0025 .*, got epoch with 0"),
        ({"service": "sbas_l1", "sky": {"gps": 0}}, r"sky must have satellites of GPS for the service sbas_l1"),
    ],
)
def test_a_service_that_would_run_worse_without_a_word_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        NavigatorConfig.load(given)


def test_an_environment_refuses_it_with_the_whole_path() -> None:
    with pytest.raises(ConfigError, match=r"navigator\.gnss\.bands must have 2 \(L5\) as its second band"):
        gymnasium.make(KEEPING, config={"navigator": {"service": "sbas_dfmc"}}).reset(seed=1)


def test_a_service_by_key_with_the_bands_that_it_needs_is_its_preset() -> None:
    for name, bands in (("sbas_dfmc", [0, 2]), ("ppp", [0, 2])):
        given = NavigatorConfig.preset(f"services/{name}").replace(service=[name])
        assert NavigatorConfig.load({"service": name, "gnss": {"bands": bands}}) == given
    assert NavigatorConfig.load({"service": "ppp"}).gnss.bands == (0, 1)  # L1 and L2 are free of the ionosphere too


def test_a_mapping_of_a_service_leaves_its_other_declared_errors_as_they_are() -> None:
    for name in ("spp", "dgps", "sbas_l1", "ppp"):
        plain = getattr(NavigatorConfig().services, name)
        changed = getattr(NavigatorConfig.load({"services": {name: {"max_hdop": 3.0}}}).services, name)
        assert changed == plain.replace(max_hdop=3.0)
    sent = NavigatorConfig.load({"gnss": {"augmentation": {"ppp": {"interval_s": 6.0}}}}).gnss.augmentation.ppp
    assert (sent.residual_m, sent.interval_s) == (0.03, 6.0)


@pytest.mark.parametrize("hour", [0, 6, 13, 20])
def test_network_rtk_fixes_without_a_known_place_at_any_hour(hour: int) -> None:
    """With the atmosphere as states; integers of few satellites alone would exceed the risk of wrong ones."""
    config = NavigatorConfig.preset("services/nrtk").replace(sky={"week_second_s": 180_000.0 + 3600.0 * hour})
    navigator = Navigator.nominal(config, seeds=[1, 2, 3], duration_s=60.0)
    zero, still = np.zeros((3, 2)), np.zeros(3)
    fixed = np.zeros(3, bool)
    for k in range(100):
        truth = truth_between(0.1 * (k + 1), 0.1, (zero, zero), (zero, zero), (still, still))
        solution = navigator.step(truth)
        fixed |= solution.mode == Mode.NRTK
    assert fixed.all()
    assert np.abs(solution.position_en_m).max() < 0.05


def test_a_service_from_outside_drives_alone_and_in_the_engine(galileo: ModuleType) -> None:
    navigator = {"service": "galileo", "gnss": {"bands": [0, 2]}}
    given = {"navigator": navigator, "sky": "open", "navigation": {"start_sigma_m": 10.0}}
    single = gymnasium.make(KEEPING, config=given)
    engine = gymnasium.make_vec(KEEPING, 2, config=given, vectorization_mode="vector_entry_point")
    shown = [entry.name for entry in entries(single.unwrapped.config.observation) if entry.group == "integrity"]
    alone, info = single.reset(seed=3)
    together, _ = engine.reset(seed=3)
    modes = []
    for _ in range(6):
        np.testing.assert_array_equal(alone["integrity"], together["integrity"][0])
        modes.append((Mode(info["mode"]).key, float(alone["integrity"][shown.index("mode_galileo")])))
        alone, _, _, _, info = single.step(np.zeros(2, np.float32))
        together, *_ = engine.step(np.zeros((2, 2), np.float32))
    assert ("galileo", 1.0) in modes
    assert all((name == "galileo") == bool(value) for name, value in modes)
    single.close()
    engine.close()
    assert pickle.loads(pickle.dumps(galileo.GALILEO)) is galileo.GALILEO


def test_a_service_from_outside_has_levels_that_hold_and_needs_its_second_band(galileo: ModuleType) -> None:
    with pytest.raises(ConfigError, match=r"2 \(L5\) as its second band for the service galileo, got \[0, 1\]"):
        NavigatorConfig(service="galileo")
    config = NavigatorConfig(service="galileo:galileo", gnss={"bands": [0, 2]})
    navigator = Navigator.nominal(config, seeds=list(range(8)), duration_s=60.0)
    zero, still = np.zeros((8, 2)), np.zeros(8)
    navigator.place(zero, still, 30.0, 0.01)
    modes = []
    for k in range(20):
        truth = truth_between(0.1 * (k + 1), 0.1, (zero, zero), (zero, zero), (still, still))
        solution = navigator.step(truth)
        modes.append(solution.mode.copy())
    error = np.abs(solution.position_en_m)
    assert (np.array(modes)[4:12] == galileo.GALILEO).mean() > 0.5  # later a level at rest is the lower one
    assert (error <= np.stack([solution.pl_ct_m, solution.pl_at_m], -1)).all()
    assert np.median(error) < 4.0


def test_what_cannot_be_registered_is_refused() -> None:
    declared = CodeServiceConfig()
    with pytest.raises(InputError, match="must not be taken, got 'spp'"):
        register_service("spp", "SPP", "again", declared)
    with pytest.raises(InputError, match="provider must be among dgps"):
        register_service("mine", "mine", "nothing", declared, provider="nobody")
    with pytest.raises(InputError, match="second must name a band"):
        register_service("mine", "mine", "nothing", declared, combined=True)
    with pytest.raises(InputError, match="service of the package cannot be removed, got 'spp'"):
        withdraw_service("spp")
    assert "mine" not in SERVICES
