"""``lanebound drive``: what it prints, logs and films, and that filming changes nothing."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
from imageio_ffmpeg import count_frames_and_secs
from stable_baselines3 import PPO
from typer.testing import CliRunner

from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.scoring import UNNAMED, outcome_of
from lanebound.agents.checkpointing.runner import RunProgress
from lanebound.agents.cli import app
from lanebound.agents.cli import drive as tables
from lanebound.agents.cli.output import _Lines
from lanebound.agents.drivers import AGENTS, make_agent
from lanebound.agents.episodes import COLUMNS, EpisodeLog, drive, open_env
from lanebound.agents.episodes.film import Film
from lanebound.integrity.core.errors import InputError

GIVEN = ("--sky", "open", "--set", "navigation.source=perfect", "--set", "perception.source=truth")


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["drive", *arguments])


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Two episodes of three seconds with all there is to write."""
    out = tmp_path_factory.mktemp("drive")
    result = run(
        "LaneKeeping", *GIVEN, "--set", "world.duration=3", "--seed", "5", "--episodes", "2", "--out", str(out / "log"),
        "--video", str(out / "film.mp4"), "--json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return out, json.loads(result.stdout)


def test_says_what_was_driven(driven):
    _, shown = driven
    assert [(e["seed"], e["steps"], e["ended"], e["success"]) for e in shown["episodes"]] == [
        (5, 15, "time up", True),
        (6, 15, "time up", True),
    ]
    assert shown["all"]["success rate"] == 1.0
    assert shown["all"]["availability"] == 1.0
    assert shown["episodes"][0]["mode_shares"] == {"rtk": 1.0}


@pytest.mark.parametrize("named", [True, False])
def test_a_checkpoint_drives_with_and_without_a_name_of_its_own(tmp_path, named):
    env, path = open_env("LaneKeeping", {"observation": {"form": "flat"}}), tmp_path / "model.zip"
    PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu").save(path)
    given = ("--set", "duration_s=1", "--set", "observation.form=flat")
    shown = run("LaneKeeping", *GIVEN, *given, "--agent", f"mine={path}" if named else str(path))
    assert shown.exit_code == 0, shown.output
    assert f"{'mine' if named else path} in LaneKeeping" in shown.stdout.replace("\n", "")


def test_the_log_has_a_row_for_each_step_and_says_what_its_columns_are(driven):
    out, shown = driven
    table = pq.read_table(out / "log" / "episodes.parquet")
    assert table.column_names == [column.name for column in COLUMNS]
    assert table.num_rows == sum(e["steps"] + 1 for e in shown["episodes"])
    for field, column in zip(table.schema, COLUMNS, strict=True):
        assert field.metadata == {b"unit": column.unit.encode(), b"meaning": column.meaning.encode()}
    rows = table.to_pylist()
    assert rows[0]["action"] == []
    assert len(rows[1]["action"]) == 2
    assert [row["time_s"] for row in rows[:3]] == pytest.approx([0.0, 0.2, 0.4])
    assert sum(r["reward"] for r in rows if r["episode"] == 1) == pytest.approx(shown["episodes"][1]["total_return"])
    assert all(row["err_ct_m"] == 0.0 and row["true_x_m"] == row["est_x_m"] for row in rows)
    text = (out / "log" / "columns.md").read_text(encoding="utf-8")
    assert all(f"| {column.name} |" in text for column in COLUMNS)


def test_the_diagram_is_drawn(driven):
    out, _ = driven
    assert (out / "log" / "stanford.png").read_bytes().startswith(b"\x89PNG")


def test_the_film_has_ten_pictures_a_second(driven):
    out, _ = driven
    frames, seconds = count_frames_and_secs(str(out / "film.mp4"))
    assert frames == 2 * 31  # the start and three seconds, twice
    assert seconds == pytest.approx(6.2, abs=0.2)
    assert sorted(path.name for path in out.iterdir()) == ["film.mp4", "log"]


def test_prints_tables():
    shown = run("UrbanCanyon", *GIVEN, "--set", "world.duration=2", "--agent", "random").stdout
    assert "random in UrbanCanyon: 1 episode" in shown
    assert "cost, weighted" in shown
    assert "within the limit 40" in shown
    assert "cost_lane, unweighted           │ m2 " in shown
    assert "time [s]" in shown
    for word in ("success rate", "cost_hmi", "share of rtk", "HMI steps", "collision rate"):
        assert word in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["LaneKepeing"], "error: environment 'LaneKepeing' is unknown: did you mean"),
        (["LaneKeeping", "--agent", "cruse"], "error: agent 'cruse' is unknown: did you mean 'cruise'?"),
        (["LaneKeeping", "--sky", "dence"], "error: sky must be one of"),
        (["LaneKeeping", "--faults", "stres"], "error: faults must be "),
        (["LaneKeeping", *GIVEN, "--fault", "kind=spoof"], "error: options.faults.0.kind must be one of"),
        (["LaneKeeping", "--fault", "spoofing"], "error: an override must read key=value, got 'spoofing'"),
        (["LaneKeeping", "--video", "film.avi"], "error: video must end in .mp4, got film.avi"),
        (["LaneKeeping", "--video", "film.mp4", "--fps", "3"], "error: fps must divide simulation_hz = 20, got 3"),
        (["LaneKeeping", "--video", f"{__file__}/a.mp4"], "error: video must be a file that can be written, got"),
        (["Merge", "--agent", "lqr"], "error: action must be continuous for agent 'lqr', got meta-actions: choose one"),
        (["LaneKeeping", "--set", "navigator.rate_hz=5"], "error: navigator.rate_hz is not a known key: known are"),
        (["LaneKeeping", "--set", "navigator.dt_s=0.2"], "error: navigator.dt_s must be 1 / navig"),
        (["LaneKeeping", "--out", __file__], "error: out must be a folder that can be written"),
        (["LaneKeeping", "--episodes", "0"], "error: --episodes must be >= 1, got 0"),
    ],
)
def test_mistakes_are_answered_in_one_line(arguments, message):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_faults_of_ones_own_strike_in_every_episode():
    jamming = "kind=jamming,start_s=2,duration_s=9,magnitude_db=40"
    result = run(
        "LaneKeeping", "--sky", "open", "--set", "world.duration=3", "--fault", jamming, "--episodes", "2", "--json"
    )
    assert result.exit_code == 0, result.output
    for episode in json.loads(result.stdout)["episodes"]:
        assert 0.4 < episode["mode_shares"].pop("rtk") < 0.8
        assert sum(episode["mode_shares"].values()) > 0.2


