"""Positions of a recorded receiver from its own codes: where it stands, and whether it moves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, geodetic_from_ecef
from lanebound.integrity.positioning.code_solution import gauss_newton
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.recorded.source import BDT_BEHIND_GPS_S, WEEK_S, leap_seconds
from lanebound.integrity.replay.differences import Arc, arc_of, troposphere_m
from lanebound.integrity.replay.signal_choice import Choice
from lanebound.integrity.sky.broadcast import Ephemerides
from lanebound.integrity.sky.klobuchar import Klobuchar
from lanebound.integrity.sky.orbit import ranges_and_sights
from lanebound.integrity.sky.systems import WAVELENGTH_M, System

Array = NDArray[np.float64]

MOVES_M = 15.0  # spread of code positions, 90 % of them, of a receiver that moves; noise is a few metres
NEAR_M = 30.0  # of a receiver from its codes; further is doubtful: codes with models of the air are good to about 10 m
WRONG_M = 100.0  # what codes cannot be wrong by
NO_CODES_M = 1e5  # that no time explains: orbits and clocks of an old message are off by kilometres
MISFIT_M = 100.0  # deviation of codes that no position explains; 1 s of time is up to 800 m
GLONASS_AHEAD_S = 10_800.0  # of UTC
CLOCK_S = 8.0  # up to which the error of a clock is found
SAMPLES = 40  # epochs of which positions are computed
FEWEST = 6  # satellites
LOWEST_RAD = np.deg2rad(10.0)


class CodePlaces:
    """Positions of one receiver at some epochs, (n, 3) [m]: of the first signal of each system, with the models of
    Saastamoinen and, where the navigation has its figures, Klobuchar."""

    def __init__(
        self, observations: Observations, codes: dict[str, tuple[str, ...]], choice: Choice, table: Ephemerides,
        ionosphere: Klobuchar | None = None,
    ) -> None:  # fmt: skip
        arc = arc_of(observations, codes, choice, table)
        wavelength = choice.wavelength_m[table.satellites[:, 0], 0]
        self._dispersion = (wavelength / WAVELENGTH_M[System.GPS, 0]) ** 2
        self._system, self._ionosphere = table.satellites[:, 0], ionosphere
        epochs = np.unique(np.linspace(0, observations.epochs - 1, SAMPLES).astype(int))
        self._misfits_m: list[float] = []
        found = [self._place(arc, int(k), float(observations.tow_s[k])) for k in epochs]
        self.places_m = np.array([place for place in found if place is not None]).reshape(-1, 3)

    @property
    def spread_m(self) -> float:
        """Distance from their median within which nine tenths of the positions lie [m]; 0 without positions."""
        if not len(self.places_m):
            return 0.0
        return float(np.quantile(np.linalg.norm(self.places_m - np.median(self.places_m, axis=0), axis=1), 0.9))

    @property
    def misfit_m(self) -> float | None:
        """Deviation of codes from those of their positions [m], median, inf without a position; None where no epoch has
        one code too many."""
        return float(np.median(self._misfits_m)) if self._misfits_m else None

    @property
    def moves(self) -> bool:
        """Whether more than a tenth of the positions lie further than MOVES_M from their median."""
        return self.spread_m > MOVES_M

    def distance_m(self, place_m: Array) -> float | None:
        """Distance of a place (3,) from the median of the positions [m]; None without positions."""
        return float(np.linalg.norm(np.median(self.places_m, axis=0) - place_m)) if len(self.places_m) else None

    def _place(self, arc: Arc, k: int, tow_s: float) -> Array | None:
        """Position (3,) from the codes of epoch k, by least squares; None from too few."""
        rows = np.flatnonzero(arc.known[k] & (arc.code_m[k, :, 0] != 0.0))
        delay, place = np.zeros(rows.size), np.zeros(3)
        for _ in range(2):  # the models of the air need a position
            present, group = np.unique(self._system[rows], return_inverse=True)
            if rows.size < max(FEWEST, 4 + present.size):
                return None
            solved = _least_squares(arc, k, rows, delay, place, group)
            if solved is None:  # enough satellites, and no place on Earth or above it
                self._misfits_m.append(math.inf)
                return None
            place, misfit = solved
            low, delay = self._delays(arc, k, rows, place, tow_s)
            rows, delay = rows[~low], delay[~low]
        if misfit is not None:
            self._misfits_m.append(misfit)
        return place

    def _delays(
        self, arc: Arc, k: int, rows: NDArray[np.int64], place: Array, tow_s: float
    ) -> tuple[NDArray[np.bool_], Array]:
        """Which satellites are too low, and the delays (n,) in the air at a place [m]."""
        latitude, longitude, _ = geodetic_from_ecef(place)
        _, sight = ranges_and_sights(arc.satellite_ecef_m[k, rows], place)
        e = sight @ ecef_from_enu_matrix(latitude, longitude)
        elevation = np.arcsin(np.clip(e[:, 2], -1.0, 1.0))
        delay = troposphere_m(place, elevation)
        if self._ionosphere is not None:
            delay = delay + self._dispersion[rows] * self._ionosphere.delay_m(
                float(latitude), float(longitude), np.arctan2(e[:, 0], e[:, 1]), np.maximum(elevation, 0.0), tow_s
            )
        return elevation < LOWEST_RAD, delay


def require_gps_time(
    name: str, observations: Observations, codes: dict[str, tuple[str, ...]], choice: Choice, table: Ephemerides,
    ionosphere: Klobuchar | None = None,
) -> CodePlaces:  # fmt: skip
    """Positions of a receiver from its codes, which must fit its times as GPS time.

    Raises
    ------
    InputError
        They fit no position, but do with times in another scale; the message names the scale. Or they fit none
        at any time.
    """
    own = CodePlaces(observations, codes, choice, table, ionosphere)
    if own.misfit_m is not None and own.misfit_m <= MISFIT_M:
        return own
    off_m = math.inf if own.misfit_m is None else own.misfit_m
    found = f"deviate by {off_m:,.0f} m from any position" if off_m < math.inf else "give no position"
    leap_s = float(leap_seconds(np.array(observations.week[0] * WEEK_S + observations.tow_s[0])))

    def misfit_m(behind_s: float) -> float:
        tow_s = observations.tow_s + behind_s
        over = np.floor_divide(tow_s, WEEK_S)
        moved = replace(observations, week=observations.week + over.astype(np.int64), tow_s=tow_s - WEEK_S * over)
        misfit = CodePlaces(moved, codes, choice, table, ionosphere).misfit_m
        return math.inf if misfit is None else misfit

    scales = {
        BDT_BEHIND_GPS_S: "in BDT without its label; write BDT into columns 49 to 51 of TIME OF FIRST OBS",
        leap_s: "in UTC; convert the file to GPS time",
        leap_s - GLONASS_AHEAD_S: "in GLONASS time; convert the file to GPS time",
        -BDT_BEHIND_GPS_S: "in GPS time with the label BDT; correct TIME OF FIRST OBS",
        -leap_s: "in GPS time with leap seconds added twice; convert the file to GPS time",
    }
    other = "of a clock that is off; correct the times"
    for behind_s in (*scales, _clock_error_s(misfit_m)):
        misfit = misfit_m(behind_s)
        if misfit <= MISFIT_M:
            raise InputError(
                f"times of the {name} must be GPS time, its codes {found}, and deviate by {misfit:.0f} m with times "
                f"{behind_s:+.6g} s later: they are probably {scales.get(behind_s, other)}"
            )
    if own.misfit_m is not None and own.misfit_m > NO_CODES_M:  # a clock or an orbit that is off is nearer
        raise InputError(
            f"codes of the {name} must be distances to the satellites of its navigation, they {found} at any time: its "
            "columns of codes and phases are exchanged, or the navigation is of other satellites; correct them"
        )
    return own


def _least_squares(
    arc: Arc, k: int, rows: NDArray[np.int64], delay: Array, start: Array, group: NDArray[np.int64]
) -> tuple[Array, float | None] | None:
    """Position (3,) of these satellites, with a clock for each group, and the deviation of their codes [m], None for
    as many codes as unknowns; None where it is not solvable."""
    observed = arc.code_m[k, rows, 0] + arc.clock_m[k, rows] - delay

    def about(place: Array) -> tuple[Array, Array]:
        distance, sight = ranges_and_sights(arc.satellite_ecef_m[k, rows], place)
        return observed - distance, sight

    found, fit = gauss_newton(about, start[None], 1.0, np.ones((1, rows.size), bool), group)
    if not fit.solved[0]:
        return None
    left, spare = np.ravel(about(found)[0]), rows.size - 3 - int(group.max()) - 1
    left = left - (np.bincount(group, left) / np.bincount(group))[group]
    return found[0], math.sqrt(float(left @ left) / spare) if spare > 0 else None


def _clock_error_s(misfit_m: Callable[[float], float]) -> float:
    """By how much times are too early, to 0.1 s, where the deviation of codes is in proportion to it; 0 elsewhere."""
    before, after = misfit_m(-CLOCK_S), misfit_m(CLOCK_S)
    return round(CLOCK_S * (before - after) / (before + after), 1) if before + after < math.inf else 0.0
