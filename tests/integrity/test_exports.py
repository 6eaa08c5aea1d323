"""The main names of the package, loaded when they are used."""

from __future__ import annotations

import doctest
import subprocess
import sys

import pytest

import lanebound.integrity as package


def test_every_exported_name_is_there() -> None:
    assert set(package.WHERE) == set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        assert getattr(package, name).__name__ == name
    with pytest.raises(AttributeError, match="has no attribute 'Navigatr'"):
        package.Navigatr  # noqa: B018


def test_the_package_is_imported_without_numba() -> None:
    code = "import sys, lanebound.integrity; print([m for m in ('numba', 'numpy', 'pydantic') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_example_of_the_package_runs() -> None:
    result = doctest.testmod(package)
    assert (result.failed, result.attempted > 5) == (0, True)
