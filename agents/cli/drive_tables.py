"""The tables that ``lanebound drive`` prints: episodes, position and levels, measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lanebound.agents.cli.output import counted

if TYPE_CHECKING:
    from lanebound.agents.benchmark.outcome import Outcome

__all__ = ["measures", "position_of", "print_report", "unused"]

WEIGHTED = "cost, weighted"
MEANT = (
    "Success: no crash, still on the road, fast enough; it does not depend on cost.\n"
    "Harm: 50 for a crash or an end off the road, and m2 of the body beyond its lane."
)
AXES = {"along": "at", "across": "ct"}


def print_report(
    who: str,
    outcomes: list[Outcome],
    position: Mapping[str, Mapping[str, float | None]],
    limit: float | None,
    services: Sequence[str],
    files: dict[str, Path | None],
    as_json: bool,
) -> None:
    """Print the tables, or JSON; ``position`` is of :func:`position_of`, ``limit`` that of the cost, ``services`` are
    those that the navigator names in addition to RTK."""
    from lanebound.agents.benchmark.outcome import GROUP_COST
    from lanebound.agents.cli.output import print_json, print_table

    written = {what: str(path) for what, path in files.items() if path is not None}
    if as_json:
        episodes = [outcome.to_dict() for outcome in outcomes]
        print_json(
            {
                "episodes": episodes,
                "all": measures(outcomes, services),
                "position": position,
                "cost_limit": limit,
                "files": written,
            }
        )
        return
    columns = ("seed", "ended by", "time [s]", "return", "cost", "success", "available", "HMI")
    print_table(f"{who}: {counted(len(outcomes), 'episode')}", columns, map(_line, outcomes))
    if position:
        figures = zip(*(found.items() for found in position.values()), strict=True)
        rows = [
            (pairs[0][0].removesuffix("_m").replace("_", " "), *(_metres(m) for _, m in pairs)) for pairs in figures
        ]
        print_table("Errors and protection levels of the ego's position [m]", ("figure", *position), rows)
    over = "" if len(outcomes) == 1 else f", means over {len(outcomes)} episodes"
    limits = {"cost": limit} | {GROUP_COST + name: own for name, own in outcomes[0].cost_limits.items()}
    found = measures(outcomes, services).items()
    lines = ((*_label(key), _value(value, limits.get(key))) for key, value in found)
    print_table(f"Measures{over}", ("measure", "unit", "value"), lines)
    typer.echo(MEANT)
    for what, path in written.items():
        typer.echo(f"{what}: {path}")


def position_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Errors, protection levels and alert limits along and across the track, over the decisions of a log [m].

    A missing level counts as infinite; None stands for an infinite quantile. Empty without a decision.
    """
    import numpy as np

    driven = [row for row in rows if row["step"] > 0]

    def column(name: str) -> Any:
        return np.array([row[name] for row in driven], dtype=np.float64)

    def quantile(levels: Any, share: float) -> float | None:
        found = float(np.quantile(np.where(np.isnan(levels), np.inf, levels), share, method="higher"))
        return found if np.isfinite(found) else None

    found: dict[str, dict[str, float | None]] = {}
    for name, axis in AXES.items() if driven else ():
        error, level = np.abs(column(f"err_{axis}_m")), column(f"pl_{axis}_m")
        found[name] = {
            "error_mean_m": float(error.mean()),
            "error_median_m": float(np.median(error)),
            **{f"error_p{share}_m": float(np.percentile(error, share)) for share in (75, 95)},
            "error_max_m": float(error.max()),
            "PL_median_m": quantile(level, 0.5),
            "PL_p95_m": quantile(level, 0.95),
            "AL_m": float(column(f"al_{axis}_m").min()),
        }
    return found


def _metres(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g}"


def unused(outcomes: Sequence[Outcome], *rest: Any) -> list[str]:
    """A line for the first service of a navigator, the last of ``rest``, if no decision had a position of it."""
    named: Sequence[str] = rest[-1]
    used = {mode for o in outcomes for mode, share in o.mode_shares.items() if share > 0.0}
    if not named or named[0] in used or "rtk" in used:  # RTK comes first where it is
        return []
    return [
        f"note: no decision had a position of {named[0]}: dead reckoning from the known start, or another service, had "
        "the lower level. A larger navigation.start_sigma_m or a longer navigation.warm_up_s lets it begin"
    ]


def measures(outcomes: Sequence[Outcome], services: Sequence[str] = ()) -> dict[str, float]:
    """Means over episodes; shares are of the steps of all episodes together, of named ``services`` in any case."""
    import numpy as np

    from lanebound.agents.benchmark.metrics import harm_of
    from lanebound.agents.benchmark.outcome import GROUP_COST
    from lanebound.envs.costs import CAUSES

    steps, first = np.array([o.steps for o in outcomes], dtype=np.float64), outcomes[0]
    weight = steps / max(float(steps.sum()), 1.0)

    def mean(name: str) -> float:
        return float(np.mean([getattr(o, name) for o in outcomes]))

    def of_steps(shares: Sequence[float | None]) -> float:
        return float(np.dot(weight, [share or 0.0 for share in shares]))

    modes = sorted({mode for o in outcomes for mode in o.mode_shares} | set(services))
    return {
        "success rate": mean("success"),
        "collision rate": mean("collision"),
        "return": mean("total_return"),
        "harm": float(np.mean([harm_of(o) for o in outcomes])),
        "cost": mean("cost"),
        **{cause: float(np.mean([o.costs[cause] for o in outcomes])) for cause in CAUSES},
        **{
            f"{GROUP_COST}{name}": float(np.mean([o.group_costs[name] for o in outcomes])) for name in first.cost_limits
        },
        **{f"share of {mode}": of_steps([o.mode_shares.get(mode, 0.0) for o in outcomes]) for mode in modes},
        "availability": of_steps([o.availability for o in outcomes]),
        "alert share": of_steps([o.alert_share for o in outcomes]),
        "MI steps": float(sum(o.mi_steps for o in outcomes)),
        "HMI steps": float(sum(o.hmi_steps for o in outcomes)),
    }


def _label(measure: str) -> tuple[str, str]:
    """A measure and its unit: the cost and its groups are weighted sums, its causes are unweighted."""
    from lanebound.agents.benchmark.outcome import GROUP_COST
    from lanebound.envs.info import INFO

    if measure == "cost":
        return WEIGHTED, ""
    if measure.startswith(GROUP_COST):
        return f"{measure}, weighted", ""
    if measure.startswith("cost_"):
        _, bracket, unit = INFO[measure].rpartition("[")
        return f"{measure}, unweighted", unit.rstrip("]") if bracket else ""
    return measure, "steps" if measure.endswith("steps") else ""


def _value(value: float, limit: float | None) -> str:
    """A value in three decimals; a cost next to its limit."""
    text = f"{round(value, 3):g}"
    return f"{text}, {_against(value, limit)}" if limit else text


def _against(cost: float, limit: float) -> str:
    """A cost in terms of its limit.

    >>> _against(196.9, 15.0), _against(18.0, 15.0), _against(3.0, 15.0)
    ('13 x the limit 15', '1.2 x the limit 15', 'within the limit 15')
    """
    if cost <= limit:
        return f"within the limit {limit:g}"
    return f"{cost / limit:{'.2g' if cost < 100.0 * limit else '.0f'}} x the limit {limit:g}"


def _line(s: Outcome) -> tuple[Any, ...]:
    ended = (s.seed, s.ended, round(s.time_s, 1), round(s.total_return, 1), round(s.cost, 1), s.success)
    return (*ended, f"{s.availability or 0.0:.1%}", s.hmi_steps)
