"""``lanebound train``, ``evaluate``, ``export``, ``study``, ``curves`` and ``tune``: what is learnt and fitted."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import (
    AsJson,
    Assignments,
    Budget,
    Cores,
    EnvId,
    EnvIds,
    Fresh,
    FullTables,
    Jobs,
    Page,
    Plugins,
    changes,
    require_one_source,
)
from lanebound.agents.cli.output import (
    carry_out,
    kept_text,
    print_json,
    resumable,
    show,
    show_study,
    wait_for,
    with_bar,
)
from lanebound.agents.cli.static import known_skies
from lanebound.agents.serialization import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lanebound.agents.benchmark.suite import SuiteConfig
    from lanebound.agents.checkpointing.runner import OnProgress
    from lanebound.agents.learning.experiment import ExperimentConfig
    from lanebound.agents.learning.training import Checkpoint
    from lanebound.agents.studies.learning import Course, LearningStudyConfig


def train(
    name: Annotated[str, typer.Argument(metavar="EXPERIMENT", help="One of ours, or a YAML file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the checkpoints; the last one is resumed.")],
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            show_default="one for each core, with 32 environments at least",
            help="Processes that drive the environments.",
        ),
    ] = None,
    others: Annotated[
        str | None,
        typer.Option(
            metavar="full|surrogate",
            help="Neighbours in training: surrogate (recorded errors, fast) where possible, or full.",
        ),
    ] = None,
    assignments: Assignments = None,
    _plugins: Plugins = None,
) -> None:
    """Train a policy, or resume its training; the best within the limit of cost is stored as best.zip, with a card.

    Neighbours that broadcast are recorded ones in training, where these can be; a policy is judged with neighbours as
    the configuration says, which is with receivers by default.

    Decisions of imitation come before the experiment's steps. A resumed training has other episodes than an
    uninterrupted one.

    Example: lanebound train lane_keeping_ppo_lagrangian --out out/learnt --set steps=100000
    """
    from lanebound.agents.cli.static import refuse_keys, refuse_preset

    given = changes(assignments, others=others)
    if not _plugins:
        refuse_keys("experiment", given)
    refuse_preset("experiment", "experiments/", name)
    from lanebound.agents.learning.experiment import load_experiment
    from lanebound.agents.learning.imitation import teacher_of
    from lanebound.agents.learning.others import choose_others

    experiment, line = choose_others(load_experiment(name, given))
    if teacher_of(experiment) is None:  # which opens the environment: refusals come before the work
        experiment.open().close()
    if line:
        typer.echo(line, err=True)
    with resumable(lambda: _kept(out)):
        rows, idle = with_bar("decisions", lambda on_progress: _trained(experiment, out, jobs, on_progress))
    if idle:
        typer.echo(f"all {experiment.steps} decisions are made (now {rows[-1]['steps']}): raise steps to continue")
    typer.echo(f"{counted(len(rows), 'checkpoint')}; the best is {out / 'best.zip'}, described in {out / 'best.md'}")
    typer.echo(f"What to try next\n  lanebound evaluate {out} --out {out}-evaluation")


def _trained(
    experiment: ExperimentConfig, out: Path, jobs: int | None, on_progress: OnProgress
) -> tuple[list[dict[str, Any]], bool]:
    """The evaluations of a training, and whether all its decisions had been made before."""
    from lanebound.agents.checkpointing.runner import Counter, RunProgress
    from lanebound.agents.learning.training import train as carry_out

    lessons = experiment.imitation
    total = 0 if lessons is None else lessons.total(experiment.count)
    decisions = Counter(on_progress, RunProgress(experiment.steps))
    imitation = Counter(on_progress, RunProgress(total, stage="decisions of imitation"))
    made: list[int] = []

    def stepped(steps: int) -> None:
        made.append(steps)
        decisions(min(steps, experiment.steps))

    rows = carry_out(experiment, out, jobs, partial(_say, experiment.limits()), stepped, imitation)
    return rows, not made


def _kept(out: Path) -> str:
    if (out / "last.zip").exists():
        return f"checkpoints are kept in {out}; run the same command again to resume from the last one"
    if (out / "imitation.pt").exists():
        return f"finished rounds of imitation are kept in {out}; run the same command again to resume"
    return "before the first checkpoint, so nothing is kept"


def _say(limits: Mapping[str, float], checkpoint: Checkpoint) -> None:
    """Print a checkpoint; ``limits``: of an episode's cost and of its groups, by their names in evaluations."""
    found = checkpoint.evaluation
    columns = ("return", "cost", "success", "mean_speed", *(name for name in limits if name != "cost"))
    shown = ", ".join(f"{name} {found[name]:.3g}" for name in columns)
    over = [f"{'' if name == 'cost' else f'{name} '}{limit:g}" for name, limit in limits.items() if found[name] > limit]
    notes = ("  best" if checkpoint.best else "") + (f"  (over the limit of {', '.join(over)})" if over else "")
    typer.echo(f"{checkpoint.steps:>9} decisions: {shown}{notes}", err=True)


