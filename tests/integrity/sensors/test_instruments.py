"""All instruments in one call measure what they measure one after another, bit for bit."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig
from lanebound.integrity.sensors.area import advance_area
from lanebound.integrity.sensors.corrections import link_parameters
from lanebound.integrity.sensors.corrections_kernel import receive
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sensors.gnss import observe
from lanebound.integrity.sensors.imu import sample_imu
from lanebound.integrity.sensors.instruments import observed
from lanebound.integrity.sensors.odometer import sample_odometer
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

DT = 0.1
TRACK = SkyTrack.from_config(SkyConfig(), 60.0)
CONFIG = NavigatorConfig.model_validate(
    {"corrections": {"outage_per_h": 400.0}, "imu": {"mems_exponential": True, "moving_gyro_bias_degps": 0.01}}
)
FAULTS = tuple(
    Fault.model_validate({"kind": kind, "start_s": 2.0, "duration_s": 2.0, **size})
    for kind, size in (
        ("spoofing", {"magnitude_m": 5.0, "profile": "ramp"}),
        ("corrections_loss", {}),
        ("gyro_bias", {"magnitude_degps": 0.5, "vehicle": 0}),
        ("wheel_slip", {"magnitude_ratio": 0.1}),
        ("jamming", {"magnitude_db": 6.0}),
    )
)


def _mask() -> SkyMask:
    """A street whose sky changes every 10 m: open, trees, nothing, open."""
    path = np.array(
        [SignalPath.LOS, SignalPath.FOLIAGE, SignalPath.BLOCKED, SignalPath.REFLECTED], dtype=np.uint8
    ).reshape(-1, 1, 1)
    return SkyMask(path, np.full(path.shape, 20.0, dtype=np.float32), 1, 1, 10.0, 40.0, True)


def _navigator(seeds: int | list[int], batch: int | None = None, faults: tuple[Fault, ...] = ()) -> Navigator:
    area = 7 if faults else None  # one for all, or one for each
    return Navigator(CONFIG, TRACK, _mask(), seeds, batch, FaultSchedule(faults), area)


def _one_by_one(navigator: Navigator, truth: Truth) -> Measurements:
    """The instruments, each by its own function."""
    c, s, batch = navigator.config, navigator.state, navigator.batch
    sky = navigator.track.at(navigator.track.start_s + truth.time_s, np.zeros(batch, dtype=np.int64))
    effects = navigator.faults.effects(truth.time_s, truth.dt_s, sky, batch)
    advance_area(c.gnss, c.corrections, s.area, truth.time_s, truth.dt_s)
    age = _link_ages(navigator, truth.dt_s, effects.corrections_lost)
    reception = navigator.mask.look(truth.arc_m, truth.lane, sky)
    gnss = observe(c.gnss, s.gnss, sky, reception, truth, age, s.corrections.held, effects, s.streams, s.area.signals)
    imu = sample_imu(c.imu, s.imu, truth, effects, s.streams)
    return Measurements(
        truth.time_s, sky, gnss, imu, sample_odometer(c.odometer, s.odometer, truth, effects, s.streams)
    )


def _link_ages(navigator: Navigator, dt_s: float, lost: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Ages of the newest reference data, (B,) [s]; the links advance by an epoch."""
    c, s = navigator.config.corrections, navigator.state
    u = z = np.zeros(navigator.batch)
    if c.outage_per_h > 0.0:
        u, z = s.streams.uniform("corrections"), s.streams.normal("corrections")
    network, sent, links, held = s.area.network, s.area.signals.message, s.corrections.links, s.corrections.held
    rules, areas = link_parameters(c, dt_s), network.areas
    ages = [
        receive(network.epoch, rules[0], areas[a], sent[a], u[v], z[v], lost[v], links[v], held[v])
        for v, a in enumerate(np.arange(navigator.batch) % areas.size)
    ]
    return np.array(ages)


def _truth(k: int, batch: int) -> Truth:
    heading = np.linspace(0.0, 3.0, batch)
    v = (8.0 + np.sin(0.3 * k)) * np.stack([np.sin(heading), np.cos(heading)], -1)
    return truth_between(DT * k, DT, (v * (k - 1) * DT, v * k * DT), (v, v), (heading, heading + 0.01), 0.8 * k)


