"""Agents by name: controllers that decide by observations, with the interface of stable-baselines3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, NamedTuple, cast, get_args, get_type_hints

if TYPE_CHECKING:
    from lanebound.agents.drivers.base import Driver
    from lanebound.envs.core import DrivingEnv
    from lanebound.integrity.core.config import Config
    from lanebound.integrity.core.errors import InputError

__all__ = [
    "ABOUT",
    "AGENTS",
    "LAYERED",
    "REMEMBERING",
    "About",
    "bare_name",
    "load_figures",
    "make_agent",
    "require_bindable",
    "unknown_agent",
]

AGENTS = {
    "bank": "lanebound.agents.drivers.degenerate:make_bank",
    "cautious": "lanebound.agents.drivers.margins:make_cautious",
    "cbf": "lanebound.agents.drivers.barrier:make_cbf",
    "clock": "lanebound.agents.drivers.clock:make_clock",
    "clock_scaled": "lanebound.agents.drivers.scaled:make_clock_scaled",
    "constant": "lanebound.agents.drivers.degenerate:make_constant",
    "cruise": "lanebound.agents.drivers.cruise:make_cruise",
    "idm": "lanebound.agents.drivers.cruise:make_idm",
    "integrity_aware": "lanebound.agents.drivers.aware:make_integrity_aware",
    "layer": "lanebound.agents.drivers.layered:make_layer",
    "level_scaled": "lanebound.agents.drivers.scaled:make_level_scaled",
    "lqr": "lanebound.agents.drivers.cruise:make_lqr",
    "mpc": "lanebound.agents.drivers.mpc:make_mpc",
    "nominal": "lanebound.agents.drivers.nominal:make_nominal",
    "oracle": "lanebound.agents.drivers.nominal:make_oracle",
    "ppo": "lanebound.agents.drivers.learnt:make_ppo",
    "random": "lanebound.agents.drivers.random:RandomDriver",
    "rss": "lanebound.agents.drivers.margins:make_rss",
    "stanley": "lanebound.agents.drivers.cruise:make_stanley",
    "stop_on_alert": "lanebound.agents.drivers.stop:make_stop_on_alert",
    "weave": "lanebound.agents.drivers.degenerate:make_weave",
}
ANY, STEERED, FULL, SPEED = "any", "Box", "Box(2,)", "any with speed"


class About(NamedTuple):
    """The description of an agent.

    Attributes
    ----------
    does : its method; reads : entries of observations that it uses; on_alert : its reaction to an alert
    actions : spaces of actions that it can command, as ``lanebound envs`` shows them: any, any that command speed,
        steering with or without acceleration, or steering with acceleration
    """

    does: str
    reads: str
    on_alert: str
    actions: str


LEVELS = "position, levels"
ABOUT = {
    "bank": About("bad on purpose: nominal, later stops for good", "position", "nothing", SPEED),
    "cautious": About("nominal with constant margins, slower", "position", "nothing", ANY),
    "cbf": About(
        "barrier filter over an agent (`over`; nominal)", f"{LEVELS}, alert", "slows if levels fill the lane", FULL
    ),
    "clock": About(
        "integrity_aware with levels by the time since RTK", "position, modes, sky ahead", "by time: slows, stops", ANY
    ),
    "clock_scaled": About("level_scaled by the time since RTK", "position, modes", "by time: slows", ANY),
    "constant": About("bad on purpose: a share of the limit, blind to all else", "position", "nothing", SPEED),
    "cruise": About("keeps lane, speed and distance", "position", "nothing", ANY),
    "idm": About("cruise with IDM for distances", "position", "nothing", ANY),
    "integrity_aware": About(
        "rss, slower with levels and before outages", f"{LEVELS}, alert, sky ahead", "slows, later stops", ANY
    ),
    "layer": About(
        "hard rules over an agent (`over`; nominal), `AGENT+layer`", f"{LEVELS}, alert", "slows, keeps its lane", ANY
    ),
    "level_scaled": About(
        "rss, speed and steering scaled by the levels", f"{LEVELS}, alert", "slows as levels grow", ANY
    ),
    "lqr": About("cruise with LQR steering", "position", "nothing", STEERED),
    "mpc": About("model predictive control", f"{LEVELS}, alert", "slows as levels grow", FULL),
    "nominal": About("best laws without integrity; the reference", "position", "nothing", ANY),
    "oracle": About("nominal on the true state: a bound", "the truth", "nothing", ANY),
    "ppo": About("learnt policy of the id, cost limited", "everything", "as learnt", ANY),
    "random": About("random actions", "nothing", "nothing", ANY),
    "rss": About("nominal, gaps less levels, RSS speeds", LEVELS, "nothing", ANY),
    "stanley": About("cruise with Stanley steering", "position", "nothing", STEERED),
    "stop_on_alert": About("cruise, stops while an alert is on", "position, alert", "stops", ANY),
    "weave": About("bad on purpose: nominal, from side to side", "position", "nothing", ANY),
}
"""Descriptions of ``AGENTS``, as ``lanebound agents`` prints them."""
LAYERED = "+layer"
"""End of a name ``AGENT+layer``: that agent under the rules of ``layer``."""
REMEMBERING = ("cbf", "mpc")
"""Agents that use their last command: they are wrong where the commands of another agent are carried out."""


def bare_name(name: str) -> str:
    """The agent of a name ``AGENT+layer``; other names as they are.

    Raises
    ------
    ConfigError
        The rules of ``layer`` cannot bind that agent.
    """
    over = name.removesuffix(LAYERED)
    if over != name:
        require_bindable(over)
    return over


def require_bindable(over: str) -> None:
    """Raise ConfigError for an agent that ``layer`` cannot bind: itself, or one that remembers its commands."""
    from lanebound.integrity.core.errors import ConfigError

    if over == "layer" or over.endswith(LAYERED):
        raise ConfigError(f"over must be another agent than layer, got {over}: choose nominal or ppo, say")
    if over in REMEMBERING:
        raise ConfigError(
            f"over must have no memory of its commands, got {over}: the layer changes them, choose nominal, say"
        )


def make_agent(name: str, env: DrivingEnv, figures: Mapping[str, Any] | None = None) -> Driver:
    """The agent of a name for an environment, made from its spaces and its published index alone.

    ``AGENT+layer`` is the agent ``layer`` over that one. The name may also be that of a file or a callable, see
    :func:`~lanebound.agents.drivers.foreign.open_foreign`. ``figures`` change the agent's own configuration, such as
    ``{"speed_share": 0.5}`` of ``cautious``, or ``{"over": "integrity_aware"}`` of ``cbf``, the agent that it filters.

    Raises
    ------
    InputError
        No agent has that name, it has no such figures, or the environment does not show what it needs.
    """
    from lanebound.agents.drivers.foreign import is_foreign, open_foreign

    if name.endswith(LAYERED):
        return make_agent("layer", env, {"over": bare_name(name)} | dict(figures or {}))
    if name not in AGENTS and not is_foreign(name):
        raise unknown_agent(name)
    config = load_figures(name, figures)
    if name not in AGENTS:
        return open_foreign(name, env)
    _require_actions(name, env)
    make = _maker(name)
    driver: Driver = make(env) if config is None else make(env, config=config)
    return driver


def load_figures(name: str, figures: Mapping[str, Any] | None, path: str = "") -> Config | None:
    """The configuration of an agent with changed figures; None without figures. No environment is needed.

    Parameters
    ----------
    path : prefix of the keys in messages

    Raises
    ------
    InputError
        It has no such figures, or a value is refused.
    """
    if not figures:
        return None
    if name in AGENTS:
        return _config_class(name, _maker(name)).load(dict(figures), path)
    from lanebound.integrity.core.errors import InputError

    raise InputError(f"figures must be empty for '{name}', got {sorted(figures)}: only agents of ours have figures")


def _maker(name: str) -> Any:
    module, _, maker = AGENTS[name].partition(":")
    return getattr(import_module(module), maker)


def unknown_agent(name: str, suite: Sequence[str] = ()) -> InputError:
    """The refusal of a name that no agent has, neither of the package nor of a ``suite``."""
    from lanebound.integrity.core.errors import InputError
    from lanebound.integrity.core.presets import nearest

    if (Path(name) / "best.zip").is_file():
        return InputError(f"agent must be a name or a file, got the folder {name}: give {Path(name) / 'best.zip'}")
    module, dot, attribute = name.rpartition(".")
    if dot and module and attribute.isidentifier():
        return InputError(
            f"agent '{name}' is unknown: write '{module}:{attribute}' for a callable of a module of yours"
        )
    advice, where = nearest(name, (*suite, *AGENTS)), "see 'lanebound agents'"
    if suite and advice.startswith("did you mean"):
        where = f"the suite has {', '.join(suite)}; {where}"
    elif suite:
        advice = f"the suite has {', '.join(suite)}, the package {', '.join(AGENTS)}"
    return InputError(f"agent '{name}' is unknown: {advice} ({where}), or give a file")


def _require_actions(name: str, env: DrivingEnv) -> None:
    """Refuse an agent that cannot command the actions of an environment, and name those that can."""
    actions = env.world.action_type
    steered = not hasattr(env.action_space, "n")
    fast = not steered or actions.longitudinal
    there = {ANY, *((SPEED,) if fast else ()), *((STEERED,) if steered else ()), *((FULL,) if steered and fast else ())}
    if ABOUT[name].actions in there:
        return
    from lanebound.integrity.core.errors import InputError

    fitting = ", ".join(other for other, about in ABOUT.items() if about.actions in there and _is_there(other, env))
    wanted = {FULL: "continuous with acceleration", SPEED: "one that commands speed"}.get(
        ABOUT[name].actions, "continuous"
    )
    found = "steering alone" if steered else "meta-actions"
    raise InputError(f"action must be {wanted} for agent '{name}', got {found}: choose one of {fitting}")


def _is_there(name: str, env: DrivingEnv) -> bool:
    """Whether an agent is available for an environment: the learnt one needs a policy of that world."""
    from lanebound.agents.drivers.learnt import policies

    return name != "ppo" or env.config.base in policies()


def _config_class(name: str, make: Any) -> type[Config]:
    """The class of an agent's figures, as its maker declares it."""
    if not isinstance(make, type):
        for kind in get_args(get_type_hints(make).get("config")):
            if kind is not NoneType:
                return cast("type[Config]", kind)
    from lanebound.integrity.core.errors import InputError

    raise InputError(f"figures must be empty for '{name}', got some: this agent has none")
