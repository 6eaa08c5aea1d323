"""Scores of map matching on roads that exist: S5's monitor next to the methods of its Table 5 (Quddus, Velaga, ...).

The drives are those of :mod:`.matched_drives`. A threshold is fitted on the drives of all other maps, by one of three
rules, and judged on the drives of a map: ``crossing`` (S5's: false alarms and missed detections are equally many),
``best`` (the largest OCDR), ``equal`` (the same share of right points is warned of by all methods). It is fitted on the
points that reach the score: those that earlier phases warn of have a warning with any threshold. ``published`` takes
the thresholds of S5's Table 6, ``never`` 0: the score warns of nothing. Intervals are by drive at a fixed threshold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.matched_drives import (
    ALONE,
    BEFORE,
    PUBLISHED,
    SCORES,
    THRESHOLDS,
    MapMatchingConfig,
    work_drive,
)
from lanebound.agents.studies.route_drives import PACKAGES
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.integrity.assessment.plotting import INK, legend, new_figure, save, tidy
from lanebound.integrity.assessment.warning_rates import WarningSweep
from lanebound.integrity.core.streams import named_generator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

S5_TABLE_5 = {  # OCDR, but of Yu the missed detection rate alone; S5 Table 5
    "context": "98.6 %", "quddus": "91.1 %", "velaga": "98.2 %", "jabbour": "88.8 %", "yu": "MDR 1.41 %",
}  # fmt: skip
S5_TABLE_6 = {"context": 71.0, "quddus": 70.0, "velaga": 82.0}  # thresholds; S5 Table 6 has no others
GROUPS: dict[str, Callable[[Mapping[str, Any]], bool]] = {"all": lambda _: True, "with faults": lambda d: d["faulty"]}
RESAMPLES, CONFIDENCE = 2000, 0.95
COLOURS = dict(zip(SCORES, ("#000000", "#0072B2", "#009E73", "#D55E00", "#CC79A7", "#999999"), strict=True))


def run_map_matching(
    config: MapMatchingConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing drives; writes ``results.json`` and a figure, returns the results.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or a map has no streets that lead back to themselves.
    """
    claim(out, "map matching", config, PACKAGES)
    names = [
        f"{m}-{s}-{k}" for m in range(len(config.maps)) for s in range(len(config.skies)) for k in range(config.drives)
    ]
    parts = parts_of(config, work_drive, names, out, jobs, on_progress)
    result = {"config": config.to_dict(), **summary(config, list(parts.values()))}
    save(roc_figure(result), out / "roc.svg")
    return stored(result, out)


