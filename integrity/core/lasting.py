"""Bundles of arrays that last as long as the objects that own them."""

from __future__ import annotations

from collections.abc import Callable
from operator import is_not
from typing import Any

import numpy as np

from lanebound.integrity.core import bundle_kernel
from lanebound.integrity.core.bundle_kernel import Bundle

__all__ = ["LastingBundle"]

_handle_types: dict[Any, np.dtype[np.void]] = {}


class LastingBundle:
    """A bundle, made again where one of the objects that its arrays belong to is replaced; a copy is empty."""

    def __init__(self) -> None:
        self._owners: tuple[Any, ...] = ()
        self._bundle: Bundle | None = None

    def of(self, owners: tuple[Any, ...], make: Callable[[], Any]) -> Bundle:
        """The bundle of the NamedTuple that ``make`` returns, whose arrays belong to ``owners`` and stay in place."""
        found = self._bundle
        if found is None or any(map(is_not, owners, self._owners)):
            found, self._owners = _KnownBundle(make()), owners
            found.write()
            self._bundle = found
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return LastingBundle, ()


class _KnownBundle(Bundle):
    """A bundle that finds its type by those of the arrays: Numba needs milliseconds for that of many records."""

    def write(self) -> None:
        """Write the handle, before threads read it."""
        key = _key_of(self.values)
        known = _handle_types.get(key)
        if known is None:
            _handle_types[key] = self.handle.dtype
        else:
            self._handle = np.zeros(1, known)
            bundle_kernel._write(self.values, self._handle)


def _key_of(values: Any) -> Any:
    """What the type of values in a kernel depends on."""
    if isinstance(values, np.ndarray):
        flags = values.flags
        return values.dtype, values.ndim, flags.c_contiguous, flags.f_contiguous, flags.aligned, flags.writeable
    return (type(values), *map(_key_of, values)) if isinstance(values, tuple) else type(values)
