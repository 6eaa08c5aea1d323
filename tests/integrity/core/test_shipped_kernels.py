"""A wheel can ship compiled kernels, which are copied to the cache and loaded in place of a compilation."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import llvmlite.binding
import pytest
from numba.core import types

from lanebound.integrity.core import kernel_cache
from lanebound.integrity.core import kernel_dispatcher as kd
from lanebound.integrity.core.kernel_cache import PORTABLE, PORTABLE_NEEDS, cache_directory

ROOT = Path(__file__).parents[3]
HOST = llvmlite.binding.get_host_cpu_features()
SOURCE = """
import sys
from lanebound.integrity.core.kernel_cache import locating
from lanebound.integrity.core.kernel_dispatcher import kernel_of

def twice(x):
    return 2 * x

twice = kernel_of(twice)
with locating(sys.argv[1] if __name__ == "__main__" else FOLDER):
    twice.enable_caching()
if __name__ == "__main__":
    twice(1.5)
"""


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The cache and the folder of shipped kernels, both in a temporary directory."""
    monkeypatch.setattr(kernel_cache, "cache_root", lambda: tmp_path / "cache")
    monkeypatch.setattr(kernel_cache, "SHIPPED", tmp_path / "compiled")
    (tmp_path / "cache").mkdir()
    (tmp_path / "twice.py").write_text(SOURCE)
    return tmp_path


def directory_of(places, monkeypatch, taken):
    monkeypatch.setattr(kernel_cache, "takes_shipped", lambda: taken)
    return Path(cache_directory(places / "twice.py"))


def test_a_new_directory_has_the_shipped_kernels_of_its_name(places, monkeypatch):
    name = directory_of(places, monkeypatch, False).name
    (places / "cache" / name).rmdir()
    (places / "compiled" / name).mkdir(parents=True)
    (places / "compiled" / name / "twice.nbi").write_bytes(b"code")
    assert not list(directory_of(places, monkeypatch, False).iterdir()), "taken on a processor that cannot run it"
    (places / "cache" / name).rmdir()
    taken = directory_of(places, monkeypatch, True)
    assert (taken / "twice.nbi").read_bytes() == b"code"
    assert [path.name for path in (places / "cache").iterdir()] == [name], "a temporary directory was left"
    (taken / "twice.nbi").write_bytes(b"newer")
    assert (directory_of(places, monkeypatch, True) / "twice.nbi").read_bytes() == b"newer"


def test_the_directory_of_another_process_that_was_first_is_kept(places, monkeypatch):
    name = directory_of(places, monkeypatch, False).name
    path = places / "cache" / name
    (path / "own.nbi").write_bytes(b"own")
    (places / "compiled" / name).mkdir(parents=True)
    monkeypatch.setattr(kernel_cache, "takes_shipped", lambda: True)
    kernel_cache._take_shipped(path)
    assert [found.name for found in path.iterdir()] == ["own.nbi"]
    assert [found.name for found in (places / "cache").iterdir()] == [name]


@pytest.mark.skipif(not all(HOST.get(name) for name in PORTABLE_NEEDS), reason="a processor without AVX2")
def test_a_kernel_compiled_for_the_portable_processor_is_loaded(places, monkeypatch):
    folder = places / "kernels"
    folder.mkdir()
    machine = {"NUMBA_CPU_NAME": PORTABLE[1], "NUMBA_CPU_FEATURES": PORTABLE[2], "PYTHONPATH": ":".join(sys.path)}
    subprocess.run([sys.executable, places / "twice.py", folder], check=True, env=machine, timeout=300)

    def misses(taken):
        monkeypatch.setattr(kd, "takes_shipped", lambda: taken)
        spec = spec_from_file_location("twice", places / "twice.py")
        module = module_from_spec(spec)
        module.FOLDER = str(folder)
        spec.loader.exec_module(module)
        assert module.twice(1.5) == 3.0
        return module.twice._cache_misses[(types.float64,)]

    assert misses(taken=True) == 0
    assert misses(taken=False) == 1
    assert misses(taken=False) == 0, "its own form was not cached beside the shipped one"


def test_the_wheel_is_compiled_for_the_processor_that_is_looked_for():
    script = (ROOT / ".ci/kernels").read_text(encoding="utf-8")
    assert f"NUMBA_CPU_NAME={PORTABLE[1]} NUMBA_CPU_FEATURES={PORTABLE[2]} " in script
    assert sys.platform != "linux" or not HOST.get("avx2") or HOST.keys() >= PORTABLE_NEEDS, "LLVM has other names"


def test_nothing_is_shipped_in_a_clone_or_for_a_processor_that_the_user_names(tmp_path, monkeypatch):
    kernel_cache.takes_shipped.cache_clear()
    assert not kernel_cache.takes_shipped()
    monkeypatch.setattr(kernel_cache, "SHIPPED", tmp_path)
    monkeypatch.setattr(kernel_cache.numba.config, "CPU_NAME", "generic")
    kernel_cache.takes_shipped.cache_clear()
    assert not kernel_cache.takes_shipped()
    kernel_cache.takes_shipped.cache_clear()
