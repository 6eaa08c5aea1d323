"""Tables of the context study: medians over drives, pooled counts, the crossing of the sweep, charges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from lanebound.integrity.assessment.warning_rates import PUBLISHED_COUNTS, WarningCounts, WarningSweep
from lanebound.integrity.monitoring.context.monitor import ContextReason

__all__ = [
    "PRINTED_PERCENT",
    "application_rows",
    "assumption_rows",
    "matcher_rows",
    "ocdr_rows",
    "reason_rows",
    "rule_rows",
    "speed_rows",
    "stage_rows",
    "summarise",
]

Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

PUBLISHED_PASSED = {"urban": 913, "rural": 2994, "mixed": 809}  # points, S5 table after section 4.4
PHASES = 3
PRINTED_PERCENT = {"urban": 98.24, "rural": 99.23, "mixed": 97.29}  # S5 Table 4
MAIN = "with errors, topological"  # S5's matcher, with the map that a vehicle may have
OWN = "all systems, declared errors"
COUNTED = "phase 3, over all points (S5's counting)"
STAGES = ("phase 1", "phase 2, of what reaches it", "phase 3, of what reaches it")
RULES = (
    "as printed", "all phases", "without position", "without speed", "without map", "position alone", "speed alone",
    "map alone", "level alone", "never", "always",
)  # fmt: skip


def summarise(config: Mapping[str, Any], parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All tables from the figures of the drives."""
    by_environment: dict[str, list[Mapping[str, Any]]] = {}
    roads = {part["environment"]: part["roads"] for part in parts}
    for part in parts:
        by_environment.setdefault(part["environment"], []).extend(part["seeds"])
    return {
        "config": dict(config),
        "environments": {name: _environment(drives, roads[name]) for name, drives in by_environment.items()},
    }


def _environment(drives: list[Mapping[str, Any]], roads: str) -> dict[str, Any]:
    return {
        "roads": roads,
        "drives": len(drives),
        "points": int(sum(d["points"] for d in drives)),
        "moving": _spread(d["moving"] for d in drives),
        "error_m": [_spread(d["error_m"][k] for d in drives) for k in range(2)],
        "speed": {form: _spread(d["speed"][form] for d in drives) for form in drives[0]["speed"]},
        "of": {key: _monitor([d["of"][key] for d in drives]) for key in drives[0]["of"]},
        "assumptions": {name: _monitor([d["assumptions"][name] for d in drives]) for name in drives[0]["assumptions"]},
    }


def _monitor(found: list[Mapping[str, Any]]) -> dict[str, Any]:
    return {
        "right": _spread(f["right"] for f in found),
        "available": _spread(f["available"] for f in found),
        "level_m": _spread(f["level_m"] for f in found),
        "beyond": [int(n) for n in np.sum([f["beyond"] for f in found], 0)],
        "passed": _spread(f["passed"] / max(f["counts"]["never"][0], 1) for f in found),
        "reasons": [int(n) for n in np.sum([f["reasons"] for f in found], 0)],
        "rules": {rule: _counts([f["counts"][rule] for f in found]) for rule in RULES},
        "stages": [_counts([f["stages"][k] for f in found]) for k in range(PHASES)],
        "over_all": _counts([[f["counts"]["never"][0], *f["stages"][-1][1:]] for f in found]),
        "sweep": _sweep([f["sweep"] for f in found]),
        "belief": _sweep([f["belief"] for f in found]),
        "charging": {
            kind: {what: _charges([f["charging"][kind][what] for f in found]) for what in ("toll", "speed")}
            for kind in ("plain", "guarded")
        },
    }


def _spread(values: Iterable[float]) -> list[float]:
    """Median, 5 and 95 %."""
    found = np.array(list(values))
    method: Any = "linear" if np.isfinite(found).all() else "higher"
    return [float(q) for q in np.quantile(found, [0.5, 0.05, 0.95], method=method)]


