"""Drives with one fault in each episode, and the same drives without it, for the tables of docs/results/faults.md.

``python tests/helpers/one_fault.py OUT [--ids LaneKeeping,...] [--agents nominal,...] [--seeds 200]`` drives test seeds
in the engine (``--config '{...}'``: with changes), writes ``OUT/<id>-<agent>.json`` (pairs that are there are not
driven again), and prints a table by kind of fault, and rates at nominal rates of faults.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lanebound.agents.benchmark.fault_rates import FaultCell, FaultRate, fault_cells, fault_rates
from lanebound.agents.benchmark.outcome import Outcome, Place, Task
from lanebound.agents.benchmark.scoring import alert_figures, fault_figures, outcome_of_statistics
from lanebound.agents.benchmark.suite import TEST
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs.episode_totals import EPISODE_KEY

TOGETHER = 32  # episodes
COLUMNS = ("err_at_m", "err_ct_m", "al_at_m", "al_ct_m", "pl_at_m", "pl_ct_m", "alert", "available", "mi", "hmi")


def drive(env_id: str, agent: str, seeds: Sequence[int], config: Mapping[str, Any]) -> list[dict[str, Any]]:
    """An episode under each of consecutive seeds: its rows, the info of its end, and its one fault, if any."""
    env, driver = EngineVecEnv(env_id, len(seeds), config, COLUMNS, statistics=True), _driver(env_id, agent, config)
    env.seed(seeds[0])
    observations = env.reset()
    navigation = env.envs.engine.episodes.navigation
    found: list[dict[str, Any]] = [
        {"seed": seed, "faults": schedule.faults, "rows": [_row(info, 0.0)], "end": None}
        for seed, schedule, info in zip(seeds, navigation.faults.schedules, env.reset_infos, strict=True)
    ]
    state, over, step, dt_s = None, np.ones(len(seeds), dtype=np.bool_), 0, 1.0 / env.config.policy_hz
    while any(one["end"] is None for one in found):
        actions, state = driver.predict(observations, state, over, True)
        observations, _, over, infos = env.step(actions)
        step += 1
        for one, info, ended in zip(found, infos, over.tolist(), strict=True):
            if one["end"] is None:
                one["rows"].append(_row(info, step * dt_s))
                one["end"] = info if ended else None
    env.close()
    return found


def _driver(env_id: str, agent: str, config: Mapping[str, Any]) -> Any:
    return make_agent(agent, open_env(env_id, dict(config)))


def _row(info: Mapping[str, Any], time_s: float) -> dict[str, Any]:
    return {"time_s": time_s, **{name: info[name] for name in COLUMNS}}


def outcome(one: Mapping[str, Any], place: Place, agent: str) -> Outcome:
    """The outcome of an episode."""
    rows, info = one["rows"], one["end"]
    more = {**alert_figures(rows), **fault_figures(rows, info)}
    del more["alerts"]  # the statistics have their number too
    time_s = rows[-1]["time_s"]
    task = Task(place, agent, one["seed"])
    return outcome_of_statistics(info, info[EPISODE_KEY], task, time_s=time_s, allotted_s=time_s, **more)


def _begins(rows: Sequence[Mapping[str, Any]], onset_s: float) -> bool:
    """Whether an alert begins after a time."""
    return any(now["alert"] and not before["alert"] and now["time_s"] > onset_s for before, now in pairwise(rows))


def pairs_of(env_id: str, agent: str, seeds: Sequence[int], config: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Plain data of pairs of episodes: with one fault, and under the same seed without it."""
    found, name = [], env_id.removeprefix("lanebound/")
    one, none = (drive(env_id, agent, seeds, {**config, "faults": level}) for level in ("one", "none"))
    for struck, clear in zip(one, none, strict=True):
        (fault,) = struck["faults"]
        places = [Place(name, str(config.get("sky", "")), level) for level in ("one", "none")]
        with_it, without = (outcome(e, p, agent) for e, p in zip((struck, clear), places, strict=True))
        found.append(
            {
                "one": asdict(with_it),
                "none": asdict(without),
                "fault": fault.to_dict(),
                "worst_share_of_limit": max((_excess(row) for row in struck["rows"][1:]), default=0.0),
                "alert_without": _begins(clear["rows"], with_it.fault_onset_s or 0.0),
            }
        )
    return found


