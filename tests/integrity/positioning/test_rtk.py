import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_records import records_of, rows_of

from dense_rtk import double_difference_matrix, solve_dense
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, hdop_of, invert_3x3, multiply_3
from lanebound.integrity.positioning.rtk_kernel import (
    AMBIGUITY,
    BASE,
    SATELLITE,
    Carriers,
    add_layer,
    collapse_code,
    collapse_phase,
    drop_small_systems,
    float_ambiguities,
    held_base,
    held_risk,
    order_by_variance,
)
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL

SYSTEMS = 4
C_MPS = 299792458.0
FREQUENCIES_HZ = np.array(
    [[1575.42e6, 1227.60e6], [1575.42e6, 1207.14e6], [1602.0e6, 1246.0e6], [1561.098e6, 1207.14e6]]
)
WAVELENGTH_M = C_MPS / FREQUENCIES_HZ
few = settings(max_examples=25, deadline=None, derandomize=True)


def _problem(seed, *, with_held, noise=1.0, satellites=16):
    """Random single differences: arguments of ``solve_dense`` by name, with the true position and integers."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(0.0, 2.0 * math.pi, satellites), rng.uniform(0.2, 1.5, satellites)
    los = np.column_stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)])
    system = rng.integers(0, SYSTEMS, satellites)
    system[:7] = 0  # enough of one system for any choice below
    factor = rng.uniform(1.0, 4.0, satellites) / np.sin(elevation) ** 2
    variance_code, variance_phase = 0.09 * factor, 1.8e-5 * factor
    x = rng.normal(size=3) * 20.0
    integers = rng.integers(-30, 30, (satellites, 2)).astype(float)
    clocks = rng.normal(size=(2, SYSTEMS, 2)) * 50.0
    error = noise * rng.normal(size=(2, satellites, 2))
    code = -(los @ x)[:, None] + clocks[0][system] + error[0] * np.sqrt(variance_code)[:, None]
    phase = -(los @ x)[:, None] + clocks[1][system] + error[1] * np.sqrt(variance_phase)[:, None]
    phase += WAVELENGTH_M[system] * integers
    held = rng.random(satellites) < 0.4 if with_held else np.zeros(satellites, dtype=bool)
    candidate = ~held & (rng.random(satellites) < 0.8)
    order = np.empty(satellites, dtype=np.int64)
    count = order_by_variance(candidate, variance_phase, satellites, order)
    code_used = rng.random(satellites) < 0.9
    code_used[:7] = True
    arguments = {
        "los_enu": los,
        "system": system,
        "code_m": code,
        "phase_m": phase,
        "variance_code_m2": variance_code,
        "variance_phase_m2": variance_phase,
        "wavelength_m": WAVELENGTH_M,
        "code_used": code_used,
        "held": held,
        "integers": integers,
        "candidates": order[:count],
    }
    return arguments, x, integers


def _satellites(system):
    satellites = np.zeros(len(system), SATELLITE)
    satellites["system"], satellites["wavelength"] = system, WAVELENGTH_M[system]
    return satellites


def _carriers(a):
    """Carriers and what is held of a problem."""
    held = np.zeros(len(a["system"]), AMBIGUITY)
    held["held"], held["integers"] = a["held"], a["integers"]
    signals = records_of(OBSERVED_SIGNAL, len(held), e=a["los_enu"], code=a["code_m"], phase=a["phase_m"])
    return Carriers(_satellites(a["system"]), signals, a["variance_phase_m2"]), held


def _kernel_position(a, bands):
    """Position, its covariance and whether the geometry is regular, through the kernel's collapsed layers."""
    normal, q_x, rhs, x = np.zeros((3, 3)), np.empty((3, 3)), np.zeros(3), np.empty(3)
    carriers, held = _carriers(a)
    rows = rows_of(a["los_enu"], a["system"], a["code_used"], a["variance_code_m2"] / bands)
    collapse_code(carriers.signals, bands, rows)
    add_layer(rows, normal, rhs)
    rows["variance"], rows["used"] = a["variance_phase_m2"] / bands, a["held"]
    collapse_phase(carriers, held, bands, rows)
    add_layer(rows, normal, rhs)
    assert invert_3x3(normal, q_x)
    multiply_3(q_x, rhs, x)
    return x, q_x


