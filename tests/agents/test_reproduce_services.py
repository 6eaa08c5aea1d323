"""The study of services: HDOP against its definition, a small study, and the convergence of PPP."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import services
from lanebound.agents.studies.services import (
    NO_DOP,
    ServiceStudyConfig,
    _arrive,
    _drive,
    _figures,
    approach,
    converge,
    convergence_rows,
    hdop,
    mixed_rows,
    published_rows,
    run_services,
    service_rows,
    streets_of,
    work_street,
)
from lanebound.agents.studies.street_drives import navigator_of
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.visibility import SkyMask


def test_hdop_is_that_of_the_systems_of_the_service() -> None:
    rng = np.random.default_rng(2)
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi, 16), np.deg2rad(rng.uniform(5.0, 85.0, 16))
    los = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], -1)
    system = np.array([int(System.GPS), int(System.GALILEO)] * 8)
    tracked = np.ones((2, 16), bool)
    tracked[1, 3:] = False  # too few
    m = SimpleNamespace(
        sky=SimpleNamespace(los_enu=los[None], index=np.zeros(2, np.int64), system=system),
        gnss=SimpleNamespace(tracked=tracked),
    )
    config = NavigatorConfig(service="sbas_l1")  # GPS, above 10 degrees
    own = (system == int(System.GPS)) & (elevation > np.deg2rad(10.0))
    design = np.column_stack([-los[own], np.ones(own.sum())])
    cofactor = np.linalg.inv(design.T @ design)
    found = hdop(config, m, tracked)
    assert found[0] == pytest.approx(np.sqrt(cofactor[0, 0] + cofactor[1, 1]), rel=1e-9)
    assert found[1] == NO_DOP
    both = hdop(NavigatorConfig(service="spp"), m, tracked)
    assert hdop(config, m, tracked & (np.arange(16) > 3))[0] >= found[0]  # fewer are never better
    assert (hdop(config, m, np.zeros_like(tracked)) == NO_DOP).all()  # none at all
    assert both[0] < found[0]  # more satellites, and clocks of systems without one do not matter


def test_a_small_study_has_all_its_tables(tmp_path: Path) -> None:
    config = ServiceStudyConfig(
        seeds=1, cases=("s4_egnos", "s4_sisnet"), skies=("open", "urban"), vehicles=2, duration_s=3.0, warm_up_s=2.0,
        ppp_hours=1, ppp_minutes=2,
    )  # fmt: skip
    result = run_services(config, tmp_path)
    heads, rows = service_rows(result)
    assert len(rows) == 4
    assert all(len(row) == len(heads) for row in rows)
    for sky in config.skies:
        geo, both = (result["skies"][sky][case]["corrected"] for case in config.cases)
        assert 0.0 <= geo <= both <= 1.0  # the same drives, and one more way for the messages
        for case in config.cases:
            of = result["skies"][sky][case]
            assert of["available"] <= of["corrected"]
            assert of["direct_below_3"] <= of["hdop_below_3"]
    assert result["skies"]["open"]["s4_egnos"]["corrected"] == 1.0
    assert result["skies"]["open"]["s4_egnos"]["hdop_below_3"] > 0.9
    assert [row[0] for row in mixed_rows(result)[1]] == ["s4_egnos", "s4_sisnet"]
    assert [row[0] for row in convergence_rows(result)[1]] == ["1", "2"]
    lines = {row[0]: row[2:] for row in published_rows(result)[1]}
    assert lines["s4_egnos, error 50 / 95 %"][0] == "1.9 / 5.2 m, S4"
    assert float(lines["s4_egnos, error 50 / 95 %"][1].split()[0]) == pytest.approx(
        result["skies"]["open"]["s4_egnos"]["cep_m"], abs=0.01
    )
    assert lines["s4_sisnet, EGNOS available"] == ("89.2 %, S4", mixed_rows(result)[1][1][2])
    assert "spp, error 50 / 95 %" not in lines  # it was not driven
    assert run_services(config, tmp_path) == result  # resumed: nothing is driven anew


def test_levels_and_errors_have_three_significant_digits() -> None:
    """RTK's level of 4 cm is no 0.0; the table of EGNOS has no row without its cases."""
    shares = ("service", "corrected", "accurate", "bounded", "hdop_below_3", "direct_below_3", "beyond", "available")
    errors = {"cep_m": 0.00432, "hpe95_m": 0.5, "own_cep_m": 15.83, "own_hpe95_m": 1234.5}
    of = {**dict.fromkeys(shares, 0.0), **errors, "pl_at_m": 0.0412, "pl_ct_m": 999.7}
    result = {"config": {"cases": ["rtk"], "skies": ["open"]}, "skies": {"open": {"rtk": of}}}
    assert service_rows(result)[1][0][2:6] == ("0.00432 / 0.500", "15.8 / 1234", "0.0412", "1000")
    assert published_rows(result)[1][0][-1] == "0.00432 / 0.500 m"
    assert mixed_rows(result)[1] == []
    ppp = {"rms_m": [0.0271], "largest_m": [0.104], "level_m": [0.0412], "beyond": [0.0]}
    assert convergence_rows({"ppp": ppp, "config": {"ppp_minutes": 1}})[1] == [
        ("1", "0.0271", "0.104", "0.0412", "0.0 %")
    ]


