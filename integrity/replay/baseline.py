"""RTK of recorded receivers: processes any rover, base and navigation file with the RTK stages of the navigator.

Each epoch: single differences, a code position, then the RTK stages, which track carrier lock, resolve integers
(LAMBDA, ratio test with fixed failure rate), detect and exclude faults, and compute protection levels. All signals that
both receivers track help to find integers; the fixed position takes the first band. Without a fix the position is the
code position with its own levels. There is no motion model: static and moving rovers are processed alike, unless the
rover is said to stand (``static``): float ambiguities then take its position as one for all epochs. Fixed positions do
not.

Slips that one signal shows of another: the difference of two phases of a satellite contains neither its range nor the
receivers' motion. From one epoch to the next it changes by the ionosphere alone; the constant differences of the
receivers are in its median over the satellites of a system. A jump beyond ``k`` standard deviations marks both signals
as having lost their lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.core.frames import enu_axes
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.monitoring.exclusion import FdeConfig, FdeOutcome, detect_and_exclude
from lanebound.integrity.monitoring.protection import protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import MARK
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.cycle_slips_kernel import MIN_COMMON
from lanebound.integrity.positioning.least_squares import design_matrix, gain, weights
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.positioning.resolve_kernel import FIRST_SHARE
from lanebound.integrity.positioning.rtk_config import FloatConfig, RtkConfig
from lanebound.integrity.positioning.rtk_kernel import MOST_AMBIGUITIES, weigh
from lanebound.integrity.recorded.rinex_observation import WEEK_S, Observations
from lanebound.integrity.replay.differences import Arc, Reduced, arc_of, matched, reduce_epoch
from lanebound.integrity.replay.rtk_stages import Entries, RtkStages, Signals
from lanebound.integrity.replay.signal_choice import LETTERS, Choice, choose_signals
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.broadcast import Ephemerides
from lanebound.integrity.sky.systems import FIXABLE

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

Bools = NDArray[np.bool_]

PLENTY = 7  # satellites with two signals that make the better position
ENOUGH = 0.5  # share of the epochs of a second code of a band in which the first one makes it unnecessary


def entries_of(choice: Choice, rover: Arc, base: Arc, satellites: Ints, cn0_min_dbhz: float) -> Entries:
    """The signals that both receivers have tracked; ``satellites`` (S, 2) are system and PRN.

    Every satellite with a further signal has an entry of its first one, too, which may be without measurements. A
    second code of a band is an entry of the satellites that lack the first one.
    """
    tracked = [
        ((arc.code_m != 0.0) & (arc.phase_m != 0.0) & (arc.cn0_dbhz >= cn0_min_dbhz) & arc.known[..., None]).sum(0)
        for arc in (rover, base)
    ]
    epochs = np.minimum(tracked[0] / max(len(rover.known), 1), tracked[1] / max(len(base.known), 1))
    wanted = np.zeros(epochs.shape, np.bool_)
    for letter, names in choice.rover.items():
        own = satellites[:, 0] == LETTERS[letter]
        for k, name in enumerate(names):
            wanted[own, k] = epochs[own, k] > 0.0
            for earlier in range(k):
                if names[earlier][0] == name[0]:
                    wanted[own, k] &= epochs[own, earlier] < ENOUGH * epochs[own, k]
    wanted[:, 0] |= wanted.any(-1)
    satellite, column = np.nonzero(wanted)
    system = satellites[satellite, 0]
    first = np.full(len(satellites), -1)
    first[satellite[column == 0]] = np.flatnonzero(column == 0)
    return Entries(
        satellite, column, choice.clock[system, column], first[satellite], choice.wavelength_m[system, column],
        np.asarray(FIXABLE[system]),
    )  # fmt: skip


def signals_of(reduced: Reduced, entries: Entries, rtk: RtkConfig) -> Signals:
    """The signals of one epoch."""
    at = entries.satellite, entries.column
    los, tracked, cn0 = np.ascontiguousarray(reduced.sight_enu[at[0]]), reduced.tracked[at], reduced.cn0_dbhz[at]
    quality = _weighed(los, tracked, cn0, rtk)
    return Signals(los, quality, tracked, cn0, reduced.code_m[at], reduced.phase_m[at], reduced.lost[at])


def _weighed(los: Array, tracked: Bools, cn0: Array, rtk: RtkConfig) -> Array:
    """Variance factors (N,) of signals."""
    signals, marks = np.zeros(len(los), OBSERVED_SIGNAL), np.zeros(len(los), MARK)
    signals["e"], signals["tracked"], signals["cn0"] = los, tracked, cn0
    weigh(signals, rtk.cn0_knee_dbhz, marks)
    return marks["quality"].copy()


def code_rows(reduced: Reduced, los: Array, rtk: RtkConfig) -> tuple[Ints, Array, Array]:
    """Satellites (n,) whose codes make a position, their codes [m] and variances [m^2], of one clock for each system.

    The mean of the first two signals where enough satellites have both, otherwise the first one: means and single codes
    do not have the same clock.
    """
    both = np.asarray(reduced.tracked[:, :2].all(-1))
    for columns, tracked in ((2, both), (1, np.ascontiguousarray(reduced.tracked[:, 0]))):
        cn0 = -10.0 * np.log10((10.0 ** (-0.1 * reduced.cn0_dbhz[:, :columns])).mean(-1))
        quality, high = _weighed(los, tracked, cn0, rtk), los[:, 2] > np.sin(np.deg2rad(rtk.elevation_mask_deg))
        rows = np.flatnonzero(tracked & high & (cn0 >= rtk.cn0_min_dbhz))
        if rows.size >= PLENTY:
            break
    return rows, reduced.code_m[rows, :columns].mean(-1), quality[rows] * rtk.sigma_code_m**2 / columns


class SlipComparison:
    """Compares the phases of each satellite's signals with those of the epoch before."""

    def __init__(self, entries: Entries, rtk: RtkConfig, slips: CycleSlipConfig) -> None:
        self._pairs = _pairs_of(entries)
        self._sigma, self._slips = rtk.sigma_phase_m, slips
        self._last = np.zeros(len(entries.clock))
        clock = entries.clock[self._pairs]
        self._kind = clock[:, 0] * 256 + clock[:, 1]

    def lost(self, signals: Signals, dt_s: float) -> Bools:
        """Which signals (N,) have lost their lock: by their flags, or by a jump against another of the satellite."""
        here = signals.tracked & (signals.phase != 0.0)
        lost = signals.lost.copy()
        if len(self._pairs):
            known = here & (self._last != 0.0) & ~lost
            pairs = np.flatnonzero(known[self._pairs].all(-1))
            one, other = self._pairs[pairs].T
            moved = signals.phase - self._last
            change = moved[one] - moved[other]
            variance = 2.0 * self._sigma**2 * (signals.quality[one] + signals.quality[other])
            limit = self._slips.threshold * np.sqrt(variance + (self._slips.ionosphere_rate_mps * dt_s) ** 2)
            for kind in np.unique(self._kind[pairs]):
                same = self._kind[pairs] == kind
                if np.count_nonzero(same) >= MIN_COMMON:
                    change[same] -= np.median(change[same])
            jumped = np.abs(change) > limit
            lost[one[jumped]] = lost[other[jumped]] = True
        self._last = np.where(here, signals.phase, 0.0)
        return lost


