"""Random numbers of many generators: SFC64 and the ziggurat method, with the same bits as NumPy's ``Generator``.

The state of a generator is a row of four words: a, b, c and a counter (Doty-Humphrey's Small Fast Counting generator).
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.core.accel import jit

__all__ = ["begin", "normals", "normals_at", "uniforms", "uniforms_at"]

ONE = np.uint64(1)
ROUNDS = 12  # number of draws that mix the seed
TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53
EDGE, INVERSE_EDGE = 3.6541528853610088, 0.27366123732975828  # end of the ziggurat and start of the tail; its inverse


@jit(inline=True)
def advance(a, b, c, counter):  # type: ignore[no-untyped-def]
    """The next word of a generator, and its next state of four words."""
    word = a + b + counter
    turned = ((c << np.uint64(24)) | (c >> np.uint64(40))) + word
    return word, b ^ (b >> np.uint64(11)), c + (c << np.uint64(3)), turned, counter + ONE


@jit(inline=True)
def raw(g):  # type: ignore[no-untyped-def]
    """The next word of a generator (4,), whose state advances."""
    word, g[0], g[1], g[2], g[3] = advance(g[0], g[1], g[2], g[3])
    return word


@jit(inline=True)
def uniform(g):  # type: ignore[no-untyped-def]
    """Uniform draw in [0, 1) with 53 bits."""
    return float(raw(g) >> np.uint64(11)) * TO_UNIT


@jit(borrows=True)
def fill(g, table, out):  # type: ignore[no-untyped-def]
    """Draw standard normals (W,) from a generator (4,) by the ziggurat of 256 layers of Marsaglia and Tsang 2000.

    table (3, 256): for each layer the share of words within the layer above, in units of 2^-52; its width over 2^52;
    the density at its edge. The state stays in registers, except for the one draw in a hundred that lies outside.
    """
    a, b, c, counter = g[0], g[1], g[2], g[3]
    for w in range(out.shape[0]):
        within = False
        while not within:
            word, a, b, c, counter = advance(a, b, c, counter)
            layer = np.int64(word & np.uint64(255))
            place = float(np.int64((word >> np.uint64(9)) & np.uint64(0x000FFFFFFFFFFFFF)))
            x = place * table[1, layer] * (1.0 - 2.0 * float(np.int64((word >> np.uint64(8)) & ONE)))
            within = place < table[0, layer]
            if not within:
                g[0], g[1], g[2], g[3] = a, b, c, counter
                within, x = outside(g, table, layer, place, x)
                a, b, c, counter = g[0], g[1], g[2], g[3]
        out[w] = x
    g[0], g[1], g[2], g[3] = a, b, c, counter


@jit(borrows=True)
def outside(g, table, layer, place, x):  # type: ignore[no-untyped-def]
    """Whether a draw outside the layer above is accepted, and its value; a draw of layer 0 comes from the tail."""
    if layer == 0:
        return True, tail(g, place)
    density = (table[2, layer - 1] - table[2, layer]) * uniform(g) + table[2, layer]
    return density < math.exp(-0.5 * x * x), x


@jit(borrows=True)
def tail(g, place):  # type: ignore[no-untyped-def]
    """Draw beyond the edge by the method of Marsaglia 1964; bit 8 of ``place`` is the sign."""
    while True:
        x = -INVERSE_EDGE * math.log1p(-uniform(g))
        y = -math.log1p(-uniform(g))
        if y + y > x * x:
            return -(EDGE + x) if (np.uint64(place) >> np.uint64(8)) & ONE else EDGE + x


@jit
def begin(words, states):  # type: ignore[no-untyped-def]
    """Seed generators (n, 4) with three words each (n, 3)."""
    for i in range(words.shape[0]):
        states[i, 0], states[i, 1], states[i, 2], states[i, 3] = words[i, 0], words[i, 1], words[i, 2], ONE
        for _ in range(ROUNDS):
            raw(states[i])


@jit
def uniforms(states, rows, out):  # type: ignore[no-untyped-def]
    """Fill out (n, W) with uniform draws from the generators ``rows`` (n,) of states (N, 4)."""
    for i in range(rows.shape[0]):
        for w in range(out.shape[1]):
            out[i, w] = uniform(states[rows[i]])


@jit
def normals(states, rows, table, out):  # type: ignore[no-untyped-def]
    """Fill out (n, W) with standard normals from the generators ``rows`` (n,) of states (N, 4)."""
    for i in range(rows.shape[0]):
        fill(states[rows[i]], table, out[i])


@jit
def uniforms_at(states, used, out):  # type: ignore[no-untyped-def]
    """Fill the entries of out (N, S, W) with ``used`` (N, S) with uniform draws, in order; others do not change."""
    for e in range(out.shape[0]):
        for s in range(out.shape[1]):
            if used[e, s]:
                for w in range(out.shape[2]):
                    out[e, s, w] = uniform(states[e])


@jit
def normals_at(first, last, states, used, table, out):  # type: ignore[no-untyped-def]
    """Fill the entries of out (N, S, W) with ``used`` (N, S) with normals, for generators ``first`` to ``last - 1``."""
    drawn = np.empty(out.shape[1] * out.shape[2])
    for e in range(first, last):
        fill(states[e], table, drawn[: used[e].sum() * out.shape[2]])
        n = 0
        for s in range(out.shape[1]):
            if used[e, s]:
                out[e, s] = drawn[n : n + out.shape[2]]
                n += out.shape[2]
