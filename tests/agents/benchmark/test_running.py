"""Whole runs: broken off and gone on with, in one process or two, with agents that fail, within a budget; replayed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml
from processes import started

from lanebound.agents.benchmark.replay import differences, replay
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import BenchmarkPlan, run
from lanebound.agents.checkpointing.runner import RunProgress
from lanebound.integrity.core.errors import InputError

SUITE = {
    "envs": ["LaneKeeping", "CarFollowing"],
    "skies": ["urban", "open"],
    "agents": ["random", "nominal"],
    "seeds": {"count": 2},
    "overrides": {"duration_s": 2.0},
}
GIVEN = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 2.0}


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory) -> Results:
    """All of the suite, in one process."""
    progress: list[RunProgress] = []
    results = run(SuiteConfig.load(SUITE), tmp_path_factory.mktemp("unbroken"), jobs=1, on_progress=progress.append)
    assert progress[-1].done == progress[-1].of == 16
    assert progress[-1].left_s == 0.0
    return results


def episodes_in(folder: Path) -> int:
    return len(list(folder.glob("episodes/*/*/*/*.parquet")))


def children_of(pid: int) -> list[int]:
    found = (path.read_text(encoding="utf-8").split() for path in Path(f"/proc/{pid}/task").glob("*/children"))
    return [int(child) for of_thread in found for child in of_thread]


def wait_until(condition) -> None:
    """Give up after three minutes."""
    until = time.monotonic() + 180.0
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes as Linux shows them")
def test_a_run_broken_off_and_gone_on_with_ends_as_an_unbroken_one(unbroken, tmp_path):
    suite, out = tmp_path / "suite.yaml", tmp_path / "out"
    suite.write_text(yaml.safe_dump(SUITE), encoding="utf-8")
    command = [Path(sys.executable).parent / "lanebound", "benchmark", suite, "--out", out, "--jobs", "1"]
    with started(command) as broken:
        wait_until(lambda: episodes_in(out) >= 3)
        workers = [pid for pid in children_of(broken.pid) if b"spawn_main" in cmdline_of(pid)]
        broken.send_signal(signal.SIGINT)
        _, told = broken.communicate(timeout=120)
    assert broken.returncode == 130
    said = re.search(rf"interrupted: (\d+) finished episodes are kept in {re.escape(str(out))}", told)
    assert said is not None
    assert len(workers) == 1
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    kept = episodes_in(out)
    assert kept - int(said[1]) in (0, 1)  # the worker may have finished what it had in hand when that was said
    assert kept < 16

    results = run(SuiteConfig.load(SUITE), out, jobs=2)
    assert results.missing == []
    assert [o.lasting() for o in results.outcomes] == [o.lasting() for o in unbroken.outcomes]
    for ours, theirs in zip(results.outcomes, unbroken.outcomes, strict=True):
        assert results.rows(ours).equals(unbroken.rows(theirs))


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes as Linux shows them")
@pytest.mark.parametrize("moment", ["at once", "first worker", "workers import"])
def test_an_interrupt_of_all_processes_is_answered_in_one_line(tmp_path, moment):
    suite, out = tmp_path / "suite.yaml", tmp_path / "out"
    suite.write_text(yaml.safe_dump(SUITE), encoding="utf-8")
    command = [sys.executable, "-c", "from lanebound.agents.cli import main; print('on', flush=True); main()"]
    command += ["benchmark", str(suite), "--out", str(out), "--jobs", "2"]
    with started(command, start_new_session=True) as begun:
        assert begun.stdout is not None
        assert begun.stdout.readline() == "on\n"
        if moment == "at once":
            wait_until((out / "run.json").exists)
        else:
            wait_until(lambda: any(b"spawn_main" in cmdline_of(pid) for pid in children_of(begun.pid)))
        time.sleep({"at once": 0.1, "first worker": 0.05, "workers import": 1.0}[moment])
        os.killpg(begun.pid, signal.SIGINT)
        _, told = begun.communicate(timeout=120)
    assert begun.returncode == 130, told
    assert "Traceback" not in told
    if moment == "at once" and not told:
        return  # on a busy machine the command had not begun
    assert told.count("interrupted: ") == 1
    last = told.strip().splitlines()[-1]
    assert last.startswith("interrupted: ")
    assert "kept" in last or "no episode was finished" in last


def cmdline_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def test_the_files_of_a_run(unbroken):
    names = {path.name for path in unbroken.folder.iterdir()}
    assert names == {
        ".lock", "episodes", "episodes.parquet", "results.csv", "results.json", "run.json",
    }  # fmt: skip
    assert pq.read_table(unbroken.folder / "episodes.parquet").num_rows == 16
    assert Results.load(unbroken.folder) == unbroken
    assert not list(unbroken.folder.rglob("*.part"))


def test_an_episode_ends_again_as_it_did_and_can_be_filmed(unbroken, tmp_path):
    stored, now = replay(unbroken.folder, "CarFollowing/urban-none/random/10001", tmp_path / "film.mp4")
    assert differences(stored, now) == []
    assert stored.id == "CarFollowing-v0/urban-none/random/10001"
    assert (tmp_path / "film.mp4").stat().st_size > 1000


@pytest.mark.parametrize(
    ("ident", "film", "message"),
    [
        (
            "LaneKeeping/urban-none/random/9",
            None,
            "episode 'LaneKeeping/urban-none/random/9' is not in .*: did you mean",
        ),
        ("LaneKeeping/urban-none/random/10000", Path("a.avi"), r"video must end in \.mp4, got a\.avi"),
    ],
)
def test_what_cannot_be_replayed_is_refused(unbroken, ident, film, message):
    with pytest.raises(InputError, match=message):
        replay(unbroken.folder, ident, film)


def test_a_folder_of_another_suite_is_refused(unbroken):
    with pytest.raises(
        InputError, match=r"which differs in skies \(.*dense.*\): choose a new folder, or drive anew with --fresh"
    ):
        BenchmarkPlan.of(SuiteConfig.load({**SUITE, "skies": ["dense"]}), unbroken.folder)
    with pytest.raises(InputError, match=r"which differs in agents\.random \(random, \w+ there, now cruise, \w+\)"):
        BenchmarkPlan.of(SuiteConfig.load({**SUITE, "agents": {"random": "cruise"}}), unbroken.folder)
    assert BenchmarkPlan.of(SuiteConfig.load({**SUITE, "seeds": {"count": 3}}), unbroken.folder).stored == 16
    assert len(BenchmarkPlan.of(SuiteConfig.load(SUITE), unbroken.folder).tasks) == 0


def test_nothing_is_begun_beyond_the_budget(tmp_path):
    results = run(SuiteConfig.load(SUITE), tmp_path, jobs=1, budget_h=0.0)
    assert len(results.missing) == 16
    assert results.cells == []


def test_agents_that_fail_are_reported_and_the_rest_is_kept(tmp_path):
    bad = {name: f"bad_agents:{name}" for name in ("raises", "dies", "hangs", "not_a_number", "draws")}
    suite = SuiteConfig.load(
        {**SUITE, "envs": ["LaneKeeping"], "skies": ["open"], "agents": {**bad, "nominal": "nominal"},
         "seeds": {"count": 1}, "overrides": GIVEN, "episode_timeout_s": 6.0},
    )  # fmt: skip
    results = run(suite, tmp_path, jobs=1)
    by_agent = {outcome.agent: outcome for outcome in results.outcomes}
    assert {agent: outcome.status for agent, outcome in by_agent.items()} == {
        "raises": "raised", "dies": "raised", "hangs": "timeout", "not_a_number": "not_finite",
        "draws": "ok", "nominal": "ok",
    }  # fmt: skip
    assert results.missing == []
    assert [o.seed for o in results.failures if o.agent == "hangs"] == [10_000]
    assert by_agent["dies"].message == "its process died with exit code 7"
    assert "episode_timeout_s = 6" in by_agent["hangs"].message
    assert results.cell(suite.places[0], "hangs").metrics["failed"].mean == 1.0
    assert results.rows(by_agent["hangs"]).num_rows == 0


def test_a_script_that_runs_without_a_guard_is_told_so_and_nothing_is_stored(tmp_path):
    script = tmp_path / "mine.py"
    script.write_text(
        "from pathlib import Path\n"
        "from lanebound.agents.benchmark import SuiteConfig, run\n"
        "suite = SuiteConfig.load({'envs': ['LaneKeeping'], 'agents': ['nominal'], 'seeds': {'count': 1}})\n"
        "run(suite, Path('out'), jobs=1)\n",
        encoding="utf-8",
    )
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "InputError: a worker process ended while it was started (exit code 1" in done.stderr
    assert "must stand below if __name__ == '__main__':" in done.stderr
    assert episodes_in(tmp_path / "out") == 0


def test_agents_that_cannot_drive_an_environment_are_left_out(tmp_path):
    suite = SuiteConfig.load({**SUITE, "envs": ["Merge"], "skies": ["open"], "agents": ["nominal", "cbf"]})
    plan = BenchmarkPlan.of(suite, tmp_path)
    ((env, agent, why),) = plan.left_out
    assert (env, agent) == ("Merge-v0", "cbf")
    assert why.startswith("action must be continuous")
    assert {task.agent for task in plan.tasks} == {"nominal"}
    assert plan.hours(1) > 0.0
    with pytest.raises(InputError, match="agent 'nominl' is unknown"):
        BenchmarkPlan.of(SuiteConfig.load({**SUITE, "agents": ["nominl"]}), tmp_path)
    with pytest.raises(InputError, match=r"agent must be a file that exists, got no\.zip"):
        BenchmarkPlan.of(SuiteConfig.load({**SUITE, "agents": {"mine": "no.zip"}}), tmp_path)


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (
            {"agent": "cbf", "figures": {"ovr": "integrity_aware"}},
            r"agents\.mine\.figures\.ovr is not .*figures\.over'\?",
        ),
        ({"agent": "cautious", "figures": {"speed_share": -1}}, r"agents\.mine\.figures\.speed_share must "),
        ({"agent": "cbf", "figures": {"over": "nominl"}}, "agent 'nominl' is unknown: did you mean 'nominal'?"),
        ({"agent": "cbf", "figures": {"over": "cbf"}}, "over must be another agent than cbf"),
        ({"agent": "random", "figures": {"x": 1}}, "figures must be empty for 'random'"),
        ({"agent": "bad_agents:draws", "figures": {"x": 1}}, "only agents of ours have figures"),
    ],
)
def test_figures_that_are_wrong_anywhere_are_refused_and_not_left_out(tmp_path, agent, message):
    suite = SuiteConfig.load(
        {**SUITE, "envs": ["Merge", "LaneKeeping"], "agents": {"nominal": "nominal", "mine": agent}}
    )
    with pytest.raises(InputError, match=message):
        BenchmarkPlan.of(suite, tmp_path / "out")
    assert not (tmp_path / "out").exists()