def _pairs_of(entries: Entries) -> Ints:
    """Pairs of entries (P, 2) of the same satellite."""
    found = [pair for host in np.unique(entries.host) for pair in combinations(np.flatnonzero(entries.host == host), 2)]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


MIN_MOVE_M = 0.3  # distance between fixed positions for a new heading
POSITION_ROUNDS = 6  # iterations of the code position, which start at the base


class RecordedFloatConfig(FloatConfig):
    """Float ambiguities of recorded receivers: sequential by default."""

    kind: Literal["epoch", "sequential"] = Field(
        "sequential", description="epoch: from one epoch; sequential: from a filter over the epochs before, too"
    )


class RecordedRtkConfig(RtkConfig):
    """RTK of recorded receivers; the residual atmosphere is declared by the baseline, not in the phase."""

    sigma_phase_m: float = Field(
        0.0042, gt=0, description="phase, zenith, one band [m]; root 2 x 3 mm, RTKLIB's default of one receiver"
    )
    max_candidates: int = Field(
        MOST_AMBIGUITIES, ge=4, le=MOST_AMBIGUITIES, description="signals whose ambiguities are estimated at once [-]"
    )
    posterior_margin: float = Field(
        1.5,
        ge=0,
        description="0: integers are fixed where their failure rate, known before the measurements, is within its "
        "limit; 1 and more: also where their probability of being wrong, given the measurements, is, for errors so "
        "many times as large as declared [-]",
    )
    float_solution: RecordedFloatConfig = RecordedFloatConfig()


