"""How time and memory of the vector engine grow: with environments, vehicles, satellites and the length of episodes.

Each table changes one quantity. Times are processor times of one core. A step is one after which no episode has ended,
so without resets, under random actions. Memory is what Python and NumPy hold after a reset of all environments and of
two of them again, with the next episodes that wait, as ``tracemalloc`` counts it. A straight line is fitted to each
column by least squares of relative deviations.
"""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.study import stored
from lanebound.envs.vector.env import VectorDrivingEnv, engines
from lanebound.integrity.core.accel import serial

PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents:studies/scale.py")
SURROGATE: dict[str, Any] = {"perception": {"others": "surrogate"}}
SENSOR: dict[str, Any] = {"perception": {"source": "sensor"}}
SYSTEMS = ("gps", "galileo", "glonass", "beidou")
SECTIONS = ("environments", "vehicles", "satellites", "horizon", "plan")
SEED = 1
MOST_S, LEAST = 1.0, 5  # time of steps, and their number at least
STEPS = 1e9  # of the planned study
CORES, SIDE_BY_SIDE = 16, 64  # of its machine; environments of each process
LENGTHS = 20, 80  # decisions of an episode: of a random driver, and of a whole one of Highway


class ScalePoint(NamedTuple):
    """A measurement.

    Attributes
    ----------
    table, value : where it stands: the quantity that is changed, and its value
    what, env, envs, config : name of the configuration, id, number of environments, and configuration
    """

    table: str
    value: float
    what: str
    env: str
    envs: int
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.table}-{self.what.replace(' ', '-')}-{self.value:g}"


def points(quick: bool = False) -> list[ScalePoint]:
    """What is measured; ``quick``: two small points of each table, in LaneKeeping alone where this is possible."""
    found = [
        ScalePoint("environments", n, "LaneKeeping", "LaneKeeping", n, {}) for n in (*(4**k for k in range(7)), 8192)
    ]
    counts = (1, 4, 16, 64, 256, 1024)
    found += [ScalePoint("environments", n, "Highway, surrogate", "Highway", n, SURROGATE) for n in counts]
    for what, config in (("sensor", SENSOR), ("receivers", {})):
        counts = (1, 2, 5, 10, 20, 50)
        found += [
            ScalePoint("vehicles", n, what, "Highway", 16, {**config, "world": {"vehicles_count": n}}) for n in counts
        ]
    for n in range(1, len(SYSTEMS) + 1):
        sky = dict.fromkeys((*SYSTEMS[n:], "qzss"), 0)
        found.append(ScalePoint("satellites", n, "LaneKeeping", "LaneKeeping", 64, {"navigator": {"sky": sky}}))
    for what, env, config in (("LaneKeeping", "LaneKeeping", {}), ("Intersection, sensor", "Intersection", SENSOR)):
        lengths = (15, 30, 60, 120, 240, 480)
        found += [ScalePoint("horizon", s, what, env, 64, {**config, "duration_s": float(s)}) for s in lengths]
    return _few(found) if quick else found


def _few(every: Sequence[ScalePoint]) -> list[ScalePoint]:
    found: list[ScalePoint] = []
    for point in every:
        if sum(one.table == point.table for one in found) < 2 and point.envs <= 64:
            found.append(point._replace(envs=min(point.envs, 4)))
    return found


