"""Faults: the vehicles and satellites that they strike, their times, and their sizes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.view import SkyView

DT = 0.1
SYSTEM = np.array([System.GPS, System.GPS, System.GALILEO, System.GALILEO, System.BEIDOU], dtype=np.int64)
PRN = np.array([3, 7, 3, 11, 20], dtype=np.int64)


def _sky(batch: int = 3) -> SkyView:
    azimuth, elevation = np.array([0.0, 1.3, 2.6, 3.9, 5.2]), np.array([0.4, 0.7, 1.1, 0.6, 1.4])
    los = np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1
    )
    flat = np.ones((1, 5))
    return SkyView(
        los_enu=los[None],
        elevation_rad=elevation[None],
        azimuth_rad=azimuth[None],
        range_m=2.2e7 * flat,
        range_rate_mps=0.0 * flat,
        above=flat > 0,
        system=SYSTEM,
        prn=PRN,
        index=np.zeros(batch, dtype=np.int64),
    )


SKY = _sky()
KINDS = [kind.name for kind in fault_kinds()]
EXAMPLES: dict[str, dict[str, Any]] = {
    "satellite_range": {"system": System.GPS, "prn": 7, "magnitude_m": 5.0},
    "constellation": {"system": System.GALILEO, "magnitude_m": 2.0, "azimuth_deg": 30.0},
    "cycle_slip": {"system": System.GPS, "magnitude_cycles": -3},
    "reference_coordinates": {"magnitude_m": 0.5, "azimuth_deg": 0.0},
    "spoofing": {"magnitude_m": 4.0},
    "jamming": {"magnitude_db": 15.0},
    "corrections_loss": {},
    "gyro_bias": {"magnitude_degps": 2.0},
    "wheel_slip": {"magnitude_ratio": 0.5},
    "odometer_frozen": {},
    "v2v_lie": {"magnitude_m": 3.0, "magnitude_ratio": -0.75},
    "wrong_fix": {"magnitude_rank": 2, "magnitude_cycles": 1},
    "nlos_burst": {"magnitude_m": 20.0, "satellites": 2},
}
CHANGES = {
    "satellite_range": {"code_bias_m", "phase_bias_m"},
    "constellation": {"code_bias_m", "phase_bias_m"},
    "cycle_slip": {"slip_cycles"},
    "reference_coordinates": {"reference_enu_m"},
    "spoofing": {"spoof_enu_m"},
    "jamming": {"cn0_drop_db"},
    "corrections_loss": {"corrections_lost"},
    "gyro_bias": {"gyro_bias_radps"},
    "wheel_slip": {"odometer_scale"},
    "odometer_frozen": {"odometer_frozen"},
    "v2v_lie": {"v2v_offset_enu_m", "v2v_pl_scale"},
    "wrong_fix": {"integer_error", "next_best"},
    "nlos_burst": {"code_bias_m", "cn0_drop_db"},
}


def _fault(kind: str, **changes: Any) -> Fault:
    return Fault(kind=kind, **{"start_s": 1.0, "duration_s": 2.0, **EXAMPLES[kind], **changes})


def _effects(*faults: Fault, time_s: float = 1.1) -> FaultEffects:
    return FaultSchedule(faults).effects(time_s, DT, SKY, 3)


def _changed(effects: FaultEffects) -> set[str]:
    """Names of the effects that differ from none."""
    none = FaultEffects.none(3, 5)
    names = [*(effects.signals.dtype.names or ()), *(effects.vehicles.dtype.names or ())]
    return {name for name in names if not np.array_equal(getattr(effects, name), getattr(none, name))}


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_changes_its_own_effects_while_it_lasts(kind: str) -> None:
    assert _changed(_effects(_fault(kind), time_s=1.0)) == set()
    assert _changed(_effects(_fault(kind), time_s=1.1)) == CHANGES[kind]
    later = set() if kind == "cycle_slip" else CHANGES[kind]
    assert _changed(_effects(_fault(kind), time_s=3.0)) == later
    assert _changed(_effects(_fault(kind), time_s=3.1)) == set()


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_strikes_only_the_vehicle_it_names(kind: str) -> None:
    alone, everyone, none = _effects(_fault(kind, vehicle=1)), _effects(_fault(kind)), FaultEffects.none(3, 5)
    for name in CHANGES[kind]:
        struck = getattr(alone, name)
        np.testing.assert_array_equal(struck[1], getattr(everyone, name)[1])
        np.testing.assert_array_equal(struck[[0, 2]], getattr(none, name)[[0, 2]])


def test_no_fault_gives_the_shared_zeros() -> None:
    assert _effects() is FaultEffects.none(3, 5)
    assert _effects(_fault("jamming"), time_s=0.5) is FaultEffects.none(3, 5)


def test_a_range_fault_strikes_code_and_phase_of_its_satellite() -> None:
    effects = _effects(_fault("satellite_range"))
    np.testing.assert_array_equal(effects.code_bias_m, np.tile([0.0, 5.0, 0.0, 0.0, 0.0], (3, 1)))
    np.testing.assert_array_equal(effects.phase_bias_m, effects.code_bias_m)


@pytest.mark.parametrize(
    ("target", "struck"),
    [
        ({"system": System.GPS, "prn": 3}, [[1, 1], [0, 0], [0, 0], [0, 0], [0, 0]]),
        ({"system": System.GALILEO}, [[0, 0], [0, 0], [1, 1], [1, 1], [0, 0]]),
        ({"system": System.GALILEO, "prn": 3, "band": 1}, [[0, 0], [0, 0], [0, 1], [0, 0], [0, 0]]),
        ({"system": System.QZSS}, np.zeros((5, 2))),
    ],
)
def test_slips_strike_the_satellites_and_bands_they_name(target: dict[str, Any], struck: Any) -> None:
    slips = _effects(_fault("cycle_slip", **target)).slip_cycles
    np.testing.assert_array_equal(slips, np.tile(-3 * np.asarray(struck), (3, 1, 1)))


def test_a_constellation_fault_moves_the_position_of_that_system() -> None:
    effects = _effects(_fault("constellation"))
    ours = SYSTEM == System.GALILEO
    shift = 2.0 * np.array([0.5, math.sqrt(0.75), 0.0])  # 2 m towards an azimuth of 30 deg
    # code = -e . x: the biases are those of a receiver that stands elsewhere
    np.testing.assert_allclose(effects.code_bias_m[:, ours], np.tile(-SKY.los_enu[0, ours] @ shift, (3, 1)))
    assert not effects.code_bias_m[:, ~ours].any()


def test_displacements_point_to_their_azimuth() -> None:
    np.testing.assert_allclose(_effects(_fault("reference_coordinates")).reference_enu_m[0], [0.0, 0.5, 0.0])
    np.testing.assert_allclose(_effects(_fault("spoofing")).spoof_enu_m[0], [4.0, 0.0, 0.0], atol=1e-12)


def test_a_wrong_fix_has_the_integers_given_by_satellite() -> None:
    chosen = _effects(Fault(kind="wrong_fix", start_s=1.0, magnitude_cycles=-2, system=System.GPS, prn=7))
    np.testing.assert_array_equal(chosen.integer_error[0], [[0, 0], [-2, -2], [0, 0], [0, 0], [0, 0]])
    listed = _effects(
        Fault(kind="wrong_fix", start_s=1.0, integers=((System.GPS, 7, 4, 3), (System.GALILEO, 99, 1, 1)))
    )
    np.testing.assert_array_equal(listed.integer_error[0], [[0, 0], [4, 3], [0, 0], [0, 0], [0, 0]])
    with pytest.raises(ConfigError, match="jamming has no integers"):
        Fault(kind="jamming", magnitude_db=10.0, integers=((System.GPS, 7, 4, 3),))
    with pytest.raises(ConfigError, match="magnitude_rank must be an integer >= 1 and <= 100, got 101"):
        Fault(kind="wrong_fix", magnitude_rank=101)


def test_the_loss_of_a_burst_is_settable() -> None:
    for loss in (2.0, 6.0):
        dropped = _effects(_fault("nlos_burst", **({} if loss == 6.0 else {"loss_db": loss}))).cn0_drop_db
        assert set(np.unique(dropped)) == {0.0, loss}


def test_a_burst_strikes_the_lowest_satellites_of_its_side_by_the_mirror_image() -> None:
    effects = _effects(_fault("nlos_burst"))
    east = SKY.los_enu[0, :, 0]
    struck = [1, 2]  # east of North-South: azimuths 1.3 and 2.6 rad; the two others stand in the west, one at North
    expected = np.zeros(5)
    expected[struck] = 20.0 * east[struck]
    np.testing.assert_allclose(effects.code_bias_m, np.tile(expected, (3, 1)), atol=1e-12)
    assert not effects.phase_bias_m.any()
    assert not effects.range_rate_bias_mps.any()
    (lowest,) = np.flatnonzero(_effects(_fault("nlos_burst", satellites=1)).code_bias_m[0])
    assert lowest == 1


def test_the_carrier_of_a_burst_follows_the_change_of_its_path() -> None:
    effects = _effects(_fault("nlos_burst", profile="ramp", ramp_s=2.0), time_s=2.0)
    np.testing.assert_allclose(effects.phase_bias_m, effects.code_bias_m)
    np.testing.assert_allclose(effects.range_rate_bias_mps, effects.code_bias_m, atol=1e-12)  # 1 s after the onset


@pytest.mark.parametrize("kind", ["satellite_range", "constellation", "nlos_burst"])
def test_the_doppler_bias_is_the_derivative_of_the_phase_bias(kind: str) -> None:
    ramp = _fault(kind, profile="ramp", ramp_s=0.8)
    for time_s in (1.2, 1.6, 2.4):
        before, now, after = (_effects(ramp, time_s=time_s + h) for h in (-0.05, 0.0, 0.05))
        slope = (after.phase_bias_m - before.phase_bias_m) / 0.1
        np.testing.assert_allclose(now.range_rate_bias_mps, slope, atol=1e-9)


def test_a_drag_off_shows_in_the_doppler_as_the_motion_it_feigns() -> None:
    effects = _effects(_fault("spoofing", profile="ramp", ramp_s=2.0), time_s=2.0)
    np.testing.assert_allclose(effects.spoof_enu_m, np.tile([2.0, 0.0, 0.0], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(effects.range_rate_bias_mps, np.tile(-2.0 * SKY.los_enu[0, :, 0], (3, 1)), atol=1e-12)


@given(time_s=st.floats(1.01, 3.0), ramp_s=st.floats(0.1, 5.0))
def test_a_ramp_grows_to_its_size_and_stays(time_s: float, ramp_s: float) -> None:
    share = min((time_s - 1.0) / ramp_s, 1.0)
    effects = _effects(_fault("gyro_bias", profile="ramp", ramp_s=ramp_s), time_s=time_s)
    np.testing.assert_allclose(effects.gyro_bias_radps, math.radians(2.0) * share, atol=1e-12)
    factor = _effects(_fault("wheel_slip", profile="ramp", ramp_s=ramp_s), time_s=time_s).odometer_scale
    np.testing.assert_allclose(factor, 1.0 + 0.5 * share)


def test_faults_add_up_and_factors_multiply() -> None:
    effects = _effects(
        _fault("satellite_range"),
        _fault("satellite_range", magnitude_m=-2.0),
        _fault("wheel_slip"),
        _fault("wheel_slip", magnitude_ratio=-0.5, vehicle=0),
        _fault("odometer_frozen", vehicle=2),
    )
    np.testing.assert_allclose(effects.code_bias_m[0], [0.0, 3.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(effects.odometer_scale, [0.75, 1.5, 1.5])
    assert effects.odometer_frozen.tolist() == [False, False, True]


@given(start=st.integers(0, 8000), dt=st.sampled_from([0.01, 0.05, 0.1, 0.7]))
def test_a_slip_happens_in_exactly_one_epoch(start: int, dt: float) -> None:
    schedule = FaultSchedule([_fault("cycle_slip", start_s=start / 1000.0, magnitude_cycles=1)])
    slips = sum(schedule.effects(n * dt, dt, SKY, 3).slip_cycles[0, 0, 0] for n in range(1, math.ceil(10.0 / dt)))
    assert slips == 1


def test_epochs_summed_in_floating_point_meet_every_onset_and_end() -> None:
    faults = [_fault("jamming", start_s=n / 10, duration_s=0.3) for n in range(50)]
    schedule, time_s = FaultSchedule(faults), 0.0
    for n in range(1, 60):
        time_s += DT
        onsets = [round(10 * f.start_s) for f in schedule.active(time_s)]
        assert onsets == [k for k in (n - 3, n - 2, n - 1) if 0 <= k < 50]


@pytest.mark.parametrize("kind", [kind.name for kind in fault_kinds() if "ramp" not in kind.profiles])
def test_a_kind_without_ramps_has_its_whole_size_at_once(kind: str) -> None:
    step, ramp = (_effects(_fault(kind, profile=profile, ramp_s=1.5)) for profile in ("step", "ramp"))
    for name in CHANGES[kind]:
        np.testing.assert_array_equal(getattr(ramp, name), getattr(step, name))


def test_faults_survive_json() -> None:
    for kind in KINDS:
        fault = _fault(kind)
        assert Fault.from_json(fault.to_json()) == fault


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"kind": "jaming"}, "did you mean 'jamming'"),
        ({"kind": 3}, "kind must be one of 'satellite_range', .*got 3: choose one of them"),
        ({"kind": "wheel_slip", "magnitude_ratio": -1.0}, "magnitude_ratio must be > -1, got -1"),
        ({"kind": "v2v_lie"}, "v2v_lie needs magnitude_m or magnitude_ratio"),
        (
            {"kind": "jamming", "magnitude": 3.0, "magnitude_db": 1.0},
            "jamming has no magnitude: give its size as magnitude_db \\[dB\\]",
        ),
        ({"kind": "jamming"}, "jamming needs magnitude_db"),
        ({"kind": "jamming", "magnitude_m": 3.0}, "jamming has no magnitude_m"),
        (
            {"kind": "odometer_frozen", "magnitude_ratio": 2.0},
            "odometer_frozen has no magnitude_ratio: leave it out, this kind has no size$",
        ),
        (
            {"kind": "constellation", "magnitude_m": 1.0},
            "constellation needs a system: give one of 0 .GPS., 1 .GALILEO., .* 4 .QZSS.$",
        ),
        ({"kind": "satellite_range", "magnitude_m": 1.0, "system": 0}, "satellite_range needs a prn"),
        ({"kind": "jamming", "magnitude_db": -1.0}, "magnitude_db must be >= 0"),
        ({"kind": "corrections_loss", "duration_s": 0.0}, "duration_s must be > 0"),
    ],
)
def test_refuses_faults_that_make_no_sense(data: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Fault.load(data)