class BaselineConfig(Config):
    """Parameters of the solution of recorded baselines and of its protection levels."""

    static: bool = Field(
        False,
        description="the rover stands: the filter of float ambiguities takes its position as the same in all epochs",
    )
    bands: int | None = Field(None, ge=1, le=3, description="bands of a system at most; None: all, up to three [-]")
    ionosphere_ppm: float = Field(
        0.5,
        ge=0,
        description="residual vertical ionosphere, 1 sigma, per length of the baseline [1e-6]; a quiet day "
        "at middle latitudes, 0.4 to 1",
    )
    troposphere_ppm: float = Field(
        0.5, ge=0, description="residual zenith delay, 1 sigma, per length of the baseline [1e-6]; 5 mm over 10 km"
    )
    rtk: RecordedRtkConfig = RecordedRtkConfig()
    slips: CycleSlipConfig = CycleSlipConfig()
    fde: FdeConfig = FdeConfig()
    risk: RiskConfig = RiskConfig()


@dataclass(frozen=True)
class Baseline:
    """All epochs (T,) of the rover: GPS week, time of week [s], mode, status codes of RtkStatus, position relative to
    the base in E, N, U (T, 3) and in ECEF [m], heading [rad], levels and sigmas (T, 2) on AT, CT [m], numbers of
    satellites and of excluded ones, risk of wrong integers, age of the base epoch [s], inf without one, number of
    signals whose integers were sought and the failure rate of their integers, whose limit is ``failure_limit``;
    ``choice`` of signals; ``base_ecef_m`` (3,), origin of E, N, U; the configuration ``rtk`` and the integrity
    ``risk`` of the levels, which are relative to the base.

    Positions are those of the antenna reference points of rover and base. The offset to the marker is ANTENNA: DELTA
    H/E/N of the header. Phase centres are assumed at the reference points (no calibrations).
    """

    week: Ints
    tow_s: Array
    mode: Ints
    status: Ints
    enu_m: Array
    ecef_m: Array
    heading_rad: Array
    pl_m: Array
    sigma_m: Array
    satellites: Ints
    excluded: Ints
    wrong_fix_risk: Array
    age_s: Array
    searched: Ints
    failure: Array
    failure_limit: float
    choice: Choice
    base_ecef_m: Array
    rtk: RtkConfig
    risk: float

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Epochs with a fixed position.  (T,)."""
        return np.asarray(self.mode == Mode.RTK)


def solve_baseline(
    rover: Observations, base: Observations, table: Ephemerides, base_ecef_m: Array | None = None,
    config: BaselineConfig | None = None, progress: Progress = silent,
) -> Baseline:  # fmt: skip
    """Solve all epochs of the rover; those without a base epoch that is not too old have the status NO_CORRECTIONS.

    Parameters
    ----------
    base_ecef_m : (3,) position of the antenna reference point of the base [m]; by default marker plus ANTENNA: DELTA
        H/E/N of its header. Its error is an error of the rover position.
    progress : called with the number of solved epochs and the total number

    Raises
    ------
    InputError
        There is no position of the base, no common epochs, signals or satellites, or no navigation of that time.
    """
    config = config or BaselineConfig()
    place = base_antenna(base, base_ecef_m)
    rtk = config.rtk
    choice = choose_signals(rover, base, config.bands, cn0_min_dbhz=rtk.cn0_min_dbhz, cn0_knee_dbhz=rtk.cn0_knee_dbhz)
    epochs, partners, age = matched(rover, base, config.rtk.max_age_s)
    if not epochs.size:
        raise InputError(
            f"rover and base must overlap in time, got {_span(rover)} and {_span(base)}: pass files of one session"
        )
    if not len(table):
        raise InputError(
            "the navigation files must hold messages of GPS, Galileo, BeiDou or QZSS, have none: pass the day's "
            "navigation"
        )
    arcs = [arc_of(data, codes, choice, table) for data, codes in ((rover, choice.rover), (base, choice.base))]
    _require_messages(rover, arcs, table)
    run = _Session(arcs[0], arcs[1], table, place, choice, config)
    return run.solve(rover, epochs, partners, age, progress)


def on_earth(place_ecef_m: Array) -> bool:
    """Whether a place (3,) [m] is near the Earth's surface, unlike coordinates in other units or axes."""
    return 6.0e6 < float(np.linalg.norm(place_ecef_m)) < 7.0e6


