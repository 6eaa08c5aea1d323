"""A Tokyo-like urban drive next to S1 (El-Mowafy and Kubo: sections 4 and 5, tables 2, 4 and 5), and its ablation.

Many seeds drive the same loop for the same time: each has its own traffic lights, signals, instruments and outages.
Figures are medians over the seeds of the statistic of one drive, with their spread: one drive alone passes or fails by
luck. The printed figures stand here with the bands within which ours should fall. The ablation takes the chosen
constants away one by one: how many cells of S1's tables each of them buys.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.agents.checkpointing.runner import Advance, OnProgress, RunProgress, ignore, run_parts
from lanebound.agents.report.pages import Table
from lanebound.agents.serialization import finite_or_none
from lanebound.agents.studies.study import Shown, claim, seed_batches, spread, stored
from lanebound.integrity.assessment.plotting import map_figure, save, series_figure, stanford_figure
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.monitoring.risk import Variant
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import LevelForm, Navigator, NavigatorConfig, PlCase
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.motion_config import DopplerConfig
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.city import City, CityConfig, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]

MODES = ("rtk", "doppler", "imu_odometer")
RISKS = (1e-3, 1e-4, 1e-5, 1e-6)

MODE_SHARE = {"rtk": 0.722, "doppler": 0.258, "imu_odometer": 0.02}  # S1 section 5
ERROR_M = {  # S1 table 2
    "rtk": {"median_at_m": 0.058, "median_ct_m": 0.054, "rmse_at_m": 0.077, "rmse_ct_m": 0.105},
    "doppler": {"median_at_m": 0.163, "median_ct_m": 0.172, "rmse_at_m": 0.332, "rmse_ct_m": 0.442},
    "imu_odometer": {"median_at_m": 0.150, "median_ct_m": 0.321, "rmse_at_m": 0.249, "rmse_ct_m": 0.206},
}
PL_AT_M = {  # S1 table 4, by risk 1e-3 .. 1e-6
    "rtk": (0.176, 0.197, 0.215, 0.232),
    "doppler": (1.355, 1.621, 1.851, 2.057),
    "imu_odometer": (1.208, 1.368, 1.506, 1.601),
}
PL_CT_M = {  # S1 table 5
    "rtk": (0.148, 0.164, 0.177, 0.188),
    "doppler": (1.802, 2.159, 2.468, 2.623),
    "imu_odometer": (0.884, 1.101, 1.150, 1.191),
}
IMPOSSIBLE = {("error", "imu_odometer", "rmse_ct_m"), ("error", "imu_odometer", "median_ct_m")}
MODE_CODES = {"rtk": Mode.RTK, "doppler": Mode.DOPPLER, "imu_odometer": Mode.IMU_ODOMETER}
LOOP_M = (
    (0.0, 0.0), (700.0, 150.0), (1100.0, -100.0), (1500.0, 300.0), (1400.0, 900.0), (800.0, 1100.0), (300.0, 900.0),
    (-200.0, 1000.0), (-350.0, 400.0),
)  # fmt: skip
PACKAGES = ("lanebound.integrity", "lanebound.agents.studies")
ALERT_LIMIT_M = 1.0  # S1 section 5
FIGURE_RISKS = {"1e-4": 1, "1e-6": 3}  # S1 figures 3 and 4
WHITE_S = 0.01  # correlation time far below an epoch
SHOWN = {
    "RTK error along, across [m]": (("error", "rtk", "median_at_m"), ("error", "rtk", "median_ct_m")),
    "RTK PL at 1e-6 [m]": (("pl_median", "rtk", "at_m", "1e-6"), ("pl_median", "rtk", "ct_m", "1e-6")),
    "Doppler PL at 1e-6 [m]": (("pl_median", "doppler", "at_m", "1e-6"), ("pl_median", "doppler", "ct_m", "1e-6")),
}


@dataclass(frozen=True)
class PrintedFigure:
    """One printed figure: ``path`` in tables.json, its value, the band we aim at and a remark."""

    path: tuple[str, ...]
    published: float
    low: float
    high: float
    remark: str = ""


def risk_key(risk: float) -> str:
    """``1e-3`` for 0.001."""
    return f"1e-{round(-math.log10(risk))}"


def _cells() -> list[PrintedFigure]:
    share_band = {"rtk": (0.672, 0.772), "doppler": (0.208, 0.308), "imu_odometer": (0.01, 0.04)}
    cells = [PrintedFigure(("mode_share", m), MODE_SHARE[m], *share_band[m]) for m in MODES]
    for mode in MODES:
        tolerance = 0.6 if mode == "imu_odometer" else 0.3
        for key, value in ERROR_M[mode].items():
            remark = (
                "printed RMSE is below the printed median over sqrt 2" if ("error", mode, key) in IMPOSSIBLE else ""
            )
            cells.append(
                PrintedFigure(("error", mode, key), value, value * (1 - tolerance), value * (1 + tolerance), remark)
            )
    for mode in MODES:
        tolerance = 0.4 if mode == "imu_odometer" else 0.25
        for axis, table in (("at", PL_AT_M), ("ct", PL_CT_M)):
            for risk, value in zip(RISKS, table[mode], strict=True):
                path = ("pl_median", mode, f"{axis}_m", risk_key(risk))
                remark = "0.567 K + 0.050 gives 2.745" if (mode, axis, risk) == ("doppler", "ct", 1e-6) else ""
                cells.append(PrintedFigure(path, value, value * (1 - tolerance), value * (1 + tolerance), remark))
    return cells


CELLS = _cells()


class UrbanDriveConfig(Config):
    """Everything the study depends on."""

    seeds: int = Field(100, ge=1, description="drives [-]; each is one seed")
    first_seed: int = Field(1000, ge=0, description="seed of the first drive [-]")
    minutes: float = Field(26.0, gt=0, description="length of one drive [min]; S1 drove about 25")
    batch: int = Field(25, ge=1, description="drives run together, and lost together by an interruption [-]")
    city_seed: int = Field(7, ge=0, description="seed of the street's buildings [-]")
    loop_m: tuple[tuple[float, float], ...] = Field(
        LOOP_M, min_length=3, description="corners of the loop, East, North [m]"
    )
    lane_width_m: float = Field(3.25, gt=0, description="lane width [m]; Road Structure Order of Japan, urban roads")
    lanes: int = Field(2, ge=1, description="lanes of the carriageway [-]; S2: 2 to 3 lanes on each side")
    city: CityConfig = CityConfig()
    drive: DriveConfig = DriveConfig()
    navigator: NavigatorConfig = NavigatorConfig()

    def road(self) -> Road:
        """The loop."""
        return Road.through(
            np.array(self.loop_m),
            corner_radius_m=25.0,
            closed=True,
            lane_count=self.lanes,
            lane_width_m=self.lane_width_m,
        )

    def with_levels(self) -> NavigatorConfig:
        """The navigator with the eight reported levels behind its operative one: four published, then four exact."""
        cases = [
            PlCase(
                integrity_risk=risk,
                variant=variant,
                form=LevelForm.CLOSED if variant is Variant.PUBLISHED else LevelForm.ROOT,
            )
            for variant in (Variant.PUBLISHED, Variant.EXACT)
            for risk in RISKS
        ]
        return self.navigator.replace(more_levels=[case.to_dict() for case in cases])


@dataclass(frozen=True)
class Drives:
    """Time series of a batch of drives: (T, B) each, levels (T, B, 8, 2) behind the operative one."""

    time_s: Array
    mode: NDArray[np.int8]
    rtk: NDArray[np.int8]
    error_m: NDArray[np.float32]
    level_m: NDArray[np.float32]
    position_en_m: NDArray[np.float32]
    satellites: NDArray[np.int16]


def street(config: UrbanDriveConfig, cache: Path | None = None) -> tuple[Road, City, SkyMask]:
    """The loop, the city along it, and its sky mask, which is cached in the folder ``cache``."""
    road = config.road()
    city = build_city(road, config.city, named_generator(config.city_seed, "city"))
    digest = SkyMask.digest_of(road, city)
    path = None if cache is None else cache / f"mask-{digest[:16]}.npz"
    if path is not None and path.exists():
        return road, city, SkyMask.load(path, digest)
    mask = SkyMask.build(road, city)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f"draft-{path.name}")  # NumPy wants the suffix .npz
        mask.save(draft)
        os.replace(draft, path)
    return road, city, mask


def drive(
    config: UrbanDriveConfig,
    road: Road,
    mask: SkyMask,
    seeds: list[int],
    advance: Advance = ignore,
) -> Drives:
    """Drive the loop with each seed; ``advance`` is called with the share of the epochs that is done."""
    navigation = config.with_levels()
    dt, epochs = navigation.dt_s, round(60.0 * config.minutes / navigation.dt_s)
    horizon_s = 3600.0 * np.ceil(
        (60.0 * config.minutes + 60.0) / 3600.0
    )  # whole hours: short drives begin as long ones
    track = SkyTrack.from_config(navigation.sky, horizon_s)
    navigator = Navigator(navigation, track, mask, seeds)
    car, traffic = CityDrive(road, config.drive, dt), Streams(seeds)
    state = car.start(traffic, spread_m=road.length_m)
    batch = len(seeds)
    out = Drives(
        time_s=np.asarray(dt * np.arange(1, epochs + 1), dtype=np.float64),
        mode=np.zeros((epochs, batch), dtype=np.int8),
        rtk=np.zeros((epochs, batch), dtype=np.int8),
        error_m=np.zeros((epochs, batch, 2), dtype=np.float32),
        level_m=np.zeros((epochs, batch, 2 * len(RISKS), 2), dtype=np.float32),
        position_en_m=np.zeros((epochs, batch, 2), dtype=np.float32),
        satellites=np.zeros((epochs, batch), dtype=np.int16),
    )
    for k in range(epochs):
        truth = car.step(state, traffic)
        s = navigator.step(truth)
        d = s.position_en_m - truth.position_enu_m[:, :2]
        sin_h, cos_h = np.sin(truth.heading_rad), np.cos(truth.heading_rad)
        out.error_m[k, :, 0] = sin_h * d[:, 0] + cos_h * d[:, 1]
        out.error_m[k, :, 1] = cos_h * d[:, 0] - sin_h * d[:, 1]
        out.mode[k], out.rtk[k], out.level_m[k] = s.mode, s.rtk, s.pl_cases_m[:, 1:]
        out.position_en_m[k], out.satellites[k] = truth.position_enu_m[:, :2], s.satellites_doppler
        if k % 100 == 99:
            advance((k + 1) / epochs)
    return out


def outage_lengths_s(rtk: NDArray[np.bool_], dt_s: float) -> Array:
    """Lengths of the runs without RTK between two RTK epochs.  rtk (T,) -> (n,) [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], rtk.astype(np.int8), [1]])))
    return np.asarray((edges[1::2] - edges[::2]) * dt_s)


