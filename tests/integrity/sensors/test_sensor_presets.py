"""The packaged sensor presets: each loads, and says what its name promises."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.presets import load_preset, preset_names
from lanebound.integrity.sensors.campaign import FaultPriors
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sensors.imu import ImuConfig
from lanebound.integrity.sensors.odometer import OdometerConfig
from lanebound.integrity.sensors.v2v import V2vConfig

MODELS: dict[str, type[Config]] = {
    "corrections": CorrectionsConfig,
    "fault_priors": FaultPriors,
    "gnss": GnssConfig,
    "imu": ImuConfig,
    "odometer": OdometerConfig,
    "v2v": V2vConfig,
}
NAMES = [name for name in preset_names() if name.startswith("sensors/") and load_preset(name)["kind"] in MODELS]


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_loads(name: str) -> None:
    config = MODELS[load_preset(name)["kind"]].preset(name)
    assert type(config).from_json(config.to_json()) == config


def test_every_kind_has_a_preset_that_is_its_default() -> None:
    for kind, model in MODELS.items():
        assert any(load_preset(n)["kind"] == kind and model.preset(n) == model() for n in NAMES)


def test_better_grades_of_inertial_sensors_are_better() -> None:
    consumer, automotive, tactical = (
        ImuConfig.preset(f"sensors/imu_{g}") for g in ("consumer", "automotive", "tactical")
    )
    for better, worse in ((automotive, consumer), (tactical, automotive)):
        assert better.gyro.density < worse.gyro.density
        assert better.gyro.instability < worse.gyro.instability
        assert better.gyro.turn_on < worse.gyro.turn_on
    # data sheets: 0.005 deg/s/sqrt(Hz) and 3 deg/h (ASM330LHH), 0.15 deg/sqrt(h) and 0.5 deg/h (STIM300)
    assert math.degrees(automotive.gyro.density) == pytest.approx(0.005, rel=0.01)
    assert math.degrees(automotive.gyro.instability) * 3600 == pytest.approx(3.0, rel=0.01)
    assert math.degrees(tactical.gyro.density) * 60 == pytest.approx(0.15, rel=0.01)
    assert math.degrees(tactical.gyro.instability) * 3600 == pytest.approx(0.5, rel=0.01)


def test_the_city_link_is_down_for_the_share_of_s1() -> None:
    config = CorrectionsConfig.preset("sensors/corrections_city")
    z = np.random.default_rng(0).standard_normal(200_000)
    length_s = np.minimum(config.outage_median_s * np.exp(config.outage_log_sd * z), config.outage_max_s).mean()
    down = config.outage_per_h / 3600.0 * length_s
    assert down / (1.0 + down) == pytest.approx(0.258, abs=0.002)  # S1 section 5, share of Doppler positioning


def test_stress_meets_every_kind_and_gives_each_a_size() -> None:
    priors = FaultPriors.preset("sensors/fault_priors_stress")
    nominal = FaultPriors()
    for kind in fault_kinds():
        prior = priors.of(kind)
        assert prior.per_h > nominal.of(kind).per_h
        assert (prior.low > 0) == bool(kind.magnitudes)
