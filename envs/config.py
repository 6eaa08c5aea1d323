"""The configuration of an environment: world, sky, navigation, perception, observation, rewards and costs."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import cached_property
from typing import Any, Self

from pydantic import Field, field_validator, model_validator

from lanebound.envs.actuators import ActuatorConfig
from lanebound.envs.alert_limits import AlertLimit, BudgetConfig
from lanebound.envs.costs import GROUPS, AlertSpeed, CostConfig, CostLimits
from lanebound.envs.lane_sensor import LaneSensorConfig
from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.observation import ObservationConfig
from lanebound.envs.perception import PerceptionConfig
from lanebound.envs.rendering.config import RenderingConfig
from lanebound.envs.rewards import RewardConfig
from lanebound.envs.sky import RECORDING, SKIES, CitiesConfig, SkyLevel
from lanebound.envs.worlds.followers import MOTORWAYS, TrafficConfig
from lanebound.envs.worlds.wander import WanderConfig
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import FILES, nearest
from lanebound.integrity.navigators.context_guard import CONTEXT
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sensors.campaign import FaultPriors

__all__ = ["ActionKind", "EnvConfig", "FaultLevel"]


class ActionKind(Enum):
    """Kind of action."""

    META = "meta"
    CONTINUOUS = "continuous"


class FaultLevel(Enum):
    """Random faults of sensors, satellites and links: none, at two rates, or exactly one in each episode."""

    NONE = "none"
    NOMINAL = "nominal"
    STRESS = "stress"
    ONE = "one"

    @property
    def priors(self) -> FaultPriors | None:
        """Rates by kind of fault; those of one fault are the nominal ones; None without any."""
        if self is FaultLevel.NONE:
            return None
        rates = FaultLevel.NOMINAL if self is FaultLevel.ONE else self
        return FaultPriors.preset(f"sensors/fault_priors_{rates.value}")


class EnvConfig(Config):
    """All options of an environment. The preset of an id may be overridden key by key.

    >>> EnvConfig.build({"base": "highway-v0"}, {"sky": "dense", "cost": {"hmi": 1.0}}).cost.hmi
    1.0
    """

    base: str = Field(description="id of highway-env, or one of our own worlds")
    world: Mapping[str, Any] = Field({}, description="keys of the world's own configuration, merged deeply")
    action: ActionKind = Field(ActionKind.META, description="meta-actions, or steering and acceleration")
    action_options: Mapping[str, Any] = Field({}, description="options of highway-env's action type")
    simulation_hz: int = Field(20, ge=1, le=200, description="steps of the dynamics in a second")
    policy_hz: int = Field(2, ge=1, le=50, description="decisions in a second; must divide simulation_hz")
    sky: str = Field(
        "urban",
        description=f"packaged sky: {', '.join(SKIES)}; or a .csv recording, a .yaml file",
    )
    cities: CitiesConfig = Field(CitiesConfig(), description="generated cities, one of them drawn for each episode")
    extent_m: float = Field(2500.0, gt=0, description="length of a lane that is lined with buildings")
    faults: FaultLevel = Field(
        FaultLevel.NONE, description="random faults: their rates, or one in each episode, with its weight in info"
    )
    navigation: NavigationConfig = Field(NavigationConfig(), description="source of the ego's position")
    navigator: Mapping[str, Any] = Field(
        {}, description="keys of NavigatorConfig, merged deeply over those of the sky; or name of a preset or a kind"
    )
    perception: PerceptionConfig = Field(PerceptionConfig(), description="source of other vehicles' positions")
    slots: int = Field(64, ge=0, le=512, description="largest number of vehicles perceived at a time")
    observation: ObservationConfig = Field(ObservationConfig(), description="contents, form and scales of observations")
    actuators: ActuatorConfig | None = Field(
        ActuatorConfig(), description="limits of steering; None for highway-env's own"
    )
    lane_sensor: LaneSensorConfig | None = Field(
        None, description="camera that keeps the car in its lane; None: it keeps its lane by the position"
    )
    alert_limit: AlertLimit = Field(
        AlertLimit.FIXED, description="alert limits: fixed, or of a budget at each decision"
    )
    budget: BudgetConfig = Field(BudgetConfig(), description="figures of alert limits from a budget")
    al_at_m: float = Field(1.5, gt=0, description="along-track alert limit; by default half of a 3 m lane, S2 5.3")
    al_ct_m: float | None = Field(None, gt=0, description="cross-track alert limit; None: (narrowest lane - car) / 2")
    keep_lane: bool = Field(True, description="costs count beyond the lane; false: beyond the road")
    duration_s: float | None = Field(
        None,
        gt=0,
        le=3600,
        description="length of an episode, over world.duration; None: that of the world, or 300 s",
    )
    off_road_ends: bool = Field(True, description="terminate when the middle of the car leaves the road")
    wrong_way_s: float = Field(1.0, gt=0, description="terminate after driving against the lane for this time")
    success_share: float = Field(
        0.25,
        ge=0,
        le=1,
        description="mean speed that a success requires, over the speed that limit, bends and the vehicle ahead allow",
    )
    success_behind_s: float = Field(
        10.0,
        ge=0,
        description="time behind a car at that mean speed at which a success may end; a lead does not count; chosen",
    )
    traffic: TrafficConfig = Field(TrafficConfig(), description="vehicles behind the ego at the start")
    wander: WanderConfig = Field(WanderConfig(), description="lateral position of the other drivers in their lanes")
    reward: RewardConfig = Field(RewardConfig(), description="weights of the reward's terms")
    cost: CostConfig = Field(CostConfig(), description="weights and parameters of the costs")
    cost_limit: float = Field(10.0, ge=0, description="limit of an episode's cost; not enforced")
    cost_limits: CostLimits = Field(CostLimits(), description="limits of parts of an episode's cost; not enforced")
    rendering: RenderingConfig = Field(RenderingConfig(), description="size and style of pictures")

    @classmethod
    def kept(cls, base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
        """The part of ``base`` that remains valid with ``changes``: all but the services of its navigator."""
        observation = base.get("observation")
        if not isinstance(observation, Mapping):
            return dict(base)
        return {**base, "observation": {k: v for k, v in observation.items() if k != "navigator_services"}}

    @field_validator("navigator", mode="before")
    @classmethod
    def _navigator_by_name(cls, value: Any) -> Any:
        return NavigatorConfig.data_of(value)

    @model_validator(mode="before")
    @classmethod
    def _cities_are_counted(cls, data: Any) -> Any:
        # The key of earlier versions: a second name for one thing would have to be merged with the first.
        if isinstance(data, Mapping) and "layouts" in data:
            raise ConfigError(
                f"layouts must be left out, got {data['layouts']!r}: set cities.count, which draws the same cities"
            )
        return data

    @model_validator(mode="before")
    @classmethod
    def _navigator_is_observed(cls, data: Any) -> Any:
        """What services, context monitor, filter, limits of the navigator and the cost report has observed entries."""
        if not isinstance(data, Mapping) or not isinstance(data.get("observation", {}), Mapping):
            return data
        try:
            navigator = NavigatorConfig.data_of(data.get("navigator", {}))
        except ConfigError:
            return data  # the field itself is refused, with its path
        if not isinstance(navigator, Mapping):
            return data
        observation = dict(data.get("observation", {}))
        shown = {
            "navigator_services": _services_in(navigator),
            "context": _has_context(navigator),
            "filters": navigator.get("kind") == "filter",
            "speed_geometry": _limits_sdop(navigator),
            "permitted_speed": _follows_level(data.get("cost")),
            "roads": data.get("lane_sensor") is not None,
        }
        given = observation.get("navigator_services")
        if given and isinstance(given, list | tuple) and tuple(given) != shown["navigator_services"]:
            raise ConfigError(
                f"observation.navigator_services must be left to navigator.service, got {list(given)}: "
                "set observation.services"
            )
        changed = {name: value for name, value in shown.items() if value or observation.get(name)}
        return {**data, "observation": {**observation, **changed}} if changed else data

    @field_validator("sky")
    @classmethod
    def _sky_exists(cls, name: str) -> str:
        if name.endswith((*RECORDING, *FILES)):
            SkyLevel.named(name)
        elif name not in SKIES and "/" not in name:
            advice = nearest(name, SKIES)
            close = f": {advice}" if advice.startswith("did") else ""
            raise ConfigError(
                f"sky must be one of {', '.join(SKIES)}, or a file, got {name!r}{close} "
                "(files: .csv of 'lanebound record-sky', .yaml of your own)"
            )
        return name

    @model_validator(mode="after")
    def _rates_divide(self) -> Self:
        if self.simulation_hz % self.policy_hz:
            raise ConfigError(
                f"policy_hz must divide simulation_hz = {self.simulation_hz}, got {self.policy_hz}: choose a divisor"
            )
        ratio = self.simulation_hz / self.navigation.rate_hz
        sensed = self.navigation.source.uses_sensors or self.perception.has_radio
        if sensed and abs(ratio - round(ratio)) > 1e-9:
            raise ConfigError(
                f"navigation.rate_hz must divide simulation_hz = {self.simulation_hz}, "
                f"got {self.navigation.rate_hz}: choose a divisor"
            )
        step_s, epoch_s = self.navigator.get("dt_s"), 1.0 / self.navigation.rate_hz
        if step_s is not None and step_s != epoch_s:
            raise ConfigError(
                f"navigator.dt_s must be 1 / navigation.rate_hz = {epoch_s:g}, got {step_s!r}: set navigation.rate_hz"
            )
        ratio = self.navigation.rate_hz / self.policy_hz
        if sensed and abs(ratio - round(ratio)) > 1e-9:
            raise ConfigError(
                f"policy_hz must divide navigation.rate_hz = {self.navigation.rate_hz:g}, got {self.policy_hz}: "
                "what is observed is of a navigation epoch"
            )
        return self

    @model_validator(mode="after")
    def _limits_are_of_one_kind(self) -> Self:
        # A figure that is not used must not seem to be.
        unused = ("al_at_m", "al_ct_m") if self.alert_limit is AlertLimit.BUDGET else ("budget",)
        for name in unused:
            if name in self.model_fields_set and getattr(self, name) != type(self).model_fields[name].default:
                raise ConfigError(
                    f"{name} must be left out with alert_limit {self.alert_limit.value!r}, got {getattr(self, name)}: "
                    "remove it, or choose the other kind"
                )
        if self.alert_limit is AlertLimit.BUDGET and self.budget.most_m > self.observation.pl_max_m:
            raise ConfigError(
                f"budget.most_m must be <= observation.pl_max_m = {self.observation.pl_max_m}, as far as limits are "
                f"shown, got {self.budget.most_m}: raise pl_max_m or lower most_m"
            )
        return self

    @model_validator(mode="after")
    def _roads_are_matched(self) -> Self:
        if self.lane_sensor is None and self.cost.alert_speed is AlertSpeed.ROADS:
            raise ConfigError("cost.alert_speed must be 'share' or 'level' without a lane_sensor, got 'roads': add one")
        return self

    @model_validator(mode="after")
    def _camera_counts_lanes(self) -> Self:
        # The lanes of links are told apart by the camera; a car that keeps its lane by metres does not keep it.
        if self.observation.tolls and self.lane_sensor is None:
            raise ConfigError("observation.tolls must be false without a lane_sensor, got true: add one")
        return self

    @model_validator(mode="after")
    def _camera_has_no_budget(self) -> Self:
        # A budget is the room in the lane, which a camera measures: the position has no part in it.
        if self.lane_sensor is not None and self.alert_limit is AlertLimit.BUDGET:
            raise ConfigError(
                "alert_limit must be 'fixed' with a lane_sensor, got 'budget': set al_at_m and al_ct_m, or remove one"
            )
        return self

    @model_validator(mode="after")
    def _limited_costs_can_grow(self) -> Self:
        # Every drive keeps a limit of costs that weigh nothing: it would seem to constrain and does not.
        for group, limit in self.cost_limits.given.items():
            if not self.cost.weights_of(group).any():
                weights = " or ".join(f"cost.{cause.removeprefix('cost_')}" for cause in GROUPS[group])
                raise ConfigError(
                    f"cost_limits.{group} must be left out where its costs weigh 0, got {limit:g}: raise {weights}, or "
                    "remove it"
                )
        return self

    @model_validator(mode="after")
    def _followers_have_room(self) -> Self:
        # Elsewhere the ego begins near the start of its road, is alone, or has followers of the world itself.
        if self.traffic.behind and self.base not in MOTORWAYS:
            raise ConfigError(
                f"traffic.behind must be 0 in {self.base}, got {self.traffic.behind}: choose {' or '.join(MOTORWAYS)}, "
                "or UrbanCanyonWorld, where world.spread begins behind the ego"
            )
        return self

    @model_validator(mode="after")
    def _others_have_receivers(self) -> Self:
        # Random faults also act in the receivers of the others, which a surrogate does not have.
        if self.faults is not FaultLevel.NONE and self.perception.has_radio and not self.perception.others_navigate:
            raise ConfigError(
                f"perception.others must be 'full' with faults {self.faults.value!r}, got 'surrogate': set it to full"
            )
        return self

    @model_validator(mode="after")
    def _corners_hide(self) -> Self:
        # Buildings stand at a crossing, and matter to sensor and ranges alone.
        corner, source = self.perception.sensor.corner_m, self.perception.source
        if corner is not None and (
            not self.base.startswith("intersection-") or source not in ("sensor", "both", "cooperative")
        ):
            raise ConfigError(
                f"perception.sensor.corner_m must be left out in {self.base} with perception.source {source!r}, got "
                f"{corner:g}: choose an intersection, and source sensor, both or cooperative"
            )
        return self

    @model_validator(mode="after")
    def _one_fault_strikes(self) -> Self:
        # An episode that no fault can reach would count as one with a fault; wrong senders would be further faults.
        if self.faults is FaultLevel.ONE and self.perception.wrong_share:
            raise ConfigError(
                f"perception.wrong_share must be 0 with faults 'one', got {self.perception.wrong_share:g}: remove it, "
                "or set faults to none"
            )
        if self.faults is FaultLevel.ONE and not self.navigation.source.uses_sensors:
            raise ConfigError(
                f"navigation.source must be 'navigator' with faults 'one', got {self.navigation.source.value!r}: set "
                "it, or faults to none"
            )
        return self

    @cached_property
    def level(self) -> SkyLevel:
        """The preset of the sky, read once: a file of one's own may change later."""
        return SkyLevel.named(self.sky)

    def limits_m(self, lane_width_m: float, car_width_m: float) -> tuple[float, float]:
        """Alert limits along and across the track, for the narrowest lane: ``AL_CT = (w - W) / 2``.

        With a budget, what it is at most: the limits of the moment are within.
        """
        if self.alert_limit is AlertLimit.BUDGET:
            return self.budget.most_m, self.budget.most_m
        geometric = max(0.5 * (lane_width_m - car_width_m), 0.05)
        return self.al_at_m, geometric if self.al_ct_m is None else self.al_ct_m


