"""Error of an accelerometer after switch-on, ``e(t) = C1 (1 - exp(-t / tau)) + C2`` (S4 section II-C5), and its fit.

A log shows tau if it is not much shorter: of S4's law with its noise at 10 Hz, 1,000 s give tau to 15 %, 2,000 s to 6 %
(1 sigma). Where a log does not show a warm-up, its fit is a constant: of 600 s two times in three, of 300 s always.

S4 prints C1 -0.0043 m/s^2, C2 -0.007 m/s^2 and tau 500 s, and states that the position drifted by 55 m in 60 s without
correction and by 0.7 m with it. The law with these figures gives 12.9 m in 60 s from switch-on (20.3 m once it has
settled, error 11.3 mm/s^2), so that the 55 m have another cause or begin at another speed. Both are stated.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.recorded.source import Lines, in_order

__all__ = ["PUBLISHED", "InertialErrorLaw", "InertialFit", "drift_m", "fit_inertial_law", "read_static_log"]

Array = NDArray[np.float64]
LEAST_ROWS = 10
LONGEST_STEP_S, LONGEST_LOG_S = 5.0, 1e5  # no log of a sensor is so slow and so long
LARGEST_MPS2 = 1.0  # mean of a log without gravity; ten times the errors of consumer sensors
LONGEST, SHORTEST = 2.0, 0.01  # tau over the length of the log: beyond, an exponential is a line or a step
SIGMAS = 3.0  # C1 and tau must exceed so many of their sigmas


@dataclass(frozen=True)
class InertialErrorLaw:
    """C1, C2 [m/s^2] and tau [s]."""

    c1_mps2: float
    c2_mps2: float
    tau_s: float

    def error_mps2(self, time_s: ArrayLike) -> Array:
        """``e(t)`` (...,) [m/s^2], t since switch-on."""
        return np.asarray(self.c1_mps2 * -np.expm1(-np.asarray(time_s, dtype=np.float64) / self.tau_s) + self.c2_mps2)

    def drift_m(self, time_s: ArrayLike) -> Array:
        """Its double integral from switch-on (...,) [m]: ``(C1 + C2) t^2/2 - C1 tau (t - tau (1 - exp(-t/tau)))``."""
        t, tau = np.asarray(time_s, dtype=np.float64), self.tau_s
        return np.asarray(
            0.5 * (self.c1_mps2 + self.c2_mps2) * t * t - self.c1_mps2 * tau * (t + tau * np.expm1(-t / tau))
        )


PUBLISHED = InertialErrorLaw(-0.0043, -0.007, 500.0)
"""S4 section II-C5."""


@dataclass(frozen=True)
class InertialFit:
    """A fitted law; sigma (3,) of C1, C2 [m/s^2] and tau [s] from the normal matrix, for white noise; ``reason`` why it
    is a constant: C1 is 0 and its sigma and that of tau mean nothing, or None."""

    law: InertialErrorLaw
    sigma: tuple[float, float, float]
    reason: str | None = None


def fit_inertial_law(time_s: ArrayLike, acceleration_mps2: ArrayLike) -> InertialFit:
    """The law with the least mean squared error, by Nelder and Mead's simplex (S4 section II-C5).

    A constant where C1 or tau does not exceed three of its sigmas, or tau lies beyond 0.01 to 2 lengths of the log.

    Parameters
    ----------
    time_s, acceleration_mps2 : (n,) of a static test, without gravity; time since switch-on

    Raises
    ------
    InputError
        Fewer than 10 rows, shapes that differ, entries that are not finite, times that do not increase, or a mean above
        1 m/s^2.
    """
    t, a = require_finite("time_s", time_s), require_finite("acceleration_mps2", acceleration_mps2)
    if t.ndim != 1 or t.shape != a.shape or t.size < LEAST_ROWS:
        raise InputError(f"time_s and acceleration_mps2 must both have n >= {LEAST_ROWS} rows, got {t.shape} and "
                         f"{a.shape}: give one acceleration for each time")  # fmt: skip
    if not (np.diff(t) > 0.0).all():
        raise InputError("time_s must increase from row to row, it does not: sort the rows and remove repeated ones")
    if abs(float(a.mean())) > LARGEST_MPS2:
        raise InputError(f"acceleration_mps2 must have a mean within {LARGEST_MPS2:g} m/s^2, got {a.mean():.3g}: "
                         "subtract gravity, and leave the sensor at rest")  # fmt: skip
    span, unit = float(t[-1] - t[0]), float(np.abs(a).max())
    constant = InertialErrorLaw(0.0, float(a.mean()), span)
    error = float(a.std()) / np.sqrt(t.size)
    if float(a.std()) <= 1e-9 * max(unit, 1e-12):
        return InertialFit(constant, (0.0, error, 0.0), "the log is constant")
    law = _simplex(t, a, span, unit)
    sigma = _sigmas(t, a, law)
    reason = _unseen(law, sigma, span)
    return InertialFit(law, sigma) if reason is None else InertialFit(constant, (0.0, error, 0.0), reason)


def _simplex(t: Array, a: Array, span: float, unit: float) -> InertialErrorLaw:
    """The best of three starts; tau between its bounds."""
    from scipy.optimize import minimize  # as in significance.py

    part = max(t.size // 20, 1)
    first, last = float(a[:part].mean()), float(a[-part:].mean())
    low, high = np.log(SHORTEST), np.log(LONGEST)

    def law_of(p: Array) -> InertialErrorLaw:
        return InertialErrorLaw(unit * float(p[0]), unit * float(p[1]), span * float(np.exp(np.clip(p[2], low, high))))

    def squared(p: Array) -> float:
        return float(np.mean(np.square(a - law_of(p).error_mps2(t)))) / unit**2

    options: Any = {"xatol": 1e-10, "fatol": 1e-18, "maxiter": 20_000, "maxfev": 20_000}
    starts = (np.array([(last - first) / unit, first / unit, np.log(share)]) for share in (0.1, 0.5, 1.5))
    best = min((minimize(squared, start, method="Nelder-Mead", options=options) for start in starts),
               key=lambda found: float(found.fun))  # fmt: skip
    return law_of(best.x)


def _sigmas(t: Array, a: Array, law: InertialErrorLaw) -> tuple[float, float, float]:
    """1-sigma of C1, C2, tau from the normal matrix and what is left; inf where it is singular."""
    ratio = t / law.tau_s
    rows = np.stack([-np.expm1(-ratio), np.ones_like(t), -law.c1_mps2 * ratio * np.exp(-ratio) / law.tau_s], -1)
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    normal = (rows / scale).T @ (rows / scale)
    if np.linalg.cond(normal) > 1e12:
        return math.inf, math.inf, math.inf
    left = float(np.sum(np.square(a - law.error_mps2(t)))) / max(t.size - 3, 1)
    sigma = np.sqrt(left * np.diagonal(np.linalg.inv(normal))) / scale
    return float(sigma[0]), float(sigma[1]), float(sigma[2])


def _unseen(law: InertialErrorLaw, sigma: tuple[float, float, float], span: float) -> str | None:
    """Why the log does not show a warm-up, or None."""
    longer = "log for two tau or more, 1,000 s for S4's sensor"
    if not SHORTEST * 1.001 < law.tau_s / span < LONGEST * 0.999:
        return f"tau is not within {SHORTEST:g} to {LONGEST:g} lengths of the log ({span:g} s): {longer}"
    for name, value, one in (("C1", law.c1_mps2, sigma[0]), ("tau", law.tau_s, sigma[2])):
        if not abs(value) > SIGMAS * one:
            return f"{name} = {value:.3g} has a sigma of {one:.2g}: {longer}"
    return None


def drift_m(time_s: Array, acceleration_mps2: Array, after_s: float = 60.0) -> float:
    """Position after ``after_s`` from rest under accelerations (n,), integrated twice by trapezoids [m].

    Raises
    ------
    InputError
        The log is shorter.
    """
    if time_s[-1] - time_s[0] < after_s - 1e-9:
        raise InputError(f"after_s must be <= {time_s[-1] - time_s[0]:g}, the length of the log, got {after_s:g}")
    part = time_s - time_s[0] <= after_s + 1e-9
    dt, a = np.diff(time_s[part]), acceleration_mps2[part]
    speed = np.concatenate([[0.0], np.cumsum(0.5 * dt * (a[1:] + a[:-1]))])
    return float(np.sum(0.5 * dt * (speed[1:] + speed[:-1]) + dt**2 * (a[:-1] - a[1:]) / 12.0))


def read_static_log(path: Path) -> tuple[Array, dict[str, Array], str]:
    """Times (n,) and the columns of accelerations (n,) by name, of a table with a head and the time first, plain or
    gzip, between commas, semicolons or tabs; and a note on rows that are left out and on gaps, "" for none.

    Raises
    ------
    InputError
        The file is absent, or is no such table in seconds whose times ascend.
    """
    if not path.is_file():
        raise InputError(f"LOG must be a file that exists, got {path}: correct the path")
    lines = Lines(path)
    rows = [[cell.strip() for cell in re.split(r"[,;\t]", text)] for text in lines if text.strip()]
    if len(rows) <= LEAST_ROWS or len(rows[0]) < 2:
        raise InputError(f"{path} must have a head, a time and an acceleration column and {LEAST_ROWS} rows or more, "
                         f"got {len(rows)} rows: write time_s,accel_mps2 and one line for each sample")  # fmt: skip
    try:
        table = np.array(rows[1:], dtype=np.float64)
    except ValueError:
        raise InputError(f"{path} must hold numbers below its head, it does not: correct the lines") from None
    keep, timing = in_order(path, table[:, 0], rows=table)
    table = table[keep]
    step = float(np.median(np.diff(table[:, 0])))
    if step > LONGEST_STEP_S and float(np.ptp(table[:, 0])) > LONGEST_LOG_S:
        raise InputError(
            f"{path} must have its times in s, they are {step:g} apart: are they in ms or us? Convert them"
        )
    note = "; ".join(text for text in (str(lines.stop or ""), timing.note) if text)
    return table[:, 0], {name: table[:, k] for k, name in enumerate(rows[0]) if k > 0}, note
