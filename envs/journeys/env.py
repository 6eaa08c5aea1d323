"""``lanebound/Journey-v0``, alone and as a vector environment; the docstring of the class is its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from lanebound.envs.journeys.config import JourneyConfig
from lanebound.envs.journeys.engine import Journeys, JourneyStep
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import deep_merge
from lanebound.integrity.sky.availability import NO_LEVEL_M

__all__ = ["Journey", "VectorJourney"]

Flags = NDArray[np.bool_]

SHOWN = "time_s", "length_m", "energy_kwh", "unusable_s", "gap_s"


class Journey(gymnasium.Env[NDArray[np.float32], Any]):
    """
    ## Description
    Choose the streets of a journey through a generated city, one at each junction, so that it is short in time and
    seldom without a usable position ([journeys](journeys.md)). Streets are predicted from a map with errors and
    without trees; what is met is that of the true city. A position is usable if the navigator gives one and raises no
    alert.

    Difficulty: a prediction is a probability, and what was met so far changes it. RTK that is missing now will be
    missing for a while, and dead reckoning bridges dark streets only for some time.

    ## Action Space
    `Discrete(4)`: the next street, numbered from the sharpest left to the sharpest right; at the place of departure
    clockwise from the South. Turn restrictions hold; turning back is never possible. Where only one street goes
    on, the journey does so without an action. `action_masks()` and `info["action_mask"]` say which actions lead into a
    street. Another one of the space takes the street whose number is nearest (the lower one of two), and
    `info["invalid_action"]` is true; one outside of it is refused.

    With `departure: choose` actions 4, 5, ... are the `hours`; only they are valid first. With several `speed_classes`
    the space is `MultiDiscrete([4, n])`: street and share of the speed limit; `action_masks()` then has 4 + n entries.

    ## Observation Space
    `Box(-1, 1, (96,), float32)`: 12 entries of the journey and 21 of each of four streets. Times are divided by 600 s,
    lengths by 5 km, gaps by 60 s, levels by 20 m, speeds by 20 m/s, and clipped. Everything follows from the map and
    from what the navigator has shown.

    | entries | meaning |
    |---|---|
    | `elapsed`, `distance` | time since departure; straight distance to the goal |
    | `goal_sin`, `goal_cos` | its direction, relative to that of the car |
    | `rtk`, `usable`, `level`, `gap` | here: mode RTK, usable position, PL_CT, time since RTK as experienced |
    | `unusable`, `predicted` | time without a usable position so far; that predicted on entering each street |
    | `hour_sin`, `hour_cos` | hour of departure |
    | `street{k}_exists`, `_arrives` | there is a street k; the goal is in it |
    | `street{k}_turn_sin`, `_turn_cos`, `_speed` | its direction, relative to that of the car; its speed limit |
    | `street{k}_length`, `_time` | its length; time with the turn |
    | `street{k}_unusable` | expected time without a usable position, entered with `gap` |
    | `street{k}_level_median`, `_level_90` | predicted quantiles of PL_CT; 1: beyond 20 m, or no level |
    | `street{k}_aware_time`, `_unusable`, `_length` | from its end to the goal by the integrity-aware route |
    | `street{k}_fast_...`, `_short_...` | the same by the fastest and by the shortest route |
    | `street{k}_aware_excess`, `_fast_excess` | cost of the whole way beyond that of the best street, over 1 min |
    | `departing`, `hour{k}_time`, `_unusable` | with `departure: choose`: the integrity-aware route at each hour |

    ## Rewards
    The negative sum of time [min] and 1.2 times energy [kWh]; `reward.unusable` adds time without a usable position
    [min]. `info["rewards"]` holds the terms unweighted. Energy is rolling resistance and drag of a car of 1.5 t.

    ## Costs
    `info["cost"]`: the time of the step without a usable position [s]. `cost_limit` is 47, the 0.7 quantile of
    `integrity_aware` over 400 training seeds, rounded up.

    ## Info
    Of the journey so far: `time_s`, `length_m`, `energy_kwh`, `unusable_s`, `predicted_unusable_s`; here: `rtk`,
    `usable`, `gap_s`, `level_m` (PL_CT, `inf` without one); `city` (number), `hour`, `cost`, `rewards`, `is_success`,
    `action_mask`, `invalid_action`.

    ## Starting State
    At the middle of a street, at rest. City, hour, origin and destination are drawn; both are of 40 places of the
    city, at least 300 m apart. The navigator starts facing the street that is chosen first: until then `rtk` and
    `usable` are 0, and `level` is 1, no level.

    ## Episode End
    Terminated on arrival, which a success requires. Truncated at the first junction after 600 s (`duration_s`); with
    `full` 120 s later at the latest, wherever that is.

    ## Arguments
    `realised: fast` draws RTK, usable positions and levels at stations 10 m apart from laws that are fitted on drives
    of the navigator; `full` drives the navigator itself, a journey in about a second once the sky of the city is cast.
    In `full` the choice is due where the car begins to brake for the junction; the last metres are driven after it.
    `reset(options={"city": k})` takes a city by its number. `render_mode` is `"rgb_array"` or None.

    ## Version History
    * v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012 - as Gymnasium

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> None:
        self.config = journey_config(config)
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        self.render_mode = render_mode
        self.journeys = Journeys(self.config, 1, render_mode is not None)
        self.action_space, self.observation_space = self.journeys.action_space, self.journeys.observation_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a journey; ``options["city"]`` takes one of the cities, by number, in place of a drawn one.

        Raises
        ------
        InputError
            Other options, or no such city.
        """
        city = _city_in(options, self.config)
        super().reset(seed=seed)
        if seed is not None or not self.journeys.seeded(0):
            self.journeys.seed(0, seed if seed is not None else int(self.np_random.integers(2**31)))
        self.journeys.begin([0], city)
        return self.journeys.observe()[0], _single(infos_of(self.journeys, None))

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive to the next junction with a choice, or to the end.

        Raises
        ------
        InputError
            The journey is over, or the action lies outside of the action space.
        """
        if not self.journeys.running[0]:
            raise InputError("step must follow a reset, and not the end of a journey: call reset() first")
        found = self.journeys.step(np.asarray(action)[None], self.journeys.running)
        observation, info = self.journeys.observe()[0], _single(infos_of(self.journeys, found))
        reward = float(rewards_of(self.config, found)[0])
        return observation, reward, bool(found.arrived[0]), bool(found.late[0]), info

    def action_masks(self) -> Flags:
        """Which actions are valid, (A,) bool (sb3-contrib's name); with speed classes a part for them follows."""
        return np.asarray(self.journeys.action_masks()[0])

    def oracle_observation(self) -> NDArray[np.float32]:
        """The observation with a forecast by the true city in place of the map, for a driver to compare with."""
        return np.asarray(self.journeys.oracle_observation()[0])

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of streets by predicted probability of a usable position and of the way so far; (600, 600, 3)."""
        if self.render_mode is None:
            return None
        from lanebound.envs.journeys.picture import picture_of

        return picture_of(self.journeys, 0)


class VectorJourney(VectorEnv[NDArray[np.float32], Any, NDArray[Any]]):
    """N journeys that step together; journey i under seed s is that of a single environment under seed s + i.

    Parameters
    ----------
    num_envs : N
    config : as of a single environment
    autoreset_mode : ``NextStep`` (default), ``SameStep`` or ``Disabled``
    render_mode : None; draw pictures of a single environment

    Raises
    ------
    InputError
        A number or a mode that does not exist.
    ConfigError
        As for a single environment.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise InputError(f"num_envs must be a positive int, got {num_envs!r}: give 1 or more")
        if render_mode is not None:
            raise InputError(f"render_mode must be None, got {render_mode!r}: draw pictures of a single environment")
        self.num_envs, self.config, self.render_mode = int(num_envs), journey_config(config), None
        self.mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.mode}
        self.journeys = Journeys(self.config, self.num_envs)
        self.single_action_space = self.journeys.action_space
        self.single_observation_space = self.journeys.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin journeys, all of them or those of ``options["reset_mask"]`` (N,) bool; ``city`` as of a single one.

        Raises
        ------
        InputError
            Other options, or seeds that are not one for each.
        """
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options and "reset_mask" in options:
            options = dict(options)
            mask = np.asarray(options.pop("reset_mask"), dtype=np.bool_)
        city = _city_in(options, self.config)
        one = int(seed) if isinstance(seed, int | np.integer) else None
        super().reset(seed=one)
        given: Any = range(one, one + self.num_envs) if one is not None else seed
        seeds = [] if given is None else list(given)
        if seed is not None and len(seeds) != self.num_envs:
            raise InputError(f"seed must be an int or one for each of {self.num_envs} environments, got {len(seeds)}")
        rows = np.flatnonzero(mask).tolist()
        for row in rows:
            own = seeds[row] if seeds else None
            if own is not None or not self.journeys.seeded(row):
                self.journeys.seed(row, own if own is not None else int(self.np_random.integers(2**31)))
        self.journeys.begin(rows, city)
        return self.journeys.observe(), _keyed(infos_of(self.journeys, None), np.ones(self.num_envs, dtype=np.bool_))

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Drive each journey to its next junction with a choice, or to its end.

        Raises
        ------
        InputError
            Actions outside of the action space; with resets ``Disabled``, for a journey that is over.
        """
        again = np.flatnonzero(~self.journeys.running)
        if again.size and self.mode is AutoresetMode.DISABLED:
            raise InputError(f"environments {again} must be reset, their journeys are over: pass options.reset_mask")
        found = self.journeys.step(np.asarray(actions), self.journeys.running)
        over = found.arrived | found.late
        final: dict[str, Any] = {}
        if self.mode is AutoresetMode.SAME_STEP and over.any():
            observed, info = self.journeys.observe(), _keyed(infos_of(self.journeys, found), over)
            observations = np.full(self.num_envs, None, dtype=object)
            for row in np.flatnonzero(over):
                observations[row] = observed[row]
            final = {"final_obs": observations, "_final_obs": over, "final_info": info, "_final_info": over}
            again = np.flatnonzero(over)
        self.journeys.begin(again.tolist())
        fresh = np.isin(np.arange(self.num_envs), again)
        of_new = JourneyStep(*(np.where(fresh, np.zeros_like(part), part) for part in found))
        infos = _keyed(infos_of(self.journeys, of_new), np.ones_like(fresh)) | final
        return self.journeys.observe(), rewards_of(self.config, found), found.arrived, found.late, infos

    def action_masks(self) -> Flags:
        """Which actions are valid, (N, A) bool."""
        return self.journeys.action_masks()

    def oracle_observation(self) -> NDArray[np.float32]:
        """As of a single environment, (N, n)."""
        return self.journeys.oracle_observation()


