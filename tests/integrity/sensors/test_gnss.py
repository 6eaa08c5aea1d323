"""What the receiver puts out: signs, units, tracking, slips, late signals, sizes, and reproducible bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import plain_signals as signals
import pytest
from scipy.stats import binom, chi2

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.area import advance_area, initial_area
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.gnss import GnssConfig, GnssEpoch, initial_state, observe
from lanebound.integrity.sky.systems import WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import Reception, SignalPath

DT = 0.1
SYSTEM = np.array([0, 0, 1, 2, 3, 0, 1, 3])
ELEVATION_DEG = np.array([80.0, 60.0, 50.0, 45.0, 40.0, 35.0, 30.0, 70.0])
N_SAT = len(SYSTEM)
LINK = CorrectionsConfig()
PERFECT = GnssConfig(
    cn0_sigma_db=0.0, code_sigma_m=0.0, phase_sigma_m=0.0, range_rate_sigma_mps=0.0, code_multipath_m=0.0,
    phase_multipath_m=0.0, iono_ppm=0.0, tropo_ppm=0.0, orbit_ppm=0.0, age_rate_mps=0.0,
    slips_per_h=0.0, clock_m=0.0, drift_mps=0.0, clock_h0=0.0, clock_hm2=0.0, station_clock_h0=0.0,
    station_clock_hm2=0.0,
)  # fmt: skip


def _sky(batch: int = 1, elevation_deg: np.ndarray = ELEVATION_DEG) -> SkyView:
    azimuth, elevation = np.linspace(0.0, 5.5, N_SAT)[None], np.deg2rad(elevation_deg)[None]
    c = np.cos(elevation)
    los = np.stack([c * np.sin(azimuth), c * np.cos(azimuth), np.sin(elevation)], -1)
    one = np.ones((1, N_SAT))
    return SkyView(
        los,
        elevation,
        azimuth,
        2e7 * one,
        0.0 * one,
        one > 0,
        SYSTEM,
        np.arange(1, N_SAT + 1),
        np.zeros(batch, dtype=np.int64),
    )


def _truth(
    batch: int = 1, position: tuple[float, float] = (3.0, -4.0), velocity: tuple[float, float] = (0.0, 0.0)
) -> Truth:
    p, v = np.tile(position, (batch, 1)), np.tile(velocity, (batch, 1))
    heading = np.arctan2(*v.T)
    return truth_between(DT, DT, (p - v * DT, p), (v, v), (heading, heading))


def _reception(batch: int = 1, path: SignalPath = SignalPath.LOS, excess_m: float = 0.0) -> Reception:
    return Reception(np.full((batch, N_SAT), path, dtype=np.uint8), np.full((batch, N_SAT), excess_m))


class _Receiver:
    """A receiver that is stepped through epochs."""

    def __init__(self, config: GnssConfig, batch: int = 1, seeds: int | list[int] = 1, settle: int = 15) -> None:
        self.config, self.batch, self.sky = config, batch, _sky(batch)
        self.streams = Streams(seeds, batch if isinstance(seeds, int) else None)
        own = Streams(seeds, batch if isinstance(seeds, int) else None)
        self.state = initial_state(config, self.sky, self.streams)
        self.area = initial_area(config, LINK, N_SAT, DT, own)
        self.time_s = 0.0
        for _ in range(settle):
            self.step()

    def step(self, **given: Any) -> GnssEpoch:
        self.time_s += DT
        advance_area(self.config, LINK, self.area, self.time_s, DT)
        return observe(
            self.config,
            self.state,
            self.sky,
            given.get("reception", _reception(self.batch)),
            given.get("truth", _truth(self.batch)),
            given.get("age_s", np.zeros(self.batch)),
            given.get("message", self.area.signals.message),
            given.get("effects", FaultEffects.none(self.batch, N_SAT)),
            self.streams,
            self.area.signals,
        )


class _Same(Streams):
    """Every vehicle draws what the first one does."""

    def __init__(self, streams: Streams) -> None:
        super().__init__([1] * streams.batch)


def _twice(state: Any) -> Any:
    """The state of the first vehicle for all of them."""
    parts = (getattr(state, f) for f in type(state).__dataclass_fields__)
    return type(state)(*(None if part is None else np.repeat(part[:1], 2, axis=0) for part in parts))


def _position(epoch: GnssEpoch, sky: SkyView) -> np.ndarray:
    """Least-squares position from the codes of a receiver without clocks."""
    return np.linalg.lstsq(-sky.los_enu[0], epoch.code_m[0, :, 0], rcond=None)[0]


def test_codes_are_minus_e_x_and_phases_add_whole_cycles() -> None:
    receiver = _Receiver(PERFECT)
    epoch = receiver.step()
    expected = -(receiver.sky.los_enu[0] @ np.array([3.0, -4.0, 0.0]))
    assert epoch.tracked.all()
    np.testing.assert_allclose(epoch.code_m[0], np.stack([expected, expected], -1), atol=1e-9)
    cycles = (epoch.phase_m[0] - epoch.code_m[0]) / WAVELENGTH_M[SYSTEM, :2]
    np.testing.assert_allclose(cycles, np.round(cycles), atol=1e-6)
    assert np.abs(cycles).max() > 10.0


def test_every_system_band_and_type_has_a_clock_of_its_own() -> None:
    receiver = _Receiver(PERFECT.replace(clock_m=100.0))
    epoch = receiver.step()
    clock = epoch.code_m[0] + (receiver.sky.los_enu[0] @ np.array([3.0, -4.0, 0.0]))[:, None]
    assert np.ptp(clock[SYSTEM == 0], axis=0).max() < 1e-9
    assert len(np.unique(np.round(clock, 6))) == 2 * len(np.unique(SYSTEM))


def test_range_rate_is_minus_e_v_plus_drift() -> None:
    velocity = (5.0, -2.0)
    plain = _Receiver(PERFECT).step(truth=_truth(velocity=velocity))
    drifting = _Receiver(PERFECT.replace(clock_m=1.0, drift_mps=1.0)).step(truth=_truth(velocity=velocity))
    np.testing.assert_allclose(plain.range_rate_mps[0], -(_sky().los_enu[0] @ [5.0, -2.0, 0.0]))
    drift = drifting.range_rate_mps - plain.range_rate_mps
    assert np.ptp(drift) < 1e-12
    assert abs(drift[0, 0]) > 1e-3


def test_wrong_reference_coordinates_move_the_solution_by_themselves() -> None:
    effects = FaultEffects.blank(1, N_SAT)
    effects.reference_enu_m[0] = [0.5, -0.2, 0.1]
    receiver = _Receiver(PERFECT)
    np.testing.assert_allclose(_position(receiver.step(effects=effects), receiver.sky), [3.5, -4.2, 0.1], atol=1e-9)


def test_spoofed_signals_describe_another_place() -> None:
    effects = FaultEffects.blank(1, N_SAT)
    effects.spoof_enu_m[0] = [0.0, 7.0, 0.0]
    receiver = _Receiver(PERFECT)
    np.testing.assert_allclose(_position(receiver.step(effects=effects), receiver.sky), [3.0, 3.0, 0.0], atol=1e-9)


def test_biases_reach_their_observables() -> None:
    effects = FaultEffects.blank(1, N_SAT)
    effects.code_bias_m[0, 2], effects.phase_bias_m[0, 3], effects.range_rate_bias_mps[0, 4] = 5.0, 0.3, 0.7
    receiver, twin = _Receiver(PERFECT), _Receiver(PERFECT)
    plain, biased = twin.step(), receiver.step(effects=effects)
    difference = biased.code_m - plain.code_m
    np.testing.assert_allclose(difference[0, 2], 5.0)
    assert np.count_nonzero(np.abs(difference) > 1e-9) == 2
    np.testing.assert_allclose((biased.phase_m - plain.phase_m)[0, 3], 0.3)
    assert (biased.range_rate_mps - plain.range_rate_mps)[0, 4] == pytest.approx(0.7)


def test_a_hidden_slip_moves_the_phase_by_whole_waves_and_stays() -> None:
    effects = FaultEffects.blank(1, N_SAT)
    effects.slip_cycles[0, 1] = [3, -1]
    receiver = _Receiver(PERFECT)
    before, slipped, after = receiver.step(), receiver.step(effects=effects), receiver.step()
    jump = (slipped.phase_m - before.phase_m)[0, 1]
    np.testing.assert_allclose(jump, WAVELENGTH_M[0, :2] * [3, -1], atol=1e-9)
    np.testing.assert_allclose(after.phase_m, slipped.phase_m, atol=1e-9)
    assert not slipped.lock_lost.any()


def test_blockage_silences_then_code_then_phase_with_new_integers() -> None:
    config = PERFECT.replace(code_delay_s=0.2, phase_delay_s=1.0)
    receiver = _Receiver(config)
    before = receiver.step()
    gone = receiver.step(reception=_reception(path=SignalPath.BLOCKED))
    assert not gone.tracked.any()
    for name in ("code_m", "phase_m", "range_rate_mps", "cn0_dbhz"):
        assert not getattr(gone, name).any()
    back = [receiver.step() for _ in range(12)]
    assert [e.tracked.all() for e in back[:3]] == [False, True, True]
    assert [bool(e.phase_m.any()) for e in back].index(True) == 9
    assert [n for n, e in enumerate(back) if e.lock_lost.any()] == [9]
    cycles = (back[-1].phase_m - before.phase_m)[0] / WAVELENGTH_M[SYSTEM, :2]
    np.testing.assert_allclose(cycles, np.round(cycles), atol=1e-6)
    assert np.abs(cycles).max() > 1.0


def test_jamming_drops_the_signal_and_then_the_satellite() -> None:
    effects = FaultEffects.blank(1, N_SAT)
    effects.cn0_drop_db[0, 0], effects.cn0_drop_db[0, 1] = 6.0, 40.0
    receiver, twin = _Receiver(PERFECT), _Receiver(PERFECT)
    plain, jammed = twin.step(), receiver.step(effects=effects)
    assert (plain.cn0_dbhz - jammed.cn0_dbhz)[0, 0] == pytest.approx(6.0)
    assert not jammed.tracked[0, 1]


@pytest.mark.parametrize("path", [SignalPath.FOLIAGE, SignalPath.REFLECTED])
def test_obstructed_signals_are_weaker_by_the_declared_loss(path: SignalPath) -> None:
    loss = {SignalPath.FOLIAGE: PERFECT.foliage_loss_db, SignalPath.REFLECTED: PERFECT.reflection_loss_db}[path]
    quick = PERFECT.replace(cn0_loop_hz=1e3)
    receiver, twin = _Receiver(quick.replace(cn0_sigma_db=1.0), 4000), _Receiver(quick, 4000)
    drop = twin.step().cn0_dbhz - receiver.step(reception=_reception(4000, path)).cn0_dbhz
    assert drop[:, 0].mean() == pytest.approx(loss, abs=4.0 * 3.0 / np.sqrt(4000))  # fails once in 15000 seeds


def test_a_late_signal_delays_the_code_by_its_detour() -> None:
    receiver, twin = _Receiver(PERFECT), _Receiver(PERFECT)
    late, plain = receiver.step(reception=_reception(path=SignalPath.REFLECTED, excess_m=40.0)), twin.step()
    seen = late.tracked[0]
    assert seen.sum() > 3
    np.testing.assert_allclose((late.code_m - plain.code_m)[0][seen], 40.0)


def test_slips_come_at_their_rate_in_half_and_whole_cycles_some_unannounced() -> None:
    """Counts of slips, of half ones and of announced ones: three binomial tests, each fails once in 1000 seeds."""
    config = PERFECT.replace(slips_per_h=3600.0, slip_decade_db=1e6, half_share=0.5, unannounced=0.25)
    receiver = _Receiver(config, batch=400)
    before, after = receiver.step(), receiver.step()
    cycles = (after.phase_m - before.phase_m)[..., 0] / WAVELENGTH_M[SYSTEM, 0]
    np.testing.assert_allclose(2.0 * cycles, np.round(2.0 * cycles), atol=1e-6)
    slipped = np.abs(cycles) > 0.25
    half = np.abs(cycles % 1.0 - 0.5) < 0.1
    counts = [(slipped.size, DT, slipped.sum()), (slipped.sum(), 0.5, half.sum())]
    counts.append((int(slipped.sum()), 0.75, int(after.lock_lost[slipped].sum())))
    for n, p, count in counts:
        low, high = binom.ppf([5e-4, 1 - 5e-4], n, p)
        assert low <= count <= high


def test_a_half_cycle_is_corrected_after_a_while_and_the_receiver_knows() -> None:
    receiver = _Receiver(PERFECT.replace(half_cycle_resolve_s=0.5))
    before = receiver.step()
    receiver.state.signals["ambiguity"][0, 2] += [1.0, 3.0]
    epochs = [receiver.step() for _ in range(8)]
    cycles = [(epoch.phase_m - before.phase_m)[0] / WAVELENGTH_M[SYSTEM, :2] for epoch in epochs]
    for k in range(5):
        np.testing.assert_allclose(cycles[k][2], [0.5, 1.5], atol=1e-6)
        assert not epochs[k].lock_lost.any()
    np.testing.assert_array_equal(np.flatnonzero(epochs[5].lock_lost[0]), [2])
    for k in range(5, 8):
        np.testing.assert_allclose(cycles[k][2], [0.0, 1.0], atol=1e-6)
    assert not any(epoch.lock_lost.any() for epoch in epochs[6:])
    others = np.arange(N_SAT) != 2
    np.testing.assert_allclose(np.array(cycles)[:, others], 0.0, atol=1e-6)


def test_no_half_cycle_outlasts_its_time() -> None:
    config = PERFECT.replace(slips_per_h=360.0, slip_decade_db=1e6, half_share=1.0, half_cycle_resolve_s=0.5)
    receiver = _Receiver(config, batch=50)
    doubt = np.array([receiver.step() and receiver.state.signals["ambiguity"] % 2.0 for _ in range(60)])
    assert doubt.any()
    assert not (np.lib.stride_tricks.sliding_window_view(doubt.any(-1), 7, axis=0).all(-1)).any()


def test_weak_signals_slip_more_often() -> None:
    config = PERFECT.replace(slips_per_h=360.0, slip_decade_db=5.0)
    effects = FaultEffects.blank(400, N_SAT)
    effects.cn0_drop_db[:] = 5.0
    strong, weak = _Receiver(config, 400), _Receiver(config, 400)
    n_strong = sum(int(strong.step().lock_lost.sum()) for _ in range(10))
    n_weak = sum(int(weak.step(effects=effects).lock_lost.sum()) for _ in range(10))
    assert n_weak > 3 * n_strong


def test_errors_grow_in_proportion_to_the_age_of_corrections() -> None:
    config = PERFECT.replace(age_rate_mps=0.0015, age_tau_s=1e9)
    receiver, plain = _Receiver(config, 500), _Receiver(PERFECT, 500).step().code_m
    error = [(receiver.step(age_s=np.full(500, age)).code_m - plain)[..., 0] for age in (10.0, 20.0)]
    np.testing.assert_allclose(error[1], 2.0 * error[0], rtol=1e-3, atol=1e-6)
    statistic = (error[0] ** 2).sum() / 0.015**2
    low, high = chi2.ppf([5e-4, 1 - 5e-4], error[0].size)  # fails by chance once in 1000 seeds
    assert low < statistic < high
    assert np.isfinite(receiver.step(age_s=np.full(500, np.inf)).phase_m).all()


def test_ionosphere_delays_codes_advances_phases_and_scales_with_the_wavelength() -> None:
    receiver, twin = _Receiver(PERFECT.replace(iono_ppm=2.0, baseline_km=10.0)), _Receiver(PERFECT)
    late, plain = receiver.step(), twin.step()
    code, phase = (late.code_m - plain.code_m)[0], (late.phase_m - plain.phase_m)[0]
    np.testing.assert_allclose(code, -phase, atol=1e-9)
    np.testing.assert_allclose(code[:, 1] / code[:, 0], (WAVELENGTH_M[SYSTEM, 1] / WAVELENGTH_M[SYSTEM, 0]) ** 2)


def test_troposphere_delays_all_alike_and_has_its_size() -> None:
    n, config = 500, PERFECT.replace(tropo_ppm=1.0, baseline_km=20.0)
    late, plain = _Receiver(config, n).step(), _Receiver(PERFECT, n).step()
    code, phase = late.code_m - plain.code_m, late.phase_m - plain.phase_m
    np.testing.assert_allclose(code, phase, atol=1e-9)
    z = code[..., 0] / signals.atmosphere_sigma_m(1.0, 20.0, np.deg2rad(ELEVATION_DEG))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], z.size)  # fails by chance once in 1000 seeds
    assert low < (z**2).sum() < high


def test_white_noise_and_range_rate_error_have_their_sizes_and_correlation() -> None:
    n = 400
    config = PERFECT.replace(code_sigma_m=0.3, phase_sigma_m=0.003, range_rate_sigma_mps=0.1)
    receiver, plain = _Receiver(config, n), _Receiver(PERFECT, n).step()
    one = receiver.step()
    for _ in range(9):
        other = receiver.step()
    scale = signals.elevation_scale(np.deg2rad(ELEVATION_DEG), plain.cn0_dbhz)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], n * N_SAT)  # each of the three fails by chance once in 1000 seeds
    code, rate = (one.code_m - plain.code_m)[..., 0] / (0.3 * scale), one.range_rate_mps - plain.range_rate_mps
    phase = (one.phase_m - plain.phase_m)[..., 1] / (0.003 * scale)
    for z in (code, phase, rate / (0.1 * scale)):
        assert low < (z**2).sum() < high
    later = other.range_rate_mps - plain.range_rate_mps
    correlation = (rate * later).mean() / (rate**2).mean()
    assert correlation == pytest.approx(np.exp(-9 * DT / 0.54), abs=4.0 / np.sqrt(n * N_SAT) * 1.5)


def test_one_band_receivers_leave_the_other_at_zero() -> None:
    epoch = _Receiver(PERFECT.replace(bands=(0,))).step()
    assert not epoch.code_m[..., 1].any()
    assert not epoch.phase_m[..., 1].any()
    assert epoch.code_m[..., 0].all()


def test_third_band_uses_its_own_wavelength() -> None:
    receiver = _Receiver(PERFECT.replace(bands=(0, 2)))
    epoch = receiver.step()
    cycles = (epoch.phase_m - epoch.code_m)[0, :, 1] / WAVELENGTH_M[SYSTEM, 2]
    np.testing.assert_allclose(cycles, np.round(cycles), atol=1e-6)


def test_motion_shortens_multipath_only_when_asked() -> None:
    def kept(per_m: float) -> float:
        config = PERFECT.replace(code_multipath_m=1.0, multipath_tau_s=1e3, multipath_per_m=per_m)
        receiver, plain = _Receiver(config, 300), _Receiver(PERFECT, 300).step().code_m
        fast = _truth(300, velocity=(20.0, 0.0))
        a, b = (receiver.step(truth=fast).code_m - plain for _ in range(2))
        return float((a * b).mean() / (a * a).mean())

    assert kept(0.0) > 0.99
    assert kept(0.1) == pytest.approx(np.exp(-0.2), abs=0.05)


def test_a_vehicle_is_the_same_alone_and_in_a_parallel_batch() -> None:
    seeds = list(range(20))
    many, alone = _Receiver(GnssConfig(), 20, seeds), _Receiver(GnssConfig(), 1, [7])
    for _ in range(3):
        a, b = many.step(), alone.step()
    for name in (f for f in GnssEpoch.__dataclass_fields__ if getattr(a, f) is not None):
        np.testing.assert_allclose(getattr(a, name)[7], getattr(b, name)[0], rtol=1e-9, atol=1e-9)


def test_same_seed_same_bits_a_copy_goes_on_alike_and_other_streams_move_nothing() -> None:
    one, two = _Receiver(GnssConfig(), 3, 9), _Receiver(GnssConfig(), 3, 9)
    two.streams.normal("imu", 50)
    twin = two.state.copy()
    a, b = one.step(), two.step()
    np.testing.assert_array_equal(a.code_m, b.code_m)
    assert not np.array_equal(twin.signals, two.state.signals)


def test_a_copy_of_the_state_goes_on_with_the_same_bits() -> None:
    receiver = _Receiver(GnssConfig(), 3, 9)
    state, streams, area, time_s = (
        receiver.state.copy(),
        receiver.streams.snapshot(),
        receiver.area.copy(),
        receiver.time_s,
    )
    first = [receiver.step() for _ in range(4)]
    receiver.state, receiver.streams, receiver.area, receiver.time_s = state, streams, area, time_s
    for a, b in zip(first, [receiver.step() for _ in range(4)], strict=True):
        for name in GnssEpoch.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_the_reference_offset_lasts_has_its_length_and_any_direction() -> None:
    receiver = _Receiver(PERFECT.replace(reference_offset_m=0.2), batch=8)
    before, after = receiver.step(), receiver.step()
    np.testing.assert_allclose(after.code_m, before.code_m, atol=1e-9)
    shifts = np.linalg.lstsq(-receiver.sky.los_enu[0], after.code_m[..., 0].T, rcond=None)[0].T - [3.0, -4.0, 0.0]
    np.testing.assert_allclose(np.hypot(shifts[:, 0], shifts[:, 1]), 0.2, atol=1e-9)
    np.testing.assert_allclose(shifts[:, 2], 0.0, atol=1e-9)
    assert np.ptp(np.arctan2(shifts[:, 0], shifts[:, 1])) > 1.0


@pytest.mark.parametrize("code_sigma_m", [0.05, 0.15, 1.0])
def test_code_noise_has_its_size_whatever_part_of_it_is_the_stations(code_sigma_m: float) -> None:
    n = 400
    config = PERFECT.replace(code_sigma_m=code_sigma_m, code_multipath_m=2.0 * code_sigma_m, foliage_loss_db=4.0)
    receiver, twin = _Receiver(config, n), _Receiver(PERFECT.replace(foliage_loss_db=4.0), n)
    noisy, plain = (r.step(reception=_reception(n, SignalPath.FOLIAGE)) for r in (receiver, twin))
    scale = signals.elevation_scale(np.deg2rad(ELEVATION_DEG), plain.cn0_dbhz)
    z = (noisy.code_m - plain.code_m)[..., 0] / (np.sqrt(5.0) * code_sigma_m * scale)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], z.size)  # fails by chance once in 1000 seeds
    assert low < (z**2).sum() < high


@pytest.mark.parametrize(
    ("name", "band", "size_m"),
    [
        ("code_multipath", None, 0.1),
        ("phase_multipath", 0, 0.001),
        ("phase_multipath", 1, 0.001),
        ("code", 0, 0.1),
        ("code", 1, 0.1),
        ("phase", 0, 0.002),
        ("phase", 1, 0.002),
    ],
)
def test_the_stations_errors_are_those_of_the_message_held(name: str, band: int | None, size_m: float) -> None:
    """Nothing but that message is noisy: by its sizes, over the elevation, in the band or both of the observable."""
    config = PERFECT.replace(code_sigma_m=0.15, code_multipath_m=0.15, phase_sigma_m=0.003, phase_multipath_m=0.002)
    receiver = _Receiver(config, 2)
    message = np.zeros((2, N_SAT), gk.STATION)
    message[name][(1, slice(None)) if band is None else (1, slice(None), band)] = 1.0
    receiver.state = _twice(receiver.state)
    receiver.streams, receiver.area = _Same(receiver.streams), initial_area(config, LINK, N_SAT, DT, Streams([1]))
    epoch = receiver.step(message=message)
    root = np.sqrt(0.5 * (1.0 + 1.0 / np.sin(np.deg2rad(ELEVATION_DEG)) ** 2))
    expected = np.zeros((2, N_SAT, 2))  # code, phase
    expected[int(name.startswith("phase"))][:, [0, 1] if band is None else [band]] = -size_m * root[:, None]
    np.testing.assert_allclose(epoch.code_m[1] - epoch.code_m[0], expected[0], atol=1e-9)
    np.testing.assert_allclose(epoch.phase_m[1] - epoch.phase_m[0], expected[1], atol=1e-9)


def test_the_receivers_clock_moves_codes_phases_and_rates_alike() -> None:
    clocks = {"drift_mps": 100.0, "clock_h0": 2e-19, "clock_hm2": 2e-20}
    receiver, still = _Receiver(PERFECT.replace(**clocks)), _Receiver(PERFECT)
    epochs, plain = [receiver.step() for _ in range(50)], still.step()
    offset = np.array([e.code_m[0] - plain.code_m[0] for e in epochs])
    assert np.ptp(offset, axis=(1, 2)).max() < 1e-9
    phase = np.array([e.phase_m[0] for e in epochs])
    np.testing.assert_allclose(np.diff(phase, axis=0), np.diff(offset, axis=0), atol=1e-6)
    drift = np.array([e.range_rate_mps[0, 0] for e in epochs])
    # between epochs the offset grows by the drift at the start, and by 3 cm of white frequency noise
    np.testing.assert_allclose(np.diff(offset[:, 0, 0]), DT * drift[:-1], atol=0.2)
    assert 0.1 < np.std(np.diff(drift) / np.sqrt(DT)) < 0.3


def test_what_is_in_view_does_not_move_the_draws() -> None:
    one, two = _Receiver(GnssConfig(), settle=30), _Receiver(GnssConfig(), settle=29)
    two.step(reception=_reception(path=SignalPath.BLOCKED))
    np.testing.assert_array_equal(one.streams.normal("gnss", 3), two.streams.normal("gnss", 3))


def test_everything_stays_finite_in_a_city() -> None:
    rng, receiver = np.random.default_rng(3), _Receiver(GnssConfig(), 10)
    for _ in range(30):
        path = rng.integers(0, 4, (10, N_SAT)).astype(np.uint8)
        epoch = receiver.step(reception=Reception(path, rng.uniform(0, 100, path.shape)), age_s=np.full(10, np.inf))
        for name in ("code_m", "phase_m", "range_rate_mps", "cn0_dbhz"):
            assert np.isfinite(getattr(epoch, name)).all()
        assert not epoch.code_m[~epoch.tracked].any()


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="same batch"):
        _Receiver(PERFECT, 2).step(truth=_truth(3))
    with pytest.raises(InputError, match="same batch"):
        _Receiver(PERFECT, 2).step(reception=_reception(3))
    lonely = _Receiver(PERFECT, 3)
    lonely.area = initial_area(PERFECT, LINK, N_SAT, DT, Streams([1, 2]))
    with pytest.raises(InputError, match="area must hold 1 or 3 areas"):
        lonely.step()
    with pytest.raises(ConfigError, match="bands"):
        GnssConfig(bands=(0, 1, 2))
    with pytest.raises(ConfigError, match="unannounced"):
        GnssConfig(unannounced=1.5)
