"""Rate of errors beyond the level without an alarm under the worst bias of the worst code, by Monte Carlo.

``python tests/helpers/worst_bias.py`` prints the table of docs/monitors.md.
"""

from __future__ import annotations

import sys

import numpy as np
from code_geometry import directions

from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch

SIGMA_M, BIASES = 2.0, np.linspace(0.0, 10.0, 21)
SKIES = {
    5: directions([0, 70, 150, 220, 300], [20, 50, 30, 60, 75]),
    7: directions([0, 50, 100, 160, 210, 260, 310], [15, 40, 25, 60, 35, 20, 70]),
    9: directions(np.linspace(0, 330, 9), [20, 70, 35, 15, 50, 65, 25, 40, 30]),
}


def worst_code(codes: int) -> tuple[CodeEpochs, int, float]:
    """An epoch of the sky, its code of the largest slope, and ``sqrt(R_ii)`` of that one."""
    e = CodeEpochs.of(np.zeros((1, codes)), SKIES[codes], SIGMA_M)
    fit = solve_codes(e)
    worst = int(fit.slopes()[0].argmax())
    return e, worst, float(np.sqrt(fit.redundancy[0, worst]))


def beyond(kind: str, codes: int, risk: float, size: float, trials: int, seed: int = 5) -> tuple[float, float]:
    """Rates of usable epochs with an error beyond the level, and of those without an alarm, at a bias of the worst code
    of ``size`` deviations of its test."""
    e, worst, root = worst_code(codes)
    y = SIGMA_M * np.random.default_rng(seed).normal(size=(trials, codes))
    y[:, worst] += SIGMA_M * size / root
    v = watch(
        CodeEpochs.of(y, np.broadcast_to(e.los_enu, (trials, codes, 3)), SIGMA_M), monitor_named(kind).config(), risk
    )
    error = np.hypot(*v.position_enu_m[:, :2].T)
    return float((v.usable & (error > v.hpl_m[:, 0])).mean()), float((~v.alarm).mean())


def worst_rate(kind: str, codes: int, risk: float = 1e-3, trials: int = 20_000) -> float:
    """The largest rate of errors beyond the level over biases of all sizes."""
    return max(beyond(kind, codes, risk, size, trials)[0] for size in BIASES)


if __name__ == "__main__":
    for name in sys.argv[1:] or ("residual", "weighted", "uncertainty", "separation", "separation_root"):
        print(name, *(f"{codes}: {worst_rate(name, codes):.2g}" for codes in SKIES), sep="  ")
