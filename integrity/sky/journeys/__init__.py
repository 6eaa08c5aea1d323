"""Journeys through street maps: what is predicted along each street at an hour, and the choice of a route by it."""
