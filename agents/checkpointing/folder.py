"""Result folders: a manifest says what a folder holds; other work, other versions and foreign files are refused.

::

    run.json    manifest: kind of the work, configuration, digest of the defaults, versions of the code and of packages
    .lock       locked while a process writes results

All other names belong to the kind of the work.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lanebound.agents.checkpointing.files import make_folder, read_json, write_json
from lanebound.agents.plugins import loaded_plugins
from lanebound.integrity.core.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: folders are not locked there
    fcntl = None  # type: ignore[assignment]


MANIFEST, LOCK = "run.json", ".lock"
FORMAT = 1
OTHERS = ("experiments/", "studies/", "suites/")  # presets of commands, which no other command takes values from
PACKAGES = ("numpy", "numba", "scipy", "gymnasium", "highway-env")
SHOWN = 3  # names or values in a message
_begun: list[ResultFolder] = []
_held: set[Path] = set()  # folders that this process has locked


@dataclass(frozen=True)
class ResultFolder:
    """A folder of results of one kind of work.

    Attributes
    ----------
    path : the folder; it need not exist before :meth:`claim`
    kind : kind of the work, such as ``benchmark``
    config : configuration of the work
    source : digest of the code that the results follow from; with it the versions of numerical packages count too
    fixed : values that must not change; ``config`` by default, nothing where that is None
    growing : keys of mappings in ``fixed`` to which entries may be added
    extra : further entries of the manifest
    remedy : last part of a refusal
    """

    path: Path
    kind: str
    config: Mapping[str, Any] | None = None
    source: str = ""
    fixed: Mapping[str, Any] | None = None
    growing: Collection[str] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    remedy: str = "choose a new folder"

    def claim(self, anew: bool = False) -> None:
        """Write the manifest.

        Parameters
        ----------
        anew : what the folder holds of this kind of work was removed, so that it is not compared

        Raises
        ------
        InputError
            As :meth:`check`, or the folder cannot be written.
        """
        before, fixed = {} if anew else self.check().get("fixed", {}), self._fixed()
        if not (self.path / MANIFEST).exists():
            _begun.append(self)
        make_folder(self.path)
        for key in self.growing:
            fixed[key] = {**before.get(key, {}), **fixed[key]}
        head = {"format": FORMAT, "kind": self.kind, "version": version("lanebound"), "source": self.source}
        made_with = {"defaults": defaults_digest(), "plugins": plugin_digests(), "packages": package_versions()}
        data = {"config": self.config, "fixed": fixed, **self.extra}
        write_json(self.path / MANIFEST, head | made_with | data)

    def check(self) -> dict[str, Any]:
        """The manifest of a folder that can be claimed; empty for a new folder.

        Raises
        ------
        InputError
            The folder holds other work, results of another version, or foreign files.
        """
        if not (self.path / MANIFEST).exists():
            foreign = _names_in(self.path)
            if foreign:
                raise self._refusal(f"with files of other origin ({_few(foreign)})", "choose a new folder")
            return {}
        found = self._read()
        if self.source and (other := _other_version(found, self.source)):
            raise self._refusal(f"of another version of {other}", self.remedy)
        compared = None if self.config is None and self.fixed is None else self._fixed()
        if compared is not None and (changed := _changed(found.get("fixed", {}), compared, self.growing)):
            raise self._refusal(f"which differs in {_few(changed)}", self.remedy)
        return found

    def release(self) -> None:
        """Give a claimed folder back that holds no results, so that other work may claim it."""
        if set(_names_in(self.path)) <= {MANIFEST}:
            (self.path / MANIFEST).unlink(missing_ok=True)

    @staticmethod
    def release_begun() -> None:
        """Release the folders that this process was the first to claim: a command that is refused leaves none."""
        while _begun:
            _begun.pop().release()

    def manifest(self) -> dict[str, Any]:
        """The manifest of a claimed folder.

        Raises
        ------
        InputError
            There is none, it is damaged, or it is of another kind.
        """
        if not (self.path / MANIFEST).exists():
            what = f"{self.path} without {MANIFEST}" if self.path.exists() else f"{self.path}, which does not exist"
            raise InputError(f"the folder must hold a {self.kind}, got {what}: give the folder of its --out")
        return self._read()

    def _read(self) -> dict[str, Any]:
        try:
            found = read_json(self.path / MANIFEST, dict)
        except OSError as error:
            raise InputError(f"{self.path / MANIFEST} cannot be read ({error}): choose a new folder") from None
        if found.get("format") != FORMAT:
            raise self._refusal(f"whose {MANIFEST} is of another version of lanebound", "choose a new folder")
        if found.get("kind") != self.kind:
            raise self._refusal(f"with the results of a {found.get('kind')}", "choose another folder")
        return found

    def _fixed(self) -> dict[str, Any]:
        """What must not change, as JSON returns it: tuples are lists, keys are text."""
        return dict(json.loads(json.dumps(self.config or {} if self.fixed is None else self.fixed)))

    def _refusal(self, found: str, remedy: str) -> InputError:
        return InputError(f"the folder must be empty or hold the same {self.kind}, got {self.path} {found}: {remedy}")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """In this context no other process can lock the folder; this process may lock it again.

    Raises
    ------
    InputError
        Another process has locked it.
    """
    key = folder.resolve()
    if fcntl is None or key in _held:
        yield
        return
    with (folder / LOCK).open("a+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"out must not be in use by another process, got {folder}: wait for that process or end it"
            ) from None
        except OSError:  # a file system without locks
            pass
        _held.add(key)
        try:
            yield
        finally:
            _held.remove(key)


def _names_in(folder: Path) -> list[str]:
    """Names in a folder but hidden ones; none where it does not exist."""
    try:
        return sorted(name for name in os.listdir(folder) if not name.startswith("."))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"out must be a folder that can be written, got {folder} ({error}): choose another") from None


def _leaves(tree: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Values of nested mappings by their dotted paths."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= _leaves(value, f"{path}{key}.") if isinstance(value, Mapping) else {f"{path}{key}": value}
    return found


def _changed(then: Mapping[str, Any], now: Mapping[str, Any], growing: Collection[str]) -> list[str]:
    """Paths whose values differ, with both values."""
    old, new = _leaves(then), _leaves(now)
    differing = [key for key in sorted(old | new) if old.get(key) != new.get(key)]
    kept = [key for key in differing if key.partition(".")[0] not in growing or (key in old and key in new)]
    return [f"{key} ({_short(old.get(key))} there, now {_short(new.get(key))})" for key in kept]


def _other_version(found: Mapping[str, Any], source: str) -> str:
    """What has another version than in a manifest; "" where nothing has."""
    if found.get("source") != source:
        return f"the code ({found.get('version')}, {found.get('source')})"
    then, now = found.get("plugins", {}), plugin_digests()
    for name in sorted(then.keys() | now.keys()):
        if then.get(name) != now.get(name):
            changed = "changed since" if name in then and name in now else "new" if name in now else "not loaded now"
            return f"the plug-in {name} ({changed})"
    then = found.get("packages", {})
    moved = next((name for name, version in package_versions().items() if then.get(name) != version), None)
    return "" if moved is None else f"{moved} ({then.get(moved, 'not recorded')})"


def _few(texts: list[str]) -> str:
    return ", ".join(texts[:SHOWN]) + (f" and {len(texts) - SHOWN} more" if len(texts) > SHOWN else "")


def _short(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


@cache
def code_digest(*sources: str) -> str:
    """Digest of Python and YAML files, as they are at the first call.

    Parameters
    ----------
    sources : packages, with all below them, or single files as ``package:file.py``; suites are no part of a result
    """
    found = hashlib.blake2b(digest_size=8)
    for source in sources:
        package, _, name = source.partition(":")
        root = Path(str(resources.files(package)))
        files = [root / name] if name else (path for path in root.rglob("*") if path.suffix in (".py", ".yaml"))
        for path in sorted(files):
            if "suites" not in path.parts:
                found.update(path.read_bytes())
    return found.hexdigest()


def plugin_digests() -> dict[str, str]:
    """Digests of the files of the plug-ins that are loaded, by file name."""
    files = [Path(file) for file in filter(None, loaded_plugins().values())]
    return {file.name: hashlib.blake2b(file.read_bytes(), digest_size=8).hexdigest() for file in files}


@cache
def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages whose arithmetic results follow from."""
    return {"Python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


@cache
def defaults_digest() -> str:
    """Eight hexadecimal digits of the default navigator, the ids as shipped, and the packaged presets they may name.

    They say which configuration a result was made with where it names none. Constants in the code are no part of them;
    the manifest of a result folder has a digest of the code too.
    """
    # Imported here because environments take a second to import, and most commands refuse or show something only.
    from lanebound.envs.ids import IDS
    from lanebound.envs.registration import make_config
    from lanebound.integrity.core.presets import load_preset, preset_names
    from lanebound.integrity.navigators.navigator import NavigatorConfig

    presets = {name: load_preset(name) for name in preset_names() if not name.startswith(OTHERS)}
    ids = {name: make_config(name).to_dict() for name in sorted(IDS) if name.startswith("lanebound/")}
    values = {"navigator": NavigatorConfig().to_dict(), "ids": ids, "presets": presets}
    return hashlib.blake2b(json.dumps(values, sort_keys=True).encode(), digest_size=4).hexdigest()