@pytest.mark.parametrize(
    ("maker", "line", "frames"),
    [
        ("raises", "ValueError: no idea what to do \\(bad_agents.py:\\d+\\), at seed 4, step 3", 2),
        ("leaves", "SystemExit: 3 \\(bad_agents.py:\\d+\\), at seed 4, step 3", 2),
        ("unmade", "RuntimeError: could not be made \\(bad_agents.py:\\d+\\)", 1),
        ("short", "action must be float32 numbers of shape \\(2,\\), got array.*, at seed 4, step 3", 0),
    ],
)
def test_an_agent_that_fails_is_told_by_its_own_frames_and_one_line(maker, line, frames):
    result = run("LaneKeeping", *GIVEN, "--seed", "4", "--agent", f"bad_agents:{maker}")
    assert result.exit_code == 1
    shown = result.stderr.splitlines()
    assert re.fullmatch(f"error: agent bad_agents:{maker}: {line}", shown[-1])
    told = [text for text in shown if text.startswith("  File")]
    assert len(told) == frames
    assert all("bad_agents.py" in text for text in told)
    assert not any("Traceback" in text for text in shown)


def test_the_table_of_episodes_fits_into_eighty_characters(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    row = dict.fromkeys([column.name for column in COLUMNS], 0.0) | {"seed": 10_000, "mode": "rtk", "step": 900}
    end = {"time_s": 180.0, "cost": 1196.9, "reward": -123.4, "off_road": True}
    outcome = outcome_of([row | {"time_s": 179.8}, row | end], 180.0, UNNAMED._replace(seed=10_000))
    position = tables.position_of([row])
    tables.print_report("integrity_aware in LaneKeeping", [outcome], position, 15.0, (), {}, False)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "80 x the limit 15" in shown


def _driven_by(mode: str) -> Outcome:
    """An episode of two rows, positioned by one mode."""
    row = dict.fromkeys([column.name for column in COLUMNS], 0.0) | {"mode": mode, "step": 900, "time_s": 179.8}
    return outcome_of([row, row | {"time_s": 180.0}], 180.0, UNNAMED._replace(seed=1))


def test_a_service_that_is_never_used_is_told():
    reckoned = [_driven_by("doppler")]
    assert tables.measures(reckoned, ("ppp",))["share of ppp"] == 0.0
    (line,) = tables.unused(reckoned, {}, 15.0, ("ppp", "spp"))
    assert "no decision had a position of ppp" in line
    assert tables.unused(reckoned, {}, 15.0, ()) == []
    assert tables.unused([_driven_by("ppp")], {}, 15.0, ("ppp", "spp")) == []
    assert tables.unused([_driven_by("rtk")], {}, 15.0, ("sbas_dfmc", "spp")) == []  # RTK comes first


def test_a_cost_is_told_in_terms_of_its_limit():
    assert tables._against(196.9, 15.0) == "13 x the limit 15"
    assert tables._against(3.0, 15.0) == "within the limit 15"


def rows_of_a_drive(tmp_path: Path, filmed: bool) -> list[dict[str, Any]]:
    env = open_env("CarFollowing", {"sky": "urban", "world": {"duration": 4.0}}, "rgb_array" if filmed else None)
    log, agent = EpisodeLog(), make_agent("cruise", env)
    if filmed:
        with Film(env, tmp_path / "film.mp4", 20) as film:
            drive(env, agent, [7], [log, film])
        assert film.frames == 81
    else:
        drive(env, agent, [7], [log])
    return log.rows


def test_filming_changes_nothing_of_the_drive(tmp_path):
    assert rows_of_a_drive(tmp_path, True) == rows_of_a_drive(tmp_path, False)


def test_an_unfinished_film_is_thrown_away(tmp_path):
    env = open_env("LaneKeeping", {"sky": "open", "navigation": {"source": "perfect"}}, "rgb_array")

    def fall(episode: int) -> None:
        raise InputError("enough")

    env.world.config["duration"] = 0.4
    with pytest.raises(InputError, match="enough"), Film(env, tmp_path / "film.mp4") as film:
        drive(env, make_agent("cruise", env), [1], [film], fall)
    assert list(tmp_path.iterdir()) == []


def test_measures_weigh_episodes_by_steps_where_shares_are_of_steps():
    end = {"crashed": True, "off_road": False, "wrong_way": False, "truncated": False, "terminated": True}
    row = dict.fromkeys([c.name for c in COLUMNS], 0.0) | end | {
        c.name: 1.0 for c in COLUMNS if c.name.startswith("cost")
    } | {"reward": 2.0, "is_success": False, "alert": True, "mi": False, "hmi": True}  # fmt: skip

    def episode(steps: int, **given: Any) -> Outcome:
        return outcome_of([row | {"step": k, "time_s": 0.2 * k, **given} for k in range(steps + 1)], 1.0)

    short, long = episode(1, available=True, mode="rtk"), episode(3, available=False, mode="doppler")
    for outcome in (short, long):
        outcome.cost_limits["lane"], outcome.group_costs["lane"] = 2.0, float(outcome.steps)
    found = tables.measures([short, long])
    assert found["group_cost_lane"] == 2.0
    assert (tables._label("group_cost_lane"), tables._value(2.0, 2.0)) == (
        ("group_cost_lane, weighted", ""), "2, within the limit 2",
    )  # fmt: skip
    assert (short.ended, short.steps, long.steps) == ("collision", 1, 3)
    assert found["availability"] == found["share of rtk"] == pytest.approx(0.25)
    assert found["HMI steps"] == 4.0
    assert found["return"] == pytest.approx(6.0)
    assert math.isclose(found["collision rate"], 1.0)


def test_position_of_a_log_counts_decisions_and_missing_levels():
    row = {"step": 1, "err_ct_m": 0.2, "pl_ct_m": 0.5, "al_at_m": 1.5, "al_ct_m": 0.7, "pl_at_m": 4.0}
    start = {**row, "step": 0, "err_at_m": 99.0}
    steps = [{**row, "err_at_m": error} for error in (-3.0, 1.0, 1.0, 1.0)]
    steps[0] |= {"pl_ct_m": math.inf, "step": 2}
    found = tables.position_of([start, *steps])
    assert found["along"] == {
        "error_mean_m": 1.5, "error_median_m": 1.0, "error_p75_m": 1.5, "error_p95_m": pytest.approx(2.7),
        "error_max_m": 3.0, "PL_median_m": 4.0, "PL_p95_m": 4.0,
        "AL_m": 1.5,
    }  # fmt: skip
    assert found["across"]["PL_median_m"] == 0.5
    assert found["across"]["PL_p95_m"] is None
    assert tables.position_of([start]) == {}


def test_gymnasium_records_the_environments_too(tmp_path):
    pytest.importorskip("moviepy")
    config = {"sky": "open", "navigation": {"source": "perfect"}, "world": {"duration": 1.0}}
    made = gymnasium.make("lanebound/LaneKeeping-v0", config=config, render_mode="rgb_array")
    env = gymnasium.wrappers.RecordVideo(made, str(tmp_path), episode_trigger=lambda episode: True)
    env.reset(seed=1)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(np.zeros(2, dtype=np.float32))
        over = terminated or truncated
    env.close()
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]


def test_help_names_every_agent():
    shown = "".join(run("--help").stdout.split()).replace("│", "")
    assert [agent for agent in AGENTS if agent not in shown] == []


def test_one_episode_is_no_column_of_equal_lines(capsys):
    lines = _Lines("episodes")
    for tenth in range(11):
        lines(RunProgress(of=1, done=tenth / 10, left_s=5.0))
    assert capsys.readouterr().err.splitlines() == ["0 of 1 episodes, 0:00:05 left", "1 of 1 episodes, 0:00:05 left"]


def test_a_syntax_error_of_an_agent_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "spelt_so_wrong.py").write_text("def make(env):\n    return )\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    result = run("Merge", *GIVEN, "--agent", "spelt_so_wrong:make")
    assert result.exit_code == 2
    assert result.stderr.startswith(
        "error: 'spelt_so_wrong:make' must name a module that can be imported, got SyntaxError"
    )
    assert "frozen" not in result.stderr
    assert "spelt_so_wrong.py, line 2" in result.stderr


def test_harm_is_among_the_measures(driven):
    _, shown = driven
    assert shown["all"]["harm"] == pytest.approx(np.mean([e["costs"]["cost_lane"] for e in shown["episodes"]]))
