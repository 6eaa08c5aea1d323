"""What all tests share: no display, plain terminals, interrupts that are heard, registries of the package alone.

Hypothesis runs repeat exactly. The tests pass in any order: ``make test ARGS=--random-order-seed=3`` shuffles them.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # two workers: threads of PyTorch that wait for each other slow both

# What commands print is compared as plain text of one width, whatever terminal or service runs the tests.
os.environ["COLUMNS"] = "120"
for variable in ("FORCE_COLOR", "GITHUB_ACTIONS", "PY_COLORS"):
    os.environ.pop(variable, None)

# What shells start in the background ignores Ctrl-C, and so would all that the tests start: it is heard again.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=50, database=None)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def _registries_of_the_package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What a test or a module of tests registers, or withdraws, no other test sees."""
    from registries import as_in_the_package

    with as_in_the_package(tmp_path_factory.getbasetemp()):
        yield


def pytest_configure() -> None:
    """Keep the tables of the package before modules of tests are imported, as some of these register."""
    import registries  # noqa: F401


def pytest_collectreport() -> None:
    """What a module of tests registers while it is imported is no parameter of the tests in another one."""
    from registries import restore

    restore()
