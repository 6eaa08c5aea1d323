"""Basics of the integrity layer: configuration, errors, random streams, frames, compiled kernels and their data."""