def _kernel_ambiguities(a, bands, x, q_x):
    base, (carriers, held) = np.zeros(MAX_GROUPS, BASE), _carriers(a)
    held_base(carriers, held, bands, base)
    size = bands * len(a["system"])
    ambiguity, q_a, owner = np.empty(size), np.empty((size, size)), np.empty(size, dtype=np.int64)
    order = a["candidates"]
    n = float_ambiguities(carriers, order, len(order), bands, x, q_x, base, ambiguity, q_a, owner)
    return ambiguity[:n], q_a[:n, :n], owner[:n]


@few
@given(seed=st.integers(0, 10**6), with_held=st.booleans(), bands=st.sampled_from([1, 2]))
def test_the_kernel_equals_the_dense_solution(seed, with_held, bands):
    a, _, _ = _problem(seed, with_held=with_held)
    dense = solve_dense(**a, bands=bands)
    x, q_x = _kernel_position(a, bands)
    np.testing.assert_allclose(x, dense.position_enu_m, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(q_x, dense.covariance_m2, rtol=1e-9, atol=1e-9 * np.trace(q_x))
    ambiguity, q_a, owner = _kernel_ambiguities(a, bands, x, q_x)
    np.testing.assert_array_equal(owner, dense.owner)
    np.testing.assert_array_equal(np.arange(len(owner)) % bands, dense.band)
    np.testing.assert_allclose(ambiguity, dense.ambiguity_cycles, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(q_a, dense.ambiguity_covariance, rtol=1e-8, atol=1e-9 * q_a.max(initial=1.0))
    np.testing.assert_array_equal(q_a, q_a.T)


@pytest.mark.parametrize("with_held", [False, True])
def test_without_noise_position_and_integers_come_back(with_held):
    a, x, integers = _problem(5, with_held=with_held, noise=0.0)
    dense = solve_dense(**a)
    np.testing.assert_allclose(dense.position_enu_m, x, atol=1e-7)
    reference = np.zeros((SYSTEMS, 2))  # a system without held satellites counts from its first candidate
    for s in a["candidates"][::-1]:
        if not a["held"][a["system"] == a["system"][s]].any():
            reference[a["system"][s]] = integers[s]
    expected = integers[dense.owner, dense.band] - reference[a["system"][dense.owner], dense.band]
    np.testing.assert_allclose(dense.ambiguity_cycles, expected, atol=1e-5)


@few
@given(seed=st.integers(0, 10**6), bands=st.sampled_from([1, 2]), first=st.booleans())
def test_double_differences_equal_single_differences_with_clocks(seed, bands, first):
    a, _, _ = _problem(seed, with_held=True)
    dense = solve_dense(**(a | {"candidates": a["candidates"][:0]}), bands=bands)
    normal, rhs = np.zeros((3, 3)), np.zeros(3)
    for used, values, variance in (
        (a["code_used"], a["code_m"], a["variance_code_m2"]),
        (a["held"], a["phase_m"] - WAVELENGTH_M[a["system"]] * a["integers"], a["variance_phase_m2"]),
    ):
        members = np.flatnonzero(used)
        system = a["system"][members]
        reference = np.full(SYSTEMS, -1)
        for i in range(len(members))[:: -1 if first else 1]:  # whichever satellite is the reference
            reference[system[i]] = i
        D = double_difference_matrix(system, reference)
        W = np.linalg.inv(D @ np.diag(variance[members]) @ D.T) if len(D) else np.zeros((0, 0))
        G = -D @ a["los_enu"][members]
        for b in range(bands):
            normal += G.T @ W @ G
            rhs += G.T @ W @ D @ values[members, b]
    np.testing.assert_allclose(np.linalg.solve(normal, rhs), dense.position_enu_m, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(
        np.linalg.inv(normal), dense.covariance_m2, rtol=1e-7, atol=1e-9 * np.trace(dense.covariance_m2)
    )


def test_double_differences_cancel_every_clock_and_skip_systems_without_reference():
    system = np.array([0, 2, 0, 1, 2, 0])
    D = double_difference_matrix(system, np.array([2, 3, -1]))
    np.testing.assert_array_equal(D, [[1, 0, -1, 0, 0, 0], [0, 0, -1, 0, 0, 1]])
    np.testing.assert_array_equal(D @ np.array([7.0, 1.0, 4.0])[system], [0.0, 0.0])
    assert double_difference_matrix(system, np.full(3, -1)).shape == (0, 6)


def test_position_errors_have_the_stated_covariance():
    # Linear estimator: perturb each row by one sigma and add up S Q_y S'.
    a, _, _ = _problem(3, with_held=True)
    base = solve_dense(**a)
    total = np.zeros((3, 3))
    for name, variance in (("code_m", a["variance_code_m2"]), ("phase_m", a["variance_phase_m2"])):
        for s in range(len(variance)):
            for b in range(2):
                moved = a[name].copy()
                moved[s, b] += math.sqrt(variance[s])
                d = solve_dense(**(a | {name: moved})).position_enu_m - base.position_enu_m
                total += np.outer(d, d)
    np.testing.assert_allclose(total, base.covariance_m2, rtol=1e-5, atol=1e-8)


def _sky(azimuth_deg, elevation_deg):
    az, el = np.radians(np.broadcast_arrays(azimuth_deg, elevation_deg))
    return np.column_stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])


SINGULAR = {
    "three satellites": (_sky([0.0, 120.0, 240.0], [20.0, 40.0, 60.0]), [0, 0, 0]),
    "one elevation": (_sky(np.arange(6) * 60.0, 35.0), [0] * 6),
    "a street's plane": (_sky([0.0, 0.0, 0.0, 180.0, 180.0], [20.0, 50.0, 80.0, 60.0, 30.0]), [0] * 5),
    "one of each system": (_sky([0.0, 90.0, 180.0, 270.0], [20.0, 40.0, 60.0, 80.0]), [0, 1, 2, 3]),
    "two systems of two": (_sky([0.0, 90.0, 180.0, 270.0], [20.0, 40.0, 60.0, 80.0]), [0, 0, 1, 1]),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_singular_geometry_is_a_refusal_in_the_reference_and_a_value_in_the_kernel(name):
    los, system = SINGULAR[name][0], np.array(SINGULAR[name][1])
    n = len(system)
    assert hdop_of(rows_of(los, system, np.ones(n, dtype=bool))) == math.inf
    nothing = np.zeros(n, dtype=bool)
    with pytest.raises(InputError, match="geometry is singular"):
        solve_dense(
            los,
            system,
            np.zeros((n, 2)),
            np.zeros((n, 2)),
            np.ones(n),
            np.ones(n),
            WAVELENGTH_M,
            ~nothing,
            nothing,
            np.zeros((n, 2)),
            np.empty(0, dtype=np.int64),
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"variance_code_m2": np.zeros(16)}, "variance_code_m2 must be positive"),
        ({"variance_phase_m2": np.full(16, np.nan)}, "variance_phase_m2 must be positive"),
        ({"los_enu": np.zeros((16, 2))}, "los_enu must have shape"),
        ({"los_enu": np.full((16, 3), np.nan)}, "los_enu must be finite"),
    ],
)
def test_unusable_input_of_the_reference_is_refused(changes, message):
    a, _, _ = _problem(1, with_held=True)
    with pytest.raises(InputError, match=message):
        solve_dense(**(a | changes))


