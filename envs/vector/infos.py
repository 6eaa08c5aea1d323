"""The engine's columns as the ``info`` of single environments, and as Gymnasium's vector environments batch it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.costs import CAUSES
from lanebound.envs.rewards import TERMS
from lanebound.envs.vector import columns_kernel as k

__all__ = ["NAMES", "Told", "form_of", "infos_of", "single_info", "told"]

# names of the columns of ``out`` from the terms of the reward on, in their order; those have a dict of their own
NUMBERS = (
    "cost", *CAUSES, "tta_s", "err_at_m", "err_ct_m", "hmi_share", "yaw_rate_radps", "pl_at_m", "pl_ct_m", "al_at_m",
    "al_ct_m", "margin_at_m", "margin_ct_m", "speed_mps",
)  # fmt: skip
FLAGS = (
    "mi", "hmi", "crashed", "crashed_now", "off_road", "wrong_way", "astray_now", "is_success", "alert", "available",
)  # fmt: skip
CODES = ("mode", "reason")
NAMES = (*NUMBERS, *FLAGS, *CODES)
"""Entries of infos that are arrays (N,)."""
Infos = dict[str, Any]


class Told(NamedTuple):
    """What a step has come to in N environments, a copy: arrays (N,); ``terms`` and ``rest`` as infos name them."""

    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    terms: list[NDArray[np.float64]]
    rest: list[NDArray[Any]]


def told(out: NDArray[np.float64], of: NDArray[np.bool_] | None = None) -> Told:
    """The columns (N, OUT) of all environments; or of those ``of`` (N,), and zeros of the others."""
    rows = out.T.copy()
    if of is not None:
        rows[:, ~of] = 0.0
    numbers, flags = list(rows[: k.O_FLAGS]), list(rows[k.O_FLAGS : k.O_CODES] > 0.0)
    codes = list(rows[k.O_CODES :].astype(np.int64))
    return Told(numbers[0], flags[0], flags[1], numbers[k.O_TERMS : k.O_COST], numbers[k.O_COST :] + flags[2:] + codes)


def form_of(mask: NDArray[np.bool_]) -> tuple[Infos, Infos]:
    """Infos still to be filled, and their ``rewards``: by ``_key`` that the environments ``mask`` (N,) have one."""
    masks = {f"_{name}": mask for name in (*NAMES, "rewards")}
    return dict.fromkeys(NAMES) | masks, dict.fromkeys(TERMS) | {f"_{name}": mask for name in TERMS}


def infos_of(found: Told, form: tuple[Infos, Infos]) -> Infos:
    """The info of environments: a :func:`form_of` them, which stays as it is, filled with arrays (N,)."""
    infos, terms = form[0].copy(), form[1].copy()
    infos.update(zip(NAMES, found.rest, strict=True))
    terms.update(zip(TERMS, found.terms, strict=True))
    infos["rewards"] = terms
    return infos


def single_info(infos: Infos, row: int) -> Infos:
    """What a single environment would have said: Python's own types, no masks."""
    found: Infos = {}
    for name, value in infos.items():
        if name.startswith("_"):
            continue
        found[name] = single_info(value, row) if isinstance(value, dict) else value[row].item()
    return found
