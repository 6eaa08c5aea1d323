"""Why RTK holds at an epoch, or why not."""

from __future__ import annotations

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.positioning import status_kernel as code

__all__ = ["RtkStatus"]


class RtkStatus(Advice):
    """Outcome of one RTK epoch; ``code`` is what arrays carry."""

    FIXED = code.FIXED, "ambiguities fixed and the fixed position passed its tests"
    NO_CORRECTIONS = code.NO_CORRECTIONS, "the reference data are missing or too old: wait for the link"
    TOO_FEW = code.TOO_FEW, "too few satellites with carrier lock: wait for a better view of the sky"
    NOT_CONVERGED = code.NOT_CONVERGED, "the risk of a wrong fix is above its limit: wait for more satellites"
    RATIO_FAILED = code.RATIO_FAILED, "the second best integers fit nearly as well: wait for the next epoch"
    FAULT = code.FAULT, "the fixed position failed its fault test: the ambiguities are on trial"
    SEARCH_FAILED = code.SEARCH_FAILED, "the integer search did not finish: the float solution is too loose"
