"""Hand-made records of satellites, signals and rows, for tests of kernels that take them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.records import Records
from lanebound.integrity.positioning.rows_kernel import ROW

__all__ = ["records_of", "rows_of"]


def records_of(kind: Any, count: int, **fields: Any) -> Records:
    """``count`` records of a kind, of zeros but for some fields, each a value of all or a column."""
    out = np.zeros(count, kind)
    for name, values in fields.items():
        out[name] = values
    return out


def rows_of(e: Any, group: Any, used: Any, variance: Any = 1.0, y: Any = 0.0, system: Any = None) -> Records:
    """Rows (S,) of lines of sight e (S, 3); each group is a system where no ``system`` (S,) is given."""
    return records_of(
        ROW, len(e), e=e, group=group, system=group if system is None else system, variance=variance, y=y, used=used
    )
