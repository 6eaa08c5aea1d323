"""How often errors exceed their protection levels in drives of the whole navigator, by sky, mode and risk.

Vehicles of one street share its city, its satellites and its faults, so that the spread between streets limits the
accuracy of a rate: its interval is that of the mean over streets, by resampling whole streets. Where no street has an
exceedance, the interval is the exact one of the share of streets that have any.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.studies.street_drives import PACKAGES, DriveMoment, StreetDrivesConfig, drive_street, work_streets
from lanebound.integrity.assessment.bounding import clopper_pearson
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.modes import Mode

__all__ = [
    "AXES",
    "FEW_STREETS",
    "InTheLoopConfig",
    "assess_in_the_loop",
    "exceedance_rows",
    "few_streets",
    "mode_rows",
    "rate_by_street",
    "rate_cell",
    "sbas_rows",
    "trust_rows",
    "work_street",
]

AXES = ("along", "across")
RESAMPLES, CONFIDENCE = 2000, 0.95
SAMPLE_S = 1.0  # between the levels that medians are taken of
NO_LEVEL_M = 1e4  # in place of a missing level, for quantiles
NEAR_M = 7.0  # a trust level below it (S4 section III-E)
FEW_STREETS = 30  # fewer say little of a rate: where none has an event, 1 in 9 of all streets may have one


class InTheLoopConfig(StreetDrivesConfig):
    """Drives, and the risks at which exceedances are counted."""

    risks: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = Field(
        (1e-3, 1e-4, 1e-5), min_length=1, description="total horizontal risks counted [-]"
    )
    epochs: int = Field(1_000_000, ge=1, description="epochs under each sky, rounded up to whole streets")

    @property
    def epochs_of_street(self) -> int:
        """Number of epochs of a street, of all its vehicles."""
        return self.vehicles * round(self.duration_s / self.navigator.dt_s)

    @property
    def streets(self) -> int:
        """Number of streets of each sky."""
        return -(-self.epochs // self.epochs_of_street)

    @property
    def rounding(self) -> str:
        """What is driven under each sky where the epochs are not those of whole streets; "" where they are."""
        if self.epochs == self.streets * self.epochs_of_street:
            return ""
        return (
            f"{self.epochs:,} epochs under each sky are rounded up to whole streets: {self.streets} of "
            f"{self.epochs_of_street:,} epochs each"
        )

    def with_levels(self) -> InTheLoopConfig:
        """The same with further protection levels at all the risks; the operative one stays that of the navigator."""
        more = [{"integrity_risk": risk} for risk in self.risks]
        return self.replace(navigator=self.navigator.replace(more_levels=more).to_dict())


def assess_in_the_loop(
    config: InTheLoopConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing streets, and write ``results.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    ResultFolder(out, "bounding in the loop", config.to_dict(), code_digest(*PACKAGES)).claim()
    found = work_streets(config, config.streets, work_street, out, jobs, on_progress)
    skies = {sky: _summary(config, streets) for sky, streets in found.items()}
    result = {"config": config.to_dict(), "skies": skies}
    write_json(out / "results.json", result)
    return result


def work_street(config: InTheLoopConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Drive one street; it does not depend on others."""
    tally, sampled = _Tally(config), []
    every = round(SAMPLE_S / config.navigator.dt_s)
    for k, moment in enumerate(drive_street(config.with_levels(), sky, number, advance)):
        tally.count(moment)
        if k % every == 0:
            sampled.append(_sample(moment))
    return tally.counts() | {"samples": np.concatenate(sampled).T.tolist()}


