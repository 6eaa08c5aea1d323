"""Benchmarks: each module here that has ``measure(rounds) -> list[Row]`` is found and run by ``lanebound bench``."""
