"""Drivers, learning, benchmarks and the command line ``lanebound``."""

from __future__ import annotations

import sys

__all__ = ["main"]


def main() -> None:
    """Run the command line; without the packages of the extra ``agents`` it says what is missing."""
    try:
        from lanebound.agents.cli import main as run
    except ModuleNotFoundError as error:
        sys.exit(
            f"error: the command line needs the package {error.name}, got none: install lanebound with its extra "
            "'agents', as in pip install 'PATH_OF_LANEBOUND[agents]'"
        )
    run()
