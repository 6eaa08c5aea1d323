"""What a position of metres is worth where a camera keeps the lane: services and drivers in Guidance.

Each case is a navigator and a driver, over the same training seeds: the same roads, traffic, sky and errors of the
camera. ``integrity_aware`` reads the levels; ``nominal`` takes the road that fits the position best for the true one.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.statistics import difference, estimate
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.episodes.opening import full_id, open_env
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.limits import first_episodes
from lanebound.envs import make_config
from lanebound.envs.costs import CAUSES
from lanebound.integrity.core.angles_kernel import ROUNDING_M
from lanebound.integrity.core.config import Config, Field, deep_merge

__all__ = ["SECTIONS", "GuidanceConfig", "assess_guidance", "tables"]

Array = NDArray[np.float64]
PACKAGES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.agents.drivers",
    "lanebound.agents:studies/guidance.py",
    "lanebound.agents:studies/limits.py",
)
ENV = "Guidance"
SECTIONS = ("outcome", "position")
SHOWN = ("speeding", "route", "gore", "blocking", "alert", "hmi")
"""Causes whose weighted costs the table shows."""


class GuidanceConfig(Config):
    """All inputs of the study."""

    navigators: Mapping[str, Any] = Field(
        {
            "RTK": "navigators/consumer",
            "PPP": "services/ppp",
            "DGPS": "services/dgps",
            "SPP": "services/spp",
            "SBAS L1": "services/sbas_l1",
            "SBAS DFMC": "services/sbas_dfmc",
            "IMM of S4": "navigators/imm_s4",
        },
        min_length=1,
        description="values of navigator, by the name in the tables",
    )
    drivers: tuple[str, ...] = Field(("nominal", "integrity_aware"), min_length=1, description="names of agents")
    seeds: int = Field(24, ge=2, le=1000, description="episodes of each case, of training seeds")
    overrides: Mapping[str, Any] = Field({}, description="of the environment's configuration, merged deeply")

    @property
    def cases(self) -> dict[str, tuple[str, str]]:
        """Navigator and driver of each part, by its name."""
        pairs = product(self.navigators, self.drivers)
        return {f"{navigator}-{driver}".replace(" ", "_"): (navigator, driver) for navigator, driver in pairs}

    def changes_of(self, navigator: str) -> dict[str, Any]:
        """The configuration of a case."""
        return deep_merge(self.overrides, {"navigator": self.navigators[navigator], "observation": {"form": "flat"}})


def assess_guidance(
    config: GuidanceConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the cases that are missing; returns the data of ``results.json``.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or a driver does not exist; ConfigError for a value that the environment refuses.
    """
    for navigator in config.navigators:  # refusals come before the work
        make_config(full_id(ENV), config.changes_of(navigator))
    fixed = {**config.to_dict(), "navigators": None, "drivers": None, "cases": dict.fromkeys(config.cases, True)}
    source = code_digest(*PACKAGES)
    ResultFolder(out, "guidance", config.to_dict(), source, fixed=fixed, growing=("cases",)).claim()
    found = {
        "config": config.to_dict(),
        "cases": run_parts(out, list(config.cases), partial(_of_case, config), jobs, on_progress),
    }
    write_json(out / "results.json", found)
    return found