def base_antenna(base: Observations, given_ecef_m: Array | None) -> Array:
    """Antenna reference point of the base (3,) [m]: the given one, otherwise that of its header.

    Raises
    ------
    InputError
        There is none, it is not on Earth, or the antenna is elsewhere on a vehicle.
    """
    place = base.header.antenna_ecef_m if given_ecef_m is None else given_ecef_m
    require_one_site(base, given_ecef_m is not None)
    if given_ecef_m is None and any(base.header.antenna_delta_body_m):  # on axes that nothing gives
        raise InputError(
            "the base must have ANTENNA: DELTA H/E/N, ANTENNA: DELTA X/Y/Z of its header is that of a vehicle: give "
            "--base-position (base_ecef_m)"
        )
    if place is None:
        raise InputError(
            "the position of the base must be known, its header has no APPROX POSITION XYZ: pass it with "
            "--base-position (base_ecef_m)"
        )
    place = require_finite("base_ecef_m", place)
    require_shape("base_ecef_m", place, (3,))
    if not on_earth(place):
        raise InputError(
            f"the position of the base must lie near the Earth's surface, got {place.tolist()} m: correct "
            "--base-position (base_ecef_m) or the header"
        )
    return place


def require_one_site(base: Observations, given: bool) -> None:
    """Raise InputError where the file of a base says that its antenna moved; a new approximate position does not matter
    where its position is given."""
    moves = [move for move in base.moves if not (given and move.approximate)]
    if moves:
        remedy = ", or give --base-position (base_ecef_m) if it did not move" if moves[0].approximate else ""
        raise InputError(f"the base must stand at one place, {moves[0]}: cut the file there{remedy}")


def _require_messages(rover: Observations, arcs: list[Arc], table: Ephemerides) -> None:
    """Raise InputError where no satellite that a receiver observed has a message for its time."""
    if all(arc.known.any() for arc in arcs):
        return
    seen = (rover.week[[0, -1]] * WEEK_S + rover.tow_s[[0, -1]]).tolist()
    sent = [float(table.toe_s.min()), float(table.toe_s.max())]
    raise InputError(
        f"navigation messages must be of the time of the observations, {' to '.join(map(date_text, seen))}, got "
        f"{' to '.join(map(date_text, sent))} and none that fits: pass the navigation of that day"
    )


def date_text(gps_time_s: float) -> str:
    """A GPS time [s since 1980-01-06] as date and time of day, to the minute."""
    return f"{datetime(1980, 1, 6) + timedelta(seconds=round(gps_time_s)):%Y-%m-%d %H:%M}"


def _span(observations: Observations) -> str:
    first, last = (f"week {observations.week[k]} {observations.tow_s[k]:.1f} s" for k in (0, -1))
    return f"{first} to {last}"


