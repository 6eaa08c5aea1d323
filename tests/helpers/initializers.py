"""What tests call first in worker processes: those import it from ``pythonpath``, and cannot import a test itself."""

from __future__ import annotations

import os

from lanebound.envs.info import InfoEntry, register_info
from lanebound.integrity.core.errors import InputError

__all__ = ["fail", "fail_oddly", "register_late", "set_variable"]


def set_variable(name: str) -> None:
    os.environ[name] = "1"


def fail() -> None:
    raise InputError("no plug-in")


class TwoArgumentsError(Exception):
    """It can be pickled, and not be read again."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first)


def fail_oddly() -> None:
    raise TwoArgumentsError("odd", "error")


def register_late() -> None:
    register_info(InfoEntry("late_m", "level [m]", lambda observed: observed.belief["pl_at_m"]))
