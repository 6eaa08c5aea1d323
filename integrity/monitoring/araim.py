"""Advanced RAIM of aviation (WG-C ARAIM ADD v3.1, appendix D) as a configuration of the road vehicle's kernel.

Fault modes are subsets of the satellites; East, North and Up are read from the two axes of the kernel. For the plane
the vehicle moves East: along-track is East, cross-track minus North. For the vertical the axes change names, (U, E, N)
for (E, N, U), and along-track is Up: nothing but the order of three columns.

The risk left after the modes not monitored is divided as ADD v3.1 does: ``P_VERT/(P_VERT + P_HOR)`` of it is vertical,
half of the rest each horizontal axis'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.monitoring.araim_kernel import AraimEpochs, ModeTables, level_modes
from lanebound.integrity.monitoring.fault_modes import FaultModes
from lanebound.integrity.monitoring.protection import protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig

__all__ = ["AraimConfig", "SortedModes", "checked_levels", "levels_at"]

Array = NDArray[np.float64]

EAST_RAD = 0.5 * np.pi  # heading for which along-track is the first column
UP_FIRST = (2, 0, 1)
GROUPS = 8
EPOCH_US = 60.0


class AraimConfig(Config):
    """Risks, false alarms and fault priors of ARAIM for LPV-200."""

    vertical_risk: float = Field(9.8e-8, gt=0, lt=1, description="P_HMI,VERT [-]; WG-C ARAIM ADD v3.1 table 3-2")
    horizontal_risk: float = Field(2e-9, gt=0, lt=1, description="P_HMI,HOR [-]; WG-C ARAIM ADD v3.1 table 3-2")
    vertical_false_alarm: float = Field(3.9e-6, gt=0, lt=1, description="P_FA,VERT [-]; WG-C ARAIM ADD v3.1 table 3-2")
    horizontal_false_alarm: float = Field(9e-8, gt=0, lt=1, description="P_FA,HOR [-]; WG-C ARAIM ADD v3.1 table 3-2")
    unmonitored_below: float = Field(8e-8, gt=0, lt=1, description="P_THRES [-]; WG-C ARAIM ADD v3.1 table 3-2")
    satellite_prior: float = Field(1e-5, ge=0, lt=1, description="P_sat [-]; ADD v3.1 table 3-1")
    constellation_prior: float = Field(1e-4, ge=0, lt=1, description="P_const [-]; ADD v3.1 table 3-1")
    at_once: int = Field(
        3, ge=1, le=4, description="most events of a fault mode [-]; as few as P_THRES allows are used"
    )

    @property
    def risk(self) -> float:
        """Risk of the vertical and of the plane together [-]."""
        return self.vertical_risk + self.horizontal_risk

    def axis_rules(self, vertical: bool) -> RiskConfig:
        """The road vehicle's rules for one run of the kernel: along-track is Up, or East beside North."""
        share = self.vertical_risk / self.risk
        return RiskConfig(
            integrity_risk=self.risk if vertical else self.horizontal_risk,
            at_share=share if vertical else 0.5,
            # the kernel's significance is of two axes, the vertical's of one
            false_alarm=2.0 * self.vertical_false_alarm if vertical else self.horizontal_false_alarm,
            satellite_prior=(self.satellite_prior,) * GROUPS,
            constellation_prior=(0.0,) * GROUPS,
            subtract_multiple=False,
        )


def levels_at(
    los_enu: Array,
    group: ArrayLike,
    variance_m2: ArrayLike,
    accuracy_m2: ArrayLike,
    bias_m: ArrayLike,
    config: AraimConfig,
    modes: FaultModes,
    times: Array,
) -> tuple[Array, Array]:
    """Levels of Up (E, R), and of East and North (E, R, 2), by two runs of the kernel (ADD v3.1 eq 12 to 29).

    The modes and what they leave are the same at all risks, so that one search serves all. A mode without a solution
    leaves no level: what cannot be monitored must be no mode, but a part of ``modes.unmonitored``.

    Parameters
    ----------
    los_enu : (E, m, 3) unit vectors receiver to satellite.
    group : (m,) constellation of each satellite, 0 to 7.
    variance_m2, accuracy_m2 : (E, m) or (m,) variances for integrity and for accuracy.
    bias_m : (E, m), (m,) or scalar bounds of the nominal biases.
    modes : modes of one satellite must have ``config.satellite_prior``.
    times : (R,) multiples of the risks of the configuration.

    Raises
    ------
    InputError
        As :func:`lanebound.integrity.monitoring.protection.protection_levels_batch`.
    """
    rules = [config.axis_rules(vertical) for vertical in (True, False)]
    levels = [
        protection_levels_batch(
            los_enu[..., UP_FIRST] if vertical else los_enu,
            True,
            group,
            variance_m2,
            EAST_RAD,
            rules[0 if vertical else 1],
            rules[0 if vertical else 1].integrity_risk * times,
            accuracy_m2=accuracy_m2,
            bias_m=bias_m,
            spent=modes.unmonitored * (1.0 if vertical else config.horizontal_risk / config.risk),
            subsets=modes.take(modes.several),
        ).root_m
        for vertical in (True, False)
    ]
    return levels[0][..., 0], levels[1]


