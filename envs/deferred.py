"""Imports highway-env without two libraries that it imports and driving does not need: they take a second."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

__all__ = ["DEFERRED"]

DEFERRED = ("matplotlib", "matplotlib.pyplot", "pandas")  # plots of vehicle dynamics, tables of its own observations


class _Later(ModuleType):
    """Stands in for a module, which is imported when one of its names is used."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(import_module(self.__name__), name)


def _import_highway_env() -> None:
    """Import it; the modules that stand in stay known to highway-env alone."""
    later = {name: _Later(name) for name in DEFERRED if name not in sys.modules}
    if "matplotlib" in later:
        later["matplotlib"].__dict__["pyplot"] = later["matplotlib.pyplot"]
    sys.modules.update(later)
    try:
        import_module("highway_env.envs")
    finally:
        for name, module in later.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]


_import_highway_env()
