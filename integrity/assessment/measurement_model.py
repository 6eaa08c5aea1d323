"""Random cases of the measurement model that protection levels assume: geometries and their levels.

A case is the geometry of one epoch: satellites, clocks, standard deviations, bounds of the nominal biases, the biases
(at their bounds, with the worst signs), and a heading. For each case the levels of several *forms* are computed: the
exact levels of this package and those printed in the papers, completely and with one printed formula at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.protection import closed_form, protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, false_alarm_factor, pair_risk, upper_quantile
from lanebound.integrity.monitoring.separation import Separation, published_bias, separate
from lanebound.integrity.positioning.least_squares import design_matrix

__all__ = ["Case", "Form", "Prepared", "Worst", "draw_case", "prepare"]

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
