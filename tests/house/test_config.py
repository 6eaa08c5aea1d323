"""Typed configuration: what is taken, what is refused and in which words, and what comes back."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Mapping
from enum import Enum, IntEnum
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field, describe, unit_of
from lanebound.integrity.core.errors import ConfigError


class Grade(Enum):
    CONSUMER = "consumer"
    TACTICAL = "tactical"


class Clock(Config):
    drift_mps: float = Field(0.1, ge=0, description="drift of the clock [m/s]; source")
    risk: float = Field(1e-6, gt=0, lt=1, description="integrity risk [-]; source")
    channels: int = Field(12, ge=1)
    enabled: bool = True


class Receiver(Config):
    clock: Clock = Clock()
    spare: Clock | None = None
    others: tuple[Clock, ...] = ()
    named: dict[str, Clock] = Field({})
    weights: tuple[float, float] = (1.0, 2.0)
    grade: Grade = Grade.CONSUMER
    limit_m: float | None = Field(None, gt=0)


class Window(Config):
    start_s: float = 0.0
    end_s: float = Field(...)

    @model_validator(mode="after")
    def _in_order(self) -> Window:
        if self.end_s <= self.start_s:
            raise ValueError(f"end_s must be > start_s = {self.start_s}, got {self.end_s}: swap them")
        return self


def refusal(data: dict, path: str = "", model: type[Config] = Receiver) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        model.load(data, path)
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (
            {"clock": {"risk": 1.5}},
            "clock.risk must lie in (0, 1), got 1.5: correct that value (the default is 1e-06)",
        ),
        (
            {"clock": {"drift_mps": -1}},
            "clock.drift_mps must be >= 0, got -1: correct that value (the default is 0.1)",
        ),
        (
            {"clock": {"drift_mps": math.inf}},
            "clock.drift_mps must be finite, got inf: correct that value (the default is 0.1)",
        ),
        ({"clock": {"drift_mps": "3"}}, "clock.drift_mps must be a number, got '3': write the number without quotes"),
        ({"clock": {"channels": "nan"}}, "clock.channels must be an integer, got 'nan': give a number"),
        ({"clock": {"drift_mps": "three"}}, "clock.drift_mps must be a number, got 'three': give a number"),
        ({"weights": 1}, "weights must be a list, got 1: write [1]"),
        ({"clock": {"drift_mps": True}}, "clock.drift_mps must be a number, got True: give a number"),
        ({"clock": {"channels": True}}, "clock.channels must be an integer, got True: give a number"),
        (
            {"clock": {"channels": 2.5}},
            "clock.channels must be an integer, got 2.5: correct that value (the default is 12)",
        ),
        (
            {"clock": {"enabled": 1}},
            "clock.enabled must be true or false, got 1: correct that value (the default is True)",
        ),
        (
            {"clock": {"enabled": "yes"}},
            "clock.enabled must be true or false, got 'yes': correct that value (the default is True)",
        ),
        ({"clock": {"drfit_mps": 1}}, "clock.drfit_mps is not a known key: did you mean 'clock.drift_mps'?"),
        ({"colck": {}}, "colck is not a known key: did you mean 'clock'?"),
        (
            {"spare": {"q": 1}},
            "spare.q is not a known key: known are channels, drift_mps, enabled, risk",
        ),
        ({"others": [{}, {"chanels": 3}]}, "others.1.chanels is not a known key: did you mean 'others.1.channels'?"),
        (
            {"named": {"left": {"risk": 0}}},
            "named.left.risk must lie in (0, 1), got 0: correct that value (the default is 1e-06)",
        ),
        ({"weights": [1, "2"]}, "weights must be a number, got [1, '2']: give a number"),
        ({"weights": [1]}, "weights.1 is required, got nothing: add it"),
        (
            {"grade": "tactcal"},
            "grade must be one of 'consumer' or 'tactical', got 'tactcal': did you mean 'tactical'?",
        ),
        ({"limit_m": -2}, "limit_m must be > 0, got -2: correct that value"),
        ({"clock": 3}, "clock must be a mapping, got 3: write keys and values"),
    ],
)  # fmt: skip
def test_refusals_name_path_bound_value_and_remedy(data, line):
    assert refusal(data) == [line]


def test_every_problem_has_its_line_below_the_given_path():
    lines = refusal({"clock": {"risk": 2, "channels": 0}, "x": 1}, "navigator.gnss")
    assert [line.split()[0] for line in lines] == [
        "navigator.gnss.clock.risk",
        "navigator.gnss.clock.channels",
        "navigator.gnss.x",
    ]


def test_long_values_are_cut():
    assert len(refusal({"limit_m": "9" * 500})[0]) < 150


def test_required_key_and_rule_between_keys():
    assert refusal({}, model=Window) == ["end_s is required, got nothing: add it"]
    assert refusal({"end_s": -1.0}, "drive", Window) == ["drive.end_s must be > start_s = 0.0, got -1.0: swap them"]


def test_direct_construction_refuses_in_the_same_words():
    with pytest.raises(ConfigError, match=r"^clock\.risk must lie in \(0, 1\), got 7: "):
        Receiver(clock={"risk": 7})
    with pytest.raises(ConfigError, match=r"^risk must lie in \(0, 1\), got 7: "):
        Receiver(clock=Clock(risk=7))


def test_the_name_of_a_preset_is_no_data():
    with pytest.raises(ConfigError, match=r"^Clock must be a mapping, got 'a/b': write Clock\.preset\('a/b'\)$"):
        Clock.build("a/b")


def test_data_must_be_a_mapping():
    with pytest.raises(ConfigError, match=r"^gnss must be a mapping, got \[1\]: "):
        Receiver.load([1], "gnss")


def test_defaults_are_checked_too():
    class Wrong(Config):
        rate_hz: float = Field(-1.0, gt=0)

    with pytest.raises(ConfigError, match=r"rate_hz must be > 0"):
        Wrong()


def test_yaml_types_are_taken():
    config = Receiver.load({"clock": {"drift_mps": 3}, "weights": [3, 4], "grade": "tactical", "limit_m": None})
    assert isinstance(config.clock.drift_mps, float)
    assert (config.clock.drift_mps, config.weights, config.grade) == (3.0, (3.0, 4.0), Grade.TACTICAL)


def test_frozen():
    with pytest.raises(ValueError, match="frozen"):
        Clock().channels = 3


def test_build_merges_deeply_and_leaves_its_arguments_alone():
    data = {"clock": {"risk": 1e-3, "channels": 4}}
    config = Receiver.build(data, {"clock": {"channels": 5}})
    assert (config.clock.risk, config.clock.channels) == (1e-3, 5)
    assert data == {"clock": {"risk": 1e-3, "channels": 4}}
    assert Receiver.build(config, {"limit_m": 2}).clock == config.clock
    assert Receiver.build() == Receiver()


def test_replace_is_checked():
    config = Receiver(spare=Clock(channels=3))
    assert config.replace(spare={"risk": 0.5}).spare == Clock(channels=3, risk=0.5)
    assert config.replace(grade=Grade.TACTICAL).grade is Grade.TACTICAL
    with pytest.raises(ConfigError, match=r"spare\.risk"):
        config.replace(spare={"risk": 2})


def test_hash_and_pickle():
    config = Receiver(others=(Clock(channels=3),), named={"left": Clock()})
    assert pickle.loads(pickle.dumps(config)) == config
    assert hash(Clock(channels=3)) == hash(Clock(channels=3)) != hash(Clock(channels=4))


@given(
    risk=st.floats(0, 1, exclude_min=True, exclude_max=True),
    channels=st.integers(1, 2**60),
    weights=st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 2),
    grade=st.sampled_from(Grade),
    others=st.lists(st.integers(1, 9), max_size=3),
)
def test_json_round_trip(risk, channels, weights, grade, others):
    config = Receiver(
        clock=Clock(risk=risk, channels=channels),
        weights=weights,
        grade=grade,
        others=tuple(Clock(channels=n) for n in others),
        named={"a": Clock()},
    )
    assert Receiver.from_json(config.to_json()) == config
    assert Receiver.load(json.loads(json.dumps(config.to_dict()))) == config


def test_broken_json_is_refused():
    with pytest.raises(ConfigError, match=r"^Clock must be given as JSON, got .*: correct the text$"):
        Clock.from_json('{"risk": 0.1')


def test_describe_gives_path_value_unit_and_meaning():
    rows = describe(Receiver(others=(Clock(channels=3),), named={"left": Clock()}))
    by_path = {row.path: row for row in rows}
    assert by_path["clock.drift_mps"] == ("clock.drift_mps", 0.1, "m/s", "drift of the clock; source")
    assert by_path["clock.risk"].unit == ""
    assert by_path["limit_m"] == ("limit_m", None, "m", "")
    assert by_path["others.0.channels"].value == 3
    assert "named.left.risk" in by_path
    assert rows[0].path == "clock.drift_mps"
    assert describe(Clock(), "gnss.clock")[0].path == "gnss.clock.drift_mps"


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("pl_at_m", "m"),
        ("delay_s", "s"),
        ("mask_deg", "deg"),
        ("speed_mps", "m/s"),
        ("rate_hz", "Hz"),
        ("drop_db", "dB"),
        ("cn0_min_dbhz", "dB-Hz"),
        ("bias_radps", "rad/s"),
        ("acceleration_mps2", "m/s^2"),
        ("scale_ppm", "ppm"),
        ("faults_per_h", "1/h"),
        ("drift_mps_per_s", "m/s/s"),
        ("noise_radps_per_sqrt_hz", "rad/s/sqrt(Hz)"),
        ("risk", ""),
        ("m", ""),
        ("max_candidates", ""),
    ],
)
def test_unit_of(name, unit):
    assert unit_of(name) == unit


def test_equal_configurations_hash_alike_and_carry_no_hash_into_another_process():
    one, other = Clock(), Clock()
    assert hash(one) == hash(other)
    assert one == other
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert "_hash" not in vars(again)
    assert len({one, other, again}) == 1


def test_a_file_and_the_keys_in_it_are_told_apart():
    lines = refusal({"clock": {"drfit_mps": 1, "channels": 0}}, "my/sky.yaml")
    assert sorted(line.partition(" must")[0] for line in lines) == [
        "my/sky.yaml: clock.channels",
        "my/sky.yaml: clock.drfit_mps is not a known key: did you mean 'clock.drift_mps'?",
    ]


class Kind(IntEnum):
    GPS = 0
    GALILEO = 1


class Ruled(Config):
    kind: Kind = Kind.GPS
    rate_hz: int = 10

    @model_validator(mode="after")
    def _divides(self) -> Ruled:
        if 20 % self.rate_hz:
            raise ConfigError(f"rate_hz must divide 20, got {self.rate_hz}: choose a divisor")
        if self.kind is Kind.GALILEO:
            raise ConfigError("today is no day for that: wait")
        return self


class Around(Config):
    inner: Ruled = Ruled()


def test_a_rule_between_keys_names_the_whole_path_of_a_key():
    assert refusal({"rate_hz": 3}, model=Ruled) == ["rate_hz must divide 20, got 3: choose a divisor"]
    assert refusal({"inner": {"rate_hz": 3}}, model=Around) == ["inner.rate_hz must divide 20, got 3: choose a divisor"]
    assert refusal({"inner": {"kind": 1}}, model=Around) == ["inner: today is no day for that: wait"]


def test_enums_of_numbers_are_shown_with_their_names():
    (line,) = refusal({"inner": {"kind": 9}}, model=Around)
    assert line.startswith("inner.kind must be one of 0 (GPS), 1 (GALILEO), got 9")


class Wide(Config):
    inner: Ruled = Ruled(rate_hz=5)
    listed: tuple[int, ...] = (1, 2)


def test_a_mapping_changes_only_its_own_keys_of_the_default_of_a_field():
    assert Wide.load({"inner": {"kind": 0}}).inner.rate_hz == 5
    assert Wide.load({"inner": {"rate_hz": 4}}).inner == Ruled(rate_hz=4)
    assert Wide.load({"inner": Ruled()}).inner.rate_hz == 10  # a whole configuration replaces it
    assert refusal({"inner": {"rate_hz": 3}}, model=Wide) == ["inner.rate_hz must divide 20, got 3: choose a divisor"]


class Free(Config):
    """A configuration with data that other code checks."""

    navigator: Mapping[str, Any] = Field({})


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_plain_data_that_json_would_turn_into_none_are_refused_with_their_path(bad: float) -> None:
    data = {"gnss": {"near_objects": {"code_m": bad}}, "rates": [1.0]}
    line = f"navigator.gnss.near_objects.code_m must be finite, got {bad}: correct that value"
    with pytest.raises(ConfigError) as refused:
        Free(navigator=data)
    assert str(refused.value) == line
    with pytest.raises(ConfigError, match=rf"^config\.navigator\.rates\.1 must be finite, got {bad}: "):
        Free.load({"navigator": {"rates": [1.0, bad]}}, "config")
