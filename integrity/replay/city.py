"""Code-only navigation of a recorded city drive: position, protection levels, exclusions and alerts.

Each epoch solves the window of the last seconds (:mod:`.window`), detects and excludes satellites, and computes levels
by solution separation with each satellite as a fault mode. The correlation time of code errors is not assumed: levels
bound every one between the spacing of the window and that of the trained errors, because a code that jumps between
direct and reflected signal would otherwise turn the heading of the window unnoticed. If no solution passes, the
position is propagated from the last solution with wheel speed and yaw rate, and the level grows
(:mod:`lanebound.integrity.monitoring.dead_reckoning_pl`).

Danish re-weighting is optional. Its weights depend on the data, which the levels do not account for, and it can
converge to the wrong signals. Switch it off where the levels must hold.

Error models are trained on the first part of a drive and assessed on the rest, next to simpler ones.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.accuracy import assess, bounding_by_axis, doubt
from lanebound.integrity.assessment.plotting import map_figure, save, series_figure, stanford_figure
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.monitoring.alerts import AlertConfig, AlertLimits, AlertState, step
from lanebound.integrity.monitoring.exclusion import FdeConfig, FdeOutcome, FdeResult, detect_and_exclude
from lanebound.integrity.monitoring.protection import protection_levels
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.monitoring.separation import separate
from lanebound.integrity.positioning.danish import DanishConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.smartloc import SmartLoc, read_smartloc
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.code_epochs import recorded_epochs
from lanebound.integrity.replay.reckoning import Bridge, BridgeConfig, DeadReckonedPath, reckon, turned
from lanebound.integrity.replay.sensor_checks import check_smartloc
from lanebound.integrity.replay.training import CodeErrors, train
from lanebound.integrity.replay.window import (
    FIXED_UNKNOWNS,
    PSI,
    ErrorCourse,
    LocalFrame,
    WhitenedSystem,
    WindowRows,
    settle,
)
from lanebound.integrity.sky.orbit import ranges_and_sights

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

GOOD_ENOUGH = (FdeOutcome.CLEAN.code, FdeOutcome.EXCLUDED.code)
EPOCH_S = 0.2  # of smartLoc, the least time between epochs of a window
TURNS = 8  # number of initial values of the heading


class CodeReplayConfig(Config):
    """Parameters of code-only navigation and of its protection levels."""

    window_s: float = Field(40.0, ge=0.0, le=300.0, description="length of a window [s]; 200 m at 5 m/s")
    spacing_s: float = Field(1.0, ge=0.0, description="time between epochs of a window [s]; below the errors' duration")
    shortest_s: float = Field(
        1.0,
        gt=0.0,
        description="shortest correlation time of code errors that levels bound [s]; jumps between paths within the "
        "spacing of a window; the longest one is that of the trained errors",
    )
    cn0_min_dbhz: float = Field(20.0, ge=0.0, description="lowest C/N0 used [dB-Hz]")
    path_error: float = Field(0.02, ge=0.0, description="error of the dead-reckoned path over its length [-]; 1 sigma")
    axle_m: float = Field(0.0, ge=0.0, le=20.0, description="antenna ahead of the rear axle [m]; unknown for smartLoc")
    minimum_satellites: int = Field(5, ge=5, description="fewer satellites at an epoch: dead reckoning [-]")
    satellite_prior: float = Field(1e-3, gt=0.0, lt=1.0, description="P(a satellite's errors exceed their bound) [-]")
    danish: DanishConfig = DanishConfig(iterations=0)
    fde: FdeConfig = FdeConfig()
    risk: RiskConfig = RiskConfig(integrity_risk=1e-3)
    bridge: BridgeConfig = BridgeConfig()


@dataclass(frozen=True)
class CodeReplay:
    """Epochs (T,): time [s], position (T, 3) in ``frame`` [m], heading [rad], mode, levels and sigmas (T, 2) on AT and
    CT [m], numbers of satellites and of excluded satellites, share of rows with reduced weight."""

    frame: LocalFrame
    time_s: Array
    position_enu_m: Array
    heading_rad: Array
    mode: Ints
    pl_m: Array
    sigma_m: Array
    satellites: Ints
    excluded: Ints
    reweighted: Array

    def record(
        self, drive: SmartLoc, alerts: AlertConfig, after_s: float = -math.inf, before_s: float = math.inf,
        window_s: float = 0.0,
    ) -> Record:  # fmt: skip
        """Record of estimate and truth for epochs in [after, before) with a position; errors in the estimated track.

        Epochs in a gap of wheels and gyro, or up to ``window_s`` after it, are left out.

        Raises
        ------
        InputError
            There is no truth, or no such epoch.
        """
        if drive.truth is None:
            raise InputError("drive must have a ground truth to be assessed, has none: give its *_GT file")
        true, known = drive.truth.at(self.time_s)
        known &= ~drive.bridged(self.time_s, window_s)  # a window with a gap has a path that was not measured
        keep = known & (self.mode != Mode.NONE) & (self.time_s >= after_s) & (self.time_s < before_s)
        if not keep.any():
            raise InputError(f"[{after_s}, {before_s}) must hold epochs with position and truth, has none: widen it")
        off = (self.position_enu_m - self.frame.local(true))[keep, :2]
        track = (track_from_enu_matrix(self.heading_rad[keep]) @ off[:, :, None])[..., 0]
        pl = self.pl_m[keep]
        alert, available = self.alerts(alerts)
        return Record(
            self.time_s[keep], self.mode[keep], track[:, 0], track[:, 1], pl[:, 0], pl[:, 1], alert[keep],
            available[keep],
        )  # fmt: skip

    def alerts(self, config: AlertConfig) -> tuple[Bools, Bools]:
        """Whether there is an alert, and whether the position is available, at every epoch.  (T,) each."""
        state, steps = AlertState.initial(1), np.diff(self.time_s, prepend=2.0 * self.time_s[0] - self.time_s[1])
        found = [step(config, state, pl[:1], pl[1:], float(dt)) for pl, dt in zip(self.pl_m, steps, strict=True)]
        return np.array([s.alert[0] for s in found]), np.array([s.available[0] for s in found])


def drive_city(
    drive: SmartLoc, errors: CodeErrors | None, config: CodeReplayConfig,
    outages_s: tuple[tuple[float, float], ...] = (), every: int = 1, first: int = 0,
    progress: Progress = silent,
) -> CodeReplay:  # fmt: skip
    """Solve a drive epoch by epoch.

    ``errors`` are trained bounds; with None the errors are independent zero-mean Gaussian noise with the variances
    given by the receiver. ``outages_s`` are intervals (start, end) in which no signal is used. Only each ``every``-th
    epoch is solved, from number ``first`` on. ``progress`` is called with the number of solved epochs and the total
    number.

    Raises
    ------
    InputError
        There is no odometry, or no epoch has enough satellites for a first fix.
    """
    return _CityRun(drive, errors, config, outages_s).drive(every, first, progress)


class _CityRun:
    """Data and state of one drive: last unknowns and growth of the levels."""

    def __init__(
        self,
        drive: SmartLoc,
        errors: CodeErrors | None,
        config: CodeReplayConfig,
        outages: tuple[tuple[float, float], ...],
    ) -> None:
        o, r = drive.odometry, drive.ranges
        if o.time_s.size < 2:
            raise InputError(f"drive must have odometry, got {o.time_s.size} lines 'odom3': give the whole file")
        self.config, self.ranges = config, r
        self.path = reckon(o.time_s, o.speed_mps, -o.yaw_rate_left_radps, config.axle_m)
        self.time = np.unique(r.time_s)
        self.on_path = _path_at(self.path, r.time_s)
        self.now_path = _path_at(self.path, self.time)
        self.speed = np.interp(self.time, o.time_s, o.speed_mps)
        if errors is None:
            self.centre, self.sigma, tau_s = np.zeros(r.time_s.size), np.sqrt(r.variance_m2), 0.0
        else:
            self.centre, self.sigma = errors.at(r.cn0_dbhz)
            tau_s = errors.tau_s
        self.course = ErrorCourse.between(config.shortest_s, tau_s, max(config.spacing_s, EPOCH_S))
        self.usable = (r.cn0_dbhz >= config.cn0_min_dbhz) & (self.sigma > 0.0)
        for start, end in outages:
            self.usable &= ~((r.time_s >= start) & (r.time_s < end))
        self.systems = np.unique(r.system[self.usable])
        self.epoch = np.searchsorted(self.time, r.time_s)
        self.frame = self._first_frame()
        self.x: Array | None = None
        self.bridge: Bridge | None = None

    def _first_frame(self) -> LocalFrame:
        """Local frame at the fix of the first epoch with enough signals; the iteration starts at the Earth's centre."""
        count = np.bincount(self.epoch[self.usable], minlength=self.time.size)
        enough = np.flatnonzero(count >= self.config.minimum_satellites)
        if not enough.size:
            raise InputError(
                f"drive must have an epoch of {self.config.minimum_satellites} satellites, the best has "
                f"{count.max(initial=0)}: lower cn0_min_dbhz"
            )
        own = self.usable & (self.epoch == enough[0])
        r = self.ranges
        x = np.zeros(4)
        for _ in range(12):
            distance, sight = ranges_and_sights(r.satellite_ecef_m[own], x[:3])
            design = np.column_stack([-sight, np.ones(len(sight))])
            x += np.linalg.lstsq(design, r.range_m[own] - self.centre[own] - distance - x[3], rcond=None)[0]
        self.first_clock = float(x[3])
        return LocalFrame.at(x[:3])

    def drive(self, every: int, first: int, progress: Progress) -> CodeReplay:
        """Solve each ``every``-th epoch from ``first`` on."""
        chosen = np.arange(first, self.time.size, every)
        n = chosen.size
        out = CodeReplay(
            self.frame, self.time[chosen], np.zeros((n, 3)), np.zeros(n), np.full(n, int(Mode.NONE)),
            np.full((n, 2), np.inf), np.full((n, 2), np.inf), np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n),
        )  # fmt: skip
        before = first
        for i, k in enumerate(map(int, chosen)):
            if not self._solve(k, i, out):
                self._propagate(before, k, i, out)
            before = k
            progress(i + 1, n)
        return out

    def _solve(self, k: int, i: int, out: CodeReplay) -> bool:
        """Solve one epoch with its window; False without a usable solution."""
        now = self.usable & (self.epoch == k)
        out.satellites[i] = int(now.sum())
        if out.satellites[i] < self.config.minimum_satellites:
            return False
        rows = self._rows(k)
        system = self._solve_window(rows)
        fde = self._detect(system, system.x[PSI] + self.now_path[k, 2])
        out.excluded[i], out.reweighted[i] = int(fde.excluded.sum()), float((system.factor > 1.0).mean())
        if int(fde.outcome) not in GOOD_ENOUGH:
            return False
        x = system.x + fde.adjustment.x
        heading = float(x[PSI] + self.now_path[k, 2])
        levels, sigma = self._levels(system, fde, heading)
        if not np.isfinite(levels).all():
            return False
        self.x = x
        gain = fde.adjustment.gain[[0, 1, PSI]]
        joint = gain @ gain.T
        self.bridge = Bridge(
            self.config.bridge, self.config.risk, joint[:2, :2], levels, sigma, heading, with_heading=joint[2]
        )
        out.position_enu_m[i], out.heading_rad[i], out.mode[i] = x[:3], heading, int(Mode.CODE)
        out.pl_m[i], out.sigma_m[i] = levels, sigma
        return True

    def _rows(self, k: int) -> WindowRows:
        """Pseudoranges of the window that ends at epoch k."""
        r, age = self.ranges, self.time - self.time[k]
        wanted = np.zeros(self.time.size, np.bool_)
        last = math.inf
        for j in range(k, -1, -1):
            if age[j] < -self.config.window_s:
                break
            if last - age[j] >= self.config.spacing_s - 0.05:
                wanted[j], last = True, age[j]
        own = np.flatnonzero(self.usable & wanted[self.epoch])
        _, satellite = np.unique(r.satellite[own], return_inverse=True)
        way = self.on_path[own, :2] - self.now_path[k, :2]
        length = self.now_path[k, 3] - self.on_path[own, 3]
        sigma = np.hypot(self.sigma[own], self.config.path_error * length)
        return WindowRows(
            age[self.epoch[own]], r.range_m[own] - self.centre[own], sigma, r.satellite_ecef_m[own],
            satellite.astype(np.int64), np.searchsorted(self.systems, r.system[own]), way, length,
        )  # fmt: skip

    def _solve_window(self, rows: WindowRows) -> WhitenedSystem:
        """The solved window, started at the last solution, or at several headings if there is none."""
        size = FIXED_UNKNOWNS + max(self.systems.size - 1, 0)
        if self.x is not None:
            return settle(rows, self.frame, self.x.copy(), self.course, self.config.danish)
        best: WhitenedSystem | None = None
        for turn in range(TURNS):
            start = np.zeros(size)
            start[3], start[PSI] = self.first_clock, 2.0 * np.pi * turn / TURNS
            found = settle(rows, self.frame, start, self.course, self.config.danish)
            if best is None or _cost(found) < _cost(best):
                best = found
        assert best is not None
        return best

    def _detect(self, system: WhitenedSystem, heading: float) -> FdeResult:
        """Detection and exclusion with each satellite as a fault mode."""
        rows = len(system.y)
        modes = system.owner == np.arange(int(system.owner.max()) + 1)[:, None]
        return detect_and_exclude(
            self.config.fde, system.design, np.eye(rows), system.y, modes=modes, heading_rad=heading
        )

    def _levels(self, system: WhitenedSystem, fde: FdeResult, heading: float) -> tuple[Array, Array]:
        """Protection levels and sigmas (2,) on AT, CT."""
        used = fde.used
        present = np.unique(system.owner[used])
        modes = system.owner == present[present >= 0][:, None]
        parts = separate(system.design, np.eye(len(system.y)), modes, heading, rows=used)
        priors = np.full(modes.shape[0], self.config.satellite_prior)
        levels = protection_levels(parts, priors, self.config.risk)[0]
        return levels, parts.sigma_m[0]

    def _propagate(self, before: int, k: int, i: int, out: CodeReplay) -> None:
        """Propagate from the last epoch with wheel speed and yaw rate."""
        if self.bridge is None or self.x is None:
            return
        heading = float(self.x[PSI] + self.now_path[k, 2])
        dt = float(self.time[k] - self.time[before])
        way = turned(self.now_path[k, :2] - self.now_path[before, :2], float(self.x[PSI]))
        self.x[:2] += way
        self.x[3] += self.x[4] * dt
        levels, sigma = self.bridge.step(dt, float(np.linalg.norm(way)) / dt, heading)
        out.position_enu_m[i], out.heading_rad[i], out.mode[i] = self.x[:3], heading, int(Mode.IMU_ODOMETER)
        out.pl_m[i], out.sigma_m[i] = levels, sigma


