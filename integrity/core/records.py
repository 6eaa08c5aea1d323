"""Named records: structured arrays in which kernels keep many scalars of a vehicle, an environment or a lane.

>>> POSE = record(east_m="position, East", north_m="position, North", laps=("i8", "rounds driven"))
>>> poses = np.zeros(3, POSE)                  # a row for each of three vehicles
>>> poses["east_m"] = 1.0, 2.0, 3.0            # outside of kernels: an array for each field
>>> one_record(POSE, east_m=1.0, north_m=2.0, laps=0)["north_m"]
array([2.])

Inside a kernel ``pose = poses[v]`` is a record whose fields are attributes (``pose.east_m += 1.0``); it refers to the
array and is passed on as one pointer. Arrays of several axes travel in a NamedTuple beside them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["Records", "one_record", "record"]

Records = NDArray[np.void]
"""A structured array."""
Field = str | tuple[Any, str] | tuple[Any, tuple[int, ...], str]


def record(**fields: Field) -> np.dtype[np.void]:
    """The type of a record from its fields, in their order.

    A field is what it means (a float64); or its type and meaning; or type, shape and meaning. The type of a field may
    be that of another record.
    """
    return np.dtype([(name, *_kind(field)) for name, field in fields.items()], align=True)


def _kind(field: Field) -> tuple[Any, ...]:
    return (np.float64,) if isinstance(field, str) else tuple(field[:-1])


def one_record(kind: DTypeLike, **values: Any) -> Records:
    """An array (1,) of one record: a kernel's parameters.

    Raises
    ------
    TypeError
        A field is left out, or there is none of that name.
    """
    out = np.zeros(1, kind)
    names = set(out.dtype.names or ())
    if names != set(values):
        raise TypeError(f"values must be given for {sorted(names)}, got {sorted(values)}")
    for name, value in values.items():
        out[name] = value
    return out
