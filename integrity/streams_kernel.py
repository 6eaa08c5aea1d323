"""Random numbers of many generators at once: SFC64 and the ziggurat method, bit by bit as NumPy's ``Generator`` draws.

A generator is a row of four words: a, b, c and a counter (Doty-Humphrey's Small Fast Counting generator).
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.accel import jit

__all__ = ["begin", "normals", "normals_at", "uniforms", "uniforms_at"]

ONE = np.uint64(1)
ROUNDS = 12  # that mix the seed
TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53
EDGE, OF_EDGE = 3.6541528853610088, 0.27366123732975828  # where the ziggurat ends and the tail begins; one over that


@jit(inline=True)
def raw(g):  # type: ignore[no-untyped-def]
    """The next word of a generator (4,)."""
    word = g[0] + g[1] + g[3]
    g[3] += ONE
    g[0] = g[1] ^ (g[1] >> np.uint64(11))
    g[1] = g[2] + (g[2] << np.uint64(3))
    g[2] = ((g[2] << np.uint64(24)) | (g[2] >> np.uint64(40))) + word
    return word


@jit(inline=True)
def uniform(g):  # type: ignore[no-untyped-def]
    """In [0, 1), of 53 bits."""
    return float(raw(g) >> np.uint64(11)) * TO_UNIT


@jit
def normal(g, table):  # type: ignore[no-untyped-def]
    """Standard normal, by the ziggurat of 256 layers of Marsaglia and Tsang 2000.

    table (3, 256): of each layer the share of words that lie within the one above, in 2^52nds; its width over 2^52; the
    density at its edge.
    """
    while True:
        word = raw(g)
        layer = np.int64(word & np.uint64(255))
        negative = (word >> np.uint64(8)) & ONE
        place = float((word >> np.uint64(9)) & np.uint64(0x000FFFFFFFFFFFFF))
        x = place * table[1, layer]
        if negative:
            x = -x
        if place < table[0, layer]:
            return x
        if layer == 0:
            return tail(g, place)
        if (table[2, layer - 1] - table[2, layer]) * uniform(g) + table[2, layer] < math.exp(-0.5 * x * x):
            return x


@jit
def tail(g, place):  # type: ignore[no-untyped-def]
    """Beyond the edge, by Marsaglia 1964; bit 8 of the place is its sign."""
    while True:
        x = -OF_EDGE * math.log1p(-uniform(g))
        y = -math.log1p(-uniform(g))
        if y + y > x * x:
            return -(EDGE + x) if (np.uint64(place) >> np.uint64(8)) & ONE else EDGE + x


@jit
def begin(words, states):  # type: ignore[no-untyped-def]
    """Seed generators (n, 4) by three words each (n, 3)."""
    for i in range(words.shape[0]):
        states[i, 0], states[i, 1], states[i, 2], states[i, 3] = words[i, 0], words[i, 1], words[i, 2], ONE
        for _ in range(ROUNDS):
            raw(states[i])


@jit
def uniforms(states, rows, out):  # type: ignore[no-untyped-def]
    """Fill out (n, W) from the generators ``rows`` (n,) among states (N, 4)."""
    for i in range(rows.shape[0]):
        for w in range(out.shape[1]):
            out[i, w] = uniform(states[rows[i]])


@jit
def normals(states, rows, table, out):  # type: ignore[no-untyped-def]
    """The same of standard normals."""
    for i in range(rows.shape[0]):
        for w in range(out.shape[1]):
            out[i, w] = normal(states[rows[i]], table)


@jit
def uniforms_at(states, used, out):  # type: ignore[no-untyped-def]
    """Fill the places of out (N, M, S, W) that are used (N, S), one after another; the others stay as they are."""
    for e in range(out.shape[0]):
        for m in range(out.shape[1]):
            for s in range(out.shape[2]):
                if used[e, s]:
                    for w in range(out.shape[3]):
                        out[e, m, s, w] = uniform(states[e])


@jit
def normals_at(states, used, table, out):  # type: ignore[no-untyped-def]
    """The same of standard normals."""
    for e in range(out.shape[0]):
        for m in range(out.shape[1]):
            for s in range(out.shape[2]):
                if used[e, s]:
                    for w in range(out.shape[3]):
                        out[e, m, s, w] = normal(states[e], table)
