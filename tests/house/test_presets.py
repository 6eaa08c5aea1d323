"""Presets: merging, extending, YAML's traps, overrides from text."""

from __future__ import annotations

import copy
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.core import presets
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import (
    deep_merge,
    load_file,
    load_preset,
    nearest,
    parse_assignments,
    parse_yaml,
    preset_names,
)

FILES = {
    "base.yaml": "kind: toy\nrisk: 1e-7\nrtk: {age_s: 30, bands: [1, 2]}\n",
    "city/dense.yaml": "extends: base\nrtk: {age_s: 20}\n",
    "city/night.yaml": "extends: [city/dense, calm]\nrtk: {bands: [3]}\n",
    "calm.yaml": "speed_mps: 5\n",
    "circle_a.yaml": "extends: circle_b\n",
    "circle_b.yaml": "extends: circle_a\n",
    "orphan.yaml": "extends: bse\n",
    "list.yaml": "- 1\n",
    "number.yaml": "extends: 5\n",
    "twice.yaml": "a: 1\na: 2\n",
    "broken.yaml": "a: [1\n",
    "notes.txt": "not a preset",
}


@pytest.fixture(autouse=True)
def _toy_presets(tmp_path, monkeypatch):
    package = tmp_path / "toy_presets"
    for name, text in {**FILES, "__init__.py": ""}.items():
        path = package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "toy_presets", raising=False)
    monkeypatch.setattr(presets, "PRESET_PACKAGE", "toy_presets")


def test_names_are_paths_without_suffix():
    assert preset_names() == sorted(name.removesuffix(".yaml") for name in FILES if name.endswith(".yaml"))


def test_extends_merges_parents_below_the_preset_and_overrides_on_top():
    assert load_preset("city/dense") == {"kind": "toy", "risk": 1e-7, "rtk": {"age_s": 20, "bands": [1, 2]}}
    night = load_preset("city/night", {"rtk": {"age_s": 1}})
    assert night == {"kind": "toy", "risk": 1e-7, "speed_mps": 5, "rtk": {"age_s": 1, "bands": [3]}}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("city/dnese", r"^preset 'city/dnese' is unknown: did you mean 'city/dense'\?$"),
        ("orphan", r"^preset 'bse' \(extended by 'orphan'\) is unknown: did you mean 'base'\?$"),
        ("circle_a", r"extends itself: circle_a -> circle_b -> circle_a: remove one 'extends'$"),
        ("list", r"^preset 'list' must be a mapping, got list: "),
        ("twice", r"^preset 'twice' is not valid YAML, got key 'a' twice in line 1"),
        ("number", r"^extends of preset 'number' must be a name or a list of names, got 5: correct it$"),
        ("broken", r"^preset 'broken' is not valid YAML, got "),
        ("../base", r"^preset '\.\./base' is unknown"),
    ],
)
def test_refusals(name, message):
    with pytest.raises(ConfigError, match=message):
        load_preset(name)


def test_a_model_builds_from_its_preset():
    class Rtk(Config):
        age_s: float = 1.0
        bands: tuple[int, ...] = ()

    class Toy(Config):
        risk: float = 0.5
        rtk: Rtk = Rtk()

    assert Toy.preset("city/dense", {"risk": 0.1}) == Toy(risk=0.1, rtk=Rtk(age_s=20.0, bands=(1, 2)))


def test_mappings_may_be_merged_within_a_file():
    text = "base: &base {age_s: 20, bands: [1]}\nother: {<<: *base, age_s: 30}\n"
    assert parse_yaml(text, "test")["other"] == {"age_s": 30, "bands": [1]}


@pytest.mark.parametrize(
    ("text", "value"), [("1e-7", 1e-7), ("-2.5E+3", -2500.0), (".5e1", 5.0), ("3", 3), ("1e", "1e"), ("e7", "e7")]
)
def test_numbers_in_scientific_notation_are_numbers(text, value):
    assert parse_yaml(text, "test") == value
    assert type(parse_yaml(text, "test")) is type(value)


