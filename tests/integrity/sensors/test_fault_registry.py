"""The registry of fault kinds: each kind has an effect that a measurement shows, and wrong declarations are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.fault_kinds import MAGNITUDE_FIELDS, FaultKind, FaultMoment, FaultPrior, Magnitude
from lanebound.integrity.sensors.fault_registry import fault_kind, fault_kinds, register_fault, withdraw_fault
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

DT, VEHICLES, ONSET = 0.1, 2, 60
CONFIG = NavigatorConfig.load({"corrections": {"outage_per_h": 0.0}})
TRACK = SkyTrack.from_config(CONFIG.sky, 60.0)
SKY = TRACK.at(TRACK.start_s, np.zeros(VEHICLES, dtype=np.int64))
HIGHEST = int(np.argmax(SKY.elevation_rad[0]))


def _largest(kind: FaultKind) -> Fault:
    """A fault of the largest size that the fault campaign tries, at the highest satellite, of the second vehicle."""
    places = {"system": int(SKY.system[HIGHEST]), "prn": int(SKY.prn[HIGHEST]), "band": 0}
    size = {} if kind.magnitude is None else {kind.magnitude.field: kind.sizes_tried[-1]}
    needed = {name: places[name] for name in kind.needs if name in places}
    return Fault.load({"kind": kind.name, "start_s": ONSET * DT, "vehicle": 1, **size, **needed})


def _measured(faults: FaultSchedule, epochs: int = ONSET + 15) -> list[list[np.ndarray]]:
    """All measurements and messages by epoch, each with the vehicle as its first axis."""
    navigator = Navigator(CONFIG, TRACK, SkyMask.open(), [1, 2], faults=faults)
    heading, v = np.zeros(VEHICLES), np.tile([0.0, 8.0], (VEHICLES, 1))
    rows = []
    for k in range(1, epochs + 1):
        truth = truth_between(DT * k, DT, (v * (k - 1) * DT, v * k * DT), (v, v), (heading, heading), 0.8 * k)
        m = navigator.measure(truth)
        effects = faults.effects(truth.time_s, DT, SKY, VEHICLES)
        said = (effects.v2v_offset_enu_m, effects.v2v_pl_scale)  # by sender
        signals = [values for values in vars(m.gnss).values() if values is not None]
        rows.append([*signals, *vars(m.imu).values(), *vars(m.odometer).values(), *said])
    return rows


@pytest.fixture(scope="module")
def sound() -> list[list[np.ndarray]]:
    return _measured(FaultSchedule())


@pytest.mark.parametrize("kind", fault_kinds(), ids=lambda kind: kind.name)
def test_a_measurement_shows_each_kind(kind: FaultKind, sound: list[list[np.ndarray]]) -> None:
    """At the first epoch of the fault or, where a message is lost, once the next one is missing."""
    faulty, shown = _measured(FaultSchedule([_largest(kind)])), False
    for k, (with_fault, without) in enumerate(zip(faulty, sound, strict=True), start=1):
        same = [[np.array_equal(a[v], b[v]) for a, b in zip(with_fault, without, strict=True)] for v in (0, 1)]
        assert all(same[0]), "the other vehicle measures the same"
        assert all(same[1]) or k > ONSET
        shown |= not all(same[1])
    assert shown


def test_names_are_looked_up_and_unknown_ones_refused_with_the_nearest() -> None:
    assert fault_kind("jamming").unit == "dB"
    with pytest.raises(InputError, match=r"one of 'satellite_range', .* or 'nlos_burst', got 'jaming': did you mean"):
        fault_kind("jaming")


def _nothing(effects: FaultEffects, now: FaultMoment) -> None:
    """A fault without effects."""


def test_a_name_is_registered_once_and_kinds_of_the_package_stay() -> None:
    kind = FaultKind(name="other", summary="nothing", apply=_nothing)
    assert register_fault(kind) is register_fault(kind) is fault_kinds()[-1]
    try:
        with pytest.raises(InputError, match=r"must be new, got 'other': .*withdraw_fault\('other'\)"):
            register_fault(FaultKind(name="other", summary="nothing else", apply=_nothing))
    finally:
        withdraw_fault("other")
    with pytest.raises(InputError, match="got 'other'"):
        withdraw_fault("other")
    with pytest.raises(InputError, match="got 'jamming'"):
        withdraw_fault("jamming")
    with pytest.raises(InputError, match="must be new, got 'jamming'"):
        register_fault(FaultKind(name="jamming", summary="nothing", apply=_nothing))


NS = Magnitude("ns", ge=1.0, le=9.0, signed=False, whole=True)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"name": "clock jump"}, "'clock jump': name must be an identifier"),
        ({"summary": ""}, "summary must say what the fault does"),
        ({"profiles": ("ramp",)}, "profiles must contain 'step'"),
        ({"profiles": "step"}, "profiles must be a tuple of 'step' and 'ramp', got 'step'"),
        ({"profiles": ("step", "rmp")}, r"profiles must be a tuple of 'step' and 'ramp', got \('step', 'rmp'\)"),
        ({"apply": None}, "apply must be a function of effects and moment, got None"),
        ({"target": "satelite"}, "target must be a FaultTarget, got 'satelite'"),
        (
            {"magnitudes": (NS,), "sizes_tried": (1.0,), "prior": FaultPrior(per_h=1.0, low=1.0, high=10.0)},
            "prior.high must be an integer >= 1 and <= 9, got 10",
        ),
        ({"needs": ("satellite",)}, r"needs must be of system, prn, band, vehicle, got \('satellite',\)"),
        ({"magnitudes": (NS,)}, "sizes_tried must hold the sizes of the fault campaign, got none: .*not_tried_because"),
        ({"magnitudes": (NS,), "sizes_tried": (3.0, 10.0)}, "must be an integer >= 1 and <= 9 and not 0, got 10"),
        ({"magnitudes": (NS,), "sizes_tried": (2.5,)}, "must be an integer >= 1 and <= 9 and not 0, got 2.5"),
        ({"magnitudes": (Magnitude("ns"),), "sizes_tried": (0.0,)}, "must be any number and not 0, got 0"),
        ({"sizes_tried": (1.0,)}, "sizes_tried must be empty without a magnitude"),
        (
            {"magnitudes": (NS,), "sizes_tried": (1.0,), "not_tried_because": "slow"},
            "not_tried_because must be empty",
        ),
    ],
)
def test_wrong_declarations_are_refused(declared: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        FaultKind(**{"name": "other", "summary": "nothing", "apply": _nothing, **declared})


def test_a_function_that_returns_its_effects_is_refused() -> None:
    kind = FaultKind(name="other", summary="nothing", apply=lambda effects, now: effects.code_bias_m + 1.0)  # type: ignore[arg-type, return-value]
    register_fault(kind)
    schedule = FaultSchedule([Fault(kind="other", start_s=0.0)])
    with pytest.raises(InputError, match="apply of fault kind 'other' must change the effects in place"):
        schedule.effects(0.5, DT, SKY, VEHICLES)


def test_a_magnitude_has_a_field_of_faults() -> None:
    assert set(MAGNITUDE_FIELDS) == {name for name in Fault.model_fields if name.startswith("magnitude")}
    with pytest.raises(ConfigError, match=r"field must be one of magnitude, magnitude_m, .* got 'magnitude_ns'"):
        Magnitude("ns", "magnitude_ns")


def test_random_sizes_take_no_sign_that_the_bounds_refuse() -> None:
    with pytest.raises(ConfigError, match="signed must be False where a magnitude must be >= 0"):
        Magnitude("dB", ge=0.0)
