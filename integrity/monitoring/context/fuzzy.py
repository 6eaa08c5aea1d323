"""The Sugeno system of S5: 18 rules on the differences of heading, distance and speed; a score of 0 to 100.

``score = sum_r f_r z_r / sum_r f_r``: the strength ``f_r`` of a rule is the product of the memberships of its three
terms; its output is ``z_r = 100 (w_h g_h + w_d g_d + w_s g_s)`` with the weights of the factors and the grades of the
terms, at most the bound of the rule's level. S5 prints rules, weights, bounds of the terms and the threshold, and no
output values. With the grades 1, 0.5 and 0 the weighted sum gives rules 1 to 9 exactly the order of their printed
levels: 85 and more very high, 70 high, 55 average, 40 low. A threshold of 71 then warns below "very high".

The terms of S5's preset overlap, so that a difference at the bound of a term counts half. With the others at 0 warnings
begin at DD = 9.73 m, DS = 12.17 m/s and DA = 88.5 degrees; S5 calls DD above 8 and DS above 10 not to be trusted.
``monitors/context_rules_crisp`` has terms that end at these bounds.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError, require_finite
from lanebound.integrity.core.presets import preset_values

__all__ = ["FuzzyFactor", "FuzzyRule", "FuzzyTerm", "RuleBase", "s5_rules"]

Array = NDArray[np.float64]

FACTORS = ("heading", "distance", "speed")


class FuzzyTerm(Config):
    """A term of a factor: its membership is linear between points and constant beyond them."""

    name: str
    points: tuple[tuple[float, float], ...] = Field(min_length=1, description="value of the factor, membership")
    grade: float = Field(ge=0, le=1, description="what the term contributes of the factor's weight [-]")


class FuzzyFactor(Config):
    """An input of the system."""

    weight: float = Field(ge=0, le=1, description="share of the score [-]; S5 section 5.2")
    terms: tuple[FuzzyTerm, ...] = Field(min_length=1)

    def memberships(self, value: Array) -> Array:
        """Memberships of values (...,) in all terms, (..., terms)."""
        return np.stack([np.interp(value, *np.transpose(term.points)) for term in self.terms], -1)


class FuzzyRule(Config):
    """A rule: three terms and a level."""

    rule: int = Field(ge=1, description="number in S5 Table 1")
    heading: str
    distance: str
    speed: str
    level: str


class RuleBase(Config):
    """Factors, levels and rules; ``RuleBase.preset("monitors/context_rules")`` is that of S5.

    A configuration may name a preset: ``map.rules=monitors/context_rules_crisp``.

    Raises
    ------
    ConfigError
        A rule names an unknown term or level, a combination of terms has no rule or several, or weights do not sum
        to 1.
    """

    heading: FuzzyFactor
    distance: FuzzyFactor
    speed: FuzzyFactor
    levels: dict[str, float]
    rules: tuple[FuzzyRule, ...]

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        """The name of a preset in place of a mapping."""
        return preset_values(data) if isinstance(data, str) else data

    @model_validator(mode="after")
    def _complete(self) -> Self:
        total = sum(factor.weight for factor in self.factors)
        if abs(total - 1.0) > 1e-9:
            raise ConfigError(f"the weights must sum to 1, got {total:g}: scale them")
        names = [[term.name for term in factor.terms] for factor in self.factors]
        wanted = {(h, d, s) for h in names[0] for d in names[1] for s in names[2]}
        found = [(rule.heading, rule.distance, rule.speed) for rule in self.rules]
        if set(found) != wanted or len(found) != len(wanted):
            raise ConfigError(
                f"rules must hold each of the {len(wanted)} combinations of terms once, got {len(found)} rules of "
                f"{len(set(found) & wanted)} combinations: add or remove rules"
            )
        for rule in self.rules:
            if rule.level not in self.levels:
                raise ConfigError(f"level of rule {rule.rule} must be one of {list(self.levels)}, got {rule.level!r}")
        return self

    @property
    def factors(self) -> tuple[FuzzyFactor, FuzzyFactor, FuzzyFactor]:
        """Heading, distance, speed."""
        return self.heading, self.distance, self.speed

    @cached_property
    def table(self) -> NDArray[np.int64]:
        """Terms of each rule, (rules, 3)."""
        names = [[term.name for term in factor.terms] for factor in self.factors]
        return np.array(
            [[names[k].index(getattr(rule, FACTORS[k])) for k in range(3)] for rule in self.rules], np.int64
        )

    @cached_property
    def outputs(self) -> Array:
        """Output of each rule, (rules,)."""
        sums = 100.0 * sum(
            factor.weight * np.array([term.grade for term in factor.terms])[self.table[:, k]]
            for k, factor in enumerate(self.factors)
        )  # fmt: skip
        return np.minimum(sums, [self.levels[rule.level] for rule in self.rules])

    def strengths(self, heading_deg: ArrayLike, distance_m: ArrayLike, speed_mps: ArrayLike) -> Array:
        """Strength of each rule, (..., rules)."""
        values = np.broadcast_arrays(
            *(require_finite(name, v) for name, v in zip(FACTORS, (heading_deg, distance_m, speed_mps), strict=True))
        )
        out: Array = np.ones((*values[0].shape, len(self.rules)))
        for k, factor in enumerate(self.factors):
            out = out * factor.memberships(np.asarray(values[k], np.float64))[..., self.table[:, k]]
        return out

    def score(self, heading_deg: ArrayLike, distance_m: ArrayLike, speed_mps: ArrayLike) -> Array:
        """Integrity score 0 to 100 of differences (...,): the sum of the outputs, weighted with the strengths."""
        strength = self.strengths(heading_deg, distance_m, speed_mps)
        total = strength.sum(-1)
        return np.asarray((strength * self.outputs).sum(-1) / np.where(total > 0.0, total, 1.0))


@lru_cache(maxsize=1)
def s5_rules() -> RuleBase:
    """The rules of S5."""
    return RuleBase.preset("monitors/context_rules")
