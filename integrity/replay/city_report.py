"""Files of a code-only drive: trained on its first part, assessed on the rest, compared with simpler error models."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.integrity.assessment.bounding import measure_bounding
from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.assessment.record import AXES, Record
from lanebound.integrity.assessment.report import assess
from lanebound.integrity.assessment.series import map_figure, series_figure
from lanebound.integrity.assessment.stanford import stanford_figure
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.monitoring.alerts import AlertConfig, AlertLimits
from lanebound.integrity.positioning.danish import DanishConfig
from lanebound.integrity.recorded.smartloc import SmartLoc, read_smartloc
from lanebound.integrity.replay.city import CodeReplay, CodeReplayConfig, drive_city
from lanebound.integrity.replay.overbound import CodeErrors
from lanebound.integrity.replay.recording_checks import check_smartloc
from lanebound.integrity.replay.training import train

__all__ = ["CityReplay", "CityResult", "find_smartloc", "read_city", "replay_city", "write_city"]

CAUTION = (
    "epochs of one drive are not independent: adjacent epochs share most of their signals. The exact intervals are "
    "therefore too narrow"
)


class CityReplay(Config):
    """Parameters of training, solution and alerts."""

    training_share: float = Field(0.4, gt=0, lt=1, description="first part of the drive, used to fit the bounds [-]")
    every: int = Field(1, ge=1, description="every n-th epoch is solved [-]")
    first: int = Field(0, ge=0, le=100, description="number of the first solved epoch [-]")
    solution: CodeReplayConfig = CodeReplayConfig()
    alerts: AlertConfig = AlertConfig(limits=AlertLimits(al_at_m=25.0, al_ct_m=25.0))


@dataclass(frozen=True)
class CityResult:
    """Solutions of a drive: ``overbound`` (trained bounds), ``danish`` (the same with re-weighting), ``gaussian``
    (variances of the receiver as Gaussian noise) and ``gaussian_epoch`` (the same without the window)."""

    config: CityReplay
    drive: SmartLoc
    until_s: float
    errors: CodeErrors
    solutions: dict[str, CodeReplay]

    def parts(self) -> dict[str, tuple[float, float]]:
        """Intervals [from, to) [s] of the training, of the time after it, and of windows completely after it."""
        clear = self.until_s + self.config.solution.window_s
        return {
            "training": (-np.inf, self.until_s), "after_training": (self.until_s, np.inf), "unshared": (clear, np.inf)
        }  # fmt: skip

    def record(self, name: str, part: str) -> Record | None:
        """Record of a solution in a part; None if the part has no epoch."""
        after, before = self.parts()[part]
        try:
            return self.solutions[name].record(
                self.drive, self.config.alerts, after, before, self.config.solution.window_s
            )
        except InputError:
            return None

    def summary(self) -> dict[str, Any]:
        """Statistics as JSON data."""
        limits, best = self.config.alerts.limits, self.solutions["overbound"]
        parts = {}
        for name, solution in self.solutions.items():
            parts[name] = {
                "fde": {
                    "epochs_with_exclusion": int((solution.excluded > 0).sum()),
                    "satellites_excluded": int(solution.excluded.sum()),
                    "most_at_once": int(solution.excluded.max(initial=0)),
                    "rows_reweighted": float(solution.reweighted.mean()),
                },
                "alert_share": float(solution.alerts(self.config.alerts)[0].mean()),
            }
            for part in self.parts():
                record = self.record(name, part)
                if record is not None:
                    figures = assess(record, limits.al_at_m, limits.al_ct_m)
                    parts[name][part] = {**_bounds(record), **figures}
        return {
            "agreement": {name: found.figures() for name, found in check_smartloc(self.drive).items()},
            "left_out_at_gaps": int(self.drive.bridged(best.time_s, self.config.solution.window_s).sum()),
            "risk": self.config.solution.risk.integrity_risk, "trained_until_s": self.until_s, "caution": CAUTION,
            "bounds": {key: np.round(value, 3).tolist() for key, value in asdict(self.errors).items()},
            "solutions": parts,
        }  # fmt: skip


def _bounds(record: Record) -> dict[str, Any]:
    """Exceedances of the levels on each axis, over all modes."""
    return {"all_modes": {a: asdict(measure_bounding(record.error(a), record.pl(a))) for a in AXES}}


def replay_city(drive: SmartLoc, config: CityReplay | None = None, progress: Progress = silent) -> CityResult:
    """Train on the first part of a drive, then solve all of it with the trained bounds and with simpler models.

    ``progress`` is called with the number of solved epochs and the total number, over all four solutions.

    Raises
    ------
    InputError
        The drive has no truth, or too few signals.
    """
    config = config or CityReplay()
    time = drive.ranges.time_s
    until = float(time[0] + config.training_share * (time[-1] - time[0]))
    errors = train(drive, until)
    plain = config.solution.replace(danish={"iterations": 0})
    again = config.solution.replace(danish={"iterations": DanishConfig().iterations})
    models: dict[str, tuple[CodeErrors | None, CodeReplayConfig]] = {
        "overbound": (errors, config.solution),
        "danish": (errors, again),
        "gaussian": (None, plain),
        "gaussian_epoch": (None, plain.replace(window_s=0.0)),
    }
    solutions: dict[str, CodeReplay] = {}
    for name, (bounds, solution) in models.items():

        def count(done: int, of: int, before: int = len(solutions)) -> None:
            progress(before * of + done, of * len(models))

        solutions[name] = drive_city(drive, bounds, solution, every=config.every, first=config.first, progress=count)
    return CityResult(config, drive, until, errors, solutions)


def find_smartloc(folder: Path) -> tuple[Path, Path | None] | None:
    """The input file and the truth file (or None) of a smartLoc folder; None for other folders."""
    inputs = sorted(folder.glob("*_Input.txt*"))
    truths = sorted(folder.glob("*_GT.txt*"))
    return (inputs[0], truths[0] if truths else None) if inputs else None


def read_city(folder: Path) -> SmartLoc:
    """Read the smartLoc drive of a folder with its truth, against which wheels and gyro are checked.

    Raises
    ------
    InputError
        The folder does not contain both files, or a sensor contradicts the truth.
    """
    found = find_smartloc(folder)
    if found is None or found[1] is None:
        raise InputError(f"{folder} must hold *_Input.txt(.gz) and *_GT.txt of smartLoc: give another folder")
    drive = read_smartloc(*found)
    check_smartloc(drive)
    return drive


def write_city(
    folder: Path, out: Path, config: CityReplay | None = None, progress: Progress = silent
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a smartLoc folder and write ``replay.json``, Stanford diagrams, series and map into ``out``.

    ``progress`` is called with the number of solved epochs and the total number.

    Raises
    ------
    InputError
        The folder contains no smartLoc drive with its truth.
    """
    drive = read_city(folder)
    result = replay_city(drive, config, progress)
    summary = {"dataset": "smartloc", "stopped": drive.notes, **result.summary()}
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "replay.json"]
    written[0].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return summary, [*written, *_figures(result, out)]


def _figures(result: CityResult, out: Path) -> list[Path]:
    """A Stanford diagram of each solution after training; time series and map of the solution with trained bounds."""
    limits, risk = result.config.alerts.limits, result.config.solution.risk.integrity_risk
    written = []
    for name in result.solutions:
        record = result.record(name, "after_training")
        if record is not None:
            title = f"{name.replace('_', ', ')}: after training"
            figure = stanford_figure(record, limits.al_at_m, limits.al_ct_m, title=title, risk=risk)
            written.append(save(figure, out / f"stanford_{name}.png"))
    best = result.solutions["overbound"]
    whole = best.record(result.drive, result.config.alerts)
    written.append(
        save(series_figure(whole, risk=risk, al_at_m=limits.al_at_m, al_ct_m=limits.al_ct_m), out / "series.png")
    )
    alert, _ = best.alerts(result.config.alerts)
    assert result.drive.truth is not None  # checked by record
    true, known = result.drive.truth.at(best.time_s)
    figure = map_figure(
        best.position_enu_m[:, :2], best.mode, title="estimated and true positions", alert=alert,
        truth_en_m=best.frame.local(true)[known, :2],
    )  # fmt: skip
    return [*written, save(figure, out / "map.png")]
