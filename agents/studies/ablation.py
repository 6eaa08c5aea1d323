"""The urban drive with its chosen constants taken away one by one: how many cells of S1's tables each of them buys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import OnProgress, RunProgress, ignore
from lanebound.agents.studies.urban_drive import UrbanDriveConfig
from lanebound.agents.studies.urban_drive_study import PACKAGES, check_drive, lookup, rows_against_paper, run_study
from lanebound.integrity.positioning.motion_config import DopplerConfig
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.sensors.gnss import GnssConfig

__all__ = ["ABLATIONS", "Ablation", "ablation_rows", "run_ablation"]

WHITE_S = 0.01  # correlation time far below an epoch
SHOWN = {
    "RTK error along, across [m]": (("error", "rtk", "median_at_m"), ("error", "rtk", "median_ct_m")),
    "RTK PL at 1e-6 [m]": (("pl_median", "rtk", "at_m", "1e-6"), ("pl_median", "rtk", "ct_m", "1e-6")),
    "Doppler PL at 1e-6 [m]": (("pl_median", "doppler", "at_m", "1e-6"), ("pl_median", "doppler", "ct_m", "1e-6")),
}


@dataclass(frozen=True)
class Ablation:
    """A variant of the study: its name, what is taken away, and the changes of ``navigator`` that do it."""

    name: str
    text: str
    navigator: Mapping[str, Any] = field(default_factory=dict)


def _positioning(part: str, **values: Any) -> dict[str, Any]:
    return {"positioning": {part: values}}


_DOPPLER_SIGMA = _positioning("doppler", sigma_mps=DopplerConfig().sigma_mps)
_PHASE_SIGMA = _positioning("rtk", sigma_phase_integrity_m=RtkConfig().sigma_phase_integrity_m)
_WHITE = {"gnss": {"range_rate_tau_s": WHITE_S}, **_positioning("doppler", tau_range_s=[WHITE_S, WHITE_S])}
_NO_OFFSET = {"gnss": {"reference_offset_m": 0.0}, **_positioning("rtk", reference_bias_m=0.0)}

ABLATIONS = (
    Ablation("shipped", "nothing"),
    Ablation("no-offset", "offset of the reference coordinates, and its bound", _NO_OFFSET),
    Ablation("default-doppler", "declared Doppler sigma of 0.33 m/s: default", _DOPPLER_SIGMA),
    Ablation(
        "default-doppler-noise",
        "simulated and declared Doppler sigma: defaults",
        {**_DOPPLER_SIGMA, "gnss": {"range_rate_sigma_mps": GnssConfig().range_rate_sigma_mps}},
    ),
    Ablation("white-doppler", "correlation of Doppler errors, simulated and declared", _WHITE),
    Ablation("unknown-tau", "knowledge of that time: 0.1 to 10 s", _positioning("doppler", tau_range_s=[0.1, 10.0])),
    Ablation("no-outages", "outages of the link", {"corrections": {"outage_per_h": 0.0}}),
    Ablation("default-phase", "declared phase sigma of 27 mm: default", _PHASE_SIGMA),
)
"""The study as shipped, and without each of its constants."""


def run_ablation(config: UrbanDriveConfig, out: Path, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Run every variant in a folder of its own below ``out``, and write ``ablation.json``; returns its data.

    Raises
    ------
    InputError
        A variant cannot be driven, or a folder cannot be claimed.
    """
    check_drive(config)
    ResultFolder(out, "urban drive ablation", config.to_dict(), code_digest(*PACKAGES)).claim()
    variants = []
    for k, one in enumerate(ABLATIONS):

        def report(progress: RunProgress, before: int = k) -> None:
            of = progress.of * len(ABLATIONS)
            on_progress(replace(progress, of=of, done=progress.done + before * progress.of, left_s=None))

        changed = config.replace(navigator=dict(one.navigator))
        tables = run_study(changed, out / one.name, report, masks=out / "masks")
        rows = rows_against_paper(tables)
        variants.append(
            {"name": one.name, "without": one.text, "met": sum(row["met"] for row in rows), "of": len(rows)}
            | {"outside": [row["figure"] for row in rows if not row["met"]]}
            | {key: [lookup(tables, path) for path in paths] for key, paths in SHOWN.items()}
        )
    result = {"seeds": config.seeds, "minutes": config.minutes, "variants": variants}
    write_json(out / "ablation.json", result)
    return result


def ablation_rows(result: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """What is taken away, cells met, and median errors and levels of RTK and Doppler."""
    rows = [
        (one["without"], f"{one['met']} of {one['of']}", *(_pair(one[key]) for key in SHOWN))
        for one in result["variants"]
    ]
    return ("taken away", "cells", *SHOWN), rows


def _pair(values: list[float | None]) -> str:
    return ", ".join("-" if value is None else f"{value:.3f}" for value in values)