def _cost(system: WhitenedSystem) -> float:
    """Sum of squared residuals of the whole window at its end."""
    x = np.linalg.lstsq(system.design, system.y, rcond=None)[0]
    return float(((system.y - system.design @ x) ** 2).sum() + system.misfit.sum() + 2.0 * np.log(system.factor).sum())


def _path_at(path: DeadReckonedPath, time_s: Array) -> Array:
    """East, North, heading and distance of the path at times (T,): (T, 4)."""
    columns = (path.position_m[:, 0], path.position_m[:, 1], path.heading_rad, path.distance_m)
    return interpolated(time_s, path.time_s, np.stack(columns, -1))


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
        risk, after = self.config.solution.risk.integrity_risk, self.record("overbound", "after_training")
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
            "risk": risk, "doubt": None if after is None else doubt(risk, *after.by_epoch(), "epochs of overbound"),
            "trained_until_s": self.until_s, "caution": CAUTION,
            "bounds": {key: np.round(value, 3).tolist() for key, value in asdict(self.errors).items()},
            "solutions": parts,
        }  # fmt: skip


def _bounds(record: Record) -> dict[str, Any]:
    """Exceedances of the levels on each axis, over all modes."""
    return {"all_modes": bounding_by_axis(*record.by_epoch())}


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
    """Read the smartLoc drive of a folder with its truth, against which wheels, gyro and times of codes are checked.

    Raises
    ------
    InputError
        The folder does not contain both files, a sensor contradicts the truth, or no epoch determines a position.
    """
    found = find_smartloc(folder)
    if found is None or found[1] is None:
        raise InputError(f"{folder} must hold *_Input.txt(.gz) and *_GT.txt of smartLoc: give another folder")
    drive = read_smartloc(*found)
    check_smartloc(drive)
    recorded_epochs(drive)  # which tests the times of the codes
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
    written = write_summary(out / "replay.json", summary)
    return summary, [written, *_figures(result, out)]


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
