"""Why RTK holds at an epoch, or why not."""

from __future__ import annotations

from lanebound.integrity.core.advice import Advice

__all__ = ["RtkStatus"]


class RtkStatus(Advice):
    """Outcome of one RTK epoch; ``code`` is what arrays carry."""

    FIXED = 0, "ambiguities fixed and the fixed position passed its tests"
    NO_CORRECTIONS = 1, "the reference data are missing or too old: wait for the link"
    TOO_FEW = 2, "too few satellites with carrier lock: wait for a better view of the sky"
    NOT_CONVERGED = 3, "the risk of a wrong fix is above its limit: wait for more satellites"
    RATIO_FAILED = 4, "the second best integers fit nearly as well: wait for the next epoch"
    FAULT = 5, "the fixed position failed its fault test: the ambiguities are on trial"
    SEARCH_FAILED = 6, "the integer search did not finish: the float solution is too loose"
