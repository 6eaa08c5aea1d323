"""Text files as users have them: plain or gzip; other forms are refused with the program that unpacks them."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import IO, cast

from lanebound.integrity.core.errors import InputError

__all__ = ["CRINEX_REMEDY", "open_unpacked"]

GZIP_MAGIC = b"\x1f\x8b"
PACKED = {  # first bytes: what it is, and what unpacks it
    b"\x1f\x9d": ("compressed by compress (.Z)", "gzip -d"), b"PK\x03\x04": ("a zip archive", "unzip"),
    b"BZh": ("compressed by bzip2", "bzip2 -d"), b"\xfd7zXZ": ("compressed by xz", "xz -d"),
    b"7z\xbc\xaf": ("a 7-Zip archive", "7z x"), b"\x28\xb5\x2f\xfd": ("compressed by zstd", "zstd -d"),
    b"\xff\xfe": ("UTF-16 text", "iconv -f UTF-16 -t UTF-8"), b"\xfe\xff": ("UTF-16 text", "iconv -f UTF-16 -t UTF-8"),
}  # fmt: skip
CRINEX_REMEDY = "it is Hatanaka-compressed (.crx, .d): unpack it with crx2rnx, or with the Python package hatanaka"


def open_unpacked(path: Path) -> IO[bytes]:
    """A stream of the bytes of a file, plain or gzip (detected by its first bytes).

    Raises
    ------
    OSError
        The file cannot be opened.
    InputError
        It is packed in another form.
    """
    with path.open("rb") as plain:
        magic = plain.read(6)
    for start, (what, program) in PACKED.items():
        if magic.startswith(start):
            raise InputError(f"{path} must be plain text or gzip, is {what}: unpack it with '{program}'")
    return cast(IO[bytes], gzip.open(path, "rb") if magic.startswith(GZIP_MAGIC) else path.open("rb"))
