"""The fault campaign in a short form: which faults are noticed, which mislead, and the comparison with theory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies.faults import FaultsConfig, assess_faults, cells_of
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sensors.fault_registry import fault_kind, fault_kinds

KINDS = [
    "satellite_range", "reference_coordinates", "corrections_loss", "odometer_frozen",
    "gyro_bias", "wheel_slip", "v2v_lie",
]  # fmt: skip
SHORT = FaultsConfig(
    vehicles=4,
    durations_s=(3.0,),
    kinds=tuple(KINDS),
    control_s=90.0,
    after_s=5.0,
    theory_satellites=(7,),
    theory_draws=1000,
)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("faults")
    return out, assess_faults(SHORT, out)


def cell(result: dict[str, Any], kind: str, size: float = 0.0, profile: str = "step") -> dict[str, Any]:
    return next(c for c in result["faults"] if (c["kind"], c["size"], c["profile"]) == (kind, size, profile))


def test_every_fault_is_in_the_campaign() -> None:
    """A kind is tried in every size and profile, or declares why not."""
    cells = cells_of(FaultsConfig())
    assert len({c.name for c in cells}) == len(cells)
    for kind in fault_kinds():
        tried = {(c.size, c.profile) for c in cells if c.kind == kind.name}
        assert tried == {(s, p) for s in kind.sizes_tried or (0.0,) for p in kind.profiles} or kind.not_tried_because


def test_the_study_of_the_package_tries_all_its_kinds() -> None:
    """The kinds, sizes and profiles of docs/results/faults.md."""
    cells = cells_of(FaultsConfig())
    assert len(cells) == 174
    assert {c.kind for c in cells if c.profile == "ramp"} == {
        "satellite_range", "constellation", "reference_coordinates", "spoofing", "jamming", "gyro_bias", "wheel_slip",
        "v2v_lie", "nlos_burst",
    }  # fmt: skip
    assert {c.kind for c in cells if c.declaration.in_blackout} == {"gyro_bias", "wheel_slip", "odometer_frozen"}


def test_an_unknown_kind_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"kinds\.0 must be one of .* got 'jaming': did you mean 'jamming'"):
        FaultsConfig(kinds=("jaming",))


def test_large_range_errors_are_excluded_and_small_ones_do_no_harm(short: tuple[Path, dict[str, Any]]) -> None:
    large = cell(short[1], "satellite_range", 50.0)
    assert large["noticed"]["events"] == 4
    assert large["noticed_median_s"] <= 0.2
    for size in fault_kind("satellite_range").sizes_tried:
        found = cell(short[1], "satellite_range", size)
        assert found["hazardous"]["events"] == 0
        assert found["failed"] == 0


def test_corrections_lost_for_seconds_never_mislead(short: tuple[Path, dict[str, Any]]) -> None:
    found = cell(short[1], "corrections_loss")
    assert found["hazardous"]["events"] == 0
    assert found["misleading"]["events"] == 0


def test_reference_coordinates_that_jump_are_noticed_at_once_and_not_followed(
    short: tuple[Path, dict[str, Any]],
) -> None:
    for size in (0.5, 2.0):
        found = cell(short[1], "reference_coordinates", size)
        assert found["noticed"]["events"] == 4
        assert found["noticed_median_s"] == pytest.approx(0.1)
        assert found["hazardous"]["events"] == found["misleading"]["events"] == 0
        assert found["lost"] == 4, "whoever has contradicted himself is not believed for a minute"
    assert cell(short[1], "reference_coordinates", 0.05)["noticed"]["events"] == 0


def test_a_lie_misleads_who_hears_it_and_nobody_notices(short: tuple[Path, dict[str, Any]]) -> None:
    found = cell(short[1], "v2v_lie", 10.0)
    assert found["noticed"]["events"] == 0
    assert found["hazardous"]["events"] == found["misleading"]["events"] > 4 * 25  # all epochs of 3 s, nearly
    assert found["worst_m"] > 5.0
    assert cell(short[1], "v2v_lie", 0.5)["hazardous"]["events"] == 0


def test_a_gyro_or_wheels_gone_wrong_in_a_blackout_for_seconds_do_no_harm(short: tuple[Path, dict[str, Any]]) -> None:
    for kind, size in (("gyro_bias", 0.1), ("wheel_slip", 0.02)):
        assert cell(short[1], kind, size)["in_blackout"]
        assert cell(short[1], kind, size)["hazardous"]["events"] == 0
    half = cell(short[1], "wheel_slip", 0.5)
    assert half["noticed"]["events"] > 0  # the others had an alert without the slip too
    assert half["misleading"]["events"] == 0


def test_detection_has_the_power_that_theory_says(short: tuple[Path, dict[str, Any]]) -> None:
    """A fixed seed; a binomial share lies within 4.5 sigma but for one case in 100,000."""
    (found,) = short[1]["theory"]
    assert (found["satellites"], found["redundancy"]) == (7, 2)
    for row in found["by_factor"]:
        trials, theory = row["own"]["trials"], row["theory"]
        assert abs(row["own"]["rate"] - theory) < 4.5 * (theory * (1.0 - theory) / trials) ** 0.5 + 2.0 / trials
        assert row["noticed"]["rate"] >= row["right"]["rate"]
    free, at_one, twice = (next(r for r in found["by_factor"] if r["factor"] == f) for f in (0.0, 1.0, 2.0))
    assert at_one["theory"] == pytest.approx(SHORT.navigator.fde.power)
    assert free["noticed"]["low"] < 2.0 * found["alpha"]  # the global test and the local ones have alpha each
    assert twice["noticed"]["rate"] > 0.99


def test_the_control_drive_is_bounded(short: tuple[Path, dict[str, Any]]) -> None:
    control = short[1]["control"]
    assert control["misleading"]["events"] == 0
    assert control["excluded"]["rate"] < 2.0 * SHORT.navigator.fde.alpha
    assert control["modes"]["rtk"]["mean_nees"] < 2.0  # declared errors bound the real ones
    assert control["modes"]["rtk"]["level_over_least_bound"]["along"] > 1.0


def test_files_are_written_and_a_second_run_drives_nothing(short: tuple[Path, dict[str, Any]]) -> None:
    out, result = short
    assert (out / "faults.svg").stat().st_size > 1000
    told: list[tuple[float, float]] = []
    again = assess_faults(SHORT, out, on_progress=lambda now: told.append((now.done, now.of)))
    assert told == [(len(cells_of(SHORT)) + 2,) * 2]
    assert (out / "detectability.svg").stat().st_size > 1000
    assert again["faults"] == json.loads((out / "results.json").read_text(encoding="utf-8"))["faults"]
    assert again["control"] == result["control"]


def test_the_command_prints_tables(tmp_path: Path) -> None:
    small = ["kinds=[odometer_frozen]", "durations_s=[2]", "control_s=61", "after_s=1", "theory_satellites=[]"]
    found = CliRunner().invoke(
        app, ["assess", "faults", "--out", str(tmp_path), "--vehicles", "1", *(w for s in small for w in ("--set", s))]
    )
    assert found.exit_code == 0, found.output
    for words in ("odometer frozen, step, 2 s", "mean NEES", "allocated 0.01 a test", "faults.svg"):
        assert words in found.stdout
