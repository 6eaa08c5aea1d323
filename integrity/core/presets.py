"""Presets: YAML files of the package :mod:`lanebound.configs`, merged deeply, as plain data."""

from __future__ import annotations

import difflib
import itertools
import os
import re
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from lanebound.integrity.core.errors import ConfigError, InputError

__all__ = [
    "FILES", "about_preset", "deep_merge", "load_file", "load_preset", "mapping_of", "nearest", "parse_assignments",
    "parse_yaml", "preset_names", "preset_values", "remove_registered", "require_new", "require_registered",
]  # fmt: skip

PRESET_PACKAGE = "lanebound.configs"
FEW = 8  # largest number of presets listed in a message
SIMILAR = 0.65  # ratio of difflib above which words are similar; one wrong letter of three has 0.67
FILES = (".yaml", ".yml")
VERSION = re.compile(r"-v\d+$")
YAML_FLOAT = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")  # YAML 1.1 reads 1e-7 as text


def nearest(word: str, known: Iterable[str]) -> str:
    """Advice with the closest known word, or with all known words if none is close.

    Close words share most letters, and have a similar length or contain each other. The folder or namespace of a name
    (``lanebound/``) and its version (``-v0``) do not count, so that the rest of a short name can be close.

    >>> nearest("nope", ["np"]), nearest("urbn", ["urban", "dense"])
    ('known are np', "did you mean 'urban'?")
    >>> nearest("LaneKeping", ["lanebound/LaneKeeping-v0", "lanebound/Merge-v0"])
    "did you mean 'lanebound/LaneKeeping-v0'?"
    """
    names, text = sorted(known), _bare(str(word))
    bare = {name: _bare(name) for name in names}
    for close in difflib.get_close_matches(text, sorted(set(bare.values())), n=3, cutoff=SIMILAR):
        long, short = max(len(close), len(text)), min(len(close), len(text))
        if long <= 1.5 * short or text in close or close in text:
            alike = difflib.get_close_matches(str(word), [name for name in names if bare[name] == close], 1, cutoff=0.0)
            return f"did you mean '{alike[0]}'?"
    return f"known are {', '.join(names)}" if names else "none are known"


def _bare(name: str) -> str:
    """A name without what stands before its last slash, and without its version."""
    return VERSION.sub("", name.rpartition("/")[2]) or name


def require_new(what: str, name: str, taken: Collection[str]) -> None:
    """Refuse a name for an extension that is taken, or that is no identifier: names stand in keys, entries and logs.

    Raises
    ------
    InputError
        ``name`` is among ``taken``, or has other characters than letters, digits and underscores.
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise InputError(f"name of {what} must be an identifier, got {name!r}: write it as clock_jump")
    if name in taken:
        raise InputError(f"name of {what} must not be taken, got {name!r}: choose another")


def require_registered(what: str, name: str, registered: Iterable[str]) -> None:
    """Refuse the name of an extension that is not registered.

    Raises
    ------
    InputError
        ``name`` is not among ``registered``.
    """
    known = tuple(registered)
    if name not in known:
        raise InputError(f"{what} must be a registered one, got {name!r}: {nearest(name, known)}")


def remove_registered(what: str, name: str, registered: list[Any], name_of: Callable[[Any], str]) -> None:
    """Remove an extension from a list of registered ones.

    Raises
    ------
    InputError
        None has this name.
    """
    require_registered(what, name, map(name_of, registered))
    registered[:] = [one for one in registered if name_of(one) != name]


def deep_merge(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """Merge ``override`` into a copy of ``base``: mappings key by key; every other value is replaced.

    A mapping over the name of a preset is merged over the values of the preset.
    """
    merged = {key: deep_merge(value, {}) if isinstance(value, Mapping) else value for key, value in base.items()}
    for key, value in override.items():
        old = merged.get(key)
        merged[key] = deep_merge(mapping_of(old), value) if isinstance(value, Mapping) else value
    return merged


def mapping_of(value: Any) -> Mapping[str, Any]:
    """A mapping as it is, the values of a preset for its name (with or without folder), nothing for other values."""
    if isinstance(value, Mapping):
        return value
    return preset_values(value) if isinstance(value, str) and _with_folder(value, _presets()) in _presets() else {}


UNCLOSED = {
    "while parsing a flow sequence": "[",
    "while parsing a flow mapping": "{",
    "while scanning a quoted scalar": "quote",
}
"""What is not closed, by PyYAML's description of what it was reading when it found an error."""
DEEPEST = 50
MOST_VALUES = 20_000


