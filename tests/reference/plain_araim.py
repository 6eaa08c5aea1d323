"""ARAIM of aviation with all that it reports, every mode solved anew (WG-C ARAIM ADD v3.1, eq 12 to 31)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.monitoring.araim import EAST_RAD, GROUPS, UP_FIRST, AraimConfig, levels_at
from lanebound.integrity.monitoring.fault_modes import FaultModes, enumerate_faults
from lanebound.integrity.monitoring.separation import Separation, separate

Array = NDArray[np.float64]

P_EMT = 1e-5  # prior from which a mode counts in the EMT, ADD v3.1 table 3-2


@dataclass(frozen=True)
class AraimLevels:
    """Levels of E epochs.

    Attributes
    ----------
    vpl_m, hpl_m : (E,) vertical and horizontal protection level, inf where none
    hpl_en_m : (E, 2) of East and North
    emt_m : (E,) effective monitor threshold of the vertical
    sigma_v_acc_m : (E,) standard deviation of the vertical for accuracy
    modes : the fault modes
    k_fa_vertical, k_fa_horizontal : thresholds of the separation tests, in sigmas
    """

    vpl_m: Array
    hpl_m: Array
    hpl_en_m: Array
    emt_m: Array
    sigma_v_acc_m: Array
    modes: FaultModes
    k_fa_vertical: float
    k_fa_horizontal: float


def araim(
    los_enu: ArrayLike,
    group: ArrayLike,
    variance_m2: ArrayLike,
    accuracy_m2: ArrayLike,
    bias_m: ArrayLike,
    config: AraimConfig | None = None,
    modes: FaultModes | None = None,
) -> AraimLevels:
    """VPL, HPL, EMT and vertical accuracy of epochs with the same satellites (WG-C ARAIM ADD v3.1, eq 12 to 31).

    Parameters
    ----------
    los_enu : (E, m, 3) unit vectors receiver to satellite.
    group : (m,) constellation of each satellite, 0 to 7.
    variance_m2, accuracy_m2 : (E, m) or (m,) variances for integrity and for accuracy.
    bias_m : (E, m), (m,) or scalar bounds of the nominal biases.
    modes : in place of those that the priors ask for; modes of one satellite must have ``config.satellite_prior``.
    """
    rules = AraimConfig() if config is None else config
    los = np.asarray(los_enu, dtype=np.float64)
    owner = np.asarray(group, dtype=np.int64)
    if modes is None:
        modes = enumerate_faults(
            owner,
            rules.satellite_prior,
            rules.constellation_prior,
            unmonitored_below=rules.unmonitored_below,
            at_once=rules.at_once,
        )
    up_m, plane_m = levels_at(los, owner, variance_m2, accuracy_m2, bias_m, rules, modes, np.ones(1))
    vertical, horizontal = up_m[:, 0], plane_m[:, 0]
    factors = [float(rules.axis_rules(v).false_alarm_factors(len(modes))[-1]) for v in (True, False)]
    up = vertical_separation(los, owner, variance_m2, accuracy_m2, bias_m, modes)
    spread = np.broadcast_to(np.asarray(accuracy_m2, dtype=np.float64), los.shape[:2])
    counts = np.concatenate([[False], modes.prior >= P_EMT])
    return AraimLevels(
        vpl_m=vertical,
        hpl_m=np.hypot(horizontal[:, 0], horizontal[:, 1]),
        hpl_en_m=horizontal,
        emt_m=factors[0] * np.where(counts, up.delta_m[..., 0], 0.0).max(-1),
        sigma_v_acc_m=np.sqrt((up.gain_track[:, 0, 0] ** 2 * spread).sum(-1)),
        modes=modes,
        k_fa_vertical=factors[0],
        k_fa_horizontal=factors[1],
    )


def vertical_separation(
    los_enu: Array,
    group: ArrayLike,
    variance_m2: ArrayLike,
    accuracy_m2: ArrayLike,
    bias_m: ArrayLike,
    modes: FaultModes,
) -> Separation:
    """Solution and separations of Up (axis 0) and East (axis 1) for every mode, the plain way.  Shapes as araim."""

    def diagonal(variance: ArrayLike) -> Array:
        wide = np.broadcast_to(np.asarray(variance, dtype=np.float64), los_enu.shape[:2])
        return wide[..., None] * np.eye(los_enu.shape[1])

    clocks = np.broadcast_to(np.asarray(group)[:, None] == np.arange(GROUPS), (*los_enu.shape[:2], GROUPS))
    return separate(
        np.concatenate([-los_enu[..., UP_FIRST], clocks], -1),
        diagonal(variance_m2),
        modes.removes,
        np.full(los_enu.shape[0], EAST_RAD),
        accuracy=diagonal(accuracy_m2),
        bias=bias_m,
    )