def _of_case(config: GuidanceConfig, name: str, advance: Advance) -> dict[str, Any]:
    """Figures of each episode of a case."""
    navigator, driver = config.cases[name]
    changes, count = config.changes_of(navigator), config.seeds
    with closing(open_env(full_id(ENV), changes)) as single:
        weights, longest = single.config.cost.weights, allotted_s(single) / single.dt_s
    by_cause, steps = np.zeros((count, len(CAUSES))), np.zeros(count)
    sums = {name: np.zeros(count) for name in ("cost", "available", "wrong_road", "hmi_share", "success", "lost")}
    sums |= {"crashed": np.zeros(count)}
    levels, errors = [], []
    for step, (infos, going, over, _) in enumerate(first_episodes(ENV, changes, driver, count)):
        ends, steps = going & over, steps + going
        by_cause += np.where(going[:, None], infos["costs"], 0.0)
        for key in ("cost", "available", "wrong_road", "hmi_share"):
            sums[key] += np.where(going, infos[key], 0.0)
        for key, of in (("success", "is_success"), ("lost", "lost"), ("crashed", "crashed")):
            sums[key] += ends & infos[of]
        levels.append(infos["pl_ct_m"][going])
        errors.append(np.abs(infos["err_ct_m"][going]))
        advance(min(step / longest, 1.0))
    level, error = np.concatenate(levels), np.concatenate(errors)
    return {
        "navigator": navigator,
        "driver": driver,
        "time_s": (steps / single.config.policy_hz).tolist(),
        **{key: values.tolist() for key, values in sums.items() if key in ("cost", "success", "lost", "crashed")},
        **{key: (sums[key] / steps).tolist() for key in ("available", "wrong_road", "hmi_share")},
        "causes": {
            cause: (weights[f"cost_{cause}"] * by_cause[:, CAUSES.index(f"cost_{cause}")]).tolist() for cause in SHOWN
        },
        "level_m": _finite(np.quantile(level, [0.5, 0.95], method="inverted_cdf")),
        "error_m": np.quantile(error, [0.5, 0.95, 1.0]).tolist(),
        "beyond": int(np.count_nonzero(error > level + ROUNDING_M)),
        "decisions": int(level.size),
    }


def _finite(values: Array) -> list[float | None]:
    """Values, None for one that is missing."""
    return [float(value) if np.isfinite(value) else None for value in values]


def tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """How the drives end and what they cost, and the positions."""
    return dict(zip(SECTIONS, (_outcomes(found), _positions(found)), strict=True))


def _outcomes(found: Mapping[str, Any]) -> Table:
    rows, reference = [], found["config"]["drivers"][0]
    first = {part["navigator"]: part["cost"] for part in found["cases"].values() if part["driver"] == reference}
    for part in found["cases"].values():
        ends = f"{sum(part['success']):.0f} of {len(part['success'])}"
        causes = [f"{np.mean(part['causes'][cause]):.2g}" for cause in SHOWN]
        counts = (f"{sum(part['lost']):.0f}", f"{sum(part['crashed']):.0f}", f"{np.mean(part['time_s']):.0f}")
        saved = "-" if part["driver"] == reference else _change(part["cost"], first[part["navigator"]])
        rows.append((part["navigator"], f"`{part['driver']}`", ends, *counts, _mean(part["cost"]), saved, *causes))
    heads = ("navigator", "driver", "success", "lost", "crashed", "time [s]", "cost, 95 % interval",
             f"less that of `{reference}`", *SHOWN)  # fmt: skip
    return heads, rows


def _positions(found: Mapping[str, Any]) -> Table:
    rows = []
    for part in found["cases"].values():
        if part["driver"] != found["config"]["drivers"][0]:
            continue
        level = " / ".join("none" if value is None else f"{value:.3g}" for value in part["level_m"])
        error = " / ".join(f"{value:.2g}" for value in part["error_m"])
        shares = [f"{100.0 * np.mean(part[key]):.3g}" for key in ("available", "wrong_road", "hmi_share")]
        rows.append((part["navigator"], level, error, f"{part['beyond']} of {part['decisions']}", *shares))
    heads = ("navigator", "PL across, 50 / 95 % [m]", "error across, 50 / 95 / 100 % [m]", "error beyond PL",
             "available [%]", "wrong road [%]", "HMI [%]")  # fmt: skip
    return heads, rows


def _change(ours: list[float], theirs: list[float]) -> str:
    """A mean difference with its interval, seed by seed."""
    found = difference(np.array(ours), np.array(theirs), "lower")
    return f"{found.difference:.2g}" + ("" if found.low is None else f" ({found.low:.2g} to {found.high:.2g})")


def _mean(values: list[float]) -> str:
    """A mean with its interval over seeds."""
    found = estimate(np.array(values), bounds=(0.0, np.inf))
    return f"{found.mean:.3g}" + ("" if found.low is None else f" ({found.low:.2g} to {found.high:.2g})")
