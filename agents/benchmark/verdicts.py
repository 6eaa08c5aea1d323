"""Verdicts: agents that are clearly safer than others, and the opening sentences of reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

from lanebound.agents.benchmark.metrics import HARM_OF_AN_END
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Paired, Results
from lanebound.agents.benchmark.statistics import holm, seeds_to_exclude
from lanebound.agents.serialization import counted
from lanebound.envs.registration import IDS, make_config

__all__ = [
    "ENDS", "HARM", "LEVEL", "MARGIN", "RULE", "SafetyVerdict", "conclusions", "mean_over_cells", "opening", "verdicts",
]  # fmt: skip

HARM = ("collision", "off_road", "lane_departure", "harm")
"""Metrics of the true car; costs also depend on levels and alerts, to which some agents react."""
ENDS = ("collision", "off_road")
MARGIN = 0.05
"""Largest rise of ENDS [share of episodes], by the upper ends of their intervals."""
LEVEL = 0.05  # of the family of all comparisons, by Holm's method
LEAST_HARMFUL = 3  # agents that the opening names
RULE = (
    f"Safer: clearly fewer crashes, ends off the road or departures, or less harm ({HARM_OF_AN_END:g} for such an end, "
    f"and m2 beyond the lane), by Holm's method over all comparisons; none of these clearly worse, and crashes and "
    f"ends off the road up by no more than {100.0 * MARGIN:g} points (95 % intervals)."
)

Key = tuple[Place, str, str]
Pairs = dict[str, Paired]


@dataclass(frozen=True)
class SafetyVerdict:
    """The comparison of an agent with another.

    Attributes
    ----------
    places : where both drove and neither failed
    safer, worse : places where it is clearly safer, and places with clearly more of any harm
    failed : number of places where one of the two failed
    throughput_mps, cost : mean differences over all ``places``; None without any
    """

    agent: str
    against: str
    places: list[Place]
    safer: list[Place]
    worse: list[Place]
    failed: int
    throughput_mps: float | None
    cost: float | None


def verdicts(results: Results) -> list[SafetyVerdict]:
    """All agents that do not observe the truth against every reference; those safer in most cells first.

    Safer requires one of HARM clearly lower, by its 95 % interval and by its p-value adjusted by Holm's method over all
    agents, references, cells and these metrics; none of them clearly higher, by its interval; the upper ends of the
    differences in ENDS at most MARGIN; and a success, because a car that does not move does no harm either.
    """
    pairs = _compared(results)
    adjusted = _adjusted(pairs)
    found = []
    for agent, against in dict.fromkeys((agent, against) for _, agent, against in pairs):
        here = {key[0]: those for key, those in pairs.items() if key[1:] == (agent, against)}
        whole = {place: those for place, those in here.items() if not those["harm"].failed}
        safer = [
            place
            for place, those in whole.items()
            if results.cell(place, agent).metrics["success"].mean and _is_safer(those, adjusted[place, agent, against])
        ]
        worse = [place for place, those in whole.items() if _clearly(those, HARM, 1.0)]
        means = (_mean(those[key].difference for those in whole.values()) for key in ("throughput", "cost"))
        found.append(SafetyVerdict(agent, against, list(whole), safer, worse, len(here) - len(whole), *means))
    return sorted(found, key=lambda v: (results.suite.references.index(v.against), -len(v.safer)))


def _compared(results: Results) -> dict[Key, Pairs]:
    seeing = {name for name, chosen in results.suite.agents.items() if chosen.sees_truth}  # no opponents
    found: dict[Key, Pairs] = {}
    for pair in results.paired:
        if pair.agent not in seeing:
            found.setdefault((pair.place, pair.agent, pair.against), {})[pair.metric] = pair
    return found


def _adjusted(pairs: dict[Key, Pairs]) -> dict[Key, dict[str, float]]:
    """P-values of HARM, adjusted over all of them; a missing one counts as 1."""
    asked = [(key, metric) for key in pairs for metric in HARM]
    known = [pairs[key][metric].p for key, metric in asked]
    found: dict[Key, dict[str, float]] = {key: {} for key in pairs}
    for (key, metric), p in zip(asked, holm([1.0 if p is None else p for p in known]), strict=True):
        found[key][metric] = p
    return found


def _is_safer(pairs: Pairs, adjusted: dict[str, float]) -> bool:
    shown = [key for key in HARM if adjusted[key] <= LEVEL]
    kept = all((high := pairs[key].high) is not None and high <= MARGIN for key in ENDS)
    return bool(_clearly(pairs, shown, -1.0)) and kept and not _clearly(pairs, HARM, 1.0)


def _clearly(pairs: Pairs, keys: Iterable[str], sign: float) -> list[str]:
    """Metrics that are clearly higher (sign 1) or lower (-1)."""
    return [key for key in keys if pairs[key].clear and sign * (pairs[key].difference or 0.0) > 0.0]


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def mean_over_cells(results: Results, agent: str, key: str) -> float | None:
    """Mean of a metric over the cells of an agent, each with the same weight."""
    return _mean(cell.metrics[key].mean for cell in results.cells if cell.agent == agent)


def opening(results: Results) -> list[str]:
    """Three sentences: harm and throughput of the reference and of the least harmful agents, and what is shown.

    Agents that observe the truth, act at random, failed, or have not driven all cells are left out.
    """
    reference, cells = results.suite.references[0], len({cell.place for cell in results.cells})
    paces = {agent: _pace(results, agent) for agent in results.suite.agents if _competes(results, agent, cells)}
    paces.pop(reference, None)
    known = sorted((pace, agent) for agent, pace in paces.items() if pace is not None)[:LEAST_HARMFUL]
    lines = []
    if (pace := _pace(results, reference)) is not None:
        lines.append(
            f"{reference}, the reference, drives at {pace[1]:.1f} m/s with a harm of {pace[0]:.1f} an episode "
            f"(means of {counted(cells, 'cell')})."
        )
    if known:
        named = ", ".join(f"{agent} ({harm:.1f} at {throughput:.1f} m/s)" for (harm, throughput), agent in known)
        lines.append(f"Least harm of the others: {named}.")
    return [*lines, *conclusions(results)]


def limits_of_other_skies(results: Results) -> list[str]:
    """A sentence where drives are judged by a limit of cost that was chosen under another sky, that of the preset."""
    ids = {place.env: f"lanebound/{place.env.removeprefix('lanebound/')}" for place in results.suite.places}
    own = {env: make_config(name).sky for env, name in ids.items() if name in IDS}
    found = sorted({f"{p.env} ({own[p.env]})" for p in results.suite.places if own.get(p.env, p.sky) != p.sky})
    if not found or "cost_limit" in results.suite.overrides:
        return []
    return [f"Cost limits were chosen under the sky of the preset, which is another one for {', '.join(found)}."]


def _pace(results: Results, agent: str) -> tuple[float, float] | None:
    """Harm and throughput of an agent; None where one is missing."""
    harm, throughput = (mean_over_cells(results, agent, key) for key in ("harm", "throughput"))
    return None if harm is None or throughput is None else (harm, throughput)


def _competes(results: Results, agent: str, cells: int) -> bool:
    chosen, own = results.suite.agents[agent], [cell for cell in results.cells if cell.agent == agent]
    whole = len(own) == cells and not any(cell.failed for cell in own)
    return whole and not chosen.sees_truth and chosen.agent != "random"


def conclusions(results: Results) -> list[str]:
    """Sentences: which agents are clearly safer than the references, in how many cells, and at which throughput."""
    found = verdicts(results)
    lines = [line for against in results.suite.references for line in _against(results, against, found)]
    return [*lines, RULE] if any(verdict.safer for verdict in found) else lines


def _against(results: Results, against: str, found: Sequence[SafetyVerdict]) -> list[str]:
    """Sentences about all agents that are compared with one reference."""
    here = [verdict for verdict in found if verdict.against == against]
    whole = [verdict for verdict in here if verdict.places]
    lines = [
        f"No verdict on {v.agent} against {against} in {counted(v.failed, 'cell')}: an agent failed there."
        for v in here
        if v.failed
    ]
    if not whole:
        return lines
    safer = [verdict for verdict in whole if verdict.safer]
    if not safer:
        return [_nobody(results, against), *lines]
    price = [f"{v.agent} {v.throughput_mps:+.1f} m/s" for v in safer if v.throughput_mps is not None]
    named = ", ".join(_counted(verdict) for verdict in safer)
    cells = "cells without a failure" if any(verdict.failed for verdict in safer) else "cells"
    paid = [f"Throughput against {against}, over all {cells}: {', '.join(price)}."] if price else []
    return [f"Clearly safer than {against}: {named}.", *paid, *lines]


def _counted(verdict: SafetyVerdict) -> str:
    worse = f" (clearly worse in {len(verdict.worse)})" if verdict.worse else ""
    return f"{verdict.agent} in {len(verdict.safer)} of {counted(len(verdict.places), 'cell')}{worse}"


def _nobody(results: Results, against: str) -> str:
    """The sentence that no agent is clearly safer, or that there are too few seeds for it."""
    count, least = max(cell.episodes for cell in results.cells), seeds_to_exclude(MARGIN)
    seeds = counted(count, "seed")
    if count >= least:
        return f"With {seeds} no agent is clearly safer than {against} in any cell; more seeds may show more (--seeds)."
    return (
        f"With {seeds} no agent can be called safer than {against}: to exclude a rise of crashes by more than "
        f"{100.0 * MARGIN:g} points takes {least} seeds at least (--seeds)."
    )
