"""Sizes of compressed files before they are read: a few kB may hold gigabytes."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from lanebound.integrity.core.errors import InputError

__all__ = ["read_bytes", "require_moderate_gzip", "require_moderate_pbf"]

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


def require_moderate_pbf(file: Path, what: str, most_bytes: int) -> None:
    """Refuse a ``.osm.pbf`` whose blobs hold more than ``most_bytes``, by the sizes that they state.

    libosmium refuses blobs that hold more than they state, and those that are cut short.

    Raises
    ------
    InputError
        As said.
    """
    total = 0
    with file.open("rb") as stream:
        while head := stream.read(4):
            size = _field(stream.read(min(int.from_bytes(head, "big"), BLOCK_BYTES)), DATA_SIZE)
            total += max(_field(stream.read(min(size, FIRST_BYTES)), RAW_SIZE), size)
            stream.seek(max(size - FIRST_BYTES, 0), 1)
            if total > most_bytes:
                raise InputError(f"{what} {file} must hold at most {most_bytes} bytes, got more: cut a part")


DATA_SIZE, RAW_SIZE = 3, 2  # numbers of fields: OpenStreetMap wiki, PBF format, BlobHeader and Blob
FIRST_BYTES = 32


def _field(message: bytes, number: int) -> int:
    """A field of a protocol buffer that is a number, 0 if it does not come before the first long field."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        value, at = _varint(message, at)
        if key == number << 3:
            return value
        if key & 7 == 2:
            at += value
    return 0


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(message):
        value |= (message[at] & 127) << shift
        shift, at = shift + 7, at + 1
        if message[at - 1] < 128 or shift > 63:
            break
    return value, at


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
