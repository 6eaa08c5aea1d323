"""The engine as a vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium.spaces import Box, MultiDiscrete, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from lanebound.envs.batch.infos import StepResult, form_of, infos_of, results
from lanebound.envs.core import OPTIONS, DrivingEnv, faults_in
from lanebound.envs.ids import Preset, every_preset, has_engine, id_of, presets, refuse_misplaced
from lanebound.envs.registration import wrap
from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.processes import EngineProcesses, require_processes
from lanebound.envs.world import within_rounding
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.faults import Fault

__all__ = ["VectorDrivingEnv", "WrappedVectorEnv", "engine_class", "engines"]

Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]
Observations = Any  # observations: an array (N, E), or a dict of them
MASK = "reset_mask"
NOBODY = np.empty(0, dtype=np.int64)


class VectorDrivingEnv(VectorEnv[Any, Any, Any]):
    """N environments of an id that step together in compiled code: spaces, rewards, costs and infos of single ones.

    >>> import gymnasium, lanebound.envs
    >>> envs = gymnasium.make_vec("lanebound/LaneKeeping-v0", 4)
    >>> observations, infos = envs.reset(seed=1)
    >>> infos["cost"].shape
    (4,)

    Environment i under seed s drives as a single one under seed s + i does, whatever N, in this episode and all later.

    Parameters
    ----------
    num_envs : N
    config : merged deeply over what the id presets, as for a single environment
    autoreset_mode : what becomes of an environment whose episode is over. ``NextStep`` (Gymnasium's own choice): the
        next step resets it, whatever its action. ``SameStep``: it is reset at once; ``infos["final_obs"]`` and
        ``infos["final_info"]`` hold how the episode ended. ``Disabled``: reset it by
        ``reset(options={"reset_mask": mask})``.
    render_mode : None; use a single environment for pictures
    processes : over which the environments are divided, with the same results; 1: they are in this one, on all its
        threads. A script that asks for more does so below ``if __name__ == "__main__":``, as worker processes import it
    initialize : called first in each worker process, such as to import plug-ins

    Raises
    ------
    ConfigError
        What the engine does not do; the message names the alternative.
    InputError
        A number of environments or processes, mode of reset or render mode that does not exist.
    """

    KIND: ClassVar[type[Preset]]

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        processes: int = 1,
        initialize: Callable[[], object] | None = None,
        **misplaced: Any,
    ) -> None:
        refuse_misplaced(misplaced, "num_envs, config, autoreset_mode, render_mode, processes and initialize")
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise InputError(f"num_envs must be a positive int, got {num_envs!r}: give 1 or more")
        if render_mode is not None:
            raise InputError(f"render_mode must be None, got {render_mode!r}: draw pictures of a single environment")
        workers = require_processes(processes, int(num_envs))
        make = self._maker(config)
        single = make()
        self.num_envs, self.config, self.render_mode = int(num_envs), single.config, None
        self.mode = _mode_of(autoreset_mode)
        self.metadata = {"render_modes": [], "render_fps": single.config.policy_hz, "autoreset_mode": self.mode}
        self.engine: Engine | EngineProcesses = Engine(single, self.num_envs) if workers == 1 else EngineProcesses(
            make, single, self.num_envs, workers, initialize
        )  # fmt: skip
        self.single_action_space, self.single_observation_space = single.action_space, single.observation_space
        self.action_space = batch_space(single.action_space, self.num_envs)
        self.observation_space = batch_space(single.observation_space, self.num_envs)
        self._bounds = _bounds_of(self.action_space)
        self._slices = _slices_of(single)
        self._history = np.zeros((self.num_envs, single.config.observation.history, len(single.observer.index)), "f4")
        everyone = np.ones(self.num_envs, dtype=np.bool_)
        everyone.flags.writeable = False  # all infos share it
        self._form = form_of(everyone)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)
        self._begun = np.zeros(self.num_envs, dtype=np.bool_)
        self._some_over, self._all_begun = False, False

    def _maker(self, config: Mapping[str, Any] | None) -> Callable[[], DrivingEnv]:
        """What makes one environment of the configuration."""
        return partial(self.KIND, config)

    # Gymnasium

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin episodes, in all environments or in those of ``options["reset_mask"]`` (N,) bool.

        Parameters
        ----------
        seed : of the first environment, the others have the following ones; or one for each, None to continue
        options : ``reset_mask``; ``faults``, which all environments that are reset have in the place of random ones

        Raises
        ------
        InputError
            Seeds or options of the wrong kind, or a fault that cannot act in one of these episodes.
        """
        given = faults_in(options, (MASK, *OPTIONS))
        return self.begin(_seeds_of(seed, self.num_envs), _mask_of(options, self.num_envs), [given] * self.num_envs)

    def begin(
        self, seeds: Sequence[int | None], mask: Flags, faults: Sequence[Sequence[Fault] | None]
    ) -> tuple[Observations, dict[str, Any]]:  # fmt: skip
        """:meth:`reset` in the environments of a mask (N,), with a seed and faults, or None, of each of all N.

        Raises
        ------
        InputError
            An environment without an episode is left out, or a fault cannot act in its episode.
        """
        if not (mask | self._begun).all():
            first = int(np.flatnonzero(~(mask | self._begun))[0])
            raise InputError(f"options.{MASK} must name environments that have not begun, but leaves out {first}: "
                             "reset all of them first")  # fmt: skip
        rows = np.flatnonzero(mask)
        self._restart(rows, [seeds[e] for e in rows.tolist()], [faults[e] for e in rows.tolist()])
        return self._observations(), self._infos(results(self.engine.outcome, mask), form_of(mask))

    def step(self, actions: Any) -> tuple[Observations, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Carry out a command in each environment until the next decision.

        Raises
        ------
        InputError
            Before the first reset; for commands outside the action space; with resets ``Disabled``, for an episode that
            is over.
        """
        commands = self._checked(actions)
        again, driving = NOBODY, None
        if self._some_over:
            again, driving = self._over.nonzero()[0], (~self._over).nonzero()[0]
            if self.mode is AutoresetMode.DISABLED:
                raise InputError(f"environments {again} must be reset, their episodes are over: pass options.{MASK}")
        self.engine.step(commands, driving)
        self._remember(driving)
        if again.size:
            self._restart(again, [None] * again.size)
        found = latest = results(self.engine.outcome)
        self._over = found.terminated | found.truncated
        self._some_over = bool(np.count_nonzero(self._over))
        final: dict[str, Any] = {}
        if self._some_over and self.mode is AutoresetMode.SAME_STEP:
            ended = self._over.nonzero()[0]
            final = self._final(ended, self._over.copy())
            self._restart(ended, [None] * ended.size)
            latest = results(self.engine.outcome)
        infos = self._infos(latest, self._form)
        infos |= final
        return self._observations(), found.rewards, found.terminated, found.truncated, infos

    def action_masks(self) -> Flags:
        """Which meta-actions make sense from where each ego believes to be, (N, A) bool (sb3-contrib's name).

        Raises
        ------
        InputError
            Before the first reset, or under continuous actions.
        """
        self._require_begun()
        if not self.engine.codes.size:
            raise InputError("action_masks needs meta-actions, got continuous ones: there is nothing to mask")
        return self.engine.sensible()

    def close_extras(self, **kwargs: Any) -> None:
        """End the worker processes, if there are any."""
        if isinstance(self.engine, EngineProcesses):
            self.engine.close()

    # Episodes

    def _restart(
        self, rows: Rows, seeds: list[int | None], faults: Sequence[Sequence[Fault] | None] = ()
    ) -> None:  # fmt: skip
        if any(given is not None for given in faults):  # they may be refused when the episodes have begun
            self._begun[rows] = self._all_begun = False
        self.engine.reset(rows, seeds, faults)
        self._history[rows] = self.engine.frame[rows, None]
        self._over[rows], self._begun[rows] = False, True
        self._some_over, self._all_begun = bool(self._over.any()), bool(self._begun.all())

    def _remember(self, rows: Rows | None) -> None:
        """Put the newest observations at the end of the stack."""
        if self._history.shape[1] == 1:
            self._history[:, 0] = self.engine.frame
            return
        where: Any = slice(None) if rows is None else rows
        self._history[where, :-1] = self._history[where, 1:]
        self._history[where, -1] = self.engine.frame[where]

    def _final(self, ended: Rows, mask: Flags) -> dict[str, Any]:
        """How episodes have ended, in Gymnasium's form."""
        observations = np.full(self.num_envs, None, dtype=object)
        last = self._observations()
        for e in ended:
            observations[e] = {g: part[e] for g, part in last.items()} if isinstance(last, dict) else last[e]
        info = self._infos(results(self.engine.outcome, mask), form_of(mask))
        return {"final_obs": observations, "_final_obs": mask, "final_info": info, "_final_info": mask}

    # Forms

    def _infos(self, found: StepResult, form: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
        return infos_of(found, form, self.engine.own_info)

    def _observations(self) -> Observations:
        """Of all environments, a copy."""
        stack, count = self._history, self.num_envs
        if self._slices is None:
            return stack.reshape(count, -1).copy()
        if count == 1 and stack.shape[1] == 1:
            row = stack[0].copy()
            return {group: row[:, part] for group, part in self._slices.items()}
        return {group: stack[:, :, part].copy().reshape(count, -1) for group, part in self._slices.items()}

    def _require_begun(self) -> None:
        if self.closed:
            raise InputError("environments must be open, got closed ones: make them anew")
        if not self._all_begun:
            raise InputError("reset must come before everything else, got no episode: call reset() first")

    def _checked(self, actions: Any) -> NDArray[Any]:
        """Commands in the type of the action space."""
        self._require_begun()
        given, (low, high, kinds) = np.asarray(actions), self._bounds
        if given.dtype.kind not in kinds or given.shape != low.shape:
            kind = f"{low.dtype} numbers" if "f" in kinds else "integers"
            raise InputError(f"actions must be {kind} of shape {low.shape}, got {given.dtype} {given.shape}: "
                             "pass one for each environment")  # fmt: skip
        commands = given.astype(low.dtype)
        fits = (commands >= low) & (commands <= high)
        if "f" in kinds and np.count_nonzero(fits) < fits.size:  # seldom, and this takes longer than the test
            commands = within_rounding(commands, low, high)
            fits = (commands >= low) & (commands <= high)
        if np.count_nonzero(fits) < fits.size:
            e = int(np.flatnonzero(~fits.reshape(self.num_envs, -1).all(axis=1))[0])
            remedy = "clip it" if np.isfinite(given[e]).all() else "check the policy for NaN"
            raise InputError(f"actions[{e}] must lie in {self.single_action_space}, got {given[e]}: {remedy}")
        return commands


class WrappedVectorEnv(VectorDrivingEnv):
    """N environments of an id of highway-env, as :func:`~lanebound.envs.wrap` makes one; ``wrap_vec`` makes this."""

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        processes: int = 1,
        initialize: Callable[[], object] | None = None,
    ) -> None:
        self.env_id = env_id
        super().__init__(num_envs, config, autoreset_mode, None, processes, initialize)

    def _maker(self, config: Mapping[str, Any] | None) -> Callable[[], DrivingEnv]:
        return partial(wrap, self.env_id, config)


_classes: dict[type[Preset], type[VectorDrivingEnv]] = {}


def engine_class(kind: type[Preset]) -> type[VectorDrivingEnv]:
    """The vector environment of an id; one class for each."""
    if kind not in _classes:
        page = f"``{id_of(kind)}``, N times."
        body = {"KIND": kind, "__doc__": page, "__module__": __name__}
        _classes[kind] = type(f"Vector{kind.__name__}", (VectorDrivingEnv,), body)
    return _classes[kind]


def engines() -> dict[str, type[VectorDrivingEnv]]:
    """The ids that the engine drives, and their vector environments."""
    return {id_of(kind): engine_class(kind) for kind in presets() if has_engine(kind)}


def __getattr__(name: str) -> type[VectorDrivingEnv]:
    """``VectorHighway`` and so on: the vector environment of the class of ids of that name."""
    for kind in every_preset():
        if name == f"Vector{kind.__name__}" and has_engine(kind):
            return engine_class(kind)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class _Bounds(NamedTuple):
    """Lowest and highest commands, and the kinds of numbers that commands may be, for a faster ``contains``."""

    low: NDArray[Any]
    high: NDArray[Any]
    kinds: str


def _bounds_of(space: Space[Any]) -> _Bounds:
    if isinstance(space, Box):
        return _Bounds(space.low, space.high, "iuf")
    if isinstance(space, MultiDiscrete):
        return _Bounds(space.start.astype(space.dtype), (space.start + space.nvec - 1).astype(space.dtype), "iu")
    raise InputError(f"action_space must be a Box or MultiDiscrete, got {space}: choose an action of the environment")


def _slices_of(single: DrivingEnv) -> dict[str, slice] | None:
    """Where each group of the dict form lies; None for the flat form."""
    return None if single.config.observation.form == "flat" else single.observer.slices


def _mode_of(mode: AutoresetMode | str) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    try:
        return AutoresetMode(mode)
    except ValueError:
        names = ", ".join(repr(m.value) for m in AutoresetMode)
        raise InputError(f"autoreset_mode must be one of {names}, got {mode!r}") from None


def _seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """One seed for each environment."""
    if seed is None:
        return [None] * count
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
        seed = [int(seed) + i for i in range(count)]
    if not isinstance(seed, Sequence | np.ndarray) or not all(_is_seed(s) for s in seed):
        raise InputError(f"seed must be an int or one for each of {count} environments, got {seed!r}: pass ints")
    seeds = [None if s is None else int(s) for s in seed]
    lowest = min((s for s in seeds if s is not None), default=0)
    if lowest < 0:
        raise InputError(f"seed must be 0 or more, got {lowest}: choose another")
    if len(seeds) != count:
        raise InputError(f"seed must be an int or one for each of {count} environments, got {len(seeds)} of them")
    return seeds


def _is_seed(seed: object) -> bool:
    return isinstance(seed, int | np.integer | None) and not isinstance(seed, bool)


def _mask_of(options: dict[str, Any] | None, count: int) -> Flags:
    """Environments to reset."""
    if not options or MASK not in options:
        return np.ones(count, dtype=np.bool_)
    mask = np.array(options[MASK])  # infos give it back
    if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
        raise InputError(f"options.{MASK} must be ({count},) bool with one True at least, got {mask!r}: "
                         "pass np.array with True for environments to reset")  # fmt: skip
    return mask
