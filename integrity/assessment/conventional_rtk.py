"""Conventional RTK on double differences, of one epoch and by a Kalman filter: ratio test, and no bound of its risk.

That of one epoch (float solution by code, integer least squares) is what a common receiver computes with ``ambiguity
resolution: instantaneous`` (RTKLIB manual 2.4.2, appendix E.7), without a model of motion: assessments compare its
failures on simulated signals with recorded ones. Letters: G design matrix of double differences, ``y_c = G x + e_c``,
``y_p = G x + lambda N + e_p``; with ``x^ = Q_x G' W y_c``

    N^ = (y_p - G x^) / lambda,   Q_N = (Q_p + G Q_x G') / lambda^2,   Q_xN = -Q_x G' / lambda,
    x~ = x^ - Q_xN Q_N^-1 (N^ - N).

The Kalman filter of position and ambiguities is conventional RTK as users of RTKLIB run it. States: position, velocity
and acceleration (3 each; the position alone without ``dynamics``) and one single-differenced ambiguity for each signal
with a phase, in metres. Measurements are double differences of codes and phases,

    y_c = G x + e_c,   y_p = G x + a_j - a_ref + e_p.

``instantaneous``: ambiguities begin anew in each epoch, as in ``nagoya_drive_rtk``, whose solution still filters the
motion (``dynamics: on`` in its header). ``continuous``: they stay while lock is kept, which flags of the receiver and
jumps of the geometry-free combination show. Integers by LAMBDA from the double-differenced ambiguities, accepted by the
ratio alone; they are not held. Sizes are RTKLIB's (manual 2.4.2, appendix E.7; rtkpos.c 2.4.3: ``udpos``, ``udbias``,
``ddres``, ``resamb_LAMBDA``), or those of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.positioning.ambiguity import resolve
from lanebound.integrity.sky.systems import FIXABLE

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

AXES = 3


class RtkSignals(NamedTuple):
    """Signals of S satellites at a vehicle: los (S, 3) unit vectors, elevation (S,) [rad], system (S,), cn0 (S,)
    [dB-Hz], tracked (S,), code and phase (S, F) single differences of F = 1 or 2 bands [m], 0 for none, wavelength
    (S, F) [m]."""

    los: Array
    elevation: Array
    system: Ints
    cn0: Array
    tracked: Bools
    code: Array
    phase: Array
    wavelength: Array


class DifferenceRows(NamedTuple):
    """Double differences: design (m, 3), y (m,) [m], covariance (m, m) [m^2]; satellite, reference and band (m,),
    wavelength (m,) [m]."""

    design: Array
    y: Array
    covariance: Array
    satellite: Ints
    reference: Ints
    band: Ints
    wavelength: Array


def double_differences(s: RtkSignals, values: Array, usable: Bools, variance: Array) -> DifferenceRows:
    """Double differences of ``values`` (S, F) against the highest satellite of each system and band.

    usable (S, F); variance (S,) of a single difference [m^2].
    """
    parts: list[tuple[Array, Array, Array, Ints, Ints, Ints, Array]] = []
    for band in range(values.shape[1]):
        for system in np.unique(s.system[usable[:, band]]):
            own = np.flatnonzero(usable[:, band] & (s.system == system))
            if own.size < 2:
                continue
            top = own[np.argmax(s.elevation[own])]
            rest = own[own != top]
            parts.append((
                s.los[top] - s.los[rest], values[rest, band] - values[top, band],
                np.diag(variance[rest]) + variance[top], rest, np.full(rest.size, top), np.full(rest.size, band),
                s.wavelength[rest, band],
            ))  # fmt: skip
    if not parts:
        none = np.zeros(0, np.int64)
        return DifferenceRows(np.zeros((0, AXES)), np.zeros(0), np.zeros((0, 0)), none, none, none, np.zeros(0))
    design, y, blocks, satellite, reference, bands, wavelength = zip(*parts, strict=True)
    return DifferenceRows(
        np.concatenate(design), np.concatenate(y), _block_diagonal(blocks), np.concatenate(satellite),
        np.concatenate(reference), np.concatenate(bands), np.concatenate(wavelength),
    )  # fmt: skip


def _block_diagonal(blocks: tuple[Array, ...]) -> Array:
    size, at = sum(len(block) for block in blocks), 0
    out = np.zeros((size, size))
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return out


UNKNOWNS = 3
MOST_CONDITION = 1e10  # of a normal matrix that is inverted
NODES = 20_000  # of a search; beyond it the solution stays a float one


class ConventionalRtkConfig(Config):
    """Settings of the conventional solution; the defaults are those of RTKLIB, or of ``nagoya_drive_rtk``."""

    elevation_mask_deg: float = Field(30.0, ge=0, lt=90, description="lowest elevation [deg]; nagoya_drive_rtk")
    cn0_min_dbhz: tuple[float, float] = Field(
        (35.0, 30.0), description="lowest C/N0 of each band [dB-Hz]; nagoya_drive_rtk"
    )
    ratio_min: float = Field(2.5, ge=1, description="lowest ratio of second to best norm [-]; nagoya_drive_rtk")
    phase_sigma_m: float = Field(0.003, gt=0, description="phase of one receiver, constant and over sine [m]; RTKLIB")
    code_ratio: float = Field(100.0, gt=0, description="code over phase [-]; RTKLIB")
    most_innovation_m: float = Field(30.0, gt=0, description="code residual that excludes a satellite [m]; RTKLIB")


class RtkOutcome(IntEnum):
    """Result of an epoch."""

    NONE = 0
    FIXED = 1
    FLOAT = 2


@dataclass(frozen=True)
class ConventionalSolution:
    """Outcome, position (3,) [m] (the float one unless fixed), ratio [-] and satellites of an epoch."""

    outcome: RtkOutcome
    position_m: Array
    ratio: float
    satellites: int


def solve_epoch(config: ConventionalRtkConfig, signals: RtkSignals) -> ConventionalSolution:
    """Solve one epoch; without four satellites, or with a singular geometry, the outcome is NONE."""
    s = signals
    usable, variance = usable_signals(config, s)
    found = code_position(config, s, usable, config.code_ratio**2 * variance)
    if found is None:
        return ConventionalSolution(RtkOutcome.NONE, np.zeros(UNKNOWNS), 0.0, int(usable.any(1).sum()))
    position, cofactor, usable = found
    count = int(usable.any(1).sum())
    phases = double_differences(s, s.phase, usable & (s.phase != 0.0) & FIXABLE[s.system][:, None], variance)
    if not phases.y.size:
        return ConventionalSolution(RtkOutcome.FLOAT, position, 0.0, count)
    fixed, ratio = _fix(phases, position, cofactor)
    if ratio < config.ratio_min:
        return ConventionalSolution(RtkOutcome.FLOAT, position, ratio, count)
    return ConventionalSolution(RtkOutcome.FIXED, fixed, ratio, count)


def usable_signals(config: ConventionalRtkConfig, s: RtkSignals) -> tuple[Bools, Array]:
    """Signals (S, F) that pass the masks, and the variance (S,) of the single difference of a phase [m^2]."""
    high = s.tracked & (s.elevation >= np.deg2rad(config.elevation_mask_deg))
    strong = high[:, None] & (s.cn0[:, None] >= np.asarray(config.cn0_min_dbhz)[: s.code.shape[1]])
    variance = 2.0 * config.phase_sigma_m**2 * (1.0 + 1.0 / np.sin(np.maximum(s.elevation, 0.01)) ** 2)
    return strong & (s.code != 0.0), variance


def code_position(
    config: ConventionalRtkConfig, s: RtkSignals, usable: Bools, variance: Array
) -> tuple[Array, Array, Bools] | None:
    """Position (3,) by code, its covariance, and the signals left; the worst satellite goes while it is far off."""
    usable = usable.copy()
    while usable.any(1).sum() > UNKNOWNS:
        rows = double_differences(s, s.code, usable, variance)
        if rows.y.size < UNKNOWNS:
            return None
        weight = np.linalg.inv(rows.covariance)
        normal = rows.design.T @ weight @ rows.design
        if np.linalg.cond(normal) > MOST_CONDITION:
            return None
        cofactor = np.linalg.inv(normal)
        position = cofactor @ rows.design.T @ weight @ rows.y
        left = np.abs(rows.y - rows.design @ position)
        if left.max() <= config.most_innovation_m:
            return position, np.asarray(cofactor, dtype=np.float64), usable
        usable[rows.satellite[left.argmax()]] = False
    return None


def _fix(rows: DifferenceRows, position: Array, cofactor: Array) -> tuple[Array, float]:
    """Position with the best integers, and the ratio of the second best norm to theirs; 0 without a proven search."""
    scale = 1.0 / rows.wavelength
    floated = scale * (rows.y - rows.design @ position)
    spread = rows.design @ cofactor
    covariance = scale[:, None] * (rows.covariance + spread @ rows.design.T) * scale
    found = resolve(floated, covariance, node_limit=NODES)
    if int(found.status) != 0:
        return position, 0.0
    left = floated - found.candidates[0]
    correction = -(spread.T * scale) @ np.linalg.solve(covariance, left)
    return position - correction, float(found.ratio)


MOTION = 9  # states of position, velocity and acceleration
START_M, START_MPS, START_MPS2 = 30.0, 10.0, 10.0  # 1-sigma of a new position and motion; RTKLIB's VAR_POS, VAR_VEL
FEWEST = 4  # satellites of a solution; RTKLIB


class KinematicConfig(Config):
    """Motion and ambiguities of the filter; the other settings are those of the single-epoch solution."""

    ambiguities: Literal["instantaneous", "continuous"] = Field(
        "continuous", description="new in each epoch, or kept while lock is"
    )
    dynamics: bool = Field(True, description="filter position, velocity and acceleration; else each epoch begins anew")
    acceleration_h: float = Field(0.1, ge=0, description="walk of the horizontal acceleration [m/s^2/sqrt(s)]; Nagoya")
    acceleration_v: float = Field(0.01, ge=0, description="the same of the vertical one; Nagoya")
    ambiguity_start_m: float = Field(30.0, gt=0, description="1 sigma of a new ambiguity [m]; Nagoya")
    ambiguity_walk_m: float = Field(1e-4, ge=0, description="its walk [m/sqrt(s)]; Nagoya")
    slip_m: float = Field(0.05, gt=0, description="jump of the geometry-free combination that is a slip [m]; Nagoya")
    most_gap: int = Field(5, ge=1, description="epochs without a signal after which it begins anew [-]; Nagoya")


class KinematicFilter:
    """The filter of one vehicle, epoch by epoch.

    Parameters
    ----------
    config, solution : settings of the filter, and of masks, weights and the ratio test
    satellites, bands : sizes S and F of the signals
    """

    def __init__(
        self, config: KinematicConfig, solution: ConventionalRtkConfig, satellites: int, bands: int = 2
    ) -> None:
        self._config, self._solution, self._bands = config, solution, bands
        size = MOTION + satellites * bands
        self._x, self._p = np.zeros(size), np.zeros((size, size))
        self._known = np.zeros((satellites, bands), np.bool_)
        self._gap = np.zeros((satellites, bands), np.int64)
        self._free = np.full(satellites, np.nan)  # geometry-free combination of the last epoch with both phases [m]
        self._begun = False

    def step(self, signals: RtkSignals, lost: Bools, dt_s: float) -> ConventionalSolution:
        """Solve the epoch ``dt_s`` after the last one; ``lost`` (S,): the receiver has lost lock since then."""
        usable, variance = usable_signals(self._solution, signals)
        codes = self._solution.code_ratio**2 * variance
        found = code_position(self._solution, signals, usable, codes)
        if found is None:
            self._predict(dt_s)
            return ConventionalSolution(RtkOutcome.NONE, np.zeros(3), 0.0, int(usable.any(1).sum()))
        self._predict(dt_s)
        self._place(found[0])
        phased = usable & (signals.phase != 0.0) & FIXABLE[signals.system][:, None]
        self._follow(signals, phased, lost, dt_s)
        parts = [
            self._near(double_differences(signals, values, which, spread), phase)
            for values, which, spread, phase in (
                (signals.code, usable, codes, False), (signals.phase, phased, variance, True)
            )
        ]  # fmt: skip
        count = int(np.unique(np.concatenate([np.r_[rows.satellite, rows.reference] for rows in parts])).size)
        for rows, phase in zip(parts, (False, True), strict=True):
            self._update(rows, phase)
        if count < FEWEST:
            return ConventionalSolution(RtkOutcome.NONE, np.zeros(3), 0.0, count)
        position, ratio = self._fix(parts[1])
        fixed = ratio >= self._solution.ratio_min
        outcome = RtkOutcome.FIXED if fixed else RtkOutcome.FLOAT
        return ConventionalSolution(outcome, position if fixed else self._x[:3].copy(), ratio, count)

    def _predict(self, dt: float) -> None:
        """Advance the motion by ``dt`` and the ambiguities by their walk."""
        c = self._config
        if c.dynamics and self._begun:
            move = np.eye(MOTION)
            for i in range(3):
                move[i, 3 + i], move[i, 6 + i], move[3 + i, 6 + i] = dt, 0.5 * dt * dt, dt
            self._x[:MOTION] = move @ self._x[:MOTION]
            self._p[:MOTION] = move @ self._p[:MOTION]
            self._p[:, :MOTION] = self._p[:, :MOTION] @ move.T
            walk = np.array([c.acceleration_h, c.acceleration_h, c.acceleration_v])
            self._p[range(6, 9), range(6, 9)] += walk**2 * dt
        kept = MOTION + np.flatnonzero(self._known)
        self._p[kept, kept] += c.ambiguity_walk_m**2 * dt

    def _place(self, by_code: Array) -> None:
        """Begin with the position by code, where nothing better is known."""
        if self._begun and self._config.dynamics and self._p[range(3), range(3)].mean() <= START_M**2:
            return
        self._forget(np.arange(MOTION))
        self._x[:3] = by_code
        start = np.repeat([START_M, START_MPS, START_MPS2], 3)
        count = MOTION if self._config.dynamics else 3
        self._p[range(count), range(count)] = start[:count] ** 2
        self._begun = True

    def _follow(self, s: RtkSignals, phased: Bools, lost: Bools, dt: float) -> None:
        """Drop ambiguities that slipped or have been away, and begin new ones with phase less code."""
        slipped = np.broadcast_to(lost[:, None], phased.shape).copy()
        if self._bands == 2:
            both = phased.all(1)
            free = np.where(both, s.phase[:, 0] - s.phase[:, 1], self._free)
            slipped |= (both & (np.abs(free - self._free) > self._config.slip_m))[:, None]
            self._free = free
        self._gap = np.where(phased, 0, self._gap + 1)
        anew = self._config.ambiguities == "instantaneous"
        gone = self._known & (anew | slipped | (self._gap > self._config.most_gap))
        self._forget(MOTION + np.flatnonzero(gone))
        self._known &= ~gone
        new = np.flatnonzero(phased & ~self._known)
        self._x[MOTION + new] = (s.phase - s.code).ravel()[new]
        self._p[MOTION + new, MOTION + new] = self._config.ambiguity_start_m**2
        self._known |= phased

    def _forget(self, index: NDArray[np.int64]) -> None:
        self._x[index], self._p[index, :], self._p[:, index] = 0.0, 0.0, 0.0

    def _slots(self, rows: DifferenceRows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """States of the ambiguities of the satellites and of their references."""
        return (
            MOTION + self._bands * rows.satellite + rows.band,
            MOTION + self._bands * rows.reference + rows.band,
        )

    def _innovation(self, rows: DifferenceRows, phase: bool) -> Array:
        left = rows.y - rows.design @ self._x[:3]
        own, reference = self._slots(rows)
        return np.asarray(left - (self._x[own] - self._x[reference]) if phase else left)

    def _near(self, rows: DifferenceRows, phase: bool) -> DifferenceRows:
        """The rows whose innovation is not too large."""
        keep = np.flatnonzero(np.abs(self._innovation(rows, phase)) <= self._solution.most_innovation_m)
        return DifferenceRows(
            rows.design[keep], rows.y[keep], rows.covariance[np.ix_(keep, keep)], rows.satellite[keep],
            rows.reference[keep], rows.band[keep], rows.wavelength[keep],
        )  # fmt: skip

    def _update(self, rows: DifferenceRows, phase: bool) -> None:
        """Kalman update by double differences of one observable."""
        if not rows.y.size:
            return
        own, reference = self._slots(rows)
        live = np.r_[:MOTION, MOTION + np.flatnonzero(self._known)]
        design = np.zeros((rows.y.size, live.size))
        design[:, :3] = rows.design
        if phase:
            row = np.arange(rows.y.size)
            design[row, np.searchsorted(live, own)] = 1.0
            design[row, np.searchsorted(live, reference)] = -1.0
        block = np.ix_(live, live)
        before = self._p[block]
        spread = before @ design.T
        gain = np.linalg.solve(design @ spread + rows.covariance, spread.T).T
        self._x[live] += gain @ self._innovation(rows, phase)
        after = before - gain @ spread.T
        self._p[block] = 0.5 * (after + after.T)

    def _fix(self, rows: DifferenceRows) -> tuple[Array, float]:
        """Position with the best integers, and the ratio; 0 without phases or without a proven search."""
        if not rows.y.size:
            return self._x[:3], 0.0
        own, reference = self._slots(rows)
        floated = (self._x[own] - self._x[reference]) / rows.wavelength
        spread = (self._p[:, own] - self._p[:, reference]) / rows.wavelength
        covariance = (spread[own] - spread[reference]) / rows.wavelength[:, None]
        found = resolve(floated, 0.5 * (covariance + covariance.T), node_limit=NODES)
        if int(found.status) != 0:
            return self._x[:3], 0.0
        left = floated - found.candidates[0]
        return self._x[:3] - spread[:3] @ np.linalg.solve(covariance, left), float(found.ratio)
