"""Configurations of several kinds: a tag in the data selects the class; new kinds are registered with a decorator.

>>> class Shape(Tagged, tag="kind"):
...     area_m2: float = 0.0
>>> @Shape.register
... class Circle(Shape):
...     kind: Literal["circle"] = "circle"
...     radius_m: float = 1.0
>>> Shape.load({"kind": "circle", "radius_m": 2.0}).radius_m
2.0

Fields of type ``Shape`` accept, validate and serialize every registered kind. Data without a tag have the default kind,
if the family has one.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self, TypeVar

from pydantic import GetCoreSchemaHandler, model_validator
from pydantic_core import core_schema

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.config_errors import joined
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.plugins import bare_name, unknown
from lanebound.integrity.core.presets import load_preset, nearest, preset_names, preset_values

__all__ = ["Literal", "Tagged"]

C = TypeVar("C", bound="Tagged")


class Tagged(Config):
    """Base class of a family of configurations.

    Class arguments of a family
    ---------------------------
    tag : name of the field with the name of the kind
    default : kind of data without a tag; no default kind if None
    modules : modules that register built-in kinds, by kind; they are imported at the first use of the kind
    """

    family: ClassVar[type[Tagged] | None] = None
    tag: ClassVar[str] = "kind"
    default: ClassVar[str | None] = None
    modules: ClassVar[Mapping[str, str]] = {}
    kinds: ClassVar[dict[str, type[Tagged]]] = {}

    def __init_subclass__(
        cls, tag: str | None = None, default: str | None = None, modules: Mapping[str, str] | None = None, **more: Any
    ) -> None:
        super().__init_subclass__(**more)
        if tag is not None:
            cls.family, cls.tag, cls.default, cls.modules, cls.kinds = cls, tag, default, modules or {}, {}

    def __new__(cls, **data: Any) -> Self:
        kind = cls._kind_of(data) if cls.family is cls else cls
        return super().__new__(kind)

    @classmethod
    def register(cls, kind: type[C]) -> type[C]:
        """Add a kind to the family (class decorator).

        Raises
        ------
        ConfigError
            The kind has no tag, or another class has the same tag.
        """
        field = kind.model_fields.get(cls.tag)
        name = field.default if field is not None else None
        if not isinstance(name, str):
            raise ConfigError(f"{kind.__name__}.{cls.tag} must have a default, got none: give the name of the kind")
        other = cls.kinds.get(name)
        if other is not None and (other.__module__, other.__qualname__) != (kind.__module__, kind.__qualname__):
            raise ConfigError(f"{cls.tag} must be unused, got {name!r} of {other.__name__}: choose another name")
        cls.kinds[name] = kind
        return kind

    @classmethod
    def withdraw(cls, kind: type[Tagged]) -> None:
        """Take back a kind that was registered."""
        del cls.kinds[kind.model_fields[cls.tag].default]

    @classmethod
    def all_kinds(cls) -> Mapping[str, type[Tagged]]:
        """Every kind by name; the built-in ones are imported."""
        for module in cls.modules.values():
            importlib.import_module(module)
        return cls.kinds

    @classmethod
    def kind_named(cls, name: str) -> type[Self]:
        """The class of a kind; ``package.module:kind`` imports the module first.

        Raises
        ------
        ConfigError
            The kind is unknown.
        """
        name = bare_name(name) if isinstance(name, str) else name
        if name not in cls.kinds and name in cls.modules:
            importlib.import_module(cls.modules[name])
        found = cls.kinds.get(name) if isinstance(name, str) else None
        if found is None:
            known = dict.fromkeys(sorted({*cls.kinds, *cls.modules}))
            presets = [preset for preset in cls._presets() if preset.rpartition("/")[2] == name]
            advice = f"it is a preset, give {presets[0]} without '{cls.tag}'" if presets else unknown(str(name), known)
            raise ConfigError(f"{cls.tag} must be one of {', '.join(known)}, got {name!r}: {advice}")
        return found  # type: ignore[return-value]

    @classmethod
    def _kind_of(cls, data: Mapping[str, Any]) -> type[Self]:
        name = data.get(cls.tag, cls.default)
        if name is None:
            known = sorted({*cls.kinds, *cls.modules})
            raise ConfigError(f"{cls.tag} is required, got nothing: write one of {', '.join(known)}")
        return cls.kind_named(name)

    @classmethod
    def load(cls, data: Mapping[str, Any], path: str = "", unchanged: Mapping[str, Any] | None = None) -> Self:
        """Build the configuration of the kind given in the data; see :meth:`Config.load`."""
        if cls.family is not cls or not isinstance(data, Mapping):
            return super().load(data, path, unchanged)
        try:
            kind = cls._kind_of(data)
        except ConfigError as error:
            raise ConfigError(joined(path, (str(error),))) from None
        return kind.load(data, path, unchanged)

    @classmethod
    def kept(cls, base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
        """``base`` itself, or, if the kind changes, the values that both kinds have."""
        family, tag = cls.family or cls, cls.tag
        name = changes.get(tag, base.get(tag))
        if name == base.get(tag, cls.default) or name is None:
            return dict(base)
        fields = family.kind_named(name).model_fields
        return {key: value for key, value in base.items() if key in fields and key != tag}

    def replace(self, **changes: Any) -> Self:
        """A validated copy with ``changes``; a mapping changes only its own keys. The kind can change."""
        return (self.family or type(self)).build(self, changes)  # type: ignore[return-value]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """The schema of a family dispatches to the kind; a kind has the usual schema."""
        if cls.family is not cls:
            return handler(source)
        return core_schema.no_info_plain_validator_function(
            cls._validate,
            serialization=core_schema.plain_serializer_function_ser_schema(_written, info_arg=True),
        )

    @classmethod
    def _validate(cls, value: Any) -> Any:
        """A configuration of the family from one, from data, or from the name of a kind or preset."""
        if isinstance(value, cls):
            return value
        data = cls.data_of(value)
        if not isinstance(data, Mapping):
            raise ConfigError(f"must be a mapping, got {value!r}: write keys and values")
        return cls._kind_of(data).model_validate(dict(data))

    @classmethod
    def data_of(cls, value: Any) -> Any:
        """Plain data from a name of a preset or of a kind; everything else is unchanged.

        A name with a ``/`` is that of a preset. The folder may be left out, unless a kind has the same name.
        """
        if not isinstance(value, str):
            return value
        if "/" not in value and not cls._names_preset(value):
            if ":" not in value and value not in {*cls.kinds, *cls.modules}:
                raise ConfigError(cls._unknown_name(value))
            return {cls.tag: value}
        if "/" in value and value not in cls._presets():
            raise ConfigError(cls._unknown_name(value))
        return preset_values(value)

    @classmethod
    def _unknown_name(cls, value: str) -> str:
        """The refusal of a name that is neither a kind nor a preset of this family."""
        kinds, presets = sorted({*cls.kinds, *cls.modules}), cls._presets()
        short = {preset.rpartition("/")[2]: preset for preset in presets}
        also = f" or a preset ({', '.join(short)})" if presets else ""
        if "/" in value:
            advice = nearest(value, presets)
            advice = advice if advice.startswith("did you mean") else "'lanebound config list' lists the presets"
        else:
            advice = unknown(value, {**short, **dict.fromkeys(kinds)})
        return f"must be a kind ({', '.join(kinds)}){also}, got {value!r}: {advice}"

    @classmethod
    def _names_preset(cls, name: str) -> bool:
        """Whether a name without folder is that of a preset of this family, and of no kind."""
        if name in cls.kinds or name in cls.modules or ":" in name:
            return False
        found = [preset for preset in preset_names() if preset.rpartition("/")[2] == name]
        return len(found) == 1 and cls._configures(found[0])

    @classmethod
    def _configures(cls, preset: str) -> bool:
        """Whether a preset is one of this family, by its kind: ``navigator`` or ``navigator/filter``."""
        family = (cls.family or cls).__name__.removesuffix("Config").lower()
        return str(load_preset(preset).get("kind")).partition("/")[0] == family

    @classmethod
    def _presets(cls) -> list[str]:
        """Names of the presets of this family."""
        return [preset for preset in preset_names() if cls._configures(preset)]

    @model_validator(mode="before")
    @classmethod
    def _without_module(cls, data: Any) -> Any:
        """The tag ``package.module:kind`` as ``kind``."""
        name = data.get(cls.tag) if isinstance(data, Mapping) else None
        return {**data, cls.tag: bare_name(name)} if isinstance(name, str) and ":" in name else data


def _written(value: Tagged, info: Any) -> Any:
    """Plain data of a configuration; only the name of the kind if the kind has no other fields."""
    data = value.model_dump(mode=info.mode)
    return data[value.tag] if set(data) == {value.tag} else data
