"""The order of the layers, as import-linter proves it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_imports_follow_the_layers():
    linter = Path(sys.executable).parent / "lint-imports"
    done = subprocess.run(
        [str(linter), "--no-cache", "--no-logo"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_kernels_know_kernels_alone():
    """What else they took constants from could change without their compiled form: the cache looks at kernels only."""
    own = re.compile(r"^from (lanebound\S*) import (.*)$", re.M)
    strangers = [
        f"{path.relative_to(ROOT)}: {module} {names}"
        for layer in ("integrity", "envs")
        for path in sorted((ROOT / layer).rglob("*_kernel.py"))
        for module, names in own.findall(path.read_text())
        if not (module.endswith(("_kernel", ".accel", ".records")) or "_kernel" in names)
    ]
    assert not strangers
