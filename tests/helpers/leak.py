"""How much of the signed position errors an observation gives away, by regression on held-out episodes.

An agent must not know the sign and the size of its position error. ``leak`` fits gradient boosting of the errors along
and across the track on whole observations and returns R^2 on episodes that were not fitted on: 0 for none.

    .venv/bin/python tests/helpers/leak.py CarFollowing sensor 64      # id, perception source, episodes
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from drives import drives, single_of
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from lanebound.envs.observation import entries

AXES = ("err_at_m", "err_ct_m")
HELD_OUT = 0.4  # share of the episodes


class Samples(NamedTuple):
    """Observations (n, E), errors (n, 2) [m], and the episode of each row (n,)."""

    observations: NDArray[np.float32]
    errors: NDArray[np.float64]
    episode: NDArray[np.int64]
    columns: tuple[str, ...]


def samples(name: str, source: str, episodes: int, seed: int = 1000, **config: Any) -> Samples:
    """Drives of ``nominal`` under an id and a perception source, on consecutive seeds."""
    made = {"perception": {"source": source}, **config}
    columns = tuple(entry.column for entry in entries(single_of(name, made).config.observation))
    found = [
        (one.observations, np.stack([one.infos[axis] for axis in AXES], -1), one.episode)
        for one in drives(name, made, "nominal", None, episodes, seed)
    ]
    return Samples(*(np.concatenate(part) for part in zip(*found, strict=True)), columns)


def leak(data: Samples) -> dict[str, float]:
    """R^2 of each error on held-out episodes; negative where the fit is worse than the mean."""
    held = data.episode >= (1.0 - HELD_OUT) * (data.episode.max() + 1)
    found = {}
    for k, axis in enumerate(AXES):
        model = HistGradientBoostingRegressor(max_iter=100, learning_rate=0.1, min_samples_leaf=40, random_state=0)
        truth = data.errors[held, k]
        with threadpool_limits(1):  # threads that wait for each other are slow beside other processes
            model.fit(data.observations[~held], data.errors[~held, k])
            rest = truth - model.predict(data.observations[held])
        found[axis] = 1.0 - float(np.square(rest).sum() / np.square(truth - truth.mean()).sum())
    return found


def suspects(data: Samples, axis: str, most: int = 5) -> list[tuple[str, float]]:
    """The columns that correlate most with an error, with their squared correlation."""
    error = data.errors[:, AXES.index(axis)]
    spread = data.observations.std(0) * error.std()
    both = ((data.observations - data.observations.mean(0)) * (error - error.mean())[:, None]).mean(0)
    squared = np.where(spread > 0.0, both / np.where(spread > 0.0, spread, 1.0), 0.0) ** 2
    return [(data.columns[i], float(squared[i])) for i in np.argsort(-squared)[:most]]


if __name__ == "__main__":
    found = samples(sys.argv[1], sys.argv[2], int(sys.argv[3]))
    print(sys.argv[1:], len(found.errors), {axis: round(value, 3) for axis, value in leak(found).items()})
    print("std", found.errors.std(0).round(3), *(suspects(found, axis) for axis in AXES))
