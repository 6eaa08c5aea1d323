"""Random campaigns: Poisson counts, one for each target, the same from the same seed; one fault, and its weight."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest, chi2, norm, poisson

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign, single_fault
from lanebound.integrity.sensors.fault_kinds import FaultPrior
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.view import SkyView

SATELLITES, VEHICLES = 6, 3
NEVER = {kind.name: {"per_h": 0.0} for kind in fault_kinds()}


def _sky(vehicles: int = VEHICLES) -> SkyView:
    one = np.ones((1, SATELLITES))
    los = np.tile([0.0, 0.0, 1.0], (1, SATELLITES, 1))
    system, prn = np.array([0, 0, 0, 1, 1, 3]), np.arange(1, SATELLITES + 1)
    return SkyView(los, one, one, one, one, one > 0, system, prn, np.zeros(vehicles, dtype=np.int64))


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


RAISED = {
    "corrections_loss": {"per_h": 40.0, "median_s": 10.0},
    "cycle_slip": {"per_h": 2.0, "low": 1.0, "high": 10.0},
    "wheel_slip": {"per_h": 8.0, "low": 0.1, "high": 0.5},
    "jamming": {"per_h": 4.0, "low": 5.0, "high": 40.0},
}
LENGTH_S, RUNS = 30.0, 4000
LONG_S = 12.0


def _priors() -> FaultPriors:
    return FaultPriors().replace(**{**NEVER, **RAISED})


def test_one_fault_of_each_kind_that_occurs_is_equally_likely_and_weights_sum_to_one() -> None:
    rng = named_generator(7, "faults")
    drawn = [single_fault(_priors(), LENGTH_S, rng, _sky(1)) for _ in range(RUNS)]
    counts = {kind: sum(one.fault.kind == kind for one in drawn) for kind in RAISED}
    assert sum(counts.values()) == RUNS
    assert sum((n - RUNS / 4) ** 2 for n in counts.values()) / (RUNS / 4) < chi2.isf(1e-3, 3)
    weights = {one.fault.kind: one.weight for one in drawn}
    expected = {kind: prior["per_h"] * (SATELLITES if kind == "cycle_slip" else 1) for kind, prior in RAISED.items()}
    assert weights == pytest.approx({kind: 4 * rate / sum(expected.values()) for kind, rate in expected.items()})
    assert sum(weights.values()) / 4 == pytest.approx(1.0)
    total = sum(expected.values()) * LENGTH_S / 3600.0
    assert [one.probability for one in drawn] == pytest.approx([poisson.pmf(1, total)] * RUNS)
    assert [one.none_probability for one in drawn] == pytest.approx([poisson.pmf(0, total)] * RUNS)
    struck = [(one.fault.system, one.fault.prn) for one in drawn if one.fault.kind == "cycle_slip"]
    assert len(set(struck)) == SATELLITES, "each satellite may fail"
    assert {one.fault.vehicle for one in drawn if one.fault.kind == "wheel_slip"} == {0}


def test_weighted_runs_with_one_fault_give_the_rate_of_nominal_runs() -> None:
    """A long loss of corrections in the first half: in closed form, by all campaigns, and by runs with one fault."""
    rng, sky = named_generator(11, "faults"), _sky(1)

    def lost(faults: tuple[Fault, ...]) -> bool:
        return any(
            f.kind == "corrections_loss" and f.start_s < 0.5 * LENGTH_S and f.duration_s > LONG_S for f in faults
        )

    campaigns = [random_campaign(_priors(), LENGTH_S, rng, sky) for _ in range(4 * RUNS)]
    drawn = [single_fault(_priors(), LENGTH_S, rng, sky) for _ in range(RUNS)]
    p0, p1 = drawn[0].none_probability, drawn[0].probability
    # exactly: a share of corrections_loss among all, of long ones, and of onsets
    share = 40.0 / (40.0 + 6 * 2.0 + 8.0 + 4.0)
    long = norm.sf(np.log(LONG_S / 10.0) / 0.8)
    values = np.array([one.weight * lost((one.fault,)) for one in drawn])
    error = values.std() / np.sqrt(RUNS)
    assert abs(values.mean() - 0.5 * long * share) < 3.3 * error
    # of all campaigns those with one fault agree, and the whole rate lies between the bounds of the unseen rest
    alone = [lost(faults) for faults in campaigns if len(faults) == 1]
    assert binomtest(sum(alone), len(alone), values.mean()).pvalue > 1e-3
    rate, spread = np.mean([lost(faults) for faults in campaigns]), 3.3 * p1 * error
    assert p1 * values.mean() - spread < rate < p1 * values.mean() + (1.0 - p0 - p1) + spread
    assert abs(np.mean([not faults for faults in campaigns]) - p0) < 3.3 * np.sqrt(p0 * (1 - p0) / (4 * RUNS))


def test_one_fault_is_none_that_the_vehicle_itself_does_not_feel() -> None:
    rng = named_generator(3, "faults")
    kinds = {single_fault(FaultPriors(), 60.0, rng, _sky(1)).fault.kind for _ in range(400)}
    able = {kind.name for kind in fault_kinds() if kind.prior.per_h > 0.0}
    assert able - kinds == {"v2v_lie"}
    with pytest.raises(InputError, match=r"priors_per_h must let a kind occur that is no broadcast"):
        single_fault(_only("v2v_lie", per_h=1.0, low=1.0, high=2.0), 60.0, rng, _sky(1))
    with pytest.raises(InputError, match="duration_s must be positive"):
        single_fault(FaultPriors(), 0.0, rng, _sky(1))