def test_assignments_nest_and_merge():
    texts = ["rtk.age_s=20", "rtk.bands=[1, 2]", "risk = 1e-4", "name=a=b", "rtk.age_s=21"]
    wanted = {"rtk": {"age_s": 21, "bands": [1, 2]}, "risk": 1e-4, "name": "a=b"}
    assert parse_assignments(texts) == wanted


@pytest.mark.parametrize("name", ["city/dense", "dense"])
@pytest.mark.parametrize("backwards", [False, True])
def test_keys_apply_over_the_preset_that_is_named_beside_them(backwards, name):
    texts = [f"toy={name}", "toy.rtk.age_s=1"]
    wanted = {"toy": {"risk": 1e-7, "rtk": {"age_s": 1, "bands": [1, 2]}}}
    assert parse_assignments(texts[::-1] if backwards else texts) == wanted
    assert deep_merge({"toy": name}, {"toy": {"rtk": {"age_s": 1}}}) == wanted


@pytest.mark.parametrize("value", ["odometer_gyro", "3", "null", "no/preset"])
def test_keys_inside_other_values_are_refused(value):
    message = r"navigator must be a mapping or a preset's name where 'navigator\.dt_s' is set, got .*: set its keys"
    for texts in ([f"navigator={value}", "navigator.dt_s=0.2"], ["navigator.dt_s=0.2", f"navigator={value}"]):
        with pytest.raises(ConfigError, match=message):
            parse_assignments(texts)


@pytest.mark.parametrize("text", ["rtk.age_s", "=3", "rtk..age_s=1", ""])
def test_assignments_must_read_key_equals_value(text):
    with pytest.raises(ConfigError, match="an override must read key=value, got"):
        parse_assignments([text])


def test_an_assignment_that_is_no_text_is_refused():
    with pytest.raises(ConfigError, match="an override must be text, got 3: write"):
        parse_assignments([3])


def test_nearest_takes_any_key():
    assert nearest(1, ["10", "a"]) == "did you mean '10'?"


@pytest.mark.parametrize(
    ("word", "known", "advice"),
    [
        ("nope", ["np", "make"], "known are make, np"),  # half as long
        ("nonsense-v0", ["intersection-v0", "merge-v1"], "known are intersection-v0, merge-v1"),  # too few letters
        ("LaneKeeping", ["lanebound/LaneKeeping-v0", "x"], "did you mean 'lanebound/LaneKeeping-v0'?"),  # contained
        ("elevation_mask_deg", ["reflection_loss_db"], "known are reflection_loss_db"),  # of another meaning
        ("tyo", ["toy", "boy"], "did you mean 'toy'?"),
        ("LaneKeping", ["lanebound/LaneKeeping-v0", "lanebound/Merge-v0"], "did you mean 'lanebound/LaneKeeping-v0'?"),
        ("Merg-v0", ["lanebound/LaneKeeping-v0", "lanebound/Merge-v0"], "did you mean 'lanebound/Merge-v0'?"),
        ("highwy-v1", ["highway-v0", "highway-v1"], "did you mean 'highway-v1'?"),  # of the same version
        ("lanebound/Nothing-v0", ["lanebound/Merge-v0"], "known are lanebound/Merge-v0"),  # alike but for the name
    ],
)
def test_nearest_suggests_only_what_is_near(word, known, advice):
    assert nearest(word, known) == advice


def test_nearest_falls_back_to_the_list():
    assert nearest("zzz", ["b", "a"]) == "known are a, b"
    assert nearest("zzz", []) == "none are known"


TREES = st.recursive(
    st.integers() | st.none(), lambda inner: st.dictionaries(st.sampled_from("abc"), inner, max_size=3), max_leaves=8
)
MAPPINGS = st.dictionaries(st.sampled_from("abc"), TREES, max_size=3)


@given(MAPPINGS, MAPPINGS, MAPPINGS)
def test_merging_keeps_all_keys_and_changes_no_argument(a, b, c):
    before = copy.deepcopy((a, b, c))
    merged = deep_merge(a, b)
    assert deep_merge(a, {}) == a == deep_merge({}, a)
    assert deep_merge(merged, b) == merged
    assert set(deep_merge(merged, c)) == {*a, *b, *c}
    assert (a, b, c) == before


