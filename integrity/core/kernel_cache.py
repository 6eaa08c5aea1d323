"""Where compiled kernels are cached on disk, and for which sources.

Numba's cache depends on the source file of a kernel but not on the source files of its callees. The kernels of a file
therefore have a directory whose name contains a digest of that file and of all files that it imports, directly or not
(:func:`sources_of`). A change compiles only kernels that depend on it, and copies of the package with the same sources
(another clone, another environment) share their kernels, since the path of the package does not enter.

The cache contains machine code. Below the temporary directory, which all users share, a directory is used only if it is
private to the user. Without a writable directory the kernels are compiled in each process.

A wheel for one platform contains compiled kernels (``.ci/kernels``). Their directories have the same names and are
copied to the cache instead of being compiled there, where the processor is one of those they are compiled for.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import llvmlite.binding
import numba
from numba.core.caching import UserProvidedCacheLocator

__all__ = ["PORTABLE", "KernelLocator", "cache_directory", "cache_root", "locating", "sources_of", "takes_shipped"]

PACKAGE = "lanebound"
LAYERS = "integrity", "envs", "agents"
UNUSED_S = 30 * 86400.0
SHIPPED = Path(__file__).parents[1] / "compiled"
PORTABLE = "x86_64-unknown-linux-gnu", "x86-64-v3", ""
"""Platform, processor and further features of the shipped kernels, as Numba names them."""
PORTABLE_NEEDS = frozenset({"avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"})  # x86-64 psABI, table 3.1
NAMED_TUPLE = re.compile(rb"^class \w+\(NamedTuple\):\n(?:(?:[ \t].*)?\n)+", re.MULTILINE)
IMPORT = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]+)", re.MULTILINE)


class KernelLocator(UserProvidedCacheLocator):
    """Numba's directory of a kernel is the configured one itself, whose name identifies the sources."""

    def __init__(self, py_func: object, py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[no-untyped-call]
        self._cache_path = str(numba.config.CACHE_DIR)  # type: ignore[attr-defined]

    def get_cache_path(self) -> str:
        """The directory of the kernel."""
        return str(self._cache_path)


@contextmanager
def locating(directory: str) -> Iterator[None]:
    """Context in which Numba caches in ``directory``; its settings are restored afterwards."""
    config = numba.config
    locator = f"{KernelLocator.__module__}.{KernelLocator.__qualname__}"
    before = {name: getattr(config, name, "") for name in ("CACHE_DIR", "CACHE_LOCATOR_CLASSES")}
    try:
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = directory, locator  # type: ignore[attr-defined]
        yield
    finally:
        for name, value in before.items():
            setattr(config, name, value)


def cache_directory(source: Path, options: str = "") -> str | None:
    """A writable directory for the kernels of one file with some options of the compiler, or None."""
    root = cache_root()
    if root is None:
        return None
    digest = hashlib.blake2b(options.encode() + _named_tuples() + repr(_importable()).encode(), digest_size=8)
    for text in sorted(map(_bytes, sources_of(source))):
        digest.update(text)
    path = root / f"kernels-{source.stem}-{digest.hexdigest()}"
    try:
        if not path.exists():
            _remove_unused(root)
            _take_shipped(path)
        path.mkdir(exist_ok=True)
        os.utime(path)
    except OSError:
        return None
    return str(path)


@cache
def takes_shipped() -> bool:
    """Whether kernels are shipped that this processor runs; not where Numba is told to compile for another one."""
    if not SHIPPED.is_dir() or numba.config.CPU_NAME is not None:  # type: ignore[attr-defined]
        return False
    there = llvmlite.binding.get_host_cpu_features()
    return all(there.get(name, False) for name in PORTABLE_NEEDS)


def _take_shipped(path: Path) -> None:
    """Fill a new directory of the cache with the shipped kernels of its name, at once for other processes."""
    shipped, ours = SHIPPED / path.name, path.with_name(f"{path.name}.{os.getpid()}")
    if takes_shipped() and shipped.is_dir():
        shutil.copytree(shipped, ours)
        try:
            ours.rename(path)
        except OSError:  # another process was first
            shutil.rmtree(ours, ignore_errors=True)


@cache
def _importable() -> tuple[bool, ...]:
    """Whether the packages that the environments need are installed.

    The cache names NamedTuples by their module; with those of the environments no other installation could load it.
    """
    return tuple(find_spec(name) is not None for name in ("gymnasium", "highway_env"))


@cache
def _named_tuples() -> bytes:
    """Digest of the NamedTuples of all kernel files, which a kernel can take without importing them.

    Numba recognises a NamedTuple by its name and the types of its fields, and not by their names.
    """
    digest = hashlib.blake2b(digest_size=8)
    for layer in LAYERS:
        for file in sorted((Path(__file__).parents[2] / layer).rglob("*_kernel.py")):
            for definition in NAMED_TUPLE.findall(_bytes(file)):
                digest.update(definition)
    return digest.digest()


@cache
def sources_of(source: Path) -> frozenset[Path]:
    """A file and the files that it imports, directly or not: those of lanebound, and those in its folder."""
    found: set[Path] = set()
    waiting = [source]
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting.extend(_imports(file))
    return frozenset(found)


@cache
def _imports(file: Path) -> tuple[Path, ...]:
    """Files that a file imports by ``from module import ...``."""
    found = []
    for module, names in IMPORT.findall(_bytes(file).decode("utf-8", "replace")):
        parts = module.split(".")
        place = Path(__file__).parents[2] if parts[0] == PACKAGE else file.parent
        base = place.joinpath(*parts[1:] if parts[0] == PACKAGE else parts)
        inner = [base / name for name in re.findall(r"\w+", names)]
        found += [path.with_suffix(".py") for path in (base, *inner) if path.with_suffix(".py").is_file()]
    return tuple(found)


@cache
def _bytes(file: Path) -> bytes:
    return file.read_bytes()


@cache
def cache_root() -> Path | None:
    """A writable directory for compiled kernels and streets, or None."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    places: tuple[Callable[[], Path], ...] = (lambda: Path(base).expanduser() / PACKAGE, _shared, _fresh)
    for place in places:
        try:
            path = place()
            path.mkdir(parents=True, exist_ok=True)
        except (OSError, RuntimeError):  # not writable, not private, no temporary directory or no home directory
            continue
        if os.access(path, os.W_OK):
            return path
    return None


def _remove_unused(folder: Path) -> None:
    """Remove kernels of other versions that no process has used for a month; each start updates the folder's time."""
    for old in folder.glob("kernels-*"):
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > UNUSED_S:
                shutil.rmtree(old, ignore_errors=True)


def _shared() -> Path:
    """The directory of this user below the temporary directory; it is created if it is missing.

    Raises
    ------
    OSError
        The directory cannot be created, or another user can write into it.
    """
    path = Path(tempfile.gettempdir()) / f"{PACKAGE}-{_user()}"
    with suppress(FileExistsError):
        path.mkdir(mode=0o700)
    if not _is_private(path):
        raise PermissionError(f"{path} must be a directory of this user alone")
    return path


def _user() -> int:
    """Number of the user; 0 on Windows, where the temporary directory is not shared."""
    return os.getuid() if hasattr(os, "getuid") else 0


def _is_private(path: Path) -> bool:
    """Whether a path is a directory (not a link) of this user with mode 0700."""
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode):
        return False
    return os.name == "nt" or (found.st_uid == _user() and stat.S_IMODE(found.st_mode) == 0o700)


def _fresh() -> Path:
    """A new private directory of this process, removed when it ends."""
    path = tempfile.mkdtemp(prefix=f"{PACKAGE}-")
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # not in a forked child
            shutil.rmtree(path, ignore_errors=True)

    atexit.register(remove)
    return Path(path)
