"""Recorded episodes of a configuration: what the other vehicles broadcast when each navigates by itself.

They are recorded once, by the vector engine, in the traffic of the configuration without its ego, and stored next to
the compiled kernels. With ``perception.others: surrogate`` the broadcasts of other vehicles have their errors. The
recorded vehicles of an episode share atmosphere, reference station and outages, and so do these, not with the ego.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import re
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from gymnasium.utils import seeding
from highway_env.envs.common.abstract import AbstractEnv

import lanebound.envs
import lanebound.integrity
from lanebound.envs.batch.perception_kernel import COURSE_FROM_MPS
from lanebound.envs.batch.surrogate_kernel import SAID, TRAITS, Recordings
from lanebound.envs.config import EnvConfig
from lanebound.envs.worlds import world_kind
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.kernel_cache import cache_root
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import named_generator

__all__ = ["AWAY_M", "EPISODES", "SEED", "city_of", "epochs_of", "recordings_of", "require_recordable"]

LOGGER = logging.getLogger("lanebound")
EPISODES = 64  # recorded, in cities and at hours drawn as in any episode
SEED = 2**31  # of the first recorded episode, beyond the seeds that users give
AWAY_M = 20_000.0  # the ego stands there, beyond the end of a road
ON_DISK = 40
NOT_HEARD = (
    "observation", "reward", "cost", "cost_limit", "cost_limits", "rendering", "faults", "success_share",
    "success_behind_s", "actuators", "keep_lane", "off_road_ends", "wrong_way_s",
)  # fmt: skip
OF_EGO = ("source", "offset_at_m", "offset_ct_m", "jump_m", "smoothing_s")  # of ``navigation``


def recordings_of(config: EnvConfig) -> Recordings:
    """The recordings of a configuration, from memory, from disk or made now.

    Raises
    ------
    ConfigError
        The vector engine does not drive the world of this configuration, so nothing can be recorded.
    """
    heard = {name: value for name, value in config.to_dict().items() if name not in NOT_HEARD}
    heard["navigation"] = {name: value for name, value in heard["navigation"].items() if name not in OF_EGO}
    heard["perception"] = {"source": "v2v", "others": "full"}
    return _recordings(EnvConfig.load(heard).to_json(), config.level.to_json())


@lru_cache(maxsize=4)
def _recordings(text: str, level: str) -> Recordings:
    config = EnvConfig.from_json(text)
    place, recorded = cache_root() if _is_ours(config, text) else None, config.level.recording
    sky = b"" if recorded is None else Path(recorded).read_bytes()
    inputs = repr((_sources(), np.__version__, version("highway-env"), EPISODES, text, level)).encode()
    key = hashlib.blake2b(inputs + sky, digest_size=16).hexdigest()
    file = None if place is None else place / "recordings" / f"{key}.npz"
    found = None if file is None else _load(file)
    if found is None:
        LOGGER.warning("lanebound: recording other vehicles, once for this configuration. This takes a minute or more.")
        found = record(config, range(SEED, SEED + EPISODES))
        if file is not None:
            _save(file, found)
    return found


def _is_ours(config: EnvConfig, text: str) -> bool:
    """Whether the code of all parts is that of this package; recordings of others are not stored."""
    kind = world_kind(config.base)
    world = "" if kind is None or kind.world is None else kind.world.__module__
    return world.partition(".")[0] in ("", "lanebound", "highway_env") and re.search(r'"[\w.]+:\w+"', text) is None


@cache
def _sources() -> str:
    """Digest of the code that recordings come from."""
    h = hashlib.blake2b(digest_size=8)
    for package in (lanebound.integrity, lanebound.envs):
        for source in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
            h.update(source.read_bytes())
    return h.hexdigest()


# To record


def record(config: EnvConfig, seeds: Sequence[int]) -> Recordings:
    """Record episodes with these seeds in the traffic of a configuration in which the others navigate."""
    from lanebound.envs.core import DrivingEnv
    from lanebound.envs.scene import alert_limits_m, navigator_config
    from lanebound.envs.vector.recorder import Recorder

    single = DrivingEnv(config)
    recorder = Recorder(single, len(seeds), AWAY_M)
    notes = recorder.record(list(seeds), epochs_of(config, single.world))
    settings = navigator_config(config, alert_limits_m(single.world, config))
    return _recordings_in(notes, settings.odometer.dropout_mps)


def require_recordable(config: EnvConfig) -> None:
    """Refuse surrogates where the vector engine does not drive the world, so that nothing can be recorded.

    Raises
    ------
    ConfigError
        They are asked for and cannot be made.
    """
    kind, radio = world_kind(config.base), config.perception
    if radio.has_radio and not radio.others_navigate and (kind is None or kind.support is None):
        raise ConfigError(
            f"perception.others must be 'full' with base {config.base!r}, which the vector engine does not drive, got "
            "'surrogate': set it to full"
        )


def city_of(seed: int, cities: int) -> int:
    """Which of so many cities the episode of a seed takes place in."""
    from lanebound.envs.core import EPISODE_SEEDS

    episode = int(seeding.np_random(seed)[0].integers(EPISODE_SEEDS))
    return int(named_generator(episode, "scene").integers(cities))


def epochs_of(config: EnvConfig, world: AbstractEnv) -> int:
    """Navigation epochs of an episode."""
    from lanebound.envs.scene import duration_s

    return math.ceil(duration_s(config, world) * config.navigation.rate_hz)


def _recordings_in(notes: Records, still_mps: float) -> Recordings:
    """The vehicles in notes (E, K, C) NOTE of E episodes; those at the start come first, the others as they enter."""
    traits = _take_traits(notes, still_mps)
    recorded = [_vehicles_in(of_episode) for of_episode in notes]
    some = [vehicles for vehicles in recorded if vehicles] or [[(0, np.zeros(1, SAID))]]
    episodes = [vehicles or some[e % len(some)] for e, vehicles in enumerate(recorded)]  # where nobody was, another
    most = max(len(vehicles) for vehicles in episodes)
    said = np.zeros((len(episodes), most, notes.shape[1]), SAID)
    lengths = np.ones(said.shape[:2], dtype=np.int64)
    began, count = np.ones((2, len(said)), dtype=np.int64)
    for e, vehicles in enumerate(episodes):
        count[e], began[e] = len(vehicles), sum(first == 0 for first, _ in vehicles)
        for i, (_, rows) in enumerate(vehicles):
            said[e, i, : rows.size], lengths[e, i] = rows, rows.size
    return Recordings(said, lengths, began, count, traits)


def _take_traits(notes: Records, still_mps: float) -> Records:
    """Take what errors have in common with braking and yaw rate out of notes, by least squares.  -> (1,) TRAITS"""
    said, move = notes["said"], notes["move"]
    there, speed = move["key"] > 0, np.abs(move["speed_mps"])
    slopes = []
    for error, cause, some in (
        (said["speed_mps"], move["braking_mps2"], there & (speed >= still_mps)),
        (said["turn_rad"], move["yaw_radps"], there & (move["speed_mps"] > COURSE_FROM_MPS)),
    ):
        x, y = cause[some], error[some].astype(np.float64)
        power, slope = float(x @ x), 0.0
        if power > 0.0:
            slope = float(x @ y) / power
            rest = y - slope * x
            slope += float(x @ np.clip(rest, *np.quantile(rest, (0.01, 0.99)))) / power  # outages do not decide
        slopes.append(slope)
        error[some] -= (slope * x).astype(np.float32)
    return one_record(TRAITS, still_mps=still_mps, speed_s=slopes[0], course_s=slopes[1])


def _vehicles_in(notes: Records) -> list[tuple[int, Records]]:
    """First epoch and SAID of each vehicle in notes (K, C), in the order of their names."""
    key, found = notes["move"]["key"], {}
    for slot in range(key.shape[1]):
        for name in np.unique(key[:, slot][key[:, slot] > 0]).tolist():
            rows = np.flatnonzero(key[:, slot] == name)
            found[name] = int(rows[0]), notes["said"][rows, slot]
    return [found[name] for name in sorted(found)]


# On disk


def _load(file: Path) -> Recordings | None:
    try:
        with np.load(file, allow_pickle=False) as data:
            return Recordings(*(data[name] for name in Recordings._fields))
    except (OSError, EOFError, KeyError, ValueError, BadZipFile):
        return None


def _save(file: Path, recordings: Recordings) -> None:
    """Write recordings to disk atomically; only the newest 40 files are kept."""
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, **recordings._asdict())
            os.replace(name, file)
        except OSError:
            Path(name).unlink(missing_ok=True)
            return
        for old in sorted(file.parent.glob("*.npz"), key=lambda one: one.stat().st_mtime)[:-ON_DISK]:
            old.unlink(missing_ok=True)
