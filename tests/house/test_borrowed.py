"""Kernels that count no references call none that makes an array: such a call compiles in some orders only."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
MAKES = re.compile(r"\bnp\.(zeros|empty|ones|full|array|arange)(_like)?\(|\.copy\(")


def _kernels() -> list[Any]:
    files = [file for layer in ("integrity", "envs") for file in (ROOT / layer).rglob("*_kernel.py")]
    names = [".".join(("lanebound", *file.relative_to(ROOT).with_suffix("").parts)) for file in files]
    found = [value for name in names for value in vars(import_module(name)).values()]
    return [value for value in found if _is_kernel(value)]


def _is_kernel(value: Any) -> bool:
    return hasattr(value, "py_func") and hasattr(value, "targetoptions")


def _makes_arrays(kernel: Any, seen: frozenset[Any] = frozenset()) -> bool:
    function = kernel.py_func
    if function in seen:
        return False
    called = [function.__globals__.get(name) for name in function.__code__.co_names]
    inner = (_makes_arrays(one, seen | {function}) for one in called if _is_kernel(one))
    return MAKES.search(inspect.getsource(function)) is not None or any(inner)


def test_borrowing_kernels_make_no_arrays() -> None:
    borrowing = [kernel for kernel in _kernels() if kernel.targetoptions.get("_nrt") is False]
    assert len(borrowing) > 50
    assert [kernel.py_func.__qualname__ for kernel in borrowing if _makes_arrays(kernel)] == []
