"""The engine drives alike in this process, with threads, and in its children, however they were started."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SCRIPT = """
import multiprocessing, os, sys
import numpy as np
from lanebound.envs.vector import VectorCarFollowing


def drive():
    env = VectorCarFollowing(16, {"sky": "open", "observation": {"form": "flat"}, "navigation": {"warm_up_s": 0.5}})
    seen, _ = env.reset(seed=1)
    for _ in range(3):
        seen, *_ = env.step(np.full((16, 2), 0.1, np.float32))
    return seen.tobytes()


if __name__ == "__main__":
    here = drive()
    for method in sys.argv[1:]:
        if method == "os.fork":
            child = os.fork()
            if child == 0:
                os._exit(0 if drive() == here else 7)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, method
        else:
            with multiprocessing.get_context(method).Pool(1) as pool:
                assert pool.apply_async(drive).get(timeout=300) == here, method
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_the_engine_works_in_children_of_every_kind(tmp_path) -> None:
    script = tmp_path / "drive.py"
    script.write_text(SCRIPT, encoding="utf-8")
    told = subprocess.run(
        [sys.executable, str(script), "fork", "forkserver", "spawn", "os.fork"],
        capture_output=True,
        text=True,
        timeout=800,
        env={**os.environ, "NUMBA_NUM_THREADS": "2"},
    )
    assert told.returncode == 0, told.stderr