def run_scale(out: Path, quick: bool = False, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Measure the points that are missing in ``out``, and write results.json; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed.
    """
    wanted = {point.name: point for point in points(quick)}
    ResultFolder(out, "scale", {"quick": quick}, code_digest(*PACKAGES)).claim()
    found = run_parts(out, list(wanted), partial(_of_name, wanted), 1, on_progress, size=lambda n: _size(wanted[n]))
    return stored({"points": [{**wanted[name]._asdict(), **measured} for name, measured in found.items()]}, out)


def _size(point: ScalePoint) -> float:
    """About the time of a point [s]."""
    others = point.config.get("world", {}).get("vehicles_count", 0) if point.what == "receivers" else 0
    return 3.0 + 0.01 * point.envs * (1.0 + others)


def _of_name(wanted: Mapping[str, ScalePoint], name: str, advance: Advance) -> dict[str, float]:
    with serial():
        return _measure(wanted[name], advance)


def _measure(point: ScalePoint, advance: Advance) -> dict[str, float]:
    """Times of one core and memory of a point: of all its environments together."""
    kind, count = engines()[f"lanebound/{point.env}-v0"], point.envs
    with closing(kind(1, point.config, "Disabled")) as first:  # compiles or loads the kernels, and fills caches
        first.reset(seed=SEED)
        first.step(_actions(first))
    tracemalloc.start()
    begun = time.process_time()
    with closing(kind(count, point.config, "Disabled")) as envs:
        open_s = time.process_time() - begun
        envs.reset(seed=SEED)
        advance(0.3)
        again = np.arange(count) < 2
        envs.reset(options={"reset_mask": again})
        envs.step(_actions(envs))
        held, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        advance(0.6)
        begun = time.process_time()
        envs.reset(seed=SEED + count)
        reset_s = time.process_time() - begun
        advance(0.8)
        step_s = statistics.median(_steps_s(envs))
        known = envs.engine.bytes_per_environment * count
    return {"open_s": open_s, "reset_s": reset_s, "step_s": step_s, "held": held, "peak": peak, "known": known}


def _steps_s(envs: VectorDrivingEnv) -> list[float]:
    """Times of steps; episodes that have ended are reset between them."""
    found: list[float] = []
    while len(found) < LEAST or sum(found) < MOST_S:
        actions, begun = _actions(envs), time.process_time()
        _, _, terminated, truncated, _ = envs.step(actions)
        found.append(time.process_time() - begun)
        if (over := terminated | truncated).any():
            envs.reset(options={"reset_mask": over})
    return found


def _actions(envs: VectorDrivingEnv) -> Any:
    """Random commands of all environments."""
    return envs.action_space.sample()


# A straight line


class Line(NamedTuple):
    """``fixed + each x``; ``worst``: the largest relative deviation of a value from it, which is at ``where``."""

    fixed: float
    each: float
    worst: float
    where: float


def fit(x: Sequence[float], y: Sequence[float]) -> Line:
    """The straight line with the least squares of relative deviations.

    >>> fit([1.0, 2.0, 4.0], [3.0, 5.0, 9.0])
    Line(fixed=1.0, each=2.0, worst=0.0, where=1.0)
    """
    at, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    rows = np.stack([1.0 / values, at / values], axis=1)
    (fixed, each), *_ = np.linalg.lstsq(rows, np.ones(at.size), rcond=None)
    off = values / (fixed + each * at) - 1.0
    worst = int(np.argmax(np.abs(off)))
    a, b = (float(f"{v:.6g}") for v in (fixed, each))
    return Line(a, b, round(float(off[worst]), 6) + 0.0, float(at[worst]))


# Tables


def tables(result: Mapping[str, Any]) -> dict[str, Table]:
    """Tables of the results by the names of :data:`SECTIONS`."""
    found = {name: _table(result, name) for name in SECTIONS[:-1]}
    return {**found, SECTIONS[-1]: plan(result)}


def _rows_of(result: Mapping[str, Any], table: str) -> dict[str, list[dict[str, Any]]]:
    """Points of a table by configuration."""
    found: dict[str, list[dict[str, Any]]] = {}
    for point in result["points"]:
        if point["table"] == table:
            found.setdefault(point["what"], []).append(point)
    return found


def _table(result: Mapping[str, Any], table: str) -> Table:
    """Lines of time and memory for each configuration, with the range of its points; of two points no line.

    Where environments are counted, the lines are of all together; else of one environment.
    """
    rows = []
    for what, found in _rows_of(result, table).items():
        x = [point["value"] for point in found]
        if len(x) > 2:
            lines = [fit(x, [_value(point, key, table == "environments") for point in found])
                     for key in ("step_s", "held")]  # fmt: skip
            step, memory = (_line(line, unit) for line, unit in zip(lines, (1e-6, 1024.0), strict=True))
            resets = [1e3 * point["reset_s"] / point["envs"] for point in found]
            rows.append((what, f"{x[0]:,.0f} to {x[-1]:,.0f}", step, f"{min(resets):.2f} to {max(resets):.2f}", memory))
    return ("", table, "step [us]", "reset [ms]", "memory [KiB]"), rows


def _line(line: Line, unit: float) -> str:
    text = f"{line.fixed / unit:,.0f} + {line.each / unit:.3g} x"
    return f"{text} ({100.0 * line.worst:+.0f} % at {line.where:,.0f})"


def measured(result: Mapping[str, Any]) -> Table:
    """All points: times and memory of one environment."""
    heads = ("table", "configuration", "value", "step_us", "reset_ms", "memory_kib")
    rows = [
        (point["table"], point["what"], f"{point['value']:.0f}", f"{1e6 * point['step_s'] / point['envs']:.0f}",
         f"{1e3 * point['reset_s'] / point['envs']:.2f}", f"{point['held'] / point['envs'] / 1024.0:.0f}")
        for point in result["points"]
    ]  # fmt: skip
    return heads, rows


def _value(point: Mapping[str, Any], key: str, whole: bool) -> float:
    return float(point[key]) if whole else float(point[key]) / float(point["envs"])


def plan(result: Mapping[str, Any]) -> Table:
    """Hours and bytes of a study of so many steps on a machine of some cores, from the lines of the environments."""
    rows = []
    for what, found in _rows_of(result, "environments").items():
        if len(found) < 3:
            continue
        x = [point["value"] for point in found]
        step, held = (fit(x, [point[key] for point in found]) for key in ("step_s", "held"))
        reset = found[-1]["reset_s"] / found[-1]["envs"]
        a_step = step.each + step.fixed / SIDE_BY_SIDE
        for length in LENGTHS:
            seconds = a_step + reset / length
            memory = CORES * (max(held.fixed, 0.0) + SIDE_BY_SIDE * held.each)
            rows.append((
                what, f"{length:,}", f"{1e6 * seconds:,.0f}", f"{STEPS * seconds / 3600.0:,.0f}",
                f"{STEPS * seconds / 3600.0 / CORES:,.1f}", f"{memory / 1e9:.2f}",
            ))  # fmt: skip
    heads = ("", "decisions of an episode", "a decision [us]", "core hours", f"hours on {CORES} cores", "memory [GB]")
    return heads, rows