def summary(config: MapMatchingConfig, drives: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rates of every map, group of drives, score, chain and rule; thresholds are those of the other maps."""
    rows, curves = [], []
    for name in config.maps:
        others = [d for d in drives if d["map"] != name]
        own = [d for d in drives if d["map"] == name]
        groups = {sky: [d for d in own if d["sky"] == sky] for sky in config.skies}
        groups |= {group: [d for d in own if of(d)] for group, of in GROUPS.items()}
        for score in SCORES:
            for chain in (ALONE, PUBLISHED):
                reached = reaching(_total(others, score, chain), sum(d["wrong"] for d in others))
                thresholds = fitted(reached, score, config.equal_far)
                key = {"map": name, "score": score, "chain": chain}
                curves.append(key | _curve(own, score, chain, config.equal_far))
                rows += [
                    key | {"group": group, "rule": rule, "threshold": threshold}
                    | rates(some, score, chain, int(np.searchsorted(THRESHOLDS, threshold)))
                    for group, some in groups.items() if some
                    for rule, threshold in thresholds.items()
                ]  # fmt: skip
    counts = [
        {"map": name, "sky": sky} | {
            key: sum(d[key] for d in drives if (d["map"], d["sky"]) == (name, sky))
            for key in ("points", "wrong", "wrong_link", "beyond", "faulty")
        }
        for name in config.maps for sky in config.skies
    ]  # fmt: skip
    return {"drives": counts, "rates": rows, "curves": curves}


def _total(drives: Sequence[Mapping[str, Any]], score: str, chain: str) -> WarningSweep:
    false_alarms, missed = np.sum([d["sweeps"][score][chain] for d in drives], 0)
    return WarningSweep(THRESHOLDS, false_alarms, missed, sum(d["points"] for d in drives))


def reaching(sweep: WarningSweep, wrong: int) -> WarningSweep:
    """The same of the points that reach the score; of all points, ``wrong`` of them, others have a warning at 0 too."""
    early = int(sweep.false_alarms[0])
    points = sweep.points - early - (wrong - int(sweep.missed[0]))
    return replace(sweep, false_alarms=sweep.false_alarms - early, points=points)


def fitted(sweep: WarningSweep, score: str, equal_far: float) -> dict[str, float]:
    """Threshold of each rule for a score, by a sweep of the points that reach it; only some have a published one.

    ``equal`` is the largest threshold by which at most ``equal_far`` of the right points are warned of, the least one
    where even that warns of more.
    """
    crossing, right = sweep.crossing(), max(sweep.points - int(sweep.missed[0]), 1)
    few = np.flatnonzero(sweep.false_alarms <= equal_far * right)
    out = {
        "crossing": float(THRESHOLDS[-1]) if crossing is None else crossing,
        "best": sweep.best()[0],
        "equal": float(THRESHOLDS[few[-1] if few.size else 0]),
        "never": 0.0,
    }
    return out | ({"published": S5_TABLE_6[score]} if score in S5_TABLE_6 else {})


def rates(drives: Sequence[Mapping[str, Any]], score: str, chain: str, at: int) -> dict[str, list[float | None]]:
    """OCDR, FAR and MDR over all points (S5 equations 15 to 17), and shares of right and of wrong points, by drive.

    Each is a value and its interval; None where no drive has such points.
    """
    rows = np.array(
        [[d["points"], d["wrong"], *np.array(d["sweeps"][score][chain])[:, at]] for d in drives], np.float64
    )  # fmt: skip
    drawn = named_generator(0, "resamples").integers(len(rows), size=(RESAMPLES, len(rows)))
    sums = np.concatenate([rows.sum(0)[None], rows[drawn].sum(1)])
    points, wrong, false_alarms, missed = sums.T
    return {
        "ocdr": _interval(points - false_alarms - missed, points), "far": _interval(false_alarms, points),
        "mdr": _interval(missed, points), "per_right": _interval(false_alarms, points - wrong),
        "per_wrong": _interval(missed, wrong),
    }  # fmt: skip


def _interval(events: Array, of: Array) -> list[float | None]:
    """The first ratio, and the interval of the others that have points."""
    if not of[0] > 0.0:
        return [None, None, None]
    tail, some = 0.5 * (1.0 - CONFIDENCE), of > 0.0
    ratio = events[some] / of[some]
    return [float(ratio[0]), *(float(q) for q in np.quantile(ratio[1:], (tail, 1.0 - tail)))]


def _curve(drives: Sequence[Mapping[str, Any]], score: str, chain: str, equal_far: float) -> dict[str, Any]:
    """Warned shares of right and wrong points by threshold; the area below the second over the first one, by drive;
    and the second where the first is ``equal_far``, on the line between neighbouring thresholds."""
    sweeps = np.array([d["sweeps"][score][chain] for d in drives], np.float64)
    wrong = np.array([d["wrong"] for d in drives], np.float64)
    right = np.array([d["points"] for d in drives]) - wrong
    drawn = named_generator(0, "resamples").integers(len(drives), size=(RESAMPLES, len(drives)))
    times = np.stack([np.bincount(one, minlength=len(drives)) for one in drawn])
    times = np.concatenate([np.ones((1, len(drives)), np.int64), times])  # as they are, and drawn again
    x = times @ sweeps[:, 0] / np.maximum(times @ right, 1.0)[:, None]
    y = 1.0 - times @ sweeps[:, 1] / np.maximum(times @ wrong, 1.0)[:, None]
    edge = np.ones((len(times), 1))
    across, up = np.concatenate([0.0 * edge, x, edge], 1), np.concatenate([0.0 * edge, y, edge], 1)
    area = np.sum(0.5 * (up[:, 1:] + up[:, :-1]) * np.diff(across), 1)
    return {
        "right": np.round(x[0], 5).tolist(), "wrong": np.round(y[0], 5).tolist(),
        "area": _interval(np.where(times @ wrong > 0.0, area, 0.0), np.asarray(times @ wrong > 0.0, np.float64)),
        "detected": float(np.interp(equal_far, across[0], up[0])) if wrong.any() else None,
    }  # fmt: skip


def roc_figure(result: Mapping[str, Any]) -> Figure:
    """Wrong points warned of over right points warned of, by score, a panel a map."""
    label = labels(result["config"]["maps"])
    figure = new_figure(3.8 * len(label), 3.6)
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(label))), label, strict=True):
        for curve in result["curves"]:
            if (curve["map"], curve["chain"]) == (name, ALONE):
                right, wrong = ([100.0 * v for v in curve[key]] for key in ("right", "wrong"))
                axes.plot(right, wrong, color=COLOURS[curve["score"]], label=curve["score"], lw=1.2)
        axes.plot([0, 100], [0, 100], ":", color=INK, lw=0.8)
        tidy(axes, title=label[name], xlabel="right points warned of [%]", ylabel="wrong points warned of [%]")
        legend(axes)
    return figure


def labels(maps: Sequence[str]) -> dict[str, str]:
    """Names of maps for tables: without folder and endings, as given where two would be the same."""
    short = {name: Path(name).name.partition(".")[0] for name in maps}
    return {name: own if list(short.values()).count(own) == 1 else name for name, own in short.items()}


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables."""
    label = labels(result["config"]["maps"])
    rows = [
        (label[d["map"]], d["sky"], f"{d['points']:,}", f"{d['wrong']:,}", f"{d['wrong_link']:,}", f"{d['beyond']:,}",
         str(d["faulty"]))
        for d in result["drives"]
    ]  # fmt: skip
    heads = ("map", "sky", "points", "wrong", "wrong link", "beyond the limit", "drives with faults")
    yield "Points in motion with a position", (heads, rows)
    yield "By S5's threshold rule, fitted on the other maps; intervals of 95 % by drive", crossing_rows(result)
    yield "The same with the phases that the authors have before the score", first_phases_rows(result)
    yield "By the thresholds of S5's Table 6; scores alone", published_rows(result)
    yield "At equal false alarms of right points, fitted on the other maps; scores alone", equal_rows(result)
    yield "Largest OCDR on the other maps; scores alone", best_rows(result)


def _of(result: Mapping[str, Any], rule: str, chain: str, group: str | None = None) -> list[dict[str, Any]]:
    """Rates of a rule and a chain in the order of the scores; ``label`` is the name of the map in tables."""
    label = labels(result["config"]["maps"])
    found = [
        r | {"label": label[r["map"]]} for r in result["rates"]
        if (r["rule"], r["chain"]) == (rule, chain) and r["group"] == (group or r["group"])
    ]  # fmt: skip
    return sorted(found, key=lambda r: SCORES.index(r["score"]))


def crossing_rows(result: Mapping[str, Any]) -> Table:
    """Each score alone, next to S5's Table 5."""
    heads = ("score", "S5", "map", "drives", "threshold", "false alarms", "missed", "OCDR")
    return heads, [
        (r["score"], S5_TABLE_5.get(r["score"], "-"), r["label"], r["group"], f"{r['threshold']:g}", _text(r["far"]),
         _text(r["mdr"]), _text(r["ocdr"]))
        for r in _of(result, "crossing", ALONE)
    ]  # fmt: skip


def first_phases_rows(result: Mapping[str, Any]) -> Table:
    """Scores after the phases that their authors have before them, and those phases without the score."""
    never = {(r["map"], r["group"], r["score"]): r for r in _of(result, "never", PUBLISHED)}
    heads = ("score", "map", "drives", "threshold", "false alarms", "missed", "OCDR", "OCDR of the phases alone")
    return heads, [
        (r["score"], r["label"], r["group"], f"{r['threshold']:g}", _text(r["far"]), _text(r["mdr"]), _text(r["ocdr"]),
         _text(never[r["map"], r["group"], r["score"]]["ocdr"]))
        for r in _of(result, "crossing", PUBLISHED) if r["score"] in BEFORE
    ]  # fmt: skip


def published_rows(result: Mapping[str, Any]) -> Table:
    """Scores alone at the thresholds that S5 prints."""
    heads = ("score", "map", "drives", "threshold", "warned of right", "wrong not warned of", "OCDR")
    return heads, [
        (r["score"], r["label"], r["group"], f"{r['threshold']:g}", _text(r["per_right"]), _text(r["per_wrong"]),
         _text(r["ocdr"]))
        for r in _of(result, "published", ALONE)
    ]  # fmt: skip


def equal_rows(result: Mapping[str, Any]) -> Table:
    """Scores alone at the threshold of equal false alarms, and the curve of the judged map itself."""
    curve = {(c["map"], c["score"]): c for c in result["curves"] if c["chain"] == ALONE}
    share = result["config"]["equal_far"]
    heads = ("score", "map", "threshold", "warned of right", "wrong not warned of", "OCDR",
             f"not warned of where {100.0 * share:g} % of right are, by the map's own curve", "area")  # fmt: skip
    return heads, [
        (r["score"], r["label"], f"{r['threshold']:g}", _text(r["per_right"]), _text(r["per_wrong"]), _text(r["ocdr"]),
         *(("-", "-") if (own := curve[r["map"], r["score"]])["detected"] is None
           else (f"{100.0 * (1.0 - own['detected']):.0f} %", "{:.2f} ({:.2f} .. {:.2f})".format(*own["area"]))))
        for r in _of(result, "equal", ALONE, "all")
    ]  # fmt: skip


def best_rows(result: Mapping[str, Any]) -> Table:
    """Scores alone at the threshold of the largest OCDR, next to never warning."""
    never = {(r["map"], r["score"]): r for r in _of(result, "never", ALONE, "all")}
    heads = ("score", "map", "threshold", "warned of right", "wrong not warned of", "OCDR", "OCDR of never warning")
    return heads, [
        (r["score"], r["label"], f"{r['threshold']:g}", _text(r["per_right"]), _text(r["per_wrong"]), _text(r["ocdr"]),
         _text(never[r["map"], r["score"]]["ocdr"]))
        for r in _of(result, "best", ALONE, "all")
    ]  # fmt: skip


def _text(found: Sequence[float | None]) -> str:
    value, low, high = found
    if value is None or low is None or high is None:
        return "-"
    return f"{100.0 * value:.1f} ({100.0 * low:.1f} .. {100.0 * high:.1f}) %"
