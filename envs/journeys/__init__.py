"""Journeys through cities: streets are chosen at junctions by the integrity that they will have."""
