"""Pictures: their form, that they are the same for the same frame, and that they show what they should."""

from __future__ import annotations

import copy
import pickle
import sys
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import gymnasium
import numpy as np
import pygame
import pytest
from highway_env.road.road import RoadNetwork

from beliefs import believe
from lanebound.envs import IDS
from lanebound.envs.pictures import INCIDENTS, Pictures
from lanebound.envs.records import EgoBelief, Traffic
from lanebound.envs.rendering import Bodies, EpisodeCost, Frame, RenderingConfig, Satellites, Tape, Viewer
from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.map_view import camera_of
from lanebound.envs.rendering.panel import _ago, _rtk, legend_entries
from lanebound.envs.rendering.roads import RoadDrawing
from lanebound.envs.rendering.theme import THEMES
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.sky.scene import City, Surface, prisms

DARK = THEMES["dark"]
EGO_PX = (330, 356)  # middle of the true ego in the default picture
LEVELS = {"err_at_m": 0.1, "pl_at_m": 0.5, "al_at_m": 1.5, "err_ct_m": 0.1, "pl_ct_m": 0.5, "al_ct_m": 1.0}
SQUARE = np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]])


def belief(**changes) -> EgoBelief:
    """A little ahead and to the right of where the car is, on the middle lane."""
    place = {"position_m": np.array([100.3, 4.2]), "lane_index": ("0", "1", 1), "longitudinal_m": 100.3}
    return believe(**(place | {"lateral_m": 0.2, "pl_at_m": 0.6, "pl_ct_m": 0.4} | changes))


def traffic(pl_m: float) -> Traffic:
    one = np.ones(1)
    place = np.array([[120.0, 8.3]])
    key, relative = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    return Traffic(key, place, 0 * one, 9 * one, pl_m * one, pl_m * one, 0 * one, 5 * one, 2 * one, relative)


def sky() -> Satellites:
    path = np.arange(8) % 4
    azimuth, elevation = np.linspace(0.0, 6.0, 8), np.linspace(-0.1, 1.5, 8)
    return Satellites(azimuth, elevation, path, path < 2, np.arange(8) % 5)


def tape() -> Tape:
    record = Tape()
    for k in range(40):
        pl = np.inf if k > 35 else 0.5
        row = {"err_at_m": 0.2, "pl_at_m": pl, "al_at_m": 1.5, "err_ct_m": -0.1, "pl_ct_m": pl, "al_ct_m": 1.0}
        record.add(0.1 * k, **row, alert=k > 35)
    return record


@pytest.fixture(scope="module")
def city() -> City:
    slab = prisms(SQUARE[None] + [120.0, 0.0], 6.0, 7.5, floor=True)
    tree = City.of(prisms(0.4 * SQUARE[None] + [95.0, 12.0], 4.5, 9.0), Surface.FOLIAGE)
    return City.of(np.concatenate([slab, prisms(SQUARE[None] + [105.0, -22.0], 0.0, 30.0)])) + tree


@pytest.fixture(scope="module")
def frame(city) -> Frame:
    bodies = Bodies(
        np.array([[100.0, 4.0], [120.0, 8.0]]), np.zeros(2), np.full(2, 5.0), np.full(2, 2.0), np.array([False, True])
    )
    network = RoadNetwork.straight_road_network(3, length=300)
    cost = EpisodeCost(0.5, 3.25, 15.0)
    return Frame(
        network, bodies, 0, belief(), 3.9, 12.0, traffic(0.5), (), city, sky(), tape().trace, "lanebound/Test-v0", cost
    )


@pytest.fixture(scope="module")
def viewer() -> Viewer:
    return Viewer()


def near(pixel, colour, within=12) -> bool:
    return bool(np.abs(np.asarray(pixel, dtype=int) - colour).max() <= within)


def test_a_picture_is_rgb_of_the_size_asked_for(viewer, frame):
    picture = viewer.render(frame)
    assert picture.shape == (540, 960, 3)
    assert picture.dtype == np.uint8
    assert picture.flags.writeable
    kept = picture.copy()
    viewer.render(replace(frame, belief=belief(alert=True, reason=2)))
    assert (picture == kept).all()


