"""One extended Kalman filter for the vehicles of a fleet: the centralised estimator of S2 section 7 (its [36]).

The state of a vehicle is its position, heading, gyro bias and the scale error of its odometer; that of the area are the
errors of each satellite's signal, of the vertical ionosphere and troposphere, and the multipath of each satellite at
each roadside unit, in units of their declared sigma::

    psi' = psi + (turn - b dt),  v = u / (1 + s),  p' = p + v dt (sin psi, cos psi, 0)
    code    y_is = -e_s.p_i + clock_i + own_s g_s + C_s.a + noise
    doppler y_is = -e_s.v_i + drift_i + noise
    range   r_ij = |p_i - p_j| + noise

with turn and speed u of gyro and odometer. Clocks and drifts are free in each epoch. Codes of a roadside unit, whose
place is known, measure the errors of the satellites: with all codes in one filter the solution is that of all double
differences with their correlations. A vehicle alone is a fleet of one: the INS/GNSS solution that S2 compares with.

Errors of satellites and multipath at a unit are Gauss-Markov processes of the declared time: a model, not a bound.
Multipath of a vehicle is correlated in time. It enters as white noise of the density that bounds it in every linear
filter (:func:`~lanebound.integrity.positioning.correlation.bound_correlation`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.positioning.code_errors import CodeErrorBudget, CodeErrorParts
from lanebound.integrity.positioning.cooperative.factors import line_between
from lanebound.integrity.positioning.cooperative.shared_codes import clock_free
from lanebound.integrity.positioning.correlation import bound_correlation

__all__ = ["MOVING_MPS", "Codes", "JointFilter", "JointFilterConfig", "JointState"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

OWN = 6  # states of a vehicle: East, North, up, heading, gyro bias, scale error
COMMON = 2  # of the area beside those of the satellites: ionosphere, troposphere


class JointFilterConfig(Config):
    """Declared errors of the instruments of each vehicle, 1 sigma."""

    codes: CodeErrorBudget = Field(CodeErrorBudget(), description="of the codes")
    satellite_tau_s: float = Field(1800.0, gt=0, description="correlation time of the satellites' errors [s]")
    doppler_mps: float = Field(0.1, gt=0, description="range rates, zenith [m/s]; S1: 10 cm/s")
    doppler_tau_s: float = Field(0.54, ge=0, description="their longest correlation time [s]")
    start_m: float = Field(10.0, gt=0, description="position at the start, on each axis [m]")
    start_heading_deg: float = Field(3.0, gt=0, description="heading at the start [deg]")
    gyro_degps: float = Field(0.014, ge=0, description="white noise of the gyro [deg/s/sqrt(Hz)]; BMI088")
    gyro_bias_degps: float = Field(0.12, ge=0, description="gyro bias at the start [deg/s]; as the consumer grade")
    gyro_walk_degps: float = Field(2.4e-4, ge=0, description="walk of the gyro bias [deg/s/sqrt(s)]; that bounds its "
                                   "instability of 6 deg/h over 100 s")  # fmt: skip
    gyro_scale: float = Field(3e-3, ge=0, description="scale error of the gyro [-]")
    odometer_mps: float = Field(0.05, ge=0, description="noise of the odometer's speed [m/s]")
    odometer_scale: float = Field(0.003, ge=0, description="its scale error [-]")
    slip: float = Field(0.003, ge=0, description="wheel slip, share of the way, white [sqrt(s)]; 0.001 s^2/m at 3 "
                        "m/s^2")  # fmt: skip
    sideways_mps: float = Field(0.02, ge=0, description="motion across the heading [m/s/sqrt(Hz)]; chosen")
    climb_mps: float = Field(0.1, ge=0, description="unknown climb [m/s/sqrt(Hz)]; chosen, a slope of 1 % at 10 m/s")
    gate_sigmas: float = Field(
        3.29, gt=0, description="codes and range rates beyond are left out; 1e-3 of those without faults"
    )


class Codes(NamedTuple):
    """Codes and range rates of the nodes, vehicles first: code_m, rate_mps, cn0_dbhz, used (N, S)."""

    code_m: Array
    rate_mps: Array
    cn0_dbhz: Array
    used: Bools

    def each(self, change: Callable[[Any], Any]) -> Codes:
        """The same with every array changed in one way."""
        return Codes(*(change(values) for values in self))


@dataclass
class JointState:
    """State of F fleets: mean (F, n), covariance (F, n, n), speed (F, V) of the odometers, time since codes [s].

    misfit (F,) is how much innovations exceed what they are expected to be: their weighted squares, a measurement
    beyond the gate counted with the square of the gate, less what noise of the declared size gives with these weights;
    it fades over ``MISFIT_S``.
    """

    mean: Array
    covariance: Array
    speed_mps: Array
    misfit: Array
    since_s: float = 0.0

    def copy(self) -> JointState:
        """An independent copy."""
        return copy.deepcopy(self)


class JointFilter:
    """The filter of fleets of V vehicles under S satellites; fleets are independent, or hypotheses about one.

    Parameters
    ----------
    config : JointFilterConfig
    vehicles : number V of vehicles in a fleet
    system : (S,) system of each satellite
    places_m : (G, 3) surveyed places of the roadside units, which are the nodes after the vehicles
    epoch_s : time between updates by codes [s]
    shared : units share their codes; else the vehicles' codes and ranges are all there is
    """

    def __init__(
        self,
        config: JointFilterConfig,
        vehicles: int,
        system: Ints,
        places_m: Array | None = None,
        epoch_s: float = 1.0,
        shared: bool = True,
    ) -> None:
        self.config, self.vehicles, self.system, self.epoch_s = config, vehicles, system, epoch_s
        self.places_m = np.empty((0, 3)) if places_m is None else places_m
        sats, first = len(system), OWN * vehicles
        self._common = slice(first, first + COMMON)
        self._errors = self._common.stop  # of the satellites; after them the multipath of each unit that shares codes
        after = self._errors + sats
        self._units_at = [after + sats * g for g in range(len(self.places_m))] if shared else []
        self._count = after + sats * len(self._units_at)
        self._rest_course = bound_correlation(0.1, config.codes.rest_tau_s, epoch_s).course
        # What a distance bends by is wrong for as long as the position is: some ten seconds, chosen.
        self._bend_course = bound_correlation(0.1, 10.0, epoch_s).course
        self._rate_course = bound_correlation(1e-3, max(config.doppler_tau_s, 2e-3), epoch_s).course

    @property
    def nodes(self) -> int:
        """Vehicles and roadside units."""
        return self.vehicles + len(self.places_m)

    def start(self, position_m: Array, heading_rad: Array) -> JointState:
        """State at positions (F, V, 3) and headings (F, V), known to the declared sigmas."""
        c, fleets = self.config, len(position_m)
        own = np.zeros((fleets, self.vehicles, OWN))
        own[..., :3], own[..., 3] = position_m, heading_rad
        sigma = [c.start_m] * 3 + list(np.deg2rad([c.start_heading_deg, c.gyro_bias_degps])) + [c.odometer_scale]
        area = self._count - OWN * self.vehicles
        mean = np.concatenate([own.reshape(fleets, -1), np.zeros((fleets, area))], -1)
        variance = np.concatenate([np.tile(np.square(sigma), self.vehicles), np.ones(area)])
        covariance = np.broadcast_to(np.diag(variance), (fleets, len(variance), len(variance))).copy()
        return JointState(mean, covariance, np.zeros((fleets, self.vehicles)), np.zeros(fleets))

    def predict(self, state: JointState, turn_rad: Array, speed_mps: Array, dt_s: float) -> None:
        """Move the vehicles by turns (F, V) of gyros and speeds (F, V) of odometers over ``dt_s``, in place."""
        c, own = self.config, self._own(state.mean)
        middle = own[..., 3] + 0.5 * (turn_rad - own[..., 4] * dt_s)
        step = speed_mps / (1.0 + own[..., 5]) * dt_s
        ahead = np.stack([np.sin(middle), np.cos(middle)], -1)
        right = np.stack([ahead[..., 1], -ahead[..., 0]], -1)
        moves = np.zeros((*own.shape, OWN)) + np.eye(OWN)
        moves[..., :2, 3] = step[..., None] * right
        moves[..., :2, 4] = -0.5 * dt_s * step[..., None] * right
        moves[..., :2, 5] = -(step / (1.0 + own[..., 5]))[..., None] * ahead
        moves[..., 3, 4] = -dt_s
        own[..., :2] += step[..., None] * ahead
        own[..., 3] += turn_rad - own[..., 4] * dt_s
        along = np.square(c.odometer_mps * dt_s) + np.square(c.slip * speed_mps) * dt_s
        across = c.sideways_mps**2 * dt_s
        noise = np.zeros((*own.shape, OWN))
        noise[..., :2, :2] = (
            along[..., None, None] * ahead[..., :, None] * ahead[..., None, :]
            + across * right[..., :, None] * right[..., None, :]
        )
        noise[..., 2, 2] = c.climb_mps**2 * dt_s
        noise[..., 3, 3] = np.deg2rad(c.gyro_degps) ** 2 * dt_s + np.square(c.gyro_scale * turn_rad)
        noise[..., 4, 4] = np.deg2rad(c.gyro_walk_degps) ** 2 * dt_s
        for v in range(self.vehicles):
            mine = slice(OWN * v, OWN * (v + 1))
            state.covariance[:, mine] = moves[:, v] @ state.covariance[:, mine]
            state.covariance[:, :, mine] = state.covariance[:, :, mine] @ np.swapaxes(moves[:, v], -1, -2)
            state.covariance[:, mine, mine] += noise[:, v]
        state.speed_mps = speed_mps
        state.since_s += dt_s

    def errors(self, los_enu: Array, cn0_dbhz: Array, moving: Bools) -> tuple[CodeErrorParts, Array, Array]:
        """Declared parts of codes (..., S); the variances of noise that is white, or bounded by white noise, and of
        multipath that lasts (..., S) [m^2].

        Multipath passes while a node moves (``moving`` (..., 1)); at rest it lasts for minutes.
        """
        budget = self.config.codes
        parts = budget.errors(np.broadcast_to(los_enu[:, 2], cn0_dbhz.shape), cn0_dbhz)
        white = budget.noise_m**2
        lasting = parts.fast_m2 * (1.0 - white / (white + budget.multipath_m**2 + budget.reflections_m**2))
        course = bound_correlation(0.1, budget.multipath_tau_s, self.epoch_s).course
        passing = np.where(moving, lasting, 0.0)
        return parts, parts.fast_m2 - lasting + course * passing, lasting - passing

    def update(self, state: JointState, los_enu: Array, codes: Codes, uses: Bools | None = None) -> Bools:
        """Take the codes and range rates of an epoch, in place; returns those of which codes were used (F, N, S).

        ``uses`` (F, N): whose codes each fleet uses; all without.
        """
        self._age(state)
        c, fleets, v, coded = self.config, len(state.mean), self.vehicles, self.vehicles + len(self._units_at)
        codes = codes.each(lambda x: np.broadcast_to(x, (fleets, *x.shape[-2:]))[:, :coded])
        moving = np.zeros((fleets, coded, 1), np.bool_)
        moving[:, :v, 0] = state.speed_mps > MOVING_MPS
        parts, bound, lasting = self.errors(los_enu, codes.cn0_dbhz, moving)
        bound[:, :v] += self._rest_course * lasting[:, :v]
        used = codes.used & (True if uses is None else uses[:, :coded, None])
        design, expected = self.code_rows(state, los_enu, parts, lasting)
        used = used & np.isfinite(codes.code_m)
        innovation = np.where(used, codes.code_m - expected, 0.0)
        plain = np.minimum(bound, parts.fast_m2)
        tracked, used = used, used & self._inside(state, design, innovation, plain, used)
        weight = clock_free(np.where(used, 1.0 / bound, 0.0), self.system)
        rates, rate_rows = self._rate_rows(state, los_enu)
        known = used[:, :v] & np.isfinite(codes.rate_mps[:, :v])
        left = np.where(known, codes.rate_mps[:, :v] - rates, 0.0)
        noise = c.doppler_mps**2 * parts.factor[:, :v]
        good = known & self._inside(state, rate_rows, left, noise, known)
        free = clock_free(np.where(good, 1.0 / (noise * self._rate_course), 0.0), np.zeros_like(self.system))
        state.misfit *= np.exp(-self.epoch_s / MISFIT_S)
        state.misfit += c.gate_sigmas**2 * (tracked & ~used).sum((1, 2))
        self._take(
            state,
            np.concatenate([design, rate_rows], 1),
            np.concatenate([innovation, left], 1),
            np.concatenate([weight, free], 1),
            np.concatenate([plain, noise], 1),
        )
        return np.asarray(used)

    def shifts(self, state: JointState, los_enu: Array, codes: Codes) -> tuple[Array, Array]:
        """How much better the codes of each node fit if all of it is elsewhere, and how well they do then; of row 0.

        With the covariance C of the innovations n, free clocks taken out (M), and E the lines of sight: ``n'M E (E'M
        E)^-1 E'M n``, of 3 degrees of freedom without a shift, and what it leaves of ``n'M n`` over its degrees of
        freedom; (N,) each, 0 and inf of fewer than ``LEAST_CODES``. The state is that before the epoch's update.
        """
        row = replace(state, mean=state.mean[:1], covariance=state.covariance[:1], speed_mps=state.speed_mps[:1])
        coded = self.vehicles + len(self._units_at)
        cn0, used = codes.cn0_dbhz[None, :coded], codes.used[:coded]
        parts, _, lasting = self.errors(los_enu, cn0, np.zeros((1, coded, 1), np.bool_))
        design, expected = self.code_rows(row, los_enu, parts, lasting)
        gain, left = np.zeros(self.nodes), np.full(self.nodes, np.inf)
        for node in np.flatnonzero(used.sum(-1) >= LEAST_CODES):
            among = used[node]
            rows, clocks = design[0, node, among], self.system[among][:, None] == np.unique(self.system[among])
            noise = parts.fast_m2[0, node, among] - (lasting[0, node, among] if node >= self.vehicles else 0.0)
            whole = np.linalg.inv(rows @ row.covariance[0] @ rows.T + np.diag(noise))
            free = whole - whole @ clocks @ np.linalg.solve(clocks.T @ whole @ clocks, clocks.T @ whole)
            innovation, toward = codes.code_m[node, among] - expected[0, node, among], los_enu[among]
            seen = toward.T @ free @ innovation
            gain[node] = seen @ np.linalg.lstsq(toward.T @ free @ toward, seen, rcond=1e-9)[0]
            freedom = max(int(among.sum()) - clocks.shape[1] - 3, 1)
            left[node] = (innovation @ free @ innovation - gain[node]) / freedom
        return gain, left

    def update_ranges(
        self, state: JointState, ends: Ints, range_m: Array, sigma_m: Array, uses: Bools | None = None
    ) -> Bools:
        """Take ranges (M,) between nodes ``ends`` (M, 2), in place; returns which each fleet used (F, M).

        Ranges beyond the gate are left out: a delayed one must not move the position. ``uses`` (F, N): nodes whose
        ranges each fleet uses.
        """
        if not len(ends):
            return np.zeros((len(state.mean), 0), np.bool_)
        place, first, second = self.positions(state), *ends.T
        spread = np.zeros((len(state.mean), self.nodes, 3, self.nodes, 3))
        spread[:, : self.vehicles, :, : self.vehicles] = self.covariances(state)
        apart = sum(s * spread[:, a, :, b] for a, b, s in (
            (first, first, 1), (second, second, 1), (first, second, -1), (second, first, -1)))  # fmt: skip
        line = line_between(place[:, first], place[:, second], np.moveaxis(np.asarray(apart), 0, 1))
        rows = np.zeros((*line.distance_m.shape, state.mean.shape[-1]))
        for m, (i, j) in enumerate(ends):
            for node, sign in ((i, 1.0), (j, -1.0)):
                if node < self.vehicles:
                    rows[:, m, OWN * node : OWN * node + 3] = sign * line.unit[:, m]
        innovation = range_m - line.distance_m - line.bend_m
        noise = np.square(sigma_m) + self._bend_course * line.bend_m2
        total = np.einsum("fmi,fij,fmj->fm", rows, state.covariance, rows) + noise
        among = np.ones_like(innovation, np.bool_)
        if uses is not None:
            among &= uses[:, ends[:, 0]] & uses[:, ends[:, 1]]
        among &= np.isfinite(range_m)
        used = among & (np.abs(innovation) <= self.config.gate_sigmas * np.sqrt(total))
        state.misfit += self.config.gate_sigmas**2 * (among & ~used).sum(-1)
        weight = (np.where(used, 1.0 / noise, 0.0)[..., None] * np.eye(len(ends)))[:, None]
        self._take(state, rows[:, None], np.where(used, innovation, 0.0)[:, None], weight, noise[:, None])
        return np.asarray(used)

    def positions(self, state: JointState) -> Array:
        """Of all nodes (F, N, 3) [m]."""
        fixed = np.broadcast_to(self.places_m, (len(state.mean), *self.places_m.shape))
        return np.concatenate([self._own(state.mean)[..., :3], fixed], 1)

    def covariances(self, state: JointState) -> Array:
        """Of the positions of each pair of vehicles (F, V, 3, V, 3) [m^2]."""
        among = (OWN * np.arange(self.vehicles)[:, None] + np.arange(3)).reshape(-1)
        shape = (len(state.mean), self.vehicles, 3, self.vehicles, 3)
        return state.covariance[:, among[:, None], among].reshape(shape)

    def way_covariance(self, state: JointState, way_m: Array, time_s: float) -> Array:
        """Covariance (F, V, 3, 3) of the error of ways (F, V, 3) by dead reckoning over ``time_s`` [m^2].

        Along the way scale error and noise of the odometer, as if it lasted; across it the error of the heading.
        """
        c, at = self.config, OWN * np.arange(self.vehicles)
        length = np.hypot(way_m[..., 0], way_m[..., 1])
        ahead = way_m[..., :2] / np.maximum(length, 1e-9)[..., None]
        right = np.stack([ahead[..., 1], -ahead[..., 0]], -1)
        white = c.odometer_mps**2 * time_s**2 + np.square(c.slip * length) / time_s
        along = np.square(length) * state.covariance[:, at + 5, at + 5] + white
        across = np.square(length) * state.covariance[:, at + 3, at + 3] + c.sideways_mps**2 * time_s
        out = np.zeros((*length.shape, 3, 3))
        out[..., :2, :2] = (
            along[..., None, None] * ahead[..., :, None] * ahead[..., None, :]
            + across[..., None, None] * right[..., :, None] * right[..., None, :]
        )
        out[..., [0, 1], [0, 1]] += c.sideways_mps**2 * time_s
        out[..., 2, 2] = c.climb_mps**2 * time_s
        return out

    def _own(self, mean: Array) -> Array:
        """The states of the vehicles (F, V, 6), as a view."""
        return mean[:, : OWN * self.vehicles].reshape(len(mean), self.vehicles, OWN)

    def _age(self, state: JointState) -> None:
        """Let the errors of the area pass, since the last codes, as stationary processes of unit variance."""
        c, kept = self.config, np.ones(self._count)
        kept[self._common.start :] = np.exp(-state.since_s / c.satellite_tau_s)
        for at in self._units_at:
            kept[at : at + len(self.system)] = np.exp(-state.since_s / c.codes.rest_tau_s)
        state.mean *= kept
        state.covariance *= kept[:, None] * kept
        every = np.arange(len(kept))
        state.covariance[:, every, every] += 1.0 - kept**2
        state.since_s = 0.0

    def code_rows(
        self, state: JointState, los_enu: Array, parts: CodeErrorParts, lasting: Array
    ) -> tuple[Array, Array]:
        """Design (F, N, S, n) and expected codes (F, N, S) of the nodes whose codes are used."""
        every, units = np.arange(len(self.system)), len(self._units_at)
        design = np.zeros((len(state.mean), self.vehicles + units, len(every), self._count))
        own = np.sqrt(parts.own_m2)
        for v in range(self.vehicles):
            design[:, v, :, OWN * v : OWN * v + 3] = -los_enu
        design[..., every, self._errors + every] = own
        for g, at in enumerate(self._units_at, self.vehicles):
            design[:, g, every, at + every] = np.sqrt(lasting[:, g])
        design[..., self._common] = parts.common_m
        errors = slice(self._common.start, None)
        known = np.einsum("fnsk,fk->fns", design[..., errors], state.mean[:, errors])
        return design, known - self.positions(state)[:, : design.shape[1]] @ los_enu.T

    def _rate_rows(self, state: JointState, los_enu: Array) -> tuple[Array, Array]:
        """Expected range rates (F, V, S) and their design (F, V, S, n)."""
        own = self._own(state.mean)
        speed = state.speed_mps / (1.0 + own[..., 5])
        sine, cosine = np.sin(own[..., 3]), np.cos(own[..., 3])
        toward = sine[..., None] * los_enu[:, 0] + cosine[..., None] * los_enu[:, 1]
        turned = cosine[..., None] * los_enu[:, 0] - sine[..., None] * los_enu[:, 1]
        design = np.zeros((*toward.shape, state.mean.shape[-1]))
        for v in range(self.vehicles):
            design[:, v, :, OWN * v + 3] = -speed[:, v, None] * turned[:, v]
            design[:, v, :, OWN * v + 5] = (speed[:, v] / (1.0 + own[:, v, 5]))[:, None] * toward[:, v]
        return -speed[..., None] * toward, design

    def _inside(self, state: JointState, design: Array, innovation: Array, variance: Array, used: Bools) -> Bools:
        """Whether innovations (F, K, S) less the (lower) median of their node and system are inside the gate.

        The clock is unknown, and a median is moved by reflected signals least.
        """
        spread = np.einsum("fksi,fij,fksj->fks", design, state.covariance, design, optimize=True) + variance
        centred = innovation.copy()
        for number in np.unique(self.system):
            among = used & (self.system == number)
            ordered, count = np.sort(np.where(among, innovation, np.inf), -1), among.sum(-1, keepdims=True)
            middle = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, -1)
            centred -= np.where(among, np.where(count > 0, middle, 0.0), 0.0)
        return np.asarray(np.abs(centred) <= self.config.gate_sigmas * np.sqrt(spread))

    def _take(self, state: JointState, design: Array, innovation: Array, weight: Array, noise: Array) -> None:
        """Kalman update in information form by blocks of rows, design (F, K, S, n), weight matrices (F, K, S, S).

        noise (F, K, S): variances of the errors of an epoch, which the weights bound over many.
        """
        weighted = weight @ design
        normal = np.einsum("fksi,fksj->fij", design, weighted, optimize=True)
        right = np.einsum("fksi,fks->fi", weighted, innovation)
        count = normal.shape[-1]
        gained = np.linalg.solve(np.eye(count) + state.covariance @ normal, state.covariance)
        state.covariance = 0.5 * (gained + np.swapaxes(gained, -1, -2))
        moved = np.einsum("fij,fj->fi", state.covariance, right)
        # Of the innovations n with weights W and design H, n'(W^-1 + H P H')^-1 n = n'W n - moved'right.
        state.misfit += np.einsum("fks,fkst,fkt->f", innovation, weight, innovation, optimize=True)
        state.misfit -= (moved * right).sum(-1) + np.einsum("fkss,fks->f", weight, noise)
        state.mean = state.mean + moved


LEAST_CODES = 6  # fewer say nothing of a whole node
MISFIT_S = 10.0  # over which a contradiction counts; chosen, some epochs of codes
MOVING_MPS = 1.0  # slower, multipath counts as that of a vehicle at rest
