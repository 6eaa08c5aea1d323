"""Stanford counts by hand, what the figures show, and the report's files."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.assessment.accuracy import assess
from lanebound.integrity.assessment.plotting import count_zones, map_figure, save, series_figure, stanford_figure
from lanebound.integrity.assessment.record import Record, Zone
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.modes import Mode


@pytest.fixture
def drive() -> Record:
    """Eight epochs with one or more in every zone across track."""
    error = np.array([0.1, 0.2, 0.7, 1.5, 0.3, 3.0, 0.2, 0.2])
    pl = np.array([0.3, 0.3, 0.5, 0.9, 1.8, 2.0, np.inf, 0.3])
    mode = np.array([1, 1, 2, 2, 3, 3, 0, 1])
    n = error.size
    return Record(np.arange(n) * 0.1, mode, np.zeros(n), -error, np.full(n, 0.4), pl, pl > 1.0, pl <= 1.0)


def test_zone_counts_by_hand(drive: Record) -> None:
    zones = count_zones(drive, "ct", 1.0)
    assert zones.counts == {
        Zone.NOMINAL: 3,
        Zone.MISLEADING: 1,
        Zone.HAZARDOUS: 1,
        Zone.UNAVAILABLE: 2,
        Zone.UNAVAILABLE_MISLEADING: 1,
    }
    assert (zones.total, zones.rate(Zone.HAZARDOUS)) == (8, 0.125)
    assert count_zones(drive, "at", 1.0).counts[Zone.UNAVAILABLE] == 1  # the epoch without a position
    assert zones.to_dict()["misleading"] == {"count": 1, "rate": 0.125}


def test_stanford_figure_labels_every_zone(drive: Record) -> None:
    figure = stanford_figure(drive, 1.0, 1.0, title="drive")
    labels = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]  # type: ignore[union-attr]
    assert len(labels) == len(Zone)
    assert "1  (12.5 %)" in labels[Zone.HAZARDOUS]


def test_series_figure_has_the_papers_panels(drive: Record) -> None:
    figure = series_figure(drive, risk=1e-4, al_at_m=1.0, al_ct_m=1.0)
    assert len(figure.axes) == 8
    assert figure.axes[2].get_ylim() == (0.0, 0.5)
    assert [axes.get_ylabel().split(",")[0] for axes in figure.axes[::2]] == [
        "all modes",
        "RTK",
        "Doppler",
        "IMU + odometer",
    ]


def test_the_strip_of_modes_has_a_key_and_nothing_is_written_over_the_levels(drive: Record) -> None:
    figure = series_figure(drive, risk=1e-4)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["mode, as in the strip above the first row:", "no solution", "RTK", "Doppler", "IMU + odometer"]
    assert figure.axes[4].get_title(loc="left") == "25.0 % of epochs"
    assert not any(text.get_text() for axes in figure.axes for text in axes.texts)


def test_a_rare_mode_is_drawn_with_dots() -> None:
    n = 40
    mode = np.where(np.arange(n) == 7, 3, 1)
    record = Record(np.arange(n) * 0.1, mode, np.zeros(n), np.zeros(n), np.ones(n), np.ones(n), mode > 5, mode < 5)
    figure = series_figure(record)
    assert {line.get_marker() for line in figure.axes[6].lines} == {"."}
    assert {line.get_marker() for line in figure.axes[2].lines} == {"None"}


def test_a_drive_by_code_shows_the_modes_it_used_and_each_epoch_in_the_strip() -> None:
    n = 6
    mode = np.array([4, 3, 4, 0, 4, 3])
    record = Record(np.arange(n) * 6.0, mode, np.zeros(n), np.zeros(n), np.ones(n), np.ones(n), mode > 5, mode < 5)
    figure = series_figure(record)
    assert [axes.get_ylabel().split(",")[0] for axes in figure.axes[::2]] == ["all modes", "code", "IMU + odometer"]
    strip = {bars.get_label(): bars for bars in figure.axes[0].collections if len(bars.get_paths()) == 3}
    (code,) = strip.values()
    assert [path.get_extents().x0 for path in code.get_paths()] == pytest.approx([0.0, 0.2, 0.4])
    assert [path.get_extents().width for path in code.get_paths()] == pytest.approx([0.1] * 3)


def test_a_drive_on_a_service_shows_it_and_is_grey_where_there_are_no_epochs() -> None:
    time = np.array([0.0, 1.0, 2.0, 3.0, 200.0, 201.0])
    mode, n = np.full(6, int(Mode.SPP)), 6
    record = Record(time, mode, np.ones(n), np.ones(n), np.full(n, 9.0), np.full(n, 9.0), mode > 9, mode < 9)
    figure = series_figure(record)
    assert [axes.get_ylabel().split(",")[0] for axes in figure.axes[::2]] == ["all modes", Mode.SPP.label]
    line = figure.axes[0].lines[0]
    across = np.flatnonzero(np.diff(line.get_xdata()) > 1.0)  # from 3 s to 200 s
    assert across.size == 1
    assert np.isnan(line.get_ydata()[across[0] + 1])
    strip = {
        bars.get_facecolor()[0][:3].tobytes(): [tuple(p.get_extents().intervalx) for p in bars.get_paths()]
        for bars in figure.axes[0].collections
        if bars.get_paths() and bars.get_paths()[0].get_extents().y0 > 0.9
    }
    covered = sorted(strip.values(), key=len)
    assert covered[0] == [pytest.approx((4.0 / 60.0, 200.0 / 60.0))]  # grey
    assert covered[1] == [pytest.approx((0.0, 4.0 / 60.0)), pytest.approx((200.0 / 60.0, 201.0 / 60.0))]
    assert "no solution" in [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize(
    ("risk", "text"), [(None, ""), (1e-6, ", integrity risk $10^{-6}$"), (2e-5, ", integrity risk 2e-05")]
)
def test_titles_name_the_risk(drive: Record, risk: float | None, text: str) -> None:
    assert stanford_figure(drive, 1.0, 1.0, risk=risk).get_suptitle() == f"Stanford diagram{text}"
    assert series_figure(drive, risk=risk).get_suptitle().endswith(f"(PL){text}")


def test_series_figure_refuses_a_batch(drive: Record) -> None:
    two = {name: (v if name == "time_s" else np.stack([v, v], -1)) for name, v in vars(drive).items()}
    with pytest.raises(InputError, match="one vehicle"):
        series_figure(Record(**two))


def test_map_figure(tmp_path: Path) -> None:
    position = np.stack([np.arange(5.0), np.zeros(5)], -1)
    figure = map_figure(position, [1, 1, 2, 3, 0], obstacles=[np.eye(3)[:, :2]], alert=[False] * 4 + [True])
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]  # type: ignore[union-attr]
    assert labels[0] == "RTK (40.0 %)"
    assert labels[-4:] == ["alert", "first estimate", "last estimate", "buildings, overpasses"]
    ends = [c for c in figure.axes[0].collections if c.get_label() in ("first estimate", "last estimate")]
    start, end = (np.asarray(c.get_offsets()).tolist() for c in ends)
    assert (start, end) == ([[0.0, 0.0]], [[4.0, 0.0]])
    assert save(figure, tmp_path / "deep" / "map.png").stat().st_size > 1000
    with pytest.raises(InputError, match="mode"):
        map_figure(position, [1, 2])


def test_the_truth_is_drawn_over_the_map() -> None:
    position = np.stack([np.arange(5.0), np.zeros(5)], -1)
    figure = map_figure(position, [1, 1, 2, 3, 0], truth_en_m=position + 0.5)
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "truth"]
    np.testing.assert_array_equal(line.get_xydata(), position + 0.5)
    dots = [c for c in figure.axes[0].collections if c.get_label() not in ("first estimate", "last estimate")]
    assert dots
    assert all(line.get_zorder() > c.get_zorder() for c in dots)
    with pytest.raises(InputError, match="truth_en_m"):
        map_figure(position, [1, 1, 2, 3, 0], truth_en_m=np.zeros((3, 3)))


def test_an_assessment_is_data_for_json(drive: Record) -> None:
    summary = json.loads(json.dumps(assess(drive, 1.0, 1.0), allow_nan=False))
    assert summary["events"]["ct"]["counts"]["hmi"] == 1
    assert summary["mode_share"]["none"] == 0.125


def test_counting_needs_no_matplotlib() -> None:
    code = "import sys, lanebound.integrity.assessment.accuracy; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_modes_have_keys_and_labels() -> None:
    assert [mode.key for mode in Mode] == [
        "none", "rtk", "doppler", "imu_odometer", "code", "spp", "dgps", "sbas_l1", "sbas_dfmc", "ppp", "nrtk",
    ]  # fmt: skip
    assert Mode.IMU_ODOMETER.label == "IMU + odometer"
