"""Freeze what the package computes, and compare a later version with it: the safety net of a refactoring.

    .venv/bin/python tests/helpers/frozen.py save FILE.npz       # in the checkout to be kept
    .venv/bin/python tests/helpers/frozen.py compare FILE.npz    # in the changed one
    .venv/bin/python tests/helpers/frozen.py digest              # renews what test_same_results.py compares with

Three groups: ``navigator`` (24,000 vehicle-epochs under four skies with and without each kind of fault), ``single``
(drives of all environment ids under several configurations) and ``engine`` (the same through the vector engine). The
comparison prints for each case whether all bits are equal, or the largest difference and where it begins.

The digest is of a short part of the first group. It is compared in every run of the tests, on any machine.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

import lanebound.envs
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.fault_kinds import FaultKind, FaultTarget
from lanebound.integrity.sensors.fault_registry import BUILT_IN, fault_kind
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

Arrays = dict[str, np.ndarray]
VEHICLES, EPOCHS = 20, 300  # of each of four skies: 24,000 vehicle-epochs
DIGEST = Path(__file__).with_name("same_results.json")
STREETS = {"open": None, "suburban": "suburban", "urban": "semi_urban", "dense": "dense_canyon"}

SINGLE: list[tuple[str, dict[str, Any], int, int]] = [
    ("LaneKeeping", {}, 3, 40),
    ("LaneKeeping", {"sky": "dense", "faults": "stress", "observation": {"form": "flat", "history": 2}}, 2, 40),
    ("LaneKeeping", {"action": "meta", "world": {"lanes_count": 2}, "navigation": {"source": "offset"}}, 2, 30),
    ("CarFollowing", {}, 3, 40),
    ("CarFollowing", {"perception": {"source": "both"}, "sky": "dense", "faults": "stress"}, 2, 40),
    ("CarFollowing", {"observation": {"integrity": "oracle"}, "perception": {"source": "sensor"}}, 2, 30),
    ("Highway", {"world": {"vehicles_count": 12}}, 2, 20),
    ("Highway", {"world": {"vehicles_count": 12}, "perception": {"source": "truth"}, "keep_lane": False}, 2, 20),
    ("Merge", {}, 3, 20),
    ("Merge", {"sky": "dense", "faults": "stress", "perception": {"source": "both"}}, 2, 20),
    ("Roundabout", {}, 3, 20),
    ("Roundabout", {"observation": {"integrity": "oracle"}, "faults": "stress"}, 2, 20),
    ("Intersection", {}, 3, 20),
    ("Intersection", {"action": "continuous", "perception": {"source": "both"}}, 2, 20),
    ("Racetrack", {}, 3, 40),
    ("Racetrack", {"observation": {"integrity": "blind"}, "perception": {"source": "none"}}, 2, 30),
    ("UrbanCanyon", {}, 3, 30),
    ("UrbanCanyon", {"action": "continuous", "sky": "dense", "faults": "stress"}, 2, 30),
]
WRAPPED: list[tuple[str, dict[str, Any]]] = [
    ("two-way-v0", {"sky": "urban"}),
    ("exit-v0", {"sky": "suburban"}),
    ("u-turn-v0", {"sky": "urban"}),
    ("lane-keeping-v0", {"sky": "urban"}),
    ("racetrack-large-v1", {"sky": "urban"}),
]
ENGINE: list[tuple[str, dict[str, Any], int, int]] = [
    ("LaneKeeping", {}, 6, 40),
    ("LaneKeeping", {"sky": "dense", "observation": {"integrity": "oracle"}}, 4, 30),
    ("CarFollowing", {}, 6, 40),
    ("CarFollowing", {"perception": {"source": "both"}, "sky": "dense", "action": "meta"}, 4, 30),
    ("Highway", {"perception": {"source": "truth"}}, 6, 30),
    ("Highway", {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}, 6, 30),
    ("Highway", {"world": {"vehicles_count": 12}}, 3, 20),
    ("UrbanCanyon", {}, 4, 30),
    ("UrbanCanyon", {"action": "continuous", "perception": {"source": "sensor"}}, 4, 30),
]


def navigator_cases() -> Iterator[tuple[str, Arrays]]:
    """Four skies, vehicles with the faults in turn and some without."""
    for sky in STREETS:
        yield f"navigator/{sky}", _under(sky, Spell(EPOCHS, 12.0, 8.0))


class Spell(NamedTuple):
    """Epochs of a drive, and begin and length of the faults in it [s]."""

    epochs: int
    start_s: float
    duration_s: float


def digest() -> dict[str, list[float]]:
    """A number of each field of the solution for each of 20 vehicles, in 60 epochs under a dense sky.

    It is the mean of the finite values, with weights that differ in epochs and components; where a field has others,
    their share beside it. Numbers have 6 digits, so that another processor or BLAS gives the same ones.
    """
    found = {}
    for name, values in _under("dense", Spell(60, 2.0, 3.0)).items():
        if values.ndim < 2:  # times of epochs are of no vehicle
            continue
        rows = np.moveaxis(values, 1, 0).reshape(VEHICLES, -1).astype(np.float64)
        finite, weights = np.isfinite(rows), np.linspace(1.0, 2.0, rows.shape[1])
        means = np.where(finite, rows, 0.0) @ weights / np.maximum(finite @ weights, 1.0)
        found[name] = [float(f"{mean:.6g}") for mean in means]
        if not finite.all():
            found[f"{name}, not finite"] = [float(f"{share:.6g}") for share in 1.0 - finite.mean(-1)]
    return found


def _under(sky: str, spell: Spell) -> Arrays:
    """Drives around a block under a sky."""
    kind, level = STREETS[sky], SkyLevel.named(sky)
    config = NavigatorConfig() if kind is None else level.navigator()
    road = Road.through(
        np.array([[0.0, 0.0], [0.0, 260.0], [220.0, 260.0], [220.0, 0.0]]), corner_radius_m=20.0, closed=True
    )
    mask = SkyMask.open()
    if kind is not None:
        city = build_city(road, CityConfig.uniform(SectionKind(kind)), np.random.default_rng(5))
        mask = SkyMask.build(road, city)
    return _drive(config, SkyTrack.from_config(config.sky, 60.0), mask, road, spell)


def _drive(config: NavigatorConfig, track: SkyTrack, mask: SkyMask, road: Road, spell: Spell) -> Arrays:
    seeds = list(range(100, 100 + VEHICLES))
    here = track.at(track.start_s, np.zeros(1, dtype=np.int64))
    high = np.flatnonzero(here.elevation_rad[0] > 0.5)
    faults = [
        fault_of(kind, row, _satellite(here, high, row), spell.start_s + 0.1 * row, spell.duration_s)
        for row, kind in _struck()
    ]
    navigator = Navigator(config, track, mask, seeds, faults=FaultSchedule(faults))
    drive, streams = CityDrive(road, DriveConfig(), config.dt_s), Streams([s + 1 for s in seeds])
    state = drive.start(streams, spread_m=300.0)
    navigator.place(state.position_m, state.heading_rad, 0.05, 0.01)
    rows: dict[str, list[np.ndarray]] = {}
    for _ in range(spell.epochs):
        solution = navigator.step(drive.step(state, streams))
        for f in fields(solution):
            if (value := getattr(solution, f.name)) is not None:
                rows.setdefault(f.name, []).append(np.asarray(value).copy())
    return {name: np.stack(values) for name, values in rows.items()}


def _struck() -> Iterator[tuple[int, FaultKind]]:
    """Vehicles with a fault, and its kind: three of four, and all kinds of the package in turn."""
    rows = [row for row in range(VEHICLES) if row % 4 != 3]
    kinds = [fault_kind(name) for name in sorted(BUILT_IN)]
    return zip(rows, (kinds[n % len(kinds)] for n in range(len(rows))), strict=True)


def fault_of(kind: FaultKind, vehicle: int, prn: int, start_s: float, duration_s: float) -> Fault:
    """A fault of a kind, of the middle one of the sizes that the fault campaign tries; every second one a ramp."""
    data: dict[str, Any] = {"kind": kind.name, "vehicle": vehicle, "start_s": start_s, "duration_s": duration_s}
    if kind.sizes_tried:
        data[kind.magnitudes[0].field] = kind.sizes_tried[len(kind.sizes_tried) // 2]
    if "system" in kind.needs:
        data["system"] = System.GALILEO if kind.target is FaultTarget.SYSTEM else System.GPS
    if kind.target is FaultTarget.SATELLITE:
        data["prn"] = prn
    if vehicle % 2 and "ramp" in kind.profiles:
        data |= {"profile": "ramp", "ramp_s": 0.5 * duration_s}
    return Fault.load(data)


def _satellite(here: SkyView, high: NDArray[np.intp], row: int) -> int:
    """Number of one of the high satellites of GPS."""
    gps = [s for s in high if here.system[s] == int(System.GPS)]
    return int(here.prn[gps[row % len(gps)]])


def single_cases() -> Iterator[tuple[str, Arrays]]:
    """Drives of single environments."""
    for n, (name, config, seeds, steps) in enumerate(SINGLE):
        env = gymnasium.make(f"lanebound/{name}-v0", config=config)
        yield f"single/{n}-{name}", _episodes(env, seeds, steps)
    for name, config in WRAPPED:
        yield f"wrapped/{name}", _episodes(lanebound.envs.wrap(name, config), 2, 15)


def _episodes(env: Any, seeds: int, steps: int) -> Arrays:
    rows: dict[str, list[Any]] = {}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        observation, info = env.reset(seed=seed)
        _note(rows, observation, 0.0, False, False, info, env)
        for _ in range(steps):
            observation, reward, terminated, truncated, info = env.step(_command(env.action_space, rng))
            _note(rows, observation, reward, terminated, truncated, info, env)
            if terminated or truncated:
                break
    return {name: np.asarray(values) for name, values in rows.items()}


def _note(
    rows: dict[str, list[Any]], observation: Any, reward: Any, terminated: Any, truncated: Any, info: Any, env: Any
) -> None:
    values = {"reward": reward, "terminated": terminated, "truncated": truncated}
    values |= (
        {f"observation.{k}": v for k, v in observation.items()}
        if isinstance(observation, dict)
        else {"observation": observation}
    )
    values |= {k: v for k, v in info.items() if not isinstance(v, dict) and not k.startswith("_")}
    values |= {f"rewards.{k}": v for k, v in info["rewards"].items() if not k.startswith("_")}
    if env is not None:
        ego = env.unwrapped.world.vehicle
        values["pose"] = np.array([*ego.position, ego.heading, ego.speed])
    for name, value in values.items():
        rows.setdefault(name, []).append(np.array(value))


def _command(space: Any, rng: np.random.Generator) -> Any:
    """Mild commands, so that drives last: mostly straight on."""
    if hasattr(space, "n"):
        return int(rng.integers(space.n))
    if hasattr(space, "nvec"):
        return rng.integers(space.nvec)
    return (0.15 * rng.standard_normal(space.shape)).clip(-1, 1).astype(np.float32)


def engine_cases() -> Iterator[tuple[str, Arrays]]:
    """Drives by the vector engine, episodes that end and begin anew included."""
    for n, (name, config, count, steps) in enumerate(ENGINE):
        envs = gymnasium.make_vec(f"lanebound/{name}-v0", count, config=config)
        rows: dict[str, list[Any]] = {}
        rng = np.random.default_rng(n)
        observation, info = envs.reset(seed=11)
        _note(rows, observation, np.zeros(count), np.zeros(count), np.zeros(count), info, None)
        for _ in range(steps):
            observation, reward, terminated, truncated, info = envs.step(_command(envs.action_space, rng))
            _note(rows, observation, reward, terminated, truncated, info, None)
        yield f"engine/{n}-{name}", {key: np.asarray(values) for key, values in rows.items()}
        envs.close()


def cases(groups: list[str]) -> Iterator[tuple[str, Arrays]]:
    """All cases, one after another."""
    makers = {"navigator": navigator_cases, "single": single_cases, "engine": engine_cases}
    for group in groups or makers:
        yield from makers[group]()


def compare(name: str, old: Arrays, new: Arrays) -> str:
    """What has changed in a case."""
    found = [f"{key} only in one" for key in sorted(set(old) ^ set(new))]
    for key in sorted(set(old) & set(new)):
        a, b = old[key], new[key]
        if a.shape != b.shape:
            found.append(f"{key}: shape {a.shape} -> {b.shape}")
        elif not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            x, y = a.astype(np.float64), b.astype(np.float64)
            with np.errstate(invalid="ignore"):
                gap = np.where(x == y, 0.0, np.abs(x - y)).reshape(a.shape[0], -1)
            first = int(np.flatnonzero(gap.max(1) != 0.0)[0])
            found.append(f"{key}: {np.nanmax(gap):.3g} from row {first}, {np.count_nonzero(gap)} of {gap.size}")
    return f"{name}: " + ("equal" if not found else "\n    " + "\n    ".join(found))


def main(verb: str, path: str = "", *groups: str) -> None:
    """Save or compare, or renew the digest."""
    if verb == "digest":
        DIGEST.write_text(json.dumps(digest(), indent=0).replace(",\n", ", ").replace("], ", "],\n") + "\n")
        return
    if verb == "save":
        kept = {f"{name}|{key}": value for name, arrays in cases(list(groups)) for key, value in arrays.items()}
        np.savez_compressed(path, **kept)  # type: ignore[arg-type]
        return
    with np.load(path) as kept:
        by_case: dict[str, Arrays] = {}
        for key in kept.files:
            case, _, column = key.partition("|")
            by_case.setdefault(case, {})[column] = kept[key]
    for name, arrays in cases(list(groups)):
        print(compare(name, by_case[name], arrays), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
