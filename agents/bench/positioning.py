"""Speed of integers, levels and monitors, against plain forms and, where it is installed, sidereon 3.0.4 (Rust)."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import nullcontext
from importlib import import_module
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.bench.runner import Row, alternate, median_ratio, plain_form
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.araim import AraimConfig, levels_at
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.kinds import CODES, FAMILY, monitor_named
from lanebound.integrity.monitoring.family.monitor import MEMORY, watch
from lanebound.integrity.monitoring.fault_modes import enumerate_faults
from lanebound.integrity.monitoring.protection import protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.positioning import lambda_kernel as kernel
from lanebound.integrity.positioning.ambiguity import NODE_LIMIT

Array = NDArray[np.float64]

SATELLITES, EPOCHS, DT_S = 11, 400, 0.1
CODE_M, PHASE_M = 0.3, 0.003
WAVELENGTHS_M = (0.190293673, 0.244210213)  # GPS L1 and L2
SKY_RATE_RADPS = 1.2e-4  # how fast satellites of a 12-hour orbit move across the sky


def _covariance(elevation: Array, azimuth: Array) -> Array:
    """Covariance (n, n) [cycles^2] of the double-differenced ambiguities of two bands, code and phase of one epoch."""
    e = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1)
    pairs = len(elevation) - 1
    difference = np.hstack([-np.ones((pairs, 1)), np.eye(pairs)])
    weights = np.linalg.inv(2 * difference @ np.diag(np.sin(elevation) ** -2) @ difference.T)
    normal = np.zeros((3 + 2 * pairs, 3 + 2 * pairs))
    for band, wavelength in enumerate(WAVELENGTHS_M):
        for sigma, scale in ((CODE_M, 0.0), (PHASE_M, wavelength)):
            rows = np.zeros((pairs, 3 + 2 * pairs))
            rows[:, :3] = -difference @ e
            rows[:, 3 + band * pairs : 3 + (band + 1) * pairs] = scale * np.eye(pairs)
            normal += rows.T @ weights @ rows / sigma**2
    Q = np.linalg.inv(normal)[3:, 3:]
    return np.asarray((Q + Q.T) / 2)


def drifting_problems(seed: int = 3) -> tuple[Array, Array]:
    """Float ambiguities (E, 20) and covariances (E, 20, 20) of one sky at 10 Hz, satellites moving."""
    rng = np.random.default_rng(seed)
    elevation = np.arcsin(rng.uniform(np.sin(np.radians(15)), 1.0, SATELLITES))
    azimuth = rng.uniform(0, 2 * np.pi, SATELLITES)
    rates = SKY_RATE_RADPS * rng.uniform(-1, 1, (2, SATELLITES))
    Q = np.stack([_covariance(elevation + rates[0] * t, azimuth + rates[1] * t) for t in DT_S * np.arange(EPOCHS)])
    true = rng.integers(-50, 50, Q.shape[-1])
    noise = rng.standard_normal((EPOCHS, Q.shape[-1], 1))
    return true + (np.linalg.cholesky(Q) @ noise)[..., 0], Q


def measure_ambiguity(rounds: int = 5) -> list[Row]:
    """Warm compiled fix of 20 integers against the plain one, both returning the two best candidates; compared first.

    The plain form is that of a checkout; without one its row is left out.
    """
    a, Q = drifting_problems()
    candidates, norms = np.empty((EPOCHS, 2, a.shape[-1])), np.empty((EPOCHS, 2))
    failure_rate, status = np.empty(EPOCHS), np.empty(EPOCHS, dtype=np.int64)
    plain, turn = plain_form("plain_ambiguity"), itertools.cycle(range(EPOCHS))

    def run(reuse: bool) -> int:
        kernel.solve_epochs(a, Q, NODE_LIMIT, reuse, candidates, norms, failure_rate, status)
        return EPOCHS

    def slow() -> int:
        e = next(turn)
        plain.integer_least_squares(a[e], Q[e])
        return 1

    run(True)
    sides = {"warm": lambda: run(True), "cold": lambda: run(False)}
    if plain is not None:
        checked = plain.integer_least_squares(a[:5], Q[:5])
        if status.any() or not np.array_equal(checked.candidates, candidates[:5]):
            raise AssertionError("compiled and plain integer least squares disagree")
        sides["plain"] = slow
    rates = alternate(sides, rounds)
    rows = [] if plain is None else [
        Row("lambda_n20_vs_python", median_ratio(rates, "warm", "plain"), "x", gate=500, stretch=1000)
    ]  # fmt: skip
    return [
        *rows,
        Row("lambda_n20_us", 1e6 / median(rates["warm"]), "us", higher_is_better=False),
        Row("lambda_n20_cold_us", 1e6 / median(rates["cold"]), "us", higher_is_better=False),
    ]


LEVEL_SATELLITES = 30
LEVEL_SYSTEMS = 4
FAST_EPOCHS = 20_000
SLOW_EPOCHS = 40
RISK = RiskConfig(integrity_risk=1e-6, satellite_prior=(1e-5,) * 5)


class Sky:
    """Random epochs: lines of sight, clock group, variances for integrity and accuracy, biases, headings."""

    def __init__(self, epochs: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        shape = (epochs, LEVEL_SATELLITES)
        elevation = np.arcsin(rng.uniform(np.sin(np.radians(8.0)), 1.0, shape))
        azimuth = rng.uniform(0.0, 2.0 * np.pi, shape)
        flat = np.cos(elevation)
        self.los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
        self.group = rng.permuted(np.tile(np.arange(LEVEL_SATELLITES) % LEVEL_SYSTEMS, (epochs, 1)), axis=1)
        self.variance = 0.09 + 0.04 / np.sin(elevation) ** 2
        self.accuracy = 0.6 * self.variance
        self.bias = rng.uniform(0.0, 0.2, shape)
        self.heading = rng.uniform(0.0, 2.0 * np.pi, epochs)

    def kernel(self, parallel: bool) -> Array:
        """Levels of all epochs by the kernels.  (E, 2) [m]."""
        with nullcontext() if parallel else serial():
            levels = protection_levels_batch(
                self.los, True, self.group, self.variance, self.heading, RISK, accuracy_m2=self.accuracy,
                bias_m=self.bias,
            )  # fmt: skip
        return levels.root_m[:, 0]

    def by(self, plain: Any) -> Array:
        """The same levels by a plain form of an epoch.  (E, 2) [m]."""
        rows = zip(self.los, self.group, self.variance, self.accuracy, self.bias, self.heading, strict=True)
        return np.array([plain.plain_levels(*row, RISK) for row in rows])


def measure_protection(rounds: int = 5) -> list[Row]:
    """Rate of protection levels on all threads and on one, and ratio to a plain form, which is compared first.

    The plain form is that of a checkout; without one its row is left out.
    """
    small, large, plain = Sky(SLOW_EPOCHS, 1), Sky(FAST_EPOCHS, 2), plain_form("plain_protection")

    def fast(parallel: bool) -> int:
        large.kernel(parallel)
        return FAST_EPOCHS

    def slow() -> int:
        small.by(plain)
        return SLOW_EPOCHS

    sides = {"threads": lambda: fast(True), "one": lambda: fast(False)}
    if plain is not None:
        worst = float(np.abs(small.kernel(False) / small.by(plain) - 1.0).max())
        if not worst < 1e-8:
            raise InputError(f"the kernel must equal the plain form to 1e-8, it differs by {worst}: fix it first")
        sides["naive"] = slow
    rates = alternate(sides, rounds)
    rows = [] if plain is None else [
        Row("pl_kernel_n30_vs_naive", median_ratio(rates, "threads", "naive"), "x", gate=800.0, stretch=3000.0)
    ]  # fmt: skip
    return [
        *rows,
        Row("pl_kernel_n30_epochs_per_s", float(np.median(rates["threads"])), "1/s", stretch=3.0e6),
        Row("pl_kernel_n30_epochs_per_s_one_core", float(np.median(rates["one"])), "1/s"),
    ]


MONITOR_SATELLITES, MONITOR_SYSTEMS, MONITOR_EPOCHS = 30, 4, 4096
GATE = 1e5  # epochs/s of snapshot monitors that have one solution and a closed level; issue 25
GATED = ("residual", "weighted", "ibpl", "sbas")
SHOWN = tuple(k.name for k in FAMILY.values() if k.needs == (CODES,) and k.config().level not in MEMORY)
"""Snapshot monitors of codes; those with an exclusion, weights or modes do not reach the gate, and are shown."""
FEWER = {"ransac": 64, "p_ransac": 64, "araim": 256, "araim_lpv200": 256}
FEW = 1024  # epochs of other kinds without a gate


def epochs_of_noise(epochs: int, seed: int = 1) -> CodeEpochs:
    """Normal errors under a random sky."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, (epochs, MONITOR_SATELLITES))
    sine = rng.uniform(np.sin(np.radians(8.0)), 1.0, (epochs, MONITOR_SATELLITES))
    flat = np.sqrt(1.0 - sine**2)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1)
    sigma = 1.0 + 0.5 / sine
    return CodeEpochs.of(
        sigma * rng.normal(size=sine.shape), los, sigma, True, np.arange(MONITOR_SATELLITES) % MONITOR_SYSTEMS
    )


