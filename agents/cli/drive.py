"""``lanebound drive``: an agent drives; the results are shown, logged and filmed."""

from __future__ import annotations

import importlib
import math
from contextlib import ExitStack, contextmanager
from pathlib import Path
from traceback import extract_tb, format_list
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.drive_tables import position_of, print_report
from lanebound.agents.cli.options import (
    AsJson,
    Assignments,
    EnvId,
    Faults,
    Fps,
    Plugins,
    Seed,
    Sky,
    Video,
    changes,
    film_rate,
)
from lanebound.agents.cli.output import counted
from lanebound.agents.drivers import AGENTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lanebound.agents.benchmark.outcome import Outcome
    from lanebound.agents.checkpointing.runner import OnProgress
    from lanebound.agents.episodes import EpisodeLog
    from lanebound.agents.episodes.display import DriverDisplay
    from lanebound.envs.core import DrivingEnv

__all__ = ["drive"]

LOG, COLUMNS, DIAGRAM, WARNINGS = "episodes.parquet", "columns.md", "stanford.png", "warnings.csv"
AGENT_HELP = (
    f"Agent: {', '.join(AGENTS)} (see 'lanebound agents'); FILE.zip, .onnx, .npz or module:callable. NAME=AGENT names "
    "it."
)


def drive(
    name: EnvId,
    agent: Annotated[str, typer.Option(help=AGENT_HELP)] = "cruise",
    sky: Sky = None,
    faults: Faults = None,
    seed: Seed = 0,
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes.")] = 1,
    video: Video = None,
    fps: Fps = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for {LOG}, {COLUMNS} and {DIAGRAM}.")] = None,
    display: Annotated[
        bool,
        typer.Option("--display", help=f"Monitor position, speed, road; a light in the film, {WARNINGS} in DIR."),
    ] = False,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Drive with an agent, and print return, costs and the quality of its position.

    With a context monitor (--display, or navigator.context among --set) DIR has a log of its warnings.

    Example: lanebound drive LaneKeeping --sky dense --faults stress --seed 1 --video out/drive.mp4 --out out/drive
    \f
    More than 12 parameters: each is an option of the command line.
    """
    from lanebound.agents.cli.drive_tables import unused
    from lanebound.agents.cli.early import refuse_early, refuse_film

    given = changes(assignments, sky=sky, faults=faults)
    called, _, named = agent.partition("=")  # NAME=AGENT, as in a benchmark
    agent = named or called
    if not _plugins:
        refuse_early(name, agent, sky, faults, given)
    refuse_film(video)
    from lanebound.agents.cli.progress import resumable, with_bar

    finished: list[int] = []
    seeds, film = range(seed, seed + episodes), (video, film_rate(video, fps))
    with resumable(lambda: _kept(len(finished), out, video)), failing(agent):
        changed = _with_context(given, display)
        drove = with_bar("episodes", lambda report: _drive(name, agent, changed, seeds, film, out, finished, report,
                                                           display))  # fmt: skip
    files = {"log": out and out / LOG, "diagram": out and out / DIAGRAM, "video": video}
    files["warnings"] = out / WARNINGS if out and (out / WARNINGS).is_file() else None
    print_report(f"{called} in {name}", *drove, files, as_json)
    for line in unused(*drove):
        typer.echo(line, err=True)


def _with_context(changed: dict[str, Any], display: bool) -> dict[str, Any]:
    """The changes, with a context monitor for the display."""
    from lanebound.integrity.core.presets import deep_merge
    from lanebound.integrity.navigators.navigator import NavigatorConfig

    if not display:
        return changed
    navigator = NavigatorConfig.data_of(changed.get("navigator", {}))
    return {**changed, "navigator": deep_merge({"context": {}}, navigator)}


@contextmanager
def failing(agent: str) -> Iterator[None]:
    """In this context the failure of an agent prints its own frames and one line; exit code 1. Refusals pass."""
    from lanebound.agents.episodes.guard import AgentFailure
    from lanebound.integrity.core.errors import InputError

    try:
        yield
    except AgentFailure as failure:
        cause = failure.__cause__
        if isinstance(cause, InputError):
            raise cause from None
        ours = (str(Path(__file__).parents[1]), importlib.__file__, "<frozen ")  # and Python's import machinery
        frames = [f for f in extract_tb(cause.__traceback__ if cause else None) if not f.filename.startswith(ours)]
        typer.echo("".join(format_list(frames)), err=True, nl=False)
        when = "".join(f", {note}" for note in getattr(failure, "__notes__", ()))
        typer.echo(f"error: agent {agent}: {failure}{when}", err=True)
        raise typer.Exit(1) from None


def _kept(finished: int, out: Path | None, video: Path | None) -> str:
    from lanebound.agents.episodes.film import part_of

    kept = [f"{counted(finished, 'finished episode')} in {out / LOG}"] if out and finished else []
    kept += [f"the film so far in {part_of(video)}"] if video and part_of(video).exists() else []
    return f"kept: {' and '.join(kept)}" if kept else "nothing is kept"


def _drive(
    name: str,
    agent: str,
    changed: dict[str, Any],
    seeds: range,
    film: tuple[Path | None, int],
    out: Path | None,
    finished: list[int],
    on_progress: OnProgress,
    display: bool = False,
) -> tuple[list[Outcome], dict[str, dict[str, float | None]], float | None, tuple[str, ...]]:
    """Outcomes of the episodes, errors and levels of the position, the limit of the cost, and services of the ego.

    All refusals come before the first progress.
    """
    from lanebound.agents.benchmark.episode import allotted_s
    from lanebound.agents.benchmark.outcome import Place, Task
    from lanebound.agents.benchmark.scoring import outcome_of
    from lanebound.agents.checkpointing.runner import Counter, RunProgress
    from lanebound.agents.drivers import make_agent
    from lanebound.agents.episodes import EpisodeLog, open_env
    from lanebound.agents.episodes import drive as drive_all
    from lanebound.agents.episodes.display import DriverDisplay
    from lanebound.agents.episodes.film import Film
    from lanebound.agents.episodes.guard import guarded

    env = open_env(name, changed, None if film[0] is None else "rgb_array")
    driver, log = guarded(lambda env: make_agent(agent, env), env, seeds[0]), EpisodeLog()
    if out is not None:
        _claim(out)
    length_s = float(env.world.config.get("duration") or math.inf)
    watchers: list[Any] = [log, EpisodeProgress(Counter(on_progress, RunProgress(len(seeds))), length_s)]
    shown: Any = DriverDisplay(env) if env.config.observation.context else None
    watchers += [shown] if shown is not None else []

    def keep(episode: int) -> None:
        if out is not None:
            log.write(out / LOG)
        finished.append(episode)

    with ExitStack() as stack:
        stack.callback(env.close)
        if film[0] is not None:
            watchers.append(stack.enter_context(Film(shown if display else env, film[0], film[1])))
        drive_all(env, driver, list(seeds), watchers, keep)
    if shown is not None:
        _tell(shown, out)
    if out is not None:
        driven = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
        sky = Path(env.config.sky).name
        _draw(env, log, out, f"{name}, {agent}: {sky} sky, faults {env.config.faults.value}, {driven}")
    place = Place(name, env.config.sky, env.config.faults.value)
    outcomes = [
        outcome_of(log.episode(i), allotted_s(env), Task(place, agent, seed), env.config)
        for i, seed in enumerate(seeds)
    ]
    sensed = env.config.navigation.source.uses_sensors
    named = env.config.observation.navigator_services if sensed else ()
    return outcomes, position_of(log.rows), env.config.cost_limit, named


def _tell(shown: DriverDisplay, out: Path | None) -> None:
    """Write the log of the display, and say how long each light was on."""
    if out is not None:
        shown.write(out / WARNINGS)
    lit = ", ".join(f"{light} {seconds:.0f} s" for light, seconds in shown.seconds.items())
    typer.echo(f"light: {lit}; it changed {counted(shown.changes, 'time')}", err=True)


def _claim(out: Path) -> None:
    from lanebound.agents.checkpointing.folder import ResultFolder
    from lanebound.agents.episodes.columns import describe_columns

    ResultFolder(out, "drive").claim()
    (out / COLUMNS).write_text(describe_columns(), encoding="utf-8")
    (out / WARNINGS).unlink(missing_ok=True)  # of a drive before


class EpisodeProgress:
    """Reports episodes as they are driven, by the share of their time; an episode that ends early is complete.

    Parameters
    ----------
    report : called with the episodes done
    length_s : longest time of an episode [s]; infinity where it has none
    """

    def __init__(self, report: Callable[[float], None], length_s: float) -> None:
        self._report, self._length_s = report, length_s

    def note(self, moment: Any) -> None:
        """Report a step."""
        over = moment.terminated or moment.truncated
        share = 1.0 if over else min(moment.belief.time_s / self._length_s, 1.0)
        self._report(moment.episode + share)


def _draw(env: DrivingEnv, log: EpisodeLog, out: Path, title: str) -> None:
    from lanebound.integrity.assessment.plotting import save
    from lanebound.integrity.assessment.stanford import stanford_figure

    if len({(row["al_at_m"], row["al_ct_m"]) for row in log.rows}) > 1:
        title += "\nAlert limits change; errors and levels are scaled to those of the start"
    figure = stanford_figure(log.to_record(env.dt_s), *log.limits_m, title=title, counted="decisions")
    save(figure, out / DIAGRAM)
