"""The suite ``degenerate`` through the vector engine where it has the world: a table of an id in minutes.

    .venv/bin/python tests/helpers/degenerate.py LaneKeeping 32 10000      # id, episodes, first seed
    .venv/bin/python tests/helpers/degenerate.py LaneKeepingPriced 12 1000

The agents, their figures and the changes of the environment are those of the suite; the seeds are consecutive. Priced
ids are driven without those changes. There no bad policy may be within the cost limit more than half as often as the
sound one.
"""

from __future__ import annotations

import sys
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from drives import drives, single_of

from lanebound.agents.benchmark.suite import load_suite
from lanebound.integrity.core.errors import InputError

SOUND = "integrity_aware"


class Score(NamedTuple):
    """Means over the episodes of an agent: of ``within`` those at a cost of at most the limit, of ``kept`` those of
    them that are a success."""

    success: float
    kept: float
    mean_speed: float
    cost: float
    total_return: float
    crashed: float
    off_road: float
    within: float = 0.0

    def matched_by(self, other: Score) -> list[str]:
        """Whether another agent is within the limit half as often, a success or not, as a sound driver."""
        return ["half as often within the limit"] if other.within > 0.5 * self.within else []

    def outdone_by(self, other: Score) -> list[str]:
        """What another agent does too well, beside a sound driver with this score."""
        out = []
        if other.total_return > self.total_return and other.cost <= self.cost:
            out.append("more return at equal or lower cost")
        if other.kept > 0.0 and other.kept >= 0.5 * self.kept:
            out.append("half of the successes within the limit")
        return out


def is_priced(name: str) -> bool:
    """Whether an id has a price of stopping."""
    return name.endswith("Priced") or name in ("WorkZone", "Guidance", "Platoon")


def scores(name: str, episodes: int, seed: int, only: Collection[str] = ()) -> dict[str, Score]:
    """The score of each agent of the suite that can drive an id, or of some of them alone."""
    suite = load_suite("degenerate")
    config = {} if is_priced(name) else {"sky": suite.skies[0], **suite.overrides}
    limit = single_of(name, config).config.cost_limit
    found = {}
    for label, chosen in suite.agents.items():
        if only and label not in only:
            continue
        try:
            found[label] = _score(drives(name, config, chosen.agent, chosen.figures, episodes, seed), episodes, limit)
        except InputError:
            continue  # no such command in this id
    return found


def _score(decisions: Any, episodes: int, limit: float) -> Score:
    rows, ends = np.zeros((episodes, 4)), np.zeros((episodes, 3))
    for one in decisions:
        both = np.stack([one.infos["cost"], one.rewards, one.infos["speed_mps"], np.ones(one.episode.size)], -1)
        rows[one.episode] += both
        last = one.over
        names = ("is_success", "crashed", "off_road")
        ends[one.episode[last]] = np.stack([one.infos[name][last] for name in names], -1)
    kept = ends[:, 0] * (rows[:, 0] <= limit)
    speed = rows[:, 2] / rows[:, 3]
    means = (ends[:, 0], kept, speed, rows[:, 0], rows[:, 1], ends[:, 1], ends[:, 2], rows[:, 0] <= limit)
    return Score(*(float(values.mean()) for values in means))


def lines(name: str, found: dict[str, Score]) -> list[str]:
    """Rows of a table in Markdown; what outdoes the sound driver is named in the last column."""
    sound = found[SOUND]
    if is_priced(name):
        return [
            f"| {name} | `{label}` | {s.within:.2f} | {s.cost:.1f} | {s.success:.2f} | {s.mean_speed:.1f} "
            f"| {s.crashed:.2f}, {s.off_road:.2f} | {'' if label == SOUND else ', '.join(sound.matched_by(s))} |"
            for label, s in found.items()
        ]
    return [
        f"| {name} | `{label}` | {s.success:.2f} | {s.kept:.2f} | {s.mean_speed:.1f} | {s.cost:.1f} "
        f"| {s.total_return:.1f} | {s.crashed:.2f}, {s.off_road:.2f} "
        f"| {'' if label == SOUND else ', '.join(sound.outdone_by(s))} |"
        for label, s in found.items()
    ]


if __name__ == "__main__":
    print("\n".join(lines(sys.argv[1], scores(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))))
