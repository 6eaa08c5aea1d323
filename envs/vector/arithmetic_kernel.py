"""Functions for loops over all vehicles: without branches and calls, so that the compiler takes several at once.

Polynomials through the Chebyshev nodes of the interval, off by no more than the last bit or two of a double; the sums
are fused, so that they have the same bits one by one and side by side. Angles are in radians.
"""

# mypy: allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.simd_kernel import fma

__all__ = ["FLAT_MOST_RAD", "SINE_MOST", "arcsine", "cosine", "power", "sine"]

FLAT_MOST_RAD = 0.81  # largest angle [rad] of ``sine`` and ``cosine``
SINE_MOST = 0.7072  # largest argument of ``arcsine``
ONE, HALF_ROOT, FRACTION_BITS, BIAS = 0x3FF0000000000000, 0x3FE6A09E667F3BCD, 52, 1023  # bits of 1 and of sqrt(1/2)
TO_WHOLE = 6755399441055744.0  # 1.5 2^52: adding it leaves no room for a fraction
SMALLEST, LEAST_POWER = 1e-300, -1000.0  # keep logarithms and powers of zero finite


def _cast_bits(kind: Any, to: Any, llvm_type: Any) -> Any:
    @intrinsic
    def cast(typingctx: Any, value: Any) -> Any:
        """The same 64 bits, read as the other kind of number."""
        return to(kind), lambda context, builder, signature, args: builder.bitcast(args[0], llvm_type)

    return cast


_bits_of = _cast_bits(types.float64, types.int64, ir.IntType(64))
_number_of = _cast_bits(types.int64, types.float64, ir.DoubleType())


@jit(inline=True)
def _log2(x):  # type: ignore[no-untyped-def]
    """Of a positive number: its exponent, and ``2 artanh((m - 1) / (m + 1))`` of m in [sqrt(1/2), sqrt(2))."""
    bits = _bits_of(x)
    exponent = ((bits + (ONE - HALF_ROOT)) >> FRACTION_BITS) - BIAS
    m = _number_of(bits - (exponent << FRACTION_BITS))
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    p = fma(0.2136589569431927, z, 0.2209130842311768)
    p = fma(p, z, 0.262334352504183)
    p = fma(p, z, 0.32059853491395984)
    p = fma(p, z, 0.4121985858409005)
    p = fma(p, z, 0.5770780163455203)
    p = fma(p, z, 0.9617966939259898)
    p = fma(p, z, 2.8853900817779268)
    return fma(s, p, float(exponent))


@jit(inline=True)
def _exp2(y):  # type: ignore[no-untyped-def]
    """2 to a power between -1000 and 1000."""
    whole = (y + TO_WHOLE) - TO_WHOLE
    x = y - whole
    p = fma(4.4558179083360645e-10, x, 7.074194297288521e-09)
    p = fma(p, x, 1.0178057087733941e-07)
    p = fma(p, x, 1.3215432535912375e-06)
    p = fma(p, x, 1.5252733841556773e-05)
    p = fma(p, x, 0.00015403530463724353)
    p = fma(p, x, 0.001333355814640647)
    p = fma(p, x, 0.009618129107587256)
    p = fma(p, x, 0.055504108664821625)
    p = fma(p, x, 0.24022650695910158)
    p = fma(p, x, 0.6931471805599453)
    p = fma(p, x, 1.0)
    return p * _number_of((int(whole) + BIAS) << FRACTION_BITS)


@jit(inline=True)
def power(x, y):  # type: ignore[no-untyped-def]
    """``x ** y`` for x >= 0 and y > 0, where it is less than 2^1000; off by 4e-16 times the exponent of the result."""
    return _exp2(max(y * _log2(max(x, SMALLEST)), LEAST_POWER))


@jit(inline=True)
def sine(x):  # type: ignore[no-untyped-def]
    """Of an angle of at most ``FLAT_MOST_RAD``."""
    z = x * x
    p = fma(-7.573715060043533e-13, z, 1.6058261924986724e-10)
    p = fma(p, z, -2.5052104047713808e-08)
    p = fma(p, z, 2.7557319210650833e-06)
    p = fma(p, z, -0.00019841269841247577)
    p = fma(p, z, 0.008333333333333316)
    p = fma(p, z, -0.16666666666666666)
    return fma(p * z, x, x)


@jit(inline=True)
def cosine(x):  # type: ignore[no-untyped-def]
    """Of an angle of at most ``FLAT_MOST_RAD``."""
    z = x * x
    p = fma(4.7335708152844495e-14, z, -1.1470181704073233e-11)
    p = fma(p, z, 2.0876753249781055e-09)
    p = fma(p, z, -2.7557319209539387e-07)
    p = fma(p, z, 2.48015873015545e-05)
    p = fma(p, z, -0.0013888888888888846)
    p = fma(p, z, 0.041666666666666664)
    p = fma(p, z, -0.5)
    return fma(p, z, 1.0)


@jit(inline=True)
def arcsine(x):  # type: ignore[no-untyped-def]
    """Of at most ``SINE_MOST``."""
    z = x * x
    p = fma(1.1264192878807509, z, -4.438816692066939)
    p = fma(p, z, 8.32498352944691)
    p = fma(p, z, -9.669659398550623)
    p = fma(p, z, 7.768165374555008)
    p = fma(p, z, -4.535791802822955)
    p = fma(p, z, 2.0016041109291547)
    p = fma(p, z, -0.6641236302549411)
    p = fma(p, z, 0.1809574620911065)
    p = fma(p, z, -0.026316324552338826)
    p = fma(p, z, 0.015091795028583365)
    p = fma(p, z, 0.01092934906491237)
    p = fma(p, z, 0.01401917204006966)
    p = fma(p, z, 0.017349310327158196)
    p = fma(p, z, 0.022372313172485805)
    p = fma(p, z, 0.030381939881673394)
    p = fma(p, z, 0.044642857225197834)
    p = fma(p, z, 0.07499999999921603)
    p = fma(p, z, 0.16666666666666963)
    return fma(p * z, x, x)
