"""Draw docs/urban-canyon.png, the picture of the README: ``.venv/bin/python docs/urban_canyon.py [SEED]``.

The picture is of the first step after both protection levels have exceeded their alert limits for five seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.image import imsave

import lanebound.envs  # noqa: F401
from lanebound.agents.drivers import make_agent

LASTING_S = 5.0


def draw(seed: int, file: Path) -> None:
    """Drive ``integrity_aware`` with this seed until both levels were too large for long enough; write the picture."""
    env: Any = gym.make("lanebound/UrbanCanyon-v0", render_mode="rgb_array")
    agent, start = make_agent("integrity_aware", env.unwrapped), np.ones(1, dtype=np.bool_)
    observation, info = env.reset(seed=seed)
    lasted = 0.0
    while lasted < LASTING_S:
        action, _ = agent.predict(observation, episode_start=start, deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            sys.exit(f"seed {seed} has no such moment: give another one")
        beyond = info["margin_at_m"] < 0.0 and info["margin_ct_m"] < 0.0
        lasted = lasted + 1.0 / env.unwrapped.config.policy_hz if beyond else 0.0
        start = np.zeros(1, dtype=np.bool_)
    imsave(file, env.render())


if __name__ == "__main__":
    draw(int(sys.argv[1]) if len(sys.argv) > 1 else 10_002, Path(__file__).with_name("urban-canyon.png"))
