"""Replay of recorded measurements through the same positioning and monitoring as simulated ones, with assessment."""
