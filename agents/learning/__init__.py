"""Agents that learn: algorithms under a cost limit, experiments, resumable training.

The algorithms are those of stable-baselines3, and two of lanebound that limit the cost of an episode by a Lagrange
multiplier (:mod:`.ppo_lagrangian`, :mod:`.sac_lagrangian`). An experiment is a YAML file (:mod:`.experiment`);
:mod:`.training` carries it out, :mod:`.evaluation` evaluates the policy on other seeds.
"""
