"""Scores of a matched link by other methods: hand-made cases, invariances, rows, thresholds in the monitor."""

import copy
from itertools import product

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.context.code_fix import VehicleFix
from lanebound.integrity.monitoring.context.link_scores import ScoreKind, make_score, sugeno
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextReason
from lanebound.integrity.monitoring.context.position_phase import PositionTest
from lanebound.integrity.positioning.map_matching.hidden_markov import make_matcher
from lanebound.integrity.positioning.map_matching.matching import MapMatches, MatchingConfig, MatchInputs
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

OTHERS = [kind for kind in ScoreKind if kind is not ScoreKind.CONTEXT]
MATCHING = MatchingConfig()


def straight_links(*east_m: float, turned_rad: float = 0.0, shift=(0.0, 0.0)) -> RoadMap:
    """Links of 400 m to the north at some places, turned about the origin and shifted."""
    ends = np.array([[(e, -200.0), (e, 200.0)] for e in east_m])
    ends = ends @ turn(turned_rad).T + np.array(shift)
    pairs = [(2 * k, 2 * k + 1) for k in range(len(east_m))]
    return RoadMap.of_lines(ends.reshape(-1, 2), pairs, list(ends))


def turn(angle_rad: float):
    """Matrix that adds an angle to azimuths."""
    return np.array([[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]])


def score_of(kind, road_map, track, matcher=None, map_sigma_m=1.0, matched=None, **inputs):
    """Scores (T,) of one vehicle along a track (T, 2); the matched link is that of the matcher, or a given one."""
    found = make_score(kind, road_map, MATCHING, map_sigma_m, 10, 1)
    chosen = make_matcher(road_map, MATCHING, 1)
    out = []
    for place in np.atleast_2d(track):
        each = MatchInputs.of(place[None], **{"speed_mps": 10.0, "moved_m": 10.0, "sigma_m": 1.0, **inputs})
        match = chosen.step(each)
        if matched is not None:
            near = road_map.near(place[None], MATCHING.radius_m, MATCHING.candidates)
            match = MapMatches.chosen(near, np.argmax(near.link == matched, 1), np.ones(1))
        out.append(float(found.step(match, each)[0]))
    return np.array(out)


def test_sugeno_is_the_mean_of_the_rules_over_all_combinations() -> None:
    for good in ([1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.3, 0.8, 0.6]):
        total = 0.0
        for combination in product((0, 1), repeat=3):
            strength = np.prod([g if on else 1.0 - g for g, on in zip(good, combination, strict=True)])
            total += strength * {3: 100.0, 2: 50.0}.get(sum(combination), 10.0)
        assert sugeno(*(np.array([g]) for g in good))[0] == pytest.approx(total)


@pytest.mark.parametrize(
    ("east_m", "heading_deg", "sigma_m", "speed_mps", "expected"),
    [
        (5.0, 0.0, 1.0, 10.0, 100.0),
        (25.0, 0.0, 1.0, 10.0, 75.0),  # half far: the mean of high and average
        (5.0, 32.5, 1.0, 10.0, 75.0),
        (5.0, 90.0, 1.0, 10.0, 50.0),
        (45.0, 90.0, 1.0, 10.0, 10.0),
        (5.0, 90.0, 1.0, 1.0, 100.0),  # too slow for a direction
        (5.0, 0.0, 10.0, 10.0, 50.0),  # 95 % of the region within 24 m
    ],
)
def test_quddus_by_hand(east_m, heading_deg, sigma_m, speed_mps, expected) -> None:
    found = score_of(
        "quddus", straight_links(0.0), (east_m, 0.0), heading_rad=np.deg2rad(heading_deg), sigma_m=sigma_m,
        speed_mps=speed_mps,
    )  # fmt: skip
    assert found[0] == pytest.approx(expected)


