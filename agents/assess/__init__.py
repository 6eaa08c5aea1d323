"""Studies of what the layer promises: how often errors exceed their levels, and what becomes of faults."""
