"""Digest of the defaults: which configuration a result was made with where it names none."""

from __future__ import annotations

import hashlib
import json
from functools import cache

from lanebound.envs.ids import IDS
from lanebound.envs.registration import make_config
from lanebound.integrity.core.presets import load_preset, preset_names
from lanebound.integrity.navigators.navigator import NavigatorConfig

__all__ = ["defaults_digest"]

OTHERS = ("experiments/", "studies/", "suites/")  # presets of commands, which no other command takes values from


@cache
def defaults_digest() -> str:
    """Eight hexadecimal digits of the default navigator, the ids as shipped, and the packaged presets they may name.

    Constants in the code are no part of it; the manifest of a result folder has a digest of the code too.
    """
    presets = {name: load_preset(name) for name in preset_names() if not name.startswith(OTHERS)}
    ids = {name: make_config(name).to_dict() for name in sorted(IDS) if name.startswith("lanebound/")}
    values = {"navigator": NavigatorConfig().to_dict(), "ids": ids, "presets": presets}
    return hashlib.blake2b(json.dumps(values, sort_keys=True).encode(), digest_size=4).hexdigest()
