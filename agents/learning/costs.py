"""Common parts of the algorithms under limits of cost: the critic of costs, sums of episodes, and advantages.

K is the number of limits, see :mod:`.constraints`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from lanebound.integrity.core.errors import InputError

__all__ = ["CostCritic", "EpisodeCosts", "advantages", "require_flat"]

Array = NDArray[np.float32]


def require_flat(space: spaces.Space[Any]) -> int:
    """Length of a flat observation.

    Raises
    ------
    InputError
        Observations are not one vector.
    """
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise InputError(f"observations must be one vector, got {space}: set observation.form to flat")
    return int(space.shape[0])


class CostCritic(nn.Module):
    """K expected future costs of an observation, or of an observation and an action, as a small network.

    The loss is the squared error, whose minimum is the mean: a rare crash counts by its frequency.

    Parameters
    ----------
    size : of its input
    scales : (K,) of costs, about those of an episode; the outputs of the network are shares of them
    widths : of the hidden layers
    """

    scale: torch.Tensor

    def __init__(self, size: int, scales: Sequence[float] = (1.0,), widths: Sequence[int] = (64, 64)) -> None:
        super().__init__()
        self.register_buffer("scale", torch.tensor(scales, dtype=torch.float32), persistent=False)
        layers: list[nn.Module] = []
        for width in widths:
            layers += [nn.Linear(size, width), nn.Tanh()]
            size = width
        self.net = nn.Sequential(*layers, nn.Linear(size, len(scales)))

    def forward(self, given: torch.Tensor) -> torch.Tensor:
        """(..., size) to (..., K)."""
        found: torch.Tensor = self.net(given)
        return self.scale * found

    def loss(self, given: torch.Tensor, due: torch.Tensor) -> torch.Tensor:
        """Sum over the K costs of the mean squared error [of the scale] against target costs, (..., K)."""
        return len(self.scale) * functional.mse_loss(self(given) / self.scale, due / self.scale)

    def of(self, given: Array) -> Array:
        """The same on arrays, without gradients."""
        with torch.no_grad():
            device = next(self.parameters()).device
            return np.asarray(self(torch.as_tensor(given, dtype=torch.float32, device=device)).cpu().numpy())


class EpisodeCosts:
    """Means of K costs of an episode, over the latest ones of N environments side by side.

    Every environment counts alike, by its own latest episodes, and the means are known once each has ended one: among
    those that end within a time, short ones are too many. Of 64 environments that begin together only the crashed have
    ended at first, at 14 times the limit.

    Parameters
    ----------
    count : N
    limits : K
    window : episodes, of all environments together, that the means are of; at least one of each
    """

    def __init__(self, count: int, limits: int, window: int = 1) -> None:
        self._running = np.zeros((count, limits))
        self._latest = [deque[NDArray[np.float64]](maxlen=max(-(-window // count), 1)) for _ in range(count)]
        self._fresh = False

    def add(self, costs: Array, dones: NDArray[np.bool_]) -> None:
        """A step of all environments: costs (N, K), and where episodes ended, (N,)."""
        self._running += costs
        for n in np.flatnonzero(dones):
            self._latest[n].append(self._running[n].copy())
            self._running[n], self._fresh = 0.0, True

    def take(self) -> list[float] | None:
        """The means (K,), if an episode has ended since the last call."""
        if not self._fresh or not all(self._latest):
            return None
        self._fresh = False
        means: list[float] = np.mean([np.mean(costs, axis=0) for costs in self._latest], axis=0).tolist()
        return means


def advantages(
    costs: Array, values: Array, last: Array, dones: NDArray[np.bool_], gamma: float, gae_lambda: float
) -> tuple[Array, Array]:
    """Generalised advantage estimates of costs and the returns they go with (Schulman 2016, equation 16).

    ``delta_t = c_t + gamma V_(t+1) (1 - done_t) - V_t``, ``A_t = delta_t + gamma lambda (1 - done_t) A_(t+1)``

    Parameters
    ----------
    costs : (T, N, K), of a step; where an episode was cut off, with the discounted value of its end
    values : (T, N, K), of the observations before each step
    last : (N, K), value of those after the last
    dones : (T, N), whether the episode ended with the step

    Returns
    -------
    advantages and returns, (T, N, K) each
    """
    found = np.zeros_like(values)
    after, ahead = last, np.zeros_like(last)
    for t in range(len(costs) - 1, -1, -1):
        goes_on = 1.0 - dones[t, :, None].astype(np.float32)
        delta = costs[t] + gamma * after * goes_on - values[t]
        ahead = delta + gamma * gae_lambda * goes_on * ahead
        found[t], after = ahead, values[t]
    return found, found + values