def _counts(rows: Sequence[Sequence[int]]) -> dict[str, Any]:
    """Rates of the drives that have points, and of all their points together."""
    each = [WarningCounts(*row) for row in rows]
    total, some = sum(each[1:], each[0]), [c for c in each if c.points]
    return {
        **{key: _spread(getattr(c, key) for c in some) if some else None for key in ("ocdr", "far", "mdr")},
        "pooled": {
            "points": total.points, "wrong": total.wrong, "false_alarms": total.false_alarms, "missed": total.missed,
            "ocdr": total.ocdr, "per_right": total.per_right, "per_wrong": total.per_wrong,
            "far_95": total.interval(total.false_alarms), "mdr_95": total.interval(total.missed),
        },
    }  # fmt: skip


def _sweep(rows: Sequence[Sequence[Any]]) -> dict[str, Any]:
    each = [WarningSweep(np.arange(float(len(a))), np.array(a), np.array(m), int(n)) for a, m, n in rows]
    total = sum(each[1:], each[0])
    threshold, ocdr = total.best()
    return {
        "false_alarms": total.false_alarms.tolist(), "missed": total.missed.tolist(), "points": total.points,
        "crossing": total.crossing(), "best_threshold": threshold, "best_ocdr": ocdr,
    }  # fmt: skip


def _charges(rows: Sequence[Mapping[str, int]]) -> dict[str, Any]:
    total = {key: sum(row[key] for row in rows) for key in ("due", "charged", "wrong", "missed")}
    return {
        **total,
        "wrong_rate": total["wrong"] / total["charged"] if total["charged"] else None,
        "missed_rate": total["missed"] / total["due"] if total["due"] else None,
    }