def seed_statistics(drives: Drives, dt_s: float) -> list[dict[str, Any]]:
    """Statistics of each drive, from its first position on: the cells of S1's tables and what goes with them.

    Published and exact levels stand next to each other, each begun from its own level at the last fix.
    """
    return [_one_drive(drives, b, dt_s) for b in range(drives.mode.shape[1])]


def _one_drive(drives: Drives, b: int, dt_s: float) -> dict[str, Any]:
    start = int(np.argmax(drives.mode[:, b] != Mode.NONE))
    mode = drives.mode[start:, b]
    error, level = np.abs(drives.error_m[start:, b]), drives.level_m[start:, b]
    kinds = ("mode_share", "epochs", "error", "pl_median", "pl_median_exact", "exceedance")
    found: dict[str, Any] = {kind: {} for kind in kinds}
    for name in MODES:
        here = mode == MODE_CODES[name]
        found["mode_share"][name] = float(here.mean())
        if here.any():
            e, pl = error[here], level[here]
            found["error"][name] = _accuracy(e)
            found["pl_median"][name] = _medians(pl[:, :4])
            found["pl_median_exact"][name] = _medians(pl[:, 4:])
            found["epochs"][name] = int(here.sum())
            found["exceedance"][name] = {
                kind: {risk_key(r): float((e > pl[:, first + i]).any(-1).mean()) for i, r in enumerate(RISKS)}
                for kind, first in (("published", 0), ("exact", 4))
            }
    rtk = mode == Mode.RTK
    found["availability"] = {
        "rtk_1m": float((level[rtk][:, 3] <= 1.0).all(-1).mean()) if rtk.any() else 0.0,
        "rtk_1m_exact": float((level[rtk][:, 7] <= 1.0).all(-1).mean()) if rtk.any() else 0.0,
        "all_1m": float((level[:, 3] <= 1.0).all(-1).mean()),
        "all_1m5": float((level[:, 2] <= 1.5).all(-1).mean()),
    }
    lengths = outage_lengths_s(rtk, dt_s)
    found["outages"] = {
        "count": len(lengths),
        "shortest_s": float(lengths.min()) if len(lengths) else 0.0,
        "longest_s": float(lengths.max(initial=0.0)),
        "median_s": float(np.median(lengths)) if len(lengths) else 0.0,
    }
    return found