def _excess(row: Mapping[str, Any]) -> float:
    """The larger of both errors over its alert limit while the position is available."""
    if not row["available"]:
        return 0.0
    return max(abs(row[f"err_{axis}_m"]) / row[f"al_{axis}_m"] for axis in ("at", "ct"))


def by_kind(cells: Iterable[FaultCell], pairs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of the table."""
    lines = []
    for cell in cells:
        own = [p for p in pairs if p["one"]["fault_kind"] == cell.kind]
        n, m = len(own), cell.metrics
        reached = sum(p["one"]["fault_onset_s"] < p["one"]["time_s"] for p in own)
        mi, hmi, late = (sum(p["one"][key] > 0 for p in own) for key in ("mi_steps", "hmi_steps", "missed_alerts"))
        before = sum(p["none"]["mi_steps"] + p["none"]["hmi_steps"] > 0 for p in own)
        alert, without = sum(p["one"]["fault_alert_s"] is not None for p in own), sum(p["alert_without"] for p in own)
        delays = [p["one"]["fault_alert_s"] for p in own if p["one"]["fault_alert_s"] is not None]
        tta, cost = m["time_to_alert"], m["cost_hmi"].mean or 0.0
        texts = (
            cell.kind, f"{100 * cell.share:.2g} %", f"{reached}/{n}", f"{mi}; {before}", hmi,
            f"{alert}; {without}", f"{np.median(delays):.1f} s" if delays else "-",
            f"{tta.mean:.2g} s ({tta.n})" if tta.mean is not None else "-", late, f"{cost:.2g}",
            f"{max(p['worst_share_of_limit'] for p in own):.2f}",
        )  # fmt: skip
        lines.append("| " + " | ".join(map(str, texts)) + " |")
    return lines


def rate_line(rate: FaultRate) -> str:
    """A rate in words."""
    total = "-" if rate.total is None else f"{rate.total:.2g} ({rate.total_low:.2g} to {rate.total_high:.2g})"
    given = f"{rate.given_one:.2g} ({rate.low:.2g} to {rate.high:.2g})"
    return f"| {rate.metric} | {given} | {rate.probability:.3f} | {total} | {rate.unseen:.2g} |"


HEAD = ("kind", "share", "acted", "MI; without", "HMI", "alert after; without", "delay", "TTA", "missed", "cost_hmi",
        "error/AL in use")  # fmt: skip


def main() -> None:
    """Drive what is missing, and print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--ids", default="LaneKeeping,CarFollowing,Highway")
    parser.add_argument("--agents", default="nominal,integrity_aware")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--config", type=json.loads, default={})
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    for env_id in map(full_id, given.ids.split(",")):
        for agent in given.agents.split(","):
            path = given.out / f"{env_id.removeprefix('lanebound/')}-{agent}.json"
            pairs = json.loads(path.read_text()) if path.exists() else []
            while len(pairs) < given.seeds:
                seeds = TEST[len(pairs) : min(len(pairs) + TOGETHER, given.seeds)]
                pairs += pairs_of(env_id, agent, seeds, given.config)
                path.write_text(json.dumps(pairs))
            groups: dict[tuple[Place, str], list[Outcome]] = {}
            for level in ("one", "none"):
                outcomes = [Outcome.from_dict(pair[level]) for pair in pairs]
                groups[outcomes[0].task.place, agent] = outcomes
            print(f"\n{path.stem}, {len(pairs)} pairs\n| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
            print("\n".join(by_kind(fault_cells(groups), pairs)) + "\n")
            print("\n".join(map(rate_line, fault_rates(groups))), flush=True)


if __name__ == "__main__":
    main()
