"""The build backend: that of setuptools, which builds wheels outside of the source tree.

Setuptools copies modules to ``build/`` and packs all that lies there: after ``pip install PATH`` in a clone, a later
wheel would hold modules that have been renamed or deleted since.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (
    build_editable,
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]


@contextmanager
def _outside() -> Iterator[None]:
    """In this context setuptools writes into a temporary folder, which DIST_EXTRA_CONFIG names."""
    with TemporaryDirectory() as folder:
        config, before = Path(folder, "dist.cfg"), os.environ.get("DIST_EXTRA_CONFIG")
        config.write_text(f"[build]\nbuild_base = {folder}/build\n[egg_info]\negg_base = {folder}\n", encoding="utf-8")
        os.environ["DIST_EXTRA_CONFIG"] = str(config)
        try:
            yield
        finally:
            del os.environ["DIST_EXTRA_CONFIG"]
            os.environ.update({} if before is None else {"DIST_EXTRA_CONFIG": before})


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """What a wheel needs to be built."""
    with _outside():
        return build_meta.get_requires_for_build_wheel(config_settings)


def prepare_metadata_for_build_wheel(metadata_directory: str, config_settings: Any = None) -> str:
    """Write the metadata of a wheel; returns the name of their folder."""
    with _outside():
        return build_meta.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build a wheel; returns its name."""
    with _outside():
        return build_meta.build_wheel(wheel_directory, config_settings, metadata_directory)
