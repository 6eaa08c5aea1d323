"""The urban drive study in a small form: tables, resumption, refusal; and the paper's figures as data."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lanebound.agents.checkpointing.runner import RunProgress
from lanebound.agents.cli.listing import resolve
from lanebound.agents.studies import urban_drive as study
from lanebound.agents.studies.urban_drive import (
    CELLS,
    MODES,
    RISKS,
    UrbanDriveConfig,
    check,
    is_short,
    lookup,
    outage_lengths_s,
    risk_key,
    rows_against_paper,
    run_study,
    summarise,
    verdict,
)
from lanebound.integrity.core.errors import InputError

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

    def stop_in_second_batch(progress: RunProgress) -> None:
        if progress.done > progress.of // 2:
            raise StoppedError

    with pytest.raises(StoppedError):
        run_study(small(), tmp_path, stop_in_second_batch)
    assert not (tmp_path / "tables.json").exists()
    run_study(small(), tmp_path)
    assert (tmp_path / "tables.json").read_bytes() == (whole / "tables.json").read_bytes()


def test_a_folder_with_another_study_is_refused(whole: Path) -> None:
    with pytest.raises(InputError, match="differs in first_seed"):
        run_study(small().replace(first_seed=7), whole)


def test_what_cannot_be_driven_is_refused_before_the_folder_is_marked(tmp_path: Path) -> None:
    none = dict.fromkeys(("gps", "galileo", "glonass", "beidou", "qzss"), 0)
    for config in (
        small().replace(navigator={"sky": none}),
        small().replace(loop_m=[[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]),
    ):
        with pytest.raises(InputError):
            check(config, tmp_path / "new")
        assert not (tmp_path / "new").exists()


def test_tables_are_json_although_levels_may_be_infinite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unbounded(drives: object, dt_s: float) -> list[dict[str, object]]:
        return [{"mode_share": {"rtk": 1.0}, "pl_median": {"rtk": {"at_m": {"1e-3": float("inf")}}}}]

    monkeypatch.setattr(study, "seed_statistics", unbounded)
    monkeypatch.setattr(study, "drive", lambda *_: None)
    monkeypatch.setattr(study, "_figures", lambda *_: None)
    tables = run_study(small(), tmp_path)
    assert lookup(tables, ("pl_median", "rtk", "at_m", "1e-3")) is None
    assert "Infinity" not in (tmp_path / "tables.json").read_text()


@pytest.mark.parametrize(
    ("seeds", "minutes", "text"),
    [(100, 26.0, "outside"), (8, 26.0, "outside (short run)"), (100, 6.0, "outside (short run)")],
)
def test_short_runs_are_marked_and_not_condemned(seeds: int, minutes: float, text: str) -> None:
    short = is_short({"seeds": seeds, "minutes": minutes})
    assert verdict({"ours": 1.0, "met": False}, short) == text
    assert verdict({"ours": 1.0, "met": True}, short) == "inside"
    assert verdict({"ours": None, "met": False}, short) == "none"


def test_rows_hold_every_printed_figure(whole: Path) -> None:
    rows = rows_against_paper(json.loads((whole / "tables.json").read_text()))
    assert len(rows) == len(CELLS) == 3 + 4 * len(MODES) + 2 * 4 * len(MODES)
    assert all(row["band"][0] < row["paper"] < row["band"][1] for row in rows)


def test_medians_over_the_drives() -> None:
    drives = [
        {"error": {"rtk": {"a": v}}, "epochs": {"rtk": n}, "exceedance": {"rtk": {"published": {"1e-3": e}}}}
        for v, n, e in ((1.0, 500, 0.0), (2.0, 400, 0.0), (9.0, 100, 0.3))
    ]
    tables = summarise(drives)
    assert lookup(tables, ("epochs", "rtk")) == 1000
    assert lookup(tables, ("error", "rtk", "a")) == 2.0
    share = lookup(tables, ("exceedance", "rtk", "published", "1e-3"))
    assert share == pytest.approx(0.03)  # 30 of 1000 epochs: medians hide rare events
    assert tables["pl_bounds_error"]["rtk"]["1e-3"] is False
    assert lookup(tables, ("error", "doppler", "a")) is None


def test_outages_are_runs_without_rtk() -> None:
    rtk = np.array([1, 1, 0, 0, 0, 1, 0, 1, 1], dtype=bool)
    assert outage_lengths_s(rtk, 0.1) == pytest.approx([0.3, 0.1])
    assert outage_lengths_s(np.ones(4, dtype=bool), 0.1).size == 0