@few
@given(seed=st.integers(0, 10**6), size=st.integers(0, 20), limit=st.integers(0, 25))
def test_candidates_come_most_precise_first(seed, size, limit):
    rng = np.random.default_rng(seed)
    variance = rng.integers(1, 6, size).astype(float)  # with ties
    candidate = rng.random(size) < 0.6
    order = np.full(limit, -1, dtype=np.int64)
    count = order_by_variance(candidate, variance, limit, order)
    members = np.flatnonzero(candidate)
    expected = members[np.argsort(variance[members], kind="stable")][:limit]
    assert count == len(expected)
    np.testing.assert_array_equal(order[:count], expected)
    np.testing.assert_array_equal(order[count:], -1)


@few
@given(seed=st.integers(0, 10**6))
def test_hdop_is_that_of_the_design_matrix_with_clocks(seed):
    a, _, _ = _problem(seed, with_held=False)
    member, system = a["code_used"], a["system"]
    present = np.unique(system[member])
    G = np.column_stack([-a["los_enu"][member], (system[member][:, None] == present).astype(float)])
    Q = np.linalg.inv(G.T @ G)
    assert hdop_of(rows_of(a["los_enu"], system, member)) == pytest.approx(math.sqrt(Q[0, 0] + Q[1, 1]), rel=1e-9)