@dataclass(frozen=True)
class SortedModes:
    """Fault modes of several satellites by how :mod:`.araim_kernel` finds them, and the sum of all others' priors.

    pair (P, 2); system (G, 2) group and one more satellite or -1, ascending by group; other (M, m); priors of them.
    """

    pair: NDArray[np.int64]
    system: NDArray[np.int64]
    other: NDArray[np.bool_]
    pair_prior: Array
    system_prior: Array
    other_prior: Array
    unmonitored: float

    @classmethod
    def of(cls, modes: FaultModes, group: NDArray[np.int64]) -> SortedModes:
        """The modes of satellites of these groups (m,)."""
        several = modes.take(modes.several)
        removes, count = several.removes, several.removes.sum(-1)
        system = np.full((count.size, 2), -1, dtype=np.int64)
        for g in np.unique(group)[::-1]:
            own = group == g
            whole = removes[:, own].all(-1) & (count - own.sum() <= 1)
            rest = removes & ~own
            system[whole, 0] = g
            system[whole, 1] = np.where(rest.any(-1), rest.argmax(-1), -1)[whole]
        in_system = system[:, 0] >= 0
        in_pair = ~in_system & (count == 2)
        order = np.flatnonzero(in_system)[np.argsort(system[in_system, 0], kind="stable")]
        other = ~in_system & ~in_pair
        return cls(
            np.argwhere(removes[in_pair])[:, 1].reshape(-1, 2), system[order], np.ascontiguousarray(removes[other]),
            several.prior[in_pair], several.prior[order], several.prior[other], modes.unmonitored,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.pair) + len(self.system) + len(self.other)


def checked_levels(
    los_enu: Array, group: NDArray[np.int64], variance_m2: Array, y_m: Array, config: AraimConfig, modes: SortedModes,
    times: Array, whole: Array | None = None,
) -> tuple[Array, Array, NDArray[np.bool_]]:  # fmt: skip
    """:func:`levels_at` without biases, for variances that are those for accuracy, and whether the separation of any
    mode exceeds its threshold (E,). The levels count on that test. y (E, m) observed minus computed [m].

    Modes without a solution at an epoch are not monitored there: they are spent as those that are no modes. All of
    these take the same share of both budgets, their prior over ``whole`` (R,), by default the risk of the vertical and
    of the plane together, as ADD v3.1 has it.
    """
    epochs, scale = los_enu.shape[0], np.asarray(times, dtype=np.float64)
    shared = config.risk * scale if whole is None else np.ascontiguousarray(whole, dtype=np.float64)
    found, alarm = [], np.zeros(epochs, bool)
    for vertical in (True, False):
        rules = config.axis_rules(vertical)
        k_fa = float(rules.false_alarm_factors(group.size + len(modes))[-1])
        tables = ModeTables(
            modes.pair, modes.system, modes.other, modes.pair_prior, modes.system_prior, modes.other_prior,
            np.full(GROUPS, config.satellite_prior), k_fa, rules.axis_budgets(rules.integrity_risk * scale), shared,
            modes.unmonitored,
        )  # fmt: skip
        rows = AraimEpochs(
            np.ascontiguousarray(los_enu[..., UP_FIRST] if vertical else los_enu), np.ascontiguousarray(group),
            np.ascontiguousarray(variance_m2), np.ascontiguousarray(y_m),
        )  # fmt: skip
        levels, worst = np.empty((epochs, scale.size, 2)), np.empty((epochs, 2))
        run_rows(level_modes, epochs, rows, tables, levels, worst, row_us=EPOCH_US)
        found.append(levels)
        alarm |= (worst[:, :1] if vertical else worst).max(-1) > k_fa
    return found[0][..., 0], found[1], alarm
