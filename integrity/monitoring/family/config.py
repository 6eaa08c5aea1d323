"""A monitor of the family as a composition: weights of the codes, what is rejected, the test, and the level."""

from __future__ import annotations

from enum import Enum

from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.monitoring.araim import AraimConfig
from lanebound.integrity.monitoring.family.error_classes import ErrorClasses
from lanebound.integrity.positioning.danish import DanishConfig
from lanebound.integrity.positioning.rtk_config import ReflectionHypothesesConfig

__all__ = ["FamilyMonitorConfig", "LevelKind", "Rejection", "ShadowedUse", "TestKind", "WeightKind"]


class WeightKind(Enum):
    """Deviations of the codes."""

    GIVEN = "given"
    ELEVATION = "elevation"
    CN0 = "cn0"
    ELEVATION_CN0 = "elevation_cn0"
    CLASSES = "classes"


class ShadowedUse(Enum):
    """Codes whose direct path a map predicts to be blocked."""

    KEEP = "keep"
    DEWEIGHT = "deweight"
    EXCLUDE = "exclude"


class Rejection(Enum):
    """Which codes lose weight or are left out before the level is computed."""

    NONE = "none"
    LOCAL_TEST = "local_test"
    SEPARABLE = "separable"
    SEPARATION = "separation"
    RANSAC = "ransac"
    P_RANSAC = "p_ransac"
    DANISH = "danish"
    HUBER = "huber"
    IGG3 = "igg3"


class TestKind(Enum):
    """The test that raises an alarm."""

    __test__ = False

    NONE = "none"
    GLOBAL = "global"
    SEPARATION = "separation"


class LevelKind(Enum):
    """Form of the horizontal level; OWN is that of a registered monitor."""

    SLOPE = "slope"
    UNCERTAINTY = "uncertainty"
    WEIGHTED = "weighted"
    RELIABILITY = "reliability"
    ROAD = "road"
    SEPARATION = "separation"
    SEPARATION_PUBLISHED = "separation_published"
    SEPARATION_ROOT = "separation_root"
    SEPARATION_ODDS = "separation_odds"
    ARAIM = "araim"
    SBAS = "sbas"
    NORMAL = "normal"
    ISOTROPIC = "isotropic"
    ISOTROPIC_PUBLISHED = "isotropic_published"
    ISOTROPIC_KALMAN = "isotropic_kalman"
    COMPOSITE = "composite"
    RAYLEIGH = "rayleigh"
    PARETO = "pareto"
    RELATIVE_POSITION = "relative_position"
    RELATIVE_RANGE = "relative_range"
    EXTENDED = "extended"
    FIXED_CARRIERS = "fixed_carriers"
    OWN = "own"


