"""NamedTuples of many arrays that are passed to kernels by one address.

An array argument of a kernel costs 0.1 to 0.3 us; the arrays of an environment would cost more than one of its steps. A
:class:`Bundle` writes a NamedTuple of arrays (and of such NamedTuples) once in the memory layout of kernels, and passes
its address:

>>> bundle = Bundle(POSES)              # POSES: a NamedTuple of arrays
>>> kernel(0, 3, bundle.handle)         # in the kernel: poses = unbundle(handle)

The name of the only field of the handle contains a digest of the types, so that a kernel is compiled separately for
different types. The bundle refers to the arrays and holds references to them. The arrays must not move; a replaced
array needs a new bundle.
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.kernel_dispatcher import kernel_of
from lanebound.integrity.core.records import Records

__all__ = ["Bundle", "RowCopier", "is_ours", "unbundle"]

_types: dict[str, Any] = {}
_sizes: dict[str, int] = {}
_intrinsic: Callable[[Any], Any] = intrinsic


class Bundle:
    """A NamedTuple of arrays for kernels; a copy or pickle is a bundle of copied arrays.

    Parameters
    ----------
    values : a NamedTuple of arrays, numbers and such NamedTuples
    """

    def __init__(self, values: Any) -> None:
        self.values = values
        self._handle: Records | None = None

    @property
    def handle(self) -> Records:
        """The argument for kernels."""
        if self._handle is None:
            self._handle = _written(self.values)
        return self._handle

    def __getstate__(self) -> dict[str, Any]:
        """The state without the addresses."""
        return {"values": self.values, "_handle": None}


class RowCopier:
    """Copies rows of many arrays to the same rows of other arrays in one call.

    Parameters
    ----------
    arrays : contiguous arrays with one row for each of N environments; they must not move in memory
    """

    def __init__(self, arrays: tuple[NDArray[Any], ...]) -> None:
        self.arrays = arrays
        self._places: NDArray[np.int64] | None = None

    @property
    def places(self) -> NDArray[np.int64]:
        """(n, 2) address of each array, and size of a row in bytes."""
        if self._places is None:
            self._places = np.array([(a.ctypes.data, a.nbytes // len(a)) for a in self.arrays], dtype=np.int64)
        return self._places

    def copy(self, rows: NDArray[np.int64], other: RowCopier) -> None:
        """Copy the rows of the arrays of ``other``, which have the same types and shapes."""
        _copy_rows(self.places, other.places, rows)

    def __getstate__(self) -> dict[str, Any]:
        """The state without the addresses."""
        return {"arrays": self.arrays, "_places": None}


def _written(values: Any) -> Records:
    """The values in the memory layout of kernels."""
    kind = numba.typeof(values)
    name = f"b{hashlib.blake2b(str(kind).encode(), digest_size=12).hexdigest()}"
    if name not in _types:
        _types[name] = kind
    write = _write if is_ours(kind) else _write_uncached
    if name not in _sizes:
        context = cpu_target.target_context
        _sizes[name] = int(context.get_abi_sizeof(context.get_data_type(kind)))
    handle = np.zeros(1, np.dtype([(name, np.int64, (-(-_sizes[name] // 8),))]))
    write(values, handle)
    return handle


def is_ours(kind: Any) -> bool:
    """Whether every process can load cached kernels for a type: the NamedTuples in it are importable from lanebound.

    One kernel in the cache with a class of a script or test would keep all others from loading.
    """
    parts = getattr(kind, "types", ())
    named = getattr(kind, "instance_class", None)
    return (named is None or str(named.__module__).startswith("lanebound.")) and all(map(is_ours, parts))


def _kind_of(handle: Any) -> Any:
    """The Numba type of the values behind a handle."""
    return _types[next(iter(handle.dtype.fields))]


@_intrinsic
def _store(typingctx: Any, values: Any, handle: Any) -> Any:
    """Write a value to the address of a handle."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = context.make_array(handle)(context, builder, args[1]).data
        pointer = builder.bitcast(place, context.get_data_type(values).as_pointer())
        context.pack_value(builder, values, args[0], pointer)
        return context.get_dummy_value()

    return types.void(values, handle), codegen


@_intrinsic
def unbundle(typingctx: Any, handle: Any) -> Any:
    """The NamedTuple that a handle refers to, inside a kernel."""
    kind = _kind_of(handle)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = context.make_array(handle)(context, builder, args[0]).data
        pointer = builder.bitcast(place, context.get_data_type(kind).as_pointer())
        return context.unpack_value(builder, kind, pointer)

    return kind(handle), codegen


@_intrinsic
def _copy(typingctx: Any, target: Any, source: Any, size: Any) -> Any:
    """Copy bytes from one address to another."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        to, of = builder.inttoptr(args[0], pointer), builder.inttoptr(args[1], pointer)
        cgutils.raw_memcpy(builder, to, of, args[2], 1)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


@jit(borrows=True)
def _copy_rows(targets, sources, rows):  # type: ignore[no-untyped-def]
    for n in range(targets.shape[0]):
        size = targets[n, 1]
        for e in rows:
            _copy(targets[n, 0] + e * size, sources[n, 0] + e * size, size)


@jit(borrows=True)
def _write(values, handle):  # type: ignore[no-untyped-def]
    _store(values, handle)


_write_uncached = kernel_of(_write.py_func, error_model="numpy", nogil=True, _nrt=False)
