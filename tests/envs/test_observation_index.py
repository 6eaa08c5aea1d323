"""The published index: names, bounds, groups, and what each variant leaves out."""

from __future__ import annotations

import pytest

from lanebound.envs import EnvConfig
from lanebound.envs.observation import (
    GROUPS,
    OBSERVATION_INDEX,
    ObservationConfig,
    Observer,
    describe,
    entries,
    group_slices,
)
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.positioning.modes import Mode

VARIANTS = [
    ObservationConfig(),
    ObservationConfig(integrity="blind"),
    ObservationConfig(integrity="clock"),
    ObservationConfig(integrity="oracle", vehicles=0),
    ObservationConfig(preview_m=(), satellites_m=(), vehicles=1),
]


@pytest.mark.parametrize("config", VARIANTS)
def test_names_are_unique_and_groups_hang_together(config):
    index = entries(config)
    assert len({entry.column for entry in index}) == len(index)
    slices = group_slices(config)
    assert list(slices) == [group for group in GROUPS if group in {entry.group for entry in index}]
    assert [entry.group for entry in index] == [g for g, part in slices.items() for _ in range(part.stop - part.start)]


@pytest.mark.parametrize("config", VARIANTS)
def test_every_entry_says_what_it_is(config):
    for entry in entries(config):
        assert entry.meaning
        assert entry.scale > 0.0
        assert (entry.low, entry.high) in {(-1.0, 1.0), (0.0, 1.0)}


def test_sizes_of_the_default():
    sizes = {group: part.stop - part.start for group, part in group_slices(ObservationConfig()).items()}
    assert sizes == {"ego": 15, "integrity": 44, "road": 43, "traffic": 6 * 19}
    assert entries(ObservationConfig()) == OBSERVATION_INDEX


def test_blind_leaves_out_integrity_and_levels_and_nothing_else():
    full, blind = ({e.column for e in entries(ObservationConfig(integrity=i))} for i in ("full", "blind"))
    gone = full - blind
    assert blind < full
    assert {name for name in gone if name.startswith("traffic.")} == {name for name in full if "_pl_" in name} - {
        name for name in full if name.startswith("integrity.")
    }
    assert all(name.startswith("integrity.") or "_pl_" in name for name in gone)


def test_clock_adds_mode_and_age_of_rtk_to_blind_and_nothing_else():
    blind, clock = ({e.column for e in entries(ObservationConfig(integrity=i))} for i in ("blind", "clock"))
    modes = {f"integrity.mode_{mode.key}" for mode in Mode if mode <= Mode.CODE}  # services have entries where named
    assert clock - blind == modes | {"integrity.since_rtk"}
    assert blind < clock


def test_oracle_has_the_entries_of_full():
    assert entries(ObservationConfig(integrity="oracle")) == entries(ObservationConfig())


def test_the_table_has_a_line_for_each_entry():
    lines = describe().splitlines()
    assert len(lines) == 2 + len(OBSERVATION_INDEX)
    assert all(line.count("|") == 9 for line in lines)
    assert lines[2].startswith("| 0 | ego | 0 | speed | m/s | 40 | [-1, 1] |")
    assert lines[2 + 15].startswith("| 15 | integrity | 0 | pl_at | m | 10 | [0, 1] |")
    assert describe(ObservationConfig(integrity="blind")) != describe()


def test_the_space_follows_the_index():
    config = ObservationConfig(form="flat", history=3)
    space = Observer(config).space
    assert space.shape == (3 * len(entries(config)),)
    assert space.low.tolist() == [e.low for e in entries(config)] * 3
    assert Observer(ObservationConfig(vehicles=0)).space.keys() == {"ego", "integrity", "road"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"form": "table"}, "form"),
        ({"history": 0}, r"history must lie in \[1, 64\]"),
        ({"integrity": "none"}, "integrity"),
        ({"preview_m": (0.0, 5.0)}, "preview_m must be > 0 and ascend"),
        ({"preview_m": (10.0, 5.0)}, "preview_m must be > 0 and ascend"),
        ({"satellites_m": (-1.0,)}, "satellites_m must be >= 0 and ascend"),
        ({"vehicle": 6}, "vehicles"),
    ],
)
def test_a_mistaken_configuration_is_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        ObservationConfig.load(change)


def test_the_index_of_another_configuration_is_refused_with_the_way_to_its_own():
    config = EnvConfig(base="highway-v0", observation={"vehicles": 2})
    with pytest.raises(InputError, match=r"got EnvConfig: pass .* env\.unwrapped\.config\.observation$"):
        describe(config)  # type: ignore[arg-type]
    assert "v1_" in describe(config.observation)
    assert "v2_" not in describe(config.observation)
