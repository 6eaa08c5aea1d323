"""What episodes come to: return, costs by cause, how they ended, and how good the belief was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lanebound.envs.costs import CAUSES

__all__ = ["Summary", "ending_of", "measures", "summarise"]

Row = Mapping[str, Any]
ENDINGS = (("crashed", "collision"), ("off_road", "off road"), ("wrong_way", "wrong way"))


@dataclass(frozen=True)
class Summary:
    """One episode.

    Attributes
    ----------
    seed, steps, time_s : what was driven
    ended : how it ended
    total_return, cost : sums of reward and cost; costs : by cause, unweighted
    success, collision : bool
    availability, alert_share : shares of the steps
    mode_shares : share of the steps by key of the mode
    mi_steps, hmi_steps : number of steps
    """

    seed: int
    steps: int
    time_s: float
    ended: str
    total_return: float
    cost: float
    costs: dict[str, float]
    success: bool
    collision: bool
    availability: float
    alert_share: float
    mode_shares: dict[str, float]
    mi_steps: int
    hmi_steps: int

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def ending_of(row: Row) -> str:
    """How the episode ended whose last row this is."""
    for key, word in ENDINGS:
        if row[key]:
            return word
    if row["truncated"]:
        return "time up"
    return "arrived" if row["terminated"] else "stopped"


def summarise(rows: Sequence[Row]) -> Summary:
    """The summary of one episode from its rows, its start first."""
    last, driven = rows[-1], rows[1:] or rows

    def total(name: str) -> float:
        return float(sum(row[name] for row in rows))

    counts = Counter(row["mode"] for row in driven)
    return Summary(
        seed=last["seed"],
        steps=last["step"],
        time_s=last["time_s"],
        ended=ending_of(last),
        total_return=total("reward"),
        cost=total("cost"),
        costs={cause: total(cause) for cause in CAUSES},
        success=bool(last["is_success"]),
        collision=bool(last["crashed"]),
        availability=_share(driven, "available"),
        alert_share=_share(driven, "alert"),
        mode_shares={mode: count / len(driven) for mode, count in counts.most_common()},
        mi_steps=sum(bool(row["mi"]) for row in driven),
        hmi_steps=sum(bool(row["hmi"]) for row in driven),
    )


def measures(summaries: Sequence[Summary]) -> dict[str, float]:
    """Means over episodes; shares of steps are of all steps together."""
    steps = np.array([s.steps for s in summaries], dtype=np.float64)
    weight = steps / max(float(steps.sum()), 1.0)

    def mean(name: str) -> float:
        return float(np.mean([getattr(s, name) for s in summaries]))

    def of_steps(shares: Sequence[float]) -> float:
        return float(np.dot(weight, shares))

    modes = sorted({mode for s in summaries for mode in s.mode_shares})
    return {
        "success rate": mean("success"),
        "collision rate": mean("collision"),
        "return": mean("total_return"),
        "cost": mean("cost"),
        **{cause: float(np.mean([s.costs[cause] for s in summaries])) for cause in CAUSES},
        **{f"share of {mode}": of_steps([s.mode_shares.get(mode, 0.0) for s in summaries]) for mode in modes},
        "availability": of_steps([s.availability for s in summaries]),
        "alert share": of_steps([s.alert_share for s in summaries]),
        "MI steps": float(sum(s.mi_steps for s in summaries)),
        "HMI steps": float(sum(s.hmi_steps for s in summaries)),
    }


def _share(rows: Sequence[Row], name: str) -> float:
    return float(np.mean([bool(row[name]) for row in rows]))