def _accuracy(error: NDArray[np.float32]) -> dict[str, float]:
    return {
        f"{what}_{axis}_m": float(value)
        for i, axis in enumerate(("at", "ct"))
        for what, value in (("median", np.median(error[:, i])), ("rmse", np.sqrt((error[:, i] ** 2).mean())))
    }


def _medians(level: NDArray[np.float32]) -> dict[str, dict[str, float]]:
    return {
        f"{axis}_m": {risk_key(r): float(np.median(level[:, i, q])) for i, r in enumerate(RISKS)}
        for q, axis in enumerate(("at", "ct"))
    }


def run_study(
    config: UrbanDriveConfig, out: Path, on_progress: OnProgress = ignore, masks: Path | None = None
) -> dict[str, Any]:
    """Drive the missing batches, and write ``tables.json`` and the figures into ``out``; returns the tables.

    Parameters
    ----------
    on_progress : called with the number of epochs
    masks : folder of cached sky masks; by default that of the parts

    Raises
    ------
    InputError
        As :func:`check`.
    """
    check(config, out)
    batches = _batches(config)
    epochs = round(60.0 * config.minutes / config.navigator.dt_s)
    found = run_parts(
        out, list(batches), partial(_drive_batch, config, out, masks or out / "parts"), 1, on_progress,
        size=lambda name: len(batches[name]) * epochs, infinite=True,
    )  # fmt: skip
    statistics = [drive_ for part in found.values() for drive_ in part]
    tables = {"seeds": config.seeds, "minutes": config.minutes, **summarise(statistics)}
    return stored(finite_or_none(tables), out, "tables.json")


