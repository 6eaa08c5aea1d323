"""The page of a study: arms and their harm in every place, and a file of differences, from stored trainings.

``python -m lanebound.agents.studies.learning_page docs/value_of_integrity.json out`` writes ``value_of_integrity.md``,
``value_of_integrity-differences.csv`` and the learning curves into ``out``, and prints the table of the results. With
folders of the study after that, as ``out/study=4518748`` with the commit that learnt there, it first makes the file of
their parts: checkpoints and episodes of each training by columns.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lanebound.agents.report.pages import Table, csv_of, text_of
from lanebound.agents.studies.learning import (
    PRIMARY,
    LearningStudyConfig,
    adjust,
    higher,
    kept_more_often,
    load_study,
    summarise,
    tested,
)
from lanebound.envs import make_config
from lanebound.integrity.assessment.plotting import INK, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#9A9A9A", "#000000")  # Okabe and Ito 2008
ENDS = ("collision", "off_road")
ROWS = (("return", "return"), ("cost", "cost"))


def curves_figure(trainings: Sequence[Mapping[str, Any]], arms: Sequence[str]) -> Figure:
    """A column for each place; trainings as they are kept, with their ``checkpoints``."""
    places = list(dict.fromkeys((one["env"], one["sky"]) for one in trainings))
    figure = new_figure(3.6 * len(places), 5.0)
    axes = figure.subplots(len(ROWS), len(places), squeeze=False, sharex="col")
    for column, (env, sky) in enumerate(places):
        here = [one for one in trainings if (one["env"], one["sky"]) == (env, sky)]
        for row, (key, label) in enumerate(ROWS):
            axis = axes[row, column]
            for arm, colour in zip(arms, cycle(COLOURS), strict=False):
                _draw(axis, [one["checkpoints"] for one in here if one["arm"] == arm], key, arm, colour)
            if key == "cost":
                limit = make_config(f"lanebound/{env}").cost_limit
                line = axis.axhline(limit, color=INK, linestyle="--", linewidth=1.0, label=f"limit of {limit:g}")
                axis.legend(handles=[line], loc="upper right", frameon=False, fontsize=8)
            title = f"{env.removesuffix('-v0')}, {sky}" if row == 0 else ""
            tidy(axis, title=title, ylabel=label if column == 0 else "", xlabel="thousand decisions" if row else "")
            axis.locator_params(axis="x", nbins=5)
    named = {label: line for axis in axes[0] for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named), frameon=False)
    return figure


def _draw(axis: Any, trainings: Sequence[Sequence[Mapping[str, float]]], key: str, arm: str, colour: str) -> None:
    if not trainings:
        return
    length = min(map(len, trainings))
    steps = [row["steps"] / 1000.0 for row in trainings[0][:length]]
    values = np.array([[row[key] for row in rows[:length]] for rows in trainings])
    axis.plot(steps, values.mean(0), color=colour, label=arm, linewidth=1.4)
    axis.fill_between(steps, values.min(0), values.max(0), color=colour, alpha=0.15, linewidth=0)


BY_COLUMNS = ("checkpoints", "episodes")
DIGITS = 5
PLACES_A_PICTURE = 4


def packed(folder: Path, commit: str) -> list[dict[str, Any]]:
    """The trainings of a folder of a study, by columns, with the commit of their code."""
    parts = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / "parts").glob("*.json"))]
    return [{**_rounded(part), "commit": commit} for part in parts]


def _rounded(part: Mapping[str, Any]) -> dict[str, Any]:
    columns = {key: {name: [_short(row[name]) for row in part[key]] for name in part[key][0]} for key in BY_COLUMNS}
    return {name: _short(value) for name, value in part.items()} | columns


def _short(value: Any) -> Any:
    """A number in few digits, as an integer where possible."""
    if not isinstance(value, float):
        return value
    short = float(f"{value:.{DIGITS}g}")
    return int(short) if short.is_integer() else short


def unpacked(path: Path) -> list[dict[str, Any]]:
    """The trainings of a file, with rows."""
    return [
        training
        | {key: [dict(zip(training[key], row, strict=True)) for row in zip(*training[key].values(), strict=True)]
           for key in BY_COLUMNS}
        for training in json.loads(path.read_text(encoding="utf-8"))
    ]  # fmt: skip


class Sum(NamedTuple):
    """The summary of a study: places, trainings within the limit, and the number of tests of each family."""

    places: list[dict[str, Any]]
    kept: list[dict[str, Any]]
    tests: dict[str, int]


def summed_up(study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> Sum:
    """Summarise the trainings of a study."""
    places = [
        {"env": env, "sky": sky, **summarise(here, study.against)}
        for env, sky in study.places
        if (here := [one for one in trainings if (one["env"], one["sky"]) == (env, sky)])
    ]
    kept = kept_more_often(trainings, study.against)
    return Sum(places, kept, adjust(places, kept, study.families))


def overview(study: LearningStudyConfig, places: Sequence[Mapping[str, Any]]) -> str:
    """Return at cost, each with half of its interval, and trainings within the limit of constrained arms."""

    def cell(arm: str, found: Mapping[str, Any]) -> str:
        text = f"{_half(found['means']['return'])} at {_half(found['means']['cost'])}"
        return f"{text} ({found['kept']})" if study.arms[arm].algorithm.constrained else text

    return _by_arm(study, places, cell)


def _half(estimate: Mapping[str, Any]) -> str:
    mean, high = estimate["mean"], estimate["high"]
    return f"{mean:.0f}" + ("" if high is None else f"±{high - mean:.0f}")


def markdown(name: str, study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> str:
    """The page."""
    places, kept, tests = summed_up(study, trainings)
    episodes = sum(len(one["episodes"]) for one in trainings)
    of = " and ".join(
        f"the {count} tests of the {f'family `{family}`' if family else 'first family'}"
        for family, count in tests.items()
    )
    lines = [
        f"# {study.title[:1].upper()}{study.title[1:]}",
        "",
        f"{len(trainings)} trainings (`configs/studies/{name}.yaml`), each evaluated on {study.test_seeds} held-out"
        f" episodes ({episodes} in all).",
        f"`{name}.json` has every episode, `{name}-differences.csv` the differences of arms in each place.",
        "",
        "- Values are means over trainings; intervals are 95 %, of Student's distribution.",
        "- A training keeps the limit if the mean cost of its episodes is at most `cost_limit`.",
        "- Differences are paired by seed. p is corrected by Holm's method over",
        f"  {of}; where none is given it is 1.",
        "",
        "Arms, with the commits of their trainings:",
        "",
        *_arms(study, trainings),
        "",
        "Trainings that keep the limit in all places, with p of McNemar's exact test before and after correction:",
        "",
        _kept(kept),
        "",
        "Pairs of trainings (same place and seed) in which the row has a higher return than the column, in brackets",
        "places in which its mean return is higher (not tested):",
        "",
        _higher(study, trainings),
    ]
    lines += [
        "",
        "## Harm",
        "",
        "Mean harm with half the width of its interval; in brackets the percentages of episodes with a collision and",
        "off the road:",
        "",
        _harm(study, places),
    ]
    return "\n".join(lines) + "\n"


def _arms(study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    for name, arm in study.arms.items():
        commits = sorted({one["commit"] for one in trainings if one["arm"] == name})
        yield f"- `{name}`: {arm.title} ({', '.join(commits) or 'not trained yet'})"


def _kept(rows: Sequence[Mapping[str, Any]]) -> str:
    head = ("first", "second", "pairs", "first keeps", "second keeps", "only first", "only second", "p", "after Holm")
    return text_of(head, [
        (f"`{row['arm']}`", f"`{row['other']}`",
         *(str(row[key]) for key in ("n", "first", "second", "first_alone", "second_alone")),
         f"{row['p']:.2g}", f"{row['p_holm']:.2g}")
        for row in rows if row["n"]
    ])  # fmt: skip


def _higher(study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> str:
    arms = [arm for arm in study.arms if any(one["arm"] == arm for one in trainings)]

    def cell(arm: str, other: str) -> str:
        above, pairs, places, of = higher(trainings, arm, other)
        return f"{above}/{pairs} ({places}/{of})" if pairs else ""

    rows = [(f"`{a}`", *(cell(a, b) if n > m else "" for n, b in enumerate(arms))) for m, a in enumerate(arms[:-1])]
    return text_of(("", *(f"`{arm}`" for arm in arms)), rows)


def _harm(study: LearningStudyConfig, places: Sequence[Mapping[str, Any]]) -> str:
    def cell(_: str, found: Mapping[str, Any]) -> str:
        ends = ", ".join(f"{100.0 * found['means'][key]['mean']:.1f}" for key in ENDS)
        return f"{_half(found['means']['harm'])} ({ends})"

    return _by_arm(study, places, cell)


def _by_arm(
    study: LearningStudyConfig, places: Sequence[Mapping[str, Any]], cell: Callable[[str, Mapping[str, Any]], str]
) -> str:
    """A row for each place, a column for each arm."""
    arms = [arm for arm in study.arms if any(arm in place["arms"] for place in places)]
    rows = [
        (_place(place), *(cell(arm, place["arms"][arm]) if arm in place["arms"] else "" for arm in arms))
        for place in places
    ]
    return text_of(("", *(f"`{arm}`" for arm in arms)), rows)


def differences(study: LearningStudyConfig, places: Sequence[Mapping[str, Any]]) -> Table:
    """Of each compared pair of arms, a row for each place: differences with their intervals as text."""
    rows = [
        (arm, other, _place(place), *(tested(less[key]) for key in PRIMARY))
        for arm, others in study.against.items()
        for other in others
        for place in places
        if (less := place["arms"].get(arm, {"less": {}})["less"].get(other)) and less["cost"]["n"]
    ]
    return ("arm", "less", "place", *PRIMARY), rows


def _place(place: Mapping[str, Any]) -> str:
    return f"{place['env'].removesuffix('-v0')}, {place['sky']}"


def write_page(source: Path, out: Path) -> str:
    """Write the page of a file of trainings into a folder, and its learning curves, some places a picture.

    Returns the table of return at cost.
    """
    from lanebound.integrity.assessment.plotting import save

    name, trainings = source.stem, unpacked(source)
    study = load_study(name)
    found = summed_up(study, trainings).places
    (out / f"{name}.md").write_text(markdown(name, study, trainings), encoding="utf-8")
    (out / f"{name}-differences.csv").write_text(csv_of(differences(study, found)), encoding="utf-8")
    there = {(one["env"], one["sky"]) for one in trainings}
    places = [place for place in study.places if place in there]
    for number, begin in enumerate(range(0, len(places), PLACES_A_PICTURE), start=1):
        chosen = places[begin : begin + PLACES_A_PICTURE]
        shown = [one for place in chosen for one in trainings if (one["env"], one["sky"]) == place]
        save(curves_figure(shown, list(study.arms)), out / f"{name}-curves-{number}.png")
    return overview(study, found)


def _made_of(folders: Iterable[str], target: Path) -> None:
    """Write the file of trainings from folders of the study, each with its commit."""
    pairs = [folder.rpartition("=") for folder in folders]
    trainings = [training for folder, _, commit in pairs for training in packed(Path(folder), commit)]
    trainings.sort(key=lambda one: (one["env"], one["sky"], one["arm"], one["seed"]))
    lines = ",\n".join(json.dumps(training, separators=(",", ":")) for training in trainings)
    target.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python -m lanebound.agents.studies.learning_page FILE.json DIR [FOLDER=COMMIT ...]")
    if sys.argv[3:]:
        _made_of(sys.argv[3:], Path(sys.argv[1]))
    print(write_page(Path(sys.argv[1]), Path(sys.argv[2])))
