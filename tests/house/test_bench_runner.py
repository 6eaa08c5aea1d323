"""The benchmark runner: discovery, selection, failures, the file it writes."""

from __future__ import annotations

import json
import sys
from importlib import import_module

import pytest

from lanebound.agents.bench import runner
from lanebound.agents.bench.runner import Row
from lanebound.integrity.core.errors import InputError

GOOD = """
from lanebound.agents.bench.runner import Row

def measure_good(rounds=5):
    return [Row("speed", float(rounds), "x", 3.0, 9.0), Row("time", 2.0, "s", 1.0, higher_is_better=False)]
"""


@pytest.fixture(autouse=True)
def _toy_package(tmp_path, monkeypatch):
    package = tmp_path / "toy_bench"
    package.mkdir()
    files = {
        "__init__": "",
        "good": GOOD,
        "broken": "import a_module_that_is_not_there",
        "few": "def measure_few(rounds=5):\n    return []",
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(runner, "BENCH_PACKAGE", "toy_bench")
    monkeypatch.setattr(runner, "BENCHES", {"good": "good", "few": "few", "broken": "broken"})
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "toy_bench"]:
        del sys.modules[name]


def test_every_benchmark_has_its_function(monkeypatch):
    monkeypatch.undo()
    for name, module in runner.BENCHES.items():
        assert callable(getattr(import_module(f"{runner.BENCH_PACKAGE}.{module}"), f"measure_{name}"))


def test_select_keeps_the_order_and_offers_the_nearest():
    assert runner.select([]) == ["broken", "few", "good"]
    assert runner.select(["good", "few"]) == ["few", "good"]
    with pytest.raises(InputError, match=r"benchmark 'godo' is unknown: did you mean 'good'\?"):
        runner.select(["godo"])


def test_a_failing_benchmark_is_reported_and_the_others_kept():
    told: list[str] = []
    report = runner.run(runner.select([]), rounds=4, progress=told.append)
    assert [(row.name, row.value, row.met) for row in report.rows] == [("speed", 4.0, True), ("time", 2.0, False)]
    assert list(report.failures) == ["broken"]
    assert report.failures["broken"].startswith("ModuleNotFoundError: ")
    assert told == ["broken", "few", "good"]


def test_write_gives_the_published_keys(tmp_path):
    path = tmp_path / "new" / "bench.json"
    runner.write([Row("speed", 4.0, "x", 3.0, 9.0)], path)
    (row,) = json.loads(path.read_text(encoding="utf-8"))
    assert {key: row[key] for key in ("name", "value", "unit", "gate", "stretch", "met")} == {
        "name": "speed",
        "value": 4.0,
        "unit": "x",
        "gate": 3.0,
        "stretch": 9.0,
        "met": True,
    }


def test_a_figure_that_is_not_finite_is_written_as_null(tmp_path):
    path = tmp_path / "bench.json"
    runner.write([Row("speed", float("inf"), "x"), Row("time", float("nan"), "s")], path)
    text = path.read_text(encoding="utf-8")
    assert [row["value"] for row in json.loads(text)] == [None, None]
    assert not {"NaN", "Infinity"} & set(text.replace(",", " ").split())


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "file" / "bench.json"):
        (tmp_path / "file").touch()
        with pytest.raises(InputError, match=r"^out must be a file that can be written, got .*: choose another one$"):
            runner.claim(path)


def test_a_benchmark_of_minutes_runs_only_when_it_is_named(monkeypatch):
    monkeypatch.setattr(runner, "ON_REQUEST", {"good"})
    assert runner.select([]) == ["broken", "few"]
    assert runner.select(["good"]) == ["good"]
