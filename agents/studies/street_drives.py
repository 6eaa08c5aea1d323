"""Drives of the whole navigator in generated streets: errors and protection levels of each epoch, by vehicle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.studies.study import claim, parts_of
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sky.city import build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, clad
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]

PACKAGES = ("lanebound.integrity", "lanebound.agents.studies", "lanebound.envs.sky")  # that results depend on
WEEK_S = 604_800
BLOCKS_M = (120.0, 320.0)  # lengths of the straight parts of a street
AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG = 4.0, 3.0  # as in the environments
HOUR_S = 3600


class StreetDrivesConfig(Config):
    """Streets, vehicles in them, and what they are equipped with."""

    skies: tuple[str, ...] = Field(
        ("urban", "dense"), min_length=1, description="levels of sky, with their instruments"
    )
    faults: str | None = Field(
        "sensors/fault_priors_nominal", description="preset of fault rates; none: nothing but what the street does"
    )
    vehicles: int = Field(16, ge=1, le=4096, description="vehicles in a street; they share its city and its satellites")
    duration_s: float = Field(180.0, gt=0, description="length of a drive after the warm-up [s]")
    warm_up_s: float = Field(20.0, ge=0, description="time before the first epoch that counts [s]")
    length_m: float = Field(
        4000.0, ge=500, le=20_000, description="length of a street [m]; vehicles that reach its end stand there"
    )
    seed: int = Field(1, ge=0, description="of streets, skies, instruments, drives and faults")
    navigator: NavigatorConfig = NavigatorConfig()
    drive: DriveConfig = DriveConfig()

    @property
    def span_s(self) -> float:
        """Length of a drive with its warm-up [s]."""
        return self.warm_up_s + self.duration_s

    def navigator_in(self, sky: str) -> NavigatorConfig:
        """The navigator with the instruments of a sky; what differs from the defaults of its kind is kept."""
        own = _changed(self.navigator.to_dict(), type(self.navigator)().to_dict())
        return SkyLevel.named(sky).navigator(self.navigator).replace(**own)


def _changed(now: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """What differs from other plain data, by key."""
    both = {key: (value, before.get(key)) for key, value in now.items()}
    return {
        key: _changed(new, old) if isinstance(new, dict) and isinstance(old, dict) else new
        for key, (new, old) in both.items()
        if new != old
    }


C = TypeVar("C", bound=StreetDrivesConfig)


def work_streets(
    config: C,
    kind: str,
    streets: int,
    work: Callable[[C, str, int, Advance], dict[str, Any]],
    out: Path,
    jobs: int = 1,
    on_progress: OnProgress = ignore,
) -> dict[str, list[dict[str, Any]]]:
    """The data of the streets of each sky: those in ``out``, and ``work(config, sky, number, advance)`` of the others.

    ``kind`` is that of the study that claims the folder. ``work`` must be picklable with more than one job, and a
    street must not depend on others.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, kind, config, PACKAGES)
    names = [f"{k}-{number}" for k in range(len(config.skies)) for number in range(streets)]
    parts = parts_of(config, partial(_work_part, work), names, out, jobs, on_progress)
    return {
        sky: [part for name, part in parts.items() if name.startswith(f"{k}-")] for k, sky in enumerate(config.skies)
    }


def _work_part(
    work: Callable[[C, str, int, Advance], dict[str, Any]], config: C, name: str, advance: Advance = ignore
) -> dict[str, Any]:
    sky, number = (int(text) for text in name.split("-"))
    return work(config, config.skies[sky], number, advance)


@dataclass(frozen=True)
class DriveMoment:
    """One epoch of B vehicles: error_m (B, 2) along and across the true heading, and the solution."""

    time_s: float
    error_m: Array
    solution: Solution


def drive_street(config: StreetDrivesConfig, sky: str, number: int, advance: Advance = ignore) -> Iterator[DriveMoment]:
    """Drive the vehicles of street ``number`` under a sky; each street has a city, an hour and draws of its own."""
    navigator, drive = street_of(config, sky, number)
    first, epochs = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, config.span_s))
    for k, truth in zip(range(epochs), drive, strict=False):
        solution = navigator.step(truth)
        error = solution.position_en_m - truth.position_enu_m[:, :2]
        if k >= first:
            turned = np.einsum("bij,bj->bi", track_from_enu_matrix(truth.heading_rad), error)
            yield DriveMoment(truth.time_s, turned, solution)
        advance((k + 1) / epochs)


