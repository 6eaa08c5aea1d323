"""The study of two vehicles and two roadside units: parts by drive, summaries, tables."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lanebound.agents.studies.cooperative import (
    CooperativeStudyConfig,
    error_rows,
    level_rows,
    moments,
    run_cooperative,
)
from lanebound.integrity.core.errors import ConfigError

SMALL = {"skies": ("open",), "seeds": 1, "warm_up_s": 12.0, "duration_s": 8.0, "few_s": 4.0, "particles": 50}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    config = CooperativeStudyConfig(**SMALL, cases=("codes", "few", "unit"))
    out = tmp_path_factory.mktemp("cooperative")
    first = run_cooperative(config, out)
    assert run_cooperative(config, out) == first  # from its parts
    assert json.loads((out / "cooperative.json").read_text())["skies"] == json.loads(json.dumps(first["skies"]))
    return first


def test_errors_are_compared_with_those_of_vehicles_alone(result):
    heads, rows = error_rows(result)
    ratio = {(row[1], row[2]): float(row[heads.index("of alone")]) for row in rows if row[0] == "open"}
    assert ratio["codes", "local"] == 1.0
    assert ratio["codes", "ekf"] < 0.5
    assert {row[2] for row in rows if row[0] == "S2"} == {"local", "ekf", "mdpc", "spawn", "md_spawn"}
    assert [row[4] for row in rows if row[0] == "S2"] == ["1.00", "0.47", "0.65", "0.64", "0.63"]


def test_few_satellites_still_give_a_position(result):
    few = result["skies"]["open"]["few"]
    assert few["ekf"]["max2d_m"] < 2.0


def test_levels_count_honest_vehicles(result):
    _, rows = level_rows(result)
    assert [row[1] for row in rows] == ["unit"]
    assert 14.0 <= result["skies"]["open"]["unit"]["epochs"] <= 16.0  # two vehicles in eight seconds
    assert result["skies"]["open"]["unit"]["found"] == 1.0


def test_ranges_have_the_errors_of_their_law():
    """Of 240 drives of a second the error of the first range: noise and offset, 5 % late by 0.3 m, 5 % lost."""
    config = CooperativeStudyConfig(skies=("open",))
    found, lost = [], 0
    for number in range(120):
        moment = next(moments(config, "open", number, True))
        place, r = moment.truth.position_enu_m, moment.ranges
        true = np.linalg.norm(place[r.ends[:, 0]] - place[r.ends[:, 1]], axis=-1)
        found.extend(r.range_m - true)
        lost += not any((r.ends == [1, 0]).all(-1))
        assert (true < config.ranging.range_m).all()
    error = np.array(found)
    assert np.median(error) == pytest.approx(0.0, abs=0.02)  # six sigma of the median of 100 and more
    assert 1.4826 * np.median(np.abs(error - np.median(error))) == pytest.approx(np.hypot(0.023, 0.021), rel=0.4)
    assert error.min() > -6.0 * np.hypot(0.023, 0.021)
    assert 0 < (error > 0.15).sum() < 0.15 * len(error)
    assert lost > 0


def test_nobody_ranges_beyond_reach():
    config = CooperativeStudyConfig(skies=("open",), ranging={"range_m": 5.0})
    for number in range(6):
        moment = next(moments(config, "open", number, True))
        ends, place = moment.ranges.ends, moment.truth.position_enu_m
        assert (np.linalg.norm(place[ends[:, 0]] - place[ends[:, 1]], axis=-1) < 5.0).all()


def test_skies_must_be_known():
    with pytest.raises(ConfigError, match="skies must be among open, suburban, urban, dense, got 'plaza'"):
        CooperativeStudyConfig(skies=("plaza",))
