"""Typed configuration: frozen models that refuse unknown keys, wrong types and values out of range with clear messages.

>>> class Receiver(Config):
...     rate_hz: float = Field(10.0, gt=0, description="epochs in a second [Hz]; S1 section 4")
>>> Receiver.load({"rate_hz": 5}).rate_hz
5.0
>>> Receiver(rate_hz=-1.0)
Traceback (most recent call last):
lanebound.integrity.core.errors.ConfigError: rate_hz must be > 0, got -1.0: correct that value (the default is 10.0)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from functools import lru_cache
from typing import Any, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from lanebound.integrity.core.config_errors import explain, model_in
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import deep_merge, load_preset, mapping_of, preset_names, preset_values

__all__ = ["Config", "ConfigValue", "Field", "deep_merge", "describe", "load_preset", "preset_names", "unit_of"]

UNITS = {
    "bps": "bit/s",
    "cm": "cm",
    "cycles": "cycles",
    "db": "dB",
    "dbhz": "dB-Hz",
    "deg": "deg",
    "degps": "deg/s",
    "dps": "deg/s",
    "g": "g",
    "h": "h",
    "hz": "Hz",
    "km": "km",
    "kmph": "km/h",
    "m": "m",
    "m2": "m^2",
    "mhz": "MHz",
    "min": "min",
    "mm": "mm",
    "mps": "m/s",
    "mps2": "m/s^2",
    "mps3": "m/s^3",
    "ms": "ms",
    "ns": "ns",
    "pct": "%",
    "ppm": "ppm",
    "rad": "rad",
    "radps": "rad/s",
    "radps2": "rad/s^2",
    "s": "s",
    "us": "us",
}
HASH = "_hash"  # key of the cached hash in ``__dict__``
ROOTS = {f"sqrt_{name}": f"sqrt({unit})" for name, unit in UNITS.items()}


class Config(BaseModel):
    """Base class of all configurations: frozen, no unknown keys, finite numbers, defaults also validated.

    An invalid value raises :class:`~lanebound.integrity.core.errors.ConfigError` with one line for each problem. Text
    and booleans are not converted to numbers. An int is accepted as a float and a list as a tuple, because YAML needs
    this.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise ConfigError(explain(type(self), error)) from None

    # pydantic then validates nested models without a call of this __init__, and paths in messages are complete
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def __hash__(self) -> int:
        """Hash of type and values, computed once: configurations are cache keys in inner loops."""
        found = self.__dict__.get(HASH)
        if found is None:
            found = hash((type(self), *(self.__dict__[name] for name in type(self).model_fields)))
            self.__dict__[HASH] = found
        return int(found)

    def __getstate__(self) -> dict[Any, Any]:
        """State without the hash, because hashes of text differ between processes."""
        state = super().__getstate__()
        return {**state, "__dict__": {name: value for name, value in state["__dict__"].items() if name != HASH}}

    @field_validator("*", mode="wrap")
    @classmethod
    def _refuse_coercion(cls, raw: Any, handler: Any, info: ValidationInfo) -> Any:
        value = handler(_completed(cls, info.field_name, raw))
        _check_same_kind(raw, value)
        _check_finite(str(info.field_name), value)
        return value

    @classmethod
    def load(cls, data: Mapping[str, Any], path: str = "", unchanged: Mapping[str, Any] | None = None) -> Self:
        """Build the configuration from plain data; ``path`` is the prefix of every key in messages.

        ``unchanged`` is the data before the changes of a user; messages give its values.

        Raises
        ------
        ConfigError
            One line for each problem: dotted path, bound, value, remedy.
        """
        if not isinstance(data, Mapping):
            raise ConfigError(f"{path or cls.__name__} must be a mapping, got {data!r}: write keys and values")
        try:
            return cls.model_validate(dict(data))
        except ValidationError as error:
            raise ConfigError(explain(cls, error, path, unchanged)) from None

    @classmethod
    def build(cls, data: Mapping[str, Any] | Self | None = None, overrides: Mapping[str, Any] | None = None) -> Self:
        """Build the configuration from plain data, another configuration or nothing, with ``overrides`` merged deeply.

        Raises
        ------
        ConfigError
            As :meth:`load`.
        """
        base = data.model_dump() if isinstance(data, Config) else data or {}
        if isinstance(base, str):
            raise ConfigError(f"{cls.__name__} must be a mapping, got {base!r}: write {cls.__name__}.preset({base!r})")
        return cls.load(_merged(cls, base, overrides or {}), unchanged=base)

    @classmethod
    def kept(cls, base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
        """The part of ``base`` that remains valid with ``changes``: all of it, unless the kind changes."""
        return dict(base)

    @classmethod
    def preset(cls, name: str, overrides: Mapping[str, Any] | None = None) -> Self:
        """Build the configuration of a packaged preset with ``overrides`` merged deeply."""
        return cls.load(deep_merge(preset_values(name), overrides or {}))

    def replace(self, **changes: Any) -> Self:
        """A validated copy with ``changes``; a mapping changes only its own keys."""
        return type(self).build(self, changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain data (numbers, text, lists, mappings) for ``load`` and JSON."""
        return self.model_dump(mode="json")

    def to_json(self) -> str:
        """JSON text for ``from_json``."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Build the configuration from JSON text.

        Raises
        ------
        ConfigError
            The text is not JSON, or a value is invalid.
        """
        import json

        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{cls.__name__} must be given as JSON, got {error}: correct the text") from error
        return cls.load(data)


def _merged(model: type[BaseModel] | None, base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """``deep_merge`` that also handles configurations whose kind changes."""
    merged = deep_merge(model.kept(base, changes) if model is not None and issubclass(model, Config) else base, {})
    for key, value in changes.items():
        old = merged.get(key)
        field = model.model_fields.get(key) if model is not None else None
        inside = model_in(field.annotation) if field is not None else None
        if isinstance(value, Mapping):
            merged[key] = _merged(inside, mapping_of(old), value)
        else:
            merged[key] = value
    return merged


def _completed(model: type[BaseModel], name: str | None, raw: Any) -> Any:
    """A mapping for a field whose default is a configuration of other values than those of its class, on top of it.

    A mapping changes only its own keys: what it leaves out is that of the field's default.
    """
    if not isinstance(raw, Mapping) or name is None:
        return raw
    own = _own_default(model, name)
    return raw if own is None else _merged(type(own), own.model_dump(), raw)


@lru_cache(maxsize=1024)
def _own_default(model: type[BaseModel], name: str) -> Config | None:
    """The default of a field, where it is a configuration that differs from that of its class."""
    default = model.model_fields[name].default
    if not isinstance(default, Config) or any(field.is_required() for field in type(default).model_fields.values()):
        return default if isinstance(default, Config) else None
    return None if default == type(default)() else default


def _check_same_kind(raw: Any, value: Any) -> None:
    """Refuse a number converted from text or from a boolean, at any depth of a sequence or mapping."""
    if isinstance(value, Config | Enum | str) or value is raw:
        return
    if isinstance(value, bool) and not isinstance(raw, bool):
        raise PydanticCustomError("bool_type", "Input should be true or false")
    if isinstance(value, int | float) and isinstance(raw, str | bytes | bool):
        raise PydanticCustomError("int_type" if isinstance(value, int) else "float_type", "Input should be a number")
    if isinstance(value, Mapping) and isinstance(raw, Mapping):
        for old, new in zip(raw.values(), value.values(), strict=True):
            _check_same_kind(old, new)
    elif isinstance(value, Sequence) and isinstance(raw, Sequence):
        for old, new in zip(raw, value, strict=True):
            _check_same_kind(old, new)


def _check_finite(name: str, value: Any) -> None:
    """Refuse plain data with a number that is not finite, which JSON would turn into ``null``."""
    where = _not_finite(value) if isinstance(value, Mapping) else None
    if where is not None:
        raise ValueError(f"{name}.{where[0]} must be finite, got {where[1]}: correct that value")


def _not_finite(data: Any) -> tuple[str, float] | None:
    """Path and value of the first number in plain data that is not finite."""
    items = data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list | tuple) else ()
    for key, value in items:
        if isinstance(value, float) and not math.isfinite(value):
            return str(key), value
        below = _not_finite(value)
        if below is not None:
            return f"{key}.{below[0]}", below[1]
    return None


class ConfigValue(NamedTuple):
    """One value of a configuration: dotted path, value, unit ("" for a dimensionless number) and description."""

    path: str
    value: Any
    unit: str
    description: str


def unit_of(name: str) -> str:
    """Unit in the suffix of a field name: ``"speed_mps"`` -> ``"m/s"``, ``"faults_per_h"`` -> ``"1/h"``."""
    head, *below = name.split("_per_")
    top = _suffix(head)
    if not below:
        return top
    return "/".join([top or "1", *(ROOTS.get(part) or UNITS.get(part, part) for part in below)])


def _suffix(name: str) -> str:
    return UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""


def describe(config: BaseModel, path: str = "") -> list[ConfigValue]:
    """List every value of a configuration, in the order of its fields.

    The unit is the one in brackets in the description of the field, otherwise the one in the suffix of its name.
    """
    return list(_entries(config, path))


def _entries(config: BaseModel, path: str) -> Iterator[ConfigValue]:
    fields = type(config).model_fields
    for name in [*fields, *(config.model_extra or ())]:
        value = getattr(config, name)
        where = f"{path}.{name}" if path else name
        items = _nested(value, where)
        if items:
            for below, model in items:
                yield from _entries(model, below)
            continue
        text = (fields[name].description or "") if name in fields else ""
        bracket = re.search(r"\s*\[([^\]]*)\]", text)
        unit = bracket[1] if bracket else unit_of(name)
        if bracket:
            text = text[: bracket.start()] + text[bracket.end() :]
        yield ConfigValue(where, value, "" if unit == "-" else unit, text)


def _nested(value: Any, path: str) -> list[tuple[str, BaseModel]]:
    """The configurations inside a value, with their paths."""
    if isinstance(value, BaseModel):
        return [(path, value)]
    if isinstance(value, Mapping):
        inside = [(f"{path}.{key}", item) for key, item in value.items()]
    elif isinstance(value, list | tuple):
        inside = [(f"{path}.{i}", item) for i, item in enumerate(value)]
    else:
        return []
    return [(where, item) for where, item in inside if isinstance(item, BaseModel)]
