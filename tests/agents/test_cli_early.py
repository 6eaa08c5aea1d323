"""Refusals before slow imports: static lists are those of the environments, and nothing heavy is imported."""

import subprocess
import sys

import pytest

from lanebound.agents.cli.early import FAULTS, SKIES, refuse_early
from lanebound.envs.config import FaultLevel
from lanebound.envs.sky import SKY_LEVELS
from lanebound.integrity.core.errors import InputError


def test_the_static_lists_are_those_of_the_environments() -> None:
    assert tuple(SKY_LEVELS) == SKIES
    assert tuple(level.value for level in FaultLevel) == FAULTS


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"env": "LaneKeepin"}, "environment 'LaneKeepin' is unknown: did you mean 'LaneKeeping-v0'"),
        ({"env": "lanebound/Nowhere-v0"}, "environment 'lanebound/Nowhere-v0' is unknown"),
        ({"agent": "nominl"}, "agent 'nominl' is unknown: did you mean 'nominal'"),
        ({"sky": "urbn"}, "sky must be one of open, suburban, urban, dense, or a file, got 'urbn': did you mean"),
        ({"faults": "stres"}, "faults must be one of none, nominal, stress, got 'stres': did you mean 'stress'"),
    ],
)
def test_names_that_cannot_exist_are_refused(names: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match="^" + message):
        refuse_early(**names)


@pytest.mark.parametrize("env", ["lanekeeping", "LaneKeeping-v0", "lanebound/Merge-v0", "two-way-v0", "mine:Own-v0"])
def test_names_that_may_exist_pass(env: str) -> None:
    refuse_early(env, "out/best.zip", "skies/plaza", "stress")
    refuse_early(env, "package.module:make", "berlin.csv")


def test_a_refusal_imports_neither_numba_nor_torch_nor_highway_env() -> None:
    code = (
        "import sys\n"
        "from lanebound.agents.cli import app\n"
        "try:\n    app(['drive', 'LaneKeepin'])\nexcept SystemExit as end:\n    assert end.code == 2\n"
        "assert not {'numba', 'torch', 'highway_env', 'scipy'} & set(sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode == 0