def test_velaga_asks_for_a_lead_over_the_second_link_and_for_more_where_roads_are_complex() -> None:
    alone, parallel = straight_links(0.0), straight_links(-6.0, 6.0)
    assert score_of("velaga", alone, (3.0, 0.0))[0] == pytest.approx(100.0)
    assert score_of("velaga", parallel, (0.0, 0.0))[0] == pytest.approx(50.0)  # no lead, all else good
    lead = 0.35 * 1.0 / 15.0 / (0.1 * 0.8)  # half a metre nearer, over a tenth of the largest weight
    assert score_of("velaga", parallel, (0.5, 0.0))[0] == pytest.approx(50.0 + 50.0 * lead)
    angle = {"heading_rad": np.deg2rad(22.5)}
    simple = score_of("velaga", straight_links(0.0, 40.0), (0.0, 0.0), **angle)[0]
    complex_ = score_of("velaga", straight_links(0.0, 10.0, -10.0), (0.0, 0.0), **angle)[0]
    assert simple == pytest.approx(10.0 + 90.0 * 0.9 + 40.0 * 0.1)
    assert complex_ == pytest.approx(50.0)  # 22.5 degrees is far there


def test_jabbour_counts_hypotheses_and_tests_the_innovation() -> None:
    one, two = straight_links(0.0), straight_links(-6.0, 6.0)
    assert score_of("jabbour", one, (2.0, 0.0))[0] == pytest.approx(100.0)
    assert score_of("jabbour", two, (0.0, 0.0), sigma_m=4.0)[0] == pytest.approx(50.0)  # two of equal weight
    assert score_of("jabbour", two, (5.0, 0.0), sigma_m=1.0)[0] > 99.9
    odds = np.exp(-0.5 * (7.0**2 - 5.0**2) / 4.0**2)  # of the farther link, one metre from the middle
    share = (1.0 + odds**2) / (1.0 + odds) ** 2
    found = [score_of("jabbour", two, (1.0, 0.0), sigma_m=4.0, matched=link)[0] for link in (1, 0)]
    assert found == pytest.approx([100.0 * share, 100.0 * share * odds])
    gate = np.sqrt(-2.0 * np.log(1e-3))  # of a variance of 1 without that of the map; chi-square of two: exponential
    near, far = (score_of("jabbour", one, (gate * share, 0.0))[0] for share in (0.99, 1.01))
    assert (near, far) == (100.0, 0.0)


def test_yu_compares_shapes() -> None:
    along = np.column_stack([np.full(12, 7.0), 10.0 * np.arange(12) - 60.0])
    parallel = score_of("yu", straight_links(0.0), along)
    assert parallel[:2].tolist() == [0.0, 0.0]  # two points have no curve yet
    assert parallel[2:] == pytest.approx(np.full(10, 100.0))  # a parallel road has the same curve
    across = np.column_stack([8.0 * np.arange(11) - 40.0, np.zeros(11)])
    found = score_of("yu", straight_links(0.0), across, heading_rad=np.pi / 2.0)
    assert found[-1] == pytest.approx(0.0)  # all matched points are one
    slanted = np.column_stack([6.0 * np.arange(11) - 30.0, 8.0 * np.arange(11) - 40.0])
    found = score_of("yu", straight_links(0.0), slanted, heading_rad=np.arctan2(6.0, 8.0))
    assert found[-1] == pytest.approx(100.0 * (1.0 - 0.6))  # 6 of each 10 m remain
    zigzag = along + np.column_stack([2.0 * (-1.0) ** np.arange(12), np.zeros(12)])
    assert 80.0 < score_of("yu", straight_links(0.0), zigzag)[-1] < 95.0


@pytest.mark.parametrize("kind", OTHERS)
def test_scores_do_not_depend_on_the_place_and_the_direction_of_the_whole(kind) -> None:
    rng, angle, shift = np.random.default_rng(3), 0.7, np.array([300.0, -120.0])
    track = np.column_stack([rng.normal(4.0, 9.0, 15), 10.0 * np.arange(15) - 70.0])
    heading = 0.1
    one = score_of(kind, straight_links(0.0, 11.0, -9.0), track, heading_rad=heading)
    turned = straight_links(0.0, 11.0, -9.0, turned_rad=angle, shift=shift)
    other = score_of(kind, turned, track @ turn(angle).T + shift, heading_rad=heading + angle)
    np.testing.assert_allclose(one, other, atol=1e-8)
    assert np.ptp(one) > 1.0
    assert ((one >= 0.0) & (one <= 100.0)).all()


