"""Smoke test of an installed wheel: run it with the interpreter of a clean environment, outside the source tree.

``python smoke_wheel.py all`` tests a wheel with its extras, ``python smoke_wheel.py integrity`` one without any, where
no simulator and no learner may be installed. Without an argument what is installed decides.
"""

from __future__ import annotations

import pkgutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

LAYERS = ("agents", "configs", "envs", "integrity")


def installed_files() -> list[str]:
    """Paths of the distribution, relative to site-packages."""
    return [str(path) for path in metadata.files("lanebound") or ()]


def check_layout() -> None:
    """Every file lies below ``lanebound/``, which is a namespace without ``__init__.py``."""
    tops = {path.split("/")[0] for path in installed_files() if not path.startswith("..")}
    strangers = {top for top in tops if top != "lanebound" and not top.endswith(".dist-info")}
    assert not strangers, f"installed outside lanebound: {strangers}"
    assert "lanebound/__init__.py" not in installed_files()
    assert any(path.endswith("licenses/LICENSE") for path in installed_files())
    for layer in LAYERS:
        assert f"lanebound/{layer}/py.typed" in installed_files(), f"{layer} is installed without its types"


def check_imports(layers: Sequence[str]) -> int:
    """Every module imports, from site-packages; returns how many there are."""
    home = Path(sysconfig.get_path("purelib")).resolve()
    count = 0
    for layer in layers:
        package = import_module(f"lanebound.{layer}")
        assert package.__file__ is not None
        assert home in Path(package.__file__).resolve().parents, f"{package.__file__} is not in {home}"
        for item in pkgutil.walk_packages(package.__path__, f"lanebound.{layer}."):
            import_module(item.name)
            count += 1
    return count


def check_presets() -> None:
    """Every packaged preset resolves to a configuration."""
    from lanebound.agents.cli.listing import resolve
    from lanebound.integrity.core.presets import preset_names

    for name in preset_names():
        resolve(name)


def check_command_line() -> None:
    """The installed command answers."""
    command = Path(sys.executable).parent / "lanebound"
    answer = subprocess.run([str(command), "--version"], check=True, capture_output=True, text=True)
    assert answer.stdout.split() == ["lanebound", metadata.version("lanebound")]


def check_absence() -> None:
    """No package of the layers above the navigation layer is installed."""
    for name in ("gymnasium", "highway_env", "torch", "stable_baselines3", "typer"):
        assert find_spec(name) is None, f"{name} is installed"


def check_integrity_alone() -> None:
    """The navigation layer works without the packages of the layers above it, and the command names the extra."""
    import numpy as np

    from lanebound.integrity.core.streams import Streams
    from lanebound.integrity.motion.drive import CityDrive, DriveConfig
    from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
    from lanebound.integrity.sky.road import Road
    from lanebound.integrity.sky.track import SkyTrack
    from lanebound.integrity.sky.visibility import SkyMask

    config, road = NavigatorConfig(), Road.straight(800.0, heading_rad=0.6)
    navigator = Navigator(config, SkyTrack.from_config(config.sky, 600.0), SkyMask.open(), [1, 2])
    car, traffic = CityDrive(road, DriveConfig(), config.dt_s), Streams([1, 2])
    state = car.start(traffic)
    for _ in range(100):
        truth = car.step(state, traffic)
        solution = navigator.step(truth)
    error_m = np.linalg.norm(solution.position_en_m - truth.position_enu_m[:, :2], axis=-1)
    assert (error_m < np.hypot(solution.pl_at_m, solution.pl_ct_m)).all(), (error_m, solution.pl_at_m)
    command = Path(sys.executable).parent / "lanebound"
    answer = subprocess.run([str(command), "--version"], check=False, capture_output=True, text=True)
    assert "install lanebound with its extra 'agents'" in answer.stderr, answer.stderr


if __name__ == "__main__":
    part = sys.argv[1] if len(sys.argv) > 1 else "all" if find_spec("gymnasium") else "integrity"
    check_layout()
    if part == "integrity":
        if len(sys.argv) > 1:
            check_absence()
        modules = check_imports(["integrity", "configs"])
        check_integrity_alone()
    else:
        modules = check_imports(LAYERS)
        check_presets()
        check_command_line()
    print(f"the wheel works ({part}): {modules} modules")
