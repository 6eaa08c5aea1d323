"""The columns of the engine as the ``info`` of single environments, and as Gymnasium's vector environments batch it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.costs import CAUSES
from lanebound.envs.rewards import TERMS
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.step_kernel import World

__all__ = ["infos_of", "single_info"]

Rows = NDArray[np.int64]
OUT = {
    "cost": k.O_COST, **{cause: k.O_CAUSES + n for n, cause in enumerate(CAUSES)}, "tta_s": k.O_TTA,
    "err_at_m": k.O_ERR_AT, "err_ct_m": k.O_ERR_CT, "hmi_share": k.O_HMI_SHARE, "yaw_rate_radps": k.O_TURN_RATE,
}  # fmt: skip
FLAGS = {
    "mi": k.O_MI, "hmi": k.O_HMI, "crashed": k.O_IS_CRASHED, "crashed_now": k.O_CRASHED_NOW, "off_road": k.O_OFF_ROAD,
    "wrong_way": k.O_WRONG_WAY, "astray_now": k.O_ASTRAY_NOW, "is_success": k.O_SUCCESS,
}  # fmt: skip
BELIEF = {"pl_at_m": k.B_PL_AT, "pl_ct_m": k.B_PL_CT}
BELIEF_FLAGS = {"alert": k.B_ALERT, "available": k.B_AVAILABLE}
BELIEF_CODES = {"mode": k.B_MODE, "reason": k.B_REASON}


def infos_of(world: World, limits_m: tuple[float, float], rows: Rows | None = None) -> dict[str, Any]:
    """The info of all environments, or of ``rows`` with zeros elsewhere: arrays (N,) and, by ``_key``, who has one."""
    count = world.out.shape[0]
    mask = np.ones(count, dtype=np.bool_) if rows is None else np.isin(np.arange(count), rows)
    out, belief, speed = world.out, world.belief, world.cars[:, k.SPEED, 0]
    if rows is not None:
        out, belief, speed = (np.where(mask[:, None], a, 0.0) for a in (out, belief, speed[:, None]))
        speed = speed[:, 0]
    columns, own = np.ascontiguousarray(out.T), np.ascontiguousarray(belief.T)
    infos: dict[str, Any] = {name: columns[n] for name, n in OUT.items()}
    flags = columns[list(FLAGS.values())] > 0.0
    infos |= dict(zip(FLAGS, flags, strict=True))
    infos |= {name: own[n] for name, n in BELIEF.items()}
    infos |= {name: own[n] > 0.0 for name, n in BELIEF_FLAGS.items()}
    infos |= {name: own[n].astype(np.int64) for name, n in BELIEF_CODES.items()}
    for axis, limit in zip(("at", "ct"), limits_m, strict=True):
        infos[f"al_{axis}_m"] = np.where(mask, limit, 0.0)
        infos[f"margin_{axis}_m"] = infos[f"al_{axis}_m"] - infos[f"pl_{axis}_m"]
    infos["speed_mps"] = speed.copy()
    infos |= {f"_{name}": mask for name in list(infos)}
    terms = {name: columns[k.O_TERMS + n] for n, name in enumerate(TERMS)}
    infos["rewards"] = terms | {f"_{name}": mask for name in terms}
    infos["_rewards"] = mask
    return infos


def single_info(infos: dict[str, Any], row: int) -> dict[str, Any]:
    """What a single environment would have said: Python's own types, no masks."""
    found: dict[str, Any] = {}
    for name, value in infos.items():
        if name.startswith("_"):
            continue
        found[name] = single_info(value, row) if isinstance(value, dict) else value[row].item()
    return found
