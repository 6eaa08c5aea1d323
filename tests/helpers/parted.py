"""How often the engine and single environments part by rounding: the table of docs/environments.md, by case.

``.venv/bin/python tests/helpers/parted.py`` drives all episodes, for an hour or more on one core, and prints the table.
The slow test of tests/envs/vector/test_equality.py drives the same episodes and bounds how many part.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

sys.path.append(str(Path(__file__).parent))  # as pytest does

from side_by_side import PERFECT, Tally, drive, pair, require_equal

DENSE: dict[str, Any] = {"world": {"vehicles_count": 16, "vehicles_density": 1.8}, **PERFECT}
CROWDED: dict[str, Any] = {"world": {"vehicles_count": 24, "spread": [-80.0, 160.0]}, **PERFECT}
LAPS: dict[str, Any] = {"off_road_ends": False, "wrong_way_s": 1000.0, "duration_s": 40.0, **PERFECT,
                        "world": {"terminate_off_road": False, "other_vehicles": 5}}  # fmt: skip


class Comparison(NamedTuple):
    """Episodes of an environment that are driven twice, and how many of them may part."""

    label: str
    name: str
    config: dict[str, Any]
    episodes: int
    may_part: int

    def drive(self) -> Tally:
        """Drive them, and refuse any difference but those that rounding explains."""
        single, engine = pair(self.name, self.config)
        tally = Tally()
        for seed in range(self.episodes):
            drive(single, engine, 1000 + seed, tally)
        require_equal(tally, self.may_part)
        assert tally.episodes == self.episodes
        return tally


COMPARISONS = (
    Comparison("LaneKeeping, both", "LaneKeeping", PERFECT, 60, 0),
    Comparison("LaneKeeping, both", "LaneKeeping", {**PERFECT, "action": "meta", "world": {"lanes_count": 3}}, 40, 0),
    Comparison("CarFollowing, meta", "CarFollowing", {**PERFECT, "duration_s": 60.0, "action": "meta"}, 40, 6),
    Comparison("CarFollowing, continuous", "CarFollowing", {**PERFECT, "duration_s": 60.0}, 60, 0),
    Comparison("Highway, meta", "Highway", {**PERFECT, "duration_s": 20.0}, 20, 2),
    Comparison("Highway, meta", "Highway", {**DENSE, "duration_s": 20.0}, 91, 5),
    Comparison("Highway, continuous", "Highway", {**DENSE, "action": "continuous", "duration_s": 20.0}, 60, 0),
    Comparison("UrbanCanyon, meta", "UrbanCanyon", PERFECT, 93, 20),
    Comparison("UrbanCanyon, meta", "UrbanCanyon", CROWDED, 60, 6),
    Comparison("UrbanCanyon, continuous", "UrbanCanyon", {**CROWDED, "action": "continuous"}, 60, 2),
    Comparison("Racetrack, continuous", "Racetrack", PERFECT, 40, 0),
    Comparison("Racetrack, continuous", "Racetrack", LAPS, 20, 2),
    Comparison("Merge, both", "Merge", PERFECT, 40, 2),
    Comparison("Merge, both", "Merge", {**PERFECT, "action": "continuous"}, 20, 0),
    Comparison("Roundabout, meta", "Roundabout", PERFECT, 60, 15),
    Comparison("Roundabout, continuous", "Roundabout", {**PERFECT, "action": "continuous"}, 20, 0),
    Comparison("Intersection, meta", "Intersection", PERFECT, 60, 30),
)


def main() -> None:
    """Print a row for each label when its episodes are driven."""
    print("| id, action | episodes | with a vehicle that slow | parted |\n|---|---|---|---|")
    for label in dict.fromkeys(comparison.label for comparison in COMPARISONS):
        tallies = [comparison.drive() for comparison in COMPARISONS if comparison.label == label]
        counts = [sum(t.episodes for t in tallies), sum(t.crawls for t in tallies), sum(len(t.parted) for t in tallies)]
        print(f"| {label} | {' | '.join(map(str, counts))} |", flush=True)


if __name__ == "__main__":
    main()
