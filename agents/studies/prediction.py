"""Prediction of positioning before a journey (S2 section 3 and Figure 6): satellites, geometry, availability, levels.

Streets are predicted from maps of their cities with errors, from the satellites at departure and from the speed limit
alone. Then the whole navigator drives them, and what it receives and bounds is compared with the prediction.

- Satellites: number in line of sight and PDOP, predicted and received, by the error of the map. A satellite is received
  where its carrier is tracked, directly or not, which a receiver cannot tell.
- Availability: the probability that a position is usable, from two models of the prediction alone. The first one
  gives the probability of an RTK position from satellites and PDOP; the second one that of a usable position from the
  satellites and the time since the first one was last above one half, at the speed limit: dead reckoning bridges gaps.
  Both are fitted on training streets of all skies together, and judged on other streets.
- Levels: quantiles of PL_CT of the training samples of similar probability, and how often levels of other streets lie
  below them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.recorded_prediction import (
    RecordedPredictionConfig,
    compared,
    passage_rows,
    read_recorded,
    recorded_figure,
    recorded_rows,
    sight_rows,
)
from lanebound.agents.studies.street_drives import (
    AZIMUTH_STEP_DEG,
    ELEVATION_STEP_DEG,
    StreetDrivesConfig,
    city_of,
    drive_of,
    mask_of,
    navigator_of,
    road_of,
    work_streets,
)
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.availability import (
    LONGEST_GAP_S,
    NO_LEVEL_M,
    WORST_PDOP,
    AvailabilityModel,
    Fit,
    gaps_along,
    likely,
)
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.prediction import pdop, predict_street
from lanebound.integrity.sky.survey import MapConfig, as_mapped
from lanebound.integrity.sky.visibility import SignalPath, antennas_along

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ANTENNA_HEIGHT_M = 1.5
SAMPLE_S = 1.0  # between samples of a vehicle
BINS = 5  # of the reliability diagram
ALL = "all"  # skies
QUANTILES = (0.5, 0.9)
RESAMPLES, CONFIDENCE = 2000, 0.95
OTHERS = "direct", "codes"
COLUMNS = ("station", "received", "direct", "codes", "pdop", "rtk", "usable", "pl_ct_m")


class PredictionConfig(StreetDrivesConfig):
    """Streets, and the maps by which they are predicted."""

    skies: tuple[str, ...] = Field(
        ("urban", "dense", "skies/plaza"), min_length=1, description="levels of sky, with their instruments"
    )
    seed: int = Field(201, ge=0, description="of streets, skies, instruments and drives")
    vehicles: int = Field(8, ge=1, le=4096, description="vehicles in a street; they share its city and its satellites")
    streets: int = Field(10, ge=1, description="streets of each sky for the fit, and as many others to be judged on")
    map_sigmas_m: tuple[Annotated[float, Field(ge=0, le=20)], ...] = Field(
        (0.5, 1.0, 2.5, 5.0), min_length=1, description="errors of heights in the maps, 1 sigma [m]; S2: 2 to 3 m"
    )
    map: MapConfig = Field(MapConfig(), description="the map of the prediction of availability and levels")
    recorded: RecordedPredictionConfig = Field(
        RecordedPredictionConfig(), description="what is compared of a recorded drive"
    )

    @property
    def maps(self) -> tuple[MapConfig, ...]:
        """The map of the prediction of availability, and those that differ in heights."""
        return (self.map, *(self.map.replace(height_sigma_m=sigma) for sigma in self.map_sigmas_m))


def run_prediction(
    config: PredictionConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore, berlin: Path | None = None
) -> dict[str, Any]:
    """Predict and drive the missing streets, and write ``results.json`` and figures; returns the results.

    Parameters
    ----------
    berlin : folder with a recorded drive, the city model that it passes through and messages of the day

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files; ``berlin`` lacks a
        file, or its files are not of one drive.
    """
    drive = None if berlin is None else read_recorded(berlin, config.recorded)
    found = work_streets(config, "prediction", 2 * config.streets, work_street, out, jobs, on_progress)
    streets = {sky: [SampledStreet.of(part) for part in parts] for sky, parts in found.items()}
    model = fitted([street for each in streets.values() for street in each[: config.streets]])
    unseen = {sky: each[config.streets :] for sky, each in streets.items()}
    groups = {sky: [each] for sky, each in unseen.items()} | {ALL: list(unseen.values())}
    result: dict[str, Any] = {
        "config": config.to_dict(),
        "satellites": [
            {"sky": sky, "sigma_m": sigma} | differences(each, 1 + k)
            for sky, each in streets.items()
            for k, sigma in enumerate(config.map_sigmas_m)
        ],
        "availability": [{"sky": name} | judged(model, each) for name, each in groups.items()],
        "reliability": [row | {"sky": name} for name, each in groups.items() for row in reliability(model, each)],
    }
    if drive is not None:
        result["recorded"] = compared(*drive, config.recorded)
        save(recorded_figure(result["recorded"], config.recorded.least_cn0_dbhz), out / "recorded.svg")
    save(figure_6({sky: each[0] for sky, each in unseen.items()}, config.vehicles), out / "satellites.svg")
    save(reliability_figure([row for row in result["reliability"] if row["sky"] == ALL]), out / "reliability.svg")
    return stored(result, out)


def work_street(config: PredictionConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Predict a street by each map, and drive it; it does not depend on others."""
    mask = mask_of(config, sky, number)
    navigator = navigator_of(config, sky, number, mask)
    stations = len(mask.rows.cell)
    predicted = _predictions(config, sky, number, stations, navigator.track)
    rows, every = [], round(SAMPLE_S / navigator.config.dt_s)
    first, epochs = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, config.span_s))
    vehicles = np.arange(config.vehicles)
    for k, truth in zip(range(epochs), drive_of(config, number, navigator.config.dt_s), strict=False):
        measured = navigator.measure(truth)
        solution = navigator.solve(measured)
        if k >= first and (k - first) % every == 0:
            received = measured.gnss.phase_m[..., 0] != 0.0  # carriers, which RTK needs
            direct = mask.look(truth.arc_m, truth.lane, measured.sky).path == SignalPath.LOS
            los, system = measured.sky.los_enu[measured.sky.index[0]], measured.sky.system
            station = np.clip(np.round(truth.arc_m / mask.spacing_m), 0, stations - 1)
            rows.append(np.column_stack([
                station, received.sum(-1), (received & direct).sum(-1), measured.gnss.tracked.sum(-1),
                np.minimum(pdop(los, system, received), WORST_PDOP), solution.mode == Mode.RTK,
                solution.available & ~solution.alert, np.minimum(solution.pl_ct_m, NO_LEVEL_M), vehicles,
            ]))  # fmt: skip
        advance((k + 1) / epochs)
    samples = np.concatenate(rows)
    samples = samples[np.argsort(samples[:, -1], kind="stable"), :-1].T  # vehicle by vehicle, in the order of time
    return {
        "spacing_m": mask.spacing_m,
        "speed_mps": config.drive.speed_limit_mps,
        "predicted": predicted,
        "samples": dict(zip(COLUMNS, np.round(samples, 3).tolist(), strict=True)),
    }


