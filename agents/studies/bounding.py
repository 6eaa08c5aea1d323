"""The rate of ``|error| > PL``: plain Monte Carlo for common risks, importance sampling for rare ones.

Three kinds of parts: ``cases-I`` draws epochs of random geometries with true probabilities, ``rare-I`` estimates the
rate at a risk that is too small for counting, ``drift-I`` draws outages without redundancy (Doppler, odometer and
heading).

The epochs of a geometry share its biases and its level, so that the spread between geometries limits the accuracy of a
rate: intervals are the exact ones of the count, widened where that spread is larger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.assessment.drift_model import DriftConfig, Outage, drift_exceedance
from lanebound.integrity.assessment.exceedance import (
    DRAWN,
    STRATA,
    Case,
    ExceedanceCounts,
    FaultSize,
    Form,
    Prepared,
    draw_case,
    expected_fault_free,
    expected_one_fault,
    importance_rates,
    least_fault_free,
    mean_and_deviation,
    prepare,
    tally,
)
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.risk import RiskConfig, pair_risk, upper_quantile

Array = NDArray[np.float64]
Row = Mapping[str, Any]

CONFIDENCE = 0.95
AXES = ("along", "across", "either")
SIGMAS = 3.0  # of an importance estimate, beyond which it disagrees


def _octant(row: Row) -> str:
    """The heading: along East or North, or between them."""
    away = abs((float(row["heading_deg"]) + 45.0) % 90.0 - 45.0)
    return "heading within 22.5 deg of an axis" if away < 22.5 else "heading between the axes"


def _size(row: Row) -> str:
    """The class of the number of satellites."""
    n = int(row["satellites"])
    return "up to 15 satellites" if n <= 15 else "16 to 25 satellites" if n <= 25 else "26 satellites and more"


PLACES: dict[str, Callable[[Row], str]] = {
    "all": lambda row: "all",
    "bias": lambda row: f"biases up to {row['bias_share']:g} sigma",
    "size": _size,
    "heading": _octant,
    "worst": lambda row: f"biases worst {row['worst']}",
}
"""Groupings of cases: functions from a case to the name of its group."""


def rate_of(events: int, trials: int) -> dict[str, Any]:
    """A rate with its exact interval; None without trials."""
    if trials == 0:
        return {"events": events, "trials": 0, "rate": None, "low": None, "high": None}
    low, high = clopper_pearson(events, trials, CONFIDENCE)
    return {"events": events, "trials": trials, "rate": events / trials, "low": low, "high": high}


def rate_over(events: Array, trials: Array, strata: Array | None = None) -> dict[str, Any]:
    """The rate of several cases together; its interval includes the spread between them.

    events, trials (cases,) counts; strata (cases,) values that are taken in turn: the spread is that within each (a
    stratified ratio).
    """
    found = rate_of(int(events.sum()), int(trials.sum()))
    if found["rate"] is None:
        return found
    variance, groups = 0.0, np.zeros(len(events)) if strata is None else strata
    for one in np.unique(groups):
        c, n = events[groups == one], trials[groups == one]
        if len(c) > 1 and n.any():
            variance += len(c) * float(np.var(c - c.sum() / n.sum() * n, ddof=1))
    half = float(upper_quantile(0.5 * (1.0 - CONFIDENCE))) * variance**0.5 / found["trials"]
    low, high = min(found["low"], found["rate"] - half), max(found["high"], found["rate"] + half)
    return found | {"low": max(low, 0.0), "high": min(high, 1.0)}


def summarise(config: Mapping[str, Any], parts: Mapping[str, Row]) -> dict[str, Any]:
    """The summary as plain data."""

    def rows(kind: str, key: str) -> list[Row]:
        return [row for name, part in parts.items() if name.startswith(kind) for row in part[key]]

    cases, rare, outages = rows("cases-", "cases"), rows("rare-", "cases"), rows("drift-", "outages")
    risks = list(config["risks"])
    result: dict[str, Any] = {"config": dict(config), "confidence": CONFIDENCE, "strata": list(STRATA)}
    if cases:
        epochs = np.sum([row["epochs"] for row in cases], 0)
        result["epochs"] = {name: int(n) for name, n in zip(STRATA, epochs, strict=True)}
        result["alarms"] = _alarms(cases)
        result["alarms_by_bias"] = {
            place: _alarms(group)[STRATA[0]] for place, group in _grouped(cases, PLACES["bias"]).items()
        }
        result["axis_epochs"] = 2 * int(epochs.sum())
        result["rates"] = {
            kind: {place: _rates(group, risks) for place, group in _grouped(cases, name_of).items()}
            for kind, name_of in PLACES.items()
        }
        result["level_over"] = _tightness(cases, risks)
    if rare:
        result["rare"] = _summary_rare(rare, config)
    if outages:
        result["drift"] = _summary_drift(outages, risks)
    return result


def _grouped(rows: Iterable[Row], name_of: Callable[[Row], str]) -> dict[str, list[Row]]:
    out: dict[str, list[Row]] = {}
    for row in rows:
        out.setdefault(name_of(row), []).append(row)
    return dict(sorted(out.items()))


def _alarms(cases: Sequence[Row]) -> dict[str, Any]:
    """Rates of alarms of the test by stratum."""
    alarms, epochs = (np.array([row[name] for row in cases]) for name in ("alarms", "epochs"))
    bias = np.array([row["bias_share"] for row in cases])
    return {name: rate_over(alarms[:, s], epochs[:, s], bias) for s, name in enumerate(STRATA)}


def _rates(cases: Sequence[Row], risks: Sequence[float]) -> dict[str, Any]:
    """By form and risk: rates along, across and on either axis, and counts by stratum."""
    out: dict[str, Any] = {}
    bias = np.array([row["bias_share"] for row in cases])
    for form in Form:
        count = np.array([row["misleading"][form.name] for row in cases])
        trials = np.array([row["available"][form.name] for row in cases])
        out[form.value] = {
            f"{risk:g}": {axis: rate_over(count[:, r, a].sum(-1), trials[:, r], bias) for a, axis in enumerate(AXES)}
            | {"by_stratum": {name: int(n) for name, n in zip(STRATA, count[:, r, 2].sum(0), strict=True)}}
            for r, risk in enumerate(risks)
        }
    return out


def _tightness(cases: Sequence[Row], risks: Sequence[float]) -> dict[str, Any]:
    """Ratios of each form's level to the exact root's, and to the least sufficient level without faults."""
    root = np.array([row["level_m"][Form.ROOT.name] for row in cases], dtype=np.float64)
    least = np.array([row["least_m"] for row in cases], dtype=np.float64)
    out: dict[str, Any] = {}
    for form in Form:
        level = np.array([row["level_m"][form.name] for row in cases], dtype=np.float64)
        out[form.value] = {
            f"{risk:g}": {"root": _spread(level[:, r] / root[:, r]), "least": _spread(level[:, r] / least[:, r])}
            for r, risk in enumerate(risks)
        }
    return out


def _spread(ratio: Array) -> dict[str, float] | None:
    """Smallest, median and largest of the finite ones."""
    known = ratio[np.isfinite(ratio)]
    if not known.size:
        return None
    return {"smallest": float(known.min()), "median": float(np.median(known)), "largest": float(known.max())}


def _summary_rare(rare: Sequence[Row], config: Mapping[str, Any]) -> dict[str, Any]:
    """Importance estimates at the rare risk and at the least counted one, all geometries together and by biases.

    Two faults at once and wrong fixes are not drawn: ``spent`` is an upper bound of their probability, which levels
    subtract from their budget, in the mean and of the geometry with the largest.
    """
    spent = [case["spent"] for case in rare]
    out: dict[str, Any] = {"spent": {"mean": float(np.mean(spent)), "largest": max(spent)}}
    for row, risk in enumerate((config["rare_risk"], min(config["risks"]))):
        out[f"{risk:g}"] = {}
        for form in (Form.ROOT, Form.CLOSED, Form.PUBLISHED):
            known = [case for case in rare if len(case["rates"][form.name]) > row]
            if known:
                by_bias = _grouped(known, PLACES["bias"]).items()
                out[f"{risk:g}"][form.value] = _estimate(known, form, row) | {
                    "by_bias": {place: _estimate(group, form, row) for place, group in by_bias}
                }
    return out


def _estimate(cases: Sequence[Row], form: Form, row: int) -> dict[str, Any]:
    """Mean rate of some geometries along and across, the part of each stratum, and the standard deviations.

    ``spread`` is the standard deviation of the mean from the spread between geometries, ``draws`` that of the draws
    alone. ``exact`` are closed forms: without the test, which bounds the stratum without a fault; and with one fault of
    either law of sizes, tested by the separation of its own satellite alone, which bounds that one. ``spent`` is
    the probability of what is not drawn.
    """
    found = [case["rates"][form.name][row] for case in cases]
    strata, variances = ([np.array(of) for of in each] for each in zip(*found, strict=True))
    mean, spread, draws = mean_and_deviation([of.sum(0) for of in strata], [of.sum(0) for of in variances])
    parts = np.mean(strata, 0)
    out: dict[str, Any] = {
        axis: {"rate": float(mean[a]), "spread": float(spread[a]), "draws": float(draws[a])}
        | {"by_stratum": {name: float(parts[s, a]) for s, name in enumerate(DRAWN)}}
        for a, axis in enumerate(AXES[:2])
    }
    if form.name in cases[0]["exact"]:
        closed = [case["exact"][form.name] for case in cases]
        out["exact"] = {name: np.mean([one[name][row] for one in closed], 0).tolist() for name in closed[0]}
    undrawn = float(np.mean([case["spent"] for case in cases]))
    return out | {"geometries": len(cases), "spent": undrawn, "upper": float((mean + SIGMAS * spread).max())}


def _summary_drift(outages: Sequence[Row], risks: Sequence[float]) -> dict[str, Any]:
    """By source and variant: how often the level at the end of an outage is exceeded, and the worst outage."""
    out: dict[str, Any] = {}
    for source, group in _grouped(outages, lambda row: str(row["source"])).items():
        trials = np.array([row["vehicles"] for row in group])
        out[source] = {
            variant: {
                f"{risk:g}": {
                    axis: rate_over(np.array([row["exceeded"][variant][r][a] for row in group]), trials)
                    for a, axis in enumerate(AXES)
                }
                for r, risk in enumerate(risks)
            }
            for variant in group[0]["exceeded"]
        }
    return out


SIZES = {"worst": "the size that misleads most", "uniform": "any size up to twice the threshold's"}
ESTIMATE = ("no fault", "one fault", "rate", "sd draws", "sd geometries")


def over_risk(rate: Mapping[str, Any], risk: float) -> str:
    """A rate over its risk, and the interval."""
    if rate["rate"] is None:
        return "-"
    return f"{rate['rate'] / risk:.3g} ({rate['low'] / risk:.3g} .. {rate['high'] / risk:.3g})"


def form_rows(result: Mapping[str, Any]) -> Table:
    """Each form at each risk, all cases together."""
    rates = result["rates"]["all"]["all"]
    risks = list(next(iter(rates.values())))
    rows = [(form, *(over_risk(found[risk]["either"], float(risk)) for risk in risks)) for form, found in rates.items()]
    return ("form", *risks), rows


def place_rows(result: Mapping[str, Any]) -> Table:
    """Each form at the least risk by biases, size, heading and the axis with the worst biases."""
    places = [(kind, place) for kind in ("bias", "size", "heading", "worst") for place in result["rates"][kind]]
    forms = list(result["rates"]["all"]["all"])
    risk = min(result["rates"]["all"]["all"][forms[0]], key=float)

    def ratio(kind: str, place: str, form: str) -> str:
        rate = result["rates"][kind][place][form][risk]["either"]["rate"]
        return "-" if rate is None else f"{rate / float(risk):.3g}"

    rows = [(place, *(ratio(kind, place, form) for form in forms)) for kind, place in places]
    return ("place", *forms), rows


def tightness_rows(result: Mapping[str, Any]) -> Table:
    """Median level of each form over the least sufficient one without faults."""
    risks = list(next(iter(result["level_over"].values())))

    def ratio(found: Mapping[str, Any] | None) -> str:
        return "-" if found is None else f"{found['median']:.2f} ({found['smallest']:.2f} .. {found['largest']:.2f})"

    rows = [(form, *(ratio(found[risk]["least"]) for risk in risks)) for form, found in result["level_over"].items()]
    return ("form", *risks), rows


def strata_rows(result: Mapping[str, Any]) -> Table:
    """Misleading epochs of the exact forms by stratum, and all epochs of each."""
    rates = result["rates"]["all"]["all"]
    rows = [
        (form, risk, *(f"{one['by_stratum'][name]:,}" for name in result["strata"]))
        for form in ("exact root", "exact closed form")
        for risk, one in rates[form].items()
    ]
    drawn = ("epochs drawn", "", *(f"{result['epochs'][name]:,}" for name in result["strata"]))
    return ("form", "risk", *result["strata"]), [*rows, drawn]


def rare_rows(result: Mapping[str, Any]) -> Table:
    """Importance estimates along and across by stratum, with the standard deviations of draws and geometries."""
    rare, rows = result["rare"], []
    undrawn = f"{rare['spent']['mean']:.2e}"
    for risk, forms in rare.items():
        if risk != "spent":
            rows += [(risk, form, *cells) for form, found in forms.items() for cells in _by_axis(found)]
            rows.append((risk, "not drawn", "either", "", "", undrawn, "", ""))
    return ("risk", "form", "axis", *ESTIMATE), rows


def rare_place_rows(result: Mapping[str, Any]) -> Table:
    """The same of the exact root at the rare risk, by biases; no rows without levels."""
    root = result["rare"][f"{result['config']['rare_risk']:g}"].get("exact root", {"by_bias": {}})
    rows = [(place, *cells) for place, one in root["by_bias"].items() for cells in _by_axis(one)]
    return ("place", "axis", *ESTIMATE), rows


def _by_axis(found: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (axis, *(f"{v:.2e}" for v in (*one["by_stratum"].values(), one["rate"], one["draws"], one["spread"])))
        for axis, one in ((axis, found[axis]) for axis in ("along", "across"))
    ]


def drift_rows(result: Mapping[str, Any]) -> Table:
    """Each source and variant at each risk."""
    rows = []
    for source, variants in result["drift"].items():
        for variant, found in variants.items():
            rates = tuple(over_risk(one["either"], float(risk)) for risk, one in found.items())
            rows.append((f"{source}, {variant}", *rates))
    risks = list(next(iter(next(iter(result["drift"].values())).values())))
    return ("source and form", *risks), rows


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables, as far as their parts were drawn."""
    if "rates" in result:
        title = f"Misleading epochs, of {result['axis_epochs']:,} axis epochs: rate of either axis over the risk, 95 %"
        yield title, form_rows(result)
        yield "Of these, by what there was: misleading epochs on either axis", strata_rows(result)
        yield "The same by place, at the least risk counted: rate over the risk", place_rows(result)
        yield "Levels over the least that would have held without faults, median", tightness_rows(result)
    if "rare" in result:
        size, most = SIZES[result["config"]["rare_sizes"]], result["rare"]["spent"]["largest"]
        yield f"By importance sampling: rate of one axis; faults have {size}", rare_rows(result)
        yield f"Not drawn: two faults and wrong fixes, at most so often on either axis ({most:.2e} in one geometry)."
        risk = f"{result['config']['rare_risk']:g}"
        yield f"The exact root at {risk} by biases: rate of one axis", rare_place_rows(result)
    if "drift" in result:
        yield "Between fixes: error beyond the level at the end of an outage, either axis", drift_rows(result)
    yield "A rate over the risk above 1 breaks the promise."


