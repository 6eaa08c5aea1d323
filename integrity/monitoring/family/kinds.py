"""The monitors of the family by name, each with its source, what it needs and what it promises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.plugins import bare_name, unknown
from lanebound.integrity.core.presets import require_new
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig, LevelKind
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.levels import OWN_LEVELS, Level
from lanebound.integrity.positioning.rtk_config import CODE_REFLECTIONS

__all__ = ["FAMILY", "MonitorKind", "applicable", "monitor_named", "register_monitor", "withdraw_monitor"]

MISSED = "a bias of one code whose mean effect on the position exceeds HPL is missed with P_MD = risk at most"
ON_A_LINE = "approximate: bias and noise on one line; short of satellites P(error > HPL and no alarm) exceeds the risk"
RISK = "P(error > HPL) <= risk with single faults of their priors; two at once are not counted (S1, S2)"
NOMINAL = "P(error > HPL) <= risk of normal errors without faults"
NONE = "none proven"
EXCLUDING = (
    "P(error > HPL) <= risk with single faults of their priors if exclusion has left out the faulty codes; "
    "a wrong exclusion has no share of the risk"
)
ADVANCED = EXCLUDING.replace("single faults", "faults of up to two satellites and systems")
CHOSEN = EXCLUDING + ", and if code_sigma_m, which is chosen, bounds the codes"
MAPPED = EXCLUDING + ", and map or detector make no mistake"
FIXED = "P(error > HPL) <= risk with single faults of their priors and of the integers, if exclusion is right"
ODDS = "P(error > HPL) <= risk with codes off by their odds, independent given C/N0"
CODES = "codes"


@dataclass(frozen=True)
class MonitorKind:
    """One monitor: group of S3, what it does, source, needs, promise, and the changes of the configuration."""

    name: str
    group: str
    summary: str
    source: str
    promise: str
    changes: dict[str, Any]
    needs: tuple[str, ...] = (CODES,)

    def config(self, changes: dict[str, Any] | None = None) -> FamilyMonitorConfig:
        """The configuration of the kind, with further changes."""
        return FamilyMonitorConfig.load({**self.changes, **(changes or {})})


def _kind(
    name: str, group: str, summary: str, source: str, promise: str, needs: str = CODES, **changes: Any
) -> MonitorKind:
    return MonitorKind(name, group, summary, source, promise, changes, tuple(needs.split("+")))


RESIDUAL, SEPARATION, FREE, CITY, LAWS, TIME = (
    "residual RAIM", "separation", "no fault model", "rejection", "error laws", "carriers and time",
)  # fmt: skip
BY_ODDS: dict[str, Any] = {
    "level": "separation_odds", "test": "separation", "satellite_prior": 1e-5,
    "reflections": CODE_REFLECTIONS.to_dict(),
}  # fmt: skip
ROOT: dict[str, Any] = {"level": "separation_root", "test": "separation"}
KINDS = (
    _kind("residual", RESIDUAL, "global test of residuals, slope HPL", "S3 eq 6-14", MISSED, level="slope"),
    _kind("residual_fde", RESIDUAL, "the same after exclusion by local tests", "S3 III-A, S1 3.1",
          MISSED + ", if exclusion has left out the faulty codes",
          level="slope", rejection="local_test"),
    _kind("uncertainty", RESIDUAL, "HUL: the residuals found in place of the threshold", "S3 III-A", NONE,
          level="uncertainty"),
    _kind("weighted", RESIDUAL, "weighted RAIM of Walter and Enge", "S5 eq 1-4; ION GPS 1995", ON_A_LINE,
          level="weighted"),
    _kind("baarda", RESIDUAL, "data snooping at every epoch, external reliability", "Baarda 1968; S1 3.1",
          "external reliability: effect of the least bias that w-tests find with power 1 - risk; no bound of the error",
          level="reliability", test="separation", rejection="separation"),
    _kind("road", RESIDUAL, "level fixed at the alert limit, false alarms vary", "S3 V-B1 [17]", MISSED, level="road"),
    _kind("separation", SEPARATION, "closed form, exact factors", "S1 eq 17", RISK, level="separation",
          test="separation"),
    _kind("separation_published", SEPARATION, "closed form, printed factors", "S1 eq 13 and 17",
          "as printed: factors smaller than those of its own test", level="separation_published", test="separation"),
    _kind("separation_root", SEPARATION, "root of the sum over hypotheses", "S2 eq 10-11", RISK, **ROOT),
    _kind("separation_fde", SEPARATION, "the same after exclusion by separations", "S2 4.1", EXCLUDING, **ROOT,
          rejection="separation"),
    _kind("araim", SEPARATION, "faults of satellites and systems, exclusion, road budget", "WG-C ARAIM ADD v3.1",
          ADVANCED, level="araim", test="separation", rejection="separation"),
    _kind("araim_lpv200", SEPARATION, "the same with the budgets of LPV-200", "WG-C ARAIM ADD v3.1",
          "P_HMI of LPV-200, whatever the risk, if exclusion is right",
          level="araim", test="separation", rejection="separation", araim={}, satellite_prior=1e-5),
    _kind("sbas", SEPARATION, "K_H 6.0 of approaches times the largest deviation; S3 prints 6.18: en_route",
          "RTCA DO-229D J.1, S3 eq 5",
          "the ground segment bounds every error: here nobody does", level="sbas", test="none"),
    _kind("ibpl", FREE, "k |r| times the largest deviation, of isotropic errors", "S3 eq 15 [122]",
          "P(error > HPL) <= risk of isotropic errors, equal in a circular geometry", level="isotropic", test="none"),
    _kind("ibpl_published", FREE, "k |r| HDOP of isotropic errors, as printed", "S3 eq 15 [122]",
          "P(error > HPL) < risk of isotropic errors: HDOP is up to root 2 above the largest deviation",
          level="isotropic_published", test="none"),
    _kind("kipl", FREE, "its Kalman form, levels of epochs add up", "S3 V-B2 [123]",
          "P(error > HPL) <= risk of jointly elliptical errors", "codes+steps", level="isotropic_kalman", test="none"),
    _kind("composite", FREE, "noise and bias split by an AR model of residuals", "S3 eq 16 [124]",
          NONE, level="composite", test="none"),
    _kind("ransac", CITY, "RANSAC, then the root level", "S3 V-B1 [77]", NONE, **ROOT, rejection="ransac"),
    _kind("p_ransac", CITY, "P-RANSAC, then the root level", "S3 V-B1 [77]", NONE, **ROOT, rejection="p_ransac"),
    _kind("danish", CITY, "Danish weights, then the root level", "Krarup 1980; S3 V-B1", NONE, **ROOT,
          rejection="danish"),
    _kind("huber", CITY, "weights of Huber, then the root level", "Huber 1964", NONE, **ROOT, rejection="huber"),
    _kind("igg3", CITY, "weights of IGG-III, then the root level", "Yang 1994", NONE, **ROOT, rejection="igg3"),
    _kind("odds", CITY, "weak codes left out or fault modes with odds, in sets of up to three", "S2 eq 10-11; S3 V-A",
          ODDS, **BY_ODDS),
    _kind("odds_fde", CITY, "the same after exclusion by separations", "S2 eq 10-11; S3 V-A", EXCLUDING, **BY_ODDS,
          rejection="separation"),
    _kind("separable", CITY, "exclusion only where the fault can be told apart", "S3 V-B1 [70]", EXCLUDING, **ROOT,
          rejection="separable"),
    _kind("elevation", CITY, "weights by elevation, exclusion, root level", "S3 V-A", CHOSEN, **ROOT,
          rejection="local_test", weights="elevation"),
    _kind("cn0", CITY, "weights by C/N0, exclusion, root level", "S3 V-A", CHOSEN, **ROOT, rejection="local_test",
          weights="cn0"),
    _kind("elevation_cn0", CITY, "weights by both, exclusion, root level", "S3 V-A", CHOSEN, **ROOT,
          rejection="local_test", weights="elevation_cn0"),
    _kind("map_exclude", CITY, "codes called reflected by map or detector are left out", "S3 V-B1", MAPPED, "codes+map",
          **ROOT, rejection="local_test", shadowed="exclude"),
    _kind("map_deweight", CITY, "codes called reflected by map or detector weigh less", "S3 V-B1", MAPPED,
          "codes+map", **ROOT, rejection="local_test", shadowed="deweight"),
    _kind("normal", LAWS, "normal errors of the stated deviations", "S3 eq 5", NOMINAL, level="normal"),
    _kind("classes", LAWS, "overbounds by C/N0 x elevation x path, exclusion, root level", "S3 V-A; fit-errors",
          EXCLUDING, "codes+fit", **ROOT, rejection="local_test", weights="classes"),
    _kind("classes_normal", LAWS, "the same overbounds, normal level, no test", "S3 V-A; fit-errors", NOMINAL,
          "codes+fit", level="normal", test="none", weights="classes"),
    _kind("rayleigh", LAWS, "Rayleigh law of the position error", "S3 V-A", "quantile of the fitted law", "codes+fit",
          level="rayleigh", test="none"),
    _kind("pareto", LAWS, "Pareto tail of the position error", "S3 V-A", "quantile of the fitted law", "codes+fit",
          level="pareto", test="none"),
    _kind("rraim_position", TIME, "an anchor of codes, positions carried on by carriers", "S3 III-A [60]", EXCLUDING,
          "codes+carriers", level="relative_position", test="separation", rejection="separation"),
    _kind("rraim_range", TIME, "an anchor of codes, ranges carried on by carriers", "S3 III-A [60]", EXCLUDING,
          "codes+carriers", level="relative_range", test="separation", rejection="separation"),
    _kind("eraim", TIME, "separation of filters aided by displacements", "S3 III-A [50]", EXCLUDING, "codes+steps",
          level="extended", test="none", rejection="separation"),
    _kind("craim", TIME, "fixed carriers, separation, with the risk of the fix", "S3 III-A", FIXED, "codes+fixed",
          level="fixed_carriers", test="none"),
)  # fmt: skip


FAMILY: dict[str, MonitorKind] = {kind.name: kind for kind in KINDS}
NEEDS = (CODES, "steps", "map", "carriers", "fixed", "fit")


def monitor_named(name: str) -> MonitorKind:
    """The kind of this name, or ConfigError. ``package.module:name`` imports the module first."""
    bare = bare_name(name)
    if bare not in FAMILY:
        raise ConfigError(f"monitor must be one of the family, got {name!r}: {unknown(bare, FAMILY)}")
    return FAMILY[bare]


def register_monitor(
    name: str, summary: str, source: str, promise: str, needs: tuple[str, ...] = (CODES,), level: Level | None = None,
    **changes: Any,
) -> MonitorKind:  # fmt: skip
    """Add a monitor of code positions, which configurations may then name.

    Parameters
    ----------
    name, summary, source, promise : as in the table of ``lanebound monitors``
    needs : what it reads, among NEEDS
    level : function of a :class:`~.levels.LevelWork` that returns the horizontal levels (E, R) [m] of E epochs at R
        risks, inf where there is none; None: the level of ``changes``
    changes : of :class:`~.config.FamilyMonitorConfig`: test, rejection, weights, level

    Raises
    ------
    InputError
        The name is taken or no identifier, the level is no function, or there is no such need.
    ConfigError
        A change is refused.
    """
    require_new("a monitor", name, FAMILY)
    if level is not None and not callable(level):
        raise InputError(f"level of monitor {name!r} must be a function of a LevelWork, got {level!r}: give one")
    missing = [need for need in needs if need not in NEEDS]
    if missing:
        raise InputError(f"needs must be among {', '.join(NEEDS)}, got {missing[0]!r}: correct it")
    if level is not None:
        changes = {**changes, "level": LevelKind.OWN.value, "own_level": name}
    kind = MonitorKind(name, "registered", summary, source, promise, changes, needs)
    kind.config()
    if level is not None:
        OWN_LEVELS[name] = level
    FAMILY[name] = kind
    return kind


def withdraw_monitor(name: str) -> None:
    """Remove a registered monitor.

    Raises
    ------
    InputError
        There is none of this name, or it is one of the package.
    """
    if name not in FAMILY or FAMILY[name] in KINDS:
        raise InputError(f"monitor must be a registered one, got {name!r}: the monitors of the package stay")
    del FAMILY[name]
    OWN_LEVELS.pop(name, None)


def applicable(epochs: CodeEpochs, fitted: bool = False) -> list[MonitorKind]:
    """The kinds whose needs these epochs meet; ``fitted`` where error classes are at hand."""
    there = {CODES}
    there |= {"map"} if epochs.shadowed is not None else set()
    there |= {"steps"} if epochs.step_enu_m is not None else set()
    there |= {"carriers"} if epochs.carrier_step_m is not None else set()
    there |= {"fixed"} if epochs.fixed_m is not None else set()
    there |= {"fit"} if fitted else set()
    return [kind for kind in FAMILY.values() if there.issuperset(kind.needs)]
