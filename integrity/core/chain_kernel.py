"""A chain of kernels that run one after another over the same rows, at the cost of one call from Python.

A call of a kernel from Python costs about 3 us for a NamedTuple of 20 arrays. A :class:`Chain` needs one such call: a
small compiled function calls the kernels by their addresses. Each kernel is compiled separately; a chain therefore adds
no compile time.
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import groupby
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.extending import intrinsic

from lanebound.integrity.core.accel import jit

__all__ = ["Chain"]


@intrinsic
def _call_at(typingctx: Any, address: Any, first: Any, last: Any, data: Any) -> Any:
    """Call the kernel ``kernel(first, last, data)`` whose machine code starts at ``address``."""
    taken = (types.int64, types.int64, data)

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        convention = context.call_conv
        function_type = convention.get_function_type(types.none, taken)
        function = builder.inttoptr(args[0], function_type.as_pointer())
        status, _ = convention.call_function(builder, function, types.none, taken, args[1:])
        with builder.if_then(status.is_error, likely=False):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.void(types.uintp, *taken), emit


def _run(addresses, first, last, data):  # type: ignore[no-untyped-def]
    for i in range(addresses.shape[0]):
        _call_at(addresses[i], first, last, data)  # type: ignore[call-arg]


class Chain:
    """Kernels with the signature ``kernel(first, last, data)``, called in order as one kernel.

    Parameters
    ----------
    stages : functions compiled by :func:`~lanebound.integrity.core.accel.jit`, or Python functions of the same
        signature, which are called from Python
    """

    def __init__(self, *stages: Callable[..., Any]) -> None:
        self._stages = stages
        parts = groupby(stages, key=lambda stage: hasattr(stage, "py_func"))
        self._parts = [p for compiled, group in parts for p in ([_Compiled(tuple(group))] if compiled else [*group])]

    def __call__(self, first: int, last: int, data: Any) -> None:
        for part in self._parts:
            part(first, last, data)

    def __reduce__(self) -> tuple[Any, ...]:
        return Chain, self._stages


class _Compiled:
    """Kernels called by one compiled function for each type of data."""

    def __init__(self, kernels: tuple[Any, ...]) -> None:
        self._kernels, self._lock = kernels, threading.Lock()
        self._bound: dict[Any, tuple[Any, np.ndarray[Any, Any]]] = {}
        self._latest: tuple[Any, np.ndarray[Any, Any]] | None = None

    def __call__(self, first: int, last: int, data: Any) -> None:
        latest = self._latest
        if latest is not None:
            driver, addresses = latest
            try:
                driver(addresses, first, last, data)
            except TypeError:  # the driver refuses data of another type
                if numba.typeof(data) in self._bound and self._bound[numba.typeof(data)] is latest:
                    raise
            else:
                return
        with self._lock:
            driver, addresses = self._latest = self._for(data)
        driver(addresses, first, last, data)

    def _for(self, data: Any) -> tuple[Any, np.ndarray[Any, Any]]:
        """The compiled function and the addresses of the kernels for data of this type."""
        kind = numba.typeof(data)
        found = self._bound.get(kind)
        if found is None:
            addresses = np.array([_address(kernel, (types.int64, types.int64, kind)) for kernel in self._kernels])
            driver = jit(_run) if _is_ours(kind) else numba.njit(error_model="numpy", nogil=True)(_run)
            driver.compile((numba.typeof(addresses), types.int64, types.int64, kind))
            driver.disable_compile()
            found = self._bound[kind] = driver, addresses
        return found


def _is_ours(kind: Any) -> bool:
    """Whether every process can load a cached function of this type: its class is importable as part of lanebound."""
    return bool(getattr(kind, "instance_class", object).__module__.startswith("lanebound."))


def _address(kernel: Any, signature: tuple[Any, ...]) -> np.uintp:
    """Address of the machine code of a kernel for a signature; the kernel is compiled if necessary."""
    kernel.compile(signature)
    compiled = kernel.overloads[signature]
    return np.uintp(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
