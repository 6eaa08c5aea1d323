"""Tables of the bounding study: columns and rows of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = [
    "Table",
    "drift_rows",
    "form_rows",
    "place_rows",
    "rare_place_rows",
    "rare_rows",
    "strata_rows",
    "tightness_rows",
]

Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

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
