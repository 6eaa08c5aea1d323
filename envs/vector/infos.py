"""The columns of the engine as the ``info`` of single environments, and as Gymnasium's vector environments batch it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.costs import CAUSES
from lanebound.envs.rewards import TERMS
from lanebound.envs.vector.infos_kernel import NUMBERS, fill_infos
from lanebound.envs.vector.step_kernel import World

__all__ = ["NAMES", "infos_of", "single_info"]

# names of the rows that the kernel fills, in its order; the terms of the reward have a dict of their own
BEFORE = ("cost", *CAUSES, "tta_s", "err_at_m", "err_ct_m", "hmi_share", "yaw_rate_radps")
AFTER = ("pl_at_m", "pl_ct_m", "al_at_m", "al_ct_m", "margin_at_m", "margin_ct_m", "speed_mps")
FLAGS = (
    "mi", "hmi", "crashed", "crashed_now", "off_road", "wrong_way", "astray_now", "is_success", "alert", "available",
)  # fmt: skip
CODES = ("mode", "reason")
NAMES = (*BEFORE, *AFTER, *FLAGS, *CODES)
"""Entries of infos that are arrays (N,)."""
MASKS = tuple(f"_{name}" for name in (*NAMES, "rewards"))
MASKS_OF_TERMS = tuple(f"_{name}" for name in TERMS)


def infos_of(world: World, limits_m: NDArray[np.float64], told: NDArray[np.bool_] | None = None) -> dict[str, Any]:
    """The info of all environments, or of those ``told`` of: arrays (N,), zeros elsewhere, and by ``_key`` who has one.

    limits_m : (2,) alert limits along and across
    """
    count = world.out.shape[0]
    mask = np.ones(count, dtype=np.bool_) if told is None else told
    numbers, codes = np.empty((NUMBERS, count)), np.empty((len(CODES), count), dtype=np.int64)
    flags = np.empty((len(FLAGS), count), dtype=np.bool_)
    fill_infos(mask, world.out, world.belief, world.cars, limits_m, numbers, flags, codes)
    rows = [*numbers, *flags, *codes]
    terms = rows[len(BEFORE) : len(BEFORE) + len(TERMS)]
    del rows[len(BEFORE) : len(BEFORE) + len(TERMS)]
    infos: dict[str, Any] = dict(zip(NAMES, rows, strict=True)) | dict.fromkeys(MASKS, mask)
    infos["rewards"] = dict(zip(TERMS, terms, strict=True)) | dict.fromkeys(MASKS_OF_TERMS, mask)
    return infos


def single_info(infos: dict[str, Any], row: int) -> dict[str, Any]:
    """What a single environment would have said: Python's own types, no masks."""
    found: dict[str, Any] = {}
    for name, value in infos.items():
        if name.startswith("_"):
            continue
        found[name] = single_info(value, row) if isinstance(value, dict) else value[row].item()
    return found
