"""Positions of nodes as particles: SPAWN, measurement-directed SPAWN (MD-SPAWN) and MDPC.

SPAWN and MD-SPAWN pass messages between nodes (S2 section 7; H. Wymeersch, J. Lien and M. Win 2009, [39]): a node's
belief is its prior times what its neighbours say of it. In SPAWN particles are drawn from the prior and weighted by the
messages. MD-SPAWN draws them from a Gaussian directed by the measurements (the prior after linearised messages) and
weights them by prior times messages over that Gaussian, so that few particles are wasted where the prior is wide.

MDPC, measurement-directed progressive correction ([37], M. Morelande, B. Moran and M. Brazil 2008), is centralised: a
particle is the positions of all vehicles. The likelihood is taken in stages, its exponents adding up to 1; in each the
particles are drawn from a Gaussian that is directed by that stage's part of the measurements. S2 prints no equations of
the three; this is our reading of its sources.

The belief that is handed on is Gaussian with the moments of the particles (J. Kotecha and P. Djuric 2003, Gaussian
particle filtering). Ranges enter without linearisation, with the mixture of direct and delayed ranges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.positioning.cooperative.factors import Factors, inverse, normal_equations, range_factors
from lanebound.integrity.positioning.cooperative.messages import sum_product, told

__all__ = ["Ranges", "mdpc", "particle_messages"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ROUNDS = 3
ENOUGH = 0.25  # share of particles that a stage of MDPC leaves effective; chosen
LEAST_STEP = 1.0 / 32.0  # of the exponent in a stage of MDPC
WIDER = 0.6  # over the number of coordinates: by so much directed draws are wider, so that weights have bounded tails


@dataclass(frozen=True)
class Ranges:
    """Ranges between M pairs of nodes.

    Attributes
    ----------
    ends : (M, 2) nodes
    range_m, sigma_m : (M,) measured, and 1 sigma of a direct range
    delayed : share of ranges that go around a body; their delay is exponential with mean ``delay_m``
    """

    ends: Ints
    range_m: Array
    sigma_m: Array
    delayed: float = 0.0
    delay_m: float = 1.0

    def log_likelihood(self, distance_m: Array) -> Array:
        """Of distances (M, ...): a Gaussian of a direct range, mixed with one of the moments of a delayed range."""
        shape = (-1,) + (1,) * (distance_m.ndim - 1)
        miss, sigma = self.range_m.reshape(shape) - distance_m, self.sigma_m.reshape(shape)
        direct = -0.5 * np.square(miss / sigma) - np.log(sigma)
        if self.delayed == 0.0:
            return np.asarray(direct)
        wide = np.hypot(sigma, self.delay_m)
        late = -0.5 * np.square((miss - self.delay_m) / wide) - np.log(wide)
        return np.asarray(np.logaddexp(np.log1p(-self.delayed) + direct, np.log(self.delayed) + late))

    def factors(self, about_m: Array, about_m2: Array | None = None) -> Factors:
        """The ranges as direct ones, linearised about positions (N, 3) of covariances (N, 3, 3)."""
        return range_factors(self.ends, self.range_m, self.sigma_m, about_m, about_m2)


def particle_messages(
    mean_m: Array,
    covariance_m2: Array,
    factors: Factors,
    ranges: Ranges,
    particles: int,
    directed: bool,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """SPAWN (``directed`` False) or MD-SPAWN: positions (N, 3) and covariances (N, 3, 3) of the nodes.

    Of a factor the message is Gaussian; of a range it is the mixture about the sender's belief, whose spread along the
    line widens it. A sender leaves out what the receiver told it. mean_m, covariance_m2 : (N, 3), (N, 3, 3) priors;
    ``particles`` of each node are weighed in each of ``ROUNDS`` rounds.
    """
    prior = inverse(covariance_m2)
    root = np.asarray(np.linalg.cholesky(covariance_m2), np.float64)
    mean, covariance, linear = mean_m, covariance_m2, len(factors.ends)
    heard: tuple[Array, Array] | None = None
    for _ in range(ROUNDS):
        every = factors.joined(ranges.factors(mean, covariance))
        to, of, matrix, right, _ = every.whole.directed()
        count = len(every.ends)
        back, ranged = np.roll(np.arange(2 * count), count), np.tile(np.arange(count) >= linear, 2)
        known = inverse(covariance)
        vector = np.einsum("nij,nj->ni", known, mean)
        senders, senders_vector = known[of], vector[of]
        if heard is not None:
            senders, senders_vector = _without(senders, mean[of], heard[0][back], heard[1][back], prior[of])
        heard = told(senders, senders_vector, matrix, right)
        message, message_vector = np.zeros_like(prior), np.zeros_like(mean_m)
        np.add.at(message, to[~ranged], heard[0][~ranged])
        np.add.at(message_vector, to[~ranged], heard[1][~ranged])
        centre, chol = mean_m, root
        if directed:
            centre, spread = sum_product(mean_m, covariance_m2, every, ROUNDS)
            chol = np.asarray((1.0 + WIDER / 3.0) * np.linalg.cholesky(spread), np.float64)
        drawn = rng.standard_normal((particles, *mean_m.shape))
        x = centre + np.einsum("nij,pnj->pni", chol, drawn)
        weight = np.einsum("pni,ni->pn", x, message_vector) - 0.5 * np.einsum("pni,nij,pnj->pn", x, message, x)
        if directed:
            off = x - mean_m
            weight += 0.5 * np.square(drawn).sum(-1) - 0.5 * np.einsum("pni,nij,pnj->pn", off, prior, off)
        if ranged.any():
            at = inverse(senders[ranged])
            told_m = np.einsum("eij,ej->ei", at, senders_vector[ranged])
            np.add.at(weight.T, to[ranged], _range_weights(x[:, to[ranged]], told_m, at, ranges).T)
        mean, covariance = _moments(x, weight)
    return mean, covariance


def _without(known: Array, mean: Array, told_matrix: Array, told_vector: Array, prior: Array) -> tuple[Array, Array]:
    """Information (E, 3, 3) and vectors (E, 3) of senders of belief ``known``, ``mean`` without what receivers told.

    Moments of draws leave some difference indefinite. Its eigenvalues are at least a thousandth of the prior's least;
    in such a direction the sender stays at its mean.
    """
    values, axes = np.linalg.eigh(known - told_matrix)
    least = 1e-3 * np.linalg.eigvalsh(prior)[:, :1]
    kept = (axes * np.maximum(values, least)[:, None, :]) @ np.swapaxes(axes, -1, -2)
    pulled = np.einsum("eij,ej->ei", told_matrix, mean) - told_vector  # about the mean
    inside = np.einsum("eji,ej->ei", axes, pulled) * (values > least)
    return kept, np.einsum("eij,ej->ei", kept, mean) + np.einsum("eij,ej->ei", axes, inside)


def _range_weights(x: Array, senders_m: Array, senders_m2: Array, ranges: Ranges) -> Array:
    """Log weights (P, 2M) of particles (P, 2M, 3) by ranges to senders (2M, 3) of covariance (2M, 3, 3)."""
    apart = x - senders_m
    distance = np.linalg.norm(apart, axis=-1)
    unit = apart / np.maximum(distance, 1e-9)[..., None]
    along = np.einsum("pmi,mij,pmj->pm", unit, senders_m2, unit).mean(0)
    sigma = np.sqrt(np.square(np.tile(ranges.sigma_m, 2)) + along)
    both = replace(ranges, range_m=np.tile(ranges.range_m, 2), sigma_m=sigma)
    return both.log_likelihood(distance.T).T


def _moments(x: Array, log_weight: Array) -> tuple[Array, Array]:
    """Mean (N, 3) and covariance (N, 3, 3) of weighted particles (P, N, 3), weights (P, N).

    Where hardly a particle has weight, the covariance of the effective ones would vanish: it gets the part of the
    spread of all particles that so few draws leave unknown, ``spread / effective number``.
    """
    weight = np.exp(log_weight - log_weight.max(0))
    weight /= weight.sum(0)
    mean = np.einsum("pn,pni->ni", weight, x)
    off = x - mean
    effective = 1.0 / np.square(weight).sum(0)
    spread = np.einsum("pni,pnj->nij", off, off) / len(x)
    covariance = np.einsum("pn,pni,pnj->nij", weight, off, off) + spread / effective[:, None, None]
    return mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))


def mdpc(
    mean_m: Array, covariance_m2: Array, factors: Factors, ranges: Ranges, particles: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """MDPC: positions (N, 3) and their joint covariance (3N, 3N) from a joint prior, (N, 3) and (3N, 3N).

    A stage that would leave fewer than ``ENOUGH`` particles effective takes half of the step of its exponent.
    """
    nodes, at = len(mean_m), mean_m.reshape(-1)
    prior, fixed = inverse(covariance_m2), normal_equations(factors, nodes)
    mean, covariance, exponent, step = at, covariance_m2, 0.0, 1.0
    while exponent < 1.0:
        step = min(step, 1.0 - exponent)
        share = exponent + step
        ranged = normal_equations(ranges.factors(mean.reshape(nodes, 3)), nodes)
        spread = inverse(prior + share * (fixed[0] + ranged[0]))
        centre = spread @ (prior @ at + share * (fixed[1] + ranged[1]))
        drawn = rng.standard_normal((particles, 3 * nodes))
        x = centre + (1.0 + WIDER / (3.0 * nodes)) * drawn @ np.linalg.cholesky(spread).T
        off = x - at
        weight = 0.5 * np.square(drawn).sum(-1) - 0.5 * np.einsum("pi,ij,pj->p", off, prior, off)
        weight += share * (x @ fixed[1] - 0.5 * np.einsum("pi,ij,pj->p", x, fixed[0], x))
        places = x.reshape(-1, nodes, 3)
        distance = np.linalg.norm(places[:, ranges.ends[:, 0]] - places[:, ranges.ends[:, 1]], axis=-1)
        weight += share * ranges.log_likelihood(distance.T).sum(0)
        part = np.exp(weight - weight.max())
        part /= part.sum()
        effective = 1.0 / np.square(part).sum()
        if effective < ENOUGH * particles and step > LEAST_STEP:
            step *= 0.5  # too large a part of the likelihood at once: few particles would carry the belief
            continue
        mean = part @ x
        off = x - mean
        covariance = np.einsum("p,pi,pj->ij", part, off, off) + spread / effective
        exponent, step = share, 1.0
    return mean.reshape(nodes, 3), covariance