PACKAGES = ("lanebound.integrity", "lanebound.agents.studies")
CASES_IN_PART = 10
OUTAGES_IN_PART = 4


class BoundingConfig(Config):
    """Numbers and distributions of the draws."""

    risks: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = Field(
        (1e-3, 1e-4, 1e-5), min_length=1, description="total horizontal risks counted [-]"
    )
    epochs: int = Field(50_000_000, ge=1, description="epochs drawn; each counts along and across")
    epochs_per_case: int = Field(50_000, ge=1, description="epochs of one geometry")
    least_satellites: int = Field(5, ge=5, le=60, description="fewest satellites of a geometry")
    most_satellites: int = Field(35, ge=5, le=60, description="most satellites of a geometry")
    bias_shares: tuple[float, ...] = Field(
        (0.0, 0.5, 2.0, 5.0), min_length=1, description="largest nominal bias, in sigmas; taken in turn"
    )
    wrong_fix_share: float = Field(0.1, ge=0, lt=1, description="share of the least risk that wrong fixes use [-]")
    rare_risk: float = Field(1e-7, gt=0, lt=1, description="risk for importance sampling [-]")
    rare_cases: int = Field(1000, ge=0, description="geometries for it")
    rare_sizes: FaultSize = Field(
        FaultSize.WORST,
        description="sizes of its faults: the most misleading one, or uniform up to twice the threshold's, as counted",
    )
    rare_draws: int = Field(512, ge=64, multiple_of=16, description="draws of each axis of a geometry without fault")
    outages: int = Field(80, ge=0, description="outages of Doppler, and as many of odometer and heading")
    vehicles: int = Field(20_000, ge=1, description="vehicles in an outage")
    seed: int = Field(1, ge=0, description="of all draws")
    risk: RiskConfig = Field(
        RiskConfig(satellite_prior=(1e-5,) * 5),
        description="rules of the navigation layer; the risk itself is replaced",
    )
    drift: DriftConfig = Field(DriftConfig(), description="errors between fixes")

    @property
    def cases(self) -> int:
        """Number of geometries."""
        return -(-self.epochs // self.epochs_per_case)


def assess_bounding(
    config: BoundingConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Draw the missing parts, and write ``results.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "bounding assessment", config, PACKAGES)
    parts = parts_of(config, work_part, part_names(config), out, jobs, on_progress)
    return stored(summarise(config.to_dict(), parts), out)


def part_names(config: BoundingConfig) -> list[str]:
    """All parts in order."""
    rare = range(0, config.rare_cases, 10 * CASES_IN_PART)
    return [
        *(f"drift-{i}" for i in range(0, config.outages, OUTAGES_IN_PART)),
        *(f"rare-{i}" for i in rare),
        *(f"cases-{i}" for i in range(0, config.cases, CASES_IN_PART)),
    ]


def work_part(config: BoundingConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """Draw one part; it does not depend on other parts."""
    kind, first = name.split("-")
    start = int(first)
    match kind:
        case "cases":
            return _cases(config, range(start, min(start + CASES_IN_PART, config.cases)), advance)
        case "rare":
            return _rare(config, range(start, min(start + 10 * CASES_IN_PART, config.rare_cases)))
        case _:
            return _drift(config, range(start, min(start + OUTAGES_IN_PART, config.outages)))


def _case(config: BoundingConfig, index: int, stream: str) -> tuple[Case, np.random.Generator]:
    """Geometry ``index`` and the generator of its draws; sizes and biases are taken in turn."""
    generator = named_generator([config.seed, index], stream)
    satellites = int(generator.integers(config.least_satellites, config.most_satellites + 1))
    share = config.bias_shares[index % len(config.bias_shares)]
    return draw_case(generator, satellites, share), generator


def _cases(config: BoundingConfig, indices: range, advance: Advance) -> dict[str, Any]:
    wrong_fix = config.wrong_fix_share * min(config.risks)
    budgets = config.risk.axis_budgets(config.risks)
    drawn = [_case(config, i, "gnss") for i in indices]
    prepared = prepare([case for case, _ in drawn], config.risk, config.risks, wrong_fix)
    rows = []
    for i, one, (case, generator) in zip(indices, prepared, drawn, strict=True):
        epochs = min(config.epochs_per_case, config.epochs - i * config.epochs_per_case)
        counted = ExceedanceCounts.empty(len(config.risks))
        tally(one, epochs, wrong_fix, generator, counted)
        rows.append(
            _place(case)
            | {
                "epochs": counted.epochs.tolist(),
                "alarms": counted.alarms.tolist(),
                "misleading": {form.name: counted.misleading[form].tolist() for form in Form},
                "available": {form.name: counted.available[form].tolist() for form in Form},
                "level_m": {form.name: one.levels_m[form].tolist() for form in Form},
                "least_m": least_fault_free(one, budgets).tolist(),
                "fault_free": {form.name: expected_fault_free(one, form).tolist() for form in (Form.ROOT, Form.CLOSED)},
            }
        )
        advance(len(rows) / len(indices))
    return {"cases": rows}


def _place(case: Case) -> dict[str, Any]:
    """The properties of a geometry."""
    return {
        "satellites": len(case),
        "clocks": int(np.unique(case.group).size),
        "heading_deg": float(np.rad2deg(case.heading_rad)),
        "bias_share": case.bias_share,
        "worst": case.worst.name.lower(),
    }


def _rare(config: BoundingConfig, indices: range) -> dict[str, Any]:
    """Importance sampling at the rare risk and, for comparison, at the least counted one; with closed forms."""
    risks = [config.rare_risk, min(config.risks)]
    drawn = [_case(config, i, "faults") for i in indices]
    prepared = prepare([case for case, _ in drawn], config.risk, risks, config.wrong_fix_share * config.rare_risk)
    rows = []
    for one, (case, generator) in zip(prepared, drawn, strict=True):
        draws = partial(importance_rates, draws=config.rare_draws, generator=generator, sizes=config.rare_sizes)
        found = {
            form.name: [
                [values.tolist() for values in draws(one, form, row)]
                for row in range(len(risks))
                if np.isfinite(one.levels_m[form][row]).all()
            ]
            for form in (Form.ROOT, Form.CLOSED, Form.PUBLISHED)
        }
        exact = {form.name: _closed_forms(one, form) for form in (Form.ROOT, Form.CLOSED)}
        spent = float(pair_risk(one.prior)) + config.wrong_fix_share * config.rare_risk
        rows.append(_place(case) | {"rates": found, "exact": exact, "spent": spent})
    return {"cases": rows}


def _closed_forms(one: Prepared, form: Form) -> dict[str, Any]:
    """Expected rates without a fault (without the test), and upper bounds with one; (R, 2) each."""
    faults = {f"one fault, {sizes.value}": expected_one_fault(one, form, sizes).tolist() for sizes in FaultSize}
    return {"no fault": expected_fault_free(one, form).tolist()} | faults


def _drift(config: BoundingConfig, indices: range) -> dict[str, Any]:
    rows = []
    for i in indices:
        generator = named_generator([config.seed, i], "odometer")
        length = float(np.exp(generator.uniform(0.0, np.log(60.0))))
        speed, heading, turn = (
            float(generator.uniform(*bounds)) for bounds in ((2.0, 20.0), (-np.pi, np.pi), (-0.1, 0.1))
        )
        for source in ("doppler", "odometer"):
            outage = Outage(source, length, speed, heading, turn)
            found = drift_exceedance(outage, config.drift, config.risks, config.vehicles, generator)
            rows.append(
                {"source": source, "length_s": length, "speed_mps": speed, "turn_radps": turn}
                | {"vehicles": config.vehicles, "exceeded": {v.value: n.tolist() for v, n in found.items()}}
            )
    return {"outages": rows}
