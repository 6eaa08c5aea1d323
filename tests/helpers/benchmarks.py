"""Results of benchmarks that nobody drove: made up from a seed, in memory or in a folder with rows of every episode."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import EpisodeStore, stored_columns
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.envs.costs import CAUSES
from lanebound.integrity.core.streams import named_generator

SUITE = {
    "title": "made up",
    "envs": ["LaneKeeping", "CarFollowing"],
    "skies": ["urban", "dense"],
    "agents": ["random", "nominal", "integrity_aware"],
    "seeds": {"count": 6},
}
SKILL = {"random": 0.0, "nominal": 0.6, "integrity_aware": 1.0}
DT_S, LIMITS_M = 0.2, (1.5, 0.625)


def made_up_suite(**changes: Any) -> SuiteConfig:
    """A small suite of three agents."""
    return SuiteConfig.build(SUITE, changes)


def made_up_outcome(task: Task, **changes: Any) -> Outcome:
    """An outcome that better agents of ``SKILL`` do better in; any attribute may be given."""
    rng = named_generator(task.seed, task.id)
    skill = SKILL.get(task.agent, 0.5)
    crashed = bool(rng.random() > 0.4 + 0.6 * skill)
    share = float(rng.uniform(0.5, 0.9))
    data: dict[str, Any] = {
        "ended": "collision" if crashed else "time up",
        "steps": 100 if crashed else 200,
        "time_s": 20.0 if crashed else 40.0,
        "allotted_s": 40.0,
        "distance_m": 240.0 if crashed else 480.0,
        "mean_speed_mps": 10.0 + 2.0 * skill + float(rng.normal(0, 0.5)),
        "throughput_mps": 6.0 if crashed else 12.0,
        "gap_m": None if task.place.env.startswith("Lane") else 15.0 - 5.0 * skill,
        "total_return": 20.0 + 20.0 * skill + float(rng.normal(0, 2.0)),
        "cost": 30.0 - 25.0 * skill + float(rng.uniform(0, 4.0)),
        "costs": {cause: float(rng.uniform(0, 2.0)) for cause in CAUSES}
        | {"cost_collision": float(crashed), "cost_off_road": 0.0},
        "cost_limit": 15.0,
        "success": not crashed,
        "collision": crashed,
        "lane_departure": bool(rng.random() > 0.3 + 0.6 * skill),
        "rms_acceleration_mps2": 1.5 - skill,
        "rms_jerk_mps3": 2.5 - skill,
        "rms_lateral_mps2": 1.0,
        "mode_shares": {"rtk": share, "doppler": 1.0 - share},
        "pl_at_median_m": 0.4,
        "pl_ct_median_m": 0.3,
        "no_level": 0.03,
        "pe_at_median_m": 0.06,
        "pe_ct_median_m": 0.05,
        "pe_at_max_m": 0.9,
        "pe_ct_max_m": 0.7,
        "availability": share,
        "alert_share": 1.0 - share,
        "alerts": int(rng.integers(0, 4)),
        "mi_steps": int(rng.integers(0, 2)),
        "hmi_steps": 0,
        "continuity": 0.98,
        "solve_ms_median": 0.2,
        "solve_ms_p99": 0.5,
    }
    return Outcome(*task.place, task.agent, task.seed, **(data | changes))


def made_up_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """Rows of an episode with an outage in the middle, its levels infinite for a while."""
    rng = named_generator(outcome.seed, outcome.id)
    plain = {"int": 0, "float": 0.0, "bool": False, "text": "", "floats": [0.0, 0.0]}
    rows = []
    for k in range(outcome.steps + 1):
        last = k == outcome.steps
        outage = 0.4 < k / (outcome.steps + 1) < 0.6
        level = math.inf if 0.5 < k / (outcome.steps + 1) < 0.53 else (1.8 if outage else 0.3) + 0.01 * rng.random()
        error = rng.normal(0.0, 0.2 if outage else 0.05, 2)
        rows.append(
            {column.name: plain[column.kind] for column in stored_columns()}
            | {
                "step": k, "time_s": DT_S * k, "action": [0.0, 0.0] if k else [],
                "mode": "doppler" if outage else "rtk",
                "true_x_m": 10.0 * DT_S * k, "true_y_m": float(np.sin(0.05 * k)), "speed_mps": 10.0, "gap_m": 12.0,
                "err_at_m": float(error[0]), "err_ct_m": float(error[1]), "pl_at_m": level, "pl_ct_m": level,
                "al_at_m": LIMITS_M[0], "al_ct_m": LIMITS_M[1], "alert": outage, "available": not outage,
                "reason": "both" if outage else "none", "cost": outcome.cost / outcome.steps if k else 0.0,
                "reward": outcome.total_return / outcome.steps if k else 0.0,
                "crashed": outcome.collision and last, "terminated": outcome.collision and last,
                "truncated": not outcome.collision and last,
            }
        )  # fmt: skip
    return rows


def made_up_results(**changes: Any) -> Results:
    """Results of a small suite in memory, without rows."""
    suite = made_up_suite(**changes)
    return Results.of(suite, [made_up_outcome(task) for task in suite.tasks()])


def made_up_folder(folder: Path, **changes: Any) -> Results:
    """The same in a folder, with rows, its last episode failed."""
    suite, store = made_up_suite(**changes), EpisodeStore(folder)
    store.claim(suite)
    tasks = list(suite.tasks())
    for task in tasks:
        outcome = made_up_outcome(task)
        if task is tasks[-1]:
            outcome = made_up_outcome(
                task, status="raised", message="ValueError: no idea", ended="stopped", success=False
            )
        store.write(made_up_rows(outcome), outcome)
    results = Results.load(folder)
    results.save(folder)
    return results
