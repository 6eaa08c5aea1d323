"""A vector type of eight numbers for kernels, whose arithmetic gives the same bits on every processor.

A compiler vectorises the sum of a row only if it may change the order of the sum; the last bits then depend on the code
around the loop. Here the kernel states explicitly which operations run in parallel. ``Lanes`` are added, subtracted,
multiplied and divided lane by lane, with other ``Lanes`` or with numbers; the functions below are the other operations.
Each operation is one machine operation on 2, 4 or 8 lanes, depending on the processor, with the same result.

For use inside kernels only. ``load`` and ``store`` move ``WIDTH`` entries at a time without bounds checks: arrays must
be C-contiguous and long enough for whole vectors (:func:`padded`).
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import get_or_insert_function
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, Signature, infer_global
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from lanebound.integrity.core.accel import jit

__all__ = [
    "WIDTH",
    "absolute",
    "fma",
    "largest",
    "load",
    "maximum",
    "minimum",
    "padded",
    "root_of",
    "spread",
    "store",
    "total",
    "where_less",
]

WIDTH = 8
VECTOR, NUMBER, INDEX = ir.VectorType(ir.DoubleType(), WIDTH), ir.DoubleType(), ir.IntType(64)


class LanesType(types.Type):
    """Numba type of ``Lanes``; a number is converted by a copy to all lanes."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        return Conversion.safe if isinstance(other, types.Float) else None


lanes = LanesType()


@register_model(LanesType)
class LanesModel(models.PrimitiveModel):
    """Data model of ``Lanes``: a vector register."""

    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, VECTOR)


def _filled(builder: Any, number: Any) -> Any:
    first = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH))


@lower_cast(types.Float, lanes)
def _cast(context: Any, builder: Any, from_type: Any, to_type: Any, value: Any) -> Any:
    return _filled(builder, context.cast(builder, value, from_type, types.float64))


def _takes_lanes(arguments: tuple[Any, ...]) -> bool:
    return lanes in arguments and all(a == lanes or isinstance(a, types.Float) for a in arguments)


def _operator(function: Any, instruction: str) -> None:
    """Register ``function`` of two ``Lanes``, or of ``Lanes`` and a number, with Numba."""

    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Signature | None:
            return Signature(lanes, (lanes, lanes), None) if len(args) == 2 and _takes_lanes(args) else None

    @lower_builtin(function, lanes, lanes)
    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args)


for _name, _llvm_name in {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}.items():
    for _function in (_name, f"i{_name}"):
        _operator(getattr(operator, _function), _llvm_name)


def _instruction(function: Any) -> Any:
    """Kernel function whose LLVM code ``function`` emits."""
    return intrinsic(function)


def _llvm(builder: Any, name: str, *args: Any) -> Any:
    """Call of the LLVM function ``name``, whose arguments and result are vectors or numbers of one type."""
    kind = args[0].type
    suffix = f"v{WIDTH}f64" if kind == VECTOR else "f64"
    signature = ir.FunctionType(kind, [kind] * len(args))
    return builder.call(get_or_insert_function(builder.module, signature, f"llvm.{name}.{suffix}"), args)


@_instruction
def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """``a b + c`` of lanes or numbers with a single rounding."""
    kind = lanes if lanes in (a, b, c) else types.float64
    return kind(kind, kind, kind), lambda context, builder, signature, args: _llvm(builder, "fma", *args)


@_instruction
def absolute(typingctx: Any, a: Any) -> Any:
    """``abs(a)`` of each lane."""
    return lanes(lanes), lambda context, builder, signature, args: _llvm(builder, "fabs", *args)


@_instruction
def root_of(typingctx: Any, a: Any) -> Any:
    """Square root of each lane."""
    return lanes(lanes), lambda context, builder, signature, args: _llvm(builder, "sqrt", *args)


@_instruction
def where_less(typingctx: Any, a: Any, b: Any, then: Any, otherwise: Any) -> Any:
    """``then if a < b else otherwise`` in each lane; the comparison with NaN is False."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", args[0], args[1]), args[2], args[3])

    return lanes(lanes, lanes, lanes, lanes), emit


@_instruction
def spread(typingctx: Any, number: Any) -> Any:
    """``number`` in all lanes."""
    return lanes(lanes), lambda context, builder, signature, args: args[0]


def _address(context: Any, builder: Any, array_type: Any, array: Any, indices: Any) -> Any:
    """Vector pointer to the entry ``indices`` of an array with one or two axes."""
    fields = context.make_array(array_type)(context, builder, array)
    offset = indices[0]
    if array_type.ndim == 2:
        offset = builder.add(builder.mul(indices[0], builder.extract_value(fields.shape, 1)), indices[1])
    return builder.bitcast(builder.gep(fields.data, [offset]), VECTOR.as_pointer())


def _indices(array: Any, j: Any) -> tuple[Any, Any] | None:
    """Types of the one or two indices; None if they do not fit the axes of the array."""
    axes = 1 if j is None else 2
    if not isinstance(array, types.Array) or array.ndim != axes:
        return None
    return types.int64, types.Omitted(None) if j is None else types.int64


@_instruction
def load(typingctx: Any, array: Any, i: Any, j: Any = None) -> Any:
    """Entries ``i`` to ``i + WIDTH - 1`` of a vector, or ``j`` to ``j + WIDTH - 1`` of row ``i`` of a matrix."""
    indices = _indices(array, j)
    if indices is None:
        return None

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], args[0], args[1:]), align=8)

    return lanes(array, *indices), emit


@_instruction
def store(typingctx: Any, value: Any, array: Any, i: Any, j: Any = None) -> Any:
    """Write the lanes to the same entries that :func:`load` reads."""
    indices = _indices(array, j)
    if indices is None:
        return None

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[0], _address(context, builder, signature.args[1], args[1], args[2:]), align=8)
        return context.get_dummy_value()

    return types.void(lanes, array, *indices), emit


def _folded(builder: Any, vector: Any, combine: Any) -> Any:
    """Reduce all lanes to one number: combine the upper half with the lower half until one number remains."""
    width = WIDTH
    while width > 1:
        width //= 2
        mask = ir.VectorType(ir.IntType(32), width)
        low, high = (ir.Constant(mask, list(range(start, start + width))) for start in (0, width))
        vector = combine(builder.shuffle_vector(vector, vector, low), builder.shuffle_vector(vector, vector, high))
    return builder.extract_element(vector, ir.IntType(32)(0))


@_instruction
def total(typingctx: Any, a: Any) -> Any:
    """Sum of the lanes, in pairs in a fixed order."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _folded(builder, args[0], builder.fadd)

    return types.float64(lanes), emit


@_instruction
def largest(typingctx: Any, a: Any) -> Any:
    """Largest of the lanes, none of which may be NaN."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def greater(x: Any, y: Any) -> Any:
            return builder.select(builder.fcmp_ordered(">", x, y), x, y)

        return _folded(builder, args[0], greater)

    return types.float64(lanes), emit


@jit
def minimum(a: Any, limit: Any) -> Any:
    """The smaller value in each lane; a NaN in ``a`` is preserved."""
    return where_less(limit, a, limit, a)


@jit
def maximum(a: Any, limit: Any) -> Any:
    """The larger value in each lane; a NaN in ``a`` is preserved."""
    return where_less(a, limit, limit, a)


@jit
def padded(n: int) -> int:
    """``n`` rounded up to a multiple of WIDTH: the number of columns for whole vectors."""
    return (n + WIDTH - 1) // WIDTH * WIDTH
