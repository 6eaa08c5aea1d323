"""Lines of a text file that may be compressed, truncated, very large or binary, read with bounded time and memory."""

from __future__ import annotations

import codecs
import gzip
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.packed import open_unpacked

__all__ = ["MAX_BYTES", "Lines", "Stop", "finite_number", "whole_number"]

MAX_BYTES = 256 * 2**20  # of uncompressed text; its arrays and the temporary lists need less than 1 GiB
MAX_LINE = 65_536  # bytes; the longest line of the formats has some thousands


@dataclass(frozen=True)
class Stop:
    """Place and reason of an end of reading before the end of the file: line, or row of an array, from 1."""

    line: int
    reason: str

    def __str__(self) -> str:
        return f"stopped at line {self.line}: {self.reason}"


class Lines:
    """Numbered lines of a file, plain or gzip (detected by its first bytes), as Latin-1 text without line ends.

    ``stop`` is set if the file ends unexpectedly: a damaged compressed stream, a line that is too long, or a last line
    without a line end. Such a last line is left out, because its last number may have lost digits.

    Raises
    ------
    InputError
        The file cannot be opened, is packed in another form, or holds more than ``max_bytes``.
    """

    def __init__(self, path: str | Path, max_bytes: int = MAX_BYTES) -> None:
        self.path = Path(path)
        self.max_bytes = max_bytes
        self.number = 0
        self.read = 0
        self.stop: Stop | None = None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the lines; ``number`` is the number of the latest line, ``read`` the bytes up to its end."""
        try:
            with open_unpacked(self.path) as stream:
                while raw := stream.readline(MAX_LINE):
                    if not self.number:
                        raw = raw.removeprefix(codecs.BOM_UTF8)  # which tags that count bytes do not know
                    self.number += 1
                    self.read += len(raw)
                    if self.read > self.max_bytes:
                        raise InputError(
                            f"{self.path} must hold at most {self.max_bytes} bytes of text, has more: split it"
                        )
                    if not raw.endswith(b"\n"):
                        endless = len(raw) == MAX_LINE
                        reason = f"it is longer than {MAX_LINE} bytes" if endless else "it has no line end"
                        self.stop = Stop(self.number, reason)
                        return
                    yield raw.decode("latin-1").rstrip("\r\n")
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            self.stop = Stop(self.number + 1, f"the compressed stream is damaged ({error})")
        except OSError as error:
            raise InputError(
                f"{self.path} must be a readable file, got {error.strerror or error}: correct the path"
            ) from error

    def where(self) -> str:
        """File and line, for the start of messages."""
        return f"{self.path}, line {self.number}"


def finite_number(text: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Convert text to a finite number within bounds.

    Raises
    ------
    ValueError
        The text is not such a number; readers put file, line and field in front of the message.
    """
    try:
        value = float(text)
    except ValueError:
        comma = ": write decimal points, not commas" if re.fullmatch(r"[-+]?\d+,\d+", text.strip()) else ""
        raise ValueError(f"must be a number, got {text[:40]!r}{comma}") from None
    if not math.isfinite(value) or not low <= value <= high:
        raise ValueError(f"must lie in [{low:g}, {high:g}], got {text[:40].strip()!r}")
    return value


def whole_number(text: str, low: int, high: int) -> int:
    """Convert text to an integer within bounds.

    Raises
    ------
    ValueError
        As :func:`finite_number`.
    """
    value = finite_number(text, low, high)
    if value != int(value):
        raise ValueError(f"must be a whole number, got {text[:40].strip()!r}")
    return int(value)