def _predictions(config: PredictionConfig, sky: str, number: int, stations: int, track: Any) -> list[dict[str, Any]]:
    """Satellites and PDOP at the stations of a street at departure, by each map."""
    road, city = road_of(config, number), city_of(config, sky, number)
    arc = np.linspace(0.0, road.length_m, stations)
    antennas = antennas_along(road, arc, road.lane_count, ANTENNA_HEIGHT_M)
    departure = track.at(track.start_s)
    found = []
    for one in config.maps:
        mapped = as_mapped(city, one, named_generator([config.seed, number], "map"))
        cells = AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG
        forecast = SkyForecast.of_stations(antennas, mapped, road.length_m / max(stations - 1, 1), *cells)
        each = predict_street(forecast, departure)
        found.append({
            "satellites": each.satellites.tolist(), "pdop": np.round(np.minimum(each.pdop, WORST_PDOP), 3).tolist()
        })  # fmt: skip
    return found


class SampledStreet(NamedTuple):
    """A street as predicted by M maps at N stations, and K samples of its drives.

    Attributes
    ----------
    spacing_m, speed_mps : distance of stations, speed of the plan
    satellites, pdop : (M, N)
    samples : by name of COLUMNS, (K,)
    """

    spacing_m: float
    speed_mps: float
    satellites: NDArray[np.int64]
    pdop: Array
    samples: dict[str, Array]

    @classmethod
    def of(cls, part: Mapping[str, Any]) -> SampledStreet:
        """The street of a stored part."""
        maps, samples = part["predicted"], {name: np.asarray(v, float) for name, v in part["samples"].items()}
        numbers = np.array([one["satellites"] for one in maps])
        return cls(part["spacing_m"], part["speed_mps"], numbers, np.array([one["pdop"] for one in maps]), samples)

    @property
    def station(self) -> NDArray[np.int64]:
        """(K,) station of each sample."""
        return self.samples["station"].astype(np.int64)


