"""Configuration of the kind ``filter``."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.filters.code_position import SBAS, CodePositionConfig, CodeSource
from lanebound.integrity.positioning.filters.vehicle_models import TRANSITION, Interaction, Predictor
from lanebound.integrity.sensors.gnss import GnssConfig

__all__ = [
    "CurvedNoise",
    "FilterConfig",
    "GateConfig",
    "GnssUpdateConfig",
    "ModelNoise",
    "MotionUpdateConfig",
    "StraightNoise",
]

SCALE_SIGMAS = 4.5  # of the declared bound of the odometer's scale, DeadReckoningConfig
Share = Annotated[float, Field(ge=0, le=1)]


class ModelNoise(Config):
    """Noise of one vehicle model as densities: over a scan of T seconds the 1-sigma is the density over root T."""

    yaw_acceleration: float = Field(ge=0, description="yaw acceleration [rad/s^2/sqrt(Hz)]")
    acceleration: float = Field(ge=0, description="acceleration, where no accelerometer is an input [m/s^2/sqrt(Hz)]")
    slip: float = Field(ge=0, description="slip rate (straight) [rad/s/sqrt(Hz)], acceleration (curved) [rad/s^2/...]")
    slide: float = Field(ge=0, description="rate of the slide correction [rad/s/sqrt(Hz)]")


class StraightNoise(ModelNoise):
    """Straight and mild ways."""

    yaw_acceleration: float = Field(
        0.3,
        ge=0,
        description="yaw acceleration [rad/s^2/sqrt(Hz)]; 0.9 rad/s^2 over 0.1 s; chosen so that the levels of this "
        "model alone hold in turns of 10 m radius, where 0.1 breaks them",
    )
    acceleration: float = Field(0.3, ge=0, description="acceleration without accelerometer [m/s^2/sqrt(Hz)]; chosen")
    slip: float = Field(0.01, ge=0, description="slip rate [rad/s/sqrt(Hz)]; chosen")
    slide: float = Field(1e-4, ge=0, description="rate of the slide correction [rad/s/sqrt(Hz)]; chosen")


class CurvedNoise(ModelNoise):
    """Sharp turns."""

    yaw_acceleration: float = Field(
        1.0, ge=0, description="yaw acceleration [rad/s^2/sqrt(Hz)]; 3 rad/s^2 over 0.1 s, a turn at a junction; chosen"
    )
    acceleration: float = Field(1.0, ge=0, description="acceleration without accelerometer [m/s^2/sqrt(Hz)]; chosen")
    slip: float = Field(0.3, ge=0, description="slip acceleration [rad/s^2/sqrt(Hz)]; chosen")
    slide: float = Field(1e-4, ge=0, description="rate of the slide correction [rad/s/sqrt(Hz)]; chosen")


class GateConfig(Config):
    """The test of innovations, one sensor vector at a time (S4 eq 8)."""

    enabled: bool = Field(True, description="reject what fails; S4 scenario 5 is without, scenario 6 with it")
    gnss: float = Field(1e-3, gt=0, lt=1, description="P(a right GNSS position is rejected) [-]; chosen")
    motion: float = Field(
        1e-8, gt=0, lt=1, description="P(a right motion measurement is rejected) [-]; 6 sigma of two dimensions, S4"
    )
    lost_s: float = Field(
        20.0,
        gt=0,
        description="after this long without an accepted position though there are positions, the filter doubts "
        "itself: it takes the innovation into its covariance [s]; chosen",
    )
    doubt_s: float = Field(
        60.0, ge=0, description="and its levels hold the distance this long [s]; either side may be wrong; chosen"
    )
    misfit_alert: float | None = Field(
        9.0,
        gt=1,
        description="mean NIS / 2 of positions (position.excess_tau_s) above which there is an alert, because errors "
        "are three times those declared; none: no such alert [-]; chosen",
    )


class GnssUpdateConfig(Config):
    """When GNSS positions are used, and how long their errors last."""

    codes: CodePositionConfig = CodePositionConfig()
    interval_s: float = Field(1.0, gt=0, description="least time between two positions used [s]; S4's receivers, 1 Hz")
    least_move_m: float = Field(
        2.0, ge=0, description="least distance driven between two [m]; at rest reflections do not change"
    )
    rest_interval_s: float = Field(
        5.0,
        gt=0,
        description="after this time a position is used without that distance, with errors that last as at rest [s]; "
        "chosen",
    )
    fast_tau_s: float = Field(
        5.0, ge=0, description="correlation time of noise and multipath, bounded by more noise [s]; as tau of signals"
    )
    slow_tau_s: float = Field(1800.0, gt=0, description="correlation time of slow errors [s]; as BroadcastConfig")
    excess_tau_s: float = Field(
        15.0,
        ge=0,
        description="memory of the NIS of positions, rejected ones too; their noise grows by its mean, exact levels by "
        "the root of it; 0: they do not [s]; chosen on dense streets of seed 101: reflections of a canyon last for "
        "some 100 m",
    )
    level_misfit: bool = Field(True, description="exact levels grow by that root; false: the noise alone grows")
    bias_m: float = Field(
        0.1, ge=0, description="bound of a constant error of positions, on each axis [m]; datum and antenna, chosen"
    )


class MotionUpdateConfig(Config):
    """Declared errors of wheels, steering, accelerometers and compass."""

    accelerometer: Literal["input", "observation", "off"] = Field(
        "input",
        description="input: v(k+1) = v(k) + a T drives the prediction; observation: S4 eq 4-6 as printed, pseudo "
        "observations of position and speed that count the state twice; off",
    )
    accelerometer_density: float = Field(
        5e-3, gt=0, description="noise of the accelerometer [m/s^2/sqrt(Hz)]; BMI088 1.7e-3, and vibration"
    )
    accelerometer_bias_mps2: float = Field(
        0.08, ge=0, description="1-sigma of its bias [m/s^2]; BMI088 5 mg after calibration, and S4's warm-up"
    )
    accelerometer_walk: float = Field(
        1e-3, ge=0, description="random walk of that bias [m/s^2/sqrt(s)]; slopes, chosen"
    )
    wheel_scale: float | None = Field(
        None,
        ge=0,
        description="1-sigma of the scale of the wheels [-]; none: that of positioning.dead_reckoning.odometer_scale, "
        "a bound of 4.5 sigma",
    )
    speed_sigma_mps: float = Field(0.06, gt=0, description="speed by the wheels, 1 sigma [m/s]; S1 section 4: 0.05")
    speed_tau_s: float = Field(0.2, ge=0, description="correlation time of its error [s]; slip, pulses")
    creep_tau_s: float = Field(
        5.0,
        ge=0,
        description="how long a vehicle creeps where its odometer shows rest, bounded by more noise; a longer one is "
        "bounded as a constant error [s]; chosen",
    )
    slip_sigma_deg: float = Field(0.3, gt=0, description="slip by the geometry, 1 sigma [deg]; chosen")
    slide_sigma_deg: float = Field(0.1, ge=0, description="1-sigma of the slide correction at the start [deg]; chosen")
    steering_sigma_deg: float = Field(0.12, gt=0, description="angle of the front wheel, 1 sigma [deg]; ChassisConfig")
    steering_tau_s: float = Field(60.0, ge=0, description="how long its error lasts, bounded by more noise [s]; chosen")
    compass_deviation_deg: float = Field(1.2, ge=0, description="1-sigma of the compass's own error [deg]")
    compass_sigma_deg: float = Field(2.4, gt=0, description="1-sigma of its disturbances [deg]")
    compass_tau_s: float = Field(10.0, ge=0, description="correlation time of the disturbances [s]")
    rest_mps2: float = Field(0.3, gt=0, description="acceleration above which a vehicle does not rest [m/s^2]; chosen")


class FilterConfig(NavigatorConfig):
    """Loosely coupled Kalman filters on vehicle models: GNSS positions, gyro, accelerometers, wheels (S4)."""

    kind: Literal["filter"] = Field("filter", description="kind of the navigator")
    filter: Literal["ekf", "ukf", "imm"] = Field(
        "imm", description="ekf, ukf: one filter, with the first of models; imm: one extended filter for each model"
    )
    models: tuple[Literal["straight", "curved"], ...] = Field(
        ("straight", "curved"), min_length=1, max_length=2, description="vehicle models; S4 eq 1"
    )
    interaction: Interaction = Field(Interaction.STANDARD, description="mixing of models; standard, or as S4 prints it")
    transition: tuple[tuple[Share, Share], tuple[Share, Share]] = Field(
        TRANSITION, description="P(model after | model before) at each epoch [-]; S4 eq 9"
    )
    straight: StraightNoise = Field(StraightNoise(), description="noise of the straight model")
    curved: CurvedNoise = Field(CurvedNoise(), description="noise of the curved model")
    gate: GateConfig = GateConfig()
    position: GnssUpdateConfig = GnssUpdateConfig()
    motion: MotionUpdateConfig = MotionUpdateConfig()
    sensor_errors: bool = Field(
        True, description="errors of sensors are states; false: S4's own states alone, whose levels do not hold"
    )

    @model_validator(mode="after")
    def _rows_of_transition_are_probabilities(self) -> Self:
        if len(set(self.models)) < len(self.models):
            raise ConfigError(f"models must name each one once, got {list(self.models)}: remove the repeated one")
        for row in self.transition:
            if abs(sum(row) - 1.0) > 1e-9:
                raise ConfigError(f"transition must have rows of sum 1, got {list(row)}: correct it")
        for name, column in zip(("straight", "curved"), zip(*self.transition, strict=True), strict=True):
            if not sum(column) > 0.0:
                raise ConfigError(
                    f"transition must reach each model, got the column {list(column)} of {name}: make one of its "
                    "entries larger than 0"
                )
        return self

    @model_validator(mode="after")
    def _sbas_corrects_the_first_band(self) -> Self:
        if self.position.codes.source is CodeSource.SBAS and self.gnss.bands[0] != 0:
            raise ConfigError(
                f"gnss.bands must begin with 0 (L1) for position.codes.source sbas, got {list(self.gnss.bands)}: "
                "set [0], or another source"
            )
        return self

    @property
    def chosen_models(self) -> tuple[str, ...]:
        """Names of the models that run."""
        return self.models if self.filter == "imm" else self.models[:1]

    @property
    def wheel_scale(self) -> float:
        """1-sigma of the scale of the wheels [-]."""
        declared = self.motion.wheel_scale
        return self.positioning.dead_reckoning.odometer_scale / SCALE_SIGMAS if declared is None else declared

    @property
    def predictor(self) -> Predictor:
        """The prediction of each filter."""
        return Predictor.UNSCENTED if self.filter == "ukf" else Predictor.EXTENDED

    @property
    def receiver(self) -> GnssConfig:
        """The receiver, with undifferenced observables and SBAS where the positions are made of them."""
        source, gnss = self.position.codes.source, self.gnss
        if source is CodeSource.SBAS and SBAS not in gnss.augmentation.providers:
            gnss = gnss.replace(augmentation={"providers": [*gnss.augmentation.providers, SBAS]})
        if source is not CodeSource.DIFFERENTIAL and not gnss.undifferenced:
            gnss = gnss.replace(undifferenced=True)
        return gnss
