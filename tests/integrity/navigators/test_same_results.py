"""What the navigator computes is what it computed when the digest was written, with every kind of fault."""

from __future__ import annotations

import json

import frozen
import numpy as np

from lanebound.integrity.sensors.fault_registry import BUILT_IN

RENEW = (
    "the navigator computes other results than before. If a change of results was not meant, find it by "
    "'python tests/helpers/frozen.py save' before and 'compare' after. If it was, renew the digest by "
    "'python tests/helpers/frozen.py digest' and say in the commit what changed and why"
)
CLOSE = 1e-5  # of the largest number of a field: rounding of another processor or BLAS is smaller


def test_every_kind_of_fault_is_in_it() -> None:
    assert {kind.name for _, kind in frozen._struck()} == set(BUILT_IN)


def test_results_are_those_of_the_digest() -> None:
    """1,200 vehicle-epochs; a number for each field and vehicle."""
    kept, found = json.loads(frozen.DIGEST.read_text()), frozen.digest()
    assert set(found) == set(kept), RENEW
    changed = {
        name: np.flatnonzero(~np.isclose(found[name], kept[name], rtol=CLOSE, atol=CLOSE * np.abs(kept[name]).max()))
        for name in kept
    }
    differing = {name: rows.tolist() for name, rows in changed.items() if rows.size}
    assert not differing, f"vehicles by field: {differing}: {RENEW}"
