"""The ablation of the urban drive: what each variant takes away, and what a run leaves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lanebound.agents.studies import urban_drive as ablation
from lanebound.agents.studies.urban_drive import UrbanDriveConfig, rows_against_paper

STUDY = UrbanDriveConfig.preset("studies/urban_drive")


def variant(name: str) -> UrbanDriveConfig:
    found = next(one for one in ablation.ABLATIONS if one.name == name)
    return STUDY.replace(navigator=dict(found.navigator))


def test_each_variant_takes_away_what_it_says() -> None:
    assert variant("shipped") == STUDY
    n = variant("no-offset").navigator
    assert n.gnss.reference_offset_m == n.positioning.rtk.reference_bias_m == 0.0
    assert variant("default-doppler").navigator.positioning.doppler.sigma_mps == 0.10
    assert variant("default-doppler").navigator.gnss.range_rate_sigma_mps == 0.21
    assert variant("unknown-tau").navigator.positioning.doppler.tau_range_s == (0.1, 10.0)
    assert variant("no-outages").navigator.corrections.outage_per_h == 0.0
    names = [one.name for one in ablation.ABLATIONS]
    assert len(set(names)) == len(names)
    different = [variant(name) for name in names[1:]]
    assert all(one != STUDY for one in different)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path, list[float]]:
    """Two variants of a short drive."""
    out, shares = tmp_path_factory.mktemp("ablation"), []
    config = STUDY.replace(seeds=1, minutes=0.5, loop_m=[[0, 0], [300, 0], [300, 200], [0, 200]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ablation, "ABLATIONS", ablation.ABLATIONS[:2])
        found = ablation.run_ablation(config, out, lambda progress: shares.append(progress.done / progress.of))
    return found, out, shares


def test_cells_are_those_of_the_tables_of_each_variant(result: tuple[dict[str, Any], Path, list[float]]) -> None:
    found, out, shares = result
    assert [one["name"] for one in found["variants"]] == ["shipped", "no-offset"]
    for one in found["variants"]:
        rows = rows_against_paper(json.loads((out / one["name"] / "tables.json").read_text()))
        assert (one["met"], one["of"]) == (sum(row["met"] for row in rows), 39)
        assert one["outside"] == [row["figure"] for row in rows if not row["met"]]
    assert found["variants"][0] | {"name": "", "without": ""} != found["variants"][1] | {"name": "", "without": ""}
    assert len(list((out / "masks").glob("*.npz"))) == 1
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_the_table_has_a_row_for_each_variant(result: tuple[dict[str, Any], Path, list[float]]) -> None:
    heads, rows = ablation.ablation_rows(result[0])
    assert heads[:2] == ("taken away", "cells")
    assert [row[0] for row in rows] == [one.text for one in ablation.ABLATIONS[:2]]
    assert all(len(row) == len(heads) for row in rows)
