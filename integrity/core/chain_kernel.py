"""A chain of kernels that run one after another over the same rows, at the cost of one call from Python.

A chain is itself a kernel for :func:`~lanebound.integrity.core.accel.run_rows`. All its kernels take the same data;
kernels with arguments of their own are called by :func:`~lanebound.integrity.core.accel.call_links` instead.

To hand an array to a kernel costs 0.1 to 0.3 us. A :class:`Chain` takes the arrays that last as a bundle, which is one
argument, and the arrays of the epoch as a NamedTuple; a small compiled function joins both and calls the kernels by
their addresses. The kernels stay compiled by themselves, so that a chain of any length costs no compile time.
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.extending import intrinsic

from lanebound.integrity.core.accel import FASTMATH, jit
from lanebound.integrity.core.bundle_kernel import Bundle, is_ours, unbundle
from lanebound.integrity.core.compile_ahead import Ahead
from lanebound.integrity.core.kernel_dispatcher import address_of, kernel_of

__all__ = ["Chain"]

_intrinsic: Callable[[Any], Any] = intrinsic
_wholes: dict[type, type] = {}
_ahead: dict[tuple[Any, ...], tuple[Any, Ahead]] = {}
_kept: list[Any] = []  # kernels whose machine code is called by address
IN_MEMORY: dict[str, Any] = {"error_model": "numpy", "fastmath": FASTMATH, "nogil": True}
BORROWING: dict[str, Any] = {**IN_MEMORY, "_nrt": False}
"""Options of kernels with types of a script or test, which must not come into the cache."""


@_intrinsic
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


@_intrinsic
def _joined(typingctx: Any, lasting: Any, inputs: Any) -> Any:
    """The NamedTuple of the fields of both, for kernels that count no references."""
    kind = types.BaseTuple.from_types((*lasting.types, *inputs.types), _wholes[inputs.instance_class])

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        parts = ((args[0], len(lasting.types)), (args[1], len(inputs.types)))
        values = [builder.extract_value(part, i) for part, count in parts for i in range(count)]
        return context.make_tuple(builder, kind, values)

    return kind(lasting, inputs), emit


def _run(addresses, first, last, handle, inputs):  # type: ignore[no-untyped-def]
    data = _joined(unbundle(handle), inputs)
    for i in range(addresses.shape[0]):
        _call_at(addresses[i], first, last, data)


class Chain:
    """Kernels with the signature ``kernel(first, last, data)``, called in order as one kernel.

    Each type of data gets a compiled function of its own, at its first call.

    Parameters
    ----------
    whole : the class of ``data``, a NamedTuple of the fields of the bundle and of the inputs, in this order
    kernels : functions that :func:`~lanebound.integrity.core.accel.jit` compiled

    Raises
    ------
    TypeError
        At a call, when ``whole`` has other fields.
    """

    def __init__(self, whole: type[Any], *kernels: Any) -> None:
        self._whole, self._kernels, self._lock = whole, kernels, threading.Lock()
        self._bound: dict[Any, tuple[Any, np.ndarray[Any, Any]]] = {}
        self._latest: tuple[Any, np.ndarray[Any, Any]] | None = None

    def compile_ahead(self, make: Callable[[], Any]) -> None:
        """Begin to compile in a second process if no kernel is cached; ``make`` returns data of the expected types."""
        if self._kernels not in _ahead and Ahead.helps(self._kernels):
            kind = numba.typeof(make())
            if is_ours(kind):
                _ahead[self._kernels] = kind, Ahead(self._kernels, _signature(kind)).start()

    def __call__(self, first: int, last: int, lasting: Bundle, inputs: Any) -> None:
        latest, handle = self._latest, lasting.handle
        if latest is not None:
            driver, addresses = latest
            try:
                driver(addresses, first, last, handle, inputs)
            except TypeError:  # data of other types, which the driver refuses
                if self._bound.get((numba.typeof(handle), numba.typeof(inputs))) is latest:
                    raise
            else:
                return
        with self._lock:
            driver, addresses = self._latest = self._for(lasting, inputs)
        driver(addresses, first, last, handle, inputs)

    def _for(self, lasting: Bundle, inputs: Any) -> tuple[Any, np.ndarray[Any, Any]]:
        """The compiled function and the addresses of the kernels for data of these types."""
        key = numba.typeof(lasting.handle), numba.typeof(inputs)
        found = self._bound.get(key)
        if found is None:
            if self._whole._fields != (*lasting.values._fields, *inputs._fields):
                raise TypeError(
                    f"{self._whole.__name__} must have the fields {(*lasting.values._fields, *inputs._fields)}, "
                    f"got {self._whole._fields}: name those of the bundle, then those of the inputs"
                )
            kind = numba.typeof(self._whole(*lasting.values, *inputs))
            _wholes[type(inputs)] = self._whole
            expected, ahead = _ahead.get(self._kernels, (None, None))
            if ahead is not None and expected == kind:
                ahead.finish()
            addresses = np.array([_address(kernel, _signature(kind)) for kernel in self._kernels])
            driver = jit(borrows=True)(_run) if is_ours(kind) else kernel_of(_run, **BORROWING)
            driver.compile((numba.typeof(addresses), types.int64, types.int64, *key))
            driver.disable_compile()
            found = self._bound[key] = driver, addresses
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return Chain, (self._whole, *self._kernels)


def _signature(kind: Any) -> tuple[Any, ...]:
    """Types of the arguments of kernels for a type of data."""
    return types.int64, types.int64, kind


def _address(kernel: Any, signature: tuple[Any, ...]) -> np.uintp:
    """Where the machine code of a kernel for a signature begins; compiled now if it is not yet."""
    if not is_ours(signature[-1]):
        kernel = kernel_of(kernel.py_func, **IN_MEMORY)
        _kept.append(kernel)
    return address_of(kernel, signature)
