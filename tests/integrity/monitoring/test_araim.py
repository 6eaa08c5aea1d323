"""The worked examples of ARAIM, and subsets of any shape in the kernel."""

from __future__ import annotations

import numpy as np
import pytest
from plain_araim import araim, vertical_separation

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.araim import AraimConfig
from lanebound.integrity.monitoring.fault_modes import FaultModes, enumerate_faults
from lanebound.integrity.monitoring.protection import protection_levels, protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.monitoring.separation import separate
from lanebound.integrity.positioning.least_squares import design_matrix

# WG-C ARAIM Reference Airborne Algorithm Description Document v3.1 (20 June 2019) and v3.0, appendix D: ENU rows, two
# systems of five satellites, bias 0.5 m, and variances for integrity and for accuracy [m^2].
ROWS = np.array(
    [
        [0.0225, 0.9951, -0.0966],
        [0.675, -0.69, -0.2612],
        [0.0723, -0.6601, -0.7477],
        [-0.9398, 0.2553, -0.2269],
        [-0.5907, -0.7539, -0.2877],
        [-0.3236, -0.0354, -0.9455],
        [-0.6748, 0.4356, -0.5957],
        [0.0938, -0.7004, -0.7075],
        [0.5571, 0.3088, -0.7709],
        [0.6622, 0.6958, -0.278],
    ]
)
LOS = -ROWS[None]
GROUP = np.repeat([0, 1], 5)
V31 = (
    [3.2899, 1.2792, 0.7901, 1.443, 1.1847, 0.7737, 0.8233, 0.7962, 0.7871, 1.2166],
    [2.9774, 0.9667, 0.4776, 1.1305, 0.8722, 0.4612, 0.5108, 0.4837, 0.4746, 0.9041],
)
V30 = (
    [3.8865, 1.4377, 0.8604, 1.6383, 1.3229, 0.8434, 0.8963, 0.8669, 0.8573, 1.3616],
    [3.574, 1.1252, 0.5479, 1.3258, 1.0104, 0.5309, 0.5838, 0.5544, 0.5448, 1.0491],
)


def test_add_v31_appendix_d() -> None:
    """As printed; to more digits as Stanford's MAAST (mhss_raim_baseline_v5, in Octave) gives them.

    The printed HPL of 13.45 m lies at the upper end of a bisection with a tolerance of 0.05 m.
    """
    found = araim(LOS, GROUP, *V31, 0.5)
    assert len(found.modes) == 12
    assert found.k_fa_vertical == pytest.approx(5.1083, abs=1e-4)
    assert found.vpl_m[0] == pytest.approx(18.3, abs=0.05)
    assert found.hpl_m[0] == pytest.approx(13.45, abs=0.05)
    assert found.emt_m[0] == pytest.approx(7.2998, abs=0.005)
    assert found.sigma_v_acc_m[0] == pytest.approx(1.3694, abs=5e-4)
    assert found.modes.unmonitored == pytest.approx(3.4496e-8, abs=1e-12)
    # MAAST solves to a tolerance of 1e-3 m
    assert found.vpl_m[0] == pytest.approx(18.294037, abs=2e-3)
    assert found.hpl_m[0] == pytest.approx(13.406494, abs=1e-3)
    assert found.emt_m[0] == pytest.approx(7.299717, abs=1e-6)
    assert found.sigma_v_acc_m[0] == pytest.approx(1.369368, abs=1e-6)
    # exact roots by scipy, independently
    assert found.vpl_m[0] == pytest.approx(18.292584657774945, abs=1e-6)
    np.testing.assert_allclose(found.hpl_en_m[0], [8.90345702913343, 10.022828486964505], atol=1e-6)


@pytest.mark.parametrize(
    ("variances", "sigma", "delta", "bias"),
    [
        (V31, (2.46, 2.4359), (1.429, 1.4217), (2.8915, 2.0875)),
        (V30, (2.576, 2.5577), (1.5307, 1.5292), (2.8935, 2.0875)),
    ],
)
def test_constellation_modes_as_printed(
    variances: tuple[list[float], list[float]], sigma: tuple[float, ...], delta: tuple[float, ...], bias: tuple[float]
) -> None:
    modes = enumerate_faults(GROUP, 1e-5, 1e-4)
    found = vertical_separation(LOS, GROUP, *variances, 0.5, modes)
    np.testing.assert_allclose(found.sigma_m[0, -2:, 0], sigma, atol=1e-3)
    np.testing.assert_allclose(found.delta_m[0, -2:, 0], delta, atol=1e-3)
    np.testing.assert_allclose(found.bias_m[0, -2:, 0], bias, atol=1e-3)