def test_equal_frames_give_equal_pictures(viewer, frame):
    first = viewer.render(frame)
    viewer.render(replace(frame, time_s=8.0, city=None))
    assert (viewer.render(frame) == first).all()
    assert (Viewer().render(frame) == first).all()


def test_a_copied_or_pickled_viewer_draws_the_same(viewer, frame):
    first = viewer.render(frame)
    for twin in (copy.deepcopy(viewer), pickle.loads(pickle.dumps(viewer))):
        assert twin.config == viewer.config
        assert (twin.render(frame) == first).all()


def test_no_display_is_opened(viewer, frame):
    viewer.render(frame)
    assert not pygame.display.get_init()


@pytest.mark.parametrize("width", [320, 599, 600, 1280])
@pytest.mark.parametrize("height", [240, 300, 720])
def test_any_size_can_be_drawn(frame, width, height):
    config = RenderingConfig(width_px=width, height_px=height, supersampling=1)
    assert Viewer(config).render(frame).shape == (height, width, 3)


@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_and_reason_can_be_shown(viewer, frame, mode):
    pictures = {
        viewer.render(replace(frame, belief=belief(mode=int(mode), alert=True, reason=reason.code))).tobytes()
        for reason in AlertReason
    }
    assert len(pictures) == len(AlertReason)


def test_the_true_ego_is_where_the_camera_looks(frame):
    for theme in ("dark", "light"):
        for orientation, at in (("heading_up", EGO_PX), ("north_up", (330, 270))):
            config = RenderingConfig(theme=theme, orientation=orientation)
            picture = Viewer(config).render(replace(frame, belief=belief(position_m=np.array([104.0, 4.0]))))
            across, along = (5, 6) if orientation == "heading_up" else (6, 5)
            assert near(picture[at[1] + along, at[0] - across], THEMES[theme].ego)


def test_a_crash_shows(viewer, frame):
    at = (EGO_PX[0] + 32, EGO_PX[1] - 160)
    quiet = replace(frame, traffic=Traffic.none(), city=None)
    assert near(viewer.render(quiet)[at[1], at[0]], DARK.crashed)
    mended = replace(quiet, bodies=replace(quiet.bodies, crashed=np.zeros(2, dtype=bool)))
    assert near(viewer.render(mended)[at[1], at[0]], DARK.other)


def test_a_building_stands_to_the_north_where_its_east_and_north_say(frame):
    config = RenderingConfig(orientation="north_up", legend=False)
    south = City.of(prisms(SQUARE[None] + [105.0, -22.0], 0.0, 30.0))  # N = -22 is y = +22, 18 m below the ego's 4
    with_city = Viewer(config).render(replace(frame, city=south))
    without = Viewer(config).render(replace(frame, city=None))
    changed = np.argwhere((with_city != without).any(-1))
    top, left = changed.min(0)
    assert left == pytest.approx(330 + 8 * 0, abs=2)
    assert top == pytest.approx(270 + 8 * 13, abs=2)


def test_the_box_is_drawn_as_large_as_its_levels(frame):
    viewer = Viewer(RenderingConfig(legend=False))  # its key to the levels takes the colour of the status
    bare = replace(frame, traffic=Traffic.none(), city=None)
    small = viewer.render(bare)[:, :660]
    large = viewer.render(replace(bare, belief=belief(pl_at_m=1.4)))[:, :660]
    changed = np.argwhere((small != large).any(-1))
    middle = EGO_PX[1] - 8 * 0.3
    assert changed[:, 0].min() == pytest.approx(middle - 8 * (2.5 + 1.4), abs=2)
    assert changed[:, 0].max() == pytest.approx(middle + 8 * (2.5 + 1.4), abs=2)


def test_missing_levels_can_be_drawn(viewer, frame):
    lost = belief(pl_at_m=np.inf, pl_ct_m=np.inf, available=False, alert=True, reason=4, mode=0, since_rtk_s=np.inf)
    blind = replace(frame, belief=lost, traffic=traffic(np.inf), satellites=None, city=None, cost=None)
    assert (viewer.render(blind) != viewer.render(frame)).any()


