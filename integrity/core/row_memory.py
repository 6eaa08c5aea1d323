"""What lasts in monitors and matchers from epoch to epoch: named arrays with the vehicles as first axis.

A navigator keeps them with its own state, so that snapshots and new episodes of single vehicles include them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["EVERY", "Memory", "Rows"]

Memory = dict[str, NDArray[Any]]
Rows = NDArray[np.int64] | slice
EVERY = slice(None)
"""All vehicles."""