def journey_config(config: Mapping[str, Any] | None) -> JourneyConfig:
    """The configuration with changes of a user.

    Raises
    ------
    InputError
        They are no mapping.
    ConfigError
        An unknown key or a value out of range, with its path.
    """
    if config is not None and not isinstance(config, Mapping):
        raise InputError(f"config must be a mapping of what to change, got {config!r}: pass a dict")
    return JourneyConfig.load(deep_merge({}, config or {}))


def _city_in(options: Mapping[str, Any] | None, config: JourneyConfig) -> int | None:
    """The city of options, None where it is to be drawn."""
    given = dict(options or {})
    city = given.pop("city", None)
    if given:
        raise InputError(f"options must be city alone, got {list(options or ())}: set all else by config and seed")
    if city is not None and not (isinstance(city, int | np.integer) and 0 <= city < config.cities.number):
        raise InputError(f"options.city must be a number in [0, {config.cities.number - 1}], got {city!r}")
    return None if city is None else int(city)


def rewards_of(config: JourneyConfig, found: JourneyStep) -> NDArray[np.float64]:
    """The weighted sums of the terms, (N,)."""
    weights, terms = config.reward, terms_of(found)
    return np.asarray(
        weights.time * terms["time"] + weights.energy * terms["energy"] + weights.unusable * terms["unusable"]
    )


