"""The page of a study: results of every arm in every place, and differences of arms, from stored trainings.

``python -m lanebound.agents.learning.study_page docs/value_of_integrity.json docs`` writes ``value_of_integrity.md``
and the learning curves into ``docs``. With folders of the study after that, as ``out/study=4518748`` with the commit
that learnt there, it first makes the file of their parts: checkpoints and episodes of each training by columns.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lanebound.agents.learning.study import LearningStudyConfig, load_study
from lanebound.agents.learning.study_figure import curves_figure
from lanebound.agents.learning.study_tables import (
    PRIMARY,
    SHOWN,
    adjust,
    higher,
    kept_oftener,
    spread,
    summarise,
    tested,
)

__all__ = ["markdown", "overview", "packed", "summed_up", "unpacked", "write_page"]

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
    kept = kept_oftener(trainings, study.against)
    return Sum(places, kept, adjust(places, kept, study.families))


def overview(study: LearningStudyConfig, places: Sequence[Mapping[str, Any]]) -> str:
    """Return at cost, each with half of its interval, and trainings within the limit of constrained arms."""
    arms = list(study.arms)
    rows = [
        (f"{_named(place['env'])}, {place['sky']}", *(_at_cost(study, place["arms"].get(arm), arm) for arm in arms))
        for place in places
    ]
    return _table(("", *(f"`{arm}`" for arm in arms)), rows)


def _at_cost(study: LearningStudyConfig, found: Mapping[str, Any] | None, arm: str) -> str:
    if found is None:
        return ""
    text = f"{_half(found['means']['return'])} at {_half(found['means']['cost'])}"
    return f"{text} ({found['kept']})" if study.arms[arm].algorithm.constrained else text


def _half(estimate: Mapping[str, Any]) -> str:
    mean, high = estimate["mean"], estimate["high"]
    return f"{mean:.0f}" + ("" if high is None else f" ± {high - mean:.0f}")


def markdown(name: str, study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> str:
    """The page."""
    places, kept, tests = summed_up(study, trainings)
    episodes = sum(len(one["episodes"]) for one in trainings)
    of = ", ".join(f"{count} of the family `{family}`" if family else str(count) for family, count in tests.items())
    lines = [
        f"# {study.title[:1].upper()}{study.title[1:]}",
        "",
        f"Made by `python -m lanebound.agents.learning.study_page docs/{name}.json docs` from {len(trainings)}",
        f"trainings of `configs/studies/{name}.yaml`, each evaluated on {study.test_seeds} held-out episodes",
        f"({episodes} in all). `docs/results.md` has the expectations and the conclusions. Means over trainings",
        "with 95 % intervals (Student's; where a share is equal in all trainings, of Clopper and Pearson over all",
        "episodes); kept: trainings whose mean cost is at most the limit. Differences are paired by seed, p is",
        f"adjusted by Holm's method, with the tests of the limit among them ({of}).",
        "",
        *_arms(study, trainings),
        "",
        "Return at cost, with half of their intervals; in brackets the trainings within the limit, of constrained",
        "arms:",
        "",
        overview(study, places),
        "",
        "Trainings within the limit in all places together, p of McNemar's exact test before and after Holm:",
        "",
        _kept(kept),
        "",
        "Higher return: pairs of trainings (the same place and seed) in which the return of the row is higher than",
        "that of the column, and places with a higher mean. Most of these comparisons were not planned beforehand,",
        "so that they have no tests:",
        "",
        _higher(study, trainings),
    ]
    for place in places:
        lines += ["", f"## {_named(place['env'])}, {place['sky']} sky", "", _means(place)]
        differences = _differences(place)
        lines += ["", differences] if differences else []
    return "\n".join(lines) + "\n"


def _arms(study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    for name, arm in study.arms.items():
        commits = sorted({one["commit"] for one in trainings if one["arm"] == name})
        yield f"- `{name}`: {arm.title} (learnt at {', '.join(commits)})" if commits else f"- `{name}`: {arm.title}"


def _kept(rows: Sequence[Mapping[str, Any]]) -> str:
    head = ("first", "second", "pairs", "first keeps it", "second", "first alone", "second alone", "p", "after Holm")
    return _table(head, [
        (f"`{row['arm']}`", f"`{row['other']}`",
         *(str(row[key]) for key in ("n", "first", "second", "first_alone", "second_alone")),
         f"{row['p']:.2g}", f"{row['p_holm']:.2g}")
        for row in rows if row["n"]
    ])  # fmt: skip


def _higher(study: LearningStudyConfig, trainings: Sequence[Mapping[str, Any]]) -> str:
    arms = [arm for arm in study.arms if any(one["arm"] == arm for one in trainings)]

    def cell(arm: str, other: str) -> str:
        above, pairs, places, of = higher(trainings, arm, other)
        return f"{above} of {pairs}, {places} of {of}" if pairs and arm != other else ""

    return _table(("", *(f"`{arm}`" for arm in arms)), [(f"`{a}`", *(cell(a, b) for b in arms)) for a in arms])


def _means(place: Mapping[str, Any]) -> str:
    rows = [
        (f"`{arm}`", f"{found['kept']} of {len(found['seeds'])}", *(spread(found["means"][key]) for key in SHOWN))
        for arm, found in place["arms"].items()
    ]
    return _table(("", "kept", *(key.replace("_", " ") for key in SHOWN)), rows)


def _differences(place: Mapping[str, Any]) -> str:
    rows = [
        (f"`{arm}` less `{other}`", *(tested(less[key]) for key in PRIMARY))
        for arm, found in place["arms"].items()
        for other, less in found["less"].items()
        if less["cost"]["n"]
    ]
    return _table(("", *PRIMARY), rows) if rows else ""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ("---",) * len(head), *rows))


def _named(env: str) -> str:
    return env.removesuffix("-v0")


def write_page(source: Path, out: Path) -> None:
    """Write the page of a file of trainings into a folder, and its learning curves, some places a picture."""
    from lanebound.integrity.assessment.plotting import save

    name, trainings = source.stem, unpacked(source)
    study = load_study(name)
    (out / f"{name}.md").write_text(markdown(name, study, trainings), encoding="utf-8")
    there = {(one["env"], one["sky"]) for one in trainings}
    places = [place for place in study.places if place in there]
    for number, begin in enumerate(range(0, len(places), PLACES_A_PICTURE), start=1):
        chosen = places[begin : begin + PLACES_A_PICTURE]
        shown = [one for place in chosen for one in trainings if (one["env"], one["sky"]) == place]
        save(curves_figure(shown, list(study.arms)), out / f"{name}-curves-{number}.png")


def _made_of(folders: Iterable[str], target: Path) -> None:
    """Write the file of trainings from folders of the study, each with its commit."""
    pairs = [folder.rpartition("=") for folder in folders]
    trainings = [training for folder, _, commit in pairs for training in packed(Path(folder), commit)]
    trainings.sort(key=lambda one: (one["env"], one["sky"], one["arm"], one["seed"]))
    lines = ",\n".join(json.dumps(training, separators=(",", ":")) for training in trainings)
    target.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python -m lanebound.agents.learning.study_page FILE.json DIR [FOLDER=COMMIT ...]")
    if sys.argv[3:]:
        _made_of(sys.argv[3:], Path(sys.argv[1]))
    write_page(Path(sys.argv[1]), Path(sys.argv[2]))