class _Session:
    """Data and state of one session."""

    def __init__(
        self, rover: Arc, base: Arc, table: Ephemerides, place: Array, choice: Choice, config: BaselineConfig
    ) -> None:
        self.rover, self.base, self.place, self.choice, self.config = rover, base, place, choice, config
        self.system = np.ascontiguousarray(table.satellites[:, 0])
        self.axes = enu_axes(place)
        self.entries = entries_of(choice, rover, base, table.satellites, config.rtk.cn0_min_dbhz)
        self.stages = RtkStages(config.rtk, config.slips, config.fde, config.risk, self.entries, config.static)
        self.slips = SlipComparison(self.entries, config.rtk, config.slips)
        self.heading = 0.0
        self.before: Array | None = None
        self.passed: Array | None = None

    def solve(self, rover: Observations, epochs: Ints, partners: Ints, age: Array, progress: Progress) -> Baseline:
        """Solve the matched epochs among all of the rover."""
        n = rover.epochs
        out = Baseline(
            rover.week, rover.tow_s, np.zeros(n, np.int64), np.full(n, RtkStatus.NO_CORRECTIONS.code), np.zeros((n, 3)),
            np.zeros((n, 3)), np.zeros(n), np.full((n, 2), np.inf), np.full((n, 2), np.inf), np.zeros(n, np.int64),
            np.zeros(n, np.int64), np.zeros(n), np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n),
            FIRST_SHARE * self.config.rtk.ambiguity_risk_share * self.config.risk.integrity_risk, self.choice,
            self.place, self.config.rtk, self.config.risk.integrity_risk,
        )  # fmt: skip
        out.age_s[epochs] = age
        time = rover.since(int(rover.week[0]))
        for m, k in enumerate(epochs.tolist()):
            dt = float(time[k] - time[epochs[m - 1]]) if m else 1.0
            self._epoch(k, int(partners[m]), dt, out)
            progress(m + 1, len(epochs))
        out.ecef_m[:] = np.where((out.mode != Mode.NONE)[:, None], self.place + out.enu_m @ self.axes.T, 0.0)
        return out

    def _epoch(self, k: int, j: int, dt: float, out: Baseline) -> None:
        """Solve epoch k of the rover with epoch j of the base: code position, RTK stages, levels."""
        found = self._code_position(k, j)
        if found is None:
            self.stages.release()
            out.status[k] = RtkStatus.TOO_FEW.code
            return
        reduced, near, code_levels, coded = found
        self.before = near
        signals = signals_of(reduced, self.entries, self.config.rtk)
        signals = signals._replace(lost=self.slips.lost(signals, dt))
        sine, cosine = float(np.sin(self.heading)), float(np.cos(self.heading))
        air = self._atmosphere(near)
        fixed, levels = self.stages.step(signals, float(out.age_s[k]), dt, near, sine, cosine, *air)
        out.status[k], out.excluded[k], out.heading_rad[k] = fixed["status"], fixed["excluded"], self.heading
        out.searched[k], out.failure[k] = fixed["searched"], fixed["failure"]
        if fixed["status"] == RtkStatus.FIXED.code:
            out.mode[k], out.satellites[k] = int(Mode.RTK), fixed["satellites"]
            out.wrong_fix_risk[k] = fixed["wrong"]
            out.enu_m[k], out.pl_m[k], out.sigma_m[k] = fixed["position"], levels, fixed["sigma"]
            self._turn(out.enu_m[k])
        elif code_levels is not None:
            out.mode[k], out.satellites[k] = int(Mode.CODE), coded
            out.enu_m[k], out.pl_m[k], out.sigma_m[k] = near, code_levels[0], code_levels[1]

    def _atmosphere(self, near: Array) -> tuple[float, float]:
        """Sigmas of the residual vertical ionosphere and zenith delay [m] at a place (3,) relative to the base."""
        c, floats, away = self.config, self.config.rtk.float_solution, 1e-6 * float(np.linalg.norm(near))
        return (
            math.hypot(floats.ionosphere_m, c.ionosphere_ppm * away),
            math.hypot(floats.troposphere_m, c.troposphere_ppm * away),
        )

    def _turn(self, fixed_m: Array) -> None:
        """Compute the heading of the next epoch from two fixed positions that are far enough apart."""
        if self.passed is not None:
            step = fixed_m[:2] - self.passed[:2]
            if float(np.hypot(*step)) < MIN_MOVE_M:
                return
            self.heading = float(np.arctan2(step[0], step[1]))
        self.passed = fixed_m.copy()

    def _code_position(self, i: int, j: int) -> tuple[Reduced, Array, tuple[Array, Array] | None, int] | None:
        """The reduced epoch, the code position (3,), its levels if its test passes, and its number of satellites; None
        without a position."""
        near = self.before if self.before is not None else np.zeros(3)
        for _ in range(POSITION_ROUNDS):
            reduced = reduce_epoch(
                self.rover, self.base, i, j, self.place + self.axes @ near, self.place, self.config.rtk.cn0_min_dbhz
            )
            solved = self._code_solution(reduced)
            if solved is None:
                return None
            moved, near = float(np.linalg.norm(solved[0] - near)), solved[0]
            if moved < 1e-3:
                break
        assert solved is not None  # there is at least one iteration
        return reduced, near, solved[1], solved[2]

    def _code_solution(self, reduced: Reduced) -> tuple[Array, tuple[Array, Array] | None, int] | None:
        """Position (3,) from the differenced code, with levels and sigmas (2,) on AT, CT, and its number of satellites;
        None if it is singular."""
        los, c = np.ascontiguousarray(reduced.sight_enu), self.config
        rows, y, variance = code_rows(reduced, los, c.rtk)
        if rows.size < 4:
            return None
        present, group = np.unique(self.system[rows], return_inverse=True)
        design, covariance = design_matrix(los[rows], group, len(present)), np.diag(variance)
        if not gain(design, weights(covariance)).solved:
            return None
        fde = detect_and_exclude(c.fde, design, covariance, y, heading_rad=self.heading)
        place, count = np.asarray(fde.adjustment.x[:3]), int(np.count_nonzero(fde.used))
        if int(fde.outcome) not in (FdeOutcome.CLEAN.code, FdeOutcome.EXCLUDED.code):
            return place, None, count
        levels = protection_levels_batch(los[rows][None], fde.used[None], group, variance, self.heading, c.risk)
        turn = np.array([[np.sin(self.heading), np.cos(self.heading)], [np.cos(self.heading), -np.sin(self.heading)]])
        spread = turn @ fde.adjustment.gain[:2]
        sigma = np.sqrt((spread**2 * variance).sum(-1))
        return place, (levels.root_m[0, 0], sigma), count
