"""The environment: highway-env's world, driven on belief, observed and scored with its integrity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from highway_env.envs.common.action import DiscreteMetaAction
from numpy.typing import NDArray

from lanebound.envs.belief_loop import BeliefLoop, WorldStep
from lanebound.envs.catalogue import world_of
from lanebound.envs.config import EnvConfig
from lanebound.envs.observation import Observer
from lanebound.envs.pictures import Pictures
from lanebound.envs.recordings import require_recordable
from lanebound.envs.scene import alert_limits_m, duration_s, navigator_config, set_scene
from lanebound.envs.world import checked_command
from lanebound.envs.worlds.followers import add_followers
from lanebound.envs.worlds.tolling import ClaimAction, sensible_claims
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.faults import Fault

__all__ = ["OPTIONS", "DrivingEnv", "faults_in"]

OPTIONS = ("faults",)
WORLD_SEEDS, EPISODE_SEEDS = 2**31, 2**62  # ends of the ranges from which seeds are drawn


class DrivingEnv(gymnasium.Env[Any, Any]):
    """
    ## Description
    A car drives in a world of highway-env, whose dynamics are unchanged. Ten times a second its sensors are simulated
    at the true pose (GNSS signals between buildings, corrections of a reference station, gyros, accelerometers, wheel
    pulses), and a navigator computes an estimated pose with protection levels. Every decision uses the estimate:
    observation, lane, lane changes, steering, speed control and route. Other vehicles react to true positions.

    Other drivers have a constant offset from the middle of their lane (0.15 m, 1 sigma) and wander about it (0.19 m,
    correlation time 5 s), at most 0.5 m in all. `wander.offset_sigma_m` and `wander.wander_sigma_m` of 0 switch this
    off, as in highway-env.

    Lateral values are positive to the right, angles and yaw rates for right turns. `at` is along the track, `ct` across
    it. PL is a protection level, AL its alert limit.

    ## Action Space
    | `action` | space | commands |
    |---|---|---|
    | `"meta"` | `Discrete` | highway-env's meta-actions, executed from the estimated pose |
    | `"continuous"` | `Box` | acceleration and steering in [-1, 1], as shares of their ranges |

    Meta-actions are 0 lane left, 1 idle, 2 lane right, 3 faster, 4 slower (Intersection: 0 slower, 1 idle, 2 faster).
    `env.unwrapped.action_masks()` returns those that are possible from the estimated pose. In Tolling the car drives by
    itself, and the actions are 0 defer, 1 charge, 2 do not charge. Steering is limited to a lateral acceleration of 4
    m/s2 and, in LaneKeeping, CarFollowing and UrbanCanyon, to a rate of 0.7 rad/s. A brake holds the car at standstill
    while no acceleration is commanded. Racetrack has neither limits nor brake.

    ## Observation Space
    A `Dict` of float32 vectors, each entry divided by its scale and clipped to [-1, 1] or [0, 1]
    ([index](#observation-index)). `observation.form="flat"` gives one `Box` with the same entries in this order;
    `observation.history` stacks observations.

    | group | contents |
    |---|---|
    | `ego` | speed, acceleration, yaw rate, steering, position in the lane, neighbouring lanes, commanded lane change |
    | `integrity` | PL, AL, ratio, margin and trend on each axis; alert, reason, mode, RTK status, satellites |
    | `road` | from the map: speed limit, route 5 to 80 m ahead, predicted satellites 0 to 160 m ahead on three lanes |
    | `traffic` | the 6 nearest perceived vehicles: position, speed, heading, lane, age, and PL of both on each axis |

    `observation.vehicles`, `preview_m` and `satellites_m` set these numbers and distances. For a missing protection
    level the flag `..._exists` is 0, level and ratio are 1 and the margin is -1.

    | `observation.integrity` | effect |
    |---|---|
    | `"full"` | everything |
    | `"clock"` | of `integrity` only the mode and the time since the last RTK position; no protection levels |
    | `"blind"` | no group `integrity`, no protection levels in `traffic` |
    | `"oracle"` | the true state with protection levels of 0 |

    The map that predicts satellites has no trees and has errors (1 sigma: 2.5 m in the height of a building, 0.7 m in
    its position): the prediction is wrong by 1 to 3 satellites on average between buildings.

    ## Rewards
    The weighted sum of these terms, computed from the true state; `info["rewards"]` holds them unweighted. v is the
    speed, v_limit the speed limit of the lane, psi the heading relative to the lane, d the offset from the middle of
    the lane, a the acceleration (along and across), dt the length of a step.

    | term | weight | value in a step |
    |---|---|---|
    | `progress` | 1 | `v cos(psi) / v_limit dt`, limited to [-dt, dt] |
    | `lane_centre` | 0.2 | `max(progress, 0) / (1 + (d / 0.5 m)^2)` |
    | `comfort` | 0.1 | `-min(1, (a / 2 m/s2)^2) dt` |
    | `collision` | -5 | 1 in the step of a crash |
    | `base` | 0 | the reward of the wrapped world of highway-env |
    | `toll` | 1 | 1 for a geo-object that is settled with the right claim; only in Tolling |

    ## Costs
    Costs are not part of the reward. `info["cost"]` is their weighted sum in a step; an episode's sum does not depend
    on `policy_hz`. W and w are the widths of car and lane; `est` marks estimated values, all others are true.

    | cause | weight | value in a step |
    |---|---|---|
    | `cost_collision` | 200 | 1 in the step of a crash |
    | `cost_off_road` | 200 | 1 in the step in which the car leaves the road or the episode ends against the traffic |
    | `cost_lane` | 1 | `out v dt`; out: largest distance of a corner of the body beyond the lane, at most 2 m |
    | `cost_lane_integrity` | 0.1 | `out v dt`; out: `max(0, abs(d_est) + PL_CT + W/2 - w/2)`, at most 2 m |
    | `cost_headway` | 0.5 | `max(0, 1 - (gap_est - PL_AT of both) / d_RSS) dt`, at most dt |
    | `cost_conflict` | 10 | peak of `max(0, 1 - T2 / 1.5 s)` in each conflict of crossing courses |
    | `cost_alert` | 0.5 | dt while an alert is older than 1 s and the car changes lane or exceeds the permitted speed |
    | `cost_hmi` | 5 | dt times the share of navigation epochs with hazardously misleading information |
    | `cost_context` | 0 | dt while the context monitor warns and the car changes lane or exceeds half the limit |
    | `cost_blocking` | 0 | `max(0, 1 - v cos(psi) / (0.7 v_flow)) dt`, at most dt: slower than others drive there |
    | `cost_speeding` | 0 | `max(0, (v cos(psi) - 3 km/h) / v_limit - 1) dt`, at most dt; v_limit: also of a closure |
    | `cost_route` | 0 | 1 in the step in which the car comes onto a road that does not lead to the goal of the world |
    | `cost_gore` | 0 | dt while the body is over a line of its lane within 50 m (`cost.gore_m`) of a fork |
    | `cost_overcharge` | 0 | 1 where a geo-object is charged that the car has not driven; only in Tolling |
    | `cost_undercharge` | 0 | 1 where one is not charged that the car has driven |

    - `cost_lane`, `cost_lane_integrity`: during a commanded lane change, and where lanes meet or fork, both lanes
      count. With `keep_lane=False` the whole road counts, and `cost_lane_integrity` is 0. The least v is
      `cost.standing_speed_mps` (0).
    - `cost_headway` is also computed from the true gap and speeds without PL; the larger value counts.
      `d_RSS = v rho + a rho^2 / 2 + (v + a rho)^2 / (2 b_min) - v_lead^2 / (2 b_max)`, at least 0, with rho = 0.5 s, a
      = 2, b_min = 4 and b_max = 6 m/s2. An unperceived vehicle ahead that is nearer than `d_RSS` costs dt.
    - A missing protection level counts as 2 m across the track and as 40 m of the gap.
    - `cost_conflict`: T2 is the time until the second of two vehicles reaches the place where the first is or just was,
      if both go on along their lanes at their true speeds (Laureshyn et al. 2017; 1.5 s: Hyden 1987, FHWA-RD-03-050).
      It counts courses that cross at more than 30 degrees (SSAM), only in Intersection and Roundabout, whoever has the
      right of way.
    - `cost_alert`: an alert permits half the limit (`cost.alert_speed_share`) and no lane change. With
      `cost.alert_speed: level` it permits the largest v with `v PL <= 0.5 v_limit AL(v)` on both axes, from 0.25
      (`cost.alert_speed_least`) to 0.5 of the limit; with `roads` (needs a [lane sensor](#lane-sensor)) the least limit
      of the roads that the levels leave possible, and 3 km/h. The speed observed before the step counts
      (`integrity.permitted_speed`).
    - `cost_blocking`: v_flow is the least of limit, fastest command, comfortable speed in a bend, speed of a vehicle
      less than 4 s ahead, and speed from which the car stops in comfort before its lane ends. Under an alert the
      permitted speed replaces `0.7 v_flow` if it is less. The cost is 0 behind a vehicle that stands, while another
      one crosses the next 30 m of the way within 7.1 s (HCM 2010), and without a weight.
    - With a [lane sensor](#lane-sensor) lane, offset and bound are those of the camera.

    `cost_limit` is the limit of an episode's cost for constrained learning; it is not enforced. `cost_limits` adds
    limits of parts of that cost, with the weights above (none by default): `lane` (`cost_lane`,
    `cost_lane_integrity`), `headway`, `conflict`, `alert`, `hmi`, `blocking`, `guidance` (`cost_speeding`,
    `cost_route`, `cost_gore`), `overcharge` and `undercharge`.

    A crash or an end off the road exceeds every `cost_limit`, but can cost less than a careless drive to the end
    (UrbanCanyon: 230 at once, `nominal` 221 or 355): without a limit, costs may teach to end early.

    ## Info
    The same keys at reset and in each step. Known to the car:

    | key | value |
    |---|---|
    | `pl_at_m`, `pl_ct_m` | protection levels; `inf` when missing |
    | `al_at_m`, `al_ct_m` | [alert limits](#alert-limits) |
    | `margin_at_m`, `margin_ct_m` | AL - PL |
    | `available` | no protection level exceeds its alert limit |
    | `alert`, `tta_s` | an alert is on; time left to react to it: 1 s less its age (not the TTA of S3 II.A) |
    | `reason` | why the alert is on: code of `AlertReason` |
    | `mode` | source of the position: code of `lanebound.integrity.positioning.modes.Mode` |

    Codes of `reason`: 0 none, 1 PL_AT, 2 PL_CT, 3 both, 4 no solution, 5 a test failed, 6 accuracy, 7 initialising, 8
    not converged, 9 holding (the limits are met again). Codes of `mode`: 0 no solution, 1 RTK, 2 Doppler, 3 IMU +
    odometer, 4 code; of a [service](navigation.md#positioning-services) 5 SPP, 6 DGPS, 7 SBAS L1, 8 SBAS DFMC, 9 PPP,
    10 network RTK; then registered modes.

    True values and scores; an agent must not use them:

    | key | value |
    |---|---|
    | `speed_mps`, `yaw_rate_radps` | true speed and yaw rate |
    | `err_at_m`, `err_ct_m` | estimate less truth |
    | `mi` | misleading information in an epoch of the step: available, an error above its PL and within its AL |
    | `hmi`, `hmi_share` | hazardously misleading information: available, an error above its AL; share of the epochs |
    | `crashed`, `off_road`, `wrong_way` | state of the true car |
    | `crashed_now`, `astray_now` | new in this step: a crash; off the road or against the traffic |
    | `is_success` | the episode ends well in this step |
    | `cost` and the causes above | weighted sum; unweighted causes |
    | `lost`, `lost_now` | on a road that does not lead to the goal of the world; since this step |
    | `wrong_road` | with a [lane sensor](#lane-sensor): the believed road is another one, beside the true car |
    | `costs` | the unweighted causes as one vector (15,), float64, in the order of `lanebound.envs.costs.CAUSES` |
    | `rewards` | unweighted terms |
    | `fault_...` | with `faults: one`: [the fault of the episode](#one-fault-in-each-episode) |

    ## Starting State
    `reset(seed=...)` determines the whole episode: traffic, one of the [generated cities](#cities) along the roads, the
    hour of the constellations, all sensor noise. The navigator starts 3 s before the episode on a straight approach,
    from errors of 0.05 m and 0.5 degrees (1 sigma). The map has an error of 0.03 m (1 sigma) on each axis, which takes
    a tenth of the integrity risk. All vehicles share the atmosphere, the reference station and half of the outages of
    the link. An episode may begin in an outage, or under an alert (reason `holding`) that clears within 1 s.

    ## Episode End
    Terminated when the true car has crashed, has its middle off the road or has driven against its lane for 1 s, at the
    goal of a world that has one, on a road that does not lead there (Guidance), and by the rules of the wrapped world.
    Truncated when the world's time is up. A single environment accepts a `step` after the end; the vector engine resets
    by itself, or refuses (`AutoresetMode.DISABLED`).

    `info["is_success"]` is true in the last step if the true car is unharmed, on the road, in the direction of its
    lane, at the goal (Merge, Roundabout, Intersection, Guidance) and fast enough: its mean speed along the lane reaches
    the share `success_share` of the speed that limit, bends (2 m/s2 across) and a vehicle ahead within 4 s that is no
    wreck allow, and at the end the car is at most 10 s (`success_behind_s`) behind a car that always drives at that
    share. Costs do not count.

    ## Arguments
    `gymnasium.make(id, config={...}, render_mode=...)`. `config` is merged deeply over the preset of the id ([all
    keys](#configuration-keys)); an unknown key is refused with the nearest one. `render_mode` is `"rgb_array"`,
    `"human"` or None. `lanebound envs ID --json` prints the whole configuration of an id.

    ## Version History
    * v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012 - as Gymnasium

    def __init__(self, config: EnvConfig | Mapping[str, Any], render_mode: str | None = None) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(
                f"render_mode must be one of {self.metadata['render_modes']}, got {render_mode!r}: correct it"
            )
        self.config = config if isinstance(config, EnvConfig) else EnvConfig.load(config)
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": self.config.policy_hz}
        self.world = world_of(self.config)
        navigator_config(self.config, alert_limits_m(self.world, self.config))  # refuses its typos here, not at reset
        require_recordable(self.config)
        self.observer = Observer(self.config.observation)
        self.action_space = self.world.action_type.space()
        self.observation_space = self.observer.space
        self.belief_loop: BeliefLoop | None = None
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
        seed : seeds all random numbers; without a seed the generators continue
        options : ``{"faults": [...]}`` with faults (or their plain data) that take the place of the random campaign

        Raises
        ------
        InputError
            Unknown options, or a fault that cannot act in this episode.
        """
        super().reset(seed=seed)
        self.belief_loop = None  # there is no episode if what follows is refused
        faults = faults_in(options)
        episode_seed = int(self.np_random.integers(EPISODE_SEEDS))
        self.world.reset(seed=seed if seed is not None else int(self.np_random.integers(WORLD_SEEDS)))
        add_followers(self.world, self.config.traffic, episode_seed)
        self._duration_s = duration_s(self.config, self.world)
        self.belief_loop = loop = self._begin(episode_seed, faults)
        self.observer.reset()
        loop.score_and_observe([WorldStep(False, False, 0.0)] * len(loop.cars), start=True)
        info = loop.info
        self._show(info)
        return self._observe(), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out a command until the next decision.

        Raises
        ------
        InputError
            Before the first reset, or for a command outside the action space.
        """
        loop = self._loop()
        self.advance(loop, checked_command(self.action_space, action))
        info, outcome = loop.info, loop.episodes.ego["outcome"][0]
        over = bool(outcome["terminated"] > 0.0), bool(outcome["truncated"] > 0.0)
        self._show(info)
        return self._observe(), float(outcome["reward"]), *over, info

    def advance(self, loop: BeliefLoop, command: Any) -> None:
        """Drive until the next decision, and score and observe.

        The belief follows all simulation steps but the last in :meth:`.BeliefLoop.simulate`. Worlds add and remove
        vehicles after the last one, so it is sensed here.
        """
        ends = loop.step_world(command)
        loop.sense()
        loop.locate()
        loop.perceive()
        if loop.time_s >= self._duration_s - 0.5 * self.dt_s:
            ends = [end._replace(truncated=True) for end in ends]
        loop.score_and_observe(ends)

    def render(self) -> NDArray[np.uint8] | None:
        """The picture of now, (height, width, 3), under ``rgb_array``; ``human`` shows it as the drive goes."""
        if self.render_mode == "rgb_array":
            return self._picture().draw(self._loop(), self._title)
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
        if isinstance(inner, ClaimAction):
            claims: NDArray[np.bool_] = sensible_claims(self._loop().episodes.ego)[0]
            return claims
        inner.controlled_vehicle = self._loop().believed
        try:
            allowed = inner.get_available_actions()
        finally:
            inner.controlled_vehicle = None
        mask = np.zeros(len(inner.actions), dtype=np.bool_)
        mask[allowed] = True
        return mask

    # Helpers

    def _begin(self, seed: int, faults: tuple[Fault, ...] | None) -> BeliefLoop:
        """The loop of an episode in the world as it has been reset."""
        return BeliefLoop(self.world, self.config, set_scene(self.world, self.config, seed, faults))

    def _observe(self, row: int = 0, observer: Observer | None = None) -> Any:
        """The observation of now, of a row of the loop.

        Raises
        ------
        InputError
            An entry is NaN.
        """
        frame = self._loop().episodes.frame[row]
        if np.isnan(frame.sum()):
            names = [e.column for e, bad in zip(self.observer.index, np.isnan(frame), strict=True) if bad]
            raise InputError(f"{', '.join(names)} must be a number, got nan: correct the source of the entry")
        return (observer or self.observer).observe(frame)

    def _loop(self) -> BeliefLoop:
        if self.belief_loop is None:
            raise InputError("reset must come before everything else, got no episode: call reset() first")
        return self.belief_loop

    @property
    def _title(self) -> str:
        return self.config.base if self.spec is None else str(self.spec.id)

    def _picture(self) -> Pictures:
        if self._pictures is None:
            c = self.config
            self._pictures = Pictures(c.rendering, self._title, self.metadata["render_fps"], c.cost_limit)
        return self._pictures

    def _show(self, info: dict[str, Any]) -> None:
        if self.render_mode is None:
            return
        self._picture().note(self._loop(), info)
        if self.render_mode == "human":
            self._picture().show(self._loop(), self._title)

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the window, which cannot be copied."""
        return {**self.__dict__, "_pictures": None}


def faults_in(options: Mapping[str, Any] | None, known: Sequence[str] = OPTIONS) -> tuple[Fault, ...] | None:
    """The faults that ``reset`` was given, None for the random campaign; ``known``: names of options.

    Raises
    ------
    InputError
        Another option, or faults that are no list.
    ConfigError
        A fault with a mistake.
    """
    unknown = [key for key in options or {} if key not in known]
    if unknown:
        raise InputError(f"options must be among {', '.join(known)}, got {unknown[0]!r}: correct the name")
    if not options or "faults" not in options:
        return None
    faults = options["faults"]
    if not isinstance(faults, list | tuple):
        raise InputError(f"options.faults must be a list of faults, got {faults!r}: put a single one into a list")
    return tuple(f if isinstance(f, Fault) else Fault.load(f, f"options.faults.{i}") for i, f in enumerate(faults))
