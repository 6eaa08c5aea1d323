"""Content of files, plain or gzip, up to a size: a few kB of gzip may hold gigabytes."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from lanebound.integrity.core.errors import InputError

__all__ = ["read_bytes", "require_moderate_gzip"]

BLOCK_BYTES = 2**20


def require_moderate_gzip(file: Path, what: str, most_bytes: int) -> None:
    """Refuse a gzip file that is truncated or holds more than ``most_bytes``, without keeping its content.

    Raises
    ------
    InputError
        As said.
    """
    size = 0
    try:
        with gzip.open(file) as stream:
            while block := stream.read(BLOCK_BYTES):
                size += len(block)
                if size > most_bytes:
                    raise InputError(
                        f"{what} {file} must hold at most {most_bytes} bytes of text, got more: cut a part"
                    )
    except (EOFError, OSError, zlib.error) as error:
        raise InputError(f"{what} {file} must be a whole gzip file, got: {error}; fetch it again") from error


def read_bytes(file: Path, what: str, most_bytes: int) -> bytes:
    """The content of a file.

    Raises
    ------
    InputError
        The file is missing, empty, truncated, or holds more than ``most_bytes``.
    """
    if not file.is_file():
        raise InputError(f"{what} {file} must be a file, which does not exist: correct the path")
    if file.name.lower().endswith(".gz"):
        require_moderate_gzip(file, what, most_bytes)
        return gzip.decompress(file.read_bytes())
    if not 0 < file.stat().st_size <= most_bytes:
        raise InputError(f"{what} {file} must have 1 to {most_bytes} bytes, got {file.stat().st_size}: cut a part")
    return file.read_bytes()
