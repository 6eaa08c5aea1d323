"""``lanebound play``: drive by hand."""

from __future__ import annotations

import typer

from lanebound.agents.cli.options import Assignments, EnvId, Faults, Plugins, Seed, Sky, changes

__all__ = ["play"]

PLAY_HZ = 10  # decisions in a second, for a quick response to keys


def play(
    name: EnvId,
    sky: Sky = None,
    faults: Faults = None,
    seed: Seed = 0,
    assignments: Assignments = None,
    _plugins: Plugins = None,
) -> None:
    """Drive by hand in a window that shows belief and truth.

    Example: lanebound play UrbanCanyon --sky dense
    """
    from lanebound.agents.cli.early import refuse_early

    given = changes(assignments, sky=sky, faults=faults)
    if not _plugins:
        refuse_early(name, None, sky, faults, given)
    from lanebound.agents.benchmark.scoring import outcome_of
    from lanebound.agents.drivers.keyboard import HELP
    from lanebound.agents.episodes import EpisodeLog, open_env
    from lanebound.agents.episodes.play import play as play_all
    from lanebound.agents.episodes.play import require_display
    from lanebound.integrity.core.presets import deep_merge

    changed = deep_merge({"policy_hz": PLAY_HZ}, given)
    open_env(name, changed)
    require_display()
    log = EpisodeLog()
    typer.echo(HELP)
    begun = play_all(open_env(name, changed, "human"), seed, [log])
    for episode in range(begun):
        rows = log.episode(episode)
        if len(rows) > 1:
            o = outcome_of(rows, rows[-1]["time_s"])
            typer.echo(
                f"seed {seed + episode}: {o.ended} after {o.time_s:.1f} s, "
                f"return {o.total_return:.1f}, cost {o.cost:.1f}"
            )
