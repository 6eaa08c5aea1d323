"""The two exceptions of the integrity layer for invalid input, and the checks that raise them.

Each message gives the field, the bound, the value found and the remedy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ConfigError", "InputError", "require_finite", "require_in_range", "require_probability", "require_shape"]


class InputError(ValueError):
    """An argument is invalid."""


class ConfigError(InputError):
    """A configuration value is unknown, of the wrong type or out of range."""


def require_finite(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return ``value`` as float64; raise InputError if an entry is NaN, infinite or not a number."""
    try:
        raw = np.asarray(value)
        if raw.dtype.kind not in "biufO" or (raw.dtype.kind == "O" and any(map(_is_text, raw.flat))):
            raise TypeError("text, complex numbers and times are not read as real numbers")
        array = raw.astype(np.float64, copy=False)
    except (TypeError, ValueError) as exc:
        raise InputError(f"{name} must be numeric, got {_shown(value)}: pass an array of numbers") from exc
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))[0]
        at = f"{name}[{', '.join(map(str, bad))}]" if array.ndim else name
        raise InputError(f"{name} must be finite, got {at} = {array[tuple(bad)]}: mask or remove that entry")
    return array


def _is_text(entry: object) -> bool:
    return isinstance(entry, str | bytes)


def _shown(value: object) -> str:
    """The type of a value, with the value if it is a short text."""
    kind = type(value).__name__
    return f"{kind} {value!r}" if isinstance(value, str) and len(value) <= 40 else kind


def require_shape(name: str, array: NDArray[Any], trailing: tuple[int | None, ...]) -> None:
    """Raise InputError unless the last axes of ``array`` have the sizes ``trailing`` (None: any size)."""
    found = array.shape[-len(trailing) :] if trailing else ()
    if len(found) != len(trailing) or any(w is not None and w != f for w, f in zip(trailing, found, strict=True)):
        wanted = ", ".join("any" if w is None else str(w) for w in trailing)
        raise InputError(f"{name} must have shape (..., {wanted}), got {array.shape}: reshape it")


def require_in_range(
    name: str,
    value: ArrayLike,
    low: float,
    high: float,
    *,
    low_open: bool = False,
    high_open: bool = False,
) -> NDArray[np.float64]:
    """Return ``value`` as float64; raise InputError unless every entry lies between ``low`` and ``high``."""
    array = require_finite(name, value)
    below = array <= low if low_open else array < low
    above = array >= high if high_open else array > high
    if (below | above).any():
        interval = f"{'(' if low_open else '['}{low}, {high}{')' if high_open else ']'}"
        raise InputError(f"{name} must lie in {interval}, got {array[below | above].flat[0]}: correct that value")
    return array


def require_probability(name: str, value: float) -> float:
    """Return ``value``; raise InputError unless it lies in the open interval (0, 1)."""
    return float(require_in_range(name, value, 0.0, 1.0, low_open=True, high_open=True))