def test_a_merged_copy_shares_no_mapping():
    base = {"a": {"b": 1}}
    override = {"c": {"d": 2}}
    merged = deep_merge(base, override)
    merged["a"]["b"] = merged["c"]["d"] = 9
    assert (base, override) == ({"a": {"b": 1}}, {"c": {"d": 2}})


def test_a_file_of_ones_own_may_extend_packaged_presets(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: city/dense\nspeed_mps: 3\n", encoding="utf-8")
    assert load_file(path, "drive") == load_preset("city/dense", {"speed_mps": 3})


def test_files_of_ones_own_extend_each_other_from_where_they_are(tmp_path):
    (tmp_path / "deep").mkdir()
    (tmp_path / "mine.yaml").write_text("extends: [city/dense, deep/slow.yaml]\n", encoding="utf-8")
    (tmp_path / "deep" / "slow.yaml").write_text("extends: ../slower.yml\nspeed_mps: 3\n", encoding="utf-8")
    (tmp_path / "slower.yml").write_text("speed_mps: 2\nbrake_mps2: 1\n", encoding="utf-8")
    found = load_file(tmp_path / "mine.yaml", "drive")
    assert found == load_preset("city/dense", {"speed_mps": 3, "brake_mps2": 1})
    (tmp_path / "slower.yml").write_text("extends: deep/slow.yaml", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"slow.yaml' extends itself: .*mine.yaml -> .*slow.yaml -> .*slower"):
        load_file(tmp_path / "mine.yaml", "drive")
    (tmp_path / "slower.yml").unlink()
    with pytest.raises(
        ConfigError, match=r"^the base of .*slow.yaml must be a file that can be read, got .*slower.yml"
    ):
        load_file(tmp_path / "mine.yaml", "drive")


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (b"extends: bse", r"^preset 'bse' \(extended by '.*mine.yaml'\) is unknown: did you mean 'base'\?$"),
        (b"extends: 5", r"^extends of .*mine.yaml must be a name or a list of names, got 5: correct it$"),
        (b"- 1", r"mine.yaml must be a mapping, got list: write lines 'key: value'$"),
        (b"a: \xe9", r"^drive must be a text file in UTF-8, got .*mine.yaml with byte 0xe9 at 3: save it as UTF-8$"),
        (None, r"^drive must be a file that can be read, got .*mine.yaml .*: correct the path$"),
    ],
)
def test_a_file_that_cannot_be_read_or_extends_nothing_is_refused(tmp_path, written, message):
    if written is not None:
        (tmp_path / "mine.yaml").write_bytes(written)
    with pytest.raises(ConfigError, match=message):
        load_file(tmp_path / "mine.yaml", "drive")


@pytest.mark.parametrize(("name", "full"), [("dense", "city/dense"), ("night", "city/night"), ("base", "base")])
def test_the_folder_of_a_preset_may_be_left_out(name, full):
    assert load_preset(name) == load_preset(full)


def test_a_name_without_a_folder_must_be_the_only_one(tmp_path):
    other = tmp_path / "toy_presets" / "land" / "dense.yaml"
    other.parent.mkdir()
    other.write_text("kind: toy\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"^preset 'dense' is unknown"):
        load_preset("dense")
    assert load_preset("land/dense") == {"kind": "toy"}


def test_a_preset_that_extends_itself_by_its_short_name_is_refused(tmp_path):
    (tmp_path / "toy_presets" / "city" / "ring.yaml").write_text("extends: ring\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="extends itself"):
        load_preset("ring")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("envs: [LaneKeeping\nsky: open\n", "got '[' that is not closed in line 1, column 7: close it"),
        ("a: 1\nb: {c: 2\n", "got '{' that is not closed in line 2, column 4: close it"),
        ("a: 1\nb: 'open\n", 'got "\'" that is not closed in line 2, column 4: close it'),
        ('b: "open\n', "got '\"' that is not closed in line 1, column 4: close it"),
        ("a: 1\nb: 2: 3\n", "got mapping values are not allowed here in line 2, column 5: correct that line"),
    ],
)
def test_an_error_of_yaml_has_one_place(text, message):
    with pytest.raises(ConfigError) as refused:
        parse_yaml(text, "mine.yaml")
    assert str(refused.value) == f"mine.yaml is not valid YAML, {message}"
