"""Whether the module of an agent can be imported, found out in a process of its own."""

from __future__ import annotations

import subprocess
import sys

from lanebound.integrity.core.errors import InputError

__all__ = ["require_importable"]

LONGEST_S = 60.0
"""Time for an import [s]; one that takes longer is left to the episodes."""
MARK = "lanebound-import:"
TRIAL = f"""
import importlib, sys
sys.path[:] = sys.argv[2:]
try:
    importlib.import_module(sys.argv[1])
except BaseException as error:
    from traceback import extract_tb
    frames = [frame for frame in extract_tb(error.__traceback__)[1:] if not frame.filename.startswith("<frozen ")]
    where = f" ({{frames[-1].filename}}, line {{frames[-1].lineno}})" if frames else ""
    text = " ".join(str(error).split()) or "no message"
    print(f"{MARK}{{type(error).__name__}}: {{text}}{{where}}", file=sys.stderr)
    sys.exit(1)
"""


def require_importable(agent: str) -> None:
    """Refuse an agent ``package.module:callable`` whose module fails when it is imported.

    The import runs in another process: a module that exits, crashes or changes Python harms nothing here. A module
    that is imported here already is not tried.

    Raises
    ------
    InputError
        The import raises an exception or ends its process.
    """
    module = agent.partition(":")[0]
    if module in sys.modules:
        return
    try:
        done = subprocess.run(
            [sys.executable, "-c", TRIAL, module, *sys.path],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=LONGEST_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.startswith(MARK)]
        why = lines[-1].removeprefix(MARK) if lines else f"a process that ends with code {done.returncode}"
        raise InputError(f"agent '{agent}' must be in a module that can be imported, got {why}: correct the module")
