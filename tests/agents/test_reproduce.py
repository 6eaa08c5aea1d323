"""The urban drive study in a small form: tables, resumption, refusal; and the paper's figures as data."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lanebound.agents.cli.kinds import resolve
from lanebound.agents.reproduce.published import CELLS, MODES, RISKS, risk_key
from lanebound.agents.reproduce.study import lookup, rows_against_paper, run_study, summarise
from lanebound.agents.reproduce.urban_drive import UrbanDriveConfig, outage_lengths_s
from lanebound.integrity.errors import InputError

SMALL = {
    "seeds": 2,
    "minutes": 0.7,
    "batch": 1,
    "loop_m": [[0.0, 0.0], [200.0, 0.0], [100.0, 150.0]],
}


def small() -> UrbanDriveConfig:
    config = resolve("studies/urban_drive", SMALL)[1]
    assert isinstance(config, UrbanDriveConfig)
    return config


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    run_study(small(), out)
    return out


def test_tables_have_the_keys_asked_for(whole: Path) -> None:
    tables = json.loads((whole / "tables.json").read_text())
    for key in (
        "mode_share",
        "error",
        "pl_median",
        "pl_bounds_error",
        "availability",
        "outages",
        "exceedance",
        "spread",
    ):
        assert key in tables
    for part in (whole / "parts").glob("seeds-*.json"):
        for one in json.loads(part.read_text()):
            assert sum(one["mode_share"].values()) == pytest.approx(1.0)
    assert set(tables["pl_median"]["rtk"]["at_m"]) == {"1e-3", "1e-4", "1e-5", "1e-6"}
    levels = [tables["pl_median"]["rtk"]["ct_m"][risk_key(r)] for r in RISKS]
    assert levels == sorted(levels)
    for name in ("series-1e-4.png", "series-1e-6.png", "stanford-1e-6.png", "map.png"):
        assert (whole / name).stat().st_size > 10_000


def test_an_interrupted_study_ends_as_an_unbroken_one(whole: Path, tmp_path: Path) -> None:
    class StoppedError(Exception):
        pass

    def stop_in_second_batch(done: int, of: int) -> None:
        if done > of // 2:
            raise StoppedError

    with pytest.raises(StoppedError):
        run_study(small(), tmp_path, stop_in_second_batch)
    assert not (tmp_path / "tables.json").exists()
    run_study(small(), tmp_path)
    assert (tmp_path / "tables.json").read_bytes() == (whole / "tables.json").read_bytes()


def test_a_folder_with_another_study_is_refused(whole: Path) -> None:
    with pytest.raises(InputError, match="another configuration"):
        run_study(small().replace(first_seed=7), whole)


def test_rows_hold_every_printed_figure(whole: Path) -> None:
    rows = rows_against_paper(json.loads((whole / "tables.json").read_text()))
    assert len(rows) == len(CELLS) == 3 + 4 * len(MODES) + 2 * 4 * len(MODES)
    assert all(row["band"][0] < row["paper"] < row["band"][1] for row in rows)


def test_medians_over_the_drives() -> None:
    drives = [
        {"error": {"rtk": {"a": v}}, "exceedance": {"rtk": {"published": {"1e-3": e}}}}
        for v, e in ((1.0, 0.0), (2.0, 0.0), (9.0, 0.3))
    ]
    tables = summarise(drives)
    assert lookup(tables, ("error", "rtk", "a")) == 2.0
    assert lookup(tables, ("exceedance", "rtk", "published", "1e-3")) == pytest.approx(
        0.1
    )  # a mean: medians hide rare events
    assert tables["pl_bounds_error"]["rtk"]["1e-3"] is False
    assert lookup(tables, ("error", "doppler", "a")) is None


def test_outages_are_runs_without_rtk() -> None:
    rtk = np.array([1, 1, 0, 0, 0, 1, 0, 1, 1], dtype=bool)
    assert outage_lengths_s(rtk, 0.1) == pytest.approx([0.3, 0.1])
    assert outage_lengths_s(np.ones(4, dtype=bool), 0.1).size == 0
