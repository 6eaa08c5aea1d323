"""Random campaigns: Poisson counts, one for each target, the same from the same seed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import poisson

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.fault_kinds import FaultPrior
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sky.view import SkyView

SATELLITES, VEHICLES = 6, 3
NEVER = {kind.name: {"per_h": 0.0} for kind in fault_kinds()}


def _sky() -> SkyView:
    one = np.ones((1, SATELLITES))
    los = np.tile([0.0, 0.0, 1.0], (1, SATELLITES, 1))
    system, prn = np.array([0, 0, 0, 1, 1, 3]), np.arange(1, SATELLITES + 1)
    return SkyView(los, one, one, one, one, one > 0, system, prn, np.zeros(VEHICLES, dtype=np.int64))


def _only(kind: str, **prior: float) -> FaultPriors:
    return FaultPriors().replace(**{**NEVER, kind: prior})


@pytest.mark.parametrize(
    ("kind", "targets"),
    [("cycle_slip", SATELLITES), ("constellation", 3), ("gyro_bias", VEHICLES)],
)
def test_counts_are_poisson_for_each_target(kind: str, targets: int) -> None:
    faults = random_campaign(_only(kind, per_h=50.0, low=1.0, high=2.0), 3600.0, named_generator(1, "faults"), _sky())
    low, high = poisson.ppf([5e-4, 1 - 5e-4], 50.0 * targets)  # fails by chance once in 1000 seeds
    assert low <= len(faults) <= high
    assert {f.kind for f in faults} == {kind}


def test_every_kind_can_be_drawn_and_scheduled() -> None:
    priors = FaultPriors().replace(**{kind.name: {"per_h": 20.0} for kind in fault_kinds()})
    faults = random_campaign(priors, 3600.0, named_generator(2, "faults"), _sky())
    assert {f.kind for f in faults} == {kind.name for kind in fault_kinds()}
    assert [f.start_s for f in faults] == sorted(f.start_s for f in faults)
    effects = FaultSchedule(faults).effects(1800.0, 0.1, _sky(), VEHICLES)
    for records in (effects.signals, effects.vehicles):
        assert all(np.isfinite(records[name]).all() for name in records.dtype.names or ())


def test_magnitudes_lie_between_their_limits() -> None:
    faults = random_campaign(
        _only("gyro_bias", per_h=100.0, low=0.5, high=0.7), 3600.0, named_generator(3, "faults"), _sky()
    )
    size = np.array([f.magnitude_degps for f in faults])
    assert (np.abs(size) >= 0.5).all()
    assert (np.abs(size) <= 0.7).all()
    assert (size < 0).any()


def test_same_seed_same_campaign() -> None:
    one = random_campaign(FaultPriors(), 1e6, named_generator(5, "faults"), _sky())
    two = random_campaign(FaultPriors(), 1e6, named_generator(5, "faults"), _sky())
    assert one == two
    assert one


def test_default_priors_rarely_strike_a_short_drive() -> None:
    counts = [len(random_campaign(FaultPriors(), 60.0, named_generator(s, "faults"), _sky())) for s in range(20)]
    assert np.mean(counts) < 1.0


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="duration_s"):
        random_campaign(FaultPriors(), 0.0, named_generator(1, "faults"), _sky())
    with pytest.raises(ConfigError, match="per_h"):
        FaultPrior(per_h=-1.0)
    with pytest.raises(ConfigError, match="low must be <= high"):
        FaultPrior(low=2.0, high=1.0)
    with pytest.raises(ConfigError, match="jaming is not a known key: did you mean 'jamming'"):
        FaultPriors.load({"jaming": {}})
    with pytest.raises(ConfigError, match=r"jamming\.per_h must be >= 0, got -1: .*the default is 0"):
        FaultPriors.load({"jamming": {"per_h": -1}})
    with pytest.raises(ConfigError, match=r"jamming\.high must be > 0"):
        _only("jamming", per_h=1.0, low=0.0, high=0.0)
