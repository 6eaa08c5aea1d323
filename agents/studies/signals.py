"""Errors of code and Doppler of a recorded drive next to those of a simulated receiver.

Codes are compared by C/N0 and elevation. The recorded drive is shown in two halves: figures may be chosen by the first,
and are judged by the second. A raw table of a part of the drive, with a label for each signal whose direct ray is
blocked, adds code and Doppler errors by path.

Recorded, labelled and simulated residuals are treated alike. The receiver's clock at an epoch is the median residual of
its GPS signals of 40 dB-Hz and more; from the code residuals of every other system their median at 42 dB-Hz and more is
taken.

Signals of one satellite are not independent: intervals of recorded quantiles are by resampling satellites.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Counter, OnProgress, RunProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.street_drives import StreetDrivesConfig, street_of
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.assessment.plotting import legend, new_figure, save, tidy
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.recorded.smartloc import SmartLoc, SmartLocRaw, read_smartloc, read_smartloc_raw
from lanebound.integrity.replay.signal_choice import LETTERS
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.orbit import ranges_and_sights
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, WAVELENGTH_M, System
from lanebound.integrity.sky.visibility import SignalPath

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
QUANTILES = (0.5, 0.75, 0.9, 0.95)
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CLOCK_DBHZ, OFFSET_DBHZ = 40.0, 42.0
LEAST_GPS = 3  # signals for the clock of an epoch
EVERY = 5  # epochs of the simulation between those that count
SYSTEMS = {**LETTERS, "R": System.GLONASS}
UNKNOWN = -1
GLONASS_NUMBERS = 300  # smartLoc: number of a GLONASS satellite less its slot
GLONASS_STEP_HZ, GLONASS_MIDDLE = 0.5625e6, 7  # spacing of channels, and number of channel 0 in raw tables
SAME_PLACE_M, SAME_TIME_S = 0.05, 0.05  # of an epoch in both forms of a drive
RATE_SPAN_S = 2.0  # on both sides, of the satellite positions whose ranges give a rate


class SignalResiduals(NamedTuple):
    """N signals, (N,) each: time [s], system, satellite, residuals (observed less computed) of code [m] and range rate
    [m/s], NaN where not measured, elevation [deg], C/N0 [dB-Hz], and whether the direct ray is blocked: 1, 0, or -1
    where that is not known."""

    time_s: Array
    system: Ints
    satellite: Ints
    code_m: Array
    rate_mps: Array
    elevation_deg: Array
    cn0_dbhz: Array
    blocked: Ints

    def take(self, rows: Bools | Ints) -> SignalResiduals:
        """Some of the signals."""
        columns: Any = (column[rows] for column in self)
        return SignalResiduals(*columns)

    @staticmethod
    def join(parts: Sequence[SignalResiduals]) -> SignalResiduals:
        """All signals of several."""
        return SignalResiduals(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def without_clock(signals: SignalResiduals) -> SignalResiduals:
    """Residuals without the clock of each epoch and the offset of each system; epochs with few GPS signals go.

    Raises
    ------
    InputError
        No epoch has enough GPS signals.
    """
    s = signals
    _, epoch = np.unique(s.time_s, return_inverse=True)
    strong = (s.system == System.GPS) & (s.cn0_dbhz >= CLOCK_DBHZ)
    clock = np.full((int(epoch.max(initial=-1)) + 1, 2), np.nan)
    for k in np.unique(epoch[strong]):
        own = strong & (epoch == k)
        if own.sum() >= LEAST_GPS:
            clock[k] = np.median(s.code_m[own]), np.median(s.rate_mps[own])
    s = s._replace(code_m=s.code_m - clock[epoch, 0], rate_mps=s.rate_mps - clock[epoch, 1])
    s = s.take(np.isfinite(s.code_m))
    if not s.code_m.size:
        raise InputError(f"codes must have an epoch with {LEAST_GPS} GPS codes of {CLOCK_DBHZ:g} dB-Hz, got none")
    code = s.code_m.copy()
    for system in np.unique(s.system):
        own = s.system == system
        good = own & (s.cn0_dbhz >= OFFSET_DBHZ)
        if system != System.GPS and good.any():
            code[own] -= np.median(code[good])
    return s._replace(code_m=code)


def recorded(drive: SmartLoc) -> SignalResiduals:
    """Residuals of the codes of a drive with its truth, by time; Doppler and labels are not known.

    Raises
    ------
    InputError
        The drive has no truth.
    """
    codes, truth = drive.ranges, drive.truth
    if truth is None:
        raise InputError("drive must have a ground truth, has none: give its *_GT file")
    position, known = truth.at(codes.time_s)
    system = np.array([SYSTEMS.get(str(letter), UNKNOWN) for letter in codes.system], dtype=np.int64)
    nothing = np.full(system.size, np.nan)
    found = SignalResiduals(
        codes.time_s, system, codes.satellite,
        codes.range_m - ranges_and_sights(codes.satellite_ecef_m, position)[0], nothing,
        np.degrees(codes.elevation_rad), codes.cn0_dbhz, np.full(system.size, UNKNOWN),
    )  # fmt: skip
    found = found.take(known & (system >= 0))
    return found.take(np.argsort(found.time_s, kind="stable"))


def labelled(drive: SmartLoc, raw: SmartLocRaw) -> SignalResiduals:
    """The codes of a drive that stand in a raw table of it, with range rates and labels of that table.

    Range rates are ``-f lambda`` of the Doppler frequency f. The computed one is the rate of the range from the true
    position, by a parabola through the satellite's ranges of +- 2 s, less ``e.v`` of the true velocity.

    Raises
    ------
    InputError
        The drive has no truth, or the tables have no signal in common.
    """
    codes, truth = recorded(drive), drive.truth
    assert truth is not None  # checked by recorded
    place = ecef_from_geodetic(np.radians(raw.latitude_deg), np.radians(raw.longitude_deg), raw.height_m)
    near = np.array([np.linalg.norm(truth.position_ecef_m - p, axis=-1).argmin() for p in place])
    same = np.linalg.norm(truth.position_ecef_m[near] - place, axis=-1) < SAME_PLACE_M
    if not same.any():
        raise InputError("raw must be a table of the same drive, has no true position in common: give its raw table")
    time = raw.tow_s - np.median((raw.tow_s - truth.time_s[near])[same])
    number = raw.satellite + np.where(raw.system == "R", GLONASS_NUMBERS, 0)
    rates, rows, chosen = _range_rates(drive, raw, place, time, number), [], []
    for i in range(time.size):
        at = (codes.satellite == number[i]) & (np.abs(codes.time_s - time[i]) < SAME_TIME_S)
        own = np.flatnonzero(at & (codes.system == SYSTEMS.get(str(raw.system[i]), UNKNOWN)))
        if own.size:
            rows.append(own[0])
            chosen.append(i)
    if not rows:
        raise InputError("raw and drive must have signals in common, have none: give the raw table of the drive")
    return codes.take(np.array(rows))._replace(rate_mps=rates[chosen], blocked=raw.reflected[chosen])


def _range_rates(drive: SmartLoc, raw: SmartLocRaw, place: Array, time: Array, number: Ints) -> Array:
    """Observed less computed range rate of each signal of a raw table [m/s]; NaN for an unknown satellite."""
    codes, out = drive.ranges, np.full(time.size, np.nan)
    hertz = 1602.0e6 + GLONASS_STEP_HZ * (raw.slot - GLONASS_MIDDLE)
    wave = np.where(raw.system == "R", SPEED_OF_LIGHT_MPS / hertz, WAVELENGTH_M[System.GPS, 0])
    east, north = np.cos(raw.heading_east_left_rad), np.sin(raw.heading_east_left_rad)
    for i in range(time.size):
        own = (codes.satellite == number[i]) & (np.abs(codes.time_s - time[i]) < RATE_SPAN_S)
        if own.sum() < 3:
            continue
        distance, sight = ranges_and_sights(codes.satellite_ecef_m[own], place[i])
        late = codes.time_s[own] - time[i]
        slope = np.polyfit(late, distance - distance[0], 2)[1]
        axes = ecef_from_enu_matrix(np.radians(raw.latitude_deg[i]), np.radians(raw.longitude_deg[i]))
        velocity = raw.speed_mps[i] * (axes @ [east[i], north[i], 0.0])
        out[i] = -raw.doppler_hz[i] * wave[i] - (slope - sight[np.abs(late).argmin()] @ velocity)
    return out


def simulated(config: StreetDrivesConfig, streets: int, systems: Sequence[int], report: OnProgress) -> SignalResiduals:
    """Residuals of simulated drives under the first sky of ``config``, without their clocks; of these systems."""
    found, counter = [], Counter(report, RunProgress(float(streets)))
    for number in range(streets):
        navigator, drive = street_of(config, config.skies[0], number)
        first, epochs = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, config.span_s))
        each: list[list[SignalResiduals]] = [[] for _ in range(config.vehicles)]
        for k, truth in zip(range(epochs), drive, strict=False):
            m = navigator.measure(truth)
            if k < first or k % EVERY:
                continue
            wanted = np.isin(m.sky.system, systems)
            e = m.sky.los_enu[m.sky.index]
            code = m.gnss.code_m[:, :, 0] + np.einsum("bsi,bi->bs", e, truth.position_enu_m)
            rate = m.gnss.range_rate_mps + np.einsum("bsi,bi->bs", e, truth.velocity_enu_mps)
            elevation = np.degrees(m.sky.elevation_rad[m.sky.index])
            path = navigator.mask.look(truth.arc_m, truth.lane, m.sky).path
            blocked = (path == SignalPath.REFLECTED) | (path == SignalPath.BLOCKED)
            for v, rows in enumerate(each):
                s = np.flatnonzero(m.gnss.tracked[v] & wanted)
                rows.append(
                    SignalResiduals(
                        np.full(s.size, truth.time_s), m.sky.system[s], s, code[v, s], rate[v, s], elevation[v, s],
                        m.gnss.cn0_dbhz[v, s], blocked[v, s].astype(np.int64),
                    )
                )  # fmt: skip
        found += [without_clock(SignalResiduals.join(rows)) for rows in each]
        counter(number + 1.0)
    return SignalResiduals.join(found)


PATHS = {"direct": 0, "blocked": 1}  # values of SignalResiduals.blocked
OBSERVABLES = {"code_m": ("code", "m"), "rate_mps": ("Doppler", "m/s")}
SHARES = np.linspace(0.005, 0.995, 199)  # of signals, in the figure
RESAMPLES, CONFIDENCE = 2000, 0.95
COLOURS = {"direct": "#009E73", "blocked": "#D55E00"}


def compare_paths(recorded: SignalResiduals, simulated: SignalResiduals) -> list[dict[str, Any]]:
    """Quantiles of absolute residuals of each observable and path, recorded with intervals by satellite."""
    rows = []
    for name in OBSERVABLES:
        for path in PATHS:
            values, satellite = _of(recorded, name, path), recorded.satellite[_rows(recorded, name, path)]
            made = _of(simulated, name, path)
            low, high = _by_satellite(values, satellite)
            rows.append({
                "observable": name, "path": path, "signals": len(values), "satellites": len(np.unique(satellite)),
                "recorded": _signals_quantiles(values), "low": low, "high": high, "simulated": _signals_quantiles(made),
                "simulated_signals": len(made),
            })  # fmt: skip
    return rows


def _rows(signals: SignalResiduals, name: str, path: str) -> NDArray[np.bool_]:
    return np.asarray((signals.blocked == PATHS[path]) & np.isfinite(getattr(signals, name)))


def _of(signals: SignalResiduals, name: str, path: str) -> Array:
    """Absolute residuals of an observable and a path."""
    return np.asarray(np.abs(getattr(signals, name)[_rows(signals, name, path)]))


def _signals_quantiles(values: Array) -> list[float] | None:
    return [float(q) for q in np.quantile(values, QUANTILES)] if values.size else None


def _by_satellite(values: Array, satellite: NDArray[np.int64]) -> tuple[list[float] | None, list[float] | None]:
    """Interval of each quantile by resampling satellites; None with fewer than two."""
    groups = [values[satellite == one] for one in np.unique(satellite)]
    if len(groups) < 2:
        return None, None
    drawn = named_generator(0, "resamples").integers(len(groups), size=(RESAMPLES, len(groups)))
    found = np.array([np.quantile(np.concatenate([groups[k] for k in row]), QUANTILES) for row in drawn])
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(found, (tail, 1.0 - tail), axis=0)
    return low.tolist(), high.tolist()


def path_rows(result: Mapping[str, Any]) -> Table:
    """Recorded quantiles with intervals, and simulated ones, by observable and path."""
    rows = []
    for one in result["paths"]:
        observable, unit = OBSERVABLES[one["observable"]]
        cells = []
        for k in range(len(QUANTILES)):
            text = "-" if one["recorded"] is None else f"{one['recorded'][k]:.2g}"
            band = "" if one["low"] is None else f" [{one['low'][k]:.2g}, {one['high'][k]:.2g}]"
            ours = "-" if one["simulated"] is None else f"{one['simulated'][k]:.2g}"
            cells.append(f"{text}{band}; {ours}")
        rows.append((f"{observable} [{unit}]", one["path"], f"{one['signals']} of {one['satellites']}", *cells))
    heads = "observable", "direct ray", "signals, satellites", *(f"{100 * q:g} %" for q in QUANTILES)
    return heads, rows


def paths_figure(recorded: SignalResiduals, simulated: SignalResiduals) -> Figure:
    """Distributions of absolute residuals by path: recorded drawn through, simulated dashed."""
    figure = new_figure(8.0, 3.2)
    for axes, (name, (observable, unit)) in zip(figure.subplots(1, 2), OBSERVABLES.items(), strict=True):
        for path, colour in COLOURS.items():
            for what, signals, line in (("recorded", recorded, "-"), ("simulated", simulated, "--")):
                values = _of(signals, name, path)
                if values.size:
                    label = f"direct ray {path}" if path == "blocked" else "direct ray received"
                    axes.plot(np.quantile(values, SHARES), SHARES, line, color=colour, label=f"{label}, {what}")
        axes.set_xscale("log")
        axes.set_ylim(0.0, 1.0)
        tidy(axes, xlabel=f"absolute error of {observable} [{unit}]", ylabel="share of signals below")
        legend(axes, fontsize=7)
    return figure


LEAST_CODES = 20  # of a class that is shown
CN0_DBHZ = (0.0, 25.0, 32.0, 38.0, 43.0, 60.0)
ELEVATION_DEG = (0.0, 30.0, 60.0, 90.0)


class SignalsConfig(StreetDrivesConfig):
    """Streets and the receiver that drives through them, as nearly as is known those of the recording."""

    skies: tuple[str, ...] = Field(("skies/plaza",), min_length=1, max_length=1, description="sky of the streets")
    streets: int = Field(4, ge=1, description="number of streets")
    receiver: str = Field("sensors/gnss_consumer", description="preset of the receiver")
    faults: str | None = Field(None, description="preset of fault rates")
    duration_s: float = Field(60.0, gt=0, description="length of a drive after the warm-up [s]")

    def navigator_in(self, sky: str) -> NavigatorConfig:
        """The navigator with the receiver."""
        return super().navigator_in(sky).replace(gnss=GnssConfig.preset(self.receiver).to_dict())


def assess_signals(
    folder: Path, config: SignalsConfig, out: Path, on_progress: OnProgress = ignore, labels: Path | None = None
) -> dict[str, Any]:
    """Compare a recorded drive with simulated ones, and write ``signals.json``; returns its data.

    ``labels`` is a raw table of a part of the drive; with it the result has code and Doppler errors by path, and
    ``signals.svg`` is written.

    Raises
    ------
    InputError
        The folder has no drive of smartLoc with its ground truth, no epoch has enough GPS codes, or the labels are of
        another drive.
    """
    inputs, truths = sorted(folder.glob("*_Input.txt*")), sorted(folder.glob("*_GT.txt"))
    if not inputs or not truths:
        raise InputError(f"{folder} must hold *_Input.txt(.gz) and *_GT.txt of smartLoc: name the folder of a drive")
    drive = read_smartloc(inputs[0], truths[0])
    codes = recorded(drive)
    excerpt = None if labels is None else without_clock(labelled(drive, read_smartloc_raw(labels)))
    half = codes.time_s < 0.5 * (codes.time_s[0] + codes.time_s[-1])
    seen = sorted({int(system) for system in np.unique(codes.system)})
    ours = simulated(config, config.streets, seen, on_progress)
    halves = {"first half": without_clock(codes.take(half)), "second half": without_clock(codes.take(~half))}
    sides = {**halves, "simulated": ours}
    result = {"config": config.to_dict(), "codes": {name: len(s.code_m) for name, s in sides.items()}} | {
        "classes": [
            {"cn0_dbhz": list(cn0), "elevation_deg": list(elevation)}
            | {name: _quantiles(s, cn0, elevation) for name, s in sides.items()}
            for cn0 in pairwise(CN0_DBHZ)
            for elevation in pairwise(ELEVATION_DEG)
        ]
    }
    if excerpt is not None:
        result["paths"] = compare_paths(excerpt, ours)
        save(paths_figure(excerpt, ours), out / "signals.svg")
    return stored(result, out, "signals.json")


def _quantiles(
    signals: SignalResiduals, cn0: tuple[float, float], elevation: tuple[float, float]
) -> dict[str, Any] | None:
    """Share of a class and quantiles of its absolute residuals [m], None for a class with few codes."""
    here = (signals.cn0_dbhz >= cn0[0]) & (signals.cn0_dbhz < cn0[1]) & (signals.elevation_deg >= elevation[0])
    here &= (signals.elevation_deg < elevation[1]) | (elevation[1] == ELEVATION_DEG[-1])
    if here.sum() < LEAST_CODES:
        return None
    return {"share": float(here.mean()), "quantiles_m": np.quantile(np.abs(signals.code_m[here]), QUANTILES).tolist()}


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """Errors by class and, with labels, by path."""
    yield "Share of the codes, and 50 / 75 / 90 / 95 % of their absolute errors [m]", signal_rows(result)
    if "paths" in result:
        yield "Absolute errors by path: recorded, with 95 % by satellite; simulated", path_rows(result)


def signal_rows(result: Mapping[str, Any]) -> Table:
    """Share of each class, and quantiles of its absolute code errors, on both halves and simulated."""
    sides = list(result["codes"])

    def cell(found: Mapping[str, Any] | None) -> str:
        if found is None:
            return "-"
        return f"{100.0 * found['share']:.1f} %: " + " / ".join(f"{q:.1f}" for q in found["quantiles_m"])

    rows = [
        (
            "{:g} to {:g}".format(*one["cn0_dbhz"]),
            "{:g} to {:g}".format(*one["elevation_deg"]),
            *(cell(one[s]) for s in sides),
        )
        for one in result["classes"]
        if any(one[s] is not None for s in sides)
    ]
    return ("C/N0", "elevation", *sides), rows
