"""Messages for pydantic's validation errors: the dotted path, the bound, the value found and the remedy."""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping, Sequence
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Any

from lanebound.integrity.core.presets import FILES, nearest

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError
    from pydantic.fields import FieldInfo

__all__ = ["below", "bound_text", "explain", "joined", "model_in"]

BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
LISTS = {"tuple_type", "list_type"}
SIZES = {"too_short": "at least", "too_long": "at most"}
MAPPINGS = {"model_type", "model_attributes_type", "dict_type", "mapping_type"}
OFFER = "did you mean '"  # how the advice of ``nearest`` begins where a word is close
NUMBERS = {"float_type", "float_parsing", "int_type", "int_parsing"}


def explain(
    model: type[BaseModel], error: ValidationError, path: str = "", unchanged: Mapping[str, Any] | None = None
) -> str:
    """One line for each problem of ``error`` in ``model``, with ``path`` in front of each key.

    ``unchanged`` is the data before the changes of a user; its values are given instead of the default of a field.
    """
    found = error.errors()
    places = [problem["loc"] for problem in found]
    reported = [p for p in found if not (p["type"] == "too_short" and _contains_one(p["loc"], places))]
    return "\n".join(_line(model, problem, path, unchanged or {}) for problem in reported)


def _contains_one(loc: Sequence[int | str], places: Sequence[Sequence[int | str]]) -> bool:
    """Whether a place lies within ``loc``: a list that is too short only because of invalid entries is not reported."""
    return any(len(place) > len(loc) and tuple(place[: len(loc)]) == tuple(loc) for place in places)


def _line(model: type[BaseModel], problem: Mapping[str, Any], path: str, unchanged: Mapping[str, Any]) -> str:
    loc, kind = problem["loc"], problem["type"]
    owner, field = _find(model, loc)
    dotted = joined(path, loc) or model.__name__
    if kind == "extra_forbidden":
        others = _kinds_with(owner, str(loc[-1]))
        if owner is not None and others:
            return (
                f"{dotted} is a key of kind {' and '.join(others)}, not of {_kind_of(owner)}: leave it out, or choose "
                f"the kind {others[0]}"
            )
        advice = nearest(str(loc[-1]), owner.model_fields if owner else ())
        inside = joined("" if path.endswith(FILES) else path, loc[:-1])
        head, _, rest = str(loc[-1]).partition(".")
        if owner is not None and rest and head in owner.model_fields:
            return f"{dotted} is not a known key: nest the mappings, {{{head!r}: {{{rest!r}: ...}}}}"
        return f"{dotted} is not a known key: {_with_path(advice, inside)}"
    if kind == "missing":
        return f"{dotted} is required, got nothing: add it"
    if kind in ("value_error", "assertion_error"):
        return _in_place(str(problem["ctx"]["error"]), dotted, model, path, loc)
    remedy = _remedy(problem, field, _before(unchanged, loc))
    return f"{dotted} must {_demand(problem, field)}, got {_found(problem['input'])}: {remedy}"


def below(path: str, line: str) -> str:
    """A message about a key, with ``path`` in front of the key, and in front of the close key that it offers.

    >>> below("overrides", "duraton_s is not a known key: did you mean 'duration_s'?")
    "overrides.duraton_s is not a known key: did you mean 'overrides.duration_s'?"
    """
    head, colon, advice = line.partition(" is not a known key: ")
    return f"{path}.{head}{colon}{_with_path(advice, path)}"


def _with_path(advice: str, path: str) -> str:
    return advice.replace(OFFER, f"{OFFER}{path}.", 1) if path and advice.startswith(OFFER) else advice


def joined(path: str, keys: Sequence[int | str]) -> str:
    """Keys below a path, with dots; a path that is the name of a file ends with a colon.

    >>> joined("navigator", ["rtk", "bands", 0]), joined("sky.yaml", ["corrections", "outage"])
    ('navigator.rtk.bands.0', 'sky.yaml: corrections.outage')
    """
    inside = ".".join(map(str, keys))
    return f"{path}{': ' if path.endswith(FILES) else '.'}{inside}" if path and inside else path or inside


def _in_place(text: str, dotted: str, model: type[BaseModel], path: str, loc: Sequence[int | str]) -> str:
    """The message of a validator with the place of its model; a message that begins with a key has its whole path."""
    if text.startswith(dotted):
        return text
    if text.startswith("must "):
        return f"{dotted} {text}"
    inside = _inside(model, loc)
    word = text.split(maxsplit=1)[0].rstrip(":") if text else ""
    if loc and word.partition(".")[0] == loc[-1]:
        return joined(joined(path, loc[:-1]), (text,))
    if inside is not None and word.partition(".")[0] in inside.model_fields:
        return joined(joined(path, loc), (text,))
    return f"{dotted}: {text}"


def _demand(problem: Mapping[str, Any], field: FieldInfo | None) -> str:
    """The requirement on the value, in words."""
    kind, context = problem["type"], problem.get("ctx", {})
    if kind in BOUNDS:
        limits = {
            key: getattr(item, key) for item in (field.metadata if field else ()) for key in SIGNS if hasattr(item, key)
        }
        return bound_text(limits if len(limits) > 1 else context)
    if kind == "finite_number":
        return "be finite"
    if kind in NUMBERS:
        return "be an integer" if kind.startswith("int") else "be a number"
    if kind == "int_from_float":
        return "be an integer"
    if kind in ("enum", "literal_error"):
        return f"be one of {_numbered(field) or context['expected']}"
    if kind in SIZES:
        count = context.get("min_length", context.get("max_length"))
        return f"have {SIZES[kind]} {count} {'entry' if count == 1 else 'entries'}"
    if kind in LISTS:
        return "be a list"
    if kind in MAPPINGS:
        return "be a mapping"
    if kind == "string_type":
        return "be text"
    text = str(problem["msg"])
    text = text.removeprefix("Input should be ")
    return f"be {text}" if text != problem["msg"] else f"satisfy: {text}"


