"""What ``lanebound rtk`` and a replayed RINEX pair print of their solution."""

from __future__ import annotations

from typing import Any

import typer

__all__ = ["print_rtk"]

MOST_HALVES = 0.2  # share of phases that may be off by half a cycle


def print_rtk(found: dict[str, Any]) -> None:
    """Print statistics, notes on the inputs, and errors where the true position is known."""
    from lanebound.agents.cli.output import print_table

    keys = (
        "epochs", "fixed", "fixed_share", "first_fix_s", "satellites_median", "excluded", "wrong_fix_risk_max",
        "base_from_header_m", "base_from_codes_m", "rover_from_codes_m",
    )  # fmt: skip
    rows = [(key, found[key]) for key in keys if key in found] + [
        (f"epochs {name}", n) for name, n in found["status"].items() if n
    ]
    print_table("RTK", ("", "value"), rows)
    _print_rtk_notes(found)
    errors = found.get("errors", {})
    if errors:
        head = ("epochs", "axis", "n", "largest horizontal m", "above PL", "exact 95 % interval", "median PL m")
        print_table("Errors", head, [row for name in errors for row in _bounding_rows(name, errors[name])])
        typer.echo(found["caution"])


def _print_rtk_notes(found: dict[str, Any]) -> None:
    """Print why epochs are not fixed, and what seems wrong with the inputs."""
    from lanebound.integrity.positioning.modes import RtkStatus

    place = ",".join(f"{value:.3f}" for value in found["base_antenna_ecef_m"])
    typer.echo(
        f"Positions and levels are relative to the base at {place}, from {found['base_antenna_from']}: an error of it "
        "is an error of every position, and in no level"
    )
    for name, count in found["status"].items():
        if count and name == "not_converged":
            typer.echo(f"not_converged: {found['not_converged']['what']}")
        elif count and name != "fixed":
            typer.echo(f"{name}: {RtkStatus[name.upper()].value}")
    _print_place_notes(found)
    for name, share in found["half_cycle_share"].items():
        if share > MOST_HALVES:
            typer.echo(
                f"note: {100.0 * share:.0f} % of the phases of the {name} may be off by half a cycle by their flags, "
                "and are not used",
                err=True,
            )


def _print_place_notes(found: dict[str, Any]) -> None:
    """Print where given positions do not fit the codes of a receiver, or the fixed baseline."""
    from lanebound.integrity.replay.code_places import NEAR_M

    given = found["positions_given_by"]
    remedy = "correct" if found["base_antenna_from"] == given["base"] else "give"
    places = (
        ("base", f"positions may be wrong by as much, {remedy} {given['base']} of its antenna"),
        ("rover", f"errors may be wrong by as much, correct {given['rover']} of its antenna"),
    )
    for name, what in places:
        away = found.get(f"{name}_from_codes_m") or 0.0
        if away > NEAR_M:
            typer.echo(
                f"note: the {name} is {away:.0f} m from where its own codes put it, which are good to about 10 m: "
                f"{what}",
                err=True,
            )
    fit = found.get("fixed_baseline")
    if fit is not None and fit["likely"] is not None:
        typer.echo(f"note: the fixed baseline is {fit['off_m']:.2f} m from that of the two positions: {_likely(found)}",
                   err=True)  # fmt: skip


def _likely(found: dict[str, Any]) -> str:
    fit, given = found["fixed_baseline"], found["positions_given_by"]
    if fit["likely"] == "swapped":
        return (
            f"they are probably swapped, exchanged they are {fit['off_swapped_m']:.2f} m from it; exchange "
            f"{given['base']} and {given['rover']}, or the files of rover and base"
        )
    return (
        f"one of them is probably wrong by as much, check {given['rover']} and that of the base, from "
        f"{found['base_antenna_from']}; less likely, integers are wrong"
    )


def _bounding_rows(name: str, found: dict[str, Any]) -> list[list[Any]]:
    return [
        [
            name, axis, found[axis]["epochs"], found.get("horizontal_max_m"), found[axis]["exceeded"],
            f"{found[axis]['rate_low']:.2g} to {found[axis]['rate_high']:.2g}", found[axis]["pl_median_m"],
        ]
        for axis in ("at", "ct")
    ]  # fmt: skip
