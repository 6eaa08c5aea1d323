"""What carriers and codes of a recorded pair leave at the fixed position, by satellite and signal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.replay.baseline import Baseline
from lanebound.integrity.replay.differences import arc_of, matched, reduce_epoch
from lanebound.integrity.sky.broadcast import Ephemerides

LOWEST_DEG = 20.0


class Residuals(NamedTuple):
    """T epochs, S satellites, C signals: carrier and code [m] over the factor of the elevation, without the mean of
    each satellite and signal, NaN where there is none; speed (T,) [m/s]."""

    carrier: np.ndarray
    code: np.ndarray
    speed: np.ndarray

    def sigma(self, name: str) -> float:
        """1-sigma at the zenith while it drives, [m]."""
        return float(np.sqrt(np.nanmean(np.square(getattr(self, name)[self.speed > 2.0]))))

    def correlation(self, name: str, lag: int, driving: bool) -> float:
        """Correlation over ``lag`` epochs in motion or at rest."""
        values = getattr(self, name)
        chosen = self.speed > 2.0 if driving else self.speed < 0.3
        both = (chosen[:-lag] & chosen[lag:])[:, None, None] & np.isfinite(values[:-lag]) & np.isfinite(values[lag:])
        one, two = values[:-lag][both], values[lag:][both]
        return float((one * two).mean() / np.square(one).mean())


def residuals(
    rover: Observations, base: Observations, table: Ephemerides, solved: Baseline, share: tuple[float, float]
) -> Residuals:
    """Residuals of a part of the epochs, from one share of them to another."""
    choice, place = solved.choice, solved.base_ecef_m
    epochs, partners, _ = matched(rover, base, 1.5)
    arcs = [arc_of(data, codes, choice, table) for data, codes in ((rover, choice.rover), (base, choice.base))]
    axes = ecef_from_enu_matrix(*geodetic_from_ecef(place)[:2])
    system = table.satellites[:, 0]
    wave = choice.wavelength_m[system]
    shape = (len(epochs), *wave.shape)
    out = {name: np.full(shape, np.nan) for name in ("carrier", "code")}
    speed = np.linalg.norm(np.gradient(solved.enu_m[epochs], axis=0), axis=1)
    speed[~solved.fixed[epochs]] = np.nan
    top = _highest(arcs, epochs, partners, solved, axes, system)
    for k in np.flatnonzero(solved.fixed[epochs]):
        x = solved.enu_m[epochs[k]]
        seen = reduce_epoch(arcs[0], arcs[1], int(epochs[k]), int(partners[k]), place + axes @ x, place)
        own = (seen.sight_enu @ x)[:, None]
        phase = np.where(seen.tracked & (seen.phase_m != 0.0), seen.phase_m + own, np.nan)
        code = np.where(seen.tracked, seen.code_m + own, np.nan)
        first = phase[top[system]]
        phase -= np.round((phase - first) / wave) * wave
        root = np.sqrt(0.5 * (1.0 + 1.0 / np.square(np.maximum(seen.sight_enu[:, 2], 0.05))))
        high = seen.sight_enu[:, 2] >= np.sin(np.radians(LOWEST_DEG))
        for name, values in _adjusted(seen.sight_enu, phase, code, system).items():
            out[name][k] = np.where(high[:, None], values / root[:, None], np.nan)
    part = slice(*(int(s * len(epochs)) for s in share))
    kept = {name: values[part] for name, values in out.items()}
    for values in kept.values():
        enough = np.isfinite(values).sum(0) > 20
        values -= np.where(enough, np.nansum(values, 0) / np.maximum(np.isfinite(values).sum(0), 1), np.nan)
    return Residuals(kept["carrier"], kept["code"], speed[part])


def _highest(arcs, epochs, partners, solved, axes, system):  # type: ignore[no-untyped-def]
    """The satellite of each system whose phases most epochs have, and of these the highest."""
    place, score = solved.base_ecef_m, np.zeros(len(system))
    for i, j in zip(epochs[::20], partners[::20], strict=True):
        seen = reduce_epoch(arcs[0], arcs[1], int(i), int(j), place + axes @ solved.enu_m[i], place)
        score += np.where(seen.tracked.any(-1) & (seen.phase_m != 0.0).any(-1), 10.0 + seen.sight_enu[:, 2], 0.0)
    return np.array([np.argmax(np.where(system == s, score, -1.0)) for s in range(system.max() + 1)])


def _adjusted(sight, phase, code, system):  # type: ignore[no-untyped-def]
    """Residuals of phases after least squares of position and clocks, of codes after clocks, over their redundancy."""
    rows = np.argwhere(np.isfinite(phase))
    group = np.unique(np.stack([system[rows[:, 0]], rows[:, 1]]), axis=1, return_inverse=True)[1]
    clocks = np.eye(group.max() + 1)[group]
    found = {name: np.full(phase.shape, np.nan) for name in ("carrier", "code")}
    weight = sight[rows[:, 0], 2][:, None]
    for name, values, design in (
        ("carrier", phase, np.hstack([-sight[rows[:, 0]], clocks])), ("code", code, clocks)
    ):  # fmt: skip
        y = values[tuple(rows.T)].copy()
        for g in range(clocks.shape[1]):
            y[group == g] -= np.median(y[group == g])
        hat = (design * weight) @ np.linalg.pinv(design * weight)
        free = 1.0 - np.diag(hat)
        left = y - (hat @ (y * weight[:, 0])) / weight[:, 0]
        found[name][tuple(rows.T)] = np.where(free > 0.1, left / np.sqrt(np.maximum(free, 0.1)), np.nan)
    return found
