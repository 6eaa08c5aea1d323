"""Angles in one turn, and what counts as rounding of a length."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

__all__ = ["ROUNDING_M", "TWO_PI", "remainder", "wrap"]

TWO_PI = 2.0 * math.pi
ROUNDING_M = 1e-9  # an error that equals its level is not beyond it; differences of coordinates round by 1e-12 m


@jit(inline=True)
def wrap(angle):  # type: ignore[no-untyped-def]
    """The angle in [-pi, pi); rounding can give pi.

    Rounded as ``(angle + pi) % (2 pi) - pi`` of highway-env, whose steering multiplies other rounding at a crawl. In
    Python :func:`~lanebound.integrity.core.frames.wrap_angle` rounds in the same way, for angles within two turns.
    """
    above = angle + math.pi
    return above - TWO_PI * math.floor(above / TWO_PI) - math.pi


@jit(inline=True)
def remainder(angle):  # type: ignore[no-untyped-def]
    """The angle in [-pi, pi], as ``math.remainder``: angles in this range are unchanged, which :func:`wrap` rounds."""
    return angle - TWO_PI * round(angle / TWO_PI)
