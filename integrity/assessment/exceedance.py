"""Rates of undetected errors above the protection levels, in random cases of the measurement model that levels assume.

A case is the geometry of one epoch: satellites, clocks, standard deviations, bounds of the nominal biases, the biases
(at their bounds, with the worst signs), and a heading. For each case the levels of several *forms* are computed: the
exact levels of this package and those printed in the papers, completely and with one printed formula at a time.

Plain Monte Carlo: an epoch is *misleading* on an axis if the separation test detects nothing and the error exceeds the
level. Faults are drawn as assumed by the levels: none, one faulty satellite, two at once, or a wrong fix that the test
cannot detect. The size of a fault is uniform up to twice the size at the threshold: most faults are harmless or
detected. The worst sizes are the subject of importance sampling below.

Rates that are too small for counting, in closed form and by importance sampling: errors and separations of one epoch
are independent, because a minimum-variance solution is uncorrelated with its residuals. A fault of size ``f`` in
satellite k is therefore misleading with the probability

    P(|x + f g_k| > PL) P(quiet | f) <= P(|x + f g_k| > PL) P(|t_k + f h_k| < threshold),

where ``g_k`` and ``h_k`` are the effects of 1 m on the error and on the separation of the satellite itself; the other
separations can only increase the detection. Levels must hold for any size. The default is therefore the size with the
largest product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.protection import closed_form, protection_levels_batch
from lanebound.integrity.monitoring.risk import (
    RiskConfig,
    Variant,
    false_alarm_factor,
    multiple_fault_risk,
    pair_risk,
    upper_quantile,
)
from lanebound.integrity.monitoring.separation import Separation, published_bias, separate
from lanebound.integrity.positioning.least_squares import design_matrix

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LOWEST_RAD = np.deg2rad(10.0)
ZENITH_SIGMA_M = 0.003 * np.sqrt(2.0)  # carrier phase, single difference; RTKLIB's default 3 mm + 3 mm / sin E
NO_ROW = 1e-12  # share of the largest separation below which a separation is zero


class Form(Enum):
    """Form of a protection level: that of this package, of the papers, or with one printed formula."""

    ROOT = "exact root"
    CLOSED = "exact closed form"
    PUBLISHED = "published"
    BIAS = "published bias"
    THRESHOLD = "published K_fa"
    FACTOR = "published K_md"

    @property
    def meaning(self) -> str:
        """Description of the form with its source."""
        return MEANINGS[self]


MEANINGS = {
    Form.ROOT: "multi-hypothesis root with exact factors and biases (S2 eq 10-11)",
    Form.CLOSED: "closed form with exact factors and biases (S1 eq 17)",
    Form.PUBLISHED: "S1 eq 17 as printed: K_fa = Qinv(a/2n), K_md = Qinv(risk), bias by squares of signed sums",
    Form.BIAS: "exact closed form but for the printed bias",
    Form.THRESHOLD: "exact closed form but for the printed K_fa",
    Form.FACTOR: "exact closed form but for the printed K_md",
}


class Worst(Enum):
    """Axis for which the signs of the nominal biases are the worst."""

    ALONG = 0
    ACROSS = 1
    NEITHER = 2


@dataclass(frozen=True)
class Case:
    """A geometry: los_enu (n, 3), group (n,), sigma_m, bias_bound_m and bias_m (n,), heading_rad.

    ``bias_share`` is the largest bound of a bias, in sigmas.
    """

    los_enu: Array
    group: Ints
    sigma_m: Array
    bias_bound_m: Array
    bias_m: Array
    heading_rad: float
    worst: Worst
    bias_share: float

    def __len__(self) -> int:
        return int(self.group.size)


@dataclass(frozen=True)
class Prepared:
    """A case with the matrices for its draws.

    Attributes
    ----------
    error_rows : (2, n) ``R S diag(sigma)``: error along and across of unit normal draws
    shift : (2,) error due to the nominal biases [m]
    test_rows : (n, n) the same of the normalised separations, one row for each satellite
    test_shift : (n,) normalised separations due to the biases
    fault_error : (n, 2) error of a fault of 1 m in each satellite
    fault_test : (n, n) normalised separations of that fault, one row for each faulty satellite
    threshold : of the separation test, in sigmas
    tolerant_rows : (n, 2, n) ``R S_k diag(sigma)``
    tolerant_shift : (n, 2) error due to the biases in the solution without satellite k [m]
    prior : (n,) fault probability of each satellite
    levels_m : by form (R, 2) [m], inf for none
    """

    case: Case
    error_rows: Array
    shift: Array
    test_rows: Array
    test_shift: Array
    fault_error: Array
    fault_test: Array
    threshold: float
    tolerant_rows: Array
    tolerant_shift: Array
    prior: Array
    levels_m: dict[Form, Array]

    @property
    def sigma_of_fault_m(self) -> Array:
        """Size of a fault in each satellite with a separation of one sigma, 0 if there is none.  (n,) [m]."""
        own = np.abs(np.diag(self.fault_test))  # of either sign: of the error on the axis that it moves most
        return np.where(own > 0.0, 1.0 / np.where(own > 0.0, own, 1.0), 0.0)


def draw_case(generator: np.random.Generator, satellites: int, bias_share: float = 0.5) -> Case:
    """Draw a case of ``satellites`` with 1 to 4 clocks and any heading; bias bounds are up to ``bias_share`` sigma.

    Raises
    ------
    InputError
        There are fewer than 5 satellites, so that none can be excluded.
    """
    if satellites < 5:
        raise InputError(f"satellites must be at least 5, got {satellites}: fewer satellites allow no fault detection")
    most = min(4, 1 + (satellites - 5) // 3)  # S1 section 2: 3 more for each further system
    clocks = int(generator.integers(1, most + 1))
    group = np.sort(np.concatenate([np.arange(clocks).repeat(2), generator.integers(0, clocks, satellites)]))
    group = group[np.sort(generator.permutation(group.size)[:satellites])]
    elevation = np.arcsin(generator.uniform(np.sin(LOWEST_RAD), 1.0, satellites))
    azimuth = generator.uniform(0.0, 2.0 * np.pi, satellites)
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    sigma = ZENITH_SIGMA_M * np.hypot(1.0, 1.0 / np.sin(elevation))
    bound = bias_share * generator.uniform(0.0, 1.0, satellites) * sigma
    heading = float(generator.uniform(-np.pi, np.pi))
    worst = Worst(int(generator.integers(3)))
    signs = generator.choice([-1.0, 1.0], satellites)
    if worst is not Worst.NEITHER:
        rows = _separation(los, group, sigma, bound, heading).gain_track[0]
        signs = np.where(rows[worst.value] < 0.0, -1.0, 1.0)
    return Case(los, group, sigma, bound, signs * bound, heading, worst, bias_share)


def _separation(los: Array, group: Ints, sigma: Array, bound: Array, heading: float) -> Separation:
    """Solutions without each satellite, by the plain NumPy implementation."""
    design = design_matrix(los, group, int(group.max()) + 1)
    return separate(design, np.diag(sigma**2), np.eye(group.size, dtype=bool), heading, bias=bound)


def prepare(cases: Sequence[Case], config: RiskConfig, risks: ArrayLike, spent: float = 0.0) -> list[Prepared]:
    """Compute levels of every form and risk (R,), and the matrices from draws to errors and separations."""
    wanted = config.risks(risks)
    exact = _exact_levels(cases, config, wanted, spent)
    return [_prepared(case, config, wanted, spent, levels) for case, levels in zip(cases, exact, strict=True)]


def _exact_levels(cases: Sequence[Case], config: RiskConfig, risks: Array, spent: float) -> list[dict[Form, Array]]:
    """Multi-hypothesis and closed-form levels of all cases by the kernels, padded to the largest case."""
    size = max(map(len, cases))

    def padded(name: str, fill: float) -> Array:
        columns = [np.asarray(getattr(case, name)) for case in cases]
        out = np.full((len(cases), size, *columns[0].shape[1:]), fill)
        for row, column in zip(out, columns, strict=True):
            row[: len(column)] = column
        return out

    found = protection_levels_batch(
        padded("los_enu", 0.0),
        np.arange(size) < np.array([len(case) for case in cases])[:, None],
        padded("group", 0.0),
        padded("sigma_m", 1.0) ** 2,
        [case.heading_rad for case in cases],
        config,
        risks,
        bias_m=padded("bias_bound_m", 0.0),
        spent=spent,
        closed=True,
    )
    return [{Form.ROOT: r, Form.CLOSED: c} for r, c in zip(found.root_m, found.closed_m, strict=True)]


def _prepared(case: Case, config: RiskConfig, risks: Array, spent: float, levels: dict[Form, Array]) -> Prepared:
    n = len(case)
    found = _separation(case.los_enu, case.group, case.sigma_m, case.bias_bound_m, case.heading_rad)
    track = found.gain_track
    apart = np.where(found.solved[1:, None, None], track[0] - track[1:], 0.0)  # (n, 2, n)
    axis = found.delta_m[1:].argmax(-1)
    row = np.take_along_axis(apart, axis[:, None, None], 1)[:, 0]
    delta = np.take_along_axis(found.delta_m[1:], axis[:, None], 1)
    tests = np.where(delta > NO_ROW * delta.max(), row / np.maximum(delta, 1e-300), 0.0)
    prior = np.array(config.satellite_prior)[case.group]
    return Prepared(
        case=case,
        error_rows=track[0] * case.sigma_m,
        shift=track[0] @ case.bias_m,
        test_rows=tests * case.sigma_m,
        test_shift=tests @ case.bias_m,
        fault_error=track[0].T,
        fault_test=tests.T,
        threshold=float(false_alarm_factor(config.false_alarm, n)),
        tolerant_rows=track[1:] * case.sigma_m,
        tolerant_shift=track[1:] @ case.bias_m,
        prior=prior,
        levels_m=levels | _printed_levels(case, found, config, risks, spent, prior),
    )


def _printed_levels(
    case: Case, found: Separation, config: RiskConfig, risks: Array, spent: float, prior: Array
) -> dict[Form, Array]:
    """Levels with the printed formulas, all of them and one at a time, where exact levels exist."""
    n = len(case)
    enu = track_from_enu_matrix(case.heading_rad) @ found.gain_track  # the rotation is its own inverse
    signed = published_bias(enu, np.broadcast_to(case.bias_bound_m, (n + 1, n)), np.full(n + 1, case.heading_rad))
    biased = Separation(found.sigma_m, found.delta_m, signed, found.separation_m, found.status, found.gain_track)
    exact, printed = (float(false_alarm_factor(config.false_alarm, n, v)) for v in (Variant.EXACT, Variant.PUBLISHED))
    outside = spent + config.unmonitored_risk + (float(pair_risk(prior)) if config.subtract_multiple else 0.0)
    budgets = config.axis_budgets(risks, outside)
    columns = np.concatenate([[2.0], prior])[:, None]
    out: dict[Form, Array] = {
        form: np.full((risks.size, 2), np.inf) for form in Form if form not in (Form.ROOT, Form.CLOSED)
    }
    for r, risk in enumerate(risks):
        unsplit = np.full(n + 1, upper_quantile(risk))
        out[Form.PUBLISHED][r] = closed_form(biased, printed, unsplit)
        out[Form.FACTOR][r] = closed_form(found, exact, unsplit)
        if (budgets[r] > 0.0).all() and found.solved.all():
            with np.errstate(divide="ignore"):
                k_md = upper_quantile(budgets[r] / (n + 1) / columns)
            out[Form.BIAS][r] = closed_form(biased, exact, k_md)
            out[Form.THRESHOLD][r] = closed_form(found, printed, k_md)
    return out


STRATA = ("no fault", "one fault", "two faults", "wrong fix")
AXES = 2
BLOCK = 4096  # epochs drawn at once, which fit into the processor cache
LARGEST_FAULT = 2.0  # in units of the size whose separation is at the threshold
WAVELENGTH_M = 0.19029367279836487  # L1


@dataclass
class ExceedanceCounts:
    """Counts of misleading epochs: ``misleading[form]`` (R, 3, strata) along, across, either; ``epochs`` (strata,).

    ``available[form]`` (R,) epochs with a finite level, ``alarms`` (strata,) epochs with a detection.
    """

    misleading: dict[Form, Ints]
    available: dict[Form, Ints]
    epochs: Ints
    alarms: Ints = field(default_factory=lambda: np.zeros(len(STRATA), np.int64))

    @staticmethod
    def empty(risks: int) -> ExceedanceCounts:
        """Counts of zero."""
        return ExceedanceCounts(
            {form: np.zeros((risks, AXES + 1, len(STRATA)), np.int64) for form in Form},
            {form: np.zeros(risks, np.int64) for form in Form},
            np.zeros(len(STRATA), np.int64),
        )


def tally(
    prepared: Prepared, epochs: int, wrong_fix: float, generator: np.random.Generator, into: ExceedanceCounts
) -> None:
    """Draw ``epochs`` of a case and add the counts to ``into``; ``wrong_fix`` is the probability of a wrong fix."""
    strata = _numbers_of_strata(prepared, epochs, wrong_fix, generator)
    for form, levels in prepared.levels_m.items():
        into.available[form] += epochs * np.isfinite(levels).all(-1)
    for stratum, count in enumerate(strata):
        into.epochs[stratum] += count
        for first in range(0, count, BLOCK):
            _count_block(prepared, stratum, min(BLOCK, count - first), generator, into)


def _numbers_of_strata(prepared: Prepared, epochs: int, wrong_fix: float, generator: np.random.Generator) -> Ints:
    """Draw the numbers of epochs without fault, with one fault, with two, and with a wrong fix."""
    none, more = float(np.prod(1.0 - prepared.prior)), float(multiple_fault_risk(prepared.prior))
    faults = np.array([none, max(1.0 - none - more, 0.0), more])
    return np.asarray(generator.multinomial(epochs, [*(1.0 - wrong_fix) * faults, wrong_fix]))


def _count_block(
    prepared: Prepared, stratum: int, count: int, generator: np.random.Generator, into: ExceedanceCounts
) -> None:
    normal = generator.standard_normal((count, len(prepared.case)))
    error = normal @ prepared.error_rows.T + prepared.shift
    statistic = normal @ prepared.test_rows.T + prepared.test_shift
    if STRATA[stratum] == "wrong fix":
        turn = generator.uniform(0.0, 2.0 * np.pi, count)
        error += WAVELENGTH_M * np.stack([np.sin(turn), np.cos(turn)], -1)  # a shift of the position has no residual
    for _ in range({"one fault": 1, "two faults": 2}.get(STRATA[stratum], 0)):
        _add_faults(prepared, error, statistic, generator)
    quiet = np.maximum(statistic.max(-1), -statistic.min(-1)) < prepared.threshold
    into.alarms[stratum] += count - int(quiet.sum())
    least = np.minimum.reduce([levels.min(0) for levels in prepared.levels_m.values()])
    size = np.abs(error)
    size = size[quiet & (size > least).any(-1)]
    for form, levels in prepared.levels_m.items():
        for r, level in enumerate(levels):
            beyond = size > level
            if np.isfinite(level).all() and beyond.any():
                each = beyond.sum(0)
                into.misleading[form][r, :AXES, stratum] += each
                into.misleading[form][r, AXES, stratum] += beyond.any(-1).sum()


def _add_faults(prepared: Prepared, error: Array, statistic: Array, generator: np.random.Generator) -> None:
    """Add a fault in one satellite of each epoch, up to twice the size whose separation is at the threshold."""
    chance = prepared.prior / prepared.prior.sum()
    which = generator.choice(len(prepared.case), size=len(error), p=chance)
    reach = prepared.threshold * prepared.sigma_of_fault_m
    size = generator.uniform(-LARGEST_FAULT, LARGEST_FAULT, len(error)) * reach[which]
    error += size[:, None] * prepared.fault_error[which]
    statistic += size[:, None] * prepared.fault_test[which]


def expected_fault_free(prepared: Prepared, form: Form) -> Array:
    """Probability in closed form that a fault-free error exceeds the level, without regard to the test.  (R, 2)."""
    sigma = np.linalg.norm(prepared.error_rows, axis=-1)
    level = prepared.levels_m[form]
    return np.asarray(ndtr((prepared.shift - level) / sigma) + ndtr((-prepared.shift - level) / sigma))


def least_fault_free(prepared: Prepared, budgets: ArrayLike) -> Array:
    """Smallest levels that fault-free errors exceed with at most the probabilities ``budgets`` (R, 2).  -> (R, 2) [m].

    The difference to a protection level is the margin for faults, or conservatism.
    """
    sigma, shift = np.linalg.norm(prepared.error_rows, axis=-1), np.abs(prepared.shift)
    wanted = np.asarray(budgets, dtype=np.float64)
    low, high = np.zeros_like(wanted), shift + sigma * upper_quantile(0.5 * wanted)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = ndtr((shift - middle) / sigma) + ndtr((-shift - middle) / sigma) > wanted
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.asarray(high)


DRAWN = ("no fault", "one fault")  # sampled strata; the others are bounded by their probability
GRID = 401  # sizes tried at first, a tenth of a sigma of the separation apart or closer
BEYOND = 4.0  # sigmas of the separation, past which no size can be the worst


class FaultSize(Enum):
    """Size of a simulated fault."""

    WORST = "worst"
    UNIFORM = "uniform"


def fault_chance(prepared: Prepared, axis: int, level_m: float, size_m: Array) -> Array:
    """Probability that a fault of ``size_m`` (n, ...) in each satellite is misleading, tested by its own separation."""
    column = (slice(None),) + (None,) * (size_m.ndim - 1)
    sigma = np.linalg.norm(prepared.error_rows[axis])
    error = prepared.shift[axis] + size_m * prepared.fault_error[:, axis][column]
    apart = np.abs(prepared.test_shift[column] + size_m * np.diag(prepared.fault_test)[column])
    beyond = ndtr((error - level_m) / sigma) + ndtr((-error - level_m) / sigma)
    return np.asarray(beyond * (ndtr(prepared.threshold - apart) - ndtr(-prepared.threshold - apart)))


def worst_fault(prepared: Prepared, axis: int, level_m: float) -> tuple[Array, Array]:
    """Size of a fault in each satellite with the largest misleading probability, and this probability.  (n,) [m], (n,).

    A grid of both signs is evaluated, then twice a finer grid around the best size. In the most likely misleading case
    the separation is at the threshold and the rest of the error is in the solution without the satellite; this limits
    the range of the grid.
    """
    unit = prepared.sigma_of_fault_m
    apart = np.abs(unit * prepared.fault_error[:, axis])
    left = np.maximum(level_m + np.abs(prepared.tolerant_shift[:, axis]) - prepared.threshold * apart, 0.0)
    square = (prepared.tolerant_rows[:, axis] ** 2).sum(-1)
    reach = prepared.threshold + np.abs(prepared.test_shift) + left * apart / square + BEYOND
    middle, half = np.zeros_like(reach), reach
    for points in (GRID, 41, 41):
        size = (middle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, points)) * unit[:, None]
        chance = fault_chance(prepared, axis, level_m, size)
        best = chance.argmax(-1)
        middle = middle + half * np.linspace(-1.0, 1.0, points)[best]
        half = half * 2.0 / (points - 1)
    return middle * unit, np.asarray(chance.max(-1))


def expected_one_fault(prepared: Prepared, form: Form, sizes: FaultSize = FaultSize.WORST) -> Array:
    """Probability of a misleading fault in one satellite, along and across, in closed form.  (R, 2).

    The tests of the other satellites are ignored; the result is an upper bound, and 0 without a level.
    """
    out = np.zeros_like(prepared.levels_m[form])
    most = LARGEST_FAULT * prepared.threshold * prepared.sigma_of_fault_m
    share = (np.arange(GRID) + 0.5) / GRID * 2.0 - 1.0
    for (r, axis), level in np.ndenumerate(prepared.levels_m[form]):
        if not np.isfinite(level):
            continue
        if sizes is FaultSize.WORST:
            chance = worst_fault(prepared, axis, float(level))[1]
        else:
            chance = fault_chance(prepared, axis, float(level), most[:, None] * share).mean(-1)
        out[r, axis] = prepared.prior @ chance
    return out


def importance_rates(
    prepared: Prepared,
    form: Form,
    row: int,
    draws: int,
    generator: np.random.Generator,
    sizes: FaultSize = FaultSize.WORST,
) -> tuple[Array, Array]:
    """Rates of misleading epochs without a fault and with one, along and across, and their variances, (2, 2) each.

    In each stratum (no fault, each single fault) the errors are drawn around plus and minus the level, half of them on
    each side. The draws ``e`` are shifted by ``m`` along the gain of the solution (with a fault: of the solution
    without the faulty satellite), and have the weight ``phi(e) / (phi(e - m)/2 + phi(e + m)/2)``, at most 2.
    """
    level = prepared.levels_m[form][row]
    rate, variance = np.zeros((len(DRAWN), AXES)), np.zeros((len(DRAWN), AXES))
    alone, few = 1.0 - prepared.prior.sum(), max(draws // 8, 64)
    at_threshold = prepared.threshold * prepared.sigma_of_fault_m  # [m]
    for axis in range(AXES):
        away = level[axis] - abs(prepared.shift[axis])
        found = _weighted(prepared, prepared.error_rows[axis], away, axis, level[axis], draws, generator)
        rate[0, axis], variance[0, axis] = alone * found[0], alone**2 * found[1]
        worst = worst_fault(prepared, axis, float(level[axis]))[0] if sizes is FaultSize.WORST else None
        for k, prior in enumerate(prepared.prior):
            moved = abs(at_threshold[k] * prepared.fault_error[k, axis])
            away = level[axis] - moved - abs(prepared.tolerant_shift[k, axis])
            if worst is None:
                size = generator.uniform(-LARGEST_FAULT, LARGEST_FAULT, few) * at_threshold[k]
            else:
                size = np.full(few, worst[k])
            rows = prepared.tolerant_rows[k, axis]
            found = _weighted(prepared, rows, away, axis, level[axis], few, generator, k, size)
            rate[1, axis] += prior * found[0]
            variance[1, axis] += prior**2 * found[1]
    return rate, variance


def _weighted(
    prepared: Prepared,
    rows: Array,
    away_m: float,
    axis: int,
    level_m: float,
    draws: int,
    generator: np.random.Generator,
    faulty: int = 0,
    size_m: Array | None = None,
) -> tuple[float, float]:
    """Mean of one stratum and its variance, with errors of ``rows`` drawn around plus and minus ``away_m``."""
    mean = rows * (max(away_m, 0.0) / float(rows @ rows))
    side = np.where(np.arange(draws) % 2 == 0, 1.0, -1.0)
    normal = generator.standard_normal((draws, rows.size)) + side[:, None] * mean
    along = normal @ mean
    weight = np.exp(0.5 * mean @ mean - np.logaddexp(along, -along) + np.log(2.0))
    error = normal @ prepared.error_rows[axis] + prepared.shift[axis]
    statistic = normal @ prepared.test_rows.T + prepared.test_shift
    if size_m is not None:
        error += size_m * prepared.fault_error[faulty, axis]
        statistic += np.outer(size_m, prepared.fault_test[faulty])
    misleading = (np.abs(error) > level_m) & (np.abs(statistic).max(-1) < prepared.threshold)
    value = weight * misleading
    half = value.reshape(-1, 2).mean(-1)  # one draw on each side, as a stratified pair
    return float(half.mean()), float(half.var(ddof=1) / half.size)


def mean_and_deviation(rates: Sequence[Array], variances: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Mean over cases, its standard deviation from the spread of cases, and that of the draws only.  (...,) each."""
    r, v = np.stack(rates), np.stack(variances)
    between = r.std(0, ddof=1) / np.sqrt(len(r)) if len(r) > 1 else np.sqrt(v.mean(0))
    return r.mean(0), between, np.sqrt(v.sum(0)) / len(r)
