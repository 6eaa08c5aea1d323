"""Totals of the running episodes of N environments, from which their statistics are computed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.costs import CAUSES
from lanebound.integrity.positioning.modes import Mode

__all__ = ["EPISODE_KEY", "EpisodeTotals"]

EPISODE_KEY = "episode_integrity"
SUMS = ("cost", *CAUSES)
COUNTS = ("available", "mi", "hmi", "alert")
AXES = ("at", "ct")


class EpisodeTotals:
    """Sums over the steps of the running episodes.

    Parameters
    ----------
    count : number N of environments
    """

    def __init__(self, count: int) -> None:
        self._rows = np.arange(count)
        self._steps = np.zeros(count, dtype=np.int64)
        self._reward = np.zeros(count)
        self._speed_mps = np.zeros(count)
        self._sums = np.zeros((count, len(SUMS)))
        self._counts = np.zeros((count, len(COUNTS)), dtype=np.int64)
        self._alerts = np.zeros(count, dtype=np.int64)
        self._alerted = np.zeros(count, dtype=np.bool_)
        self._modes = np.zeros((count, len(Mode)), dtype=np.int64)
        self._worst_m = np.zeros((count, len(AXES)))
        self._levels_m = np.zeros((count, len(AXES)))
        self._levelled = np.zeros((count, len(AXES)), dtype=np.int64)

    def add(self, reward: float | NDArray[Any], info: Mapping[str, Any]) -> None:
        """Add a step: rewards (N,), and ``info`` with entries (N,), or plain values of a single environment."""
        self._steps += 1
        self._reward += reward
        self._speed_mps += info["speed_mps"]
        self._sums += _columns(info, SUMS)
        self._counts += _columns(info, COUNTS) > 0.0
        alert = np.asarray(info["alert"])
        self._alerts += alert & ~self._alerted
        self._alerted[:] = alert
        self._modes[self._rows, info["mode"]] += 1
        np.maximum(self._worst_m, np.abs(_columns(info, [f"err_{axis}_m" for axis in AXES])), out=self._worst_m)
        levels_m = _columns(info, [f"pl_{axis}_m" for axis in AXES])
        there = np.isfinite(levels_m)
        self._levels_m += np.where(there, levels_m, 0.0)
        self._levelled += there

    def report(self, row: int, is_success: bool) -> dict[str, Any]:
        """Statistics of the episode of an environment, as plain values."""
        steps = int(self._steps[row])
        available, mi, hmi, alert = self._counts[row].tolist()
        levelled = self._levelled[row]
        mean_m = np.where(levelled > 0, self._levels_m[row] / np.maximum(levelled, 1), np.inf).tolist()
        return {
            "return": float(self._reward[row]),
            "length": steps,
            "is_success": is_success,
            "speed_mean_mps": float(self._speed_mps[row]) / steps,
            **dict(zip(SUMS, self._sums[row].tolist(), strict=True)),
            "availability": available / steps,
            "mi_steps": mi,
            "hmi_steps": hmi,
            "alert_share": alert / steps,
            "alerts": int(self._alerts[row]),
            "mode_shares": {
                mode.key: count / steps for mode, count in zip(Mode, self._modes[row].tolist(), strict=True)
            },
            **{f"err_{axis}_max_m": worst for axis, worst in zip(AXES, self._worst_m[row].tolist(), strict=True)},
            **{f"pl_{axis}_mean_m": mean for axis, mean in zip(AXES, mean_m, strict=True)},
        }

    def clear(self, rows: Any = slice(None)) -> None:
        """Reset the totals of all environments or of ``rows``."""
        for array in vars(self).values():
            if array is not self._rows:
                array[rows] = 0


def _columns(info: Mapping[str, Any], names: Any) -> NDArray[np.float64]:
    """Entries as columns, (N, names) or (names,)."""
    return np.stack([np.asarray(info[name], dtype=np.float64) for name in names], axis=-1)
