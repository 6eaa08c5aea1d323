"""A receiver whose signals arrive by paths: code, carrier, Doppler and C/N0 of reflections and edges."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.arrival_kernel import TRACKED
from lanebound.integrity.sensors.gnss import GnssConfig, GnssEpoch, gnss_parameters
from lanebound.integrity.sky.raytrace_kernel import FACE, NO_EDGE
from lanebound.integrity.sky.systems import CHIP_M, WAVELENGTH_M
from lanebound.integrity.sky.visibility import Reception, SignalPath, blank_reception
from tests.integrity.sensors.test_gnss import DT, N_SAT, PERFECT, SYSTEM, _Receiver

PATHS = PERFECT.replace(cn0_zenith_dbhz=48.0, cn0_horizon_dbhz=48.0, cross_polar=1.0)
FACE_SOUTH_M = 20.0
ELEVATION_RAD = np.deg2rad([80.0, 60.0, 50.0, 45.0, 40.0, 35.0, 30.0, 70.0])


def faces(*planes: tuple[tuple[float, float, float], float, int]) -> np.ndarray:
    table = np.zeros(len(planes), FACE)
    for row, (normal, offset, material) in zip(table, planes, strict=True):
        row["normal"], row["offset"], row["material"] = normal, offset, material
    return table


METAL = faces(((0.0, 1.0, 0.0), -FACE_SOUTH_M, 3))  # a metal wall 20 m south of the origin, it faces north


def reception(
    path: SignalPath, face: tuple[int, int] = (-1, -1), table: np.ndarray = METAL, **edge: float
) -> Reception:
    rows = blank_reception(1, N_SAT, table)
    rows.path[:], rows.excess[:], rows.face[:] = path, 0.0, face
    rows.skyline[:], rows.edge[:] = edge.get("skyline", NO_EDGE), edge.get("edge", 0.0)
    return Reception(rows.path, rows.excess, rows)


def truth(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Truth:
    p, v, heading = np.array([[x, y]]), np.array([[vx, vy]]), np.array([np.arctan2(vx, vy)])
    return truth_between(DT, DT, (p - v * DT, p), (v, v), (heading, heading))


def errors(receiver: _Receiver, epoch: GnssEpoch, where: Truth) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of codes and phases (S, 2) [m] and of range rates (S,) [m/s]."""
    e = receiver.sky.los_enu[0]
    range_m = -(e @ where.position_enu_m[0])
    rate = -(e @ where.velocity_enu_mps[0])
    return epoch.code_m[0] - range_m[:, None], epoch.phase_m[0] - range_m[:, None], epoch.range_rate_mps[0] - rate


def receiver_in(arrival: Any, where: Truth, config: GnssConfig = PATHS) -> _Receiver:
    receiver = _Receiver(config, settle=0)
    for _ in range(15):
        receiver.step(reception=arrival(), truth=where)
    return receiver


def north_of(receiver: _Receiver) -> np.ndarray:
    """Component of the satellites' directions along the normal of the wall; positive: the wall reflects them."""
    return np.asarray(receiver.sky.los_enu[0, :, 1])


def test_a_signal_without_obstacles_has_no_error() -> None:
    where = truth(3.0, -4.0)
    receiver = receiver_in(lambda: reception(SignalPath.LOS), where)
    arrival = reception(SignalPath.LOS)
    code, phase, rate = errors(receiver, receiver.step(reception=arrival, truth=where), where)
    np.testing.assert_allclose(code, 0.0, atol=1e-9)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)
    cycles = phase / WAVELENGTH_M[SYSTEM, :2]
    np.testing.assert_allclose(cycles, np.round(cycles), atol=1e-6)
    assert (arrival.path == SignalPath.LOS).all()


def test_a_pure_reflection_is_late_by_the_whole_detour_and_shifted_in_frequency() -> None:
    where = truth(3.0, -4.0, 2.0, 7.0)
    receiver = receiver_in(lambda: reception(SignalPath.REFLECTED, (0, -1)), where)
    seen = reception(SignalPath.REFLECTED, (0, -1))
    epoch = receiver.step(reception=seen, truth=where)
    code, _, rate = errors(receiver, epoch, where)
    north, lit = north_of(receiver), north_of(receiver) > 0.0
    assert epoch.tracked[0].tolist() == lit.tolist()
    detour = 2.0 * (FACE_SOUTH_M - 4.0) * north[lit]
    np.testing.assert_allclose(code[lit], np.stack([detour, detour], -1), atol=1e-9)
    np.testing.assert_allclose(rate[lit], 2.0 * north[lit] * 7.0, atol=1e-6)
    assert (seen.path[0, lit] == SignalPath.REFLECTED).all()
    assert (seen.path[0, ~lit] == SignalPath.BLOCKED).all()


