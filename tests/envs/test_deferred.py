"""Libraries that highway-env imports and driving does not need are not imported, and work once they are used."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys
import lanebound.envs
assert not {"matplotlib", "pandas", "scipy.optimize"} & set(sys.modules)
from highway_env.envs.common import observation
from highway_env.vehicle import dynamics
assert callable(observation.pd.DataFrame) and callable(dynamics.plt.subplots)
import matplotlib.pyplot
import pandas
assert observation.pd.DataFrame is pandas.DataFrame and dynamics.plt.subplots is matplotlib.pyplot.subplots
"""


def test_they_are_imported_at_their_first_use() -> None:
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)