def terms_of(found: JourneyStep) -> dict[str, NDArray[np.float64]]:
    """Terms of the reward, unweighted, (N,) each."""
    return {"time": -found.time_s / 60.0, "energy": -found.energy_kwh, "unusable": -found.unusable_s / 60.0}


def infos_of(journeys: Journeys, found: JourneyStep | None) -> dict[str, Any]:
    """What is said about N journeys beside their observations, arrays (N, ...); without an outcome after a reset."""
    state, zeros = journeys.state, np.zeros(journeys.count)
    if found is None:
        false = np.zeros(journeys.count, dtype=np.bool_)
        found = JourneyStep(zeros, zeros, zeros, false, false, false)
    return {
        **{name: state[name].copy() for name in SHOWN},
        "level_m": np.where(state["level_m"] < NO_LEVEL_M, state["level_m"], np.inf),
        "predicted_unusable_s": state["predicted_s"].copy(),
        "rtk": state["rtk"] == 1,
        "usable": state["usable"] == 1,
        "city": state["host"].copy(),
        "hour": np.array([*journeys.config.hours, np.nan])[state["hour"]],
        "cost": found.unusable_s.copy(),
        "rewards": terms_of(found),
        "is_success": found.arrived.copy(),
        "invalid_action": found.invalid.copy(),
        "action_mask": journeys.masks(),
    }


def _single(infos: Mapping[str, Any]) -> dict[str, Any]:
    """The info of one journey."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return _single(value)
        return value[0] if value.ndim > 1 else value[0].item()

    return {name: plain(value) for name, value in infos.items()}


def _keyed(infos: Mapping[str, Any], who: Flags) -> dict[str, Any]:
    """Infos of Gymnasium's vector environments, and ``who`` (N,) has each entry."""
    out: dict[str, Any] = {}
    for name, value in infos.items():
        out[name] = _keyed(value, who) if isinstance(value, Mapping) else value
        out[f"_{name}"] = who
    return out