def _services_in(navigator: Mapping[str, Any]) -> tuple[str, ...]:
    """Services of a navigator's data whose modes are observed: all but RTK."""
    named = navigator.get("service", ())
    names = [named] if isinstance(named, str) else named
    if not isinstance(names, list | tuple):
        return ()
    return tuple(str(name).rpartition(":")[2] for name in names if name != "rtk")


def _limits_sdop(navigator: Mapping[str, Any]) -> bool:
    """Whether a navigator's data limit the speed dilution of precision."""
    modes = navigator.get("positioning", {})
    modes = modes.get("mode", {}) if isinstance(modes, Mapping) else {}
    return isinstance(modes, Mapping) and modes.get("doppler_max_sdop") is not None


def _follows_level(cost: Any) -> bool:
    """Whether the speed permitted under an alert is more than a share of the limit, by the data of ``cost``."""
    given = cost.get("alert_speed") if isinstance(cost, Mapping) else getattr(cost, "alert_speed", None)
    return given in (*AlertSpeed, *(kind.value for kind in AlertSpeed)) and AlertSpeed(given).is_shown


def _has_context(navigator: Mapping[str, Any]) -> bool:
    """Whether a navigator's data ask for a context monitor."""
    monitor = navigator.get("monitor")
    chosen = isinstance(monitor, Mapping) and monitor.get("kind") == CONTEXT
    return chosen or navigator.get("context") is not None
