"""Stored episodes of a benchmark: records for assessment, and the worst ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.report.charts import EpisodeTrace
from lanebound.agents.report.style import Actor
from lanebound.integrity.assessment.record import AXES, Record
from lanebound.integrity.positioning.modes import Mode

__all__ = ["badness", "pooled", "trace_of", "what_happened", "worst_of"]

BAD_ENDS = ("collision", "off road", "wrong way")
SECONDS = "time_s"
TAKEN = ("time_s", "mode", "err_at_m", "err_ct_m", "pl_at_m", "pl_ct_m", "al_at_m", "al_ct_m", "alert", "available")
Columns = dict[str, NDArray[Any]]


def trace_of(results: Results, outcome: Outcome) -> EpisodeTrace | None:
    """Belief and truth of an episode after every decision; None without stored rows."""
    columns = _columns(results, outcome)
    return None if columns is None else _traced([columns])


def pooled(results: Results, outcomes: Iterable[Outcome]) -> EpisodeTrace | None:
    """The same of many episodes, one after the other; their time counts decisions."""
    parts = [columns for outcome in outcomes if (columns := _columns(results, outcome)) is not None]
    return _traced(parts) if parts else None


def _columns(results: Results, outcome: Outcome) -> Columns | None:
    """The needed columns of the decisions with finite errors."""
    if results.folder is None:
        return None
    import pyarrow.parquet as pq

    table = pq.ParquetFile(EpisodeStore(results.folder).path(outcome.task)).read(columns=list(TAKEN))
    if table.num_rows < 2:
        return None
    found: Columns = {name: table[name].to_numpy() for name in TAKEN}
    keep = np.isfinite(found["err_at_m"]) & np.isfinite(found["err_ct_m"])
    keep[0] = False
    return {name: values[keep] for name, values in found.items()} if keep.any() else None


def _traced(parts: Sequence[Columns]) -> EpisodeTrace:
    """One record; where alert limits change, errors and levels are scaled to the first limit."""
    joined = {name: np.concatenate([part[name] for part in parts]) for name in TAKEN}
    limits = {axis: joined[f"al_{axis}_m"] for axis in AXES}
    first = {axis: float(limit[0]) for axis, limit in limits.items()}
    ratio = {axis: first[axis] / limit for axis, limit in limits.items()}
    many = len(parts) > 1
    record = Record(
        time_s=np.arange(1.0, joined[SECONDS].size + 1.0) if many else joined[SECONDS],
        mode=np.array([int(Mode.named(key)) for key in joined["mode"]]),
        error_at_m=joined["err_at_m"] * ratio["at"],
        error_ct_m=joined["err_ct_m"] * ratio["ct"],
        pl_at_m=joined["pl_at_m"] * ratio["at"],
        pl_ct_m=joined["pl_ct_m"] * ratio["ct"],
        alert=joined["alert"].astype(bool),
        available=joined["available"].astype(bool),
    )
    return EpisodeTrace(record, first["at"], first["ct"])


def what_happened(outcome: Outcome) -> str:
    """Why an episode counts as a failure; "" where it does not."""
    if outcome.failed:
        return f"{outcome.status.replace('_', ' ')}: {outcome.message}" if outcome.message else outcome.status
    if outcome.ended in BAD_ENDS:
        return outcome.ended
    return "" if outcome.success else f"no success ({outcome.ended})"


def badness(outcome: Outcome) -> tuple[int, float]:
    """Sort key of the worst episodes: bad ends first, then by cost."""
    return int(outcome.ended in BAD_ENDS), outcome.cost


def worst_of(outcomes: Iterable[Outcome], actors: Mapping[str, Actor], count: int) -> list[Outcome]:
    """The worst episode of each agent, the worst first; equal drives of several agents count once.

    Agents that failed are left out, and agents that act at random where others drove.
    """
    driven = [o for o in outcomes if not o.failed]
    serious = [o for o in driven if not actors[o.agent].chance] or driven
    worst: dict[str, Outcome] = {}
    for outcome in serious:
        if outcome.agent not in worst or badness(outcome) > badness(worst[outcome.agent]):
            worst[outcome.agent] = outcome
    different = {(o.seed, o.cost, o.total_return): o for o in reversed(worst.values())}
    return sorted(different.values(), key=badness, reverse=True)[:count]
