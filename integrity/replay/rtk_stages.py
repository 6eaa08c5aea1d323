"""The RTK stages of ``rtk_reckoning`` for one recorded receiver without other sensors.

Each signal of a satellite is an entry of its own with one band, so that satellites may have any number of them. The
first one of a satellite stands for it in positions and their fault tests; the others help to find its integers. They
share its ionosphere, and a satellite under suspicion is left out with all its signals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.exclusion import FdeConfig
from lanebound.integrity.monitoring.risk import RiskConfig, Variant
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.epoch import carrier_stages
from lanebound.integrity.navigators.rtk_reckoning.navigator import (
    arrays_of,
    blank_epoch,
    blank_filters,
    blank_state,
)
from lanebound.integrity.navigators.rtk_reckoning.parameters import (
    case_table,
    epoch_parameters,
    mode_priors,
    satellite_table,
    separation_thresholds,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Tables
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.rtk_config import RtkConfig

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FEWEST = 4  # candidates that RtkConfig demands


class Signals(NamedTuple):
    """One epoch of N signals: los (N, 3); variance factor, tracked, cn0, lost, code and phase [m], (N,) each."""

    los: Array
    quality: Array
    tracked: Bools
    cn0: Array
    code: Array
    phase: Array
    lost: Bools


class Entries(NamedTuple):
    """Signals (N,) of satellites: index of the satellite in the table, column of the signal in the choice, number of
    its clock (below MAX_GROUPS), entry of the first signal of that satellite, wavelength [m], whether it may be fixed.
    """

    satellite: NDArray[np.int64]
    column: NDArray[np.int64]
    clock: NDArray[np.int64]
    host: NDArray[np.int64]
    wavelength_m: Array
    fixable: Bools


class RtkStages:
    """Carrier lock, integer resolution, fixed position and its levels, epoch by epoch, of one receiver.

    Parameters
    ----------
    rtk, slips, fde, risk : their configurations; ``max_candidates`` of rtk counts signals
    entries : the signals
    stands : the receiver does not move
    """

    def __init__(
        self, rtk: RtkConfig, slips: CycleSlipConfig, fde: FdeConfig, risk: RiskConfig, entries: Entries,
        stands: bool = False,
    ) -> None:  # fmt: skip
        exact = risk.replace(variant=Variant.EXACT)
        most = min(rtk.max_candidates, max(len(entries.clock), FEWEST))
        positioning = {"rtk": rtk.to_dict() | {"max_candidates": FEWEST}, "slips": slips.to_dict()}
        config = RtkReckoningConfig(positioning=positioning, fde=fde, risk=exact, gnss={"bands": (0,)})
        parameters = epoch_parameters(config)
        parameters["rtk"]["max_candidates"] = most
        system = entries.clock
        parameters["modes"]["rtk_max_hdop"] = math.inf  # compute levels of every fixed position
        tables = Tables(
            _satellites(entries, exact), mode_priors(system, exact), case_table(config.cases, exact, 0.0),
            *separation_thresholds(config, len(system)),
        )  # fmt: skip
        rtk = rtk.replace(max_candidates=most)
        state = blank_state(1, len(system), tables.prior.size, 1, rtk)._replace(filters=blank_filters(1, rtk, stands))
        self._epoch = blank_epoch(parameters, tables, state)
        self._stages = carrier_stages(rtk.float_solution.kind == "sequential")

    def release(self) -> None:
        """Release all integers and forget all float ambiguities."""
        epoch = self._epoch
        epoch.ambiguities["held"] = False
        for array in (epoch.vehicles["filter"], *arrays_of((epoch.filters,))):
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
        epoch = self._epoch
        epoch.parameters["dt"] = dt_s
        filtered = epoch.parameters["rtk"]["filter"]
        filtered["ionosphere"], filtered["troposphere"] = ionosphere_m, troposphere_m
        epoch.marks["quality"][0] = signals.quality
        m = epoch.signals[0]
        m["e"], m["tracked"], m["cn0"], m["lock_lost"] = signals.los, signals.tracked, signals.cn0, signals.lost
        m["code"][:, 0], m["phase"][:, 0] = signals.code, signals.phase
        epoch.observed["age"] = age_s
        epoch.vehicles["position"][0] = near_m
        epoch.work["sin_h"], epoch.work["cos_h"] = sin_h, cos_h
        for stage in self._stages:
            stage(0, 1, epoch)
        return epoch.work["fixed"][0], epoch.fixed_levels[0, 0]


def _satellites(entries: Entries, risk: RiskConfig) -> Records:
    """SATELLITE (N,) of the signals."""
    hosts = entries.clock[entries.host]
    out = satellite_table(hosts, np.ones((int(hosts.max(initial=0)) + 1, 1)), entries.fixable, risk)
    out["system"], out["wavelength"][:, 0] = entries.clock, entries.wavelength_m
    out["further"], out["host"] = entries.host != np.arange(len(hosts)), entries.host
    out["first"] = entries.wavelength_m[entries.host]
    return out