class FamilyMonitorConfig(Config):
    """What a monitor does with an epoch; the parameters that its parts do not use have no effect."""

    weights: WeightKind = Field(WeightKind.GIVEN, description="deviations of the codes")
    shadowed: ShadowedUse = Field(ShadowedUse.KEEP, description="codes that a map predicts to be reflected")
    rejection: Rejection = Field(Rejection.NONE, description="codes left out or given less weight")
    test: TestKind = Field(TestKind.GLOBAL, description="test that raises an alarm")
    level: LevelKind = Field(LevelKind.SLOPE, description="form of the level")
    own_level: str = Field("", description="registered monitor whose level it is, of level own")
    classes: ErrorClasses | None = Field(None, description="fitted error classes; lanebound fit-errors")
    false_alarm: float = Field(1e-3, gt=0, lt=1, description="P_FA of the test at an epoch [-]; S5 section II")
    code_sigma_m: float = Field(
        1.5, gt=0, description="deviation at the zenith and 45 dB-Hz of the weight models [m]; chosen: S3 Table III"
    )
    shadowed_factor: float = Field(10.0, ge=1, description="factor on deviations of codes de-weighted by a map [-]")
    hal_m: float = Field(15.0, gt=0, description="alert limit at which road RAIM fixes its level [m]; S5 section II")
    satellite_prior: float = Field(
        1e-3,
        gt=0,
        lt=1,
        description="P(fault) of a code, for separation [-]; as in the code-only replay",
    )
    constellation_prior: float = Field(1e-4, ge=0, lt=1, description="P(fault) of a system in ARAIM [-]; ADD v3.1")
    reflections: ReflectionHypothesesConfig | None = Field(
        None, description="odds of codes by their loss of C/N0: the most doubtful are left out; none: all are used"
    )
    araim: AraimConfig | None = Field(None, description="aviation budgets of ARAIM; none: the risk of the road")
    en_route: bool = Field(
        False, description="K_H 6.18 of en route to LNAV, which S3 prints, in place of 6.0; DO-229D J.1"
    )
    vertical: bool = Field(
        False, description="vertical levels as well, at the same risk; ARAIM, SBAS and normal errors always state them"
    )
    most_excluded: int = Field(20, ge=0, le=64, description="most codes excluded one after another [-]")
    separable_below: float = Field(
        0.9, gt=0, le=1, description="largest correlation of tests of codes told apart [-]; chosen"
    )
    inlier_sigmas: float = Field(3.0, gt=0, description="largest range error of an inlier of RANSAC, in sigmas [-]")
    subsets: int = Field(48, ge=1, le=5000, description="subsets that RANSAC tries at an epoch, all if fewer exist [-]")
    seed: int = Field(0, ge=0, description="of the draws of subsets")
    danish: DanishConfig = DanishConfig()
    huber_k: float = Field(1.345, gt=0, description="normalised residual that keeps full weight [-]; 95 % efficiency")
    igg3_k0: float = Field(1.5, gt=0, description="normalised residual that keeps full weight [-]; IGG-III, 1.0 to 1.5")
    igg3_k1: float = Field(3.0, gt=0, description="normalised residual that loses all weight [-]; IGG-III, 2.5 to 3.0")
    robust_rounds: int = Field(12, ge=1, le=100, description="repetitions of robust weights [-]")
    window_s: float = Field(30.0, gt=0, description="time over which residuals are split [s]; chosen")
    coast_s: float = Field(30.0, gt=0, description="longest time that RRAIM coasts on carriers [s]; GEAS: 30 to 300 s")
    rayleigh_factor: float = Field(
        1.0, gt=0, description="scale of the Rayleigh law of error over the deviation in the plane [-]; fit-errors"
    )
    pareto_threshold: float = Field(1.0, ge=0, description="error over deviation where the Pareto tail begins [-]")
    pareto_share: float = Field(0.6, gt=0, le=1, description="share of errors beyond it [-]; exp(-1/2) if Rayleigh")
    pareto_scale: float = Field(1.0, gt=0, description="scale of the Pareto tail [-]; fit-errors")
    pareto_shape: float = Field(0.0, ge=-1, le=2, description="its shape, 0: exponential [-]; fit-errors")

    @model_validator(mode="after")
    def _parts_fit(self) -> FamilyMonitorConfig:
        if self.weights is WeightKind.CLASSES and self.classes is None:
            raise ValueError("classes is required where weights is 'classes': fit them with 'lanebound fit-errors'")
        if self.weights is WeightKind.CLASSES and self.classes is not None and not self.classes.symmetric:
            raise ValueError(
                "classes must bound both sides by one normal law each, got paired or one-sided laws, which a variance "
                "does not bound: fit them with 'lanebound fit-errors --set form=tail --set sides=both'"
            )
        if self.level is LevelKind.SEPARATION_ODDS and (self.reflections is None or self.reflections.sets < 1):
            raise ValueError(
                "reflections.sets must be at least 1 where level is 'separation_odds': give the odds of codes"
            )
        if self.level is LevelKind.OWN and not self.own_level:
            raise ValueError("own_level is required where level is 'own': name the registered monitor")
        if self.igg3_k1 <= self.igg3_k0:
            raise ValueError(f"igg3_k1 must be > igg3_k0 = {self.igg3_k0}, got {self.igg3_k1}: raise it")
        return self
