"""The observation entries that a policy was trained with, by name, and their selection from other observations.

A policy selects its entries by name, so an environment may show more entries, in another order or in another form.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, in_a_row
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.integrity.core.errors import InputError

__all__ = ["INPUTS", "PolicyInputs", "Selection"]

INPUTS = "lanebound.observation"
"""Name of the inputs as JSON: a member of a checkpoint, metadata of an ONNX file."""
REMEDY = "configure 'observation' as in its training"


class PolicyInputs(NamedTuple):
    """What a policy was trained with.

    Attributes
    ----------
    columns : names of the entries of one observation in their order, such as ``ego.speed``
    scales : their scales
    history : number of stacked observations
    """

    columns: tuple[str, ...]
    scales: tuple[float, ...]
    history: int = 1

    @classmethod
    def of(cls, config: ObservationConfig) -> Self:
        """The inputs of a policy that is trained with such observations."""
        shown = entries(config)
        return cls(tuple(e.column for e in shown), tuple(e.scale for e in shown), config.history)

    @classmethod
    def from_json(cls, text: str, name: str) -> Self:
        """Read what :meth:`to_json` wrote; ``name`` says of which policy.

        Raises
        ------
        InputError
            It is other text.
        """
        try:
            found = json.loads(text)
            columns, scales = tuple(map(str, found["columns"])), tuple(map(float, found["scales"]))
            if len(columns) != len(scales):
                raise ValueError
            return cls(columns, scales, int(found["history"]))
        except (ValueError, KeyError, TypeError):
            raise InputError(
                f"{INPUTS} of {name} must be JSON of columns, scales and history, got {text[:60]!r}: export it anew"
            ) from None

    def to_json(self) -> str:
        """As JSON."""
        return json.dumps(self._asdict())

    @property
    def size(self) -> int:
        """How many numbers the policy takes."""
        return len(self.columns) * self.history

    def select_from(self, config: ObservationConfig, name: str) -> Selection:
        """How to select these entries from observations of an environment; ``name`` says for which policy.

        Raises
        ------
        InputError
            The environment shows no such entry, shows it with another scale, or stacks another number of observations.
        """
        shown = {entry.column: (place, entry.scale) for place, entry in enumerate(entries(config))}
        missing = [column for column in self.columns if column not in shown]
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise InputError(
                f"observation must show the entries that {name} was trained with, got one without "
                f"'{missing[0]}'{more}: {REMEDY}, or register the entry"
            )
        for column, scale in zip(self.columns, self.scales, strict=True):
            if shown[column][1] != scale:
                raise InputError(
                    f"the scale of '{column}' must be {scale:g}, with which {name} was trained, "
                    f"got {shown[column][1]:g}: {REMEDY}"
                )
        if config.history != self.history:
            raise InputError(
                f"observation.history must be {self.history}, with which {name} was trained, "
                f"got {config.history}: {REMEDY}"
            )
        return Selection(
            self.columns, np.array([shown[column][0] for column in self.columns]), len(shown), self.history
        )


class Selection:
    """Selects entries from observations (..., n), flat or a dict of groups, single or in batches.

    Parameters
    ----------
    columns : names of the entries, in their order; the part before the point is the group
    places : position of each entry in the flat observation of the environment
    size, history : number of entries of one observation of the environment, and of stacked observations
    """

    def __init__(self, columns: tuple[str, ...], places: NDArray[np.int64], size: int, history: int) -> None:
        self._history = history
        self.is_whole = np.array_equal(places, np.arange(size))
        self._places = (size * np.arange(history)[:, None] + places).ravel()
        groups = np.array([column.partition(".")[0] for column in columns])
        self._groups = {str(group): np.flatnonzero(groups == group) for group in dict.fromkeys(groups.tolist())}
        self.sizes = {group: history * len(places) for group, places in self._groups.items()}

    def flat(self, observation: Observation) -> NDArray[np.float32]:
        """The entries in one vector (..., n)."""
        row = in_a_row(observation, self._history)
        return row if self.is_whole else row[..., self._places]

    def grouped(self, observation: Observation) -> Mapping[str, NDArray[np.float32]]:
        """The entries as a dict of groups."""
        if self.is_whole and isinstance(observation, Mapping):
            return observation
        row = self.flat(observation)
        frames = row.reshape(*row.shape[:-1], self._history, -1)
        return {group: frames[..., part].reshape(*row.shape[:-1], -1) for group, part in self._groups.items()}
