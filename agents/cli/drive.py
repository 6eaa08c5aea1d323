"""``lanebound drive``, ``play`` and ``replay-episode``: episodes that are shown, logged and filmed."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from traceback import extract_tb, format_list
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.options import (
    AsJson,
    Assignments,
    EnvId,
    Faults,
    Fps,
    OwnFaults,
    Plugins,
    Seed,
    Sky,
    Video,
    changes,
    film_rate,
    own_faults,
)
from lanebound.agents.cli.output import print_json, print_table, resumable, wait_for, with_bar
from lanebound.agents.drivers import AGENTS
from lanebound.agents.serialization import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lanebound.agents.benchmark.outcome import Outcome
    from lanebound.agents.checkpointing.runner import OnProgress
    from lanebound.agents.episodes import EpisodeLog
    from lanebound.agents.episodes.display import DriverDisplay
    from lanebound.envs.core import DrivingEnv

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
    fault: OwnFaults = None,
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
    from lanebound.agents.cli.static import refuse_early, refuse_film

    given = changes(assignments, sky=sky, faults=faults)
    called, _, named = agent.partition("=")  # NAME=AGENT, as in a benchmark
    agent = named or called
    if not _plugins:
        refuse_early(name, agent, sky, faults, given)
    refuse_film(video)

    finished: list[int] = []
    seeds, film = range(seed, seed + episodes), (video, film_rate(video, fps))
    options = {"faults": own} if (own := own_faults(fault)) else None
    with resumable(lambda: _kept(len(finished), out, video)), failing(agent):
        changed = _with_context(given, display)
        drove = with_bar("episodes", lambda report: _drive(name, agent, changed, seeds, film, out, finished, report,
                                                           display, options))  # fmt: skip
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
    options: dict[str, Any] | None = None,
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
        drive_all(env, driver, list(seeds), watchers, keep, options)
    if shown is not None:
        _tell(shown, out)
    if out is not None:
        driven = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
        sky = Path(env.config.sky).name
        faults = ", ".join(one["kind"] for one in options["faults"]) if options else env.config.faults.value
        _draw(env, log, out, f"{name}, {agent}: {sky} sky, faults {faults}, {driven}")
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
    from lanebound.integrity.assessment.plotting import save, stanford_figure

    if len({(row["al_at_m"], row["al_ct_m"]) for row in log.rows}) > 1:
        title += "\nAlert limits change; errors and levels are scaled to those of the start"
    figure = stanford_figure(log.to_record(env.dt_s), *log.limits_m, title=title, counted="decisions")
    save(figure, out / DIAGRAM)


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
    from lanebound.agents.cli.static import refuse_early

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

    rate = film_rate(video, fps)
    with resumable(lambda: "nothing is kept"):
        stored, now, differing = wait_for(lambda: _replayed(folder, ident, video, rate))
    film = None if video is None or not video.exists() else str(video)
    if as_json:
        print_json({"stored": stored.to_dict(), "now": now.to_dict(), "differing": differing, "video": film})
    else:
        _print_replayed(stored, now, differing, film)
    if differing:
        _explain(folder)
        raise typer.Exit(1)


def _replayed(folder: Path, ident: str, video: Path | None, fps: int) -> tuple[Outcome, Outcome, list[str]]:
    from lanebound.agents.benchmark.replay import differences, replay

    stored, now = replay(folder, ident, video, fps)
    return stored, now, differences(stored, now)


def _print_replayed(stored: Outcome, now: Outcome, differing: list[str], film: str | None) -> None:

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
