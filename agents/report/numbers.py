"""Numbers as text: three significant digits, percentages, signs, intervals."""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = ["SHARE", "interval", "plain", "shorten", "signed"]

SHARE = "share"  # unit of what is between 0 and 1 and shown as a percentage


def plain(value: float | None, unit: str = "", short: bool = False) -> str:
    """A number without its unit, but for the percent sign; a dash for none.

    >>> plain(0.4537), plain(1234.5), plain(0.125, "share"), plain(None), plain(0.00012)
    ('0.454', '1,234', '12.5 %', '–', '0.00012')
    """
    if value is None or not math.isfinite(value):
        return "–"
    if unit == SHARE:
        return f"{_three(100.0 * value, 1, short)} %"
    return _three(value, 3, short)


def _three(value: float, decimals_max: int, short: bool) -> str:
    size = abs(value)
    if size >= 1000.0:
        return f"{value:,.0f}".replace("-", "−")
    if short:
        return f"{value:.4g}".replace("-", "−")
    if 0.0 < size < 0.5 * 10.0**-decimals_max:
        return f"{value:.2g}".replace("-", "−")
    decimals = min(decimals_max, 0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 1.0 else 3)
    return f"{value:.{decimals}f}".replace("-", "−")


def signed(value: float | None, unit: str = "", short: bool = False) -> str:
    """The same with a sign before positive values.

    >>> signed(0.5), signed(-0.02, "share")
    ('+0.500', '−2.0 %')
    """
    shown = plain(value, unit, short)
    return f"+{shown}" if value is not None and value > 0.0 else shown


def interval(
    mean: float | None,
    low: float | None,
    high: float | None,
    unit: str = "",
    show: Callable[[float | None, str], str] = plain,
) -> str:
    """A mean and its interval in brackets, the unit behind unless it is a percentage.

    >>> interval(1.0, 0.5, 2.0, "m")
    '1.00 [0.500, 2.00] m'
    """
    behind = f" {unit}" if unit and unit != SHARE else ""
    return f"{show(mean, unit)} [{show(low, unit)}, {show(high, unit)}]{behind}"


def shorten(words: str, letters: int) -> str:
    """Text of limited length, with dots in the middle.

    >>> shorten("my.package.module:policy", 12)
    'my.pac…olicy'
    """
    if len(words) <= letters:
        return words
    head = letters // 2
    return f"{words[:head]}…{words[len(words) - (letters - head - 1) :]}"
