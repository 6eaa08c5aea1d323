"""Refusals before the slow imports of a command: names that can be checked against static lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lanebound.agents.cli.static import static_table
from lanebound.agents.drivers import AGENTS, bare_name, unknown_agent

__all__ = ["known_skies", "refuse_early", "refuse_film", "refuse_preset"]

FILES = (".zip", ".onnx", ".npz", ".csv", ".yaml", ".yml")


def refuse_early(
    env: str | None = None,
    agent: str | None = None,
    sky: str | None = None,
    faults: str | None = None,
    changes: Mapping[str, Any] | None = None,
) -> None:
    """Refuse the name of an environment, agent, sky, file or level of faults that does not exist.

    ``changes`` of an environment's configuration are refused for unknown keys and numbers out of bounds.

    An environment with a module (``package:id``) or with a version may be registered elsewhere, and passes.

    Raises
    ------
    InputError
        As the command itself would raise it later.
    """
    if env is not None:
        _require_env(env)
    agent = None if agent is None else bare_name(agent)
    if agent is not None and agent not in AGENTS and ":" not in agent:
        if not agent.endswith(FILES):
            raise unknown_agent(agent)
        _require_file("agent", agent, "correct the path")
    if sky is not None and sky.endswith(".csv"):
        _require_file("sky", sky, "make it by 'lanebound record-sky'")
    elif sky is not None and not sky.endswith(FILES) and "/" not in sky:
        _require(
            "sky",
            sky,
            static_table()["skies"],
            ", or a file",
            " (files: .csv of 'lanebound record-sky', .yaml of your own)",
        )
    if changes:
        from lanebound.agents.cli.keys import refuse_keys

        refuse_keys("environment", changes)
    if faults is not None:
        _require("faults", faults, static_table()["faults"])


def known_skies(names: list[str] | None) -> list[str] | None:
    """The skies that ``--sky`` gives; None without any.

    Raises
    ------
    ConfigError, InputError
        One of them is no sky, or its file is refused.
    """
    from lanebound.integrity.core.errors import ConfigError, InputError

    for name in names or ():
        try:
            refuse_early(sky=name)
        except (ConfigError, InputError) as error:
            raise type(error)(f"--{error}") from None
        if "/" in name and not name.endswith(FILES):
            refuse_preset("--sky", "skies/", name)
    return names or None


def refuse_film(video: Path | None) -> None:
    """Refuse the name of a film that is no .mp4."""
    if video is not None and video.suffix != ".mp4":
        from lanebound.integrity.core.errors import InputError

        raise InputError(f"video must end in .mp4, got {video.name}: rename it")


def _require_file(what: str, name: str, remedy: str) -> None:
    from lanebound.integrity.core.errors import InputError

    if not Path(name).is_file():
        raise InputError(f"{what} must be a file that exists, got {name}: {remedy}")


def refuse_preset(what: str, folder: str, name: str, called: str | None = None) -> None:
    """Refuse a preset that does not exist, as :func:`~lanebound.agents.presets.load_named`; files are read later."""
    if not name.endswith((".yaml", ".yml")):
        from lanebound.agents.presets import require_named

        require_named(what, folder, name, called)


def _require_env(name: str) -> None:
    from lanebound.integrity.core.errors import InputError
    from lanebound.integrity.core.presets import nearest

    table = static_table()
    listed = [row["id"] for row in table["environments"]]
    ids = [name.partition("/")[2] for name in (*listed, *table["more_environments"])]
    short = name.removeprefix("lanebound/")
    ours = name != short or "-v" not in name
    if ours and ":" not in name and short.partition("-v")[0].lower() not in {i.partition("-v")[0].lower() for i in ids}:
        raise InputError(f"environment '{name}' is unknown: {nearest(short, ids)}")


def _require(what: str, name: str, known: Sequence[str], also: str = "", how: str = "") -> None:
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.core.presets import nearest

    if name not in known:
        raise ConfigError(f"{what} must be one of {', '.join(known)}{also}, got {name!r}: {nearest(name, known)}{how}")
