"""The generated cities that episodes take place in: without end for training, and a fixed set for tests."""

from __future__ import annotations

from enum import Enum
from typing import Self

from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError

__all__ = ["TEST_CITIES", "CitiesConfig", "Split"]

TRAIN_CITIES = 2**31  # seeds 0 to 2^31 - 1
TEST_CITIES = 100  # seeds 2^31 to 2^31 + 99; never used for tuning, nor for a shipped policy
TUNED_CITIES = 4  # the levels of skies, drivers and shipped policies were made on the first ones


class Split(Enum):
    """Cities for training, or for tests."""

    TRAIN = "train"
    TEST = "test"


class CitiesConfig(Config):
    """The generated cities of the episodes: the first ones of a split, one of them drawn for each episode.

    The city of number k is drawn from the streams ``city``, ``facades`` and ``map`` of the seed :meth:`seed_of` k, and
    with ``vary`` also from ``character`` (:meth:`.SkyLevel.of_city`). No seed is in both splits.

    >>> CitiesConfig(split="test").seed_of(0)
    2147483648
    """

    split: Split = Field(
        Split.TRAIN, description="train: as many as wanted; test: 100 others, fixed, never used for tuning"
    )
    count: int | None = Field(
        None, ge=1, le=TRAIN_CITIES, description="the first cities of the split; None: 4 of train, all 100 of test"
    )

    vary: bool = Field(
        False,
        description="each city draws order and lengths of its stretches, heights, width and materials about the sky's; "
        "false: all have those of the sky",
    )

    @model_validator(mode="after")
    def _test_set_is_fixed(self) -> Self:
        if self.split is Split.TEST and self.number > TEST_CITIES:
            raise ConfigError(
                f"count must be <= {TEST_CITIES} with split 'test', got {self.count}: the test cities are fixed; lower "
                "it, or set split to train"
            )
        return self

    @property
    def number(self) -> int:
        """Number of cities."""
        return self.count or (TUNED_CITIES if self.split is Split.TRAIN else TEST_CITIES)

    def seed_of(self, index: int) -> int:
        """The seed of the city with an index from 0."""
        return index + (0 if self.split is Split.TRAIN else TRAIN_CITIES)