def measure_monitors(rounds: int = 5, seconds: float = 0.4) -> list[Row]:
    """Rows of all shown monitors."""

    def work(name: str) -> Callable[[], int]:
        number = MONITOR_EPOCHS if name in GATED else FEWER.get(name, FEW)
        epochs, config = epochs_of_noise(number), monitor_named(name).config()

        def once() -> int:
            with serial():
                watch(epochs, config, 1e-5)
            return epochs.count

        return once

    rates = alternate({name: work(name) for name in SHOWN}, rounds, seconds)
    return [
        Row(f"monitors: {name}", float(np.median(rates[name])), "epochs/s", gate=GATE if name in GATED else None)
        for name in SHOWN
    ]


LETTERS = "GERC"
"""Satellite numbers by the groups of this package; the systems are GPS, Galileo, GLONASS, BeiDou."""


def installed() -> bool:
    """Whether sidereon can be imported."""
    return find_spec("sidereon") is not None


def package() -> Any:
    """The module itself."""
    return import_module("sidereon")


class Araim:
    """One geometry as sidereon takes it: LPV-200 risks, single faults.

    los_enu (m, 3), group (m,) 0 to 3, variances and biases (m,). The receiver stands where equator and prime meridian
    meet, where East, North and Up are y, z and x.
    """

    def __init__(
        self,
        los_enu: Array,
        group: NDArray[np.int64],
        variance_m2: Array,
        accuracy_m2: Array,
        bias_m: Array,
        satellite_prior: float = 1e-5,
        constellation_prior: float = 1e-4,
    ) -> None:
        s = package()
        systems = (s.GnssSystem.GPS, s.GnssSystem.GALILEO, s.GnssSystem.GLONASS, s.GnssSystem.BEIDOU)
        names = [f"{LETTERS[g]}{i + 1:02d}" for i, g in enumerate(group)]
        rows = [
            s.AraimRow(name, los[[2, 0, 1]], float(np.arcsin(np.clip(los[2], -1.0, 1.0))))
            for name, los in zip(names, los_enu, strict=True)
        ]
        present = [systems[g] for g in np.unique(group)]
        self.geometry = s.AraimGeometry(rows, s.Wgs84Geodetic(0.0, 0.0, 0.0), present)
        usual = s.SatelliteIsmModel.new_with_effective_sigmas(1.0, 1.0, 0.0, satellite_prior, 1.0, 1.0)
        own = [
            s.SatelliteIsm.new_with_effective_sigmas(name, 1.0, 1.0, float(b), satellite_prior, float(i), float(a))
            for name, b, i, a in zip(names, bias_m, np.sqrt(variance_m2), np.sqrt(accuracy_m2), strict=True)
        ]
        self.message = s.Ism([s.ConstellationIsm(system, constellation_prior, usual) for system in present], own)
        self.allocation = s.IntegrityAllocation(1e-7, 9.8e-8, 2e-9, 3.9e-6, 9e-8, 8e-8, 1)
        self._solve = s.araim

    def solve(self) -> Any:
        """Its result: ``vpl_m``, ``hpl_m``, ``emt_m``, ``sigma_acc_v_m``, ``fault_modes``."""
        return self._solve(self.geometry, self.message, self.allocation)