def street_of(config: StreetDrivesConfig, sky: str, number: int) -> tuple[Navigator, Iterator[Truth]]:
    """The navigator of the vehicles of a street, and their true motion without end."""
    navigator = navigator_of(config, sky, number, mask_of(config, sky, number))
    return navigator, drive_of(config, number, navigator.config.dt_s)


def mask_of(config: StreetDrivesConfig, sky: str, number: int) -> SkyMask:
    """What the buildings of a street leave of its sky; it does not depend on the navigator."""
    road, city = road_of(config, number), city_of(config, sky, number)
    return SkyMask.build(road, city, az_step_deg=AZIMUTH_STEP_DEG, el_step_deg=ELEVATION_STEP_DEG)


def city_of(config: StreetDrivesConfig, sky: str, number: int) -> City:
    """What lines street ``number`` under a sky."""
    level, seeds, road = SkyLevel.named(sky), [config.seed, number], road_of(config, number)
    city = build_city(road, level.streets_along(2.0 * road.edge_m), named_generator(seeds, "city"))
    return replace(city, material=clad(city.building, level.material_shares, named_generator(seeds, "facades")))


def drive_of(config: StreetDrivesConfig, number: int, dt_s: float) -> Iterator[Truth]:
    """The true motion of the vehicles of a street without end, under any sky and for any navigator of this epoch."""
    road = road_of(config, number)
    car, traffic = CityDrive(road, config.drive, dt_s), Streams(_vehicle_seeds(config, number)[:-1])
    state = car.start(traffic, spread_m=_spread_m(config, road))
    return (car.step(state, traffic) for _ in count())


def road_of(config: StreetDrivesConfig, number: int) -> Road:
    """The road of street ``number``."""
    return _staircase(config.length_m, named_generator([config.seed, number], "road"))


def _spread_m(config: StreetDrivesConfig, road: Road) -> float:
    """Length over which vehicles start, so that none reaches the end of a street that is long enough."""
    return max(road.length_m - config.drive.speed_limit_mps * config.span_s, 0.1 * road.length_m)


def navigator_of(config: StreetDrivesConfig, sky: str, number: int, mask: SkyMask) -> Navigator:
    """The navigator of a street's vehicles."""
    hour = int(named_generator([config.seed, number], "sky").integers(24))
    base = config.navigator_in(sky)
    base = base.replace(sky={"week_second_s": (base.sky.week_second_s + HOUR_S * hour) % WEEK_S})
    track = SkyTrack.from_config(base.sky, config.span_s + 60.0)
    faults: Any = None
    if config.faults is not None:
        view = track.at(track.start_s, np.zeros(config.vehicles, dtype=np.int64))
        rng = named_generator([config.seed, number], "faults")
        faults = FaultSchedule(random_campaign(FaultPriors.preset(config.faults), config.span_s, rng, view))
    *seeds, area = _vehicle_seeds(config, number)
    return Navigator(base, track, mask, seeds, faults=faults, area_seed=area)


def _vehicle_seeds(config: StreetDrivesConfig, number: int) -> list[int]:
    """A seed for each vehicle of a street and one for its area, unlike those of other streets."""
    drawn = named_generator([config.seed, number], "vehicles").integers(2**32, size=config.vehicles + 1)
    return [int(seed) for seed in drawn]


def _staircase(length_m: float, rng: np.random.Generator) -> Road:
    """A street with right-angled bends, right and left in turn, so that it never meets itself."""
    points, eastward, gone = [(0.0, 0.0)], bool(rng.integers(2)), 0.0
    while gone < length_m:
        block = min(float(rng.uniform(*BLOCKS_M)), max(length_m - gone, BLOCKS_M[0]))
        east, north = points[-1]
        points.append((east + block, north) if eastward else (east, north + block))
        gone, eastward = gone + block, not eastward
    return Road.through(np.array(points))
