import functools
import math
import operator
import os
import shutil
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from lanebound.integrity.core import accel, kernel_cache


@pytest.fixture
def unwritable(tmp_path):
    """A path below a regular file: not even root can make it."""
    file = tmp_path / "file"
    file.write_text("")
    return file / "below"


def _run(code, **environment):
    """Run ``code`` in a new process without this one's cache settings; returns its standard output and error."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))} | environment
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def _run_kernel(code, **environment):
    """Run ``code`` and a small kernel in a new process; returns the cache directory."""
    code += (
        "\nfrom lanebound.integrity.core import accel"
        "\nfrom lanebound.integrity.core.angles_kernel import wrap"
        "\nfrom lanebound.integrity.core.kernel_cache import cache_root"
        "\nprint(cache_root(), wrap(7.0))"
    )
    directory, answer = _run(code, **environment)[0].split()
    assert float(answer) == pytest.approx(7.0 - 2.0 * math.pi, abs=1e-12)
    return directory


def test_an_unwritable_cache_falls_back_to_the_temporary_directory(unwritable, tmp_path):
    (tmp_path / "tmp").mkdir()
    nowhere = str(unwritable)
    directory = _run_kernel(
        "", HOME=nowhere, NUMBA_CACHE_DIR=nowhere, XDG_CACHE_HOME=nowhere, TMPDIR=str(tmp_path / "tmp")
    )
    assert directory.startswith(str(tmp_path / "tmp" / f"lanebound-{os.getuid()}"))
    assert list((tmp_path / "tmp").rglob("*.nbi")), "the kernel was not cached in the fallback"


@pytest.fixture
def only_temporary(monkeypatch, unwritable, tmp_path):
    """A temporary directory, and no other place for the cache; returns this user's directory in it."""
    shared = tmp_path / "tmp"
    shared.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(unwritable))
    monkeypatch.setattr(kernel_cache.tempfile, "tempdir", str(shared))
    monkeypatch.setattr(kernel_cache.atexit, "register", lambda function: function)
    return shared / f"lanebound-{os.getuid()}"


def test_the_shared_fallback_is_private_and_used_again(only_temporary):
    first = kernel_cache.cache_root.__wrapped__()
    assert first == only_temporary
    assert stat.S_IMODE(only_temporary.lstat().st_mode) == 0o700
    assert kernel_cache.cache_root.__wrapped__() == first


def _open_to_others(path, elsewhere):
    path.mkdir()
    path.chmod(0o770)


def _readable_by_others(path, elsewhere):
    path.mkdir()
    path.chmod(0o755)


def _a_link(path, elsewhere):
    elsewhere.mkdir(mode=0o700)
    path.symlink_to(elsewhere)


def _a_file(path, elsewhere):
    path.write_text("")