ARAIM_SATELLITES, ARAIM_SYSTEMS, ARAIM_EPOCHS = 30, 3, 512
AGREE_M = 0.06  # sidereon solves the horizontal level to 0.05 m
RULES = AraimConfig(constellation_prior=1e-6)  # with 1e-4 pairs of three systems alone would use up the risk


def measure_independent(rounds: int = 5) -> list[Row]:
    """ARAIM levels of 30 satellites with 33 fault modes, and cold integer least squares at n = 20; compared first."""
    return [*_levels(rounds), *_integers(rounds)] if installed() else []


def _levels(rounds: int) -> list[Row]:
    rng = np.random.default_rng(4)
    elevation = np.arcsin(rng.uniform(0.14, 1.0, (ARAIM_EPOCHS, ARAIM_SATELLITES)))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, (ARAIM_EPOCHS, ARAIM_SATELLITES))
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    group = np.arange(ARAIM_SATELLITES) % ARAIM_SYSTEMS
    variance, accuracy = 0.5 + 0.3 / np.sin(elevation) ** 2, 0.3 + 0.2 / np.sin(elevation) ** 2
    bias = np.full((ARAIM_EPOCHS, ARAIM_SATELLITES), 0.5)
    theirs = [Araim(los[e], group, variance[e], accuracy[e], bias[e], 1e-5, 1e-6) for e in range(16)]
    modes = enumerate_faults(group, RULES.satellite_prior, RULES.constellation_prior, at_once=1)

    def ours() -> tuple[Array, Array]:
        with serial():
            up, plane = levels_at(los, group, variance, accuracy, bias, RULES, modes, np.ones(1))
        return up[:, 0], plane[:, 0]

    up, plane = ours()
    apart = [
        abs(one.vpl_m - v) + abs(one.hpl_m - np.hypot(*h))
        for one, v, h in zip((one.solve() for one in theirs), up, plane, strict=False)
    ]
    if not max(apart) < 2.0 * AGREE_M:
        raise InputError(f"both sides must agree to {2.0 * AGREE_M} m, they differ by {max(apart)} m: fix it first")

    def fast() -> int:
        ours()
        return ARAIM_EPOCHS

    turn = itertools.cycle(theirs)

    def slow() -> int:
        next(turn).solve()
        return 1

    rates = alternate({"ours": fast, "sidereon": slow}, rounds)
    return [
        Row("pl_kernel_n30_vs_sidereon", median_ratio(rates, "ours", "sidereon"), "x", gate=10.0, stretch=60.0),
        Row("sidereon_araim_n30_epochs_per_s", float(np.median(rates["sidereon"])), "1/s"),
    ]


def _integers(rounds: int) -> list[Row]:
    a, Q = drifting_problems()
    epochs, n = a.shape
    candidates, norms = np.empty((epochs, 2, n)), np.empty((epochs, 2))
    failure_rate, status = np.empty(epochs), np.empty(epochs, dtype=np.int64)

    def ours() -> int:
        kernel.solve_epochs(a, Q, NODE_LIMIT, False, candidates, norms, failure_rate, status)
        return int(epochs)

    search = package().lambda_ils_search
    turn = itertools.cycle(range(epochs))

    def theirs() -> int:
        e = next(turn)
        search(a[e], Q[e])
        return 1

    ours()
    for e in range(8):
        found = search(a[e], Q[e])
        if not np.array_equal(found.fixed, candidates[e, 0]):
            raise InputError(f"both sides must find the same integers, they differ at epoch {e}: fix it first")
    rates = alternate({"ours": ours, "sidereon": theirs}, rounds)
    return [Row("lambda_n20_vs_sidereon", median_ratio(rates, "ours", "sidereon"), "x", gate=5.0, stretch=20.0)]