def _batches(config: UrbanDriveConfig) -> dict[str, list[int]]:
    """Seeds of each part by its name."""
    batches = seed_batches(config.first_seed, config.seeds, config.batch)
    return {f"seeds-{seeds[0]}-{seeds[-1]}": seeds for seeds in batches}


def _drive_batch(config: UrbanDriveConfig, out: Path, masks: Path, name: str, advance: Advance) -> list[dict[str, Any]]:
    """Statistics of the drives of a part; the figures are of the first drive."""
    seeds = _batches(config)[name]
    road, city, mask = street(config, masks)
    drives = drive(config, road, mask, seeds, advance)
    if seeds[0] == config.first_seed:
        _figures(drives, city, out)
    return seed_statistics(drives, config.navigator.dt_s)


def check(config: UrbanDriveConfig, out: Path) -> None:
    """Refuse a configuration that cannot be driven, and claim the folder.

    Raises
    ------
    InputError
        The road cannot be driven, there is no satellite, or ``out`` cannot be claimed.
    """
    check_drive(config)
    claim(out, "urban drive study", config, PACKAGES)


def check_drive(config: UrbanDriveConfig) -> None:
    """Refuse a configuration that cannot be driven.

    Raises
    ------
    InputError
        The road cannot be driven, or there is no satellite.
    """
    CityDrive(config.road(), config.drive, config.navigator.dt_s)
    config.navigator.sky.satellites()


