"""Drivers with margins: wider with protection levels, slower for alerts and known outages, blind where said so."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from lanebound.agents.benchmark.scoring import outcome_of
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.aware import AwareConfig, IntegrityAware
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.margins import Cautious, CautiousConfig, Rss, RssConfig, TunedCaution, rss_speed
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plan import Plan
from lanebound.agents.drivers.plans import CruiseConfig
from lanebound.agents.drivers.scaled import LevelScaled, ScaledConfig
from lanebound.agents.drivers.stop import StopConfig, StopOnAlert
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.envs import IDS, make_config
from lanebound.envs.batch.costs_kernel import rss_distance_m
from lanebound.envs.batch.rules import cost_figures
from lanebound.envs.costs import CostConfig
from lanebound.envs.sky import SKY_LEVELS
from lanebound.integrity.core.errors import ConfigError, InputError

GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
LIMIT_MPS = 50.0 / 3.6


@pytest.fixture(scope="module")
def env() -> Any:
    return open_env("CarFollowing", GIVEN | {"observation": {"form": "flat"}})


def seen(
    reader: Reader, gap_m: float | None = None, lead_mps: float = 10.0, v: float = 10.0, **values: float
) -> np.ndarray:
    """A calm moment on a straight road under an open sky, perhaps with a car ahead; dots are written as ``__``."""
    shown = {"ego__speed": v, "road__speed_limit": LIMIT_MPS, "ego__lane_width": 3.25, "road__lane_end": 150.0}
    for d in reader.config.satellites_m:
        shown[f"road__sky_{d:g}m_own"] = 30.0
        shown |= {f"road__sky_{d:g}m_{lane}": -40.0 for lane in ("left", "right")}
    if gap_m is not None:
        row = {"present": 1.0, "own_lane": 1.0, "lane_gap": gap_m + 5.0, "length": 5.0, "velocity_ahead": lead_mps - v}
        shown |= {f"traffic__v0_{name}": value for name, value in row.items()}
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in (shown | values).items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = value / reader.scale(column)
    return out


@pytest.mark.parametrize("v", [3.0, 8.0, 14.0])
@pytest.mark.parametrize("lead", [0.0, 6.0, 14.0])
def test_at_the_safe_speed_the_gap_is_the_distance_that_costs_are_judged_by(v, lead):
    distance = rss_distance_m(v, lead, cost_figures(CostConfig())[0])
    speed = float(rss_speed(np.array(distance), np.array(lead), RssConfig()))
    assert speed == pytest.approx(v) if distance > 0.0 else speed >= v


@pytest.mark.parametrize(
    ("plan", "config"), [(Rss, RssConfig()), (IntegrityAware, AwareConfig()), (LevelScaled, ScaledConfig())]
)
def test_a_larger_level_keeps_a_larger_gap(env, plan, config):
    driver = plan(env, config)
    accelerations, speeds = [], []
    for pl in (0.0, 1.0, 3.0, 8.0):
        shown = seen(driver.reader, 20.0, traffic__v0_pl_at=pl, traffic__v0_pl_exists=1.0)
        accelerations.append(float(driver.acceleration(shown)))
        speeds.append(float(driver.top_speed(shown)))
    assert accelerations == sorted(accelerations, reverse=True)
    assert speeds == sorted(speeds, reverse=True)
    assert accelerations[-1] < accelerations[0] - 0.3


@pytest.mark.parametrize("plan", [Plan, Nominal, Rss, Cautious, IntegrityAware, StopOnAlert])
def test_all_brake_as_the_gap_closes(env, plan):
    config = {Rss: RssConfig, Cautious: CautiousConfig, IntegrityAware: AwareConfig, StopOnAlert: StopConfig}
    driver = plan(env, config.get(plan, CruiseConfig)())
    gaps = [float(driver.acceleration(seen(driver.reader, gap, 6.0))) for gap in (100.0, 40.0, 25.0, 15.0, 5.0)]
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[0] > 0.0 or plan is Cautious
    assert gaps[-1] == pytest.approx(-5.0)


def test_cautious_is_slower_and_further_away_but_reads_no_levels(env):
    calm, careful = Nominal(env, CruiseConfig()), Cautious(env, CautiousConfig())
    shown = seen(calm.reader, 25.0)
    assert careful.acceleration(shown) < calm.acceleration(shown)
    assert careful.wanted_speed(shown) == pytest.approx(0.8 * LIMIT_MPS, rel=1e-5)
    assert careful.lead(shown)[0] == pytest.approx(25.0 - careful.config.gap_m, rel=1e-5)
    aside = seen(calm.reader, 25.0, traffic__v0_own_lane=0.0, traffic__v0_lane_offset=1.8)
    assert careful.lead(aside)[0] < 30.0 < calm.lead(aside)[0]


def test_tuned_margins_are_taken_where_they_were_found():
    street = make_config("lanebound/CarFollowing-v0", {"sky": "urban"})
    tuned = TunedCaution.load({"at": {street.base: {"urban": {"speed_share": 0.5, "gap_m": 7.0}}}})
    assert tuned.of(street).speed_share == 0.5
    assert tuned.of(street.replace(sky="open")) == CautiousConfig()
    assert tuned.of(make_config("lanebound/Merge-v0", {"sky": "urban"})) == CautiousConfig()


def test_tuned_margins_name_worlds_and_skies_that_there_are():
    at = TunedCaution.preset("drivers/cautious").at
    assert set(at) <= {make_config(env_id).base for env_id in IDS}
    assert {sky for skies in at.values() for sky in skies} <= set(SKY_LEVELS)


@pytest.mark.parametrize("agent", ["cruise", "nominal", "cautious"])
@pytest.mark.parametrize("name", ["CarFollowing", "UrbanCanyon"])
def test_the_blind_do_the_same_without_levels(agent, name):
    envs = [real(name, kind) for kind in ("full", "blind")]
    actions = [make_agent(agent, env).predict(env.reset(seed=2)[0])[0] for env in envs]
    assert np.array_equal(*actions)


@pytest.mark.parametrize("agent", ["rss", "integrity_aware", "level_scaled", "stop_on_alert"])
def test_who_needs_levels_says_so_when_blind(agent):
    env = open_env("LaneKeeping", GIVEN | {"observation": {"integrity": "blind"}})
    with pytest.raises(InputError, match=r"observation must show 'integrity\."):
        make_agent(agent, env)


def test_the_oracle_asks_for_the_true_state_and_drives_as_nominal():
    with pytest.raises(InputError, match=r"observation\.integrity must be oracle.*got full"):
        make_agent("oracle", open_env("LaneKeeping", GIVEN))
    env = open_env("LaneKeeping", GIVEN | {"observation": {"integrity": "oracle"}})
    shown = env.reset(seed=2)[0]
    assert np.array_equal(*(make_agent(name, env).predict(shown)[0] for name in ("oracle", "nominal")))


def test_a_stop_follows_an_alert(env):
    driver = StopOnAlert(env, StopConfig())
    assert driver.acceleration(seen(driver.reader)) > 0.0
    assert driver.acceleration(seen(driver.reader, integrity__alert=1.0)) == -driver.config.stop_mps2
    assert driver.acceleration(seen(driver.reader, 3.0, 0.0, integrity__alert=1.0)) == -driver.config.brake_max_mps2
    assert driver.top_speed(seen(driver.reader, integrity__alert=1.0)) == 0.0


def test_an_alert_slows_and_dead_reckoning_beyond_its_time_stops(env):
    driver = IntegrityAware(env, AwareConfig())
    c, reader = driver.config, driver.reader
    assert driver.wanted_speed(seen(reader)) == pytest.approx(LIMIT_MPS, rel=1e-5)
    alert = {"integrity__alert": 1.0, "integrity__ratio_ct": 2.0}
    slow = driver.wanted_speed(seen(reader, integrity__since_rtk=5.0, **alert))
    assert slow == pytest.approx(c.alert_share * LIMIT_MPS, rel=1e-5)
    assert driver.acceleration(seen(reader, v=13.0, **alert)) == -c.slow_mps2
    late = {"integrity__since_rtk": c.dead_reckoning_s + 1.0} | alert
    assert driver.wanted_speed(seen(reader, **late)) == 0.0
    assert driver.wanted_speed(seen(reader, integrity__since_rtk=59.0)) > slow  # by code alone, without an alert
    lasting = {"integrity__since_rtk": 0.0, "integrity__alert_age": c.dead_reckoning_s + 1.0} | alert
    assert driver.wanted_speed(seen(reader, **lasting)) == 0.0  # new positions of a service, whose levels are too large


def test_a_level_across_stops_the_car_where_that_is_configured(env):
    driver = IntegrityAware(env, AwareConfig(stop_ct_m=4.5))
    wide = {"integrity__since_rtk": 5.0, "integrity__ratio_ct": 3.0, "integrity__pl_ct": 4.6}
    assert driver.wanted_speed(seen(driver.reader, integrity__alert=1.0, **wide)) == 0.0
    assert driver.wanted_speed(seen(driver.reader, integrity__alert=1.0, **(wide | {"integrity__pl_ct": 4.4}))) > 0.0
    assert driver.wanted_speed(seen(driver.reader, **wide)) > 0.0  # without an alert
    assert IntegrityAware(env, AwareConfig()).wanted_speed(seen(driver.reader, integrity__alert=1.0, **wide)) > 0.0
    with pytest.raises(ConfigError, match=r"stop_ct_m must be <= 10, .* got 11: lower it"):
        IntegrityAware(env, AwareConfig(stop_ct_m=11.0))


def test_where_only_the_link_is_out_the_car_waits(env):
    driver = IntegrityAware(env, AwareConfig())
    cut = {"integrity__alert": 1.0, "integrity__corrections_age": 5.0, "integrity__since_rtk": 5.0}
    assert driver.wanted_speed(seen(driver.reader, **cut)) == 0.0
    assert driver.wanted_speed(seen(driver.reader, **(cut | {"road__sky_0m_own": 8.0}))) > 0.0


def test_levels_near_their_limit_slow(env):
    driver = IntegrityAware(env, AwareConfig())
    speeds = [float(driver.wanted_speed(seen(driver.reader, integrity__ratio_ct=r))) for r in (0.3, 0.6, 0.8, 1.0, 3.0)]
    slow = driver.config.alert_share * LIMIT_MPS
    assert speeds == pytest.approx([LIMIT_MPS, LIMIT_MPS, 0.5 * (slow + LIMIT_MPS), slow, slow], rel=1e-5)


def test_beyond_its_time_it_goes_on_where_that_leads_out_into_the_open(env):
    driver = IntegrityAware(env, AwareConfig())
    c, reader = driver.config, driver.reader
    dark = {f"road__sky_{d:g}m_own": 4.0 for d in reader.config.satellites_m}
    late = {"integrity__alert": 1.0, "integrity__since_rtk": c.dead_reckoning_s + 1.0, **dark}
    near = late | {"road__sky_20m_own": 30.0, "road__sky_40m_own": 30.0}
    assert driver.wanted_speed(seen(reader, **late)) == 0.0
    assert driver.wanted_speed(seen(reader, **near)) == pytest.approx(c.alert_share * LIMIT_MPS, rel=1e-5)
    over = near | {"integrity__since_rtk": c.dead_reckoning_s + c.grace_s + 1.0}
    assert driver.wanted_speed(seen(reader, **over)) == 0.0


def test_known_outages_slow_in_time(env):
    driver = IntegrityAware(env, AwareConfig())
    reader, c = driver.reader, driver.config
    slow = c.alert_share * LIMIT_MPS

    def wanted(*dark: float) -> float:
        return float(driver.wanted_speed(seen(reader, **{f"road__sky_{d:g}m_own": 8.0 for d in dark})))

    assert wanted(0.0, 20.0) == pytest.approx(slow, rel=1e-5)
    assert wanted(20.0, 40.0) == pytest.approx(np.sqrt(slow**2 + 2.0 * c.brake_mps2 * 20.0), rel=1e-5)
    assert wanted(20.0) == wanted(80.0, 160.0) == pytest.approx(LIMIT_MPS, rel=1e-5)  # too short, or far enough off
    unknown = {f"road__sky_{d:g}m_own": -40.0 for d in reader.config.satellites_m}
    assert driver.wanted_speed(seen(reader, **unknown)) == pytest.approx(LIMIT_MPS, rel=1e-5)


def test_the_open_lane_is_sought_but_not_under_an_alert():
    env = open_env("UrbanCanyon", GIVEN | {"observation": {"form": "flat"}})
    driver = IntegrityAware(env, AwareConfig())
    points = driver.reader.config.satellites_m
    open_left = {"ego__left_exists": 1.0, "road__junction": 150.0}
    open_left |= {f"road__sky_{d:g}m_own": 8.0 for d in points} | {f"road__sky_{d:g}m_left": 30.0 for d in points}
    assert driver.change(seen(driver.reader, **open_left)) == -1
    assert driver.change(seen(driver.reader, **open_left, integrity__alert=1.0)) == 0
    both_dark = open_left | {f"road__sky_{d:g}m_left": 8.0 for d in points}
    assert driver.change(seen(driver.reader, **both_dark)) == 0


@cache
def short(name: str, kind: str) -> Any:
    """An environment of 12 s."""
    return open_env(name, GIVEN | {"world": {"duration": 12.0}, "observation": {"integrity": kind}})


@cache
def real(name: str, kind: str) -> Any:
    """An environment with its navigator, under an open sky."""
    return open_env(name, {"sky": "open", "observation": {"integrity": kind}})


@pytest.mark.parametrize("agent", ["rss", "cautious", "integrity_aware", "level_scaled", "stop_on_alert", "oracle"])
@pytest.mark.parametrize("name", ["LaneKeeping", "CarFollowing", "UrbanCanyon"])
def test_a_short_drive_ends_well_and_the_same_each_time(agent, name):
    kind = "oracle" if agent == "oracle" else "full"
    env = short(name, kind)
    ends = []
    for _ in range(2):
        log = EpisodeLog()
        drive(env, make_agent(agent, env), [3], [log])
        summary = outcome_of(log.episode(0), 0.0)
        assert summary.ended == "time up"
        assert summary.costs["cost_lane"] == summary.costs["cost_collision"] == 0.0
        ends.append((summary.total_return, summary.cost, log.episode(0)[-1]["true_x_m"]))
    assert ends[0] == ends[1]
