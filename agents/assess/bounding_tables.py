"""Tables of the bounding study: columns and rows of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["Table", "drift_rows", "form_rows", "place_rows", "rare_rows", "tightness_rows"]

Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


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
    """Each form at the least risk by biases, size, heading and the axis that biases hurt."""
    places = [(kind, place) for kind in ("bias", "size", "heading", "worst") for place in result["rates"][kind]]
    forms = list(result["rates"]["all"]["all"])
    risk = min(result["rates"]["all"]["all"][forms[0]], key=float)

    def ratio(kind: str, place: str, form: str) -> str:
        rate = result["rates"][kind][place][form][risk]["either"]["rate"]
        return "-" if rate is None else f"{rate / float(risk):.3g}"

    rows = [(place, *(ratio(kind, place, form) for form in forms)) for kind, place in places]
    return ("place", *forms), rows


def tightness_rows(result: Mapping[str, Any]) -> Table:
    """Median level of each form over the least one that would have held without faults."""
    risks = list(next(iter(result["level_over"].values())))

    def ratio(found: Mapping[str, Any] | None) -> str:
        return "-" if found is None else f"{found['median']:.2f} ({found['smallest']:.2f} .. {found['largest']:.2f})"

    rows = [(form, *(ratio(found[risk]["least"]) for risk in risks)) for form, found in result["level_over"].items()]
    return ("form", *risks), rows


def rare_rows(result: Mapping[str, Any]) -> Table:
    """Importance estimates along and across, with the standard deviations of draws and geometries."""
    rows = []
    for risk, forms in result["rare"].items():
        if risk == "spent":
            continue
        for form, found in forms.items():
            for axis in ("along", "across"):
                one = found[axis]
                rows.append((risk, form, axis, *(f"{one[key]:.2e}" for key in ("rate", "draws", "spread"))))
    return ("risk", "form", "axis", "rate", "sd of draws", "sd of geometries"), rows


def drift_rows(result: Mapping[str, Any]) -> Table:
    """Each source and variant at each risk."""
    rows = []
    for source, variants in result["drift"].items():
        for variant, found in variants.items():
            rates = tuple(over_risk(one["either"], float(risk)) for risk, one in found.items())
            rows.append((f"{source}, {variant}", *rates))
    risks = list(next(iter(next(iter(result["drift"].values())).values())))
    return ("source and form", *risks), rows
