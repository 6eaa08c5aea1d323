"""The environment: highway-env's world, driven on belief, observed and judged with its integrity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import gymnasium
import numpy as np
from highway_env.envs.common.action import DiscreteMetaAction
from numpy.typing import NDArray

from lanebound.envs.catalogue import world_of
from lanebound.envs.cockpit import Cockpit
from lanebound.envs.config import ActionKind, EnvConfig
from lanebound.envs.costs import Corridor, costs_of, lead_of, weighted
from lanebound.envs.judge import Judge, Verdict
from lanebound.envs.observation import Observer
from lanebound.envs.pictures import Pictures
from lanebound.envs.records import EgoBelief
from lanebound.envs.rewards import rewards_of, total
from lanebound.envs.scene import alert_limits_m, navigator_config, set_scene
from lanebound.envs.truth import true_belief, true_traffic
from lanebound.envs.world import checked_command
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.faults import Fault

__all__ = ["DrivingEnv"]

Array = NDArray[np.float64]
OPTIONS = ("faults",)
ENDLESS_S = 300.0  # of sky for worlds that set no duration


class DrivingEnv(gymnasium.Env[Any, Any]):
    """
    ## Description
    A car drives in a world of highway-env, whose dynamics, traffic and endings stay as they are. Its navigation
    measures what really happens 10 times a second (satellites between buildings, reference link, gyros, wheel pulses)
    and works out an estimate with protection levels. Everything that decides reads the estimate: the observation, the
    lane that the car takes itself to be in, lane changes, steering and speed control of meta-actions, its route. So an
    error across the track really moves the car in its lane, and one along it really shortens the gap. The other drivers
    see the truth.

    Lateral quantities are positive to the right, angles positive when turning right, as in highway-env. `AT` is along
    the track, `CT` across it; PL is a protection level, AL the alert limit that it must not exceed.

    ## Action Space
    `action="meta"`: highway-env's meta-actions, carried out from the believed pose; `env.unwrapped.action_masks()`
    tells which of them make sense. `action="continuous"`: acceleration and steering in [-1, 1], as shares of their
    ranges. Steering asks for no more than 4 m/s2 across the track, and in our own worlds turns at 0.7 rad/s at most;
    the racetrack has neither limit. The acceleration is not limited further; a car whose wheels show standstill and
    that asks for none holds its brake.

    ## Observation Space
    A `Dict` of vectors, or one `Box` of all of them in this order (`observation.form="flat"`); float32, each entry
    scaled and clipped into [-1, 1] or [0, 1]. The published index names every entry with unit, scale and meaning.

    | group | tells |
    |---|---|
    | `ego` | speed, acceleration, yaw rate, steering, place in the lane, neighbouring lanes, commanded change |
    | `integrity` | PL, AL, ratio, margin, trend; alert, reason; source of the position; satellites, corrections |
    | `road` | by the map: limit, route 5 to 80 m ahead, satellites predicted 0 to 160 m ahead on three lanes |
    | `traffic` | the 6 nearest vehicles perceived: place, speed, heading, lane, age, PL of both on each axis |

    A missing level reads as the clipped maximum with its `exists` flag 0. `observation.integrity="blind"` leaves out
    `integrity` and the levels in `traffic`; `"oracle"` shows the true state with levels of 0. The predicted satellites
    are always those of a map without trees, whose buildings are 2.5 m off in height and 0.7 m in place (1 sigma):
    between houses they are 1 to 3 off on average, as in practice.

    ## Rewards
    The weighted sum of named terms of the true car, 1.2 a second at best; the terms are in `info["rewards"]`. v is the
    speed, d the offset from the middle of the lane, psi the heading less the lane's, dt the length of a step, a the
    acceleration along and across.

    | term | weight | is |
    |---|---|---|
    | `progress` | 1 | `v cos(psi) / v_limit dt`, between 0 and dt |
    | `lane_centre` | 0.2 | `progress / (1 + (d / 0.5 m)^2)` |
    | `comfort` | 0.1 | `-min(1, (a / 2 m/s2)^2) dt` |
    | `collision` | -5 | 1 in the step of a crash |
    | `base` | 0 | the reward of the wrapped world |

    ## Costs
    Never part of the reward: `info["cost"]` is the weighted sum of causes that stand beside it. Each is 0 or more and
    adds up over time, so that a faster policy changes no episode's cost; at rest in its lane a car pays for `cost_hmi`
    alone. v, d and dt are as above, W is the width of the car and w that of the lane; `est` marks what the car
    believes.

    | cause | weight | is |
    |---|---|---|
    | `cost_collision` | 200 | 1 in the step of a crash |
    | `cost_off_road` | 200 | 1 in the step that ends the episode off the road, or against the traffic |
    | `cost_lane` | 1 | `out v dt`, out how far the true body reaches beyond its lane, at most 2 m |
    | `cost_lane_integrity` | 0.1 | `out v dt`, out = `max(0, abs(d_est) + PL_CT + W/2 - w/2)`, at most 2 m |
    | `cost_headway` | 0.5 | `max(0, 1 - (gap_est - PL_AT of both) / d_RSS) dt`, at most dt; by the true gap if worse |
    | `cost_alert` | 0.5 | dt while an alert is older than 1 s and the car changes lane or exceeds half the limit |
    | `cost_hmi` | 5 | dt while the position counts as available and an error exceeds its alert limit, by epochs |

    `d_RSS = v rho + a rho^2 / 2 + (v + a rho)^2 / (2 b_min) - v_lead^2 / (2 b_max)`, 0 at least, with rho 0.5 s, a 2,
    b_min 4 and b_max 6 m/s2. A missing level counts as 2 m across the track and as 40 m of a gap; a leader whom the car
    does not perceive at all, nearer than d_RSS in truth, costs dt. A crash or leaving the road costs more than any
    `cost_limit`, and more than the whole drive of a driver that is blind to integrity (190 at most, in `UrbanCanyon`),
    so that an early end is no way to save costs. During a lane change both lanes count as the car's own, for the body
    and for the estimate with its level; with `keep_lane=False` the whole road counts so at all times. Where lanes meet
    the body may stand on several of them. `cost_limit` is a bound of an episode's cost for constrained learning and not
    enforced; each page says what it lies between.

    ## Info
    The same keys at reset and at every step. What the car knows: `pl_at_m`, `pl_ct_m`, `al_at_m`, `al_ct_m`,
    `margin_at_m`, `margin_ct_m` (AL - PL), `alert`, `available`, `mode` (0 none, 1 RTK, 2 Doppler, 3 IMU and
    odometer), `reason` of the alert (0 none, 1 PL_AT, 2 PL_CT, 3 both, 4 no solution, 5 a test failed, 6 accuracy, 7
    initialising, 8 not converged, 9 holding until it clears), `tta_s` (time left to react to an alert; all of it, 1 s,
    while none is on). What no agent is to be given: `speed_mps`,
    `yaw_rate_radps`, `err_at_m`, `err_ct_m` (estimate less truth), `mi` and `hmi` (at any navigation epoch of the step
    available, and an error above its PL but within its AL, or above its AL), `hmi_share` (of the epochs), `crashed`,
    `crashed_now`, `off_road`, `wrong_way`, `astray_now` (either of these two, and new), `is_success`. Of the step:
    `cost` and the causes above, `rewards` (the terms above, unweighted).

    ## Starting State
    `seed` draws everything: the traffic, one of 4 made-up cities along the roads, the hour of the constellations. The
    navigation starts 3 s before the episode, on a straight approach, 0.05 m and 0.5 degrees (1 sigma) from the truth;
    the map is 0.03 m (1 sigma) off on each axis, for which the levels take a tenth of the integrity risk. The link to
    the reference station is as it is found at any time, up or in an outage. All vehicles of an episode share
    atmosphere, station and the network's half of the outages; receivers, their surroundings and the other half are each
    one's own.

    `reset(options={"faults": [{"kind": "spoofing", "start_s": 5.0, "magnitude_m": 3.0}]})` sets faults in place of
    random ones. A fault has a `kind` (see [Fault kinds](#fault-kinds)), `start_s` from the start of the episode and
    `duration_s`, a `profile` (step, or ramp with `ramp_s`), the magnitude of its kind (`magnitude_m`,
    `magnitude_cycles`, `magnitude_db`, `magnitude_degps`, `magnitude_ratio`, or `magnitude` for a registered kind with
    another unit) and, where it takes them, `system`, `prn`, `band`, `azimuth_deg` and `vehicle` (0 is the ego, by
    default all).

    ## Episode End
    Terminated when the true car has crashed, has its middle off the road, or has driven against its lane for 1 s; and
    where the world says so. Truncated by the world's time. `info["is_success"]` marks an end without harm, at a mean
    speed along the lane of a quarter of the limit or more: the task is done. It takes no notice of costs, as in
    Safety-Gymnasium, where task and cost are reported side by side: a drive is good when it is a success *and* its cost
    is within `cost_limit`.

    ## Arguments
    `config`, a mapping that is merged deeply over what the id presets; `lanebound envs ID --json` shows it whole.

    | key | chooses |
    |---|---|
    | `sky` | `open`, `suburban`, `urban` or `dense`, the file of a recorded sky, or a `.yaml` of your own |
    | `faults` | random faults: `none` (default), `nominal` or `stress` |
    | `action`, `policy_hz`, `simulation_hz` | kind of action; decisions and steps of the dynamics (20) a second |
    | `navigation.source` | `navigator`, `perfect` (the truth, bit for bit) or `offset` (a constant error) |
    | `perception.source` | `v2v` (default), `sensor`, `both`, `truth` or `none` |
    | `observation` | `form`, `history`, `integrity`, `vehicles` and so on |
    | `reward`, `cost`, `cost_limit` | weights, and the figures of the formulas |
    | `actuators` | limits of steering; None for highway-env's own |
    | `world` | the wrapped world's own keys |

    `render_mode`: `"rgb_array"`, `"human"` or None.

    ## Version History
    * v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012 - as Gymnasium

    def __init__(self, config: EnvConfig | Mapping[str, Any], render_mode: str | None = None) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(f"render_mode must be one of {self.metadata['render_modes']}, got {render_mode!r}")
        self.config = config if isinstance(config, EnvConfig) else EnvConfig.load(config)
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": self.config.policy_hz}
        self.world = world_of(self.config)
        navigator_config(self.config, alert_limits_m(self.world, self.config))  # refuses its typos here, not at reset
        self.observer = Observer(self.config.observation)
        self.action_space = self.world.action_type.space()
        self.observation_space = self.observer.space
        self.cockpit: Cockpit | None = None
        self._pictures: Pictures | None = None

    @property
    def dt_s(self) -> float:
        """Length of a policy step."""
        return 1.0 / self.config.policy_hz

    # Gymnasium

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : seeds everything; without one the environment goes on from where its generators are
        options : ``{"faults": [...]}`` with faults (or their plain data) that take the place of the random campaign

        Raises
        ------
        InputError
            Unknown options.
        """
        super().reset(seed=seed)
        faults = _faults_in(options)
        episode_seed = int(self.np_random.integers(2**62))
        self.world.reset(seed=seed if seed is not None else int(self.np_random.integers(2**31)))
        self._duration_s = float(self.config.duration_s or self.world.config.get("duration", ENDLESS_S))
        around = set_scene(self.world, self.config, episode_seed, self._duration_s, faults)
        limits = alert_limits_m(self.world, self.config)
        self.cockpit = Cockpit(self.world, self.config.navigation, self.config.actuators, limits, around)
        self._belief = self.cockpit.belief()
        meta = self.config.action is ActionKind.META
        self._corridor = Corridor(not self.config.keep_lane, meta, self._belief.target_lane_index)
        self._judge = Judge(self.config, self.world)
        self.cockpit.watch = self._judge.glance
        self._speed_before = float(self.world.vehicle.speed)
        self.observer.reset()
        verdict = self._judge.look(self._belief, self.dt_s, ended=False)
        info = self._info(verdict, self._costs(verdict, start=True), self._rewards(verdict, 0.0, start=True))
        self._show(info)
        return self._observe(), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out a command until the next decision.

        Raises
        ------
        InputError
            Before the first reset, or for a command outside the action space.
        """
        cockpit = self._cockpit()
        command = checked_command(self.action_space, action)
        _, base, terminated, truncated, _ = self.world.step(command)
        cockpit.look()
        truncated = bool(truncated) or cockpit.time_s >= self._duration_s - 0.5 * self.dt_s
        self._belief = cockpit.belief()
        self._corridor.update(self._belief, self.world.vehicle, self.dt_s)
        verdict = self._judge.look(self._belief, self.dt_s, ended=bool(terminated or truncated))
        costs, rewards = self._costs(verdict), self._rewards(verdict, float(base))
        info = self._info(verdict, costs, rewards)
        self._show(info)
        reward = total(self.config.reward, rewards)
        return self._observe(), reward, bool(terminated) or verdict.failed, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """The picture of now, (height, width, 3), under ``rgb_array``; ``human`` shows it as the drive goes."""
        if self.render_mode == "rgb_array":
            return self._picture().draw(self._cockpit(), self._title)
        return None

    def close(self) -> None:
        """Close the window, if any; the environment can be used again."""
        if self._pictures is not None:
            self._pictures.close()
        self._pictures = None

    def action_masks(self) -> NDArray[np.bool_]:
        """Which meta-actions make sense from where the ego believes to be, (n,) bool (sb3-contrib's name).

        Raises
        ------
        InputError
            Under continuous actions.
        """
        inner = self.world.action_type
        if not isinstance(inner, DiscreteMetaAction):
            raise InputError("action_masks needs meta-actions, got continuous ones: there is nothing to mask")
        inner.controlled_vehicle = self._cockpit().believed
        try:
            allowed = inner.get_available_actions()
        finally:
            inner.controlled_vehicle = None
        mask = np.zeros(len(inner.actions), dtype=np.bool_)
        mask[allowed] = True
        return mask

    # What the agent sees

    def _observe(self) -> Any:
        cockpit = self._cockpit()
        belief, traffic = self._belief, cockpit.traffic
        if self.config.observation.integrity == "oracle":
            belief, traffic = true_belief(cockpit), true_traffic(cockpit)
        network, route = self.world.road.network, cockpit.route
        return self.observer.observe(belief, traffic, self._sky_ahead(belief), network, route)

    def _sky_ahead(self, belief: EgoBelief) -> NDArray[np.int64] | None:
        """Satellites that the map predicts ahead of the believed pose; None where nothing is sensed."""
        cockpit = self._cockpit()
        if cockpit.measurements is None or not self.observer.satellites_m.size:
            return None
        street, place = cockpit.around.street, belief.longitudinal_m
        return street.predicted_beside(
            belief.lane_index, place, self.observer.satellites_m, cockpit.measurements.sky, cockpit.route
        )

    # How it is judged

    def _costs(self, verdict: Verdict, start: bool = False) -> dict[str, float]:
        belief, traffic, car = self._belief, self._cockpit().traffic, self.world.vehicle
        road, c = self.world.road, self.config.cost
        lead = lead_of(road.network, belief, traffic, float(car.LENGTH))
        v, dt_s = verdict, 0.0 if start else self.dt_s
        return costs_of(
            c, road.network, self._corridor, car, belief, lead, road.vehicles, v.crashed_now, v.astray_now, v.hmi_share,
            dt_s,
        )  # fmt: skip

    def _rewards(self, verdict: Verdict, base: float, start: bool = False) -> dict[str, float]:
        car, dt_s = self.world.vehicle, 0.0 if start else self.dt_s
        speed = float(car.speed)
        along, across = (speed - self._speed_before) / self.dt_s, speed * verdict.yaw_rate_radps
        self._speed_before = speed
        return rewards_of(car, along, across, verdict.crashed_now, base, dt_s)

    def _info(self, verdict: Verdict, costs: dict[str, float], rewards: dict[str, float]) -> dict[str, Any]:
        b, c = self._belief, self.config.cost
        late_s = c.time_to_alert_s - b.alert_age_s
        return {
            "cost": weighted(c, costs),
            **costs,
            "pl_at_m": b.pl_at_m,
            "pl_ct_m": b.pl_ct_m,
            "al_at_m": b.al_at_m,
            "al_ct_m": b.al_ct_m,
            "margin_at_m": b.al_at_m - b.pl_at_m,
            "margin_ct_m": b.al_ct_m - b.pl_ct_m,
            "alert": b.alert,
            "available": b.available,
            "mode": b.mode,
            "reason": b.reason,
            "tta_s": max(late_s, 0.0) if b.alert else c.time_to_alert_s,
            "speed_mps": float(self.world.vehicle.speed),
            "rewards": rewards,
            **asdict(verdict),
        }

    # Helpers

    def _cockpit(self) -> Cockpit:
        if self.cockpit is None:
            raise InputError("reset must come before everything else, got no episode: call reset() first")
        return self.cockpit

    @property
    def _title(self) -> str:
        return self.config.base if self.spec is None else str(self.spec.id)

    def _picture(self) -> Pictures:
        if self._pictures is None:
            self._pictures = Pictures(self.config.rendering, self._title, self.metadata["render_fps"])
        return self._pictures

    def _show(self, info: dict[str, Any]) -> None:
        if self.render_mode is None:
            return
        self._picture().note(self._cockpit(), info)
        if self.render_mode == "human":
            self._picture().show(self._cockpit(), self._title)

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the window, which cannot be copied."""
        return {**self.__dict__, "_pictures": None}


def _faults_in(options: dict[str, Any] | None) -> tuple[Fault, ...] | None:
    """The faults that ``reset`` was given, None for the random campaign."""
    unknown = [key for key in options or {} if key not in OPTIONS]
    if unknown:
        raise InputError(f"options must be among {', '.join(OPTIONS)}, got {unknown[0]!r}: correct the name")
    if not options or "faults" not in options:
        return None
    faults = options["faults"]
    if not isinstance(faults, list | tuple):
        raise InputError(f"options.faults must be a list of faults, got {faults!r}: put a single one into a list")
    return tuple(f if isinstance(f, Fault) else Fault.load(f, f"options.faults.{i}") for i, f in enumerate(faults))
