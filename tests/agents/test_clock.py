"""The driver by a clock: no level and no alert of the navigator changes what it does, the time since RTK does."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.clock import ClockConfig, ClockReader
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.opening import full_id
from lanebound.integrity.core.errors import ConfigError

FLAT: dict[str, Any] = {"observation": {"form": "flat"}}
LEVELS = ("pl_", "ratio_", "margin_", "trend_", "alert", "available", "reason_", "permitted_speed", "possible_limit",
          "roads_agree")  # fmt: skip

SEED = 6  # in Guidance it begins on the faster road


def _observations(env: Any, count: int = 40) -> np.ndarray[Any, Any]:
    """Of a drive of the integrity-aware driver."""
    driver, found = make_agent("integrity_aware", env), []
    observation, _ = env.reset(seed=SEED)
    for _ in range(count):
        found.append(observation)
        observation, _, terminated, truncated, _ = env.step(driver.predict(observation)[0])
        if terminated or truncated:
            observation, _ = env.reset()
    return np.array(found)


@pytest.mark.parametrize(("clock", "reads"), [("clock", "integrity_aware"), ("clock_scaled", "level_scaled")])
@pytest.mark.parametrize("name", ["LaneKeeping", "CarFollowing", "Merge", "Guidance"])
def test_levels_and_alerts_do_not_change_what_it_does(name: str, clock: str, reads: str) -> None:
    with closing(open_env(full_id(name), FLAT)) as env:
        seen = _observations(env)
        reader, driver, aware = (
            Reader(env.config.observation),
            make_agent(clock, env),
            make_agent(reads, env),
        )
    of_levels = [
        place
        for place, column in enumerate(reader.columns)
        if (
            column.startswith(tuple(f"integrity.{name}" for name in LEVELS))
            or ("_pl_" in column and env.config.perception.source == "v2v")  # a sensor measures the distance itself
        )
        and column != "integrity.alert_age"  # a timer, which it reads under an alert of its own
    ]
    rng, other = np.random.default_rng(1), seen.copy()
    other[:, of_levels] = rng.uniform(0.0, 1.0, (len(seen), len(of_levels)))
    exists = [place for place in of_levels if reader.columns[place].endswith("exists")]
    other[:, exists] = seen[:, exists]  # flags that say which vehicles there are stay as they are
    assert np.array_equal(driver.predict(seen)[0], driver.predict(other)[0])
    assert not np.array_equal(aware.predict(seen)[0], aware.predict(other)[0]), "levels change what the other one does"


def test_it_is_slower_the_longer_rtk_is_out() -> None:
    with closing(open_env(full_id("LaneKeeping"), FLAT)) as env:
        seen, reader, driver = _observations(env, 1), Reader(env.config.observation), make_agent("clock", env)
    place = reader.columns.index("integrity.since_rtk")
    ages = np.repeat(seen, 3, axis=0)
    ages[:, place] = np.array([0.0, 3.0, 60.0]) / reader.scale("integrity.since_rtk")
    acceleration = driver.predict(ages)[0][:, 0]
    assert acceleration[0] > acceleration[1] >= acceleration[2]


def test_vehicles_of_a_sensor_have_no_level_of_a_position() -> None:
    figures = ClockConfig.load({"age_s": [0.0], "pl_at_m": [7.0], "pl_ct_m": [5.0]})
    with closing(open_env(full_id("Guidance"), FLAT)) as env:
        seen, reader = _observations(env, 1), ClockReader(env.config.observation, figures)
    for k, sensor in enumerate((1.0, 0.0)):
        seen[0, reader.columns.index(f"traffic.v{k}_sensor")] = sensor
        seen[0, reader.columns.index(f"traffic.v{k}_pl_at")] = 0.4 / reader.scale(f"traffic.v{k}_pl_at")
    assert reader.rows(seen, "pl_at")[0, :2] == pytest.approx([0.4, 7.0], rel=1e-5)


def test_levels_are_linear_between_ages() -> None:
    figures = ClockConfig.load({"age_s": [0, 10], "pl_at_m": [1, 2], "pl_ct_m": [0.5, 1.5]})
    with closing(open_env(full_id("LaneKeeping"), FLAT)) as env:
        seen, reader = _observations(env, 1), ClockReader(env.config.observation, figures)
    seen[0, reader.columns.index("integrity.since_rtk")] = 4.0 / reader.scale("integrity.since_rtk")
    assert reader.value(seen, "integrity.pl_at") == pytest.approx([1.4], rel=1e-5)
    assert reader.value(seen, "integrity.pl_ct") == pytest.approx([0.9], rel=1e-5)
    limit = Reader(reader.config).value(seen, "integrity.al_ct")
    assert reader.value(seen, "integrity.ratio_ct") == pytest.approx(0.9 / limit, rel=1e-5)


@pytest.mark.parametrize(
    ("figures", "field"),
    [({"pl_at_m": [1.0]}, "pl_at_m"), ({"age_s": [0, 0], "pl_at_m": [1, 1], "pl_ct_m": [1, 1]}, "age_s")],
)
def test_levels_that_do_not_fit_their_ages_are_refused(figures: dict[str, Any], field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        ClockConfig.load(figures)
