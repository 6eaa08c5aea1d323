"""The runner: an interrupted run is resumed, in this process or in workers, with progress, within a budget."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from work import Squares, leave, squared

from lanebound.agents.checkpointing.runner import (
    Counter,
    InProcess,
    PartStatus,
    Pool,
    RunProgress,
    one_thread,
    run_parts,
    run_work,
)
from lanebound.integrity.core.errors import InputError


def seen(progress: list[tuple[float, float]]) -> Any:
    return lambda now: progress.append((now.done, now.of))


def test_an_interrupted_run_is_resumed_with_the_missing_parts(tmp_path: Path) -> None:
    worked: list[str] = []

    def work(name: str, advance: Any) -> dict[str, Any]:
        if len(worked) == 2:
            raise KeyboardInterrupt
        worked.append(name)
        return squared(name, advance)

    with pytest.raises(KeyboardInterrupt):
        run_parts(tmp_path, ["3", "1", "2"], work)
    assert worked == ["3", "1"]
    assert len(list((tmp_path / "parts").iterdir())) == 2
    progress: list[tuple[float, float]] = []
    found = run_parts(tmp_path, ["3", "1", "2"], squared, on_progress=seen(progress), size=int)
    assert {name: one["squared"] for name, one in found.items()} == {"3": 9, "1": 1, "2": 4}
    assert [one["bad"] for one in found.values()] == [None] * 3
    assert progress == [(4, 6), (5, 6), (6, 6)]  # before the missing part, half of it done, after it


def test_several_processes_give_the_same_each_on_one_thread(tmp_path: Path) -> None:
    names = ["5", "4", "6"]
    found = run_parts(tmp_path, names, squared, jobs=2)
    assert list(found.items()) == [(name, {"squared": int(name) ** 2, "threads": "1", "bad": None}) for name in names]


@pytest.mark.parametrize("jobs", [1, 2])
def test_no_part_is_started_beyond_the_budget(tmp_path: Path, jobs: int) -> None:
    assert run_parts(tmp_path, ["1", "2"], squared, jobs, budget_h=0.0) == {}
    assert list(run_parts(tmp_path, ["1", "2"], squared, jobs, budget_h=1.0)) == ["1", "2"]
    for pool in (InProcess(Squares()), Pool(Squares(), jobs)):
        may = iter([True, True, False, True])
        found = dict(pool.run([1, 2, 3, 4], lambda may=may: next(may), lambda: None))
        assert (found, list(may)) == ({1: 1, 2: 4}, [True])


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_part_that_is_refused_ends_the_run_and_the_others_are_kept(tmp_path: Path, jobs: int) -> None:
    with pytest.raises(ValueError, match="invalid literal for int"):
        run_parts(tmp_path, ["1", "two"], squared, jobs)
    assert (tmp_path / "parts" / "1.json").exists() or jobs == 2
    assert not (tmp_path / "parts" / "two.json").exists()


def test_workers_are_replaced_and_errors_come_to_the_parent(capfd: pytest.CaptureFixture[str]) -> None:
    found = dict(Pool(Squares(), 2).run([3, "die", 4, "hang", 5]))
    assert found == {
        3: 9, 4: 16, 5: 25,
        "die": "die: died, its process died with exit code 7",
        "hang": "hang: timeout, it took longer than 1 s in all",
    }  # fmt: skip
    told = capfd.readouterr()
    assert (told.out, "printed by the work" in told.err) == ("", True)
    for part, kind, message in (
        ("refuse", InputError, "^part must be a number, got refuse: give one"),
        ("break", OSError, "a file of the work"),
        ("odd", RuntimeError, r"(?s)Traceback.*Unpicklable: odd"),
    ):
        with pytest.raises(kind, match=message) as raised:
            list(Pool(Squares(), 1).run([part]))
        assert kind is RuntimeError or any("in do" in note for note in raised.value.__notes__)


def test_a_lost_part_ends_a_study(tmp_path: Path) -> None:
    message = r"part [12] of .* but its process died with exit code 3: run the same command"
    with pytest.raises(InputError, match=message):
        run_parts(tmp_path, ["1", "2"], leave, jobs=2)


def test_the_time_left_follows_the_pace_without_earlier_parts_and_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("lanebound.agents.checkpointing.runner.time.monotonic", lambda: now[0])
    left: list[float | None] = []
    counter = Counter(lambda progress: left.append(progress.left_s), RunProgress(of=100, done=90))
    for done, compiling, seconds in ((90, 1, 5.0), (90, 1, 60.0), (91, 0, 10.0), (93, 0, 20.0), (100, 0, 1.0)):
        now[0] += seconds
        counter.progress.compiling = compiling
        counter(done)
    assert left == [None, None, 10.0 * 9, 30.0 / 3 * 7, 0.0]


def test_the_time_left_recovers_from_a_slow_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute that does next to nothing, then one part a second: the mean pace tells 110 s at half of them."""
    now = [0.0]
    monkeypatch.setattr("lanebound.agents.checkpointing.runner.time.monotonic", lambda: now[0])
    left: list[float | None] = []
    counter = Counter(lambda progress: left.append(progress.left_s), RunProgress(of=100))
    counter(0.0)
    now[0] = 60.0
    counter(0.2)
    for second in range(1, 51):
        now[0] = 60.0 + second
        counter(float(second))
    assert left[:2] == [None, None]
    assert left[-1] is not None
    assert 50.0 <= left[-1] < 80.0, left[-1]


def test_isolated_work_never_runs_in_this_process() -> None:
    counter = Counter(lambda progress: None, RunProgress(of=1))
    ((part, result),) = run_work(["die"], Squares(), 1, counter, isolated=True)
    assert (part, result) == ("die", "die: died, its process died with exit code 7")


def test_a_status_measures_time_and_compilation() -> None:
    import numba

    status = PartStatus([0.0] * PartStatus.SIZE)
    status.watch_compilation()
    told = []

    @numba.njit
    def twice(x: float) -> float:
        return 2.0 * x

    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            told.append(status.compiles)

        def on_end(self, event: Any) -> None:
            pass

    event.register("numba:compile", Listener())
    assert twice(2.0) == 4.0
    assert told == [True]
    assert not status.compiles
    status.begin()
    assert status.used_s >= 0.0
    status.end()
    used = status.used_s
    assert status.used_s == used
    status.advance(0.25)
    assert status.share == 0.25
    status.clear()
    assert (status.used_s, status.share) == (0.0, 0.0)


def test_the_environment_is_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with one_thread():
        assert (os.environ["OMP_NUM_THREADS"], os.environ["MKL_NUM_THREADS"]) == ("1", "1")
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
