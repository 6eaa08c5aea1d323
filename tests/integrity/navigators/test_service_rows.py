"""The variance of a corrected L1 range against hand computation."""

from __future__ import annotations

from types import SimpleNamespace as Of

import numpy as np
import pytest

from lanebound.integrity.core.records import one_record
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import FIXED_SOLUTION
from lanebound.integrity.navigators.services import code_kernel
from lanebound.integrity.navigators.services.fix_kernel import offer
from lanebound.integrity.positioning.code_errors_kernel import CODE_ERRORS
from lanebound.integrity.positioning.codes_kernel import FIXED, NO_CORRECTIONS
from lanebound.integrity.positioning.reflection_odds_kernel import REFLECTION_RULES
from lanebound.integrity.sensors.broadcast import obliquity


def _budget() -> np.record:
    """Code 1 m, ionosphere growing by 0.01 m^2/s, troposphere 0.2 m."""
    return one_record(
        CODE_ERRORS, noise=1.0, multipath=0.0, phase=0.1, knee=35.0, moving_tau=10.0, rest_tau=300.0, satellite=0.0,
        satellite_growth=0.0, iono=0.0, iono_common=0.8, iono_growth=0.01, iono_rate=0.0,
        length=20.0, tropo=0.2,
    ).view(np.recarray)[0]  # fmt: skip


def _variance(declared: float, age: float) -> float:
    """Of a satellite at 30 degrees: code 1 m, satellite 0.5 m, troposphere 0.2 m, growth 0.01 m^2/s."""
    rules = Of(errors=_budget(), smoothing=0.0, combined=False, sin_mask=0.1, cn0_min=30.0, max_age=30.0,
               zenith_max_age=600.0)  # fmt: skip
    reflections = one_record(
        REFLECTION_RULES, sets=0, horizon=40.0, zenith=45.0, most=0.1, centre=4.0, scale=1.0, single=0.5, limit=0.0
    ).view(np.recarray)[0]
    parameters = Of(rtk=Of(reflections=reflections), risk=Of(satellite_prior=[1e-5]), dt=0.1,
                    odometer=Of(still_speed=0.1))  # fmt: skip
    service = Of(rules=[rules], parameters=[parameters], share=np.array([[1.0, 0.0]]), noise=[1.0],
                 allowed=np.array([True]), tables=Of(system=[0]))  # fmt: skip
    measured = Of(los=np.array([[[0.75**0.5, 0.0, 0.5]]]), speed=[10.0],
                  sight=[0], tracked=np.array([[True]]), cn0=np.array([[45.0]]),
                  lock_lost=np.array([[False]]))  # fmt: skip
    epoch, one = Of(measured=measured, work=Of(quality=np.array([[1.0]]))), np.zeros((1, 1))
    inputs = Of(code=np.ones((1, 1, 2)), phase=np.ones((1, 1, 2)), satellite=one, zenith=one, declared=np.array([0.5]),
                zenith_declared=declared, age=[0.0], zenith_age=[age])  # fmt: skip
    hatch = np.zeros((1, 1), [("count", "f8"), ("free", "f8")])
    ranges = Of(y=one.copy(), variance=one.copy(), fast=one.copy(), odds=one.copy(), used=np.array([[False]]))
    carrier = Of(rules=[Of(zenith=False)])
    fill = getattr(code_kernel.fill_vehicle, "py_func", code_kernel.fill_vehicle)
    assert fill(0, epoch, service, inputs, Of(hatch=hatch), ranges, carrier) == 1
    return float(ranges.variance[0, 0])


def test_the_declared_ionosphere_and_its_age_are_in_the_variance() -> None:
    slant = float(obliquity(np.array(0.5))) ** 2
    own = 1.0 + 0.5**2 + 0.2**2 * (1.001 / np.sqrt(0.252001) - 1.0) ** 2
    assert _variance(0.0, 0.0) == pytest.approx(own, rel=1e-9)
    assert _variance(0.912, 0.0) == pytest.approx(own + slant * 0.912**2, rel=1e-9)  # GIVEI 9
    assert _variance(0.0, 20.0) == pytest.approx(own + slant * 0.2, rel=1e-9)  # DGPS, its declared figure is 0
    assert _variance(0.912, 1000.0) == pytest.approx(own + slant * (0.912**2 + 6.0), rel=1e-9)


def test_nothing_of_a_failed_rtk_attempt_counts_for_the_position_of_a_service() -> None:
    fixed = np.zeros(1, FIXED_SOLUTION)[0]
    fixed["status"], fixed["coded"], fixed["lasting"], fixed["wrong"] = FIXED, True, True, 0.5
    found = np.zeros(1, FIXED_SOLUTION)[0]
    found["position"], found["p_ee"] = [1.0, 2.0, 3.0], 4.0
    offer(fixed, found, 7, 1, 1.5)
    assert fixed["usable"]
    assert not fixed["lasting"]
    assert not fixed["coded"]
    assert (fixed["wrong"], fixed["status"]) == (0.0, NO_CORRECTIONS)
    assert (fixed["position"].tolist(), fixed["p_ee"], fixed["satellites"]) == ([1.0, 2.0, 3.0], 4.0, 7)
