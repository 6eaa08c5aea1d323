"""Named records: structured arrays with many scalars of a vehicle, an environment or a lane for kernels.

>>> POSE = record(east_m="position, East", north_m="position, North", laps=("i8", "rounds driven"))
>>> poses = np.zeros(3, POSE)                  # one row for each of three vehicles
>>> poses["east_m"] = 1.0, 2.0, 3.0            # outside of kernels: one array for each field
>>> one_record(POSE, east_m=1.0, north_m=2.0, laps=0)["north_m"]
array([2.])

Inside a kernel ``pose = poses[v]`` is a record whose fields are attributes (``pose.east_m += 1.0``). It refers to the
array and is passed as one pointer. Arrays of several axes are passed in a separate NamedTuple.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["Records", "blocks", "copied", "one_record", "packed", "record"]

Records = NDArray[np.void]
"""A structured array."""
Field = str | tuple[Any, str] | tuple[Any, tuple[int, ...], str]


def record(**fields: Field) -> np.dtype[np.void]:
    """Declare the type of a record from its fields, in order.

    A field is given as its meaning (for a float64), as (type, meaning), or as (type, shape, meaning). The type of a
    field can be another record.
    """
    return np.dtype([(name, *_kind(field)) for name, field in fields.items()], align=True)


def _kind(field: Field) -> tuple[Any, ...]:
    return (np.float64,) if isinstance(field, str) else tuple(field[:-1])


def one_record(kind: DTypeLike, **values: Any) -> Records:
    """Build an array (1,) of one record, for example the parameters of a kernel.

    Raises
    ------
    TypeError
        A field is missing or unknown.
    """
    out = np.zeros(1, kind)
    names = set(out.dtype.names or ())
    if names != set(values):
        raise TypeError(f"values must be given for {sorted(names)}, got {sorted(values)}")
    for name, value in values.items():
        out[name] = value
    return out


def copied(records: Records) -> Records:
    """A copy."""
    return blocks(records).copy().view(records.dtype)


def blocks(records: Records) -> NDArray[np.void]:
    """The records as blocks of bytes, which NumPy copies at once; it copies records field by field."""
    return records.view(np.dtype((np.void, records.dtype.itemsize)))


def packed(kind: np.dtype[np.void], given: Records | None, **arrays: NDArray[Any]) -> Records:
    """The records with these arrays as fields: ``given``, where the arrays are its fields, else a packed copy."""
    if given is not None and all(array.base is given for array in arrays.values()):
        return given
    name, first = next(iter(arrays.items()))
    out = np.zeros(first.shape[: first.ndim - kind[name].ndim], kind)
    for name, array in arrays.items():
        out[name] = array
    return out
