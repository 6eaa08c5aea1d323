"""What the predictive driver looks ahead with: levels that grow as those of the navigation do, and fall with RTK."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.horizon import GrowthConfig, predicted_levels
from lanebound.agents.episodes import open_env
from lanebound.envs.observation import ObservationConfig
from lanebound.integrity.sensors.faults import Fault, FaultKind

G = GrowthConfig()
DT_S = 0.2
READER = Reader(ObservationConfig(form="flat"))
OUTAGES = [
    Fault.load({"kind": FaultKind.CORRECTIONS_LOSS, "start_s": start, "duration_s": 7.0}) for start in (1.0, 13.0, 25.0)
]
AHEAD_S = (0.5, 1.0, 2.0, 4.0)


def seen(**values: float) -> Any:
    """A moment on RTK under an open sky; dots are written as ``__``."""
    shown = {"integrity__pl_at": 0.2, "integrity__pl_ct": 0.2}
    shown |= {f"road__sky_{d:g}m_own": 30.0 for d in READER.config.satellites_m}
    out = np.zeros(len(READER.columns), dtype=np.float32)
    for name, value in (shown | values).items():
        column = name.replace("__", ".")
        out[READER.columns.index(column)] = value / READER.scale(column)
    return out


def outages(sky: str, seeds: tuple[int, ...]) -> list[tuple[float, float, float]]:
    """Time since RTK, and measured level by the one foretold on RTK before, along and across, at every decision."""
    env = open_env("LaneKeeping", {"sky": sky, "world": {"duration": 33.0}})
    driver, reader, out = make_agent("lqr", env), Reader(env.config.observation), []
    times = DT_S * np.arange(1.0, 31.0)
    for seed in seeds:
        observation, info = env.reset(seed=seed, options={"faults": OUTAGES})
        over, foretold = False, None
        while not over:
            since = env.cockpit.belief().since_rtk_s
            linked = float(reader.value(observation, "integrity.corrections_age")) < G.link_age_s
            if since <= G.rtk_s:
                way = times * info["speed_mps"]
                foretold = None if linked else predicted_levels(reader, observation, way, DT_S, G)
            elif foretold is not None and since < times[-1]:
                at, ct = (float(np.interp(since, times, level)) for level in foretold)
                out.append((since, info["pl_at_m"] / at, info["pl_ct_m"] / ct))
            observation, _, terminated, truncated, info = env.step(driver.predict(observation)[0])
            over = terminated or truncated
    return out


@pytest.mark.parametrize("sky", ["urban", "dense"])
def test_levels_are_foretold_as_the_navigation_declares_them(sky):
    """Seeds that the law was not fitted on; medians within a quarter, 8 of 10 as widely spread as stated."""
    assert open_env("LaneKeeping", {}).dt_s == DT_S
    found = np.array(outages(sky, (1400, 1401)))
    early = found[found[:, 0] <= AHEAD_S[-1], 1:]
    low, high = np.quantile(early, [0.1, 0.9], axis=0)
    for ahead in AHEAD_S:
        ratios = found[np.abs(found[:, 0] - ahead) < 0.11, 1:]
        assert len(ratios) >= 4
        middle = np.median(ratios, axis=0)
        assert np.all((middle > 0.75) & (middle < 1.25)), (ahead, middle)
    assert np.all(low > 0.6), low
    assert np.all(high < 1.7), high


def test_levels_are_a_sawtooth():
    way = np.arange(1.0, 31.0) * 4.0  # 20 m/s, 0.2 s
    assert all(np.allclose(level, 0.2, atol=1e-6) for level in predicted_levels(READER, seen(), way, DT_S, G))
    at, ct = predicted_levels(READER, seen(road__sky_40m_own=3.0, road__sky_20m_own=3.0), way, DT_S, G)
    inside = ct[(way >= 20.0) & (way < 40.0)]
    assert np.all(ct[way < 20.0] == pytest.approx(0.2))
    assert np.all(np.diff(inside) > 0.0)
    assert np.all(np.diff(inside, 2) < 0.0)
    assert ct.max() > ct[-1]
    assert at[-1] <= G.reset_at_m


def test_a_second_without_rtk_gains_what_is_stated_and_later_ones_less():
    way = np.zeros(20)
    out = predicted_levels(READER, seen(integrity__corrections_age=5.0), way, DT_S, G)
    assert [level[4] - 0.2 for level in out] == pytest.approx([G.growth_at_m, G.growth_ct_m], abs=1e-6)
    values = {"integrity__since_rtk": 5.0, "integrity__corrections_age": 7.0}
    late = predicted_levels(READER, seen(**values), way, DT_S, G)
    assert late[0][4] - 0.2 == pytest.approx(G.growth_at_m * (6.0**G.growth_power - 5.0**G.growth_power), abs=1e-6)
    whole = G.gained_m(0.0, 4.0)
    assert np.add(G.gained_m(0.0, 1.0), G.gained_m(1.0, 3.0)) == pytest.approx(whole)


def test_an_open_sky_ends_an_outage_and_a_link_that_is_out_does_not():
    values, way = {"integrity__since_rtk": 3.0, "integrity__pl_at": 2.0, "integrity__pl_ct": 2.0}, np.zeros(20)
    at, _ = predicted_levels(READER, seen(**values), way, DT_S, G)
    assert np.all(np.diff(at[: round(G.refix_s / DT_S)]) > 0.0)
    assert at[-1] == G.reset_at_m
    at, _ = predicted_levels(READER, seen(**values, integrity__corrections_age=5.0), way, DT_S, G)
    assert np.all(np.diff(at) > 0.0)
    held, _ = predicted_levels(READER, seen(integrity__corrections_age=G.link_age_s + 0.1), way, DT_S, G)
    assert held[0] > 0.2
