"""Driving by hand: the window's keys go to a driver, episode after episode, until the window is closed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from lanebound.agents.drivers.keyboard import Key, KeyboardDriver
from lanebound.agents.episodes.drive import Watcher, moment_of
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError

__all__ = ["Closed", "hand_over", "play", "require_display"]

BLIND_DRIVERS = ("dummy", "offscreen")


class Closed(Exception):  # noqa: N818 - no error, a wish
    """The player has had enough."""


def require_display() -> None:
    """Refuse to play where no window can be seen.

    Raises
    ------
    InputError
        There is no display.
    """
    from lanebound.envs.rendering.canvas import load_pygame

    pygame: Any = load_pygame()
    try:
        pygame.display.init()
        found = str(pygame.display.get_driver())
    except pygame.error as error:
        found = str(error)
    else:
        pygame.display.quit()
        if found not in BLIND_DRIVERS:
            return
    raise InputError(
        f"play needs a display, got none (SDL: {found}): run it on a desktop, or use 'lanebound drive ID --video a.mp4'"
    )


def hand_over(events: Iterable[tuple[str, str]], driver: KeyboardDriver) -> bool:
    """Give events to a driver, each ``("down" or "up", name of the key)`` or ``("close", "")``.

    Returns
    -------
    Whether the player asks for a new episode.

    Raises
    ------
    Closed
        The window was closed, or Q or Escape pressed.
    """
    names = {key.value: key for key in Key} | {"escape": Key.LEAVE}
    again = False
    for what, name in events:
        key = names.get(name)
        if what == "close" or (what == "down" and key is Key.LEAVE):
            raise Closed
        if key is None:
            continue
        if what == "down":
            driver.press(key)
            again = again or key is Key.AGAIN
        else:
            driver.release(key)
    return again


def play(env: DrivingEnv, seed: int, watchers: Iterable[Watcher] = ()) -> int:
    """Play until the player leaves; returns the number of episodes begun. Each has the next seed."""
    driver, episode = KeyboardDriver(env), 0
    try:
        while True:
            _episode(env, driver, episode, seed + episode, tuple(watchers))
            episode += 1
    except Closed:
        return episode + 1
    finally:
        env.close()


def _episode(env: DrivingEnv, driver: KeyboardDriver, episode: int, seed: int, watchers: tuple[Watcher, ...]) -> None:
    """One episode, until it ends or the player wants another."""
    driver.reset()
    observation, info = env.reset(seed=seed)
    moment = moment_of(env, episode, seed, 0, None, 0.0, False, False, info)
    while True:
        for watcher in watchers:
            watcher.note(moment)
        if moment.terminated or moment.truncated or hand_over(_events(), driver):
            return
        action, _ = driver.predict(observation, episode_start=np.zeros(1, dtype=np.bool_))
        observation, reward, terminated, truncated, info = env.step(action)
        moment = moment_of(env, episode, seed, moment.step + 1, action, reward, terminated, truncated, info)


def _events() -> list[tuple[str, str]]:
    """What has happened at the keyboard and to the window since the last look."""
    import pygame

    if not pygame.display.get_init():  # the environment's window was the only one, and is closed
        return [("close", "")]
    kinds = {pygame.KEYDOWN: "down", pygame.KEYUP: "up", pygame.QUIT: "close", pygame.WINDOWCLOSE: "close"}
    found = pygame.event.get(list(kinds))
    return [(kinds[e.type], pygame.key.name(e.key) if hasattr(e, "key") else "") for e in found]