def test_the_command_prints_no_table_without_rows(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    keys = ("cep_m", "hpe95_m", "own_cep_m", "own_hpe95_m", "pl_at_m", "pl_ct_m", "service", "corrected", "accurate",
            "bounded", "hdop_below_3", "direct_below_3", "beyond", "available")  # fmt: skip
    found = {"config": {"cases": ["rtk"], "skies": ["open"]}, "skies": {"open": {"rtk": dict.fromkeys(keys, 0.5)}}}
    monkeypatch.setattr(services, "run_services", lambda *_: found)
    done = CliRunner().invoke(app, ["reproduce", "services", "--out", str(tmp_path), "--set", "cases=[rtk]"])
    assert done.exit_code == 0, done.output
    assert "The papers line by line" in done.output
    assert "EGNOS by its satellites" not in done.output


def test_unknown_cases_and_skies_are_refused_before_a_folder_is_claimed() -> None:
    with pytest.raises(ConfigError, match=r"cases must be among spp, dgps.*got 'egnos'"):
        ServiceStudyConfig(cases=("spp", "egnos"))
    with pytest.raises(ConfigError, match="preset 'village' is unknown"):
        ServiceStudyConfig(skies=("village",))
    with pytest.raises(ConfigError, match=r"ppp_hours must lie in \[0, 24\], got 30"):
        ServiceStudyConfig(ppp_hours=30)


def test_an_approach_ends_where_the_street_begins_with_its_speed() -> None:
    still = np.zeros((2, 2))
    place, heading = np.array([[3.0, 4.0], [50.0, -7.0]]), np.array([0.3, 2.0])
    start = truth_between(0.1, 0.1, (place, place), (still, still), (heading, heading), [12.0, 15.0], 1)
    truths = list(approach(start, 60.0, 0.1))
    assert len(truths) == 600
    np.testing.assert_allclose(truths[-1].position_enu_m, start.position_enu_m, atol=1e-9)
    np.testing.assert_allclose(truths[-1].velocity_enu_mps, 0.0, atol=1e-12)
    assert truths[-1].time_s == pytest.approx(60.0)
    far = np.hypot(*(truths[0].position_enu_m - start.position_enu_m)[:, :2].T)
    np.testing.assert_allclose(far, 10.0 * 55.0 + 0.5 * 10.0 * 5.0 - 1.0, rtol=1e-9)


def test_ppp_enters_a_street_converged() -> None:
    config = ServiceStudyConfig(
        seeds=1, cases=("ppp",), skies=("open",), vehicles=2, duration_s=2.0, warm_up_s=1.0, ppp_approach_s=60.0
    )
    (street,) = streets_of(config.drives(), 0)
    found = _drive(config, street, "ppp")
    assert found["cep_m"] < 0.5
    assert found["service"] == 1.0


def test_a_street_is_built_once_and_the_approach_is_driven_once_for_skies_of_the_same_instruments(monkeypatch) -> None:
    built, driven, small = [], [], SkyMask.build
    monkeypatch.setattr(SkyMask, "build", lambda *a, **k: built.append(1) or small(*a, **k))
    monkeypatch.setattr(
        services, "approach", lambda *a: driven.append(1) or approach(*a)
    )  # of a way in the open, before the street
    config = ServiceStudyConfig(
        seeds=1, cases=("spp", "ppp"), skies=("suburban", "urban", "dense"), vehicles=2, duration_s=1.0, warm_up_s=1.0,
        ppp_approach_s=20.0, street_m=500.0,
    )  # fmt: skip
    together = work_street(config, "0")
    assert len(built) == 3
    assert len(driven) == 2  # urban and dense have the same instruments
    alone = work_street(config.replace(skies=("dense",)), "0")
    assert alone["dense"] == together["dense"]  # what a drive finds depends on no other


def test_vehicles_arrive_with_what_they_know_of_the_open_and_find_the_link_of_the_street() -> None:
    config = ServiceStudyConfig(vehicles=3, duration_s=1.0, warm_up_s=1.0, street_m=500.0, skies=("dense",))
    drives = config.drives().replace(navigator=NavigatorConfig.preset("services/ppp"))
    (street,) = streets_of(drives, 5)
    longer = drives.replace(warm_up_s=41.0)
    fresh, arrived = (navigator_of(longer, "dense", 5, street.mask) for _ in range(2))
    _arrive(arrived, longer, street, 40.0)
    ours, theirs = arrived.state, fresh.state
    np.testing.assert_array_equal(ours.corrections.links, theirs.corrections.links)
    for name in ("up", "outage_left", "until", "begun"):
        np.testing.assert_array_equal(ours.area.network.areas[name], theirs.area.network.areas[name])
    assert ours.area.network.epoch == 400
    assert (ours.extensions["hatch ppp"]["count"].max(-1) > 350).all()  # ambiguities of the open sky
    off = ours.belief.vehicles["position"] - (street.truths[0].position_enu_m - 0.1 * street.truths[0].velocity_enu_mps)
    assert np.abs(off[:, :2]).max() < 3.0


def test_ppp_gets_better_with_time_and_its_levels_hold() -> None:
    found = converge(seed=1, hour=3, vehicles=4, minutes=5)
    assert len(found["rms_m"]) == 5
    assert found["level_m"][-1] < found["level_m"][0]
    assert max(found["beyond"]) == 0.0
    assert found["rms_m"][-1] < 2.0  # it has hardly converged


def test_epochs_without_a_position_have_no_error() -> None:
    rows = np.zeros((10, 9))
    rows[:, 0], rows[:, 3:5], rows[:, 5] = 0.5, np.inf, int(Mode.RTK)
    rows[:4, 0], rows[:4, 5] = 900.0, int(Mode.NONE)  # vehicles that never had a position stand at the origin
    found = _figures(rows, Mode.RTK)
    assert (found["cep_m"], found["hpe95_m"], found["accurate"]) == (0.5, 0.5, 0.6)
    assert _figures(rows[:4], Mode.RTK)["accurate"] == 0.0