def _leaves(tree: dict[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key), value


def lookup(tree: dict[str, Any], path: tuple[str, ...]) -> Any:
    """The value at a path, or None."""
    found: Any = tree
    for key in path:
        if not isinstance(found, dict) or key not in found:
            return None
        found = found[key]
    return found


def summarise(statistics: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the drives of every figure, under its own names, and the 5 % and 95 % quantiles under ``spread``.

    ``epochs`` are sums over the drives, and ``exceedance`` the share of those epochs: medians hide rare events.
    """
    paths = sorted({path for drive_ in statistics for path, _ in _leaves(drive_)})
    tables: dict[str, Any] = {"spread": {}}
    for path in paths:
        values = [v for s in statistics if (v := lookup(s, path)) is not None]
        middle, low, high = spread(values)
        if path[0] == "exceedance":
            middle = _pooled(statistics, path)
        elif path[0] == "epochs":
            middle = sum(values)
        for target, leaf in ((tables, middle), (tables["spread"], [low, high])):
            for key in path[:-1]:
                target = target.setdefault(key, {})
            target[path[-1]] = leaf
    tables["pl_bounds_error"] = {
        mode: {risk: rate == 0.0 for risk, rate in kinds["published"].items()}
        for mode, kinds in tables.get("exceedance", {}).items()
    }
    return tables


def _pooled(statistics: list[dict[str, Any]], path: tuple[str, ...]) -> float:
    """A share of the epochs of one mode, of all drives together."""
    pairs = [(rate, lookup(one, ("epochs", path[1]))) for one in statistics if (rate := lookup(one, path)) is not None]
    return float(sum(rate * epochs for rate, epochs in pairs) / sum(epochs for _, epochs in pairs))


def rows_against_paper(tables: dict[str, Any]) -> list[dict[str, Any]]:
    """Each printed figure of S1 next to ours: paper, ours, 5 and 95 % of the drives, the band aimed at, whether met."""
    return [_row(cell, tables) for cell in CELLS]


def _row(cell: PrintedFigure, tables: dict[str, Any]) -> dict[str, Any]:
    ours, spread = lookup(tables, cell.path), lookup(tables["spread"], cell.path)
    return {
        "figure": ".".join(cell.path),
        "paper": cell.published,
        "ours": ours,
        "low": spread[0] if spread else None,
        "high": spread[1] if spread else None,
        "band": [cell.low, cell.high],
        "met": ours is not None and cell.low <= ours <= cell.high,
        "remark": cell.remark,
    }


def shown(tables: dict[str, Any]) -> Iterator[Shown]:
    """S1's figures next to ours, and how often errors exceed their levels."""
    rows, short = rows_against_paper(tables), is_short(tables)
    heads = ("figure", "paper", "ours", "5 %", "95 %", "band aimed at", "ours in band")
    yield f"S1 against ours: medians over {tables['seeds']} drives of {tables['minutes']:g} min [m]", (heads, [
        (r["figure"], *(_metres(r[k]) for k in ("paper", "ours", "low", "high")),
         f"{r['band'][0]:.3f} .. {r['band'][1]:.3f}", verdict(r, short))
        for r in rows
    ])  # fmt: skip
    yield f"{sum(row['met'] for row in rows)} of {len(rows)} printed figures lie inside the band aimed at."
    if short:
        yield (
            "The bands are meant for the whole study, 100 drives of 26 min: this run is shorter, and a figure outside "
            "its band\nmay be chance. Leave out --seeds and --minutes for the full comparison."
        )
    yield ""
    heads = ("mode", "form", "epochs", "1e-3", "1e-4", "1e-5", "1e-6")
    yield "Share of epochs whose error exceeds the protection level on either axis", (heads, [
        (mode, form, f"{tables['epochs'][mode]:,}", *("0" if r == 0.0 else f"{r:.1e}" for r in by_risk.values()))
        for mode in MODES
        for form, by_risk in sorted(tables["exceedance"].get(mode, {}).items(), reverse=True)
    ])  # fmt: skip
    total = sum(tables["epochs"].values())
    yield f"Shares are of {total:,} epochs in all, ten a second and so strongly correlated.\n"
    yield f"RTK within 1 m at 1e-6 for {tables['availability']['rtk_1m']:.2%} of its epochs."


def is_short(tables: dict[str, Any]) -> bool:
    """Whether a run has fewer or shorter drives than the study, for which the bands are meant."""
    full = UrbanDriveConfig()
    return bool(tables["seeds"] < full.seeds or tables["minutes"] < full.minutes)


def verdict(row: dict[str, Any], short: bool) -> str:
    """Where our value lies; a short run is named as such."""
    if row["ours"] is None:
        return "none"
    if row["met"]:
        return "inside"
    return "outside (short run)" if short else "outside"


def _record(drives: Drives, b: int, level: int) -> Record:
    start = int(np.argmax(drives.mode[:, b] > 0))
    pl = drives.level_m[start:, b, level].astype(float)
    over = np.asarray((pl > ALERT_LIMIT_M).any(-1), dtype=np.bool_)
    return Record(
        time_s=drives.time_s[start:],
        mode=drives.mode[start:, b],
        error_at_m=drives.error_m[start:, b, 0].astype(float),
        error_ct_m=drives.error_m[start:, b, 1].astype(float),
        pl_at_m=pl[:, 0],
        pl_ct_m=pl[:, 1],
        alert=over,
        available=~over,
    )


def _figures(drives: Drives, city: City, out: Path) -> None:
    """The first drive: S1 figures 3 and 4, Stanford diagrams, and a map."""
    for risk, level in FIGURE_RISKS.items():
        record = _record(drives, 0, level)
        save(
            series_figure(record, risk=float(risk), al_at_m=ALERT_LIMIT_M, al_ct_m=ALERT_LIMIT_M),
            out / f"series-{risk}.png",
        )
        save(stanford_figure(record, ALERT_LIMIT_M, ALERT_LIMIT_M, risk=float(risk)), out / f"stanford-{risk}.png")
    start = int(np.argmax(drives.mode[:, 0] > 0))  # as the series
    position, mode = drives.position_en_m[start:, 0].astype(float), drives.mode[start:, 0]
    title = f"First drive, {drives.time_s[-1] / 60.0:.0f} min, by mode of positioning"
    save(map_figure(position, mode, title=title, obstacles=_outlines(city)), out / "map.png")


def _outlines(city: City) -> NDArray[np.float64]:
    """Level triangles of all that is solid, as a map shows them: roofs and overpasses.  (n, 3, 2) [m]."""
    triangles = city.triangles_enu_m[~city.foliage]
    level = np.ptp(triangles[:, :, 2], axis=1) < 1e-6
    return np.asarray(triangles[level, :, :2])


@dataclass(frozen=True)
class Ablation:
    """A variant of the study: its name, what is taken away, and the changes of ``navigator`` that do it."""

    name: str
    text: str
    navigator: Mapping[str, Any] = field(default_factory=dict)


def _positioning(part: str, **values: Any) -> dict[str, Any]:
    return {"positioning": {part: values}}


_DOPPLER_SIGMA = _positioning("doppler", sigma_mps=DopplerConfig().sigma_mps)
_PHASE_SIGMA = _positioning("rtk", sigma_phase_integrity_m=RtkConfig().sigma_phase_integrity_m)
_WHITE = {"gnss": {"range_rate_tau_s": WHITE_S}, **_positioning("doppler", tau_range_s=[WHITE_S, WHITE_S])}
_NO_OFFSET = {"gnss": {"reference_offset_m": 0.0}, **_positioning("rtk", reference_bias_m=0.0)}

ABLATIONS = (
    Ablation("shipped", "nothing"),
    Ablation("no-offset", "offset of the reference coordinates, and its bound", _NO_OFFSET),
    Ablation("default-doppler", "declared Doppler sigma of 0.33 m/s: default", _DOPPLER_SIGMA),
    Ablation(
        "default-doppler-noise",
        "simulated and declared Doppler sigma: defaults",
        {**_DOPPLER_SIGMA, "gnss": {"range_rate_sigma_mps": GnssConfig().range_rate_sigma_mps}},
    ),
    Ablation("white-doppler", "correlation of Doppler errors, simulated and declared", _WHITE),
    Ablation("unknown-tau", "knowledge of that time: 0.1 to 10 s", _positioning("doppler", tau_range_s=[0.1, 10.0])),
    Ablation("no-outages", "outages of the link", {"corrections": {"outage_per_h": 0.0}}),
    Ablation("default-phase", "declared phase sigma of 27 mm: default", _PHASE_SIGMA),
)
"""The study as shipped, and without each of its constants."""


def run_ablation(config: UrbanDriveConfig, out: Path, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Run every variant in a folder of its own below ``out``, and write ``ablation.json``; returns its data.

    Raises
    ------
    InputError
        A variant cannot be driven, or a folder cannot be claimed.
    """
    check_drive(config)
    claim(out, "urban drive ablation", config, PACKAGES)
    variants = []
    for k, one in enumerate(ABLATIONS):

        def report(progress: RunProgress, before: int = k) -> None:
            of = progress.of * len(ABLATIONS)
            on_progress(replace(progress, of=of, done=progress.done + before * progress.of, left_s=None))

        changed = config.replace(navigator=dict(one.navigator))
        tables = run_study(changed, out / one.name, report, masks=out / "masks")
        rows = rows_against_paper(tables)
        variants.append(
            {"name": one.name, "without": one.text, "met": sum(row["met"] for row in rows), "of": len(rows)}
            | {"outside": [row["figure"] for row in rows if not row["met"]]}
            | {key: [lookup(tables, path) for path in paths] for key, paths in SHOWN.items()}
        )
    return stored({"seeds": config.seeds, "minutes": config.minutes, "variants": variants}, out, "ablation.json")


def ablation_rows(result: Mapping[str, Any]) -> Table:
    """What is taken away, cells met, and median errors and levels of RTK and Doppler."""
    rows = [
        (one["without"], f"{one['met']} of {one['of']}", *(_pair(one[key]) for key in SHOWN))
        for one in result["variants"]
    ]
    return ("taken away", "cells", *SHOWN), rows


def _pair(values: list[float | None]) -> str:
    return ", ".join(map(_metres, values))


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
