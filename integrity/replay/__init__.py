"""Recorded drives through the same rooms as simulated ones: real measurements in, belief against truth out."""
