"""Benchmarks: ratios taken in one run, printed by ``make bench`` and written to ``build/bench.json``."""
