"""The order of the layers, as import-linter proves it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
KNOWN = "_kernel", ".accel", ".records", ".kernel_dispatcher", ".compile_ahead"


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
        if not (module.endswith(KNOWN) or "_kernel" in names)
    ]
    assert not strangers


def test_class_names_are_unique():
    """A class has a name of its own: a reader finds what a name means without its module."""
    places = defaultdict(list)
    for layer in ("integrity", "envs", "agents"):
        for path in sorted((ROOT / layer).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_functions_take_twelve_arguments_at_most():
    """More belong into a record; a kernel may take 16. Names with an underscore are options that a parser handles."""
    long = []
    for layer in ("integrity", "envs", "agents"):
        for path in sorted((ROOT / layer).rglob("*.py")):
            most = 16 if path.stem.endswith("_kernel") else 12
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef):
                    names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                    if len([name for name in names if name not in ("self", "cls") and name[0] != "_"]) > most:
                        long.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.name}")
    assert not long