def test_the_panel_says_why_the_position_is_not_rtk(viewer, frame):
    shown = belief(mode=int(Mode.RTK), rtk=RtkStatus.FIXED.code)
    assert _rtk(shown) == "fixed"
    gone = {status: _rtk(belief(mode=int(Mode.IMU_ODOMETER), rtk=status.code)) for status in RtkStatus}
    assert len({*gone.values(), "fixed"}) == len(RtkStatus) + 1
    assert (gone[RtkStatus.TOO_FEW], gone[RtkStatus.FAULT]) == ("too few satellites", "refused by a test")
    half = 0.5 * (viewer.config.panel_width_px - 40)
    canvas = Canvas(10, 10, 1)
    assert all(canvas.width_of(f"RTK  {words}", 11) < half for words in gone.values())
    assert (_ago(belief(since_rtk_s=8.42)), _ago(belief(since_rtk_s=np.inf))) == ("8.4 s ago", "never")
    pictures = [viewer.render(replace(frame, belief=belief(mode=3, rtk=s.code))) for s in list(RtkStatus)[1:3]]
    assert (pictures[0] != pictures[1]).any()


def test_the_legend_shows_the_colours_of_the_picture(viewer, frame):
    """The key to the levels: 16 px wide at the foot of the map, its edge in the colour of the status."""
    for colour, state in ((DARK.ok, belief()), (DARK.alert, belief(alert=True, reason=2))):
        foot = viewer.render(replace(frame, belief=state, city=None, traffic=Traffic.none()))[505:, :570]
        assert count(foot, colour) > 20
        assert count(foot, DARK.crashed) > 80


def entries(frame: Frame, theme=DARK) -> dict[str, str]:
    """Names of the legend, and how each is drawn."""
    return {entry.name: entry.kind for entry in legend_entries(frame, camera_of(frame, RenderingConfig()), theme)}


def test_the_legend_lists_what_is_on_the_map(frame):
    alone = replace(frame, bodies=Bodies(*(rows[:1] for rows in vars(frame.bodies).values())), traffic=Traffic.none())
    assert list(entries(alone)) == ["ego", "believed", "its PL", "alert limit"]
    assert list(entries(frame)) == [*entries(alone), "perceived + PL", "crashed"]
    whole = replace(frame, bodies=replace(frame.bodies, crashed=np.zeros(2, dtype=bool)), traffic=traffic(np.inf))
    assert list(entries(whole)) == [*entries(alone), "traffic", "perceived, no PL"]
    far = replace(frame.bodies, position_m=frame.bodies.position_m + np.array([[0.0, 0.0], [200.0, 0.0]]))
    assert list(entries(replace(alone, bodies=far))) == list(entries(alone))
    wreck = replace(alone, bodies=replace(alone.bodies, crashed=np.ones(1, dtype=bool)))
    assert list(entries(wreck)) == ["believed", "its PL", "alert limit", "crashed"]


def test_the_legend_names_a_level_that_the_map_clips(frame):
    for level, name, kind in (
        (12.0, "its PL", "blend"),
        (12.1, "its PL, over 12 m", "broken"),
        (np.inf, "no PL", "broken"),
    ):
        found = entries(replace(frame, belief=belief(pl_ct_m=level)))
        assert found[name] == kind
        assert sum("PL" in key and "perceived" not in key for key in found) == 1


def test_a_long_legend_takes_a_second_line(frame):
    both = traffic(0.5)
    rows = {name: np.concatenate([column, column]) for name, column in vars(both).items() if np.ndim(column)}
    rows["pl_at_m"] = np.array([0.5, np.inf])
    bodies = Bodies(*(np.concatenate([column, column[:1]]) for column in vars(frame.bodies).values()))
    full = replace(frame, traffic=Traffic(*rows.values()), bodies=bodies, city=None, belief=belief(pl_ct_m=13.0))
    assert {"traffic", "crashed", "perceived + PL", "perceived, no PL"} <= set(entries(full))
    with_legend, without = (Viewer(RenderingConfig(legend=legend)).render(full) for legend in (True, False))
    changed = np.argwhere((with_legend != without).any(-1))
    assert changed[:, 0].min() == pytest.approx(540 - 19 - 24 - 11, abs=1)
    assert changed[:, 1].max() < 660


