"""Slips of held carriers: every one of a cycle is found at its epoch, right changes are left alone, repairs pay."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import poisson
from signal_records import records_of

from lanebound.integrity.navigators.rtk_reckoning.records_kernel import MARK
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.parameters import rtk_parameters, slip_parameters
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY, SATELLITE, Carriers
from lanebound.integrity.positioning.slip_watch_kernel import SLIP_WATCH, DopplerMotion, watch_slips
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import WAVELENGTH_M

Array = NDArray[np.float64]
WAVES = np.ascontiguousarray(WAVELENGTH_M[:, :2])
SYSTEM = np.array([0, 0, 0, 0, 0, 1, 1, 1, 1, 3, 3, 3])
N_SAT, DT = len(SYSTEM), 0.1
SIGMA_M, SIGMA_MPS = 0.004, 0.05


@dataclass
class _Watch:
    """A vehicle on a curve under a turning sky, whose carriers are all held."""

    seed: int
    failure: float = 1e-4
    limit: float = 1e-2
    bands: int = 2
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = rng = np.random.default_rng(self.seed)
        self.azimuth, self.elevation = rng.uniform(0.0, 2.0 * math.pi, N_SAT), rng.uniform(0.4, 1.4, N_SAT)
        self.true = np.round(rng.uniform(-1e4, 1e4, (N_SAT, 2)))
        self.clock = 100.0 * rng.standard_normal((5, 2))
        self.fixes, self.satellites = np.zeros(N_SAT, AMBIGUITY), np.zeros(N_SAT, SATELLITE)
        self.fixes["held"], self.fixes["integers"], self.fixes["fix_id"], self.fixes["fix_risk"] = (
            True,
            self.true,
            1,
            1e-7,
        )
        self.satellites["system"], self.satellites["wavelength"] = SYSTEM, WAVES[SYSTEM]
        self.watch, self.time = np.zeros(1, SLIP_WATCH)[0], 0.0
        self.rtk = rtk_parameters(RtkConfig(), self.bands, 1.0)[0]
        self.rtk["fix_limit"], self.slips = self.limit, CycleSlipConfig(repair_failure_rate=self.failure)
        self.place, self.age = np.array([700.0, -900.0, 30.0]), 0.5

    def step(
        self, *, solved: bool = True, lie: float = 0.0, age: float | None = None, noise: float = 1.0,
        drift_m: float = 0.0,
    ) -> int:  # fmt: skip
        """The next epoch; ``lie`` [m/s] is added to the Doppler velocity. Returns the slips found."""
        self.time += DT
        before, after = 8.0 * math.sin(self.time - DT), 8.0 * math.sin(self.time)
        self.place = self.place + 0.5 * DT * np.array([before + after, 12.0, 0.0])
        turned = self.azimuth + 1.5e-4 * self.time
        c = np.cos(self.elevation)
        e = np.column_stack([c * np.sin(turned), c * np.cos(turned), np.sin(self.elevation)])
        self.clock += 30.0 * DT  # a drifting receiver clock
        phase = -(e @ self.place)[:, None] + self.clock[SYSTEM] + WAVES[SYSTEM] * self.true
        phase += noise * SIGMA_M * self.rng.standard_normal((N_SAT, 2))
        phase += drift_m * self.rng.standard_normal(N_SAT)[:, None]
        velocity = np.array([after, 6.0, 0.0]) + noise * SIGMA_MPS * self.rng.standard_normal(3) + lie
        motion = DopplerMotion(DT, solved, velocity, SIGMA_MPS**2 * np.eye(3), self.place + 3.0)
        signals, marks = records_of(OBSERVED_SIGNAL, N_SAT, e=e, phase=phase), records_of(MARK, N_SAT, phase_ok=True)
        carriers = Carriers(self.satellites, signals, np.full(N_SAT, SIGMA_M**2))
        found = watch_slips(
            carriers, marks, self.age if age is None else age, motion, self.fixes, self.rtk,
            slip_parameters(self.slips)[0], self.watch, 50,
        )  # fmt: skip
        return int(found)


def test_whole_drives_without_slips_raise_hardly_an_alarm() -> None:
    """12 satellites x 3000 epochs at 1e-5 each: a Poisson count (once in 1000 seeds), with clocks and sky in motion."""
    w = _Watch(1, failure=1e-9)
    found = 0
    for _ in range(3000):
        found += w.step()
        w.fixes["held"][:] = True
    assert found <= poisson.ppf(0.999, 12 * 3000 * 1e-5)


@pytest.mark.parametrize("cycles", [(1, 0), (0, 1), (1, 1), (-1, -1), (2, -3), (9, 7), (0.5, 0.0), (0.5, 0.5)])
def test_a_slip_is_found_at_its_epoch_and_only_there(cycles: tuple[float, float]) -> None:
    for s in (0, 4, 7, 11):
        w = _Watch(7 + s, failure=1e-12)
        w.step()
        assert w.step() == 0
        w.true[s] += cycles
        assert w.step() == 1
        np.testing.assert_array_equal(np.flatnonzero(~w.fixes["held"]), [s])
        assert w.step() == 0


def test_a_slip_that_only_one_pair_explains_is_repaired_and_pays_its_risk() -> None:
    w = _Watch(3)
    w.step()
    w.true[6] += [4, -2]
    assert w.step(noise=0.3) == 1
    assert w.fixes["held"].all()
    np.testing.assert_array_equal(w.fixes["integers"], w.true)
    assert w.fixes["fix_id"][6] == 50
    assert w.fixes["fix_risk"][6] == pytest.approx(1e-7 + 1e-4)
    np.testing.assert_array_equal(np.delete(w.fixes["fix_id"], 6), 1)


def test_no_repair_costs_more_than_the_risk_allows() -> None:
    w = _Watch(3, limit=1.5e-4)
    w.fixes["fix_risk"][:] = 1.4e-4
    w.step()
    w.true[6] += [4, -2]
    w.step(noise=0.3)
    np.testing.assert_array_equal(np.flatnonzero(~w.fixes["held"]), [6])


def test_without_doppler_the_two_bands_still_watch_each_other() -> None:
    w = _Watch(5, failure=1e-12)
    w.step(solved=False)
    w.true[2] += [1, 0]
    assert w.step(solved=False) == 1
    assert not w.fixes["held"][2]


def test_a_velocity_that_most_carriers_contradict_counts_for_nothing() -> None:
    w = _Watch(5)
    w.step()
    assert w.step(lie=30.0) == 0
    assert w.fixes["held"].all()


def test_a_jump_of_the_correction_age_widens_the_prediction() -> None:
    w = _Watch(9)
    w.step(age=29.0)
    assert w.step(age=0.1, drift_m=0.03) == 0


def test_epochs_without_corrections_are_not_compared() -> None:
    w = _Watch(2)
    w.step()
    w.true[0] += [1, 1]
    assert w.step(age=math.inf) == 0
    assert w.step() == 0
    assert w.step() == 0


def test_one_band_relies_on_the_prediction() -> None:
    w = _Watch(4, bands=1)
    w.step()
    w.true[1] += [1, 0]
    assert w.step() == 1
    assert not w.fixes["held"][1]
