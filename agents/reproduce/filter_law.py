"""S4's fit of the error of an accelerometer (section II-C5): static logs made by its law, with the noise it states.

A least-squares fit with a free constant leaves a mean error of 0. S4 states -3.2e-4 m/s^2 after its fit, which alone
drifts by 0.58 m in 60 s, most of its 0.7 m: that mean is of other data than the fit, or the fit had not converged.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sensors.inertial_law import PUBLISHED, drift_m, fit_inertial_law

__all__ = ["law_rows", "work_law"]

LOG_S, STEP_S = 2000.0, 0.1  # four times tau; S4 states neither
NOISE_MPS2 = 0.0033  # standard deviation after the fit, S4
AFTER_S = 60.0
PAPER = {
    "C1 [m/s^2]": PUBLISHED.c1_mps2, "C2 [m/s^2]": PUBLISHED.c2_mps2, "tau [s]": PUBLISHED.tau_s,
    "mean left [m/s^2]": -3.2172e-4, "deviation left [m/s^2]": NOISE_MPS2,
    "drift in 60 s, uncorrected [m]": 55.0, "drift in 60 s, corrected [m]": 0.7,
}  # fmt: skip
"""What S4 states."""


def work_law(logs: int, first_seed: int, advance: Advance = ignore) -> dict[str, list[float]]:
    """5 %, median and 95 % over logs of what S4 states; drifts without sign."""
    time_s = np.arange(0.0, LOG_S, STEP_S)
    found = []
    for k in range(logs):
        noise = NOISE_MPS2 * named_generator(first_seed + k, "static log").standard_normal(time_s.size)
        error = PUBLISHED.error_mps2(time_s) + noise
        law = fit_inertial_law(time_s, error).law
        left = error - law.error_mps2(time_s)
        drifts = (abs(drift_m(time_s, a, AFTER_S)) for a in (error, left))
        found.append([law.c1_mps2, law.c2_mps2, law.tau_s, left.mean(), left.std(), *drifts])
        advance((k + 1) / logs)
    spread = np.quantile(np.array(found), [0.05, 0.5, 0.95], axis=0).T
    return {name: values.tolist() for name, values in zip(PAPER, spread, strict=True)}


def law_rows(found: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Rows: figure, S4, ours with 5 and 95 %."""
    return [
        (name, f"{PAPER[name]:g}", f"{middle:.4g}", f"{low:.4g} .. {high:.4g}")
        for name, (low, middle, high) in found.items()
    ]
