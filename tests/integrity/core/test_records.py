"""Records are structured arrays whose fields kernels read and write by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import one_record, record

DOUBT = record(left_s="time left [s]", stage=("i8", "what is going on"))
CAR = record(
    east_m="position", doubt=(DOUBT, "of its position"), alert=("?", "is on"), variance=("f8", (3,), "of a velocity")
)
PARAMETERS = record(dt_s="length of an epoch [s]")


@jit
def advance(first: int, last: int, cars: Any, parameters: Any) -> None:
    par = parameters[0]
    for v in range(first, last):
        car = cars[v]
        car.east_m += par.dt_s
        car.alert = car.east_m > 0.35
        _count(car.doubt, par.dt_s)
        for i in range(3):
            car.variance[i] += i


@jit
def _count(doubt: Any, dt: float) -> None:
    doubt.left_s -= dt
    doubt.stage += 1


def test_a_kernel_reads_and_writes_fields_and_records_in_records() -> None:
    cars = np.zeros(4, CAR)
    cars["east_m"] = [0.1, 0.2, 0.3, 0.4]
    advance(1, 3, cars, one_record(PARAMETERS, dt_s=0.1))
    np.testing.assert_allclose(cars["east_m"], [0.1, 0.3, 0.4, 0.4])
    assert cars["alert"].tolist() == [False, False, True, False]
    assert cars["doubt"]["stage"].tolist() == [0, 1, 1, 0]
    np.testing.assert_allclose(cars["doubt"]["left_s"], [0.0, -0.1, -0.1, 0.0])
    assert cars["variance"].tolist() == [[0.0] * 3, [0.0, 1.0, 2.0], [0.0, 1.0, 2.0], [0.0] * 3]


def test_parameters_must_be_complete() -> None:
    for values in ({}, {"dt_s": 1.0, "dt": 1.0}):
        with pytest.raises(TypeError, match="dt_s"):
            one_record(PARAMETERS, **values)
