"""The package is what the repository holds, and its layers stand in their order."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]
LAYERS = ("agents", "configs", "envs", "integrity")
PARTS = ("envs", "agents", "learning")  # extras, each above the one before
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def folders_with_init() -> list[str]:
    inits = (path for layer in LAYERS for path in (ROOT / layer).rglob("__init__.py"))
    return sorted("lanebound." + ".".join(path.parent.relative_to(ROOT).parts) for path in inits)


def test_every_package_is_listed():
    assert PROJECT["tool"]["setuptools"]["packages"] == folders_with_init()


def test_no_module_lies_in_a_folder_without_init():
    modules = (path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))
    assert [str(path.relative_to(ROOT)) for path in modules if not (path.parent / "__init__.py").exists()] == []


def test_lanebound_itself_is_a_namespace():
    import lanebound

    assert getattr(lanebound, "__file__", None) is None


def test_data_files_are_packaged():
    patterns = PROJECT["tool"]["setuptools"]["package-data"]
    folders = {package: ROOT.joinpath(*package.split(".")[1:]) for package in patterns}
    packaged = {
        path for package in patterns for pattern in patterns[package] for path in folders[package].glob(pattern)
    }
    files = (path for layer in LAYERS for path in (ROOT / layer).rglob("*") if path.is_file())
    data = {path for path in files if path.suffix != ".py" and "__pycache__" not in path.parts}
    assert data
    assert data <= packaged


BUILD = "import sys, build_backend as b; print(getattr(b, 'build_' + sys.argv[1])(sys.argv[2]))"


def built(kind: str, source: Path, out: Path) -> set[str]:
    """Names in a wheel or source archive of a source tree."""
    done = subprocess.run(
        [sys.executable, "-c", BUILD, kind, str(out)], cwd=source, capture_output=True, text=True, check=True
    )
    archive = out / done.stdout.splitlines()[-1]
    if kind == "wheel":
        return set(ZipFile(archive).namelist())
    with tarfile.open(archive) as sdist:
        return {name.partition("/")[2] for name in sdist.getnames()}


def test_a_wheel_leaves_nothing_in_the_clone_and_holds_no_module_that_was_deleted(tmp_path):
    clone, out = tmp_path / "clone", tmp_path / "out"
    out.mkdir()
    for layer in LAYERS:
        shutil.copytree(ROOT / layer, clone / layer, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "build_backend.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, clone)
    before = sorted(path.name for path in clone.iterdir())
    modules = {f"lanebound/{path.relative_to(clone)}" for layer in LAYERS for path in (clone / layer).rglob("*.py")}
    assert {name for name in built("wheel", clone, out) if name.endswith(".py")} == modules
    (clone / "envs" / "wrappers.py").rename(clone / "envs" / "wrapping.py")
    later = built("wheel", clone, out)
    assert "lanebound/envs/wrapping.py" in later
    assert "lanebound/envs/wrappers.py" not in later
    assert sorted(path.name for path in clone.iterdir() if path.name != "__pycache__") == before
    assert {"build_backend.py", "envs/wrapping.py"} <= built("sdist", clone, out)


def test_type_checkers_read_the_annotations_of_each_layer():
    """A namespace has no marker of its own (PEP 561): each package in it has one."""
    patterns = PROJECT["tool"]["setuptools"]["package-data"]
    for layer in LAYERS:
        assert (ROOT / layer / "py.typed").is_file()
        assert "py.typed" in patterns[f"lanebound.{layer}"]


def test_versions_agree():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (\S+)$", citation, re.MULTILINE)[1] == PROJECT["project"]["version"]
    assert metadata.version("lanebound") == PROJECT["project"]["version"]


def requirement_names(lines: list[str]) -> set[str]:
    names = (re.match(r"[A-Za-z0-9._-]+", line) for line in lines)
    return {re.sub(r"[-_.]+", "-", name[0]).lower() for name in names if name}


def test_every_requirement_is_pinned():
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(line for name in PARTS for line in extras[name]), *extras["dev"]]
    wanted = [line for line in wanted if not line.startswith("lanebound[")]
    pinned = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert all(line.startswith("#") or "==" in line for line in pinned)
    assert requirement_names(wanted) <= requirement_names([line for line in pinned if not line.startswith("#")])


def test_each_extra_contains_the_one_below():
    extras = PROJECT["project"]["optional-dependencies"]
    for below, extra in pairwise((*PARTS, "dev")):
        assert f"lanebound[{below}]" in extras[extra]


def test_the_navigation_layer_installs_without_simulators_and_learners():
    base = requirement_names(PROJECT["project"]["dependencies"])
    assert not base & {"gymnasium", "highway-env", "stable-baselines3", "torch", "pygame-ce", "typer"}
    assert {"torch", "typer"} <= requirement_names(PROJECT["project"]["optional-dependencies"]["agents"])


def test_the_command_says_what_is_missing_without_its_packages():
    code = "import sys; sys.modules['typer'] = None; from lanebound.agents import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("error: the command line needs the package typer, got none: install lanebound with")
    assert done.stderr.count("\n") == 1


IMPORT_ALL = """
import importlib, pkgutil, sys
package = importlib.import_module("lanebound.integrity")
for item in pkgutil.walk_packages(package.__path__, "lanebound.integrity."):
    importlib.import_module(item.name)
print(*sorted({name for name in sys.modules}))
"""


@pytest.fixture(scope="module")
def modules_of_integrity() -> set[str]:
    """Names of all modules loaded by a process that imports all of integrity."""
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "stranger",
    ["gymnasium", "highway_env", "torch", "stable_baselines3", "pygame", "typer", "lanebound.envs", "lanebound.agents"],
)
def test_integrity_stands_alone(modules_of_integrity, stranger):
    assert "lanebound.integrity.core.errors" in modules_of_integrity
    assert stranger not in modules_of_integrity


def test_the_smoke_test_of_the_wheel_covers_every_layer():
    text = (ROOT / "tests" / "house" / "smoke_wheel.py").read_text(encoding="utf-8")
    assert f"LAYERS = {LAYERS}".replace("'", '"') in text
