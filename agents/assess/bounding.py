"""The rate of ``|error| > PL``: plain Monte Carlo for common risks, importance sampling for rare ones.

Three kinds of parts: ``cases-I`` draws epochs of random geometries with true probabilities, ``rare-I`` estimates the
rate at a risk that is too small for counting, ``drift-I`` draws outages without redundancy (Doppler, odometer and
heading).
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from lanebound.agents.assess.bounding_summary import summarise
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.integrity.assessment.drift_model import DriftConfig, Outage, drift_exceedance
from lanebound.integrity.assessment.exceedance import ExceedanceCounts, expected_fault_free, least_fault_free, tally
from lanebound.integrity.assessment.importance import FaultSize, expected_one_fault, importance_rates
from lanebound.integrity.assessment.measurement_model import Case, Form, Prepared, draw_case, prepare
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.risk import RiskConfig, pair_risk

__all__ = ["BoundingConfig", "assess_bounding", "part_names", "work_part"]


PACKAGES = ("lanebound.integrity", "lanebound.agents.assess")
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
    ResultFolder(out, "bounding assessment", config.to_dict(), code_digest(*PACKAGES)).claim()
    parts = run_parts(out, part_names(config), partial(work_part, config), jobs, on_progress)
    result = summarise(config.to_dict(), parts)
    write_json(out / "results.json", result)
    return result


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
