"""Tables of the study of services: each case under each sky, EGNOS, PPP by the time, and the papers line by line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

__all__ = ["NO_LEVEL_M", "PUBLISHED", "convergence_rows", "mixed_rows", "published_rows", "service_rows"]

AVAILABLE = "EGNOS available"
NO_LEVEL_M = 1e4  # in place of a missing level or error

PUBLISHED = {
    "spp": "1 to 6 m (S2 Table 1)",
    "dgps": "sub-metre to a few metres (S2 Table 1)",
    "sbas_l1": "sub-metre to 1.5 m (S2 Table 1); to more than 2 m (S2 6)",
    "sisnet": "as sbas_l1 (S4 II-A)",
    "sbas_dfmc": "slightly better than L1; applications 80 % in the open (S2 6)",
    "ppp": "below 0.1 m after up to 30 min (S2 Table 1); applications nearly always in the open (S2 6)",
    "rtk": "few cm (S2 Table 1)",
    "nrtk": "few cm (S2 Table 1)",
    "s4_gps": "open: CEP 3.2 m, HPE95 8.1 m; HDOP < 3 about 80 % urban, 95 % highway (S4 III-A)",
    "s4_egnos": "open: CEP 1.9 m, HPE95 5.2 m; available 64.8 % mixed, 60 % city (S4 III-A)",
    "s4_sisnet": "available 89.2 % mixed (S4 Table IV)",
}

Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


def service_rows(result: Mapping[str, Any]) -> Table:
    """Errors, levels and shares of each case under each sky, with what the papers print."""
    rows = []
    for case in result["config"]["cases"]:
        for sky, found in result["skies"].items():
            of = found[case]
            errors, own = (
                "-" if of[cep] >= NO_LEVEL_M else f"{_metres(of[cep])} / {_metres(of[hpe95])}"
                for cep, hpe95 in (("cep_m", "hpe95_m"), ("own_cep_m", "own_hpe95_m"))
            )
            levels = ["-" if of[key] >= NO_LEVEL_M else _metres(of[key]) for key in ("pl_at_m", "pl_ct_m")]
            shown = ("service", "corrected", "accurate", "bounded", "hdop_below_3", "direct_below_3")
            shares = [f"{100.0 * of[key]:.0f} %" for key in shown]
            beyond = f"{of['beyond']:.1e}" if of["beyond"] else "0"
            first = sky == next(iter(result["skies"]))
            rows.append((
                case if first else "", sky, errors, own, *levels, *shares, beyond,
                PUBLISHED[case] if first else "",
            ))  # fmt: skip
    heads = (
        "case", "sky", "CEP / HPE95 [m]", "of its mode [m]", "PL along", "PL across", "of its mode", "corrected",
        "error < 1.5 m", "levels < 1.5 m", "HDOP < 3", "of direct signals", "beyond", "published",
    )  # fmt: skip
    return heads, rows


def mixed_rows(result: Mapping[str, Any]) -> Table:
    """How long corrections and corrected positions are available on the mean of all skies, beside S4 Table IV."""
    printed = {"s4_egnos": "64.8 %", "s4_sisnet": "89.2 %"}
    rows: list[tuple[str, ...]] = []
    for case in (case for case in printed if case in result["config"]["cases"]):
        of = [sky[case] for sky in result["skies"].values()]
        shares = (f"{100.0 * np.mean([found[key] for found in of]):.1f} %" for key in ("corrected", "available"))
        rows.append((case, *shares, f"{100.0 * of[-1]['available']:.1f} %", printed[case]))
    last = result["config"]["skies"][-1]
    heads = ("case", "corrected, mean of skies", "and a position", f"the same, {last}", "S4, mixed circuit")
    return heads, rows


def convergence_rows(result: Mapping[str, Any]) -> Table:
    """Error and level of PPP by the time at rest; S2 Table 1: below 0.1 m after up to 30 min."""
    found, last = result["ppp"], result["config"]["ppp_minutes"]
    rows: list[tuple[str, ...]] = [
        (
            f"{minute}", *(_metres(found[key][minute - 1]) for key in ("rms_m", "largest_m", "level_m")),
            f"{100.0 * found['beyond'][minute - 1]:.1f} %",
        )
        for minute in sorted({1, 2, 5, 10, 15, 20, 30, last})
        if minute <= last
    ]  # fmt: skip
    return ("time [min]", "error on an axis, rms [m]", "largest [m]", "median level [m]", "beyond"), rows


def published_rows(result: Mapping[str, Any]) -> Table:
    """Each figure of S2 Table 1, S2 section 6 and S4 III-A beside that of this study, as far as its cases were run."""
    return ("figure", "sky", "published", "here"), [*_error_rows(result), *_share_rows(result)]


def _error_rows(result: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Errors, 50 % and 95 %, under the easiest and the hardest sky but ``dense``, and of PPP at rest."""
    printed = (
        ("spp", "1 to 6 m, S2"), ("dgps", "sub-metre to a few metres, S2"), ("sbas_l1", "sub-metre to 1.5 m, S2"),
        ("sbas_dfmc", "slightly better than L1, S2"), ("rtk", "few cm, S2"), ("nrtk", "few cm, S2"),
        ("s4_gps", "3.2 / 8.1 m, S4"), ("s4_egnos", "1.9 / 5.2 m, S4"),
    )  # fmt: skip
    for case, text in printed:
        for sky in ("open",) if case.startswith("s4") else ("open", "urban"):
            found = result["skies"].get(sky, {}).get(case)
            if found is not None:
                yield (
                    f"{case}, error 50 / 95 %",
                    sky,
                    text,
                    f"{_metres(found['cep_m'])} / {_metres(found['hpe95_m'])} m",
                )
    if "ppp" in result:
        rms = result["ppp"]["rms_m"]
        below = next((str(k + 1) for k, value in enumerate(rms) if value < 0.1), "never")
        text = f"{_metres(rms[-1])} m after {len(rms)} min, below 0.1 m after {below} min"
        yield "ppp at rest, error on an axis, rms", "open", "below 0.1 m after up to 30 min, S2", text


def _share_rows(result: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Shares of the time [%]: applications, HDOP and EGNOS."""
    printed = (
        ("sbas_dfmc", "accurate", "open", "about 80 %, S2"), ("sbas_dfmc", "accurate", "dense", "low, S2"),
        ("ppp", "accurate", "open", "nearly always, S2"), ("ppp", "accurate", "dense", "low, S2"),
        ("s4_gps", "direct_below_3", "open", "95 % on the highway, S4"),
        ("s4_gps", "direct_below_3", "urban", "about 80 % in the city, S4"),
        ("s4_egnos", "available", "dense", "about 60 % in the city, S4"),
    )  # fmt: skip
    names = {
        "accurate": "error < 1.5 m",
        "direct_below_3": "HDOP < 3 by direct signals",
        "available": "EGNOS available",
    }
    for case, key, sky, text in printed:
        found = result["skies"].get(sky, {}).get(case)
        if found is not None:
            yield f"{case}, {names[key]}", sky, text, f"{100.0 * found[key]:.1f} %"
    for case, _, available, _, text in mixed_rows(result)[1]:
        yield f"{case}, {AVAILABLE}", "mean of all", f"{text}, S4", available


def _metres(value: float) -> str:
    """A length with three significant digits, and no fewer than those before the point.

    >>> _metres(0.0412), _metres(0.5), _metres(15.83), _metres(1234.5)
    ('0.0412', '0.500', '15.8', '1234')
    """
    return f"{value:.0f}" if value >= 999.5 else f"{value:#.3g}".rstrip(".")
