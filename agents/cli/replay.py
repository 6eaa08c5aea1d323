"""``lanebound replay-episode``: an episode of a benchmark, driven again and filmed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lanebound.agents.cli.options import AsJson, Fps, Plugins, Video, film_rate

if TYPE_CHECKING:
    from lanebound.agents.benchmark import Outcome

__all__ = ["replay_episode"]


def replay_episode(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that 'lanebound benchmark' wrote.")],
    ident: Annotated[str, typer.Argument(metavar="ID", help="Episode as it is listed: env/sky-faults/agent/seed.")],
    video: Video = None,
    fps: Fps = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Drive an episode of a benchmark again, and check that it ends as it did. Exit code 1 when it does not.

    Example: lanebound replay-episode out/demo LaneKeeping/dense-none/nominal/10000 --video out/replay.mp4
    """
    from lanebound.agents.cli.output import print_json
    from lanebound.agents.cli.progress import resumable, wait_for

    rate = film_rate(video, fps)
    with resumable(lambda: "nothing is kept"):
        stored, now, differing = wait_for(lambda: _replayed(folder, ident, video, rate))
    film = None if video is None or not video.exists() else str(video)
    if as_json:
        print_json({"stored": stored.to_dict(), "now": now.to_dict(), "differing": differing, "video": film})
    else:
        _print(stored, now, differing, film)
    if differing:
        _explain(folder)
        raise typer.Exit(1)


def _replayed(folder: Path, ident: str, video: Path | None, fps: int) -> tuple[Outcome, Outcome, list[str]]:
    from lanebound.agents.benchmark.replay import differences, replay

    stored, now = replay(folder, ident, video, fps)
    return stored, now, differences(stored, now)


def _print(stored: Outcome, now: Outcome, differing: list[str], film: str | None) -> None:
    from lanebound.agents.cli.output import print_table

    keys = ("status", "ended", "time_s", "total_return", "cost", "success", "lane_departure", "availability")
    shown = list(dict.fromkeys([*keys, *differing]))
    before, after = stored.to_dict(), now.to_dict()
    print_table(stored.id, ("", "stored", "now"), ((key, before[key], after[key]) for key in shown))
    if stored.message:
        typer.echo(stored.message)
    typer.echo("It ended as it did, to the last bit." if not differing else f"differing: {', '.join(differing)}")
    if film:
        typer.echo(f"video: {film}")


def _explain(folder: Path) -> None:
    from lanebound.agents.benchmark.store import EpisodeStore

    same = EpisodeStore(folder).same_version()
    why = (
        "the agent may draw from a generator of its own, or depend on the time"
        if same
        else "the code or a package has changed"
    )
    typer.echo(f"error: the episode did not end as it was stored: {why}", err=True)
