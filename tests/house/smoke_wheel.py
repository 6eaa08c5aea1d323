"""Smoke test of an installed wheel: run it with the interpreter of a clean environment, outside the source tree."""

from __future__ import annotations

import pkgutil
import subprocess
import sys
import sysconfig
from importlib import import_module, metadata
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


def check_imports() -> int:
    """Every module imports, from site-packages; returns how many there are."""
    home = Path(sysconfig.get_path("purelib")).resolve()
    count = 0
    for layer in LAYERS:
        package = import_module(f"lanebound.{layer}")
        assert package.__file__ is not None
        assert home in Path(package.__file__).resolve().parents, f"{package.__file__} is not in {home}"
        for item in pkgutil.walk_packages(package.__path__, f"lanebound.{layer}."):
            import_module(item.name)
            count += 1
    return count


def check_presets() -> None:
    """Every packaged preset resolves to a configuration."""
    from lanebound.agents.cli.kinds import resolve
    from lanebound.integrity.core.presets import preset_names

    for name in preset_names():
        resolve(name)


def check_command_line() -> None:
    """The installed command answers."""
    command = Path(sys.executable).parent / "lanebound"
    answer = subprocess.run([str(command), "--version"], check=True, capture_output=True, text=True)
    assert answer.stdout.split() == ["lanebound", metadata.version("lanebound")]


if __name__ == "__main__":
    check_layout()
    modules = check_imports()
    check_presets()
    check_command_line()
    print(f"the wheel works: {modules} modules")
