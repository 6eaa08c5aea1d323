"""Ctrl-C during long work: an answer at once, what was kept, and exit code 130."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from threading import Thread
from typing import TypeVar

import typer

__all__ = ["EXIT_INTERRUPTED", "stoppable", "wait_for"]

T = TypeVar("T")
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells count
MOST_S = 5.0  # that a process may take to be started


def wait_for(work: Callable[[], T]) -> T:
    """What ``work`` returns or raises, run in a thread of its own while this one waits for it or for Ctrl-C.

    Python raises KeyboardInterrupt in the main thread only. Were the work done there, the interrupt would wait for the
    end of the compiler's present step, or be lost in one of its callbacks.
    """
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    Thread(target=run, daemon=True).start()
    return outcome.result()


@contextmanager
def stoppable(kept: Callable[[], str]) -> Iterator[None]:
    """Within it, Ctrl-C prints ``kept()`` and ends the process at once.

    A thread that compiles cannot be asked to stop, and Python may crash when it leaves one behind: so nothing is tidied
    up, and files written by the work must be whole at any time.
    """
    try:
        yield
    except KeyboardInterrupt:
        from lanebound.agents.kept import STARTING

        typer.echo(f"interrupted: {kept()}", err=True)
        sys.stdout.flush()
        sys.stderr.flush()
        STARTING.acquire(timeout=MOST_S)
        os._exit(EXIT_INTERRUPTED)