def count(picture, colour) -> int:
    """Pixels of about this colour."""
    return int((np.abs(picture.astype(int) - colour).max(-1) <= 12).sum())


def test_triangles_mark_what_lies_beyond_an_edge(viewer, frame):
    """On the strip charts, whose upper edge lies at 350 px, and at the edges of the error box."""
    inside, beyond = Tape(), Tape()
    row = {"pl_at_m": 0.5, "al_at_m": 1.5, "err_ct_m": 0.1, "pl_ct_m": 0.4, "al_ct_m": 1.0, "alert": False}
    for k in range(200):
        inside.add(0.1 * k, err_at_m=2.39, **row)
        beyond.add(0.1 * k, err_at_m=2.41, **row)
    drawn, marked = (viewer.render(replace(frame, time_s=19.9, trace=tape.trace)) for tape in (inside, beyond))
    changed = np.argwhere((drawn[:432] != marked[:432]).any(-1))
    assert len(changed) > 50
    assert changed[:, 0].max() < 376
    levels = {"pl_at_m": 0.6, "pl_ct_m": 1.5}, {"pl_at_m": 0.6, "pl_ct_m": 1.7}
    boxes = [viewer.render(replace(frame, belief=belief(alert=True, **level)))[194:328, 816:950] for level in levels]
    edge = slice(3, 9), slice(None)
    middle = slice(60, 75), slice(0, 12)
    assert count(boxes[1][middle], DARK.alert) > count(boxes[0][middle], DARK.alert)
    assert count(boxes[1][edge], DARK.alert) == count(boxes[0][edge], DARK.alert), "along track nothing is beyond"


def test_the_episode_s_cost_is_shown_and_coloured_beyond_its_limit(viewer, frame):
    """The sixth row of figures, at 156 to 168 px."""

    def row(cost):
        return viewer.render(replace(frame, cost=cost))[156:169, 670:800]

    assert count(row(EpisodeCost(0.5, 15.0, 15.0)), DARK.alert) == 0
    assert count(row(EpisodeCost(0.5, 15.5, 15.0)), DARK.alert) > 10
    assert (row(EpisodeCost(0.5, 15.0, 15.0)) != row(EpisodeCost(0.5, 14.0, 15.0))).any()
    assert (row(EpisodeCost(0.5, 15.0, 15.0)) == row(EpisodeCost(0.7, 15.0, 15.0))).all()


def test_the_cost_of_an_episode_is_summed_from_its_reset():
    pictures = Pictures(RenderingConfig(), "lanebound/Test-v0", 20.0, 15.0)
    levels = {**LEVELS, **dict.fromkeys(INCIDENTS, False)}
    for _ in range(2):
        for step, cost in enumerate((0.0, 0.5, 0.25)):
            pictures.note(SimpleNamespace(time_s=0.2 * step), {**levels, "alert": False, "cost": cost})
        assert pictures._cost == EpisodeCost(0.25, 0.75, 15.0)


@pytest.mark.parametrize(
    ("happened", "shown"),
    [({}, ""), ({"crashed": True, "off_road": True}, "CRASHED"), ({"off_road": True}, "OFF ROAD")],
)
def test_what_has_happened_to_the_true_car_is_gathered(happened, shown):
    pictures = Pictures(RenderingConfig(), "lanebound/Test-v0", 20.0, 15.0)
    info = {**LEVELS, **dict.fromkeys(INCIDENTS, False), "alert": False, "cost": 0.0, **happened}
    pictures.note(SimpleNamespace(time_s=0.2), info)
    assert pictures._incident == shown


def test_what_has_happened_stands_beside_the_time_in_the_colour_of_alerts(viewer, frame):
    def count(incident: str) -> int:
        head = viewer.render(replace(frame, incident=incident))[:26, 640:].reshape(-1, 3)
        return sum(near(pixel, DARK.alert) for pixel in head)

    assert count("") == 0
    assert count("OFF ROAD") > 20


