"""Levels of cooperative perception in the loop: how often the position of another vehicle is beyond them.

Environments of all ids with traffic are driven with little thought, and at every decision the error of each tracked
vehicle, relative to the ego, is compared with both of its levels. Left out are vehicles that break what levels assume:
that have crashed, or whose course is elsewhere than its bound and 8 m/s^2 across permit. Groups: honest senders; a
share of senders that lie; and many vans with links whose budget lets diffracted signals through, so that ranges are
late.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.env import VectorDrivingEnv, engines
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.presets import deep_merge

__all__ = ["RelativeLevelsConfig", "run_relative_levels", "shown"]

PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents.studies")
LIARS: dict[str, Any] = {"wrong_share": 0.3, "wrong_m": [2.0, 20.0]}
VANS: dict[str, Any] = {"cooperation": {"ranging": {"tall_share": 0.5, "range_m": 250.0}}}
GROUPS: dict[str, dict[str, Any]] = {"honest": {}, "lying": LIARS, "vans": VANS}
SMALL: dict[str, Any] = {"cities": {"count": 2}, "slots": 16}
FEWER: dict[str, dict[str, Any]] = {"Highway": {"world": {"vehicles_count": 14}}}
COUNTS = "tracked", "outside", "along", "across", "beyond", "excluded", "honest excluded"
SETTLED_STEPS = 2  # decisions after a start, before which ranges have just begun


class RelativeLevelsConfig(Config):
    """What is driven."""

    ids: tuple[str, ...] = Field(
        ("CarFollowing", "Highway", "Merge", "Roundabout", "Intersection", "UrbanCanyon"),
        description="ids with traffic",
    )
    sky: str = Field("urban", description="of all")
    environments: int = Field(16, ge=1, description="side by side")
    decisions: int = Field(200, ge=1, description="of each environment")
    integrity_risk: float = Field(1e-3, gt=0, lt=1, description="risk of the levels, half along and half across [-]")
    first_seed: int = Field(14000, ge=0, description="held out")


def _actions(envs: VectorDrivingEnv, rng: np.random.Generator) -> NDArray[Any]:
    """Idle meta-actions, now and then another one; or little steering and moderate accelerations."""
    space: Any = envs.single_action_space
    if hasattr(space, "n"):
        other = rng.random(envs.num_envs) < 0.1
        return np.where(other, rng.integers(0, space.n, envs.num_envs), 1)
    actions = np.zeros((envs.num_envs, *space.shape), dtype=np.float32)
    actions[:, 0] = rng.uniform(-0.4, 0.4, envs.num_envs)
    return actions


def drive_named(config: RelativeLevelsConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """Drive the environments of a part and count, along and across."""
    kind, group = name.split("-")
    perception = deep_merge(
        {"source": "cooperative", "cooperation": {"integrity_risk": config.integrity_risk}}, GROUPS[group]
    )
    given = {**SMALL, **FEWER.get(kind, {}), "sky": config.sky, "perception": perception}
    rng, count = np.random.default_rng(config.first_seed), config.environments
    found: dict[str, Any] = dict.fromkeys(COUNTS, 0)
    levels: list[NDArray[np.float64]] = []
    with closing(engines()[f"lanebound/{kind}-v0"](count, given)) as envs:
        envs.reset(seed=config.first_seed)
        assert isinstance(envs.engine, Engine)
        age, known = np.zeros(count, dtype=np.int64), set[tuple[int, int, int]]()
        episode = np.zeros(count, dtype=np.int64)
        for step in range(config.decisions):
            episodes = envs.engine.episodes
            *_, ends, cut, _ = envs.step(_actions(envs, rng))
            age, episode = np.where(ends | cut, 0, age + 1), episode + (ends | cut)
            counts, at = _counted(episodes, np.flatnonzero(age >= SETTLED_STEPS))
            for key, value in counts.items():
                found[key] += value
            levels.append(at)
            _note_excluded(episodes, episode, known, found)
            advance((step + 1) / config.decisions)
    every = np.concatenate(levels)
    return found | {"pl_at_m": _middle(every[:, 0]), "pl_ct_m": _middle(every[:, 1])}


def _middle(values: NDArray[np.float64]) -> list[float]:
    """Median and 95 % quantile; 0 without values."""
    return [float(q) for q in np.quantile(values, [0.5, 0.95])] if values.size else [0.0, 0.0]


def _note_excluded(episodes: Any, episode: Any, known: set[tuple[int, int, int]], found: dict[str, Any]) -> None:
    """Count senders that have newly been excluded, and those of them that have not been told to lie."""
    reason, lies = episodes.perception.pictures.ranging.relations["reason"], episodes.navigation.lies
    keys = episodes.perception.pictures.slots["key"]
    for e, slot in np.argwhere(reason != 0).tolist():
        name = e, int(episode[e]), int(keys[e, slot])
        if name not in known:
            known.add(name)
            found["excluded"] += 1
            found["honest excluded"] += int(lies is None or not lies[e, slot, :3].any())


def _counted(episodes: Any, rows: NDArray[np.int64]) -> tuple[dict[str, int], NDArray[np.float64]]:
    """Errors of tracked vehicles beyond their levels, and those levels (n, 2)."""
    p, cars, belief = episodes.perception.pictures, episodes.cars, episodes.ego["belief"]
    e, v = np.nonzero(cars["slot"][rows, 1:] >= 0)
    e, v = rows[e], v + 1
    slot = cars["slot"][e, v]
    track = p.tracks[e, slot]
    here = track["time_s"] == 0.0
    here &= cars["crashed"][e, v] == 0
    turn = track["heading_rad"] - cars["heading"][e, v]
    turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
    figures = p.of_tracks[0]
    most = np.arcsin(figures["course_sin"])
    most += figures["across_mps2"] * track["lag_s"] / np.maximum(np.abs(track["speed_mps"]), 1.0)
    outside = here & (np.abs(turn) > most)
    here &= ~outside
    e, v, track = e[here], v[here], track[here]
    x = track["x_m"] - belief["x_m"][e] - (cars["x"][e, v] - cars["x"][e, 0])
    y = track["y_m"] - belief["y_m"][e] - (cars["y"][e, v] - cars["y"][e, 0])
    cos, sin = np.cos(track["heading_rad"]), np.sin(track["heading_rad"])
    along = np.abs(cos * x + sin * y) > track["pl_at_m"]
    across = np.abs(cos * y - sin * x) > track["pl_ct_m"]
    counts = {"tracked": int(here.sum()), "along": int(along.sum()), "across": int(across.sum())}
    counts["outside"] = int(outside.sum())
    counts["beyond"] = int((along | across).sum())
    return counts, np.stack([track["pl_at_m"], track["pl_ct_m"]], axis=-1)


def run_relative_levels(
    config: RelativeLevelsConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing parts, and write ``results.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed.
    """
    claim(out, "relative levels study", config, PACKAGES)
    names = [f"{kind}-{group}" for kind in config.ids for group in GROUPS]
    found = parts_of(config, drive_named, names, out, jobs, on_progress)
    return stored({"risk": config.integrity_risk, "parts": {name: found[name] for name in names}}, out)


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """Counts and shares by id and group."""
    heads = ("id", "group", "positions", "left out", "along", "across", "share beyond", "95 %",
             "PL along, median; 95 %", "PL across", "excluded", "honest of these")  # fmt: skip
    rows = []
    for name, part in result["parts"].items():
        n = max(part["tracked"], 1)
        low, high = clopper_pearson(part["beyond"], n)
        rows.append((
            *name.split("-"), part["tracked"], part["outside"], part["along"], part["across"],
            f"{part['beyond'] / n:.1e}", f"{low:.1e} to {high:.1e}", "{:.2f}; {:.2f}".format(*part["pl_at_m"]),
            "{:.2f}; {:.2f}".format(*part["pl_ct_m"]), part["excluded"], part["honest excluded"],
        ))  # fmt: skip
    yield f"Positions relative to the ego beyond their levels, at a risk of {result['risk']:g}", (heads, rows)