@cache
def _yaml_loader() -> Any:
    """PyYAML's safe loader, extended to read 1e-7 as a number and to refuse repeated keys."""
    import yaml

    class Loader(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            seen = set()
            own = (key for key, _ in node.value if key.tag != "tag:yaml.org,2002:merge")  # << is not a key
            for key in (self.construct_object(key, deep=True) for key in own):
                if not isinstance(key, Hashable):
                    continue  # the safe loader refuses it
                if key in seen:
                    raise yaml.constructor.ConstructorError(None, None, f"key '{key}' twice", node.start_mark)
                seen.add(key)
            return super().construct_mapping(node, deep=deep)

    Loader.add_implicit_resolver("tag:yaml.org,2002:float", YAML_FLOAT, list("-+.0123456789"))
    return Loader


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML text to plain data; ``source`` is the name of the text in errors.

    Raises
    ------
    ConfigError
        The text is not YAML, is nested too deeply, or has too many values after expansion of its aliases.
    """
    import yaml

    try:
        data = yaml.load(text, Loader=_yaml_loader())  # a SafeLoader
    except yaml.YAMLError as exc:
        raise ConfigError(_not_yaml(exc, source)) from exc
    except RecursionError as exc:
        raise ConfigError(f"{source} must be nested at most {DEEPEST} levels, got more: flatten it") from exc
    _require_moderate(data, source)
    return data


def _not_yaml(error: Any, source: str) -> str:
    """The message of an error of PyYAML: the place, what PyYAML read there, and the remedy.

    A bracket or a quotation mark that is not closed is named with its own place, where the remedy applies.
    """
    problem = " ".join(str(getattr(error, "problem", None) or error).split())
    context, begin, mark = (getattr(error, name, None) for name in ("context", "context_mark", "problem_mark"))
    unclosed = UNCLOSED.get(str(context)) if begin is not None else None
    if begin is not None and unclosed is not None:
        sign = begin.get_snippet(indent=0, max_length=1_000_000) if unclosed == "quote" else ""
        opened = (sign.splitlines()[0][begin.column : begin.column + 1] or "'") if unclosed == "quote" else unclosed
        place = f"line {begin.line + 1}, column {begin.column + 1}"
        return f"{source} is not valid YAML, got {opened!r} that is not closed in {place}: close it"
    where = "" if mark is None else f" in line {mark.line + 1}, column {mark.column + 1}"
    return f"{source} is not valid YAML, got {problem}{where}: correct that line"


def _require_moderate(data: Any, source: str) -> None:
    """Refuse data that is too deep or too large to validate: a few aliases can expand to a billion values."""
    count, level = 0, [data]
    for _ in range(DEEPEST):
        below: list[Any] = []
        for inside in map(_inside, level):
            count += len(inside)
            if count > MOST_VALUES:
                raise ConfigError(f"{source} must hold at most {MOST_VALUES} values, got more: use fewer aliases")
            below.extend(inside)
        if not below:
            return
        level = below
    raise ConfigError(f"{source} must be nested at most {DEEPEST} levels, got more: flatten it")


def _inside(part: Any) -> Collection[Any]:
    """The values in a mapping, list, set or tuple; empty for other types."""
    if isinstance(part, Mapping):
        return part.values()
    return part if isinstance(part, list | set | tuple) else ()


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Parse texts such as ``"navigator.dt_s=0.2"`` to nested overrides; values are read as YAML.

    Keys inside a value apply over the value, in any order of the texts: over a mapping, or over a preset by its name.

    Raises
    ------
    ConfigError
        A text is no assignment, or has keys inside another value.
    """
    overrides: dict[str, Any] = {}
    for keys, value in sorted(map(_assignment, assignments), key=lambda parsed: len(parsed[0])):
        _require_inside(overrides, keys)
        for key in reversed(keys):
            value = {key: value}
        overrides = deep_merge(overrides, value)
    return overrides


def _assignment(text: Any) -> tuple[list[str], Any]:
    """The keys and the value of a text."""
    if not isinstance(text, str):
        raise ConfigError(f"an override must be text, got {text!r}: write KEY=VALUE")
    path, equals, value = text.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys):
        raise ConfigError(f"an override must read key=value, got '{text}': 'lanebound config show' lists the keys")
    return keys, parse_yaml(value, f"the value of '{path}'")


