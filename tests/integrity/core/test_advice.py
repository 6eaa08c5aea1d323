"""Codes of outcomes and their texts."""

from __future__ import annotations

import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.alerts import AlertReason


def test_a_reason_is_read_from_its_code_by_a_call():
    assert AlertReason(AlertReason.NO_SOLUTION.code) is AlertReason.NO_SOLUTION
    assert [AlertReason(member.code).value for member in AlertReason] == [member.value for member in AlertReason]


def test_a_code_without_a_reason_is_refused_with_those_that_have_one():
    with pytest.raises(InputError, match=r"AlertReason code must be one of \(0 NONE, 1 PL_AT.*got 99: use a code"):
        AlertReason(99)
