"""Mixing of models against a published two-model filter, and against the moments of the mixture itself."""

import numpy as np
from plain_kalman import correct, innovate
from plain_multiple_models import (
    combine,
    interact,
    mixing_weights,
    posterior,
    predicted_probabilities,
)

from lanebound.integrity.positioning.filters import mixing_kernel
from lanebound.integrity.positioning.filters.vehicle_models import TRANSITION, Interaction
from lanebound.integrity.positioning.filters.vehicle_states_kernel import MODEL


def manoeuvre():
    """Two models of a point that begins to accelerate."""
    f = np.array([[1.0, 1.0], [0.0, 1.0]])
    shape = np.array([[0.25, 0.5], [0.5, 1.0]])
    z = [10.3, 19.2, 31.1, 39.8, 50.6, 61.5, 75.2, 92.0, 111.7, 134.9, 160.1, 188.8, 217.2, 245.9, 274.1, 302.8]
    return f, np.stack([0.01 * shape, 9.0 * shape]), z


def run(form=Interaction.STANDARD):
    f, q, zs = manoeuvre()
    h, r, t = np.array([[1.0, 0.0]]), np.array([[4.0]]), np.array([[0.97, 0.03], [0.05, 0.95]])
    x, p, mu = np.array([[0.0, 10.0]] * 2), np.array([np.diag([10.0, 4.0])] * 2), np.array([0.5, 0.5])
    out = []
    for z in zs:
        x, p = interact(x, p, mixing_weights(mu, t, form))
        c = predicted_probabilities(mu, t)
        x, p = (f @ x[..., None])[..., 0], f @ p @ f.T + q
        found = innovate(x, p, np.array([z]), h, r)
        x, p, _ = correct(x, p, h, found)
        mu = posterior(c, found.log_likelihood)
        out.append((*combine(x, p, mu), mu))
    return out


def test_it_equals_a_published_two_model_filter():
    """filterpy's IMMEstimator, and an independent textbook form (Blom and Bar-Shalom), to 1e-8."""
    found = run()
    first, turning, last = found[0], found[7], found[-1]
    np.testing.assert_allclose(first[0], [10.23685954152704, 10.094876332216314], atol=1e-8)
    np.testing.assert_allclose(first[2], [0.524617574751346, 0.475382425248654], atol=1e-8)
    np.testing.assert_allclose(turning[0], [90.59307632046053, 15.250798523983882], atol=1e-8)
    np.testing.assert_allclose(turning[1][1], [3.803757555206265, 7.699321146610987], atol=1e-8)
    np.testing.assert_allclose(turning[2], [0.13493643639157962, 0.8650635636084203], atol=1e-8)
    np.testing.assert_allclose(last[0], [302.7762133544565, 28.56090695625661], atol=1e-8)
    np.testing.assert_allclose(last[1][0], [3.001175228867198, 2.0267970985976183], atol=1e-8)
    np.testing.assert_allclose(last[1][1], [2.0267970985976183, 4.567653602710711], atol=1e-8)
    np.testing.assert_allclose(last[2], [0.37861203669794946, 0.6213879633020506], atol=1e-8)


def test_the_kernels_equal_the_published_filter():
    """The same by the kernels that the navigator runs."""
    f, q, zs = manoeuvre()
    h, r, t = np.array([[1.0, 0.0]]), np.array([[4.0]]), np.array([[0.97, 0.03], [0.05, 0.95]])
    models, mixed, mixture, mu = np.zeros(2, MODEL), np.zeros(2, MODEL), np.zeros(1, MODEL), np.array([0.5, 0.5])
    x, p, x_own, p_own = (
        a[name][:, :2, :2] if name == "p" else a[name][:, :2] for a in (models, mixed) for name in "xp"
    )
    x[:], p[:] = [0.0, 10.0], np.diag([10.0, 4.0])
    out = []
    for z in zs:
        mixing_kernel.mixing_weights(models, mu, t, True)
        for j in range(2):
            mixing_kernel.combine(models, models["weight"][j], 2, mixed[j])
        x[:], p[:] = (f @ x_own[..., None])[..., 0], f @ p_own @ f.T + q
        found = innovate(x, p, np.array([z]), h, r)
        x[:], p[:], _ = correct(x, p, h, found)
        models["likelihood"] = found.log_likelihood
        mixing_kernel.posterior(models, mu)
        mixing_kernel.combine(models, mu, 2, mixture[0])
        out.append((mixture["x"][0, :2].copy(), mixture["p"][0, :2, :2].copy(), mu.copy()))
    for ours, reference in zip(out, run(), strict=True):
        for part, other in zip(ours, reference, strict=True):
            np.testing.assert_allclose(part, other, rtol=1e-10)
    np.testing.assert_allclose(out[7][2], [0.13493643639157962, 0.8650635636084203], atol=1e-8)
    np.testing.assert_allclose(out[-1][0], [302.7762133544565, 28.56090695625661], atol=1e-8)


def test_the_published_form_differs_and_begins_from_one_state():
    q = manoeuvre()[1]
    weight = mixing_weights(np.array([0.3, 0.7]), np.array(TRANSITION), Interaction.PUBLISHED)
    x, _ = interact(np.array([[0.0, 1.0], [2.0, 3.0]]), q, weight)
    np.testing.assert_allclose(x[0], x[1])
    np.testing.assert_allclose(x[0], [1.4, 2.4])
    assert abs(run(Interaction.PUBLISHED)[-1][0][1] - run()[-1][0][1]) > 1e-3


def test_moments_of_a_mixture_are_those_of_its_draws():
    rng = np.random.default_rng(3)
    x, w = np.array([[0.0, 0.0], [3.0, -1.0]]), np.array([0.25, 0.75])
    p = np.array([[[1.0, 0.2], [0.2, 2.0]], [[0.5, 0.0], [0.0, 0.1]]])
    draws = 200_000
    which = (rng.random(draws) < w[1]).astype(int)
    z = x[which] + np.einsum("kij,kj->ki", np.linalg.cholesky(p)[which], rng.standard_normal((draws, 2)))
    mean, covariance = combine(x, p, w)
    np.testing.assert_allclose(mean, z.mean(0), atol=0.02)  # 5 sigma of the mean
    np.testing.assert_allclose(covariance, np.cov(z.T), atol=0.05)


def test_weights_sum_to_one_and_batches_do_not_mix():
    rng = np.random.default_rng(4)
    mu = rng.dirichlet([1.0, 1.0], size=(5, 3))
    weight = mixing_weights(mu, np.array(TRANSITION))
    np.testing.assert_allclose(weight.sum(-2), 1.0, rtol=1e-14)
    x, p = rng.standard_normal((5, 3, 2, 4)), np.broadcast_to(np.eye(4), (5, 3, 2, 4, 4)).copy()
    whole, alone = interact(x, p, weight), interact(x[2:3, 1:2], p[2:3, 1:2], weight[2:3, 1:2])
    assert np.array_equal(whole[0][2, 1], alone[0][0, 0])
    assert np.array_equal(whole[1][2, 1], alone[1][0, 0])


def test_no_model_becomes_impossible():
    mu = posterior(np.array([0.5, 0.5]), np.array([0.0, -1e5]))
    assert (mu > 0.0).all()
    np.testing.assert_allclose(mu.sum(), 1.0)
