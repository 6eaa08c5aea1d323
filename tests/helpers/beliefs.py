"""What an ego believes, for tests that need one: plain defaults, and whatever a test changes of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.records import EgoBelief
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus

__all__ = ["believe"]

LANE = ("a", "b", 0)


def believe(**changes: Any) -> EgoBelief:
    """At rest at the beginning of the lane a, b, 0 of 4 m, in RTK, without an alert, its target the lane it is in."""
    plain: dict[str, Any] = dict.fromkeys(EgoBelief.__dataclass_fields__, 0.0) | {
        "position_m": np.zeros(2),
        "fix_position_m": np.zeros(2),
        "lane_index": LANE,
        "lane_width_m": 4.0,
        "pl_at_m": 0.5,
        "pl_ct_m": 0.3,
        "al_at_m": 1.5,
        "al_ct_m": 1.0,
        "mode": int(Mode.RTK),
        "rtk": RtkStatus.FIXED.code,
        "reason": AlertReason.NONE.code,
        "alert": False,
        "available": True,
        "satellites": 12,
        "satellites_doppler": 12,
        "excluded": 0,
        "hdop": 1.0,
    }
    plain["target_lane_index"] = changes.get("lane_index", LANE)
    return EgoBelief(**(plain | changes))
