"""Presets as YAML files, read by :func:`lanebound.integrity.core.presets.load_preset`.

A preset's name is its path below this folder without ``.yaml``. ``kind`` names the configuration that the values are
for, ``extends`` the preset (or presets) they change; a value stands beside its source in a comment.
"""
