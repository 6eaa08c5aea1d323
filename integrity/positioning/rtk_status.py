"""Why RTK holds at an epoch, or why not."""

from __future__ import annotations

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.positioning import codes_kernel as codes

__all__ = ["RtkStatus"]


class RtkStatus(Advice):
    """Outcome of one RTK epoch; ``code`` is what arrays carry."""

    FIXED = codes.FIXED, "ambiguities fixed and the fixed position passed its tests"
    NO_CORRECTIONS = codes.NO_CORRECTIONS, "the reference data are missing or too old: wait for the link"
    TOO_FEW = codes.TOO_FEW, "too few satellites with carrier lock: wait for a better view of the sky"
    NOT_CONVERGED = codes.NOT_CONVERGED, "the risk of a wrong fix is above its limit: wait for more satellites"
    RATIO_FAILED = codes.RATIO_FAILED, "the second best integers fit nearly as well: wait for the next epoch"
    FAULT = codes.FAULT, "the fixed position failed its fault test: wait for the next epoch"
    SEARCH_FAILED = codes.SEARCH_FAILED, "the integer search did not finish: the float solution is too loose"
