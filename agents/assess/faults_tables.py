"""Tables of the fault campaign: columns and rows of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lanebound.agents.assess.bounding_tables import Table

__all__ = ["consistency_rows", "control_lines", "fault_rows", "theory_rows"]


def fault_rows(result: Mapping[str, Any]) -> Table:
    """One row for each fault: vehicles of all, but for the rate of HMI, which is of epochs."""
    columns = (
        "fault", "noticed", "after [s]", "once over", "excluded", "slipped", "alerted", "error > AL", "late alerts",
        "misled", "HMI", "HMI rate", "largest [m]", "lost at end",
    )  # fmt: skip
    return columns, [_fault_row(cell) for cell in result["faults"]]


def _fault_row(cell: Mapping[str, Any]) -> tuple[str, ...]:
    unit, of = cell["unit"], cell["vehicles"]
    size = f" {cell['size']:g} {unit}" if unit else ""
    after = cell["noticed_median_s"]
    profile = cell["profile"]
    if profile == "ramp":
        profile += f" of {cell['size'] / cell['ramp_s']:g} {unit}/s for {cell['ramp_s']:g} s"
    return (
        f"{cell['kind'].replace('_', ' ')}{size}, {profile}, {cell['duration_s']:g} s",
        f"{cell['noticed']['events']}/{of}",
        "-" if after is None else f"{after:.1f}",
        f"{cell['noticed_after']}/{of}",
        f"{cell['excluded']}/{of}",
        f"{cell['given_up']}/{of}",
        f"{cell['alerted']}/{of}",
        f"{cell['failed']}/{of}",
        f"{cell['failed_without_timely_alert']['events']}/{of}",
        f"{cell['misled_vehicles']['events']}/{of}",
        f"{cell['hazardous_vehicles']['events']}/{of}",
        f"{cell['hazardous']['rate']:.2g}",
        f"{cell['worst_m']:.2f}",
        f"{cell['lost']}/{of}",
    )


def consistency_rows(result: Mapping[str, Any]) -> Table:
    """Normalised squared errors by mode (their mean is 2 for a covariance that is exact), and how tight levels are."""
    rows = []
    for mode, found in result["control"]["modes"].items():
        if found is not None:
            tight = found["level_over_least_bound"]
            shown = (f"{tight[axis]:.2f}" if tight[axis] is not None else "-" for axis in ("along", "across"))
            rows.append(
                (mode, f"{found['epochs']:,}", f"{found['mean_nees']:.2f}", f"{found['beyond_95']:.3f}", *shown)
            )
    return ("mode", "epochs", "mean NEES", "beyond 95 %", "PL/least AT", "PL/least CT"), rows


def theory_rows(result: Mapping[str, Any]) -> Table:
    """The power of detection by the size of a bias, in minimal detectable ones, beside theory."""
    columns = ("satellites", "bias/MDB", "theory", "own test", "noticed", "excluded rightly", "epochs")
    rows = []
    for found in result["theory"]:
        for row in found["by_factor"]:
            shares = (f"{row[key]['rate']:.4f}" for key in ("own", "noticed", "right"))
            epochs = f"{row['noticed']['trials']:,}"
            rows.append((str(found["satellites"]), f"{row['factor']:g}", f"{row['theory']:.4f}", *shares, epochs))
    return columns, rows


def control_lines(result: Mapping[str, Any]) -> list[str]:
    """False alarms against their allocation, alerts and misleading epochs without faults."""
    control = result["control"]

    def share(name: str) -> str:
        found = control[name]
        return f"{found['rate']:.3g} of {found['trials']:,} epochs (correlated)"

    allocated = f"{control['allocated_false_alarm']:g} a test"
    return [
        f"Satellites excluded without a fault: {share('excluded')}; allocated {allocated}.",
        f"Alerts without a fault: {share('alerts')}. Error beyond its level: {share('misleading')}.",
    ]
