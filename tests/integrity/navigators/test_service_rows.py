"""The variance of a corrected L1 range against hand computation."""

from __future__ import annotations

import numpy as np
import pytest
from signal_records import records_of

from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.navigator import blank_epoch, blank_state
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters, epoch_tables
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import FIXED_SOLUTION
from lanebound.integrity.navigators.services.code_kernel import fill_vehicle
from lanebound.integrity.navigators.services.fix_kernel import offer
from lanebound.integrity.navigators.services.records_kernel import (
    PART,
    SERVICE_INPUT,
    SERVICE_LABEL,
    SERVICE_RULES,
    SERVICE_SATELLITE,
    SERVICE_SIGNAL,
    SERVICE_WORK,
    ServiceInputs,
    ServiceRows,
    ServiceState,
    ServiceTables,
)
from lanebound.integrity.navigators.services.zenith_kernel import CARRIER_RULES, ZENITH, CarrierTables
from lanebound.integrity.positioning.code_errors_kernel import CODE_ERRORS
from lanebound.integrity.positioning.codes_kernel import FIXED, NO_CORRECTIONS
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.smoothing_kernel import HATCH
from lanebound.integrity.sensors.broadcast import obliquity


def _budget() -> Records:
    """Code 1 m, ionosphere growing by 0.01 m^2/s, troposphere 0.2 m."""
    return one_record(
        CODE_ERRORS, noise=1.0, multipath=0.0, phase=0.1, knee=35.0, moving_tau=10.0, rest_tau=300.0, satellite=0.0,
        satellite_growth=0.0, iono=0.0, iono_common=0.8, iono_growth=0.01, iono_rate=0.0,
        length=20.0, tropo=0.2,
    )  # fmt: skip


def _variance(declared: float, age: float) -> float:
    """Of a satellite at 30 degrees: code 1 m, satellite 0.5 m, troposphere 0.2 m, growth 0.01 m^2/s."""
    config = NavigatorConfig()
    parameters, tables = epoch_parameters(config), epoch_tables(config, np.zeros(1, np.int64))
    state = blank_state(1, 1, tables.prior.size, len(config.cases), config.positioning.rtk)
    epoch = blank_epoch(parameters, tables, state)
    epoch.signals["e"], epoch.signals["tracked"], epoch.signals["cn0"] = [0.75**0.5, 0.0, 0.5], True, 45.0
    epoch.observed["speed"], epoch.marks["quality"] = 10.0, 1.0
    rules = records_of(
        SERVICE_RULES, 1, errors=_budget(), smoothing=0.0, combined=False, sin_mask=0.1, cn0_min=30.0, max_age=30.0,
        zenith_max_age=600.0,
    )  # fmt: skip
    satellites = records_of(SERVICE_SATELLITE, 1, share=[1.0, 0.0], noise=1.0, allowed=True)
    service = ServiceTables(rules, parameters, tables, satellites, np.zeros(0, np.int64))
    signals = np.zeros((1, 1), SERVICE_SIGNAL)
    signals["code"], signals["phase"], signals["declared"] = 1.0, 1.0, 0.5
    inputs = ServiceInputs(signals, records_of(SERVICE_INPUT, 1, zenith_declared=declared, zenith_age=age))
    rows = np.zeros((1, 1), ROW)
    ranges = ServiceRows(rows, np.zeros((1, 1), PART), np.zeros(1, SERVICE_WORK), np.zeros(1, SERVICE_LABEL))
    carrier = CarrierTables(np.zeros(1, CARRIER_RULES), np.zeros(1, ZENITH))
    hatch = ServiceState(np.zeros((1, 1), HATCH), np.zeros(1))
    assert fill_vehicle(0, epoch, service, inputs, hatch, ranges, carrier) == 1
    return float(rows["variance"][0, 0])


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
