"""Benchmarks of speed, which ``lanebound bench`` runs and compares with their gates."""