Source = Annotated[
    Path, typer.Argument(metavar="TRAINING", help="Folder of a training, or a checkpoint .zip of Stable-Baselines3.")
]
Where = Annotated[
    str | None,
    typer.Option("--env", metavar="ID", help="Environment, for a checkpoint that does not say where it was learnt."),
]


def evaluate(
    source: Source,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; it is resumed.")],
    env: Where = None,
    sky: Annotated[str | None, typer.Option(help="Preset of the sky; that of the training by default.")] = None,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    agents: Annotated[str, typer.Option(metavar="A,B", help="Drive these next to it.")] = "nominal,integrity_aware",
    seeds: Annotated[int, typer.Option(min=1, help="Episodes of each, on test seeds.")] = 50,
    skip: Annotated[int, typer.Option(min=0, help="First test seeds left out, as ones that were looked at.")] = 0,
    jobs: Cores = None,
    fresh: Fresh = False,
    full: FullTables = False,
    as_json: AsJson = False,
) -> None:
    """Drive a learnt policy on the test seeds, next to other agents.

    Example: lanebound evaluate out/learnt --out out/learnt-evaluation --seeds 20
    \f
    More than 12 parameters: each is an option of the command line.
    """
    from lanebound.agents.cli.benchmark import carry_out
    from lanebound.agents.learning.evaluation import evaluation_suite

    def choose() -> SuiteConfig:
        return evaluation_suite(source, agents, seeds, skip, env, _changes(sky, assignments))

    carry_out(choose, out, fresh, jobs, None, full, as_json)


def export(
    source: Source,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="FILE.onnx, by default next to the checkpoint; or FILE.npz, as 'ppo' is."),
    ] = None,
    env: Where = None,
    assignments: Assignments = None,
    _plugins: Plugins = None,
) -> None:
    """Write a learnt policy as a network alone, from flat observations to actions.

    Example: lanebound export out/learnt --out out/learnt.onnx
    """
    from lanebound.agents.learning.export import export_arrays, export_onnx
    from lanebound.integrity.core.errors import InputError

    wanted = (source.with_suffix(".onnx") if source.suffix == ".zip" else source / "best.onnx") if out is None else out
    if wanted.suffix not in (".onnx", ".npz"):
        raise InputError(f"out must end in .onnx or .npz, got {wanted}: choose one of these forms")
    write = export_arrays if wanted.suffix == ".npz" else export_onnx
    with resumable(lambda: "nothing was written"):
        path = wait_for(lambda: write(source, wanted, env, _changes(None, assignments)))
    typer.echo(f"{path}: observation -> action, {path.stat().st_size / 1e3:.0f} kB")


def _changes(sky: str | None, assignments: list[str] | None) -> dict[str, Any]:
    """Values of an experiment that the options change."""
    overrides = changes(assignments)
    if sky is not None:
        require_one_source(overrides, "sky", "--sky")
    return ({"overrides": overrides} if overrides else {}) | ({} if sky is None else {"sky": sky})