def _require_inside(overrides: Any, keys: list[str]) -> None:
    """Refuse keys inside a value that is neither a mapping nor the name of a preset."""
    for count, key in enumerate(keys[:-1], 1):
        if key not in overrides:
            return
        value, overrides = overrides[key], mapping_of(overrides[key])
        if not isinstance(value, Mapping) and not overrides:
            path = ".".join(keys[:count])
            raise ConfigError(
                f"{path} must be a mapping or a preset's name where '{'.'.join(keys)}' is set, got {value!r}: "
                f"set its keys alone (a kind as {path}.kind)"
            )


def _walk(folder: Traversable, prefix: str = "") -> Iterable[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _walk(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".yaml"):
            yield prefix + entry.name.removesuffix(".yaml"), entry


def _presets() -> dict[str, Traversable]:
    return dict(sorted(_walk(resources.files(PRESET_PACKAGE))))


def preset_names() -> list[str]:
    """Names of the packaged presets: their paths below ``configs/`` without ``.yaml``, sorted."""
    return list(_presets())


def about_preset(name: str) -> str:
    """What a preset configures: its own title, or the first sentence of the comment at the head of its file."""
    text = _presets()[name].read_text(encoding="utf-8")
    data = parse_yaml(text, f"preset '{name}'")
    if isinstance(data, Mapping) and isinstance(data.get("title"), str):
        return str(data["title"])
    head = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    comment = " ".join(line.lstrip("# ").rstrip() for line in head)
    return re.split(r"(?<=[.;:])\s", comment, maxsplit=1)[0].rstrip(".;:")


def load_preset(name: str, overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Load the values of preset ``name``, merged over the presets that it extends, with ``overrides`` merged over them.

    A preset may say ``extends: other`` (or a list, later ones win), and so may a mapping inside it, for instance
    ``imu: {extends: sensors/imu_tactical}``. ``kind``, when present at the top, stays in the result. The folder in the
    name of a preset may be left out where only one preset has the rest of the name.

    Raises
    ------
    ConfigError
        A preset is unknown, is not a mapping of YAML, or extends itself.
    """
    return deep_merge(_resolve(name, _presets(), ()), overrides or {})


def preset_values(name: str) -> dict[str, Any]:
    """The values of preset ``name`` without its kind, as :func:`load_preset`.

    Of the kind ``navigator/filter`` the part after the slash remains: the ``kind`` of a configuration that has several.
    """
    data = load_preset(name)
    _, _, inner = str(data.pop("kind", "")).partition("/")
    return {"kind": inner, **data} if inner else data


def load_file(path: Path, what: str, kind: str | None = None) -> dict[str, Any]:
    """Load the values of a user's preset file; ``what`` describes the file in messages.

    The file can extend packaged presets by name, and other files by their paths relative to its folder. With ``kind``,
    a file of another kind is refused, and the key ``kind`` is removed from the values.

    Raises
    ------
    ConfigError
        The file cannot be read, is not a mapping of YAML, is of another kind, or extends itself or an unknown preset.
    """
    data = _read(path, what, _presets(), ())
    if kind is not None and (found := data.pop("kind", kind)) != kind:
        raise ConfigError(f"{what} must be a file of kind {kind}, got {path} of kind {found}: give another file")
    return data


def _read(path: Path, what: str, presets: Mapping[str, Traversable], seen: tuple[str, ...]) -> dict[str, Any]:
    source = os.path.abspath(path)
    _require_new(source, seen)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{what} must be a text file in UTF-8, got {path} with byte {error.object[error.start]:#04x} at "
            f"{error.start}: save it as UTF-8"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{what} must be a file that can be read, got {path} ({error}): correct the path") from None
    return _extended(text, str(path), presets, (*seen, source), path.parent)


def _require_new(name: str, seen: tuple[str, ...]) -> None:
    if name in seen:
        raise ConfigError(f"preset '{name}' extends itself: {' -> '.join((*seen, name))}: remove one 'extends'")


def _nearest_preset(name: str, presets: Iterable[str]) -> str:
    """Advice with the closest preset (by full name or last part), or with the command that lists all presets."""
    names = list(presets)
    by_last = {preset.rpartition("/")[2]: preset for preset in names}
    close = difflib.get_close_matches(name, [*names, *by_last], n=1, cutoff=0.6)
    if close:
        return f"did you mean '{by_last.get(close[0], close[0])}'?"
    return nearest(name, names) if len(names) <= FEW else "'lanebound config list' lists all of them"


def _with_folder(name: str, presets: Iterable[str]) -> str:
    """The full name of a preset that is named without its folder, if it is the only one; other names are unchanged."""
    names = list(presets)
    found = [preset for preset in names if preset.rpartition("/")[2] == name]
    return found[0] if name not in names and len(found) == 1 else name


def _resolve(name: str, presets: Mapping[str, Traversable], seen: tuple[str, ...]) -> dict[str, Any]:
    name = _with_folder(name, presets)
    _require_new(name, seen)
    if name not in presets:
        where = f" (extended by '{seen[-1]}')" if seen else ""
        raise ConfigError(f"preset '{name}'{where} is unknown: {_nearest_preset(name, presets)}")
    return _extended(presets[name].read_text(encoding="utf-8"), f"preset '{name}'", presets, (*seen, name))


def _extended(
    text: str, source: str, presets: Mapping[str, Traversable], seen: tuple[str, ...], folder: Path | None = None
) -> dict[str, Any]:
    """The values of a text, merged over what it extends: presets, and files if the text is a file in ``folder``."""
    data = parse_yaml(text, source)
    if not isinstance(data, Mapping):
        raise ConfigError(f"{source} must be a mapping, got {type(data).__name__}: write lines 'key: value'")
    own = dict(data)
    parents = own.pop("extends", [])
    parents = [parents] if isinstance(parents, str) else parents
    if not isinstance(parents, list) or not all(isinstance(parent, str) for parent in parents):
        raise ConfigError(f"extends of {source} must be a name or a list of names, got {parents!r}: correct it")
    merged: dict[str, Any] = {}
    for parent in parents:
        if folder is not None and parent.endswith(FILES):
            merged = deep_merge(merged, _read(folder / parent, f"the base of {source}", presets, seen))
        else:
            merged = deep_merge(merged, _resolve(parent, presets, seen))
    return deep_merge(merged, _parts_extended(own, source, presets, seen))


def _parts_extended(
    data: Mapping[str, Any], source: str, presets: Mapping[str, Traversable], seen: tuple[str, ...]
) -> dict[str, Any]:
    """The data with the mappings inside them over the packaged presets that these extend, without their kinds."""
    out: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, Mapping):
            below = dict(value)
            parent = below.pop("extends", None)
            if parent is not None and not isinstance(parent, str):
                raise ConfigError(f"extends of '{key}' in {source} must be a name, got {parent!r}: correct it")
            base = {} if parent is None else _resolve(parent, presets, seen)
            base.pop("kind", None)
            out[key] = deep_merge(base, _parts_extended(below, source, presets, seen))
        else:
            out[key] = value
    return out