class _Tally:
    """Counts of a street by mode: epochs, exceedances by risk and axis, usable and misleading epochs.

    Of the trust level of a filter: epochs with one, with a horizontal error beyond it, with one below NEAR_M. Of the
    SBAS level of its positions: epochs with one, with an error of the filter beyond it, and their sum [m].
    """

    def __init__(self, config: InTheLoopConfig) -> None:
        modes, risks = max(Mode) + 1, len(config.risks)
        self.epochs, self.usable, self.misleading = np.zeros((3, modes), dtype=np.int64)
        self.exceed = np.zeros((modes, risks, 2), dtype=np.int64)
        self.trust, self.sbas = np.zeros(3, dtype=np.int64), np.zeros(3)

    def count(self, moment: DriveMoment) -> None:
        """Add an epoch."""
        s = moment.solution
        beyond = np.abs(moment.error_m)[:, None, :] > s.pl_cases_m
        np.add.at(self.epochs, s.mode, 1)
        np.add.at(self.exceed, s.mode, beyond[:, 1:])
        np.add.at(self.usable, s.mode, s.available & ~s.alert)
        np.add.at(self.misleading, s.mode, s.available & ~s.alert & beyond[:, 0].any(-1))
        off, there = np.linalg.norm(moment.error_m, axis=-1), np.isfinite(s.trust_m) & np.isfinite(s.pl_at_m)
        self.trust += [there.sum(), (there & (off > s.trust_m)).sum(), (there & (s.trust_m < NEAR_M)).sum()]
        both = there & np.isfinite(s.hpl_sbas_m)
        self.sbas += [both.sum(), (both & (off > s.hpl_sbas_m)).sum(), s.hpl_sbas_m[both].sum()]

    def counts(self) -> dict[str, Any]:
        """The counts as plain data."""
        return {
            "epochs": self.epochs.tolist(),
            "usable": self.usable.tolist(),
            "misleading": self.misleading.tolist(),
            "exceed": self.exceed.tolist(),
            "trust": self.trust.tolist(),
            "sbas": self.sbas.tolist(),
        }


def _sample(moment: DriveMoment) -> NDArray[np.float64]:
    """Mode and levels [m] at the operative risk of B vehicles, (B, 3), rounded to a tenth of a millimetre."""
    s = moment.solution
    levels = np.minimum(np.stack([s.pl_at_m, s.pl_ct_m], -1), NO_LEVEL_M)
    return np.round(np.column_stack([s.mode, levels]), 4)


