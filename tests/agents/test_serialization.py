"""JSON without infinities."""

from __future__ import annotations

import json
import math

import numpy as np

from lanebound.agents.serialization import finite_or_none, to_json_text


def test_what_is_not_finite_becomes_null_at_any_depth() -> None:
    data = {"a": [1.0, math.inf, (math.nan, "nan")], "b": {"c": -math.inf, "d": None, "e": True, "f": 3}}
    assert finite_or_none(data) == {"a": [1.0, None, [None, "nan"]], "b": {"c": None, "d": None, "e": True, "f": 3}}
    assert data["a"][1] == math.inf  # type: ignore[index]
    assert finite_or_none(np.float64("inf")) is None


def test_the_text_is_json_in_the_strict_sense() -> None:
    def refuse(word: str) -> None:
        raise AssertionError(word)

    text = to_json_text({"pl_m": math.inf, "unit": "µm"})
    assert json.loads(text, parse_constant=refuse) == {"pl_m": None, "unit": "µm"}
    assert "µm" in text
