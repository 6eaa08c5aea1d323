"""Damaged files, 20,000 of each form: never a hang, a crash without message, or much memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import RAW, RINEX, RTK_REFERENCE, RTK_SOLUTION, SKY, SMARTLOC, SMARTLOC_TRUTH, survives

from lanebound.integrity.recorded.comma import read_rows
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.recorded.rtklib import read_reference, read_rtk_solution
from lanebound.integrity.recorded.sky_recording import read_sky_recording
from lanebound.integrity.recorded.smartloc import read_smartloc, read_smartloc_raw

ALL, SOME = 20_000, 500
PIECES = (
    b"\n",
    b" ",
    b"-",
    b"nan",
    b"1e308",
    b"999999999",
    b">",
    b"G",
    b";",
    b"\x00",
    b"\xff\xfe",
    b"\x1f\x8b",
    b"#",
    b"(",
)


def array_file(folder: Path) -> bytes:
    np.save(folder / "whole.npy", np.arange(30.0).reshape(10, 3))
    return (folder / "whole.npy").read_bytes()


FORMS: dict[str, tuple[Callable[[Path], bytes], Callable[[Path], Any]]] = {
    "smartloc": (lambda _: SMARTLOC.encode(), read_smartloc),
    "truth": (lambda _: (SMARTLOC + SMARTLOC_TRUTH).encode(), lambda path: read_smartloc(path, path)),
    "raw": (lambda _: RAW.encode(), read_smartloc_raw),
    "rtk solution": (lambda _: RTK_SOLUTION.encode(), read_rtk_solution),
    "reference": (lambda _: RTK_REFERENCE.encode(), read_reference),
    "rinex": (lambda _: RINEX.encode(), read_observations),
    "sky": (lambda _: SKY.encode(), read_sky_recording),
    "array": (array_file, lambda path: read_rows(path, 3)),
}


def damaged(whole: bytes, rng: np.random.Generator) -> bytes:
    """Cut, doubled, overwritten or riddled at random places."""
    raw = bytearray(whole)
    for _ in range(int(rng.integers(1, 7))):
        at, span = (int(v) for v in rng.integers(0, [len(raw) + 1, 60]))
        kind = int(rng.integers(5))
        if kind == 0:
            del raw[at:]
        elif kind == 1:
            raw[at:at] = raw[at : at + span]
        elif kind == 2:
            raw[at : at + span] = rng.bytes(span)
        elif kind == 3:
            raw[at : at + len(PIECES[span % len(PIECES)])] = PIECES[span % len(PIECES)]
        else:
            del raw[at : at + span]
    return bytes(raw)


def meet(form: str, count: int, folder: Path) -> int:
    """Read ``count`` damaged files of a form; returns how many were still readable."""
    make, read = FORMS[form]
    rng, path = np.random.default_rng(sorted(FORMS).index(form)), folder / "damaged"
    whole, readable = make(folder), 0
    for _ in range(count):
        path.write_bytes(damaged(whole, rng))
        readable += survives(lambda: read(path)) is not None
    return readable


@pytest.mark.parametrize("form", FORMS)
def test_some_damaged_files(form: str, tmp_path: Path) -> None:
    assert meet(form, SOME, tmp_path) < SOME


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_a_hundred_thousand_damaged_files(form: str, tmp_path: Path) -> None:
    assert meet(form, ALL, tmp_path) < ALL
