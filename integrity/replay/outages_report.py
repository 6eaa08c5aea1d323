"""Statistics and figures of artificial outages of a highway drive: drift compared with S1, errors and levels."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lanebound.integrity.assessment.bounding import measure_bounding
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, risk_text, save, tidy
from lanebound.integrity.recorded.comma import read_comma
from lanebound.integrity.replay.outages import Motion, OutageConfig, OutageErrors, motion_of, run_outages, sawtooth
from lanebound.integrity.replay.recording_checks import check_comma

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["S1_AGE_S", "S1_DRIFT_M", "S1_HEADING_DEG", "S1_SPEED_MPS", "by_age", "drift_figure", "write_outages"]


AGES_S = (1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 20.0)
TOOTH_S, FIXED_S = 8.0, 3.0  # duration of outages and fixes in the sawtooth figure
S1_DRIFT_M, S1_AGE_S = 0.53, 4.0  # S1 section 5, largest error of IMU and odometer after 4 s
S1_SPEED_MPS = 10.0  # assumed for an urban drive; S1 does not give the speed
S1_HEADING_DEG = math.degrees(math.asin(S1_DRIFT_M / (S1_SPEED_MPS * S1_AGE_S)))  # explains the drift; 0.76 deg
CAUTION = "outages overlap and are from one minute of one drive: the exact intervals are too narrow"


def by_age(outages: OutageErrors, ages_s: tuple[float, ...] = AGES_S) -> list[dict[str, Any]]:
    """Errors, levels and exceedances at some ages as JSON data."""
    rows = []
    for age in ages_s:
        k = int(np.argmin(np.abs(outages.age_s - age)))
        error, pl = np.abs(outages.error_m[:, k]), outages.pl_m[:, k]
        row: dict[str, Any] = {"age_s": float(outages.age_s[k]), "outages": len(error)}
        for q, axis in enumerate(("at", "ct")):
            row[axis] = {
                "median_m": float(np.median(error[:, q])), "p95_m": float(np.quantile(error[:, q], 0.95)),
                "max_m": float(error[:, q].max()), "pl_median_m": float(np.median(pl[:, q])),
                "exceeded": int((error[:, q] > pl[:, q]).sum()),
            }  # fmt: skip
        rows.append(row)
    return rows


def _against_s1(motion: Motion, config: OutageConfig) -> dict[str, Any]:
    """Cross-track error after 4 s with the heading error of S1, compared with S1's error scaled by the distance."""
    given = config.replace(heading_error_deg=S1_HEADING_DEG)
    outages = run_outages(motion, given)
    k = int(np.argmin(np.abs(outages.age_s - S1_AGE_S)))
    reached = np.abs(outages.error_m[:, k, 1])
    expected = S1_DRIFT_M * outages.speed_mps / S1_SPEED_MPS
    last = np.abs(outages.error_m[:, -1, 1])
    return {
        "heading_error_deg": S1_HEADING_DEG, "age_s": S1_AGE_S, "outages": len(reached),
        "ct_median_m": float(np.median(reached)), "s1_scaled_median_m": float(np.median(expected)),
        "ratio_median": float(np.median(reached / expected)),
        "ratio_5_95": [float(v) for v in np.quantile(reached / expected, [0.05, 0.95])],
        "ct_median_at_the_end_m": float(np.median(last)),
        "exceeded": {axis: asdict(_bounded(outages, q)) for q, axis in enumerate(("at", "ct"))},
    }  # fmt: skip


def _bounded(outages: OutageErrors, q: int) -> Any:
    return measure_bounding(outages.error_m[..., q], outages.pl_m[..., q])


def write_outages(folder: Path, out: Path, config: OutageConfig | None = None) -> tuple[dict[str, Any], list[Path]]:
    """Replay a comma2k19 segment with outages; writes ``replay.json``, ``drift.png`` and ``sawtooth.png`` into ``out``.

    Raises
    ------
    InputError
        The folder is not a comma2k19 segment, or the segment is too short.
    """
    config = config or OutageConfig()
    segment = read_comma(folder)
    agreement = check_comma(segment)
    motion, calibration = motion_of(segment, config)
    outages = run_outages(motion, config)
    figures = {
        "dataset": "comma2k19", "caution": CAUTION,
        "risk": config.risk.integrity_risk, "calibration": calibration,
        "agreement": {name: found.figures() for name, found in agreement.items()},
        "outages": len(outages.start_s), "left_out_at_gaps": outages.left_out, "stopped": segment.notes,
        "speed_mps": [float(v) for v in np.quantile(outages.speed_mps, [0.0, 0.5, 1.0])], "by_age": by_age(outages),
        "all_ages": {axis: asdict(_bounded(outages, q)) for q, axis in enumerate(("at", "ct"))},
        "with_heading_error_of_s1": _against_s1(motion, config),
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    summary = out / "replay.json"
    summary.write_text(json.dumps(figures, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    drift = save(drift_figure(outages, config.risk.integrity_risk), out / "drift.png")
    return figures, [summary, drift, save(_sawtooth_figure(motion, config), out / "sawtooth.png")]


def drift_figure(outages: OutageErrors, risk: float) -> Figure:
    """Error of every outage and median level against the age of the outage."""
    figure = new_figure(11.0, 4.4)
    figure.suptitle("Dead reckoning in artificial outages" + risk_text(risk), fontsize=12, color=INK)
    for q, name in enumerate(("along track", "cross track")):
        axes = figure.add_subplot(1, 2, q + 1)
        lines = axes.plot(outages.age_s, np.abs(outages.error_m[..., q]).T, color=INK, alpha=0.25, linewidth=0.6)
        lines[0].set_label("error of each outage")
        axes.plot(outages.age_s, np.median(outages.pl_m[..., q], 0), color=PL_COLOUR, label="median PL")
        tidy(axes, xlabel="age of the outage (s)", ylabel=f"{name} error and PL (m)")
        legend(axes, loc="upper left")
    return figure


def _sawtooth_figure(motion: Motion, config: OutageConfig) -> Figure:
    """Errors and levels of a drive with alternating fixes and outages."""
    found = sawtooth(motion, config.replace(longest_s=min(TOOTH_S, config.longest_s)), FIXED_S)
    figure = new_figure(11.0, 4.4)
    figure.suptitle("Alternating fixes and outages" + risk_text(config.risk.integrity_risk), fontsize=12, color=INK)
    for q, name in enumerate(("along track", "cross track")):
        axes = figure.add_subplot(1, 2, q + 1)
        axes.plot(found["time_s"], found["pl_m"][:, q], color=PL_COLOUR, label="PL")
        axes.fill_between(found["time_s"], np.abs(found["error_m"][:, q]), color=INK, alpha=0.35, label="error")
        tidy(axes, xlabel="time (s)", ylabel=f"{name} (m)")
        legend(axes, loc="upper left")
    return figure
