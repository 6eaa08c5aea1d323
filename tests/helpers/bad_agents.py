"""Agents that do not do their part, each in its own way, and one that does; made by a benchmark by their names."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

AFTER = 3  # decisions that all of them get right


class Bad:
    """Goes wrong at one decision, by the function that it is given."""

    def __init__(self, wrong: Any) -> None:
        self.wrong, self.decisions = wrong, 0

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        self.decisions += 1
        return (np.zeros(2, np.float32) if self.decisions <= AFTER else self.wrong()), state


def _raise() -> Any:
    raise ValueError("no idea what to do")


def _leave() -> Any:
    raise SystemExit(3)


def _hang() -> Any:
    while True:
        time.sleep(0.01)


def raises(env: Any) -> Bad:
    return Bad(_raise)


def leaves(env: Any) -> Bad:
    return Bad(_leave)


def dies(env: Any) -> Bad:
    return Bad(lambda: os._exit(7))


def hangs(env: Any) -> Bad:
    return Bad(_hang)


def not_a_number(env: Any) -> Bad:
    return Bad(lambda: np.array([np.nan, 0.0], np.float32))


def short(env: Any) -> Bad:
    return Bad(lambda: np.zeros(1, np.float32))


def says_words(env: Any) -> Bad:
    return Bad(lambda: "left")


def too_much(env: Any) -> Bad:
    return Bad(lambda: np.array([0.0, 1.5], np.float32))


def unmade(env: Any) -> Bad:
    raise RuntimeError("could not be made")


def no_pair(env: Any) -> Any:
    class Single:
        def predict(self, observation: Any, **rest: Any) -> Any:
            return np.zeros(2, np.float32)

    return Single()


def draws(env: Any) -> Any:
    """Draws from the global generator, and from what is printed nothing may get into a command's output."""
    print("I draw")
    return lambda observation: np.random.uniform(-0.2, 0.2, 2).astype(np.float32)  # noqa: NPY002


def nothing(env: Any) -> Any:
    return 5


def takes_nothing() -> Any:
    return lambda observation: np.zeros(2, np.float32)


not_callable = 5


def samples(env: Any) -> Any:
    """Draws from the generator of the action space."""
    return lambda observation: env.action_space.sample()