def _percent(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{100.0 * value:.{digits}f} %"


def _with_spread(values: Sequence[float] | None) -> str:
    return "-" if values is None else f"{100 * values[0]:.1f} ({100 * values[1]:.1f} to {100 * values[2]:.1f}) %"


def ocdr_rows(tables: Mapping[str, Any]) -> Table:
    """OCDR of S5 next to ours: by S5's counting, with warnings at rest, of all phases, and of each phase alone.

    S5's counting divides the false alarms and missed detections of the third phase by all points.
    """
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        found, published = env["of"][MAIN], PUBLISHED_COUNTS[env["roads"]]
        paper = WarningCounts(published[2], 0, *published[:2])
        rows.append((
            name, _percent(paper.ocdr, 2), _with_spread(found["over_all"]["ocdr"]),
            *(_with_spread(found["rules"][rule]["ocdr"]) for rule in ("as printed", "all phases", "never")),
            *(_with_spread(stage["ocdr"]) for stage in found["stages"]), _with_spread(found["available"]),
        ))  # fmt: skip
    return (
        "drive", "S5", COUNTED, "warned at rest", "all phases", "never warn", *STAGES, "HPL within limit",
    ), rows  # fmt: skip


def stage_rows(tables: Mapping[str, Any]) -> Table:
    """Each phase over the points that reach it, all drives together, next to never warning of the same points."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for assumed, found in _by_receiver(env):
            for stage, counted in zip(STAGES, found["stages"], strict=True):
                p = counted["pooled"]
                never = 1.0 - p["wrong"] / p["points"] if p["points"] else None
                shares = (p["ocdr"], never, p["per_right"], p["per_wrong"])
                rows.append((name, assumed, stage, f"{p['points']:,}", f"{p['wrong']:,}", *map(_percent, shares)))
    return (
        "drive", "receiver", "phase", "points", "wrong", "OCDR", "never warn", "warned of right points",
        "wrong points not warned of",
    ), rows  # fmt: skip


def _by_receiver(env: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """The monitor's own receiver first, then those of the assumptions."""
    return [(OWN, env["of"][MAIN]), *env["assumptions"].items()]


def assumption_rows(tables: Mapping[str, Any]) -> Table:
    """Availability and rates by what the receiver uses and declares; the first row of a drive is the monitor's own."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for assumed, found in _by_receiver(env):
            rows.append((
                name, assumed, f"{found['level_m'][0]:.1f} m", _with_spread(found["available"]),
                _beyond(*found["beyond"]), _with_spread(found["passed"]),
                _with_spread(found["rules"]["as printed"]["ocdr"]), _with_spread(found["rules"]["all phases"]["ocdr"]),
                _with_spread(found["over_all"]["ocdr"]), _with_spread(found["stages"][-1]["ocdr"]),
            ))  # fmt: skip
        passed = 100 * PUBLISHED_PASSED[env["roads"]] / PUBLISHED_COUNTS[env["roads"]][2]
        paper = f"{PRINTED_PERCENT[env['roads']]:.2f} %"
        rows.append((name, "S5, published", "-", "-", "-", f"{passed:.1f} %", "-", "-", paper, "-"))
    return (
        "drive", "assumption", "HPL", "HPL within limit", "errors beyond it", "three levels passed",
        "OCDR, warned at rest", "OCDR, all phases", COUNTED, STAGES[-1],
    ), rows  # fmt: skip


def _beyond(errors: int, accepted: int) -> str:
    return f"{errors:,} of {accepted:,}"


def reason_rows(tables: Mapping[str, Any]) -> Table:
    """Why the driver is warned: shares of all points, at rest as of their own, by what the receiver uses."""
    names = [reason.name.lower() for reason in ContextReason]
    rows: list[tuple[str, ...]] = []
    for drive, env in tables["environments"].items():
        for assumed, found in _by_receiver(env):
            total = max(sum(found["reasons"]), 1)
            rows.append((drive, assumed, *(_percent(n / total) for n in found["reasons"])))
    return ("drive", "receiver", *names), rows


def rule_rows(tables: Mapping[str, Any]) -> Table:
    """What each phase adds, and what naive rules reach; all drives of an environment together."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for rule in RULES:
            p = env["of"][MAIN]["rules"][rule]["pooled"]
            rows.append(
                (name, rule, _percent(p["ocdr"]), _percent(p["per_right"]), _percent(p["per_wrong"]), f"{p['wrong']:,}")
            )
    return ("drive", "rule", "OCDR", "warned of right points", "wrong points not warned of", "wrong points"), rows


def matcher_rows(tables: Mapping[str, Any]) -> Table:
    """Share of right links of each matcher and map; the crossing of its sweep; the same of its probability."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for key, found in env["of"].items():
            which, kind = key.split(", ")
            cells = [
                "-" if found[of]["crossing"] is None else f"{found[of]['crossing']:.0f}" for of in ("sweep", "belief")
            ]
            rows.append((
                name, which, kind, _with_spread(found["right"]), *cells, _percent(found["sweep"]["best_ocdr"]),
                _percent(found["belief"]["best_ocdr"]),
            ))  # fmt: skip
    return (
        "drive", "map", "matcher", "right link", "crossing of the score", "crossing of the probability",
        "best OCDR of the score", "best OCDR of the probability",
    ), rows  # fmt: skip


def speed_rows(tables: Mapping[str, Any]) -> Table:
    """Share of windows in which each form of the speed phase warns, by fault; and of the drives' points in motion."""
    cases = tables["speed_power"]
    forms = list(next(iter(cases.values())))
    rows: list[tuple[str, ...]] = [(name, *(_percent(found[form]) for form in forms)) for name, found in cases.items()]
    for name, env in tables["environments"].items():
        rows.append((f"{name} drives, no fault", *(_with_spread(env["speed"][form]) for form in forms)))
    return ("case", *forms), rows


def application_rows(tables: Mapping[str, Any]) -> Table:
    """Charges of both applications, plain and guarded by the warnings."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for what in ("toll", "speed"):
            for kind in ("plain", "guarded"):
                c = env["of"][MAIN]["charging"][kind][what]
                rows.append((name, what, kind, f"{c['due']:,}", f"{c['charged']:,}", _percent(c["wrong_rate"]),
                             _percent(c["missed_rate"])))  # fmt: skip
    return ("drive", "charge", "", "due", "charged", "wrong of charged", "missed of due"), rows
