"""A driver by keyboard: pressed keys, and the actions that they command."""

from __future__ import annotations

from enum import Enum
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import StatelessDriver
from lanebound.envs.core import DrivingEnv

__all__ = ["HELP", "Key", "KeyboardDriver"]

PEDAL = 0.5  # share of the range that an arrow commands
STEER_MAX = 0.35  # of the range, reached after STEER_S; small, as the wheel of a car is
STEER_S = 0.6
MOVES = {"LEFT": "LANE_LEFT", "RIGHT": "LANE_RIGHT", "UP": "FASTER", "DOWN": "SLOWER"}
CLAIMS = {"UP": "CHARGE", "DOWN": "SPARE"}  # where charges are decided
HELP = "arrows: up and down for speed, left and right to steer or change lane; R: again; Q or Escape: leave"


class Key(Enum):
    """The keys in use; the value is pygame's name of the key."""

    LEFT = "left"
    RIGHT = "right"
    UP = "up"
    DOWN = "down"
    AGAIN = "r"
    LEAVE = "q"


class KeyboardDriver(StatelessDriver):
    """Turns keys into actions, independent of any window.

    Under meta-actions each press is one command, in the order of pressing. Under continuous ones arrows act for as long
    as they are held: the wheel turns gradually and springs back.
    """

    def __init__(self, env: DrivingEnv) -> None:
        self._inner, self._dt_s = env.world.action_type, env.dt_s
        self._continuous = isinstance(env.action_space, spaces.Box)
        self._codes = {} if self._continuous else {label: code for code, label in self._inner.actions.items()}
        self._held: set[Key] = set()
        self._pressed: list[Key] = []
        self._wheel = 0.0

    def press(self, key: Key) -> None:
        """A key goes down."""
        self._held.add(key)
        self._pressed.append(key)

    def release(self, key: Key) -> None:
        """A key comes up."""
        self._held.discard(key)

    def reset(self) -> None:
        """Clear the pressed keys; the wheel is straight."""
        self._held.clear()
        self._pressed.clear()
        self._wheel = 0.0

    def act(self, observation: Any) -> int | NDArray[np.float32]:
        """The action of the keys."""
        return self._steered() if self._continuous else self._chosen()

    def _chosen(self) -> int:
        while self._pressed:
            key = self._pressed.pop(0).name
            label = MOVES.get(key)
            label = label if label in self._codes else CLAIMS.get(key)
            if label in self._codes:
                return int(self._codes[label])
        return int(self._codes["IDLE"])

    def _steered(self) -> NDArray[np.float32]:
        taps = {*self._pressed, *self._held}  # a tap shorter than a step counts for one step
        self._pressed.clear()
        aim = STEER_MAX * ((Key.RIGHT in taps) - (Key.LEFT in taps))
        most = STEER_MAX * self._dt_s / STEER_S
        self._wheel += min(max(aim - self._wheel, -most), most)
        pedal = PEDAL * ((Key.UP in taps) - (Key.DOWN in taps))
        wanted = ((self._inner.longitudinal, pedal), (self._inner.lateral, self._wheel))
        return np.array([value for there, value in wanted if there], dtype=np.float32)