@pytest.mark.parametrize("trap", [_open_to_others, _readable_by_others, _a_link, _a_file])
def test_a_directory_that_others_could_fill_is_not_used(trap, only_temporary, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    trap(only_temporary, elsewhere)
    chosen = kernel_cache.cache_root.__wrapped__()
    assert chosen != only_temporary
    assert chosen.parent == only_temporary.parent
    assert stat.S_IMODE(chosen.lstat().st_mode) == 0o700
    assert not elsewhere.exists() or not any(elsewhere.iterdir())
    assert kernel_cache.cache_root.__wrapped__() != chosen, "each process has a directory of its own"


def test_a_directory_of_another_user_is_not_used(only_temporary, monkeypatch):
    only_temporary.mkdir(mode=0o700)
    me = os.getuid()
    monkeypatch.setattr(kernel_cache, "_user", lambda: me + 1)
    only_temporary.rename(only_temporary.with_name(f"lanebound-{me + 1}"))
    assert kernel_cache.cache_root.__wrapped__().name != f"lanebound-{me + 1}"


def test_the_fresh_directory_goes_with_its_process(unwritable, tmp_path):
    shared = tmp_path / "tmp"
    shared.mkdir()
    (shared / f"lanebound-{os.getuid()}").write_text("")
    nowhere = str(unwritable)
    directory = _run_kernel("", HOME=nowhere, NUMBA_CACHE_DIR=nowhere, TMPDIR=str(shared))
    assert Path(directory).parent == shared
    assert not Path(directory).exists()


def test_without_any_writable_directory_kernels_still_run(unwritable):
    nowhere = str(unwritable)
    code = f"import tempfile; tempfile.tempdir = {nowhere!r}"  # TMPDIR alone would fall back to /tmp
    assert _run_kernel(code, HOME=nowhere, NUMBA_CACHE_DIR=nowhere, TMPDIR=nowhere) == "None"


def test_neither_a_home_nor_a_temporary_directory_is_needed(monkeypatch):
    def no_home(self):
        raise RuntimeError("Could not determine home directory.")

    def no_temporary_directory():
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(kernel_cache.Path, "expanduser", no_home)
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", no_temporary_directory)
    assert kernel_cache.cache_root.__wrapped__() is None


@pytest.mark.parametrize("variables", [("NUMBA_CACHE_DIR",), ("XDG_CACHE_HOME",), ("HOME",)])
def test_the_directory_follows_the_environment(variables, monkeypatch, tmp_path):
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    for name in variables:
        monkeypatch.setenv(name, str(tmp_path))
    parent = tmp_path / ".cache" if variables == ("HOME",) else tmp_path
    assert kernel_cache.cache_root.__wrapped__() == parent / "lanebound"


@pytest.fixture
def package(monkeypatch, tmp_path):
    """A package of two layers and its kernels; returns a function that gives a kernel's directory."""
    for folder in ("integrity/core", "envs"):
        (tmp_path / folder).mkdir(parents=True)
    files = {
        "integrity/core/sum_kernel.py": "A = 1\n",
        "integrity/core/far_kernel.py": "B = 1\n",
        "integrity/core/constants.py": "C = 1\n",
        "envs/step_kernel.py": "from lanebound.integrity.core.sum_kernel import (\n    A,\n)\n"
        "from lanebound.integrity.core import constants\nfrom numpy import pi\n",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(kernel_cache, "__file__", str(tmp_path / "integrity/core/kernel_cache.py"))
    monkeypatch.setattr(kernel_cache, "cache_root", lambda: tmp_path)

    def forget():
        for remembered in (
            kernel_cache.sources_of,
            kernel_cache._imports,
            kernel_cache._bytes,
            kernel_cache._named_tuples,
        ):
            remembered.cache_clear()

    def directory(name):
        forget()
        return kernel_cache.cache_directory(tmp_path / name)

    yield tmp_path, directory
    forget()


def test_the_directory_changes_with_the_sources_of_a_kernel_and_no_other(package):
    root, directory = package
    first = directory("envs/step_kernel.py")
    for name, changes in (("sum_kernel", True), ("far_kernel", False), ("constants", True)):
        (root / f"integrity/core/{name}.py").write_text("A = 2\n")
        found = directory("envs/step_kernel.py")
        assert (found != first) == changes, name
        first = found
    (root / "envs/step_kernel.py").write_text("D = 1\n")
    assert directory("envs/step_kernel.py") != first


def test_the_directory_changes_with_the_fields_of_any_named_tuple(package):
    root, directory = package
    before = directory("envs/step_kernel.py")
    (root / "integrity/core/far_kernel.py").write_text("class Pose(NamedTuple):\n    x: int\n    y: int\n")
    first = directory("envs/step_kernel.py")
    (root / "integrity/core/far_kernel.py").write_text("class Pose(NamedTuple):\n    y: int\n    x: int\n")
    assert len({before, first, directory("envs/step_kernel.py")}) == 3


def test_an_installation_without_environments_has_kernels_of_its_own(package, monkeypatch):
    _, directory = package
    first = directory("envs/step_kernel.py")
    monkeypatch.setattr(kernel_cache, "_importable", lambda: (False, False))
    assert directory("envs/step_kernel.py") != first


def test_copies_of_the_package_share_their_kernels(package, tmp_path, monkeypatch):
    root, directory = package
    first = directory("envs/step_kernel.py")
    copy = tmp_path / "copy"
    shutil.copytree(root, copy, ignore=shutil.ignore_patterns("copy", "kernels-*"))
    monkeypatch.setattr(kernel_cache, "__file__", str(copy / "integrity/core/kernel_cache.py"))
    assert directory("copy/envs/step_kernel.py") == first


def _divide(a, b):
    return a / b, math.isnan(a / b), math.isinf(a / b)


def test_kernels_divide_as_c_does_and_keep_nan_and_inf():
    fast = accel.jit(_divide)
    assert fast(1.0, 0.0) == (math.inf, False, True)
    assert fast(-1.0, 0.0) == (-math.inf, False, True)
    quotient, is_nan, is_inf = fast(0.0, 0.0)
    assert math.isnan(quotient)
    assert (is_nan, is_inf) == (True, False)


def test_the_global_cache_setting_is_left_as_it_was():
    before = numba.config.CACHE_DIR
    accel.jit(_divide)
    assert before == numba.config.CACHE_DIR


def test_a_function_without_a_file_is_compiled_in_memory():
    scope = {}
    exec("def double(x):\n    return 2.0 * x", scope)
    assert accel.jit(scope["double"])(1.5) == 3.0


def test_options_reach_numba_in_both_decorator_forms():
    assert accel.jit(_divide).targetoptions["nogil"]
    options = accel.jit(inline=True)(_divide).targetoptions
    assert options["nogil"]
    assert options["inline"] == "always"
    assert not {"nnan", "ninf", "fast"} & set(options["fastmath"])


@pytest.fixture
def four_threads(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 4)


def test_threads_serve_only_large_batches_of_the_main_process(four_threads, monkeypatch):
    assert [accel.thread_count(pieces) for pieces in (0, 1, 2, 1000)] == [1, 1, 4, 4]
    with accel.serial():
        assert accel.thread_count(1000) == 1
    assert accel.thread_count(1000) == 4
    monkeypatch.setattr("multiprocessing.parent_process", lambda: object())
    assert accel.thread_count(1000) == 1


def test_one_processor_is_no_reason_for_threads(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)
    assert accel.thread_count(1000) == 1


@pytest.mark.parametrize("rows", [0, 1, 15, 16, 17, 100, 1001])
def test_every_row_is_worked_on_once_whatever_the_number_of_threads(four_threads, rows):
    done, callers = np.zeros(rows, dtype=np.int64), set()

    def kernel(first, last, by):
        done[first:last] += by
        callers.add(threading.current_thread().name)

    accel.run_rows(kernel, rows, 3, row_us=10.0)
    assert (done == 3).all()
    if rows < 16:
        assert callers == {threading.current_thread().name}


def test_threads_share_the_work(four_threads):
    meeting = threading.Barrier(4, timeout=600.0)  # only four threads at once get past it

    def kernel(first, last):
        if not met.is_set():
            meeting.wait()
            met.set()

    met = threading.Event()
    accel.run_rows(kernel, 128, row_us=100.0)
    assert met.is_set()


def test_an_error_in_any_thread_is_raised_and_the_threads_go_on(four_threads):
    def kernel(first, last):
        if last == 128:
            raise ValueError("the last piece")

    for _ in range(3):
        with pytest.raises(ValueError, match="the last piece"):
            accel.run_rows(kernel, 128, row_us=100.0)
    test_every_row_is_worked_on_once_whatever_the_number_of_threads(four_threads, 1001)


def test_a_forked_process_has_threads_of_its_own(four_threads):
    accel.run_rows(lambda first, last: None, 128, row_us=100.0)
    child = os.fork() if hasattr(os, "fork") else None
    if child is None:
        pytest.skip("this system forks no processes")
    if child == 0:
        rows = []
        accel.run_rows(lambda first, last: rows.append(last - first), 128, row_us=100.0)
        os._exit(0 if sum(rows) == 128 else 1)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_idle_threads_use_no_processor(four_threads):
    accel.run_rows(lambda first, last: None, 128, row_us=100.0)
    before, start = time.process_time(), time.monotonic()
    time.sleep(0.5)
    assert time.process_time() - before < 0.2 * (time.monotonic() - start)


def test_a_compiled_sum_keeps_its_order_to_the_last_bit():
    @accel.jit
    def total(x):
        s = 0.0
        for v in x:
            s += v
        return s

    x = np.linspace(-1.0, 3.0, 1001)
    assert total(x) == functools.reduce(operator.add, x.tolist(), 0.0)


def test_kernels_of_versions_that_nobody_has_used_for_a_month_are_removed(only_temporary, monkeypatch, tmp_path):
    only_temporary.mkdir(mode=0o700)
    old, young, other = (only_temporary / name for name in ("kernels-old", "kernels-young", "notes"))
    for folder, days in ((old, 31), (young, 29), (other, 99)):
        folder.mkdir()
        (folder / "file").write_text("")
        then = time.time() - days * 86400.0
        os.utime(folder, (then, then))
    source = tmp_path / "one_kernel.py"
    source.write_text("A = 1\n")
    monkeypatch.setattr(kernel_cache, "cache_root", kernel_cache.cache_root.__wrapped__)
    assert Path(kernel_cache.cache_directory(source)).parent == only_temporary
    assert not old.exists()
    assert young.exists()
    assert other.exists()
    then = time.time() - 31 * 86400.0
    os.utime(young, (then, then))
    kernel_cache.cache_directory(source)  # one that is there already: nothing is looked for
    assert young.exists()


NOTICE = """
from lanebound.integrity.core import accel
accel.NOTICE_S = {threshold_s}
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.positioning.heading_kernel import doppler_heading_variance
print(wrap(7.0), doppler_heading_variance(3.0, 4.0, 1.0, 0.0, 1.0))
"""


def test_only_a_process_that_compiles_for_longer_than_the_threshold_logs_one_line(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "short")}
    assert _run(NOTICE.format(threshold_s=600.0), **cache)[1] == ""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "long")}
    answers, message = _run(NOTICE.format(threshold_s=1e-6), **cache)
    assert message == "lanebound: compiling kernels, once for this version. This takes some minutes.\n"
    assert list((tmp_path / "long").rglob("*.nbi"))
    assert _run(NOTICE.format(threshold_s=1e-6), **cache) == (answers, ""), "kernels of the cache are not compiled"


def test_a_process_without_a_cache_logs_how_to_have_one(unwritable):
    nowhere = str(unwritable)
    code = f"import tempfile; tempfile.tempdir = {nowhere!r}" + NOTICE.format(threshold_s=1e-6)
    _, message = _run(code, HOME=nowhere, NUMBA_CACHE_DIR=nowhere, TMPDIR=nowhere)
    assert message.splitlines() == [
        "lanebound: compiling kernels, in every process: set NUMBA_CACHE_DIR to a folder. This takes some minutes."
    ]