def test_add_v30_appendix_d() -> None:
    """As printed; the printed HPL of 14.5 m against 14.416 m of MAAST and of scipy is a tolerance's."""
    found = araim(LOS, GROUP, *V30, 0.5)
    assert found.vpl_m[0] == pytest.approx(19.2, abs=0.05)
    assert found.hpl_m[0] == pytest.approx(14.5, abs=0.1)
    assert found.emt_m[0] == pytest.approx(7.8, abs=0.05)
    assert found.sigma_v_acc_m[0] == pytest.approx(1.47, abs=0.005)
    assert found.vpl_m[0] == pytest.approx(19.217057175994814, abs=1e-6)
    assert found.hpl_m[0] == pytest.approx(14.415812178578244, abs=1e-6)


def test_blanch_2012_with_pairs_of_satellites() -> None:
    """Blanch et al., ION GNSS 2012, appendix H: 10 satellites, 45 pairs, 2 constellations; printed 19.7 and 14.9 m.

    The risk not monitored is not printed; with none the independent roots are 19.6091 and 14.867 m.
    """
    single = enumerate_faults(GROUP, 1e-4, 1e-4, at_once=1)
    pairs = enumerate_faults(GROUP, 1e-4, 0.0, at_once=2, unmonitored_below=1e-9)
    pairs = pairs.take(pairs.several)
    modes = FaultModes(
        np.concatenate([single.removes, pairs.removes]), np.concatenate([single.prior, pairs.prior]), unmonitored=0.0
    )
    assert len(modes) == 57
    found = araim(LOS, GROUP, *V30, 0.5, AraimConfig(satellite_prior=1e-4), modes)
    assert found.k_fa_vertical == pytest.approx(5.3953, abs=1e-4)
    assert found.vpl_m[0] == pytest.approx(19.7, abs=0.15)
    assert found.hpl_m[0] == pytest.approx(14.9, abs=0.1)
    assert found.sigma_v_acc_m[0] == pytest.approx(1.47, abs=5e-3)
    assert found.vpl_m[0] == pytest.approx(19.6091, abs=1e-3)
    assert found.hpl_m[0] == pytest.approx(14.867, abs=1e-3)


def test_a_lost_constellation_leaves_no_level() -> None:
    """Without a second system the constellation's mode has no solution, and no level is given."""
    found = araim(LOS[:, :7], np.zeros(7, np.int64), V31[0][:7], V31[1][:7], 0.5)
    assert np.isinf(found.vpl_m).all()
    alone = araim(LOS[:, :7], np.zeros(7, np.int64), V31[0][:7], V31[1][:7], 0.5, AraimConfig(constellation_prior=0.0))
    assert np.isfinite(alone.vpl_m).all()


@pytest.mark.parametrize(("n", "systems"), [(8, 1), (11, 2), (16, 3), (24, 5)])
def test_subsets_in_the_kernel_equal_the_plain_form(n: int, systems: int) -> None:
    """Random subsets over random skies, some of them beyond what is left in view, to 1e-9."""
    rng = np.random.default_rng(n)
    elevation, azimuth = np.arcsin(rng.uniform(0.14, 1.0, (6, n))), rng.uniform(0, 2 * np.pi, (6, n))
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    group, view = rng.integers(0, systems, n), rng.random((6, n)) < 0.95
    variance, accuracy, bias = rng.uniform(0.2, 2.0, n), rng.uniform(0.1, 1.0, n), rng.uniform(0.0, 0.5, n)
    removes = rng.random((7, n)) < np.array([0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.02])[:, None]
    subsets = FaultModes(removes, rng.uniform(1e-9, 1e-6, 7))
    heading = rng.uniform(-np.pi, np.pi, 6)
    config = RiskConfig(satellite_prior=(1e-6,) * 5, subtract_multiple=False, spend_unsolvable=True)
    found = protection_levels_batch(
        los, view, group, variance, heading, config, accuracy_m2=accuracy, bias_m=bias, subsets=subsets
    )
    for e in range(6):
        seen = np.flatnonzero(view[e])
        touched = removes[:, seen].any(-1)
        modes = np.concatenate([np.eye(len(seen), dtype=bool), removes[touched][:, seen]])
        separation = separate(
            design_matrix(los[e, seen], group[seen], 5), np.diag(variance[seen]), modes, heading[e],
            accuracy=np.diag(accuracy[seen]), bias=bias[seen],
        )  # fmt: skip
        priors = np.concatenate([np.full(len(seen), 1e-6), subsets.prior[touched]])
        expected = protection_levels(separation, priors, config)
        np.testing.assert_allclose(found.root_m[e], expected, rtol=1e-8)


def test_subsets_must_fit_the_satellites() -> None:
    subsets = FaultModes(np.ones((1, 9), bool), np.array([1e-5]))
    with pytest.raises(InputError, match=r"subsets\.removes"):
        protection_levels_batch(LOS, True, GROUP, 1.0, 0.0, RiskConfig(), subsets=subsets)