def differences(streets: Sequence[SampledStreet], which: int) -> dict[str, float]:
    """Received less predicted by one map, as S2 compares them: numbers of satellites and PDOP.

    PDOPs are compared where both sets determine a position with a PDOP below ``WORST_PDOP``.
    """
    of = [(s.samples["received"] - s.satellites[which, s.station]) for s in streets]
    number = np.concatenate(of)
    direct, codes = (np.concatenate([s.samples[n] - s.satellites[which, s.station] for s in streets]) for n in OTHERS)
    here = np.concatenate([s.samples["pdop"] for s in streets])
    there = np.concatenate([s.pdop[which, s.station] for s in streets])
    both = (here < WORST_PDOP) & (there < WORST_PDOP)
    return {
        "samples": number.size,
        "mean": float(number.mean()),
        "mean_abs": float(np.abs(number).mean()),
        "mean_abs_direct": float(np.abs(direct).mean()),
        "mean_codes": float(codes.mean()),
        "low": float(np.quantile(number, 0.025)),
        "high": float(np.quantile(number, 0.975)),
        "pdop": float(np.abs(here - there)[both].mean()),
        "pdop_median": float(np.median(np.abs(here - there)[both])),
        "without": float(1.0 - both.mean()),
    }


def fitted(streets: Sequence[SampledStreet]) -> AvailabilityModel:
    """The model of the samples of streets."""
    names = "rtk", "usable", "pl_ct_m"
    rtk, usable, levels = (np.concatenate([s.samples[name] for s in streets]) for name in names)
    number, pdops = (np.concatenate([v(s)[s.station] for s in streets]) for v in (_number, _pdop))

    def gap_of(fix: Fit) -> Array:
        return np.concatenate([gap_s(fix, s)[s.station] for s in streets])

    return AvailabilityModel.fitted(number, pdops, rtk > 0.0, usable > 0.0, levels, gap_of, QUANTILES)


def probability(model: AvailabilityModel, street: SampledStreet) -> Array:
    """Probability of a usable position at the stations of a street, (N,)."""
    return model.probability(_number(street), gap_s(model.fix, street))


def gap_s(fix: Fit, street: SampledStreet) -> Array:
    """Time since an RTK position was likely, at the planned speed, (N,); the longest one before it first is."""
    good = likely(fix, _number(street), _pdop(street))
    at_s = np.arange(good.size) * street.spacing_m / street.speed_mps
    return np.where(np.maximum.accumulate(good), gaps_along(good, at_s), LONGEST_GAP_S)


def _number(street: SampledStreet) -> Array:
    return np.asarray(street.satellites[0], dtype=np.float64)


def _pdop(street: SampledStreet) -> Array:
    return np.asarray(street.pdop[0])


