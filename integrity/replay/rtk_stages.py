"""The RTK stages of ``rtk_reckoning`` for one recorded receiver without other sensors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.bundle_kernel import Bundle
from lanebound.integrity.core.chain_kernel import Chain
from lanebound.integrity.monitoring.exclusion import FdeConfig
from lanebound.integrity.monitoring.risk import RiskConfig, Variant
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import find_fixed_position
from lanebound.integrity.navigators.rtk_reckoning.navigator import (
    arrays_of,
    blank_outputs,
    blank_state,
    blank_work,
    carrier_stages,
)
from lanebound.integrity.navigators.rtk_reckoning.parameters import (
    case_table,
    epoch_parameters,
    mode_priors,
    satellite_table,
    separation_thresholds,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch, EpochInputs, Lasting, Measured, Tables
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.rtk_config import RtkConfig

__all__ = ["RtkStages", "Signals"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Signals(NamedTuple):
    """One epoch of S satellites: los (S, 3); variance factor, tracked, cn0, lost (S,); code, phase (S, 2) [m]."""

    los: Array
    quality: Array
    tracked: Bools
    cn0: Array
    code: Array
    phase: Array
    lost: Bools


class RtkStages:
    """Carrier lock, integer resolution, fixed position and its levels, epoch by epoch, of one receiver.

    Parameters
    ----------
    rtk, slips, fde, risk : their configurations
    system : (S,) of the satellites
    wavelength_m : (systems, bands)
    fixable : (S,) bool, satellites whose integers may be fixed
    bands : bands used
    """

    def __init__(
        self, rtk: RtkConfig, slips: CycleSlipConfig, fde: FdeConfig, risk: RiskConfig, system: NDArray[np.int64],
        wavelength_m: Array, fixable: Bools, bands: int,
    ) -> None:  # fmt: skip
        exact = risk.replace(variant=Variant.EXACT)
        positioning = {"rtk": rtk.to_dict(), "slips": slips.to_dict()}
        config = RtkReckoningConfig(positioning=positioning, fde=fde, risk=exact, gnss={"bands": tuple(range(bands))})
        parameters = epoch_parameters(config)
        parameters["modes"]["rtk_max_hdop"] = math.inf  # compute levels of every fixed position
        tables = Tables(
            satellite_table(system, wavelength_m, fixable, exact), system, mode_priors(system, exact),
            case_table(config.cases, exact, 0.0), *separation_thresholds(config, len(system)),
        )  # fmt: skip
        n = len(system)
        state, work, out = blank_state(1, n, tables.prior.size, 1, rtk), blank_work(1, n, 1), blank_outputs(1, n, 1)
        measured = Measured(
            np.zeros((1, n, 3)), np.zeros(1, np.int64), np.zeros((1, n), np.bool_), np.zeros((1, n)),
            np.zeros((1, n, 2)), np.zeros((1, n, 2)), np.zeros((1, n)), np.zeros((1, n), np.bool_), np.zeros(1),
            np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1), np.zeros((1, n, 2), np.int64),
        )  # fmt: skip
        self._lasting, self._inputs = Bundle(Lasting(parameters, tables, state, work, out)), EpochInputs(measured)
        self._stages = Chain(Epoch, *carrier_stages(rtk), find_fixed_position)

    def release(self) -> None:
        """Release all integers and forget all float ambiguities."""
        state = self._lasting.values.state
        state.ambiguities["held"] = False
        for array in arrays_of(state.filtered):
            array[:] = np.zeros((), array.dtype)

    def step(
        self, signals: Signals, age_s: float, dt_s: float, near_m: Array, sin_h: float, cos_h: float,
        ionosphere_m: float, troposphere_m: float,
    ) -> tuple[np.void, Array]:  # fmt: skip
        """Run the stages on one epoch; ``near_m`` (3,) is a point near the receiver.

        ``ionosphere_m`` (vertical) and ``troposphere_m`` (zenith) are the sigmas of what the atmosphere leaves.

        Returns the solution (FIXED_SOLUTION of :mod:`~lanebound.integrity.navigators.rtk_reckoning.records_kernel`) and
        its levels (2,) AT, CT [m], zeros unless it is fixed.
        """
        lasting: Lasting = self._lasting.values
        lasting.parameters["dt"] = dt_s
        filtered = lasting.parameters["rtk"]["filter"]
        filtered["ionosphere"], filtered["troposphere"] = ionosphere_m, troposphere_m
        lasting.work.quality[0] = signals.quality
        m = self._inputs.measured
        for target, value in (
            (m.los, signals.los), (m.tracked, signals.tracked), (m.cn0, signals.cn0), (m.code, signals.code),
            (m.phase, signals.phase), (m.lock_lost, signals.lost),
        ):  # fmt: skip
            target[0] = value
        m.age[0] = age_s
        lasting.state.vehicles["position"][0] = near_m
        w = lasting.work.vehicles
        w["sin_h"], w["cos_h"] = sin_h, cos_h
        self._stages(0, 1, self._lasting, self._inputs)
        return w["fixed"][0], lasting.work.fixed_levels[0, 0]
