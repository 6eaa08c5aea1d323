"""The published seeds: disjoint splits for training and tuning, and for tests."""

from __future__ import annotations

from typing import Final, Literal

__all__ = ["SPLITS", "TEST", "TRAIN", "Split"]

Split = Literal["train", "test"]

TRAIN: Final = range(1000, 2000)
TEST: Final = range(10_000, 20_000)
SPLITS: Final[dict[Split, range]] = {"train": TRAIN, "test": TEST}