def test_the_carrier_of_a_reflection_follows_the_change_of_its_path() -> None:
    start, receiver = truth(0.0, 0.0), None
    receiver = receiver_in(lambda: reception(SignalPath.REFLECTED, (0, -1)), start)
    lit = north_of(receiver) > 0.0
    _, before, _ = errors(
        receiver, receiver.step(reception=reception(SignalPath.REFLECTED, (0, -1)), truth=start), start
    )
    later = truth(0.0, 0.7)
    _, after, _ = errors(
        receiver, receiver.step(reception=reception(SignalPath.REFLECTED, (0, -1)), truth=later), later
    )
    change = 2.0 * 0.7 * north_of(receiver)[lit]
    np.testing.assert_allclose((after - before)[lit], np.stack([change, change], -1), atol=1e-9)


@pytest.mark.parametrize("chips", [0.1, 0.5])
def test_multipath_stays_within_the_envelope_of_the_correlator_and_a_quarter_wave(chips: float) -> None:
    config = PATHS.replace(correlator_chips=chips, cross_polar=0.4)
    worst = np.zeros((N_SAT, 2))
    for north in np.linspace(0.0, 0.2, 40):  # a wavelength and more of detour
        where = truth(0.0, float(north))
        receiver = receiver_in(lambda: reception(SignalPath.LOS, (0, -1)), where, config)
        code, phase, _ = errors(
            receiver, receiver.step(reception=reception(SignalPath.LOS, (0, -1)), truth=where), where
        )
        worst = np.maximum(worst, np.abs(code))
        wave = WAVELENGTH_M[SYSTEM, :2]
        assert (np.abs(phase - wave * np.round(phase / wave)) <= 0.25 * wave).all()
    lit = north_of(receiver) > 0.05
    assert (worst <= 0.4 * 0.5 * chips * CHIP_M[SYSTEM, :2] + 1e-9).all()  # metal at all angles: at most cross_polar
    assert (worst[lit] > 1e-3).all()
    assert (worst[~(north_of(receiver) > 0.0)] < 1e-9).all()


def test_a_ray_over_an_edge_fades_by_the_knife_edge_loss() -> None:
    above_rad, edge_m = 0.02, 25.0
    where = truth(0.0, 0.0)
    blocked = [reception(SignalPath.BLOCKED, edge=edge_m) for _ in range(30)]
    for one in blocked:
        assert one.given is not None
        one.given.skyline[:] = ELEVATION_RAD + above_rad
    receiver = _Receiver(PATHS, settle=0)
    for one in blocked:
        epoch = receiver.step(reception=one, truth=where)
    v = above_rad * np.sqrt(2.0 * edge_m / WAVELENGTH_M[SYSTEM, 0])
    loss = 6.9 + 20.0 * np.log10(np.sqrt((v - 0.1) ** 2 + 1.0) + v - 0.1)
    np.testing.assert_allclose(48.0 - epoch.cn0_dbhz[0], loss, atol=1e-4)
    np.testing.assert_allclose(errors(receiver, epoch, where)[0], 0.5 * edge_m * above_rad**2, atol=1e-6)
    assert (blocked[-1].path == SignalPath.DIFFRACTED).all()


@pytest.mark.parametrize(
    ("above_rad", "window_s", "epochs"),
    [(0.05, 0.1, None), (0.1, 0.02, 0), (0.1, 0.1, 4), (0.1, 0.3, 12)],
)
def test_a_deep_fade_breaks_the_lock_when_the_detector_sees_it(
    above_rad: float, window_s: float, epochs: int | None
) -> None:
    """Losses of 12 and 17.4 dB from 48 dB-Hz; the carrier loop needs 34 dB-Hz.

    The power in the window is ``p + (1 - p) exp(-t / window)``, p = -17.4 dB: below -14 dB, which is 0.0398, from
    ``t = window ln((1 - p) / (0.0398 - p)) = 3.8 window`` on. Noise and wavelengths move that by an epoch.
    """
    config, where = PATHS.replace(cn0_loop_hz=0.05, phase_min_dbhz=34.0, lock_window_s=window_s), truth(0.0, 0.0)
    receiver = receiver_in(lambda: reception(SignalPath.LOS), where, config)
    locked = []
    for _ in range(20):
        behind = reception(SignalPath.BLOCKED, edge=25.0)
        assert behind.given is not None
        behind.given.skyline[:] = ELEVATION_RAD + above_rad
        epoch = receiver.step(reception=behind, truth=where)
        locked.append((epoch.phase_m[0] != 0.0).all(-1))
        assert (epoch.cn0_dbhz > 32.0).all()
    if epochs is None:
        assert np.all(locked)
    else:
        kept = np.sum(locked, axis=0)  # epochs until each satellite loses its lock, which needs 1 s to return
        assert (np.abs(kept - epochs) <= (1 if epochs else 0)).all()