def study(
    name: Annotated[
        str, typer.Argument(metavar="STUDY", help="One of ours (cities, value_of_integrity), or a YAML file.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the trainings and results; a run is resumed.")],
    jobs: Jobs = 1,
    budget: Budget = None,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Train every arm of a study in every place with several seeds, and compare them on held-out seeds.

    Example: lanebound study value_of_integrity --out out/study --jobs 2 --budget 8
    """
    from lanebound.agents.cli.static import refuse_preset

    refuse_preset("study", "studies/", name, "learning_study")
    from lanebound.agents.studies.learning import (
        load_study,
        plan,
        run_learning_study,
        shown,
        study_folder,
        study_hours,
    )

    with resumable(lambda: f"trainings and checkpoints are kept in {out}; run the same command again to resume"):
        chosen = load_study(name, changes(assignments))
        study_folder(chosen, out).check()
        typer.echo(f"measuring the speed of {counted(len(chosen.envs), 'environment')}", err=True)
        course = plan(chosen)
        _announce(chosen, course, study_hours(chosen, course) / jobs, jobs, budget)
        found = with_bar("trainings", lambda on_progress: run_learning_study(chosen, out, jobs, budget, on_progress))
    curves = ", curves.svg" if found["trainings"]["done"] else ""
    show(found, shown(found), as_json, f"results.json{curves}: {out}")


def _announce(chosen: LearningStudyConfig, course: Course, hours: float, jobs: int, budget: float | None) -> None:
    for env, arm in course.left_out:
        typer.echo(f"left out: {arm} in {env} (its filter needs actions that steer and accelerate)", err=True)
    for hypothesis in chosen.hypotheses:
        typer.echo(f"expected: {hypothesis}", err=True)
    may = "" if budget is None else f", of which {budget:g} h may be used"
    typer.echo(
        f"{counted(len(course.trainings), 'training')}, {jobs} at a time, and their policies on "
        f"{chosen.test_seeds} held-out seeds each: about {hours:.2g} h from nothing{may}.",
        err=True,
    )


def curves(
    out: Annotated[Path, typer.Option(help="Folder of the trainings and results; a run is resumed there.")],
    env: EnvIds = None,
    minutes: Annotated[float | None, typer.Option(min=0.01, help="Of a core for learning in each id; 6.")] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE.md", help="Page whose tables and picture are written anew.")
    ] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Train under the cost limit in each id as it is shipped, and judge the checkpoints on held-out seeds.

    Policies learn with recorded neighbours and are judged with receivers, next to 'nominal' and the shipped 'ppo'.

    Example: lanebound curves --out out/curves --env LaneKeeping --minutes 1
    """
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.curves import SECTIONS, CurvesConfig, run_curves, save_curves, tables

    if page is not None:
        require_page(page, SECTIONS)
    config = CurvesConfig.load(changes(assignments, envs=env, minutes=minutes))
    with resumable(lambda: f"{kept_text(out, 'parts/*.json', 'id')}; trainings go on from their last checkpoint"):
        found = with_bar("ids", lambda on_progress: run_curves(config, out, on_progress))
        figure = save_curves(found, out if page is None else page.parent)
    show_study(found, tables(found), out, page, as_json)
    if not as_json:
        typer.echo(f"picture: {figure}")


tune = typer.Typer(cls=AdvisingGroup, help="Fit parameters of agents on training seeds.", no_args_is_help=True)


@tune.callback()
def _tune() -> None:
    """Fit parameters of agents on training seeds."""


@tune.command("cautious")
def cautious(
    name: EnvId,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the episodes; a run is resumed there.")],
    sky: Annotated[str, typer.Option(help="Preset of the sky.")] = "dense",
    seeds: Annotated[int, typer.Option(min=1, help="How many, from the first training seed on.")] = 40,
    jobs: Cores = None,
    _plugins: Plugins = None,
) -> None:
    """Constant margins to compare the integrity-aware driver with; prints JSON.

    Of a ladder of nine, the least caution that does no more harm; where none does as little, that of its throughput.

    Example: lanebound tune cautious CarFollowing --sky dense --out out/tune
    """
    from lanebound.agents.benchmark.tuning import tune_cautious

    with resumable(lambda: kept_text(out, "episodes/*/*/*/*.parquet", "episode")):
        print_json(with_bar("episodes", lambda on_progress: tune_cautious(name, sky, seeds, out, jobs, on_progress)))


@tune.command("growth")
def growth(
    names: Annotated[list[str], typer.Argument(metavar="ID...", help="Environments with decisions of one length.")],
    skies: Annotated[list[str] | None, typer.Option("--sky", help="Preset of the sky; may be repeated.")] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Episodes a sky, from the first training seed on.")] = 40,
    _plugins: Plugins = None,
) -> None:
    """How protection levels grow without RTK, for the drivers that predict them; prints JSON.

    Example: lanebound tune growth CarFollowing LaneKeeping --seeds 20
    """
    from lanebound.agents.benchmark.growth_fit import fit_growth, measure_growth

    chosen = tuple(skies or ("urban", "dense"))
    print_json(fit_growth(*with_bar("episodes", lambda on_progress: measure_growth(names, chosen, seeds, on_progress))))


@tune.command("limits")
def tune_limits(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for results.json; a run is resumed there.")],
    env: EnvIds = None,
    sky: Annotated[
        list[str] | None,
        typer.Option("--sky", help="Preset of the sky; may be repeated. Otherwise that of each id, and urban."),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=2, help="Episodes of each, of training seeds; by default 24.")
    ] = None,
    page: Page = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Limits of an episode's cost and of each group: what integrity_aware keeps in 70 % of its episodes, rounded up.

    Example: lanebound tune limits --out out/cost-limits --env LaneKeeping --seeds 12
    """
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.limits import COST_SECTIONS, CostLimitsConfig, cost_tables, tune_cost_limits

    if page is not None:
        require_page(page, COST_SECTIONS)
    config = CostLimitsConfig.load(changes(assignments, envs=env, skies=known_skies(sky), seeds=seeds))
    found = carry_out(out, "id and sky", lambda report: tune_cost_limits(config, out, jobs, report), "ids and skies")
    show_study(found, cost_tables(found), out, page, as_json)
