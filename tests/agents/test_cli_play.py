"""``lanebound play``: keys become actions, and where no window can be seen it says so."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.drivers.keyboard import PEDAL, STEER_MAX, Key, KeyboardDriver
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.play import Closed, hand_over, play

GIVEN = {"navigation": {"source": "perfect"}, "sky": "open", "policy_hz": 10}


@pytest.fixture(scope="module")
def steered() -> KeyboardDriver:
    return KeyboardDriver(open_env("LaneKeeping", GIVEN))


@pytest.fixture(scope="module")
def chosen() -> KeyboardDriver:
    return KeyboardDriver(open_env("UrbanCanyon", GIVEN))


def act(driver: KeyboardDriver) -> np.ndarray:
    return np.asarray(driver.predict(None)[0])


def test_arrows_are_pedals_and_a_wheel_that_springs_back(steered):
    steered.reset()
    hand_over([("down", "up"), ("down", "right")], steered)
    turning = [act(steered) for _ in range(8)]
    assert all(action[0] == pytest.approx(PEDAL) for action in turning)
    wheel = [float(action[1]) for action in turning]
    assert wheel == sorted(wheel)
    assert wheel[0] < 0.5 * STEER_MAX
    assert wheel[-1] == pytest.approx(STEER_MAX)
    hand_over([("up", "up"), ("up", "right"), ("down", "down")], steered)
    back = [act(steered) for _ in range(8)]
    assert all(action[0] == pytest.approx(-PEDAL) for action in back)
    assert back[-1][1] == pytest.approx(0.0, abs=1e-6)


def test_a_tap_between_two_decisions_counts(steered):
    steered.reset()
    hand_over([("down", "left"), ("up", "left")], steered)
    assert act(steered)[1] < 0.0


def test_actions_lie_in_the_space(steered):
    steered.reset()
    hand_over([("down", "down"), ("down", "left")], steered)
    space = open_env("LaneKeeping", GIVEN).action_space
    assert all(space.contains(steered.predict(None)[0]) for _ in range(10))


def test_a_racetrack_has_a_wheel_alone():
    driver = KeyboardDriver(open_env("Racetrack", GIVEN))
    driver.press(Key.UP)
    driver.press(Key.RIGHT)
    assert act(driver).shape == (1,)
    assert act(driver)[0] > 0.0


def test_each_press_is_one_meta_action_in_its_turn(chosen):
    chosen.reset()
    hand_over([("down", "left"), ("up", "left"), ("down", "up"), ("down", "x")], chosen)
    labels = open_env("UrbanCanyon", GIVEN).world.action_type.actions
    assert [labels[int(act(chosen))] for _ in range(3)] == ["LANE_LEFT", "FASTER", "IDLE"]


def test_an_intersection_has_no_lanes_to_change():
    driver = KeyboardDriver(open_env("Intersection", GIVEN))
    driver.press(Key.LEFT)
    driver.press(Key.DOWN)
    labels = open_env("Intersection", GIVEN).world.action_type.actions
    assert [labels[int(act(driver))] for _ in range(2)] == ["SLOWER", "IDLE"]


@pytest.mark.parametrize("event", [("close", ""), ("down", "q"), ("down", "escape")])
def test_leaving(event, chosen):
    with pytest.raises(Closed):
        hand_over([event], chosen)


def test_again(chosen):
    assert hand_over([("down", "r")], chosen) is True
    assert hand_over([("up", "r"), ("down", "up")], chosen) is False


class Player:
    """Presses keys as the drive goes: R in the fifth step, Q in the third of the next episode."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int, int]] = []

    def note(self, moment):
        import pygame

        self.seen.append((moment.episode, moment.seed, moment.step))
        key = {(0, 5): pygame.K_r, (1, 3): pygame.K_q}.get((moment.episode, moment.step))
        if key is not None:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


def test_a_game_from_window_to_window(steered):
    player = Player()
    assert play(open_env("LaneKeeping", GIVEN, "human"), 4, [player]) == 2
    assert player.seen == [(0, 4, step) for step in range(6)] + [(1, 5, step) for step in range(4)]


def test_without_a_display_it_says_what_to_do_instead():
    result = CliRunner().invoke(app, ["play", "LaneKeeping", "--set", "navigation.source=perfect"])
    assert result.exit_code == 2
    assert result.stderr.startswith("error: play needs a display, got none (SDL: dummy): run it on a desktop, or use")
    assert result.stderr.count("\n") == 1
