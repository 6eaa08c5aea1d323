"""Satellites, obstacles and signal reception: orbits, sky views, city models, ray tracing, sky masks and forecasts."""
