"""A lasting bundle is made once, and again where an owner of its arrays is replaced."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.lasting import LastingBundle


class One(NamedTuple):
    """An array."""

    a: Any


def test_a_bundle_lasts_until_an_owner_is_replaced() -> None:
    owners, lasting = (np.zeros(2), np.zeros(3)), LastingBundle()
    first = lasting.of(owners, lambda: One(owners[0]))
    assert lasting.of(owners, lambda: One(np.ones(2))) is first
    other = owners[0], np.zeros(3)
    second = lasting.of(other, lambda: One(other[1]))
    assert second is not first
    assert second.values.a is other[1]


def test_a_copy_holds_nothing() -> None:
    owner, lasting = np.zeros(2), LastingBundle()
    first = lasting.of((owner,), lambda: One(owner))
    again = copy.deepcopy(lasting)
    assert again.of((owner,), lambda: One(owner)) is not first
    assert lasting.of((owner,), lambda: One(owner)) is first