def _summary(config: InTheLoopConfig, streets: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rates, modes and medians of a sky."""
    epochs = np.array([street["epochs"] for street in streets])
    exceed = np.array([street["exceed"] for street in streets])
    mode, along, across = np.concatenate([np.array(street["samples"]).T for street in streets]).T
    found = {
        "streets": len(streets),
        "epochs": int(epochs.sum()),
        "usable": float(sum(sum(street["usable"]) for street in streets) / epochs.sum()),
        "misleading": rate_by_street(np.array([sum(street["misleading"]) for street in streets]), epochs.sum(1)),
        "level_m": [float(np.median(along)), float(np.median(across))],
        "rates": {
            f"{risk:g}": {axis: rate_by_street(exceed[:, :, r, a].sum(1), epochs.sum(1)) for a, axis in enumerate(AXES)}
            for r, risk in enumerate(config.risks)
        },
    }
    with_trust, beyond, near = np.array([street["trust"] for street in streets]).T
    if with_trust.any():
        found["trust"] = rate_by_street(beyond, with_trust) | {
            "epochs": int(with_trust.sum()), "below": float(near.sum() / with_trust.sum()),
        }  # fmt: skip
    with_sbas, outside, total = np.array([street["sbas"] for street in streets]).sum(0)
    if with_sbas:
        found["sbas"] = {"epochs": int(with_sbas), "beyond": float(outside / with_sbas), "mean_m": total / with_sbas}
    return found | {"modes": _modes(epochs, exceed, mode, along, across)}


def _modes(epochs: Any, exceed: Any, mode: Any, along: Any, across: Any) -> dict[str, Any]:
    """Share, median operative levels, and rates at the first risk, by mode."""
    return {
        m.name.lower(): {
            "share": float(epochs[:, m].sum() / epochs.sum()),
            "level_m": [float(np.median(level[mode == m])) if (mode == m).any() else None for level in (along, across)],
            "rates": {axis: rate_by_street(exceed[:, m, 0, a], epochs[:, m]) for a, axis in enumerate(AXES)},
        }
        for m in Mode
        if epochs[:, m].any()
    }


def rate_by_street(events: NDArray[np.int64], epochs: NDArray[np.int64]) -> dict[str, Any]:
    """Rate of events per epoch with its interval by street; streets with an event, and the interval of their share."""
    streets, total = int((events > 0).sum()), int(events.sum())
    low, high = clopper_pearson(streets, len(events), CONFIDENCE)
    found: dict[str, Any] = {
        "events": total,
        "rate": total / max(int(epochs.sum()), 1),
        "streets": streets,
        "streets_low": low,
        "streets_high": high,
        "low": None,
        "high": None,
    }
    if streets > 1:
        chosen = named_generator(0, "resamples").integers(len(events), size=(RESAMPLES, len(events)))
        rates = events[chosen].sum(1) / np.maximum(epochs[chosen].sum(1), 1)
        tail = 0.5 * (1.0 - CONFIDENCE)
        found["low"], found["high"] = (float(q) for q in np.quantile(rates, (tail, 1.0 - tail)))
    return found


Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


def exceedance_rows(result: Mapping[str, Any]) -> Table:
    """Rate over the risk by sky, axis and risk, with streets that have any."""
    rows = []
    for sky, found in result["skies"].items():
        streets = found["streets"]
        for axis in AXES:
            cells = [rate_cell(rates[axis], float(risk), streets) for risk, rates in found["rates"].items()]
            rows.append((sky, axis, f"{found['epochs']:,}", *cells))
    risks = next(iter(result["skies"].values()))["rates"]
    return ("sky", "axis", "epochs", *(f"at {risk}" for risk in risks)), rows


def few_streets(result: Mapping[str, Any]) -> bool:
    """Whether any sky has so few streets that its rates say little."""
    return any(found["streets"] < FEW_STREETS for found in result["skies"].values())


def rate_cell(rate: Mapping[str, Any], risk: float, streets: int) -> str:
    """Rate of events over the risk with its interval, and in how many of the streets there are any."""
    few, of = streets < FEW_STREETS, f"{streets} street{'' if streets == 1 else 's'}"
    if not rate["events"]:
        return f"none in {of}" + (
            ", too few to tell" if few else f" (share of streets below {rate['streets_high']:.2g})"
        )
    band = "" if rate["low"] is None else f" ({rate['low'] / risk:.3g} .. {rate['high'] / risk:.3g})"
    return f"{rate['rate'] / risk:.3g}{band} in {rate['streets']} of {of}{', few' if few else ''}"


def mode_rows(result: Mapping[str, Any]) -> Table:
    """Share, median levels and exceedances of each mode at the first risk; misleading epochs are usable ones beyond."""
    rows = []
    for sky, found in result["skies"].items():
        everything = {"share": 1.0, "level_m": found["level_m"], "rates": next(iter(found["rates"].values()))}
        for name, mode in ({"all": everything} | found["modes"]).items():
            levels = ["-" if level is None or level >= NO_LEVEL_M else f"{level:.2f} m" for level in mode["level_m"]]
            events = [str(mode["rates"][axis]["events"]) for axis in AXES]
            usable = f"{100.0 * found['usable']:.1f} %" if name == "all" else ""
            misleading = str(found["misleading"]["events"]) if name == "all" else ""
            rows.append((sky, name, f"{100.0 * mode['share']:.1f} %", usable, misleading, *levels, *events))
    heads = "sky", "mode", "epochs", "usable", "misleading", "PL along", "PL across", "beyond along", "beyond across"
    return heads, rows


def trust_rows(result: Mapping[str, Any]) -> Table:
    """S4's horizontal trust level of filters: how often the horizontal error is beyond it; no row without one."""
    rows: list[tuple[str, ...]] = [
        (
            sky,
            f"{t['epochs']:,}",
            f"{t['events']:,} ({t['rate']:.2g})",
            str(t["streets"]),
            f"{100.0 * t['below']:.1f} %",
        )
        for sky, found in result["skies"].items()
        if (t := found.get("trust")) is not None
    ]
    return ("sky", "epochs with one", "errors beyond it (rate)", "in streets", f"below {NEAR_M:g} m"), rows


def sbas_rows(result: Mapping[str, Any]) -> Table:
    """HPL_SBAS of the positions by codes beside it: its mean, and how often the filter's error is beyond it."""
    rows: list[tuple[str, ...]] = [
        (sky, f"{s['epochs']:,}", f"{s['mean_m']:.2f} m", f"{s['beyond']:.2g}")
        for sky, found in result["skies"].items()
        if (s := found.get("sbas")) is not None
    ]
    return ("sky", "epochs with one", "mean", "errors of the filter beyond it"), rows
