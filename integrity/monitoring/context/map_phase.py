"""Third phase of S5: do matched positions move as the measured ones? S5 equations 9 to 13, and the fuzzy score.

Over the last N epochs: ``DD = |D_map - D_gps|`` of the summed distances between matched and between measured positions,
``DS = |D_map / (N dt) - AS_D|`` with the average Doppler speed, and ``DA`` the angle between the link and the motion.

S5 equation 10 takes the errors of position and map, summed over the epochs, from D_map. With errors of metres DD then
exceeds its bound of 8 m at every epoch; ``printed_allowance`` computes it nevertheless.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.row_memory import EVERY, Memory, Rows
from lanebound.integrity.monitoring.context.fuzzy import RuleBase, s5_rules
from lanebound.integrity.monitoring.context.link_scores import ScoreKind
from lanebound.integrity.positioning.map_matching.matching import MapMatches
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK

__all__ = ["MapPhase", "MapPhaseConfig", "MapTest"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

S5_THRESHOLD = 71.0  # of its score; S5 section 4.3, figure 8


class MapPhaseConfig(Config):
    """The third phase; S5 sections 3.3, 4.2 and 5."""

    score: ScoreKind = Field(
        ScoreKind.CONTEXT, description="context (S5), quddus, velaga, jabbour or yu; each needs a threshold of its own"
    )
    threshold: float | None = Field(
        None, ge=0, le=100, description="score below which the driver is warned; default of context 71 (S5 section 4.3)"
    )
    intervals: int = Field(10, ge=1, le=600, description="N, over which distances are summed [epochs]; as in phase 2")
    printed_allowance: bool = Field(False, description="subtract errors of position and map as in S5 eq 10")
    map_sigma_m: float = Field(
        5.0, ge=0, description="error of the map for printed_allowance, quddus and velaga [m]; chosen"
    )
    least_probability: float = Field(
        0.0, ge=0, le=1, description="least probability of the matched link [-]; 0: as S5, which has none"
    )
    rules: RuleBase = Field(default_factory=s5_rules, description="the fuzzy system, or the name of its preset")

    @model_validator(mode="after")
    def _other_scores_have_a_threshold(self) -> Self:
        # Those of S5 Table 6 (Quddus 70, Velaga 82) warn of all and of a fifth of the right points by these readings.
        if self.threshold is None and self.score is not ScoreKind.CONTEXT:
            raise ConfigError(
                f"threshold must be given with score = {self.score}, got none: the 71 of S5 is of its own score; take "
                "one from docs/results/map-matching.md, or fit it by lanebound reproduce map-matching"
            )
        return self

    @property
    def least_score(self) -> float:
        """Score below which the driver is warned."""
        return S5_THRESHOLD if self.threshold is None else self.threshold


class MapTest(NamedTuple):
    """Results of B vehicles: score (B,) 0 without a match; the three differences (B,); matched (B,)."""

    score: Array
    heading_deg: Array
    distance_m: Array
    speed_mps: Array
    matched: Bools
    passed: Bools


class MapPhase:
    """Measured and matched positions of the last N epochs of B vehicles.

    ``memory``: steps (B, N, 4) distances between matched and between measured positions, errors, times, the newest
    last; count (B,) of them; last (B, 4) matched and measured position, NaN without.
    """

    def __init__(self, config: MapPhaseConfig, batch: int) -> None:
        self.config = config
        self.memory: Memory = {
            "steps": np.zeros((batch, config.intervals, 4)), "count": np.zeros(batch, np.int64),
            "last": np.full((batch, 4), np.nan),
        }  # fmt: skip

    def forget(self, rows: Rows) -> None:
        """Begin anew with these vehicles."""
        self.memory["count"][rows], self.memory["last"][rows] = 0, np.nan

    def step(
        self,
        match: MapMatches,
        position_en_m: Array,
        sigma_m: Array,
        heading_rad: Array,
        average_mps: Array,
        dt_s: float,
        rows: Rows = EVERY,
        headed: Bools | None = None,
        score: Array | None = None,
    ) -> MapTest:
        """Score the match of an epoch of the vehicles in ``rows``; B is their number.

        Parameters
        ----------
        match : of B vehicles
        position_en_m, sigma_m, heading_rad : (B, 2), (B,), (B,) measured, with the 1 sigma of the position
        average_mps : (B,) average Doppler speed of the second phase
        dt_s : length of an epoch
        headed : (B,) the heading is known (default: all); where it is not, distance and speed alone are compared
        score : (B,) of another method, in place of that of S5
        """
        c, matched = self.config, match.link != NO_LINK
        here = np.concatenate([match.foot_en_m, position_en_m], -1)
        steps, count, last = (self.memory[name][rows] for name in ("steps", "count", "last"))
        moved = np.linalg.norm((here - last).reshape(-1, 2, 2), axis=-1)
        joined = matched & np.isfinite(moved).all(-1)
        sample = np.concatenate([moved, sigma_m[:, None], np.full((sigma_m.size, 1), dt_s)], -1)
        steps = np.concatenate([steps[:, 1:], np.where(joined[:, None], sample, 0.0)[:, None]], 1)
        count = np.where(joined, np.minimum(count + 1, c.intervals), 0)
        self.memory["steps"][rows], self.memory["count"][rows] = steps, count
        self.memory["last"][rows] = np.where(matched[:, None], here, np.nan)
        recent = np.arange(c.intervals)[::-1] < count[:, None]
        mapped, measured, errors, time = (np.where(recent, steps[..., k], 0.0).sum(-1) for k in range(4))
        speed = np.where(time > 0.0, mapped / np.where(time > 0.0, time, 1.0), average_mps)
        if c.printed_allowance:
            mapped = mapped - errors - c.map_sigma_m * recent.sum(-1)
        distance, off = np.abs(mapped - measured), np.abs(speed - average_mps)
        angle = np.rad2deg(np.abs(wrap_angle(match.heading_rad - heading_rad)))
        angle = angle if headed is None else np.where(headed, angle, 0.0)
        if score is None:
            score = np.where(matched, c.rules.score(angle, distance, off), 0.0)
        passed = matched & (score >= c.least_score) & (match.probability >= c.least_probability)
        return MapTest(score, angle, distance, off, matched, passed)