def _numbered(field: FieldInfo | None) -> str:
    """Numbers and names of an enum of integers, ``"0 (GPS), 1 (GALILEO)"``; "" for other fields."""
    kinds = (field.annotation, *typing.get_args(field.annotation)) if field is not None else ()
    kind = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, IntEnum)), None)
    return "" if kind is None else ", ".join(f"{int(member)} ({member.name})" for member in kind)


def bound_text(limits: Mapping[str, Any]) -> str:
    """What bounds demand: ``"lie in (0, 1)"`` for both, ``"be >= 0"`` for one; keys as those of ``SIGNS``."""
    low = "gt" if "gt" in limits else "ge"
    high = "lt" if "lt" in limits else "le"
    if low not in limits or high not in limits:
        return " and ".join(f"be {SIGNS[key]} {limit:.12g}" for key, limit in limits.items() if key in SIGNS)
    left, right = "(" if low == "gt" else "[", ")" if high == "lt" else "]"
    return f"lie in {left}{limits[low]:.12g}, {limits[high]:.12g}{right}"


def _found(value: Any) -> str:
    """The value as text; the middle of a long value is left out, because the end of a path matters most."""
    shown = repr(value)
    return shown if len(shown) <= 80 else f"{shown[:30]}...{shown[-45:]}"


def _before(unchanged: Any, loc: Sequence[int | str]) -> Any:
    """The value at a path of plain data, None if there is no value."""
    for key in loc:
        unchanged = unchanged.get(key) if isinstance(unchanged, Mapping) else None
    return unchanged


def _remedy(problem: Mapping[str, Any], field: FieldInfo | None, before: Any) -> str:
    kind, value = problem["type"], problem["input"]
    if kind in NUMBERS:
        return "write the number without quotes" if _is_number(value) else "give a number"
    if kind in LISTS and isinstance(value, int | float | str):
        return f"write [{value}]"
    if kind in MAPPINGS:
        return "write keys and values"
    if kind in ("enum", "literal_error"):
        words = str(problem["ctx"]["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        advice = nearest(str(value), words)
        return advice if advice.startswith(OFFER) else "choose one of them"
    default = field.get_default() if field is not None and not field.is_required() else None
    if _plain(before) and before not in (default, problem["input"]):
        return f"correct that value (unchanged it is {before})"
    if _plain(default):
        return f"correct that value (the default is {default})"
    return "correct that value"


def _is_number(value: Any) -> bool:
    """Whether a value is the text of a finite number."""
    try:
        return isinstance(value, str) and math.isfinite(float(value))
    except ValueError:
        return False


def _plain(value: Any) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, Enum)


def _find(model: type[BaseModel], loc: Sequence[int | str]) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The model that owns the last key of ``loc``, and the field of the key; None if the path leaves the models."""
    owner, field, _ = _walk(model, loc)
    return owner, field


def _inside(model: type[BaseModel], loc: Sequence[int | str]) -> type[BaseModel] | None:
    """The model at ``loc``; None if the path leaves the models."""
    return _walk(model, loc)[2]


def _walk(
    model: type[BaseModel], loc: Sequence[int | str]
) -> tuple[type[BaseModel] | None, FieldInfo | None, type[BaseModel] | None]:
    owner: type[BaseModel] | None = model
    inside: type[BaseModel] | None = model
    field: FieldInfo | None = None
    for key in loc:
        owner = _model_with(inside, key)
        field = owner.model_fields.get(key) if owner is not None and isinstance(key, str) else None
        if field is not None:
            inside = model_in(field.annotation)
        elif owner is not None and owner.model_config.get("extra") == "allow":
            inside = model_in(typing.get_type_hints(owner)["__pydantic_extra__"])
    return owner, field, inside


def _model_with(model: type[BaseModel] | None, key: int | str) -> type[BaseModel] | None:
    """The model, or the first kind of a family of models (:mod:`.tagged`) that has the key."""
    family = getattr(model, "family", None)
    kinds: list[type[BaseModel] | None] = [*getattr(model, "kinds", {}).values()] if family is model else []
    kinds = kinds or [model]
    return next((kind for kind in kinds if kind is not None and key in kind.model_fields), kinds[0])


def _kinds_with(owner: type[BaseModel] | None, key: str) -> list[str]:
    """Names of the kinds of the owner's family that have a key, if the owner is one kind of it."""
    family = getattr(owner, "family", None)
    if family is None or family is owner:
        return []
    return [name for name, kind in sorted(family.all_kinds().items()) if key in kind.model_fields]


def _kind_of(owner: type[BaseModel]) -> str:
    return str(owner.model_fields[getattr(owner, "tag", "")].default)


def model_in(annotation: Any) -> type[BaseModel] | None:
    """The model inside an annotation such as ``Model``, ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and hasattr(annotation, "model_fields"):
        return annotation
    return next(filter(None, map(model_in, typing.get_args(annotation))), None)
