"""Statistics of observations under which a policy of Stable-Baselines3 was trained (``VecNormalize``)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError

__all__ = ["NORMALIZATION", "Normalization", "require_plain"]

NORMALIZATION = "lanebound.normalization"
"""Name of the statistics as JSON, a member of a checkpoint."""
REMEDY = (
    "call lanebound.agents.drivers.origin.name_inputs(checkpoint, config, env_id, normalize=envs) with the "
    "VecNormalize of its training (docs/training.md)"
)
Array = NDArray[np.float64]


class Normalization(NamedTuple):
    """``clip((x - mean) / sqrt(variance + epsilon), -limit, limit)``, as ``VecNormalize`` computes it.

    Attributes
    ----------
    mean, variance : (n,) of each group of observations by its name; of flat observations under ``""``
    epsilon, limit : added to the variance; largest size
    """

    mean: Mapping[str, Array]
    variance: Mapping[str, Array]
    epsilon: float
    limit: float

    @classmethod
    def of(cls, envs: Any) -> Self | None:
        """The statistics of a ``VecNormalize``; None where it leaves observations as they are.

        Raises
        ------
        InputError
            ``envs`` is no ``VecNormalize``.
        """
        from stable_baselines3.common.vec_env import VecNormalize

        if not isinstance(envs, VecNormalize):
            raise InputError(f"normalize must be the VecNormalize of the training, got {envs!r}: pass it, or leave out")
        if not envs.norm_obs:
            return None
        rms: Any = envs.obs_rms if isinstance(envs.obs_rms, dict) else {"": envs.obs_rms}
        return cls({k: r.mean for k, r in rms.items()}, {k: r.var for k, r in rms.items()}, envs.epsilon, envs.clip_obs)

    @classmethod
    def from_json(cls, text: str, space: spaces.Space[Any], name: str) -> Self:
        """Read what :meth:`to_json` wrote for observations of a space; ``name`` says of which policy.

        Raises
        ------
        InputError
            It is other text, or of other observations.
        """
        parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
        try:
            found = json.loads(text)
            mean, variance = ({k: np.array(v, float) for k, v in found[of].items()} for of in ("mean", "variance"))
            if any(part[key].shape != parts[key].shape for part in (mean, variance) for key in mean):
                raise ValueError
            return cls(mean, variance, float(found["epsilon"]), float(found["limit"]))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(
                f"{NORMALIZATION} of {name} must be statistics of its observations, got {text[:60]!r}: {REMEDY}"
            ) from None

    def to_json(self) -> str:
        """As JSON."""
        groups = {of: {k: v.tolist() for k, v in getattr(self, of).items()} for of in ("mean", "variance")}
        return json.dumps({**groups, "epsilon": self.epsilon, "limit": self.limit})

    def apply(self, observation: Any) -> Any:
        """Observations (..., n) as the policy takes them; groups without statistics stay as they are."""
        if isinstance(observation, Mapping):
            return {k: self._one(k, part) if k in self.mean else part for k, part in observation.items()}
        return self._one("", observation)

    def _one(self, key: str, part: NDArray[np.float32]) -> NDArray[np.float32]:
        scaled = (part - self.mean[key]) / np.sqrt(self.variance[key] + self.epsilon)
        return np.clip(scaled, -self.limit, self.limit).astype(np.float32)


def require_plain(model: Any, name: str) -> None:
    """Refuse a policy that was trained on normalized observations, whose statistics nobody has added.

    Observations of lanebound lie within finite bounds. A checkpoint holds the last one of its training, which
    ``VecNormalize`` usually takes out of the bounds; Gymnasium's ``NormalizeObservation`` declares none. A checkpoint
    whose last observation lies within the bounds, or was not saved, leaves no trace and passes.

    Raises
    ------
    InputError
        The policy was trained so: on raw observations it would drive otherwise than it has learnt.
    """
    space, last = model.observation_space, getattr(model, "_last_obs", None)
    parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    for key, part in parts.items():
        if not isinstance(part, spaces.Box):
            continue
        seen = last.get(key) if isinstance(last, Mapping) else last
        outside = seen is not None and not np.all((np.asarray(seen) >= part.low) & (np.asarray(seen) <= part.high))
        if outside or not part.is_bounded():
            raise InputError(f"{name} must hold the statistics of its normalized observations, got none: {REMEDY}")