def test_the_lock_detector_errs_as_an_estimate_of_so_many_intervals_does() -> None:
    """At its threshold it sees the lock half of the time, 1 dB above it in the share that its variance says."""
    rules, tracked = gnss_parameters(PATHS.replace(phase_min_dbhz=32.0, lock_window_s=0.2), DT)[0], np.zeros(1, TRACKED)
    tracked["power"] = 1.0
    noise = np.random.default_rng(5).standard_normal(20_000)
    for above_db in (0.0, 1.0):
        seen = np.mean([gk.sees_lock(rules, 32.0 + above_db, z, tracked[0]) for z in noise])
        snr, least = gk.COHERENT_S * 10.0 ** (0.1 * (32.0 + above_db)), gk.COHERENT_S * 10.0**3.2
        expected = norm.cdf((snr - least) / np.sqrt((1.0 + 2.0 * snr) / 10.0))
        # fails by chance once in 15000 seeds
        assert seen == pytest.approx(expected, abs=4.0 * np.sqrt(expected * (1 - expected) / noise.size))


def test_far_below_the_edge_nothing_arrives() -> None:
    receiver = _Receiver(PATHS, settle=20)
    dark = reception(SignalPath.BLOCKED, skyline=1.5, edge=60.0)
    assert not receiver.step(reception=dark).tracked[0, 1:7].any()
    assert (dark.path[0, 1:7] == SignalPath.BLOCKED).all()


@pytest.mark.parametrize("keep", [0.0, 1.0])
def test_when_the_direct_ray_is_lost_the_carrier_goes_on_by_the_reflection_or_breaks(keep: float) -> None:
    config, where = PATHS.replace(keep_lock=keep), truth(0.0, 0.0)
    receiver = receiver_in(lambda: reception(SignalPath.LOS, (0, -1)), where, config)
    lit = north_of(receiver) > 0.3
    _, before, _ = errors(receiver, receiver.step(reception=reception(SignalPath.LOS, (0, -1)), truth=where), where)
    epoch = receiver.step(reception=reception(SignalPath.BLOCKED, (0, -1)), truth=where)
    _, after, _ = errors(receiver, epoch, where)
    if keep == 1.0:
        jump = np.abs(after - before)[lit]
        assert not epoch.lock_lost[0, lit].any()
        assert (jump <= 0.76 * WAVELENGTH_M[SYSTEM[lit], :2]).all()  # half a cycle, and the multipath of before
        later = truth(0.0, 1.0)
        moved = receiver.step(reception=reception(SignalPath.REFLECTED, (0, -1)), truth=later)
        _, gone, _ = errors(receiver, moved, later)
        np.testing.assert_allclose((gone - after)[lit, 0], 2.0 * north_of(receiver)[lit], atol=1e-9)
    else:
        assert (epoch.phase_m[0, lit] == 0.0).all()
        for _ in range(14):
            epoch = receiver.step(reception=reception(SignalPath.REFLECTED, (0, -1)), truth=where)
        assert (epoch.phase_m[0, lit] != 0.0).all()


def test_a_reflection_at_an_unknown_face_keeps_the_excess_of_the_mask() -> None:
    late = Reception(np.full((1, N_SAT), SignalPath.REFLECTED, dtype=np.uint8), np.full((1, N_SAT), 33.0))
    where = truth(1.0, 2.0)
    receiver = _Receiver(PATHS, settle=0)
    for _ in range(15):
        epoch = receiver.step(reception=late, truth=where)
    np.testing.assert_allclose(errors(receiver, epoch, where)[0], 33.0, atol=1e-9)
    np.testing.assert_allclose(epoch.cn0_dbhz[0], 48.0 - PATHS.reflection_loss_db, atol=1e-9)


def test_fading_in_motion_is_that_of_the_phase_between_the_rays() -> None:
    """Along the normal, C/N0 goes through its whole range within half a wavelength of detour each way."""
    config = PATHS.replace(cross_polar=0.4, cn0_loop_hz=1000.0)
    levels = []
    for north in np.linspace(0.0, 0.4, 200):
        where = truth(0.0, float(north))
        receiver = _Receiver(config, settle=0)
        levels.append(receiver_in(lambda w=where: reception(SignalPath.LOS, (0, -1)), where, config).step(
            reception=reception(SignalPath.LOS, (0, -1)), truth=where).cn0_dbhz[0])  # fmt: skip
    seen, lit = np.array(levels) - 48.0, north_of(receiver) > 0.1
    a = 10.0 ** (seen[:, lit].max(0) / 20.0) - 1.0
    np.testing.assert_allclose(10.0 ** (seen[:, lit].min(0) / 20.0), 1.0 - a, atol=0.01)
    assert (a < 0.41).all()
    assert math.isclose(a.max(), 0.4, abs_tol=0.02)  # metal reflects nearly all, by the response to left-handed waves
