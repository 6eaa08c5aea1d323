"""Messages between nodes: exact on trees, converging with particles, honest on loops."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.cooperative.factors import Factors, joint_solution, range_factors
from lanebound.integrity.positioning.cooperative.messages import sum_product
from lanebound.integrity.positioning.cooperative.particles import Ranges, mdpc, particle_messages
from lanebound.integrity.positioning.cooperative.split import correlated_sum, intersection, split_messages

NO_RANGES = Ranges(np.empty((0, 2), np.int64), np.empty(0), np.empty(0))


def spd(rng, count, rank=3):
    a = rng.normal(size=(count, 3, rank))
    return a @ np.swapaxes(a, 1, 2)


def whole(covariance):
    nodes = len(covariance)
    out = np.zeros((nodes, 3, nodes, 3))
    out[np.arange(nodes), :, np.arange(nodes), :] = covariance
    return out.reshape(3 * nodes, 3 * nodes)


def blocks(covariance):
    nodes = len(covariance) // 3
    return covariance.reshape(nodes, 3, nodes, 3)[np.arange(nodes), :, np.arange(nodes), :]


def factors_between(rng, ends, places, rank=3):
    information = spd(rng, len(ends), rank)
    apart = places[ends[:, 0]] - places[ends[:, 1]] + rng.normal(size=(len(ends), 3))
    return Factors(ends, information, np.einsum("eij,ej->ei", information, apart), np.zeros_like(information))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rank", [1, 2, 3])
def test_messages_are_exact_on_trees(seed, rank):
    rng = np.random.default_rng(seed)
    nodes = 9
    mean, covariance = 20.0 * rng.normal(size=(nodes, 3)), spd(rng, nodes) + np.eye(3)
    ends = np.array([(k, rng.integers(k)) for k in range(1, nodes)])
    factors = factors_between(rng, ends, mean, rank)
    exact, joint = joint_solution(mean, whole(covariance), factors)
    found, marginal = sum_product(mean, covariance, factors, rounds=nodes)
    assert np.allclose(found, exact, atol=1e-9)
    assert np.allclose(marginal, blocks(joint), atol=1e-9)


def test_errors_that_last_count_as_errors_of_a_factor():
    rng = np.random.default_rng(3)
    mean, covariance = rng.normal(size=(2, 3)), spd(rng, 2) + np.eye(3)
    factors = factors_between(rng, np.array([(0, 1)]), mean)
    lasting = 0.3 * np.eye(3)[None]
    whole_noise = np.linalg.inv(np.linalg.inv(factors.information) + lasting)
    apart = np.linalg.solve(factors.information, factors.vector[..., None])
    same = Factors(factors.ends, whole_noise, (whole_noise @ apart)[..., 0], np.zeros_like(lasting))
    first = sum_product(mean, covariance, Factors(factors.ends, factors.information, factors.vector, lasting))
    assert all(np.allclose(a, b, atol=1e-12) for a, b in zip(first, sum_product(mean, covariance, same), strict=True))


@pytest.mark.parametrize("method", ["spawn", "md_spawn", "mdpc"])
def test_particles_converge_to_the_exact_solution(method):
    rng = np.random.default_rng(7)
    mean, covariance = 30.0 * rng.normal(size=(3, 3)), spd(rng, 3) + np.eye(3)
    factors = factors_between(rng, np.array([(0, 1), (1, 2)]), mean)
    exact, joint = joint_solution(mean, whole(covariance), factors)

    def rms(particles, repeats):
        errors = []
        for _ in range(repeats):
            if method == "mdpc":
                found, spread = mdpc(mean, whole(covariance), factors, NO_RANGES, particles, rng)
                spread = blocks(spread)
            else:
                directed = method == "md_spawn"
                found, spread = particle_messages(mean, covariance, factors, NO_RANGES, particles, directed, rng)
            errors.append(found - exact)
        assert particles < 10_000 or np.allclose(spread, blocks(joint), atol=0.15)
        return float(np.sqrt(np.mean(np.square(errors))))

    # Errors of draws fall with the root of their number: 100 times as many have a tenth, 0.2 is left for chance.
    assert rms(40_000, 4) < 0.2 * rms(400, 12)


def test_directed_particles_waste_fewer_where_the_prior_is_wide():
    rng = np.random.default_rng(11)
    mean, covariance = np.array([[0.0, 0.0, 0.0], [30.0, 5.0, 0.0]]), np.array([25.0 * np.eye(3), 1e-4 * np.eye(3)])
    information = 100.0 * np.eye(3)[None]
    vector = (information[0] @ [-29.0, -4.0, 1.0])[None]
    factors = Factors(np.array([(0, 1)]), information, vector, 0.0 * information)
    exact, _ = joint_solution(mean, whole(covariance), factors)
    errors = {
        directed: [
            np.linalg.norm(particle_messages(mean, covariance, factors, NO_RANGES, 200, directed, rng)[0][0] - exact[0])
            for _ in range(30)
        ]
        for directed in (False, True)
    }
    assert np.median(errors[True]) < 0.25 * np.median(errors[False])


def ring_over_time(fuse, rng, epochs=40):
    """NEES of each node of a ring, whose knowledge is handed on from epoch to epoch, with one node that is told."""
    nodes, told = 4, 0.5
    truth = 10.0 * rng.normal(size=(nodes, 3))
    mean, covariance = truth + 3.0 * rng.normal(size=(nodes, 3)), np.tile(9.0 * np.eye(3), (nodes, 1, 1))
    ends = np.array([(0, 1), (1, 2), (2, 3), (3, 0)])
    for _ in range(epochs):
        noise = told * rng.normal(size=(len(ends), 3))
        information = np.tile(np.eye(3) / told**2, (len(ends), 1, 1))
        apart = truth[ends[:, 0]] - truth[ends[:, 1]] + noise
        factors = Factors(ends, information, apart / told**2, 0.0 * information)
        mean, covariance = fuse(mean, covariance, factors)
    error = mean - truth
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])


def test_split_messages_count_no_rumour_twice_on_a_loop():
    """Relative measurements say nothing of where the ring is: beliefs must not shrink below its start."""
    rng = np.random.default_rng(5)
    honest = np.array([ring_over_time(split_messages, rng) for _ in range(40)])
    rumours = np.array([ring_over_time(lambda *a: sum_product(*a, rounds=3), rng) for _ in range(40)])
    # A mean of 40 by 4 correlated values of chi^2(3) is above this once in 1e4 runs, if only the 40 rings are counted.
    assert honest.mean() < chi2.isf(1e-4, 3 * 40) / 40
    assert rumours.mean() > 10.0 * chi2.isf(1e-4, 3 * 40) / 40


def test_intersection_holds_for_every_correlation():
    rng = np.random.default_rng(9)
    one, other = spd(rng, 3) + np.eye(3), spd(rng, 3) + np.eye(3)
    for share in (-1.0, -0.5, 0.0, 0.7, 1.0):
        common = share * np.linalg.cholesky(one) @ np.swapaxes(np.linalg.cholesky(other), 1, 2)
        _, promised = intersection(np.zeros((3, 3)), one, np.zeros((3, 3)), other)
        gain = np.array([intersection(row, one, np.zeros((3, 3)), other)[0] for row in np.eye(3)[:, None].repeat(3, 1)])
        first = np.moveaxis(gain, 0, -1)
        second = np.eye(3) - first
        crossed = first @ common @ np.swapaxes(second, 1, 2)
        true = first @ one @ np.swapaxes(first, 1, 2) + second @ other @ np.swapaxes(second, 1, 2)
        true = true + crossed + np.swapaxes(crossed, 1, 2)
        assert (np.linalg.eigvalsh(promised - true) > -1e-9).all()
        both = correlated_sum(one, other) - one - other - common - np.swapaxes(common, 1, 2)
        assert (np.linalg.eigvalsh(both) > -1e-9).all()


def test_a_distance_bends_as_its_factor_says():
    rng = np.random.default_rng(2)
    places = np.array([[40.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    spread = np.array([np.diag([1e-6, 9.0, 4.0]), 1e-9 * np.eye(3)])
    drawn = places[0] + rng.normal(size=(200_000, 3)) * np.sqrt(np.diag(spread[0]))
    distance = np.linalg.norm(drawn, axis=-1)
    factors = range_factors([(0, 1)], [40.0], [1e-3], places, spread)
    bend = 40.0 - factors.vector[0, 0] / factors.information[0, 0, 0]
    assert bend == pytest.approx(distance.mean() - 40.0, abs=2e-3)  # the fourth order, and 4 sigma of the mean
    assert factors.information[0, 0, 0] ** -0.5 == pytest.approx(distance.std(), rel=0.02)


def test_wrong_ranges_are_refused():
    places = np.zeros((2, 3))
    with pytest.raises(InputError, match="about_m must place nodes 0 and 1 apart"):
        range_factors([(0, 1)], [3.0], [0.1], places)
    with pytest.raises(InputError, match="range_m must be >= 0, got -1"):
        range_factors([(0, 1)], [-1.0], [0.1], places + np.eye(2, 3))
    with pytest.raises(InputError, match="sigma_m must be > 0, got 0"):
        range_factors([(0, 1)], [1.0], [0.0], places + np.eye(2, 3))
    with pytest.raises(InputError, match="rounds must be >= 0, got -2"):
        sum_product(places, np.tile(np.eye(3), (2, 1, 1)), Factors.none(), rounds=-2)


@pytest.mark.parametrize("directed", [False, True])
def test_particles_with_ranges_do_not_depend_on_the_origin(directed):
    rng = np.random.default_rng(4)
    places = np.array([[0.0, 0.0, 0.0], [25.0, 8.0, 0.0], [60.0, -5.0, 0.0]])
    covariance = np.array([4.0 * np.eye(3), 4.0 * np.eye(3), 4e-4 * np.eye(3)])
    ends = np.array([(0, 1), (0, 2), (1, 2)])
    distance = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=-1)
    ranges = Ranges(ends, distance, np.full(3, 0.5), delayed=0.05, delay_m=0.3)
    mean = places + rng.normal(size=places.shape) * [2.0, 2.0, 0.5]
    for shift in (0.0, 700.0):
        found = [
            particle_messages(
                mean + shift, covariance, Factors.none(), ranges, 2000, directed, np.random.default_rng(seed)
            )
            for seed in range(3)
        ]
        if shift == 0.0:
            first = found
    assert all(np.allclose(a[0] + 700.0, b[0], atol=1e-6) for a, b in zip(first, found, strict=True))


def test_a_delayed_range_is_weighed_as_one_of_two_kinds():
    ranges = Ranges(np.array([(0, 1)]), np.array([20.0]), np.array([0.1]), delayed=0.05, delay_m=1.0)
    direct, late, impossible = (float(ranges.log_likelihood(np.array([d]))[0]) for d in (20.0, 19.0, 22.0))
    assert direct - late == pytest.approx(np.log(0.95 / 0.05) + np.log(np.hypot(0.1, 1.0) / 0.1), abs=0.6)
    assert impossible < late - 3.0
