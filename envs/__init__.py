"""Gymnasium environments in which the ego vehicle drives on what its navigation believes."""
