"""Types of a program do not enter the cache of the package."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_types_of_a_script_do_not_enter_the_cache_that_processes_share(tmp_path: Path) -> None:
    """Otherwise no other process could load any kernel of the file that has it."""
    script = tmp_path / "own.py"
    script.write_text(
        "from typing import Any, NamedTuple\n"
        "import numpy as np\n"
        "from lanebound.integrity.core.bundle_kernel import Bundle\n"
        "class Own(NamedTuple):\n"
        "    a: Any\n"
        "assert Bundle(Own(np.zeros(3))).handle.shape == (1,)\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, str(script)], check=True, env=environment)
    assert not list(tmp_path.rglob("bundle_kernel.*.nbi"))
