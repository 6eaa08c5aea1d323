"""Satellites predicted and received on a recorded drive through a city model (S2 section 3, with real buildings).

A folder holds a smartLoc drive with its truth, a city model that the drive passes through, and broadcast messages of
the day. GPS time of the recording is found by the satellite positions in it. From the true places, the model and the
messages the GPS satellites in line of sight are predicted epoch by epoch, and compared with those that were received
with a C/N0 from some threshold on. Only places well inside of the model count: beyond its edge no building is known.
The model's buildings stand on a flat street, so the height of the antenna is that above the street; heights above the
ellipsoid, 40 m more than those of the model in Berlin, are not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from lanebound.agents.report.pages import Table
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, tidy
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import enu_axes, geodetic_from_ecef
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.recorded.smartloc import read_smartloc
from lanebound.integrity.replay.city import find_smartloc
from lanebound.integrity.replay.datasets import navigation_files
from lanebound.integrity.sky.availability import WORST_PDOP
from lanebound.integrity.sky.broadcast import Ephemerides, positions, read_navigation
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.maps.city_models import is_city_model, read_city_model
from lanebound.integrity.sky.orbit import ranges_and_sights
from lanebound.integrity.sky.prediction import pdop
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.survey import MapConfig, as_mapped
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System
from lanebound.integrity.sky.view import SkyView

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SEARCH_S = 20.0  # of GPS time, in which a satellite moves 80 km
SURE_M = 200.0  # of satellites, from which on the messages are not those of the drive; broadcast orbits err by metres
CELLS_DEG = 2.0, 1.0  # of azimuth and elevation
RECEIVER = "C/N0 from {:g} dB-Hz"


class RecordedPredictionConfig(Config):
    """Which places and satellites of a recorded drive are compared."""

    height_sigmas_m: tuple[Annotated[float, Field(ge=0, le=20)], ...] = Field(
        (0.0, 0.5, 1.0, 2.5, 5.0), min_length=1, description="errors of heights added to the model, 1 sigma [m]"
    )
    draws: int = Field(50, ge=1, le=1000, description="of the errors of the model [-]")
    least_cn0_dbhz: tuple[Annotated[float, Field(ge=0, le=70)], ...] = Field(
        (0.0, 30.0, 35.0, 40.0), min_length=1, description="from which on a satellite counts as received [dB-Hz]"
    )
    mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation compared [deg]; as of code positions")
    inside_m: float = Field(20.0, ge=0, description="least distance from the edge of the model [m]; chosen")
    apart_m: float = Field(5.0, ge=0, description="least distance of a place from the one before [m]; chosen")
    antenna_m: float = Field(1.5, gt=0, le=5, description="height of the antenna above the street [m]; of a car")
    seed: int = Field(1, ge=0, description="of the errors of the model")


class RecordedSky(NamedTuple):
    """The satellites of E places of a drive.

    Attributes
    ----------
    time_s : (E,) of the recording
    place_enu_m : (E, 3) antennas in the frame of the model
    los_enu : (E, S, 3) directions to the satellites
    cn0_dbhz : (E, S) 0 where not received
    above : (E, S) a message is valid and the elevation is above the mask
    prn : (S,)
    misfit_m : largest distance of a recorded satellite position from that of the messages
    passage : (E,) number of the passage; between two of them the drive was near the edge of the model or outside
    """

    time_s: Array
    place_enu_m: Array
    los_enu: Array
    cn0_dbhz: Array
    above: Bools
    prn: NDArray[np.int64]
    misfit_m: float
    passage: NDArray[np.int64]


def read_recorded(folder: Path, config: RecordedPredictionConfig) -> tuple[RecordedSky, City]:
    """The satellites of a recorded drive at its places inside of a city model, and that model.

    Raises
    ------
    InputError
        The folder lacks a file, the model has no place on the Earth, the messages are not those of the drive, or no
        place lies inside of the model.
    """
    models = sorted(path for path in folder.iterdir() if is_city_model(path)) if folder.is_dir() else []
    if not models:
        raise InputError(f"{folder} must hold a city model (.gml, .citygml, .json), has none: add that of the drive")
    model = read_city_model(models[0])
    if model.frame is None:
        raise InputError(f"{models[0]} must have UTM coordinates, got others: convert it")
    files = find_smartloc(folder)
    drive = read_smartloc(*files) if files else None
    if drive is None or drive.truth is None:
        raise InputError(f"{folder} must hold *_Input.txt(.gz) and *_GT.txt of smartLoc: give another folder")
    rows = drive.ranges
    gps = rows.system == "G"
    epochs, which = np.unique(rows.time_s[gps], return_inverse=True)
    truth, known = drive.truth.at(epochs)
    lat, lon, _ = geodetic_from_ecef(truth)
    place = model.frame.en_of(np.degrees(lat), np.degrees(lon))
    chosen = _spaced(place, known & (_inside_m(model.city, place) >= config.inside_m), config.apart_m)
    if not chosen.size:
        raise InputError(f"{folder} must have places {config.inside_m:g} m inside of its city model, has none")
    messages = Ephemerides.merged([read_navigation(path) for path in navigation_files(folder)])
    messages = messages.take(messages.system == System.GPS)
    satellite, range_m, prn = rows.satellite_ecef_m[gps], rows.range_m[gps], rows.satellite[gps]
    start, misfit = _start_s(messages, rows.time_s[gps], satellite, range_m, prn, folder)
    states = positions(messages, start + epochs[chosen], np.median(range_m) / SPEED_OF_LIGHT_MPS, healthy_only=False)
    names = states.satellite[:, 1]
    _, sight = ranges_and_sights(states.position_ecef_m, truth[chosen, None])
    los = np.einsum("eij,esi->esj", enu_axes(truth[chosen]), sight)
    above = states.usable & (los[..., 2] >= np.sin(np.radians(config.mask_deg)))
    cn0 = np.zeros(above.shape)
    for row, number, value in zip(which, prn, rows.cn0_dbhz[gps], strict=True):
        at = np.flatnonzero(chosen == row)
        cn0[at, np.flatnonzero(names == number)] = value
    antennas = np.insert(place[chosen], 2, config.antenna_m, 1)
    lat, lon, _ = geodetic_from_ecef(drive.truth.position_ecef_m)
    out = _inside_m(model.city, model.frame.en_of(np.degrees(lat), np.degrees(lon))) < config.inside_m
    _, passage = np.unique(np.searchsorted(drive.truth.time_s[out], epochs[chosen]), return_inverse=True)
    return RecordedSky(epochs[chosen], antennas, los, cn0, above, names, misfit, passage), model.city


def _inside_m(city: City, place_en_m: Array) -> Array:
    """Distance of places (E, 2) from the edge of the convex hull of a city, negative outside (E,)."""
    hull = ConvexHull(city.triangles_enu_m.reshape(-1, 3)[:, :2]).equations
    return np.asarray(-(place_en_m @ hull[:, :2].T + hull[:, 2]).max(1))


def _spaced(place: Array, wanted: Bools, apart_m: float) -> NDArray[np.int64]:
    """Epochs that are wanted, each at some distance from the one before that is kept."""
    kept: list[int] = []
    for k in np.flatnonzero(wanted).tolist():
        if not kept or float(np.linalg.norm(place[k] - place[kept[-1]])) >= apart_m:
            kept.append(k)
    return np.array(kept, np.int64)


def _start_s(
    messages: Ephemerides, time_s: Array, satellite_ecef_m: Array, range_m: Array, prn: NDArray[np.int64], folder: Path
) -> tuple[float, float]:
    """GPS time of time 0 of a recording by its satellite positions, and the largest misfit of them [m]."""
    names = messages.satellites[:, 1]
    column = np.searchsorted(names, prn)
    some = np.isin(prn, names)
    column, time, travel, seen = column[some], time_s[some], range_m[some] / SPEED_OF_LIGHT_MPS, satellite_ecef_m[some]

    first = np.flatnonzero(time == time[0])
    span = np.arange(messages.toe_s.min() - 7200.0, messages.toe_s.max() + 7200.0, SEARCH_S)
    found = positions(messages, span, np.median(travel), healthy_only=False)
    off = np.linalg.norm(found.position_ecef_m[:, column[first]] - seen[first], axis=-1)
    off = np.where(found.usable[:, column[first]], off, np.inf)
    start = float(span[np.argmin(np.median(off, axis=1))]) - float(time[0])

    def away(start: float) -> tuple[Array, Array]:
        """Differences (n, 3) of all satellite positions and velocities (n, 3); infinite without a message."""
        found = positions(messages, start + time - travel, healthy_only=False)
        line = np.arange(column.size)
        off = seen - found.position_ecef_m[line, column]
        return np.where(found.usable[line, column][:, None], off, np.inf), found.velocity_ecef_mps[line, column]

    for _ in range(4):  # Newton: along the orbits
        off, velocity = away(start)
        use = np.isfinite(off).all(1)
        start += float((off[use] * velocity[use]).sum() / np.square(velocity[use]).sum()) if use.any() else 0.0
    misfit = np.linalg.norm(away(start)[0], axis=1)
    misfit = misfit[np.isfinite(misfit)]
    if not misfit.size or misfit.max() > SURE_M:
        raise InputError(f"{folder} must hold the messages of the day of its drive, got those of another: add them")
    return start, float(misfit.max())


def predicted(sky: RecordedSky, city: City) -> Bools:
    """Whether the satellites are in line of sight above the mask, (E, S)."""
    forecast = SkyForecast.of_stations(sky.place_enu_m[:, None], city, 1.0, *CELLS_DEG)
    azimuth = np.arctan2(sky.los_enu[..., 0], sky.los_enu[..., 1]) % (2.0 * np.pi)
    elevation = np.arcsin(np.clip(sky.los_enu[..., 2], -1.0, 1.0))
    zero, one = np.zeros((1, sky.prn.size)), np.zeros(1, np.int64)
    out = np.zeros(sky.above.shape, np.bool_)
    for k in range(sky.time_s.size):
        each = slice(k, k + 1)
        view = SkyView(
            sky.los_enu[each], elevation[each], azimuth[each], zero, zero, sky.above[each],
            np.full(sky.prn.size, int(System.GPS)), sky.prn, one,
        )  # fmt: skip
        out[k] = SkyForecast(forecast.free[each], forecast.azimuths, forecast.elevations, 1.0).in_sight(view)[0, 0]
    return out


def compared(sky: RecordedSky, city: City, config: RecordedPredictionConfig) -> dict[str, Any]:
    """Received less predicted by error of the model and by threshold; and the C/N0 of what is predicted in sight."""
    by_error: list[dict[str, Any]] = []
    for sigma in config.height_sigmas_m:
        rng = named_generator([config.seed, round(1000.0 * sigma)], "map")
        errors = MapConfig(height_sigma_m=sigma, position_sigma_m=0.0)
        cities = [as_mapped(city, errors, rng) for _ in range(config.draws)] if sigma else [city]
        each = np.array([predicted(sky, one) for one in cities])
        by_error += [
            {"sigma_m": sigma, "cn0_dbhz": least, **_differences(sky, each, least)} for least in config.least_cn0_dbhz
        ]
    sight = predicted(sky, city)
    received = sky.above & (sky.cn0_dbhz > 0.0)
    return {
        "epochs": sky.time_s.size, "satellites": int(sky.above.sum()), "misfit_m": sky.misfit_m,
        "differences": by_error,
        "passages": [
            {"passage": int(k), "places": int((sky.passage == k).sum()), "cn0_dbhz": least}
            | _differences(_during(sky, k), sight[None, sky.passage == k], least)
            for k in np.unique(sky.passage) for least in config.least_cn0_dbhz
        ],
        "cn0_dbhz": {
            name: {
                "pairs": int((kind & sky.above).sum()), "received": int((kind & received).sum()),
                "quartiles": np.quantile(sky.cn0_dbhz[kind & received], (0.25, 0.5, 0.75)).tolist()
                if (kind & received).any() else None,
            }
            for name, kind in (("in sight", sight), ("blocked", ~sight))
        },
        "series": {
            "time_s": sky.time_s.tolist(), "predicted": sight.sum(1).tolist(),
            **{f"{least:g}": (received & (sky.cn0_dbhz >= least)).sum(1).tolist() for least in config.least_cn0_dbhz},
        },
    }  # fmt: skip


def _during(sky: RecordedSky, passage: int) -> RecordedSky:
    """The places of one passage."""
    own = sky.passage == passage
    return sky._replace(
        time_s=sky.time_s[own], place_enu_m=sky.place_enu_m[own], los_enu=sky.los_enu[own], cn0_dbhz=sky.cn0_dbhz[own],
        above=sky.above[own], passage=sky.passage[own],
    )  # fmt: skip


def _differences(sky: RecordedSky, sight: Bools, least: float) -> dict[str, float | None]:
    """Of predictions (draws, E, S): numbers, PDOP where both sets determine a position below ``WORST_PDOP``, pairs."""
    received = sky.above & (sky.cn0_dbhz > 0.0) & (sky.cn0_dbhz >= least)
    number = received.sum(-1) - sight.sum(-1)
    system = np.full(sky.prn.size, int(System.GPS))

    def dilution(used: Bools) -> Array:
        """(..., S) of the epochs -> (...,)."""
        return np.array([pdop(sky.los_enu[k], system, used[..., k, :].reshape(-1, used.shape[-1]))
                         for k in range(sky.time_s.size)])  # fmt: skip

    here, there = dilution(received[None]), dilution(sight)
    both = (here < WORST_PDOP) & (there < WORST_PDOP)
    off = np.where(both, np.abs(np.where(both, here, 0.0) - np.where(both, there, 0.0)), np.nan)
    agree = (sight == received)[:, sky.above]
    return {
        "mean": float(number.mean()), "mean_abs": float(np.abs(number).mean()), "most": float(np.abs(number).max()),
        "pdop": float(np.nanmean(off)) if both.any() else None,
        "pdop_median": float(np.nanmedian(off)) if both.any() else None, "without": float(1.0 - both.mean()),
        "agree": float(agree.mean()),
    }  # fmt: skip


def _cells(d: Mapping[str, Any]) -> tuple[str, ...]:
    """Threshold of C/N0 and differences."""
    return (
        f"{d['cn0_dbhz']:g} dB-Hz" if d["cn0_dbhz"] else "all", f"{d['mean']:+.1f}", f"{d['mean_abs']:.1f}",
        f"{d['most']:.0f}", *("-" if d[key] is None else f"{d[key]:.2f}" for key in ("pdop", "pdop_median")),
        f"{100.0 * d['without']:.0f} %", f"{100.0 * d['agree']:.0f} %",
    )  # fmt: skip


HEADS = "received from", "mean", "mean abs", "most", "PDOP abs", "median", "no position", "pairs agree"


def recorded_rows(found: Mapping[str, Any]) -> Table:
    """Differences by error of the model and by threshold of C/N0."""
    return ("error of heights", *HEADS), [(f"{d['sigma_m']:g} m", *_cells(d)) for d in found["differences"]]


def passage_rows(found: Mapping[str, Any]) -> Table:
    """Differences of each passage through the model as it is: the places of one are neighbours."""
    rows = [(str(d["passage"] + 1), str(d["places"]), *_cells(d)) for d in found["passages"]]
    return ("passage", "places", *HEADS), rows


def sight_rows(found: Mapping[str, Any]) -> Table:
    """How strong satellites are that the model leaves in sight and that it blocks."""
    rows = [
        (name, str(kind["pairs"]), f"{100.0 * kind['received'] / max(kind['pairs'], 1):.0f} %",
         "-" if kind["quartiles"] is None else " / ".join(f"{q:.0f}" for q in kind["quartiles"]))
        for name, kind in found["cn0_dbhz"].items()
    ]  # fmt: skip
    return ("by the model", "pairs", "received", "C/N0, quartiles [dB-Hz]"), rows


def recorded_figure(found: Mapping[str, Any], thresholds: Sequence[float]) -> Figure:
    """Numbers of satellites by place: in sight by the model, and received from each threshold on."""
    figure, series = new_figure(7.0, 3.0), found["series"]
    axes = figure.subplots()
    at = np.arange(len(series["time_s"]))
    axes.plot(at, series["predicted"], "o-", color=INK, lw=1.4, label="in sight by the model")
    for k, least in enumerate(thresholds):
        label = RECEIVER.format(least) if least else "received"
        axes.plot(at, series[f"{least:g}"], color=PL_COLOUR, alpha=0.25 + 0.7 * k / len(thresholds), label=label)
    axes.set_ylim(bottom=0.0)
    tidy(axes, title="GPS satellites", xlabel="places, in the order of the drive", ylabel="satellites [-]")
    legend(axes)
    return figure
