"""Seed words of many generators, with the same bits as NumPy's ``SeedSequence``, which needs 20 us for each.

Source: O'Neill, "Developing a seed_seq alternative" (2015), as in NEP 19; words of 32 bits are held in 64.
"""

from __future__ import annotations

import numpy as np

from lanebound.integrity.core.accel import jit

__all__ = ["fill_words"]

POOL, WORDS = 4, 6  # words of 32 bits that are mixed, and that seed a generator of three words of 64
LOW, HALF, WHOLE = np.uint64(0xFFFFFFFF), np.uint64(16), np.uint64(32)
MIX_START, MIX_FACTOR = np.uint64(0x43B0D7E5), np.uint64(0x931E8875)
OUT_START, OUT_FACTOR = np.uint64(0x8B51F9DD), np.uint64(0x58F38DED)
LEFT, RIGHT = np.uint64(0xCA01F9DD), np.uint64(0x4973F715)


@jit(inline=True)
def _hashed(word, constant, factor):  # type: ignore[no-untyped-def]
    """A word hashed, and the constant of the next one."""
    following = (constant * factor) & LOW
    word = ((word ^ constant) * following) & LOW
    return word ^ (word >> HALF), following


@jit
def fill_words(seeds, key, words):  # type: ignore[no-untyped-def]
    """Words (n, 3) of the sequences of the entropy ``[seed, key]``, for seeds (n,) and a key of 64 bits each."""
    pool = np.empty(POOL, np.uint64)
    for i in range(seeds.shape[0]):
        used = 0
        pool[:] = 0
        for number in (seeds[i], key):
            pool[used] = number & LOW
            pool[used + 1] = number >> WHOLE
            used += 2 if number > LOW else 1
        constant = MIX_START
        for k in range(POOL):
            pool[k], constant = _hashed(pool[k], constant, MIX_FACTOR)
        for source in range(POOL):
            for k in range(POOL):
                if k != source:
                    word, constant = _hashed(pool[source], constant, MIX_FACTOR)
                    word = (LEFT * pool[k] - RIGHT * word) & LOW
                    pool[k] = word ^ (word >> HALF)
        constant = OUT_START
        for k in range(WORDS):
            word, constant = _hashed(pool[k % POOL], constant, OUT_FACTOR)
            words[i, k // 2] = word if k % 2 == 0 else words[i, k // 2] | (word << WHOLE)
