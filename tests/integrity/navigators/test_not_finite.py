"""Measurements that are not finite: no kind of navigator gives a position or a level that is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.report_kernel import keep_finite
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.sensors.finite import with_finite

KINDS: dict[str, NavigatorConfig] = {
    "rtk": NavigatorConfig(),
    "spp": NavigatorConfig.preset("services/spp"),
    "ppp": NavigatorConfig.preset("services/ppp"),
    "filter": NavigatorConfig.load({"kind": "filter"}),
    "monitored_codes": NavigatorConfig.load({"kind": "monitored_codes"}),
}
SIGNALS = ("code_m", "phase_m", "range_rate_mps", "cn0_dbhz", "raw_code_m", "raw_phase_m")
BODY = (("imu", "delta_theta_rad"), ("imu", "delta_v_mps"), ("odometer", "speed_mps"), ("odometer", "distance_m"))
NOT_FINITE = st.sampled_from([np.nan, np.inf, -np.inf])
EPOCHS, BATCH = 45, 2


@cache
def _begun(kind: str) -> tuple[Navigator, Any]:
    """A navigator after some epochs, and its state."""
    navigator = Navigator.nominal(KINDS[kind], seeds=[1, 2], duration_s=30.0)
    navigator.place(np.zeros((BATCH, 2)), np.zeros(BATCH), 0.05, 0.01)
    for k in range(30):
        navigator.step(_truth(k))
    return navigator, navigator.snapshot()


def _truth(k: int) -> Truth:
    velocity, still = np.tile([0.0, 10.0], (BATCH, 1)), np.zeros(BATCH)
    places = tuple(np.tile([0.0, float(n)], (BATCH, 1)) for n in (k, k + 1))
    return truth_between(0.1 * (k + 1), 0.1, places, (velocity, velocity), (still, still))  # type: ignore[arg-type]


def _drive(kind: str, spoil: Any) -> list[Solution]:
    navigator, state = _begun(kind)
    navigator.restore(state)
    found = []
    for k in range(30, EPOCHS):
        found.append(navigator.locate(spoil(navigator.measure(_truth(k)), k)))
    return found


@pytest.mark.parametrize("kind", KINDS)
@given(field=st.sampled_from(SIGNALS), value=NOT_FINITE, satellites=st.sets(st.integers(0, 33), min_size=1),
       from_epoch=st.integers(30, 40))  # fmt: skip
@settings(max_examples=6, deadline=None)
def test_a_signal_that_is_not_finite_counts_as_not_tracked(
    kind: str, field: str, value: float, satellites: set[int], from_epoch: int
) -> None:
    rows = sorted(satellites)

    def spoil(m: Measurements, k: int) -> Measurements:
        values = getattr(m.gnss, field)
        if k < from_epoch or values is None:
            return m
        values = values.copy()
        values[0, rows] = value
        return replace(m, gnss=replace(m.gnss, **{field: values}))

    def mask(m: Measurements, k: int) -> Measurements:
        if k < from_epoch or getattr(m.gnss, field) is None:
            return m
        g = {
            name: np.copy(getattr(m.gnss, name)) for name in (*SIGNALS, "tracked") if getattr(m.gnss, name) is not None
        }
        for x in g.values():
            x[0, rows] = 0
        return replace(m, gnss=replace(m.gnss, **g))

    for spoilt, masked in zip(_drive(kind, spoil), _drive(kind, mask), strict=True):
        assert np.isfinite(spoilt.position_en_m).all()
        assert not np.isnan(spoilt.pl_cases_m).any()
        np.testing.assert_array_equal(spoilt.position_en_m, masked.position_en_m)
        np.testing.assert_array_equal(spoilt.pl_cases_m, masked.pl_cases_m)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("sensor", "field"), BODY)
def test_gyros_accelerometers_and_wheels_that_are_not_finite_are_refused(kind: str, sensor: str, field: str) -> None:
    def spoil(m: Measurements, k: int) -> Measurements:
        values = getattr(getattr(m, sensor), field).copy()
        values[1] = np.nan
        return replace(m, **{sensor: replace(getattr(m, sensor), **{field: values})})

    with pytest.raises(InputError, match=rf"m\.{sensor}\.{field} must be finite, got nan for vehicle 1"):
        _drive(kind, spoil)


def test_corrections_that_are_not_finite_take_their_satellite_out_of_use() -> None:
    for kind in ("ppp", "sbas_filter"):
        if kind == "ppp":
            navigator = Navigator.nominal(KINDS["ppp"], seeds=[1, 2], duration_s=30.0)
        else:
            navigator = Navigator.nominal(NavigatorConfig.preset("navigators/imm_sbas"), seeds=[1, 2], duration_s=30.0)
        navigator.place(np.zeros((BATCH, 2)), np.zeros(BATCH), 10.0, 0.01)
        for k in range(30):
            m = navigator.measure(_truth(k))
            held = m.gnss.corrections
            assert held is not None
            for one in held.values():
                one.satellite_m[0, 0::3] = np.nan
            solution = navigator.locate(m)
            assert np.isfinite(solution.position_en_m).all(), kind
            assert not np.isnan(solution.pl_cases_m).any(), kind


def test_satellites_without_a_finite_direction_are_untracked_and_an_age_without_a_value_is_infinite() -> None:
    navigator, state = _begun("rtk")
    navigator.restore(state)
    m = navigator.measure(_truth(30))
    los, age = m.sky.los_enu.copy(), m.gnss.corrections_age_s.copy()
    los[0, 3], age[1] = np.nan, np.nan
    found = with_finite(replace(m, sky=replace(m.sky, los_enu=los), gnss=replace(m.gnss, corrections_age_s=age)))
    assert not found.gnss.tracked[:, 3].any()
    assert found.gnss.corrections_age_s[1] == np.inf
    assert np.isfinite(found.sky.los_enu).all()
    assert found.gnss.tracked[:, 4:].sum() == m.gnss.tracked[:, 4:].sum()


def test_finite_measurements_are_handed_on_as_they_are() -> None:
    navigator, state = _begun("spp")
    navigator.restore(state)
    m = navigator.measure(_truth(30))
    assert with_finite(m) is m


def test_a_position_that_is_not_finite_has_no_level() -> None:
    """The last gate, for stages from outside."""
    navigator, state = _begun("rtk")
    navigator.restore(state)
    vehicles = navigator.state.belief.vehicles
    assert keep_finite(vehicles[0], np.zeros((1, 2)))
    vehicles["position"][0, 0] = np.nan
    levels = np.full((1, 2), 0.05)
    assert not keep_finite(vehicles[0], levels)
    assert np.isinf(levels).all()
    assert np.isfinite(vehicles["position"]).all()
    vehicles["heading"]["angle"][1] = np.nan
    solution = navigator.locate(navigator.measure(_truth(30)))
    assert np.isfinite(solution.position_en_m).all()
    assert solution.pl_at_m[1] == np.inf
    assert not solution.available[1]
