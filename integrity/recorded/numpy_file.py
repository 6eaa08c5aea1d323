"""NumPy array files read with doubt: no pickles, no header believed that promises too much, cut files in part."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import MAX_BYTES

__all__ = ["read_rows"]

MAX_HEADER = 4096  # bytes; those of plain arrays are 118
MAX_LENGTH = 2**40
NUMBER = re.compile(r"[<>=|]?[fiu][1248]")


def read_rows(path: str | Path, columns: int | None, max_bytes: int = MAX_BYTES) -> tuple[NDArray[np.float64], int]:
    """Rows (N,) or, with ``columns``, (N, columns), as float64, and how many the header promises beyond those.

    Raises
    ------
    InputError
        The file cannot be read, is no array of real numbers of that shape, is too large, or holds a number that is not
        finite.
    """
    source = Path(path)
    try:
        size = source.stat().st_size
        if size > max_bytes:
            raise InputError(f"{path} must have at most {max_bytes} bytes, has {size}: split it")
        with source.open("rb") as stream:
            shape, fortran, dtype = _header(stream)
            body = stream.read(size)
    except OSError as error:
        raise InputError(f"{path} must be a readable file, got: {error}") from error
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError) as error:
        raise InputError(f"{path} must be a NumPy array file (.npy), got: {str(error)[:200]}") from error
    if len(shape) == 2 and shape[1] == 1 and columns is None:
        shape = shape[:1]
    wanted = (columns,) if columns is not None else ()
    if not shape or shape[1:] != wanted:
        expected = ", ".join(["N", *map(str, wanted)])
        raise InputError(f"{path} must have shape ({expected}), got {shape}: transpose or slice it")
    width = math.prod(wanted)
    whole = min(shape[0], len(body) // (dtype.itemsize * width))
    if fortran and width > 1 and whole < shape[0]:
        raise InputError(f"{path} is cut and stores column by column, so that no row is whole: fetch it again")
    flat = np.frombuffer(body, dtype, whole * width).astype(np.float64)
    rows = flat.reshape(whole, *wanted, order="F" if fortran else "C")
    if not np.isfinite(rows).all():
        bad = int(np.argwhere(~np.isfinite(rows))[0][0])
        raise InputError(f"{path} must be finite, got {rows[bad]} in row {bad}: drop that row from all its arrays")
    return rows, shape[0] - whole


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[np.generic]]:
    """Shape, order and type of the elements (NEP 1), read without NumPy's own parser, which repairs old files."""
    if stream.read(6) != b"\x93NUMPY":
        raise ValueError("the file must begin with the magic string of NumPy")
    version = stream.read(2)
    if version not in (b"\x01\x00", b"\x02\x00", b"\x03\x00"):
        raise ValueError("the format version must be 1.0, 2.0 or 3.0")
    length = int.from_bytes(stream.read(2 if version == b"\x01\x00" else 4), "little")
    if length > MAX_HEADER:
        raise ValueError(f"the header must have at most {MAX_HEADER} bytes, has {length}")
    told = ast.literal_eval(stream.read(length).decode("latin-1").strip())
    if not isinstance(told, dict) or {"descr", "fortran_order", "shape"} - told.keys():
        raise ValueError("the header must name descr, fortran_order and shape")
    shape, kind = told["shape"], told["descr"]
    if not isinstance(shape, tuple) or not all(type(n) is int and 0 <= n < MAX_LENGTH for n in shape):
        raise ValueError(f"the shape must be lengths, got {shape!r}")
    if not isinstance(kind, str) or not NUMBER.fullmatch(kind):
        raise ValueError(f"the elements must be real numbers, got {kind!r}: save them as float64")
    return shape, bool(told["fortran_order"]), np.dtype(kind)