def _assert_same(a: Any, b: Any) -> None:
    if is_dataclass(a):
        for field in (field for field in fields(a) if field.init):
            _assert_same(getattr(a, field.name), getattr(b, field.name))
    else:
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("faults", [(), FAULTS])
@pytest.mark.parametrize(("seeds", "batch"), [([4], None), ([4, 5, 6], None), (9, 3)])
def test_one_call_equals_one_instrument_after_another(
    seeds: int | list[int], batch: int | None, faults: tuple[Fault, ...]
) -> None:
    together, apart = _navigator(seeds, batch, faults), _navigator(seeds, batch, faults)
    for k in range(1, 60):
        truth = _truth(k, together.batch)
        _assert_same(together.measure(truth), _one_by_one(apart, truth))
    for name in ("gnss", "corrections", "imu", "odometer"):
        _assert_same(getattr(together.state, name), getattr(apart.state, name))


def test_side_by_side_equals_one_after_another() -> None:
    many, apart = _navigator(3, 40), _navigator(3, 40)
    for k in range(1, 15):
        _assert_same(many.measure(_truth(k, 40)), _one_by_one(apart, _truth(k, 40)))


def test_a_rover_holds_what_the_station_said_in_the_last_message_it_received() -> None:
    """Three vehicles of an area, of which the second hears nothing from 2 to 6 s: its part of the station stands still.

    Whoever holds the same message has the same, and those with another one have another.
    """
    lost = Fault.model_validate({"kind": "corrections_loss", "start_s": 2.0, "duration_s": 4.0, "vehicle": 1})
    config = CONFIG.replace(corrections={"outage_per_h": 0.0})
    navigator = Navigator(config, TRACK, _mask(), [4, 5, 6], None, FaultSchedule((lost,)), 7)
    newest, held = [], []
    for k in range(1, 81):
        navigator.measure(_truth(k, 3))
        newest.append(navigator.state.corrections.links["newest"].copy())
        held.append(navigator.state.corrections.held.copy())
    assert [n[1] for n in newest[20:60]] == 40 * [1]
    for station in held[20:60]:
        np.testing.assert_array_equal(station[1], held[20][1])
    for message, station in zip(newest, held, strict=True):
        np.testing.assert_array_equal(station[0], station[2])
        assert np.array_equal(station[0], station[1]) == (message[0] == message[1])
    assert len({station[0].tobytes() for station in held[2:]}) == len({n[0] for n in newest[2:]}) == 8


def test_a_refused_truth_leaves_the_instruments_as_they_were() -> None:
    navigator, twin = _navigator([1, 2]), _navigator([1, 2])
    wrong = _truth(1, 2)
    wrong.velocity_enu_mps[1, 0] = np.nan
    with pytest.raises(ValueError, match="velocity_enu_mps must be finite"):
        navigator.measure(wrong)
    _assert_same(navigator.measure(_truth(1, 2)), twin.measure(_truth(1, 2)))


def test_measuring_an_epoch_twice_from_a_copy_gives_the_same_bits() -> None:
    navigator = _navigator([7], faults=FAULTS)
    for k in range(1, 25):
        navigator.measure(_truth(k, 1))
    twin = copy.deepcopy(navigator)
    for k in range(25, 45):
        _assert_same(navigator.measure(_truth(k, 1)), twin.measure(_truth(k, 1)))


def test_measurements_of_the_instruments_are_their_records_without_a_copy() -> None:
    m = _navigator([4, 5]).measure(_truth(1, 2))
    signals, vehicles = observed(m)
    assert m.given is not None
    assert (signals is m.given[0], vehicles is m.given[1]) == (True, True)
    m.gnss.code_m[1, 2, 0] = 7.0
    m.odometer.speed_mps[0] = -3.0
    assert (signals["code"][1, 2, 0], vehicles["speed"][0]) == (7.0, -3.0)


def test_measurements_of_ones_own_are_packed_as_they_now_are() -> None:
    navigator = _navigator([4, 5])
    m = [navigator.measure(_truth(k, 2)) for k in range(1, 4)][-1]
    whole = observed(m)
    cut = replace(m, gnss=replace(m.gnss, tracked=np.zeros_like(m.gnss.tracked), integer_error=None))
    late = copy.deepcopy(m)
    late.imu.delta_v_mps[:] = 5.0
    turned = replace(m, sky=replace(m.sky, index=np.array([0, 0])))
    for changed, differs in ((cut, {"tracked"}), (late, {"delta_v"}), (turned, set[str]())):
        found = {
            name
            for one, other in zip(whole, observed(changed), strict=True)
            for name in one.dtype.names or ()
            if not np.array_equal(one[name], other[name])
        }
        assert found == differs
    assert m.gnss.tracked.any()
    assert whole[0]["tracked"].any()
