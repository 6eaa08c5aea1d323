"""Outcomes of N environments as the ``info`` of single ones, and as Gymnasium's vector environments batch it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.records_kernel import CAUSES, OUTCOME, TERMS
from lanebound.integrity.core.records import Records

__all__ = ["NAMES", "StepResult", "form_of", "info_of", "infos_of", "results", "single_info"]

FIELDS = OUTCOME.names or ()
COST, TERMINATED, TRUNCATED, MODE = (FIELDS.index(name) for name in ("cost", "terminated", "truncated", "mode"))
NUMBERS, FLAGS, CODES = FIELDS[COST:TERMINATED], FIELDS[TRUNCATED + 1 : MODE], FIELDS[MODE:]
BY_CAUSE = slice(FIELDS.index(CAUSES[0]), FIELDS.index(CAUSES[0]) + len(CAUSES))
NAMES = (*NUMBERS, *FLAGS, *CODES, "costs")
"""Entries of infos that are arrays (N,), ``costs`` (N, C)."""
Infos = dict[str, Any]
ZERO = np.zeros(())  # an array compares faster than a number


class StepResult(NamedTuple):
    """What a step has come to in N environments, a copy: arrays (N,), the last of ``rest`` (N, C).

    ``terms`` and ``rest`` are in the order in which infos name them.
    """

    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    terms: list[NDArray[np.float64]]
    rest: list[NDArray[Any]]


def results(outcome: Records, of: NDArray[np.bool_] | None = None) -> StepResult:
    """The outcomes (N,) OUTCOME of all environments; or of those ``of`` (N,), and zeros of the others."""
    rows = outcome.view((np.float64, len(FIELDS))).T.copy()
    if of is not None:
        rows[:, ~of] = 0.0
    reward, *terms = rows[:COST]
    terminated, truncated, *flags = np.greater(rows[TERMINATED:MODE], ZERO)
    rest = [*rows[COST:TERMINATED], *flags, *rows[MODE:].astype(np.int64), rows[BY_CAUSE].T.copy()]
    return StepResult(reward, terminated, truncated, terms, rest)


def form_of(mask: NDArray[np.bool_]) -> tuple[Infos, Infos]:
    """Infos still to be filled, and their ``rewards``: by ``_key`` that the environments ``mask`` (N,) have one."""
    masks = {f"_{name}": mask for name in (*NAMES, "rewards")}
    return dict.fromkeys(NAMES) | masks, dict.fromkeys(TERMS) | {f"_{name}": mask for name in TERMS}


def infos_of(found: StepResult, form: tuple[Infos, Infos], own: Mapping[str, NDArray[np.float64]]) -> Infos:
    """The info of environments: a :func:`form_of` them, which stays as it is, filled with arrays (N,) and ``costs``
    (N, C); ``own`` of plug-ins."""
    infos, terms = form[0].copy(), form[1].copy()
    infos.update(zip(NAMES, found.rest, strict=True))
    terms.update(zip(TERMS, found.terms, strict=True))
    infos["rewards"] = terms
    for name, values in own.items():
        mask = infos["_rewards"]
        infos |= {name: np.where(mask, values, 0.0), f"_{name}": mask}
    return infos


def info_of(outcome: Records, row: int) -> Infos:
    """The info of one environment: Python's own types, but ``costs`` (C,)."""
    values = outcome[row].item()
    info: Infos = dict(zip(NUMBERS, values[COST:TERMINATED], strict=True))
    info.update(zip(FLAGS, (value > 0.0 for value in values[TRUNCATED + 1 : MODE]), strict=True))
    info.update(zip(CODES, (int(value) for value in values[MODE:]), strict=True))
    info["costs"] = np.array(values[BY_CAUSE])
    info["rewards"] = dict(zip(TERMS, values[1:COST], strict=True))
    return info


def single_info(infos: Infos, row: int) -> Infos:
    """The info of one environment among those that are batched, as :func:`info_of` has it, without masks."""
    found: Infos = {}
    for name, value in infos.items():
        if name.startswith("_"):
            continue
        if isinstance(value, dict):
            found[name] = single_info(value, row)
        else:
            found[name] = value[row].item() if value.ndim == 1 else value[row].copy()
    return found
