"""No test sees what another one registers or withdraws."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import gymnasium
import pytest

from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from registries import PLUGINS, TABLES, as_in_the_package

NAMES = sorted(path.stem for path in PLUGINS.glob("*.py"))


@pytest.mark.parametrize("order", [NAMES, NAMES[::-1]], ids=["forwards", "backwards"])
def test_tables_are_as_in_the_package_after_all_plug_ins_and_a_withdrawal(order: list[str], tmp_path: Path) -> None:
    before = [list(table) for table in TABLES]
    ids = set(gymnasium.registry)
    for _ in range(2):  # the second time the modules are imported anew, which registers again
        with as_in_the_package(tmp_path):
            for name in order:
                importlib.import_module(name)
            changed = [list(table) != kept for table, kept in zip(TABLES, before, strict=True)]
            assert sum(changed) >= 10
            assert set(gymnasium.registry) > ids
        assert [list(table) for table in TABLES] == before
        assert set(gymnasium.registry) == ids
        assert not sys.modules.keys() & set(NAMES)
        assert not hasattr(AlertReason, "INTERFERENCE")
    with as_in_the_package(tmp_path):
        AlertReason.withdraw(list(AlertReason.members)[-1])
        Mode.members.clear()
    assert [list(table) for table in TABLES] == before
    assert all(getattr(AlertReason, name) is reason for name, reason in AlertReason.members.items())


def test_modules_of_a_temporary_folder_are_forgotten(tmp_path: Path) -> None:
    (tmp_path / "passing_by.py").write_text("", encoding="utf-8")
    with as_in_the_package(tmp_path):
        sys.path.append(str(tmp_path))
        importlib.import_module("passing_by")
    assert "passing_by" not in sys.modules
    assert str(tmp_path) not in sys.path
