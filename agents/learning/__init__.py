"""Agents that learn: algorithms under a cost limit, experiments, training that goes on where it stopped.

The algorithms are those of stable-baselines3, and two of ours that keep an episode's cost below a limit by a Lagrange
multiplier (:mod:`.ppo_lagrangian`, :mod:`.sac_lagrangian`). An experiment is a YAML file (:mod:`.experiment`);
:mod:`.training` carries it out, :mod:`.evaluation` measures what came of it on other seeds.
"""
