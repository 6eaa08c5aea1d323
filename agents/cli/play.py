"""``lanebound play``: drive by hand."""

from __future__ import annotations

from typing import Annotated

import typer

from lanebound.agents.cli.drive import Assignments, Faults, Name, Sky

__all__ = ["play"]

PLAY_HZ = 10  # decisions in a second, so that keys act and pictures come at once


def play(
    name: Name,
    sky: Sky = None,
    faults: Faults = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; each next one has the next.")] = 0,
    assignments: Assignments = None,
) -> None:
    """Drive by hand in a window that shows what is believed beside what is true.

    Example: lanebound play UrbanCanyon --sky dense
    """
    from lanebound.agents.benchmark.scoring import outcome_of
    from lanebound.agents.cli.drive import overrides
    from lanebound.agents.drivers.keyboard import HELP
    from lanebound.agents.episodes import EpisodeLog, open_env
    from lanebound.agents.episodes.play import play as play_all
    from lanebound.agents.episodes.play import require_display
    from lanebound.integrity.core.presets import deep_merge

    changes = deep_merge({"policy_hz": PLAY_HZ}, overrides(sky, faults, assignments))
    open_env(name, changes)
    require_display()
    log = EpisodeLog()
    typer.echo(HELP)
    begun = play_all(open_env(name, changes, "human"), seed, [log])
    for episode in range(begun):
        rows = log.episode(episode)
        if len(rows) > 1:
            o = outcome_of(rows, rows[-1]["time_s"])
            typer.echo(
                f"seed {seed + episode}: {o.ended} after {o.time_s:.1f} s, "
                f"return {o.total_return:.1f}, cost {o.cost:.1f}"
            )