def test_hdop_of_a_ring_with_one_satellite_overhead():
    # k satellites evenly around at elevation h bring k/2 cos^2 h to each axis: HDOP = 2 / sqrt(k) / cos h
    los, system = np.vstack([_sky(np.arange(5) * 72.0, 30.0), [[0.0, 0.0, 1.0]]]), np.zeros(6, dtype=np.int64)
    expected = 2.0 / math.sqrt(5.0) / math.cos(math.radians(30.0))
    assert hdop_of(rows_of(los, system, np.ones(6, dtype=bool))) == pytest.approx(expected, rel=1e-12)
    assert hdop_of(rows_of(los, system, np.zeros(6, dtype=bool))) == math.inf


@few
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_the_inverse_of_a_positive_definite_matrix(seed, scale):
    root = np.random.default_rng(seed).normal(size=(3, 5))
    a, inverse = scale * root @ root.T, np.empty((3, 3))
    assert invert_3x3(a, inverse)
    np.testing.assert_allclose(inverse, np.linalg.inv(a), rtol=1e-6, atol=1e-12 / scale)


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((3, 3)),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([-1.0, -1.0, 1.0]),
        np.array([[1.0, 2.0, 2.0], [2.0, 1.0, 2.0], [2.0, 2.0, 1.0]]),  # eigenvalues 5, -1, -1
        np.full((3, 3), np.nan),
        np.diag([np.inf, 1.0, 1.0]),
    ],
)
def test_what_is_not_positive_definite_has_no_inverse(matrix):
    assert not invert_3x3(matrix, np.empty((3, 3)))


def test_a_satellite_alone_in_its_system_adds_nothing():
    a, _, _ = _problem(8, with_held=False)
    member = a["system"] == 0
    alone = member.copy()
    alone[np.flatnonzero(a["system"] == 1)[0]] = True
    assert hdop_of(rows_of(a["los_enu"], a["system"], alone)) == pytest.approx(
        hdop_of(rows_of(a["los_enu"], a["system"], member))
    )


def test_systems_with_too_few_satellites_are_left_out():
    system = np.array([0, 0, 0, 1, 2, 2, 3])
    member = np.array([True, True, True, True, True, False, False])
    assert drop_small_systems(member, _satellites(system), 2) == (3, 1)
    np.testing.assert_array_equal(member, [True, True, True, False, False, False, False])
    assert drop_small_systems(member, _satellites(system), 4) == (0, 0)
    assert not member.any()


def test_the_risk_of_held_ambiguities_counts_each_fix_once():
    held = np.zeros(5, AMBIGUITY)
    held["fix_id"], held["fix_risk"] = [4, 4, 7, 4, 9], [1e-6, 1e-6, 3e-6, 1e-6, 5e-6]
    assert held_risk(held) == 0.0
    held["held"][:4] = True
    assert held_risk(held) == pytest.approx(4e-6)