def judged(model: AvailabilityModel, skies: Sequence[Sequence[SampledStreet]]) -> dict[str, Any]:
    """Brier score of the probabilities beside that of each sky's share, and how often levels lie below.

    The skill is ``1 - BS / BS_climate``; the climate is the usable share of the judged streets of each sky,
    which is not known before. Its interval is by street, drawn again within each sky, with the share of what is drawn.
    """
    streets = [street for each in skies for street in each]
    said = [probability(model, s)[s.station] for s in streets]
    was = [s.samples["usable"] for s in streets]
    sums = np.array([[((p - u) ** 2).sum(), u.sum(), u.size] for p, u in zip(said, was, strict=True)])
    drawn, first = _drawn([len(each) for each in skies]), np.cumsum([0, *map(len, skies)])
    brier, climate = np.zeros((2, RESAMPLES + 1))
    for begin, end in pairwise(first.tolist()):
        wrong, usable, number = np.moveaxis(sums[drawn[:, begin:end]].sum(1), -1, 0)
        brier += wrong
        climate += usable - usable**2 / number
    skill = 1.0 - brier / climate
    levels = np.concatenate([model.quantiles(probability(model, s))[s.station] for s in streets])
    real = np.concatenate([s.samples["pl_ct_m"] for s in streets])
    return {
        "streets": len(streets),
        "usable": float(sums[:, 1].sum() / sums[:, 2].sum()),
        "predicted": float(np.concatenate(said).mean()),
        "brier": float(sums[:, 0].sum() / sums[:, 2].sum()),
        "skill": _interval(skill),
        "below": [float((real <= levels[:, q]).mean()) for q in range(len(QUANTILES))],
    }


def reliability(model: AvailabilityModel, skies: Sequence[Sequence[SampledStreet]]) -> list[dict[str, Any]]:
    """Predicted probability and usable share, with its interval by street, of the samples in bins of equal width."""
    streets = [street for each in skies for street in each]
    said = [probability(model, s)[s.station] for s in streets]
    place = [np.minimum((p * BINS).astype(np.int64), BINS - 1) for p in said]
    sums = np.array([
        [np.bincount(b, weights, BINS) for weights in (p, s.samples["usable"], np.ones(p.size))]
        for s, p, b in zip(streets, said, place, strict=True)
    ])  # fmt: skip
    foretold, usable, number = np.moveaxis(sums[_drawn([len(each) for each in skies])].sum(1), 1, 0)
    return [
        {
            "predicted": float(foretold[0, b] / number[0, b]),
            "usable": _interval(usable[:, b] / np.maximum(number[:, b], 1.0)),
            "samples": int(number[0, b]),
        }
        for b in range(BINS)
        if number[0, b]
    ]


def _drawn(sizes: Sequence[int]) -> NDArray[np.int64]:
    """All streets, and then streets drawn again with replacement within each sky: (1 + RESAMPLES, streets)."""
    rng, begin, columns = named_generator(0, "resamples"), 0, []
    for size in sizes:
        columns.append(begin + np.vstack([np.arange(size), rng.integers(size, size=(RESAMPLES, size))]))
        begin += size
    return np.concatenate(columns, axis=1)


