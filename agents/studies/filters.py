"""S4's trials over many seeds: errors of filters and of dead reckoning, trust levels, model probabilities.

Consistency of a filter is NEES by state and NIS by sensor vector: a mean of 1 is that of a right covariance; below 1
the filter is better than it states. The figures are S4's 7 to 21.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator
from scipy.stats import t as student
from scipy.stats import ttest_rel, wilcoxon

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.filter_scenarios import (
    AXLE_M,
    CURVED,
    EQUIPMENT,
    FAULTS,
    SCENARIOS,
    SHARP,
    WIDE,
    Scenario,
    disturbed,
    fault_rows,
    law_rows,
    work_fault,
    work_law,
)
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.motion.drive import CityDrive
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.vehicle_filter.navigator import FilterNavigator
from lanebound.integrity.positioning.filters.code_position import locate_by_codes
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.sensors.instruments import Measurements

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

COLOURS = {
    "DR": "#8a8f98",
    "IMM-EKF": "#1b6ca8",
    "IMM-EKF as S4": "#c2571a",
    "EKF": "#1b6ca8",
    "UKF": "#c2571a",
    "SM-EKF": "#c2571a",
    "SM-EKF, yaw noise of curved": "#d9a441",
    "CM-EKF": "#7a3e9d",
}
SHADE = "#e8e8ea"


def save_figures(parts: Mapping[str, Any], out: Path) -> list[Path]:
    """Write the figures of each trial; returns their files."""
    files = []
    for number, part in parts.items():
        series = part["series"]
        for name, draw in (("errors", _errors), ("path", _path), ("integrity", _integrity)):
            figure = new_figure(6.4, 4.4 if name == "path" else 3.4)
            axes = figure.subplots()
            draw(axes, series)
            axes.set_title(f"Scenario {number}: {part['title']}", fontsize=9, loc="left")
            files.append(save(figure, out / f"scenario-{number}-{name}.png"))
    return files


def _gaps(axes: Axes, series: Mapping[str, Any]) -> None:
    """Shade the time without GNSS."""
    time, missing = np.array(series["time_s"]), ~np.array(series["covered"])
    for k in np.flatnonzero(missing):
        axes.axvspan(time[k] - 0.5, time[k] + 0.5, color=SHADE, lw=0, zorder=0)


def _errors(axes: Axes, series: Mapping[str, Any]) -> None:
    """Median errors with the band of 5 to 95 % of the drives (S4 figures 11 to 16 and 19)."""
    _gaps(axes, series)
    for name, (low, middle, high) in series["error_m"].items():
        colour = COLOURS.get(name, INK)
        axes.fill_between(series["time_s"], low, high, color=colour, alpha=0.15, lw=0)
        axes.plot(series["time_s"], middle, color=colour, lw=1.3, label=name)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("horizontal error [m]")
    tidy(axes)
    legend(axes)


def _path(axes: Axes, series: Mapping[str, Any]) -> None:
    """The first drive on the map (S4 figures 7 to 10, 17 and 20)."""
    for name, points in series["path"].items():
        east, north = np.array(points).T
        style: dict[str, Any] = {"color": COLOURS.get(name, INK), "lw": 1}
        if name == "truth":
            style = {"color": INK, "lw": 2.5, "alpha": 0.35}
        axes.plot(east, north, label=name, **style)
    axes.set_aspect("equal")
    axes.set_xlabel("East [m]")
    axes.set_ylabel("North [m]")
    tidy(axes)
    legend(axes)


def _integrity(axes: Axes, series: Mapping[str, Any]) -> None:
    """Error of the first drive, the median trust level and, of two models, the probability (S4 figures 18 and 21)."""
    _gaps(axes, series)
    name = list(series["htl_m"])[-1]
    axes.plot(series["time_s"], series["one_m"][name], color=COLOURS.get(name, INK), lw=1.2, label=f"error, {name}")
    axes.plot(series["time_s"], series["htl_m"][name], color=PL_COLOUR, lw=1.2, ls="-.", label="HTL, median")
    axes.plot(series["time_s"], 2.0 * np.array(series["sigma_m"][name]), color=INK, lw=0.8, ls=":", label="2 sigma")
    if max(series["curved"]) > 0.0:
        axes.plot(series["time_s"], series["curved"], color="#7a3e9d", lw=0.9, label="probability of curved [-]")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("[m]")
    tidy(axes)
    legend(axes)


VECTORS = ("position", "wheels", "gyro", "steering", "slip", "compass")  # in the order of their NIS
MOVING_MPS = 1.0  # slower, the course of the truth is not defined
MARGIN_M = 0.05  # differences of RMS below this count as none; chosen
LEAST = 6  # pairs


class Consistency:
    """Means over epochs and vehicles of one filter.

    Of the states that combine all models: squared error over its variance, of the position the NEES over 2; of vectors
    NIS over their dimension. The slip is that of the course, ``slip + slide``.
    """

    def __init__(self) -> None:
        self._nees: list[Array] = []
        self._slip: list[Array] = []
        self._nis, self._count = np.zeros(len(VECTORS)), np.zeros(len(VECTORS))

    def count(self, navigator: FilterNavigator, truth: Truth, sampled: bool) -> None:
        """Add an epoch; its states only where it is ``sampled``."""
        assert navigator.report is not None
        nis = navigator.report.nis
        used = np.isfinite(nis) & (nis > 0.0)
        self._nis += np.where(used, nis, 0.0).sum(0) / np.array([2.0] + [1.0] * (len(VECTORS) - 1))
        self._count += used.sum(0)
        if sampled:
            self._sample(navigator, truth)

    def _sample(self, navigator: FilterNavigator, truth: Truth) -> None:
        probability, models = navigator.state.belief.probability, navigator.state.belief.models
        x = np.einsum("bj,bjk->bk", probability, models["x"])
        apart = models["x"] - x[:, None]
        p = np.einsum("bj,bjkl->bkl", probability, models["p"] + apart[..., :, None] * apart[..., None, :])
        velocity = truth.velocity_enu_mps[:, :2]
        speed, course = np.linalg.norm(velocity, axis=-1), np.arctan2(velocity[:, 0], velocity[:, 1])
        moving = speed > MOVING_MPS
        off = truth.position_enu_m[:, :2] - x[:, :2]
        position = 0.5 * np.einsum("bi,bij,bj->b", off, np.linalg.inv(p[:, :2, :2]), off)
        heading = np.square(wrap_angle(truth.heading_rad - x[:, S.HEADING])) / p[:, S.HEADING, S.HEADING]
        fast = np.square(speed - x[:, S.SPEED]) / p[:, S.SPEED, S.SPEED]
        slip = wrap_angle(wrap_angle(course - truth.heading_rad) - x[:, S.SLIP] - x[:, S.SLIDE])
        spread = p[:, S.SLIP, S.SLIP] + p[:, S.SLIDE, S.SLIDE] + 2.0 * p[:, S.SLIP, S.SLIDE]
        self._nees.append(np.where(moving, [position, heading, fast, np.square(slip) / spread], np.nan).T)
        self._slip.append(np.where(moving, np.square(slip), np.nan))

    def figures(self) -> dict[str, Any]:
        """NEES by state, NIS by sensor vector, and the RMS of the slip [deg]."""
        found = dict(zip(("position", "heading", "speed", "slip"), _mean(np.array(self._nees), (0, 1)), strict=True))
        shares = self._nis / np.maximum(self._count, 1.0)
        return {
            **{f"NEES of {name}": float(value) for name, value in found.items()},
            **{f"NIS of {name}": float(v) for name, v, n in zip(VECTORS, shares, self._count, strict=True) if n > 0},
            "slip rms [deg]": float(np.rad2deg(np.sqrt(_mean(np.array(self._slip), (0, 1))))),
        }


def _mean(values: Array, axes: tuple[int, ...]) -> Array:
    """Mean without NaN; 0 of nothing."""
    there = np.isfinite(values)
    return np.asarray(np.where(there, values, 0.0).sum(axes) / np.maximum(there.sum(axes), 1))


def paired(name: str, more: Array, less: Array) -> dict[str, Any]:
    """Differences ``more - less`` (n,) of drives: 5 %, median, 95 % of the drives; mean with its 90 % interval, which
    is the test of equivalence (TOST) at 5 % for any margin that holds it; p of the Wilcoxon test and of TOST."""
    apart = more - less
    found: dict[str, Any] = {name: [float(q) for q in np.quantile(apart, [0.05, 0.5, 0.95])]}
    if apart.size < LEAST or not apart.any():
        return found
    mean, error = float(apart.mean()), float(apart.std(ddof=1) / np.sqrt(apart.size))
    half = float(student.isf(0.05, apart.size - 1)) * error
    above = ttest_rel(more, less - MARGIN_M, alternative="greater").pvalue
    below = ttest_rel(more, less + MARGIN_M, alternative="less").pvalue
    return found | {
        f"{name}, mean and 90 %": [mean - half, mean, mean + half],
        f"{name}, p of a difference": float(wilcoxon(more, less).pvalue),
        f"{name}, p of one beyond {MARGIN_M:g} m": float(max(above, below)),
    }


PACKAGES = ("lanebound.integrity", "lanebound.agents.studies")
FAULT, SENSORS, LAW = "fault ", "sensors ", "law"
"""What names of parts begin with: faults, scenario 10 with better sensors, and the fit of static logs."""
SHARPEST = "10"
PLAIN = "as scenario 10: gyro bias 0.1 deg/s, declared 0.4"
OWN: Mapping[str, Any] = {"sensor_errors": False, "position": {"excess_tau_s": 0.0}}
"""What our additions are, taken away."""
EVERY = 10  # epochs between the moments kept for figures


class FiltersConfig(Config):
    """Numbers of the study."""

    seeds: int = Field(100, ge=1, le=2000, description="drives of each trial [-]")
    first_seed: int = Field(1, ge=0, description="of the drives")
    scenarios: tuple[str, ...] = Field(tuple(SCENARIOS), min_length=1, description="numbers of S4's table I")
    vehicles: int = Field(40, ge=0, le=2000, description="vehicles that meet each fault; 0: no faults [-]")
    as_s4: bool = Field(
        False,
        description="S4's own filters in the trials: no states of sensor errors, no memory of innovations; scenario 10 "
        "with its own sensors alone",
    )

    @model_validator(mode="after")
    def _scenarios_are_known(self) -> Self:
        unknown = [number for number in self.scenarios if number not in SCENARIOS]
        if unknown:
            raise ConfigError(f"scenarios must be among {', '.join(SCENARIOS)}, got {unknown[0]!r}: correct it")
        return self


def run_filters(config: FiltersConfig, out: Path, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Drive the missing trials; write ``tables.json`` and the figures, and return the tables.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "filter study", config, PACKAGES)
    faults = [FAULT + name for name in FAULTS] if config.vehicles else []
    sharp = [SENSORS + name for name in SHARP] if SHARPEST in config.scenarios and not config.as_s4 else []
    parts = [*config.scenarios, *sharp, *faults, LAW]
    found = parts_of(config, work_part, parts, out, 1, on_progress)
    trials = {number: found[number] for number in config.scenarios}
    tables = {number: {key: value for key, value in part.items() if key != "series"} for number, part in trials.items()}
    met = {name.removeprefix(FAULT): found[name] for name in faults}
    plain = {PLAIN: found[SHARPEST]["figures"]} if sharp else {}
    result = {
        "seeds": config.seeds, "scenarios": tables, "faults": met, "law": found[LAW],
        "sharp": plain | {name.removeprefix(SENSORS): found[name]["figures"] for name in sharp},
    }  # fmt: skip
    save_figures(trials, out)
    return stored(result, out, "tables.json")


def work_part(config: FiltersConfig, number: str, advance: Advance = ignore) -> dict[str, Any]:
    """One trial: all drives side by side; or one fault; or the static logs."""
    if number.startswith(FAULT):
        return work_fault(number.removeprefix(FAULT), config.vehicles, config.first_seed, advance)
    if number == LAW:
        return work_law(config.seeds, config.first_seed, advance)
    better = number.startswith(SENSORS)
    scenario = SHARP[number.removeprefix(SENSORS)] if better else SCENARIOS[number]
    trial = _Trial(config, scenario)
    epochs = round(scenario.length_s / trial.dt_s)
    for k in range(epochs):
        trial.step(k)
        advance((k + 1) / epochs)
    return trial.summary()


class _Trial:
    """The navigators of one trial, on the same measurements, and what is kept of them."""

    def __init__(self, config: FiltersConfig, scenario: Scenario) -> None:
        self.scenario, seeds = scenario, list(range(config.first_seed, config.first_seed + config.seeds))
        built = {
            name: _navigator(scenario, deep_merge(change, OWN) if config.as_s4 else change, seeds)
            for name, change in scenario.filters.items()
        }
        self.navigators: dict[str, FilterNavigator] = built
        self.first = next(iter(built.values()))
        self.dt_s = self.first.config.dt_s
        self.traffic = Streams(seeds)
        self.car = CityDrive(scenario.road, scenario.drive, self.dt_s, AXLE_M)
        self.state = self.car.start(self.traffic)
        drawn = np.stack([named_generator(seed, "start").standard_normal(4) for seed in seeds])
        self.azimuth_rad = np.pi * np.tanh(drawn[:, 3])
        sigma = np.deg2rad(scenario.heading_deg)
        start = self.state.position_m + scenario.start_sigma_m * drawn[:, :2]
        heading = self.state.heading_rad + sigma * drawn[:, 2]
        for navigator in built.values():
            navigator.place(start, heading, scenario.start_sigma_m, float(sigma))
        self.reckoned = start.copy()
        self.error: dict[str, list[Array]] = {name: [] for name in (*built, "DR")}
        self.trust: dict[str, list[Array]] = {name: [] for name in built}
        self.sigma: dict[str, list[Array]] = {name: [] for name in built}
        self.beyond = {name: np.zeros(2, np.int64) for name in built}
        self.consistency = {name: Consistency() for name in built}
        self.curved: list[Array] = []
        self.quality: list[bool] = []
        self.rejected = np.zeros((2, 2), np.int64)  # right and spurious positions: rejected, used
        self.path: dict[str, list[list[float]]] = {name: [] for name in (*built, "DR", "truth")}

    def step(self, k: int) -> None:
        """One epoch."""
        truth = self.car.step(self.state, self.traffic)
        time_s = (k + 1) * self.dt_s
        m = disturbed(self.scenario, self.first.measure(truth), time_s, self.azimuth_rad)
        position = truth.position_enu_m[:, :2]
        self.reckoned = _reckoned(self.first, m, self.reckoned, self.dt_s)
        self.error["DR"].append(np.linalg.norm(self.reckoned - position, axis=-1))
        for name, navigator in self.navigators.items():
            solution = navigator.locate(m)
            error = np.linalg.norm(solution.position_en_m - position, axis=-1)
            assert navigator.report is not None
            self.error[name].append(error)
            self.trust[name].append(navigator.report.htl_m)
            self.sigma[name].append(np.sqrt(np.trace(solution.covariance_en_m2, axis1=-2, axis2=-1)))
            level = np.hypot(solution.pl_at_m, solution.pl_ct_m)
            self.beyond[name] += [int((error > navigator.report.htl_m).sum()), int((error > level).sum())]
            self.consistency[name].count(navigator, truth, sampled=k % EVERY == 0)
            if k % EVERY == 0:
                self.path[name].append(solution.position_en_m[0].tolist())
        self._count(time_s)
        if k % EVERY == 0:
            self.path["DR"].append(self.reckoned[0].tolist())
            self.path["truth"].append(position[0].tolist())
        last = list(self.navigators.values())[-1].report
        if last is not None:
            self.curved.append(
                last.probability[:, -1] if last.probability.shape[1] > 1 else np.zeros(position.shape[0])
            )
        self.quality.append(not any(low <= time_s < high for low, high in self.scenario.outages_s))

    def _count(self, time_s: float) -> None:
        """Positions rejected and used, spurious ones apart."""
        report = list(self.navigators.values())[-1].report
        assert report is not None
        kind = int(any(low <= time_s < high for low, high in self.scenario.spurious_s))
        self.rejected[kind] += [int(report.gnss_rejected.sum()), int(report.gnss_used.sum())]

    def summary(self) -> dict[str, Any]:
        """Figures as medians over seeds with 5 and 95 %, and the series for figures."""
        out = ~np.array(self.quality)
        error = {name: np.array(rows) for name, rows in self.error.items()}
        figures: dict[str, Any] = {}
        ended = _last_of_first(out)
        for name, e in error.items():
            figures[f"rms {name}"] = _spread(np.sqrt(np.square(e).mean(0)))
            figures[f"max {name}"] = _spread(e.max(0))
            if out.any():
                figures[f"rms in outage {name}"] = _spread(np.sqrt(np.square(e[out]).mean(0)))
                figures[f"max in outage {name}"] = _spread(e[out].max(0))
            if ended is not None:
                figures[f"error at the end of the first outage {name}"] = _spread(e[ended])
        for name, rows in self.trust.items():
            htl = np.array(rows)
            figures[f"HTL exceeded {name}"] = float(self.beyond[name][0] / htl.size)
            figures[f"level exceeded {name}"] = float(self.beyond[name][1] / htl.size)
        htl = np.array(list(self.trust.values())[-1])
        figures["HTL median"] = _spread(np.median(htl, axis=0))
        figures["HTL below 7 m"] = _spread((htl < 7.0).mean(0))
        for name, kept in self.consistency.items():
            figures |= {f"{key}, {name}": value for key, value in kept.figures().items()}
        for more, less in self.scenario.compared:
            rms = [np.sqrt(np.square(error[name]).mean(0)) for name in (more, less)]
            figures |= paired(f"rms of {more} less {less}", *rms)
        for kind, label in enumerate(("right", "spurious")):
            total = int(self.rejected[kind].sum())
            figures[f"{label} positions rejected"] = self.rejected[kind, 0] / total if total else None
        return {"title": self.scenario.title, "paper": dict(self.scenario.paper), "figures": figures,
                "series": self._series(error)}  # fmt: skip

    def _series(self, error: Mapping[str, Array]) -> dict[str, Any]:
        """Each second: quantiles of errors, median trust level and sigma, curved model of the first drive, coverage."""
        part = slice(None, None, EVERY)
        return {
            "time_s": (self.dt_s * (1 + np.arange(len(self.quality)))[part]).tolist(),
            "error_m": {name: np.quantile(e[part], [0.05, 0.5, 0.95], axis=1).tolist() for name, e in error.items()},
            "one_m": {name: e[part, 0].tolist() for name, e in error.items()},
            "htl_m": {name: np.median(np.array(rows)[part], axis=1).tolist() for name, rows in self.trust.items()},
            "sigma_m": {name: np.array(rows)[part, 0].tolist() for name, rows in self.sigma.items()},
            "curved": np.array(self.curved)[part, 0].tolist(),
            "covered": [bool(q) for q in self.quality[part]],
            "path": self.path,
        }


def _navigator(scenario: Scenario, change: Mapping[str, Any], seeds: list[int]) -> FilterNavigator:
    """The navigator of a filter of a trial."""
    data: dict[str, Any] = {"kind": "filter"}
    for more in (EQUIPMENT, scenario.equipment, change):
        data = deep_merge(data, more)
    navigator = Navigator.nominal(NavigatorConfig.load(data), seeds, duration_s=scenario.length_s + 20.0)
    assert isinstance(navigator, FilterNavigator)
    return navigator


def _reckoned(navigator: FilterNavigator, m: Measurements, position_m: Array, dt_s: float) -> Array:
    """S4's dead reckoning: the GNSS position where there is one, else odometer and compass from the last."""
    assert m.compass is not None
    fix = locate_by_codes(navigator.config.position.codes, m)
    heading, run = m.compass.heading_rad, m.odometer.speed_mps * dt_s
    moved = position_m + run[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
    return np.where(fix.valid[:, None], fix.position_m[:, :2], moved)


def _last_of_first(out: NDArray[np.bool_]) -> int | None:
    """Last epoch of the first outage by ``out`` (T,); None without one that ends within the drive."""
    ends = np.flatnonzero(out[:-1] & ~out[1:])
    return int(ends[0]) if ends.size else None


def _spread(values: Array) -> list[float]:
    """5 %, median and 95 % over seeds."""
    return [float(q) for q in np.quantile(values, [0.05, 0.5, 0.95])]


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """The trials against S4, scenario 10 with better sensors, the fit of static logs, and faults."""
    yield f"S4 against ours: medians over {result['seeds']} drives [m]", table_rows(result)
    if result["sharp"]:
        yield "Scenario 10 with better sensors [m]; S4: below 3, -, 0.48, -", sharp_rows(result)
    yield "Warm-up error of accelerometers: the fit of logs made by S4's law", law_rows(result["law"])
    if result["faults"]:
        yield "Spurious positions: with S4's gate and without", fault_rows(result)


def table_rows(result: Mapping[str, Any]) -> Table:
    """Rows: scenario, figure, paper, ours with 5 and 95 %."""
    rows: list[tuple[str, ...]] = []
    for number, found in result["scenarios"].items():
        for key, value in found["figures"].items():
            stated = found["paper"].get(key)
            paper = "-" if stated is None else f"{stated:g}"
            if isinstance(value, list):
                low, middle, high = (f"{v:.2f}" for v in value)
                rows.append((number, key, paper, middle, f"{low} .. {high}"))
            elif value is not None:
                rows.append((number, key, paper, f"{value:.3g}", ""))
    return ("trial", "figure", "paper", "ours", "5 .. 95 %"), rows


def sharp_rows(result: Mapping[str, Any]) -> Table:
    """Scenario 10 by its sensors: largest errors of IMM and one model, RMS gained over each single model, median trust
    level; with 5 and 95 %."""
    keys = (
        "max IMM-EKF",
        "max SM-EKF",
        *(f"rms of {name} less IMM-EKF" for name in ("SM-EKF", WIDE, CURVED)),
        "HTL median",
    )
    gained = (f"RMS gained over {name}" for name in ("SM-EKF", "SM-EKF, yaw noise of CM", "CM-EKF"))
    return ("sensors", "largest, IMM", "largest, SM-EKF", *gained, "HTL"), [
        (name, *(f"{figures[key][1]:.2f} ({figures[key][0]:.2f} .. {figures[key][2]:.2f})" for key in keys))
        for name, figures in result["sharp"].items()
    ]
