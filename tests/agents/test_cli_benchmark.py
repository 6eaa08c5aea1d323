"""``lanebound benchmark`` and ``lanebound replay-episode``: what they print and what they refuse."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import pytest
from benchmarks import made_up_folder, made_up_results
from typer.testing import CliRunner

from lanebound.agents import report
from lanebound.agents.benchmark import Results, work
from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.checkpointing.runner import RunProgress
from lanebound.agents.cli import app
from lanebound.agents.cli import benchmark as command
from lanebound.agents.cli.benchmark_tables import number, print_results, with_interval
from lanebound.agents.cli.output import kept_text, rest_text
from lanebound.integrity.core.errors import InputError


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments))


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    return made_up_folder(tmp_path_factory.mktemp("made-up"), seeds={"count": 3})


@pytest.fixture
def driven(monkeypatch, results):
    """Nothing is driven: the plan is real, and its results were made up."""
    plans = []

    def made_up(plan, jobs, budget_h, on_progress):
        plans.append((plan, jobs, budget_h))
        on_progress(RunProgress(of=2, done=1, left_s=3700.0))
        return results

    monkeypatch.setattr(work, "run_plan", made_up)
    monkeypatch.setattr(report, "write_report", lambda results, out, on_clip: out / "report.html")
    return plans


@pytest.mark.parametrize("name", ["benchmark", "replay-episode"])
def test_help_teaches_with_an_example(name):
    told = " ".join(run(name, "--help").stdout.split())
    assert f"Example: lanebound {name} " in told


def test_options_choose_agents_seeds_and_budget(driven, tmp_path):
    told = run(
        "benchmark", "quick", "--out", str(tmp_path), "--agents", "nominal,mine=bad_agents:draws", "--seeds", "2",
        "--jobs", "3", "--budget", "1.5", "--set", "skies=[open]",
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    ((plan, jobs, budget_h),) = driven
    assert (jobs, budget_h) == (3, 1.5)
    assert {name: chosen.agent for name, chosen in plan.suite.agents.items()} == {
        "nominal": "nominal",
        "mine": "bad_agents:draws",
    }
    assert (plan.suite.seeds.count, plan.suite.skies) == (2, ("open",))
    assert "8 episodes to drive with 3 processes: a minute or less" in told.stderr  # perhaps more to compile
    assert "of which 1.5 h may be used" in told.stderr


def test_prints_tables_and_what_to_try_next(driven, tmp_path):
    told = run("benchmark", "quick", "--out", str(tmp_path), "--full").stdout
    for text in (
        "LaneKeeping-v0, dense sky: means of 3 seeds", "integrity_aware - nominal", "success [%]", "throughput [m/s]",
        "1 episode in which the agent failed", "ValueError: no idea", "report: ", "results.csv", "What to try next",
        f"lanebound replay-episode {tmp_path} CarFollowing-v0/dense-none/integrity_aware/10002 --video",
    ):  # fmt: skip
        assert text in told


def test_an_overview_comes_first_and_is_short(driven, tmp_path):
    told = run("benchmark", "quick", "--out", str(tmp_path)).stdout
    assert told.startswith("nominal, the reference, drives at ")
    assert "\nMeans over 4 cells" in told
    assert "Each cell with its intervals: the same command with --full." in told
    assert "1 episode in which the agent failed" in told
    assert told.count("\n") < 40


def test_tables_stand_there_before_the_page_is_written(driven, tmp_path, monkeypatch, capsys):
    def broken(results, out, on_clip):
        raise InputError("no page")

    monkeypatch.setattr(report, "write_report", broken)
    told = run("benchmark", "quick", "--out", str(tmp_path))
    assert (told.exit_code, told.stderr.splitlines()[-1]) == (2, "error: no page")
    assert "Means over 4 cells" in told.stdout


def test_nothing_is_announced_where_nothing_is_to_be_driven(driven, results, tmp_path, monkeypatch):
    plan = work.BenchmarkPlan(results.suite, tmp_path, [], [], 36, [], {})
    monkeypatch.setattr(work.BenchmarkPlan, "of", lambda *arguments: plan)
    told = run("benchmark", "quick", "--out", str(tmp_path))
    assert told.exit_code == 0
    assert told.stderr == "36 episodes, all stored already: nothing to drive.\n"


@pytest.mark.parametrize(
    ("progress", "told"),
    [
        (RunProgress(of=9), "starting"),
        (RunProgress(of=9, compiling=2), "compiling kernels, once"),
        (RunProgress(of=9, done=1, left_s=3700.0, compiling=1), "1:01:40 left, compiling kernels, once"),
        (RunProgress(of=9, done=1, failed=2), "starting, 2 failed"),
        (RunProgress(of=9, done=2, left_s=5.0), "0:00:05 left"),
    ],
)
def test_no_time_is_told_before_one_is_known(progress, told):
    assert rest_text(progress) == told


def test_json_is_that_of_the_file(driven, results, tmp_path):
    told = run("benchmark", "quick", "--out", str(tmp_path), "--json")
    assert json.loads(told.stdout) == json.loads((results.folder / "results.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["benchmark", "quik", "--out", "x"], "error: suite 'quik' is unknown: did you mean 'quick'? (or the path"),
        (["benchmark", "quick"], "error: --out is required, got nothing: add it"),
        (["benchmark", "quick", "--out", __file__], "error: out must be a folder that can be written"),
        (["benchmark", "quick", "--out", "x", "--agents", "nominl"], "error: agent 'nominl' is unknown: did you mean"),
        (
            ["benchmark", "services", "--out", "x", "--agents", "nominal,aware_sp"],
            "error: agent 'aware_sp' is unknown: did you mean 'aware_spp'? (the suite has aware_rtk, aware_nrtk, ",
        ),
        (
            ["benchmark", "services", "--out", "x", "--agents", "me=zzz"],
            "error: agent 'zzz' is unknown: the suite has aware_rtk, aware_nrtk, ",
        ),
        (["benchmark", "quick", "--out", "x", "--set", "skies=[dence]"], "error: sky must be one of open"),
        (
            ["benchmark", "quick", "--out", "x", "--set", "skies=[]"],
            "error: skies must have at least 1 entry, got []",
        ),
        (["assess", "bounding", "--risk", "nan", "--out", "x"], "error: risks.0 must be finite, got nan"),
        (
            ["benchmark", "quick", "--out", "x", "--set", "envs=LaneKeeping"],
            "error: envs must be a list, got 'LaneKeep",
        ),
        (["benchmark", "quick", "--out", "x", "--set", "agents=3"], "error: agents must be a list or a mapping, got 3"),
        (
            ["benchmark", "quick", "--out", "x", "--set", "seeds.count=two"],
            "error: seeds.count must be an integer, got",
        ),
        (
            ["replay-episode", "nowhere", "a/b/c/1"],
            "error: the folder must hold a benchmark, got nowhere, which does not exist",
        ),
    ],
)
def test_mistakes_are_answered_in_one_line(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    told = run(*arguments)
    assert told.exit_code == 2
    assert told.stderr.startswith(message)
    assert told.stderr.count("\n") == 1


def test_a_replay_says_whether_it_ended_as_before(monkeypatch, results):
    from dataclasses import replace

    from lanebound.agents.benchmark import replay

    stored = results.outcomes[0]
    for now, code, message in (
        (stored, 0, "It ended as it did, to the last bit."),
        (replace(stored, cost=1.0, solve_ms_median=9.0), 1, "differing: cost"),
    ):
        monkeypatch.setattr(replay, "replay", lambda *arguments, now=now: (stored, now))
        told = run("replay-episode", str(results.folder), stored.id)
        assert (told.exit_code, message in told.stdout) == (code, True)
    assert "did not end as it was stored" in told.stderr
    shown = run("replay-episode", str(results.folder), stored.id, "--json").stdout
    assert json.loads(shown)["differing"] == ["cost"]


def test_what_is_kept_and_how_to_resume(results):
    told = kept_text(results.folder, "episodes/*/*/*/*.parquet", "episode")
    assert told == f"36 finished episodes are kept in {results.folder}; run the same command again to resume"
    assert kept_text(results.folder, "parts/*.json", "part").startswith("no part was finished; run the same")


def test_figures_have_as_many_digits_as_can_be_read():
    collision, speed, cost = map(metric_named, ("collision", "mean_speed", "cost"))
    assert number(collision, 0.125) == "12.5"
    assert number(cost, 1234.5) == "1234"
    assert number(speed, -0.001) == "0.0"
    assert with_interval(speed, 0.5, 0.25, 1.0, signed=True) == ("+0.5", "+0.2..+1.0")
    assert with_interval(speed, None, None, None) == ("-", "")


def test_a_terminal_has_intervals_below_the_means(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    print_results(made_up_results(seeds={"count": 7}))
    assert "\x1b[32m" not in capsys.readouterr().out  # too few seeds for a verdict
    print_results(made_up_results(seeds={"count": 8}))
    told = capsys.readouterr().out
    assert "\x1b[32m" in told
    plain = re.sub(r"\x1b\[[0-9;]*m", "", told)
    assert max(map(len, plain.splitlines())) <= 100
    assert "…" not in plain
    assert plain.count("integrity_aware - nominal") == 4 * 3


def coloured(results: Results, capsys, monkeypatch) -> str:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "400")
    capsys.readouterr()
    print_results(results)
    return capsys.readouterr().out.partition("With 95 %")[0]


def test_who_failed_gets_no_colour_and_figures_of_fewer_seeds_say_so(capsys, monkeypatch):
    suite = {"agents": ["nominal", "integrity_aware"], "envs": ["CarFollowing"], "skies": ["urban"]}
    sound = made_up_results(**suite, seeds={"count": 12})
    told = coloured(sound, capsys, monkeypatch)
    assert "\x1b[32m" in told
    assert "n=" not in told
    failing = [replace(o, status="raised") if o.agent != "nominal" and o.seed < 10_002 else o for o in sound.outcomes]
    told = coloured(Results.of(sound.suite, failing), capsys, monkeypatch)
    assert "\x1b[32m" not in told
    assert "\x1b[31m" not in told
    assert told.count("n=10") == 2 * 10  # means and differences of all shown but success, also within the limit


def test_each_reference_has_its_differences_and_untuned_caution_is_named(capsys, monkeypatch):
    monkeypatch.setattr("lanebound.agents.benchmark.untuned.tuned_places", lambda: (("CarFollowingWorld", "dense"),))
    given = {"agents": ["nominal", "cautious", "integrity_aware"], "envs": ["CarFollowing"]}
    told = coloured(made_up_results(**given, reference=["nominal", "cautious"]), capsys, monkeypatch)
    urban, dense = told.split("dense sky")
    for part in (urban, dense):
        for pair in (
            "cautious - nominal", "integrity_aware - nominal", "nominal - cautious", "integrity_aware - cautious",
        ):  # fmt: skip
            assert part.count(pair) == 1
    assert ("cautious (untuned)" in urban, "(untuned)" in dense) == (True, False)


def test_unknown_episodes_are_answered_with_the_nearest(results):
    from lanebound.agents.benchmark.replay import find_task
    from lanebound.agents.benchmark.store import EpisodeStore

    with pytest.raises(InputError, match=r"is not in .*: did you mean 'LaneKeeping-v0/urban-none/random/10000'"):
        find_task(EpisodeStore(results.folder), "LaneKeeping-v0/urban-none/randm/10000")


def test_a_run_in_which_one_agent_always_fails_does_not_end_well(driven, results, tmp_path, monkeypatch):
    agent = results.outcomes[0].agent
    outcomes = [replace(o, status="raised") if o.agent == agent else o for o in results.outcomes]
    failing = replace(results, outcomes=outcomes)
    assert command._always_failing(results) == []
    assert command._always_failing(failing) == [agent]
    monkeypatch.setattr(work, "run_plan", lambda plan, jobs, budget_h, on_progress: failing)
    told = run("benchmark", "quick", "--out", str(tmp_path), "--seeds", "2", "--set", "skies=[open]")
    assert told.exit_code == 1
    assert f"every episode of {agent} failed" in told.stderr


@pytest.mark.parametrize("agents", ["[3]", "[nominal, 3]", "{mine: 3}"])
def test_an_agent_that_is_no_name_is_refused_in_one_line(agents, tmp_path):
    told = run("benchmark", "quick", "--out", str(tmp_path), "--set", f"agents={agents}")
    assert told.exit_code == 2
    assert told.stderr.startswith("error: agents must be names or mappings {NAME: agent}, got 3 as entry ")
    assert told.stderr.count("\n") == 1


def test_changes_of_all_environments_are_told(driven, tmp_path):
    told = run("benchmark", "quick", "--out", str(tmp_path), "--seeds", "2", "--set", "skies=[open]")
    assert "changed in all environments of this suite: duration_s = 30.0" in told.stderr