@pytest.mark.parametrize("size", [(960, 540), (600, 240)])
@pytest.mark.parametrize("title", [*sorted(IDS), "elsewhere/AVeryLongNameOfAnEnvironmentThatSomeoneChose-v12"])
def test_title_incident_and_time_do_not_meet(frame, title, size, monkeypatch):
    """At the default size, and at the smallest with a panel."""
    config = RenderingConfig(width_px=size[0], height_px=size[1])
    drawn, draw = [], Canvas.text

    def text(canvas, x, y, words, size_px, colour, *, anchor="left", bold=False):
        width = draw(canvas, x, y, words, size_px, colour, anchor=anchor, bold=bold)
        if x >= config.map_width_px and y < 26:
            left = x - width if anchor == "right" else x
            drawn.append((left, left + width, words))
        return width

    monkeypatch.setattr(Canvas, "text", text)
    viewer = Viewer(config)
    for incident in ("", *INCIDENTS.values()):
        drawn.clear()
        viewer.render(replace(frame, title=title, incident=incident, time_s=3599.9))
        rows = sorted(drawn)
        assert [words for *_, words in rows][1:] == [*filter(None, [incident]), "3599.9 s"]
        assert all(row[1] + 8 <= following[0] for row, following in pairwise(rows))
        assert len(rows[0][2]) > 4
        assert rows[0][0] >= config.map_width_px
        assert rows[-1][1] <= size[0]


def test_a_vehicle_under_a_tree_is_drawn_on_top_of_it(viewer, frame):
    tree = City.of(prisms(0.6 * SQUARE[None] + [100.0, -4.0], 4.5, 9.0), Surface.FOLIAGE)
    picture = viewer.render(replace(frame, city=tree))
    assert near(picture[EGO_PX[1] + 6, EGO_PX[0] - 6], viewer.render(replace(frame, city=None))[362, 324])


def test_the_light_is_coloured(viewer, frame):
    colours = {
        DARK.ok: belief(), DARK.caution: belief(pl_ct_m=0.9), DARK.alert: belief(alert=True, reason=2),
    }  # fmt: skip
    for colour, state in colours.items():
        assert near(viewer.render(replace(frame, belief=state))[47, 672], colour)


def test_a_network_is_traced_once(viewer, frame, monkeypatch):
    traced = []
    original = RoadDrawing.of.__func__

    def counted(cls, network):
        traced.append(network)
        return original(cls, network)

    monkeypatch.setattr(RoadDrawing, "of", classmethod(counted))
    one = Viewer()
    one.render(frame)
    one.render(replace(frame, time_s=5.0))
    assert len(traced) == 1
    one.render(replace(frame, network=RoadNetwork.straight_road_network(2, length=300)))
    assert len(traced) == 2


def test_a_window_opens_shows_and_closes(frame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with Viewer(fps=1000.0) as viewer:
        assert viewer.show(frame)
        assert pygame.display.get_init()
        assert viewer.show(frame)
    assert not pygame.display.get_init()
    viewer.close()


def test_the_user_can_close_the_window(frame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with Viewer(fps=1000.0) as viewer:
        viewer.show(frame)
        window = viewer._window._window
        pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=window))
        assert not viewer.show(frame)
        assert not viewer.show(frame)
    assert not pygame.display.get_init()


def test_a_window_of_the_user_is_left_alone(frame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.init()
    try:
        own = pygame.display.set_mode((100, 80))
        own.fill((1, 2, 3))
        with Viewer(fps=1000.0) as viewer:
            viewer.show(frame)
            pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=None))
            assert viewer.show(frame)
        assert pygame.display.get_init()
        assert pygame.display.get_surface() is own
        assert own.get_at((5, 5))[:3] == (1, 2, 3)
        assert pygame.event.peek(pygame.WINDOWCLOSE)
    finally:
        pygame.display.quit()


def test_a_missing_pygame_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match="pip install pygame-ce"):
        Viewer()
