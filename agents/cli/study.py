"""``lanebound study``: arms with different observations and constraints, trained with several seeds and compared."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.options import AsJson, Assignments, Budget, Jobs, Plugins, changes
from lanebound.agents.cli.output import counted

if TYPE_CHECKING:
    from lanebound.agents.studies.learning import Course, LearningStudyConfig

__all__ = ["study"]


def study(
    name: Annotated[str, typer.Argument(metavar="STUDY", help="One of ours (value_of_integrity), or a YAML file.")],
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
    from lanebound.agents.cli.early import refuse_preset

    refuse_preset("study", "studies/", name, "learning_study")
    from lanebound.agents.cli.progress import resumable, with_bar
    from lanebound.agents.studies.learning import load_study, plan, run_learning_study, study_folder, study_hours

    with resumable(lambda: f"trainings and checkpoints are kept in {out}; run the same command again to resume"):
        chosen = load_study(name, changes(assignments))
        study_folder(chosen, out).check()
        typer.echo(f"measuring the speed of {counted(len(chosen.envs), 'environment')}", err=True)
        course = plan(chosen)
        _announce(chosen, course, study_hours(chosen, course) / jobs, jobs, budget)
        found = with_bar("trainings", lambda on_progress: run_learning_study(chosen, out, jobs, budget, on_progress))
        _report(found, out, as_json)


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


def _report(found: dict[str, Any], out: Path, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.studies.learning import PRIMARY, SHOWN, spread, tested

    if as_json:
        print_json(found)
        return
    for place in found["places"]:
        rows = [
            (arm, str(len(of["seeds"])), str(of["kept"]), *(spread(of["means"][key]) for key in SHOWN))
            for arm, of in place["arms"].items()
        ]
        rows += [
            (agent, "", "", *(f"{means[key]:.3g}" if key in means else "" for key in SHOWN))
            for agent, means in place["beside"].items()
        ]
        headings = ("arm", "trained", "kept limit", *(key.replace("_", " ") for key in SHOWN))
        print_table(f"{place['env']}, {place['sky']}: means over trainings, 95 %", headings, rows)
        differences = [
            (f"{arm} - {other}", *(tested(less[key]) for key in PRIMARY))
            for arm, of in place["arms"].items()
            for other, less in of["less"].items()
        ]
        if differences:
            print_table("differences, 95 %, p by Holm's method over all places", ("arms", *PRIMARY), differences)
    kept = [
        (f"{row['arm']}, {row['other']}", f"{row['first']}, {row['second']} of {row['n']}", f"{row['p_holm']:.2g}")
        for row in found["kept"]
        if row["n"]
    ]
    if kept:
        print_table("trainings within the cost limit, in all places", ("arms", "kept", "p by Holm's method"), kept)
    trainings = found["trainings"]
    if trainings["done"] < trainings["planned"]:
        typer.echo(
            f"{trainings['done']} of {trainings['planned']} trainings are done: run the same command again to resume"
        )
    typer.echo(f"results.json{', curves.svg' if trainings['done'] else ''}: {out}")
