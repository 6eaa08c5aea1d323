"""Numba's dispatcher, with the part that Python calls compiled only for kernels that Python calls.

Numba compiles with every function a wrapper that takes Python objects, and another for C. Most kernels are called by
kernels alone. For a NamedTuple of many arrays the wrappers take several times as long to compile as a short kernel, and
each caller compiles those of its callees again.

A :class:`Kernel` therefore has two forms for each signature: without wrappers, for its callers in compiled code, and
with the Python wrapper, compiled at the first call from Python. Both contain the same code of the kernel and are cached
separately. Plain ``numba.njit`` takes half as long again to the first step of an environment.

This needs attributes of Numba that its documentation does not promise (``NEEDED``). A version of Numba without one of
them compiles plain ``numba.njit`` functions, with all wrappers.
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import gc
import itertools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba.core import sigutils, types
from numba.core.caching import CacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.compiler import Flags
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.extending import lower_cast

from lanebound.integrity.core.kernel_cache import PORTABLE, takes_shipped

__all__ = ["LEVEL", "Kernel", "kernel_of"]

INNER, OUTER = "inner", "outer"  # forms in the cache: without and with the Python wrapper

LEVEL = type(numba.config.OPT)(2)  # type: ignore[attr-defined]  # kernels of level 3 are no faster
COLLECTION = 100_000  # new objects between two collections while kernels are compiled
NEEDED: tuple[tuple[Any, tuple[str, ...]], ...] = (
    (CPUDispatcher, ("compile", "get_call_template", "add_overload", "overloads", "targetoptions", "_cache")),
    (FunctionCache, ("load_overload", "save_overload", "_index_key", "_impl", "_cache_file")),
    (IndexDataCacheFile, ("_index_path", "_data_name_pattern")),
    (CacheImpl, ("filename_base",)),
    (Flags, ("no_cpython_wrapper", "no_cfunc_wrapper")),
)
"""Classes of Numba with the attributes that a :class:`Kernel` reads, sets or overrides."""


def kernel_of(function: Callable[..., Any], **options: Any) -> Any:
    """``numba.njit(**options)(function)`` as a :class:`Kernel`; the function itself where Numba is switched off."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    if _missing():
        return numba.njit(**options)(function)
    return Kernel(function, targetoptions={"nopython": True, "boundscheck": None, "no_cfunc_wrapper": True, **options})


def _missing() -> list[str]:
    """What this version of Numba lacks of ``NEEDED``; attributes of objects are those that ``__init__`` sets."""
    return [f"{owner.__name__}.{name}" for owner, names in NEEDED for name in names if not _has(owner, name)]


def _has(owner: Any, name: str) -> bool:
    codes = (getattr(kind.__init__, "__code__", None) for kind in owner.__mro__)
    return hasattr(owner, name) or any(code is not None and name in code.co_names for code in codes)


class Kernel(CPUDispatcher):
    """A compiled function with or without the wrapper for calls from Python, per signature."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._replaced: list[Any] = []  # results without wrapper; Numba drops none, as callers may refer to them

    def enable_caching(self) -> None:
        """Cache on disk, in the directory that Numba's configuration names."""
        self._cache = _KernelCache(self)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Numba's: types of a call by another kernel, which needs no wrapper and is compiled once for similar types."""
        general = tuple(map(_general, args)), {name: _general(kind) for name, kind in kws.items()}
        with self._form(INNER):
            return super().get_call_template(*general)

    def compile(self, sig: Any) -> Any:
        """Compile for a signature: with the wrapper, unless another kernel is the caller."""
        with global_compiler_lock:
            args, _ = sigutils.normalize_signature(sig)
            if not self._is_inner and (found := self.overloads.get(tuple(args))) is not None and not _is_outer(found):
                self._replaced.append(self.overloads.pop(tuple(args)))
            with _compiling():
                return super().compile(sig)

    def compile_inner(self, signature: tuple[Any, ...]) -> None:
        """Compile for a signature without wrapper, as for a call by another kernel."""
        with self._form(INNER):
            self.compile(signature)

    @property
    def is_cached(self) -> bool:
        """Whether some form of the kernel is cached on disk, for the present sources."""
        return isinstance(self._cache, _KernelCache) and os.path.exists(self._cache._cache_file._index_path)

    def add_overload(self, cres: Any) -> None:
        """Numba's: Python finds a compiled form only with the wrapper."""
        if _is_outer(cres):
            super().add_overload(cres)
        else:
            self.overloads[tuple(cres.signature.args)] = cres

    @property
    def _is_inner(self) -> bool:
        return bool(self.targetoptions.get("no_cpython_wrapper", False))

    @contextmanager
    def _form(self, form: str) -> Iterator[None]:
        """Context in which a form is compiled and loaded; Numba's lock is held."""
        with global_compiler_lock:
            options, name = self.targetoptions, "no_cpython_wrapper"
            before = options.get(name, False)
            options[name] = form == INNER
            try:
                yield
            finally:
                options[name] = before


def _is_outer(result: Any) -> bool:
    """Whether a compiled function has a wrapper for Python."""
    return bool(result.library.get_pointer_to_function(result.fndesc.llvm_cpython_wrapper_name))


def _general(kind: Any) -> Any:
    """The type for which a kernel is compiled: that of any number for a constant, and of any array for a record's."""
    if isinstance(kind, types.NestedArray):
        return types.Array(kind.dtype, kind.ndim, "C")
    return types.unliteral(kind)


@lower_cast(types.NestedArray, types.Array)
def _as_array(context: Any, builder: Any, kind: Any, wanted: Any, value: Any) -> Any:
    """Code that passes an array of a record as any array: both are represented alike."""
    return value


@contextmanager
def _compiling() -> Iterator[None]:
    """Context in which LLVM optimises at ``LEVEL`` at most, and Python collects garbage rarely. Numba's lock is held.

    Each saves a tenth of the time to compile.
    """
    collection, level = gc.get_threshold(), numba.config.OPT  # type: ignore[attr-defined]
    if 0 < collection[0] < COLLECTION:
        gc.set_threshold(COLLECTION, *collection[1:])
    numba.config.OPT = min(level, LEVEL)  # type: ignore[attr-defined]
    try:
        yield
    finally:
        gc.set_threshold(*collection)
        numba.config.OPT = level  # type: ignore[attr-defined]


class _KernelCache(FunctionCache):
    """Numba's cache of a function, with an entry for each form.

    Two processes that save at the same time write different files, so that no entry refers to the code of another.
    """

    def __init__(self, kernel: Kernel) -> None:
        super().__init__(kernel.py_func)
        self._kernel, self._saved_form = kernel, ""
        self._machine: tuple[str, str, str] | None = None  # for which a form is compiled; None for this one

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The result for a signature, with the wrapper where only that form is cached; None if it must be compiled.

        What this machine compiled comes before what a wheel shipped.
        """
        forms = (INNER, OUTER) if self._kernel._is_inner else (OUTER,)
        machines = (None, PORTABLE) if takes_shipped() else (None,)
        for machine, form in itertools.product(machines, forms):
            self._machine, self._saved_form = machine, form
            if (found := super().load_overload(sig, target_context)) is not None:
                return found
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a result in its form."""
        self._saved_form, self._machine = INNER if self._kernel._is_inner else OUTER, None
        file = self._cache_file
        file._data_name_pattern = f"{self._impl.filename_base}-{os.getpid()}.{{number:d}}.nbc"
        super().save_overload(sig, data)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        signature, machine, *code = super()._index_key(sig, codegen)
        return (signature, self._machine or machine, *code, self._saved_form)