def _interval(values: Array) -> dict[str, float]:
    """The first value, and the interval of the others."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(values[1:], (tail, 1.0 - tail))
    return {"value": float(values[0]), "low": float(low), "high": float(high)}


def figure_6(streets: Mapping[str, SampledStreet], vehicles: int) -> Figure:
    """Received less predicted along the drive of one vehicle, as S2 Figure 6: satellites and PDOP, a row a sky."""
    figure = new_figure(7.5, 1.9 * len(streets) + 0.4)
    axes = figure.subplots(len(streets), 2, squeeze=False)
    for (sky, s), (left, right) in zip(streets.items(), axes, strict=True):
        first = slice(0, s.station.size // vehicles)
        number = (s.samples["received"] - s.satellites[0, s.station])[first]
        left.step(np.arange(number.size) * SAMPLE_S, number, color=INK, lw=1.0)
        here, there = s.samples["pdop"][first], s.pdop[0, s.station][first]
        change = np.where((here < WORST_PDOP) & (there < WORST_PDOP), here - there, np.nan)
        right.step(np.arange(change.size) * SAMPLE_S, change, color=PL_COLOUR, lw=1.0)
        tidy(left, ylabel=f"{sky}\nsatellites [-]")
        tidy(right, ylabel="PDOP [-]")
    for one, title in zip(axes[0], ("received less predicted satellites", "received less predicted PDOP"), strict=True):
        one.set_title(title, fontsize=9)
    for one in axes[-1]:
        one.set_xlabel("time [s]")
    return figure


def reliability_figure(bins: Sequence[Mapping[str, Any]]) -> Figure:
    """Usable share by predicted probability, streets that nothing was fitted on."""
    figure = new_figure(4.2, 3.6)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], "--", color=INK, lw=0.8, label="calibrated")
    for b in bins:
        axes.plot([b["predicted"]] * 2, [b["usable"]["low"], b["usable"]["high"]], color=PL_COLOUR, lw=1.2)
    said, was = [b["predicted"] for b in bins], [b["usable"]["value"] for b in bins]
    axes.plot(said, was, "o-", color=PL_COLOUR, label="unseen streets")
    tidy(axes, xlabel="predicted probability [-]", ylabel="usable share [-]")
    legend(axes)
    return figure


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables."""
    title = "Received less predicted, by the error of mapped heights (S2: 2 on average, within 5; PDOP 0.461)"
    yield title, satellites(result)
    yield "Availability on streets that nothing was fitted on; intervals of 95 % by street", availability(result)
    rows = [(b["sky"], f"{b['predicted']:.2f}", _cell(b["usable"]), f"{b['samples']:,}") for b in result["reliability"]]
    yield "Reliability of the predicted probability", (("sky", "predicted", "usable", "samples"), rows)
    if found := result.get("recorded"):
        title = (
            f"GPS satellites of the recorded drive: received less predicted by its city model, {found['epochs']} places"
        )
        yield title, recorded_rows(found)
        yield "The same by passage through the model, without errors of heights", passage_rows(found)
        yield "Received satellites by what the model predicts", sight_rows(found)


def _cell(found: Mapping[str, float]) -> str:
    return f"{found['value']:.2f} ({found['low']:.2f} .. {found['high']:.2f})"


def satellites(result: Mapping[str, Any]) -> Table:
    """Differences of satellites and PDOP, by sky and map."""
    heads = ("sky", "map", "mean", "mean abs", "95 %", "direct, abs", "codes", "PDOP abs", "median", "no position")
    return heads, [
        (
            d["sky"], f"{d['sigma_m']:g} m", f"{d['mean']:+.1f}", f"{d['mean_abs']:.1f}",
            f"{d['low']:+.0f} .. {d['high']:+.0f}", f"{d['mean_abs_direct']:.1f}", f"{d['mean_codes']:+.1f}",
            f"{d['pdop']:.2f}", f"{d['pdop_median']:.2f}", f"{100.0 * d['without']:.0f} %",
        )
        for d in result["satellites"]
    ]  # fmt: skip


def availability(result: Mapping[str, Any]) -> Table:
    """Predicted and realised availability, Brier skill and coverage of the quantiles of PL_CT, by sky."""
    below = [f"PL_CT below {100.0 * q:.0f} %" for q in QUANTILES]
    heads = ("sky", "usable", "predicted", "Brier score", "skill", *below)
    return heads, [
        (
            d["sky"], f"{100.0 * d['usable']:.1f} %", f"{100.0 * d['predicted']:.1f} %", f"{d['brier']:.3f}",
            _cell(d["skill"]),
            *(f"{100.0 * share:.0f} %" for share in d["below"]),
        )
        for d in result["availability"]
    ]  # fmt: skip