@pytest.mark.parametrize("kind", OTHERS)
def test_rows_do_not_depend_on_each_other_and_can_forget(kind) -> None:
    rng, road_map = np.random.default_rng(4), straight_links(0.0, 12.0)
    tracks = np.stack([np.column_stack([rng.normal(e, 3.0, 8), 10.0 * np.arange(8)]) for e in (0.0, 12.0, 500.0)])
    each = MatchingConfig()
    together, alone = make_score(kind, road_map, each, 1.0, 10, 3), [
        make_score(kind, road_map, each, 1.0, 10, 1) for _ in range(3)
    ]  # fmt: skip
    matcher, matchers = make_matcher(road_map, each, 3), [make_matcher(road_map, each, 1) for _ in range(3)]
    for k in range(8):
        given = {"speed_mps": 10.0, "moved_m": 10.0, "sigma_m": 2.0}
        inputs = MatchInputs.of(tracks[:, k], **given)
        found = together.step(matcher.step(inputs), inputs)
        for b in range(3):
            own = MatchInputs.of(tracks[b : b + 1, k], **given)
            assert alone[b].step(matchers[b].step(own), own)[0] == found[b]
    assert found[2] == 0.0  # no road
    together.forget(np.array([0]))
    for name, value in make_score(kind, road_map, each, 1.0, 10, 3).memory.items():
        if name in ("link", "count", "log_probability") and (kind, name) != ("jabbour", "link"):
            np.testing.assert_array_equal(together.memory[name][0], value[0])


def drive(config: ContextConfig, epochs: int = 30, snapshot: int | None = None):
    """Verdicts of a car on the eastern of two roads, whose positions go over to the western one."""
    rng, road_map = np.random.default_rng(5), straight_links(-9.0, 0.0)
    watch, sure, out = ContextMonitor(config, road_map, 1, 1.0), np.ones(1, np.bool_), []
    passed = PositionTest(np.full(1, 5.0), np.zeros(1), np.full(1, np.inf), sure, sure)
    for k in range(epochs):
        east = -9.0 * np.clip((k - 15) / 5.0, 0.0, 1.0)
        place = np.array([[east, 10.0 * k - 150.0]]) + rng.normal(0.0, 2.0, (1, 2))
        fix = VehicleFix(sure, place, 4.0 * np.eye(2)[None], sure, np.array([[0.0, 10.0]]), 0.01 * np.eye(2)[None])
        if k == snapshot:
            kept = copy.deepcopy(watch.memory)
            watch = ContextMonitor(config, road_map, 1, 1.0)
            watch.memory = kept
        out.append(watch.step(fix, np.array([10.0]), passed))
    return out


@pytest.mark.parametrize("kind", list(ScoreKind))
def test_each_score_drives_the_monitor_and_a_higher_threshold_warns_more(kind) -> None:
    warned = []
    for threshold in (20.0, 60.0, 95.0):
        found = drive(ContextConfig.load({"map": {"score": kind, "threshold": threshold}}))
        doubtful = [v.reason[0] == ContextReason.DOUBTFUL_ROAD.code for v in found]
        assert doubtful == [
            bool(v.score[0] < threshold and v.speed.passed[0] and v.link[0] != NO_LINK) for v in found
        ]  # fmt: skip
        warned.append(np.array(doubtful))
    assert (warned[0] <= warned[1]).all()
    assert (warned[1] <= warned[2]).all()
    assert warned[2].any()
    assert not warned[2].all()


@pytest.mark.parametrize("kind", list(ScoreKind))
def test_a_monitor_goes_on_from_its_memory(kind) -> None:
    config = ContextConfig.load({"map": {"score": kind, "threshold": 60.0}})
    assert [v.score[0] for v in drive(config)] == [v.score[0] for v in drive(config, snapshot=17)]


@pytest.mark.parametrize("kind", OTHERS)
def test_another_score_without_its_threshold_is_refused(kind) -> None:
    for make in (
        lambda: ContextConfig.load({"map": {"score": kind}}),
        lambda: ContextConfig().replace(map={"score": kind}),  # the default of S5's score is none of this one
    ):
        with pytest.raises(ConfigError, match=f"threshold must be given with score = {kind}"):
            make()
    given = ContextConfig().replace(map={"score": kind, "threshold": 71.0})
    assert given.map.least_score == 71.0
    assert ContextConfig.load(given.to_dict()) == given


def test_the_threshold_of_s5_is_that_of_its_score() -> None:
    assert ContextConfig().map.least_score == 71.0
    assert ContextConfig.load({"map": {"threshold": 60.0}}).map.least_score == 60.0
