"""Values of OpenStreetMap tags: the forms of the wiki, and what is none."""

from __future__ import annotations

import doctest

import pytest

from lanebound.integrity.sky.maps import tags


def test_examples() -> None:
    assert doctest.testmod(tags).failed == 0


@pytest.mark.parametrize(
    ("text", "metres"),
    [("12", 12.0), ("12.5 m", 12.5), ("12,5m", 12.5), ("40 ft", 12.192), ("7'4\"", 2.2352), ("7'", 2.1336)],
)
def test_lengths_in_all_forms_of_the_wiki(text: str, metres: float) -> None:
    assert tags.metres(text) == pytest.approx(metres, abs=1e-12)


@pytest.mark.parametrize("text", [None, "", "nan", "inf", "1e6", "1e400", "-3", "tall", "9" * 400, "٣", "12 km", "831"])
def test_what_is_no_height(text: str | None) -> None:
    assert tags.metres(text) is None


@pytest.mark.parametrize(
    ("given", "kmh", "tagged"),
    [
        ({"maxspeed": "30"}, 30.0, True),
        ({"maxspeed": "30 mph"}, 48.28032, True),
        ({"maxspeed": "DE:urban"}, 50.0, True),
        ({"maxspeed": "DE:zone:30"}, 30.0, True),
        ({"maxspeed": "DE:zone30"}, 30.0, True),
        ({"maxspeed": "walk"}, 7.0, True),
        ({"maxspeed": "signals", "highway": "residential"}, 50.0, False),
        ({"maxspeed": "0", "highway": "residential"}, 50.0, False),
        ({"maxspeed": "1e9", "highway": "motorway"}, 130.0, False),
        ({"highway": "living_street"}, 7.0, False),
    ],
)
def test_speed_limits(given: dict[str, str], kmh: float, tagged: bool) -> None:
    limit, known = tags.speed_mps(given)
    assert (3.6 * limit, known) == (pytest.approx(kmh, abs=1e-9), tagged)


@pytest.mark.parametrize(
    ("given", "lanes"),
    [
        ({}, (1, 1, False)),
        ({"oneway": "yes"}, (1, 0, False)),
        ({"oneway": "-1", "lanes": "2"}, (0, 2, True)),
        ({"junction": "roundabout", "lanes": "2"}, (2, 0, True)),
        ({"highway": "motorway"}, (1, 0, False)),
        ({"highway": "motorway", "oneway": "no"}, (1, 1, False)),
        ({"lanes": "4"}, (2, 2, True)),
        ({"lanes": "3"}, (1, 2, True)),
        ({"lanes": "3", "lanes:forward": "2"}, (2, 1, True)),
        ({"lanes": "3", "lanes:backward": "1"}, (2, 1, True)),
        ({"lanes": "1"}, (1, 1, True)),
        ({"lanes": "0"}, (1, 1, False)),
        ({"lanes": "99"}, (1, 1, False)),
        ({"lanes": "2;3"}, (1, 1, True)),
    ],
)
def test_lanes_of_both_directions(given: dict[str, str], lanes: tuple[int, int, bool]) -> None:
    assert tags.lanes(given) == lanes


@pytest.mark.parametrize(
    ("given", "closed"),
    [
        ({}, False),
        ({"access": "private"}, True),
        ({"access": "no", "motor_vehicle": "yes"}, False),
        ({"access": "yes", "motorcar": "no"}, True),
        ({"access": "destination"}, False),
    ],
)
def test_the_most_special_key_of_access_counts(given: dict[str, str], closed: bool) -> None:
    assert tags.no_motor_cars(given) == closed
