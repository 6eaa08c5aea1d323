"""Map matching: golden routes, oracles by enumeration, invariants."""

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.map_matching.hidden_markov import (
    HiddenMarkovMatcher,
    make_matcher,
    transition,
    viterbi,
)
from lanebound.integrity.positioning.map_matching.matching import (
    MatcherKind,
    MatchingConfig,
    MatchInputs,
    connectivity,
    emission,
)
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

# cyang-kth/fmm, example/data and test/data/mr.txt (Apache-2.0), commit 19ef34e: nodes, links and three tracks with the
# link of each position and the links of the route. Units of the network; k 4, radius 0.4, gps_error 0.5.
NODES = [
    (2, 1), (2, 0), (3, 1), (4, 1), (2, 2), (3, 2), (0, 2), (1, 2), (4, 2), (2, 3), (3, 3), (4, 3), (2, 4),
    (0.5, 3.5), (1.999999999999, 3.5), (3.5, 4), (3.5, 2.3),
]  # fmt: skip
LINKS = [
    (1, 2), (2, 1), (3, 1), (4, 3), (1, 5), (5, 1), (3, 6), (7, 8), (8, 7), (5, 8), (8, 5), (6, 5), (5, 6), (6, 9),
    (9, 6), (10, 5), (5, 10), (6, 11), (10, 11), (11, 12), (13, 10), (10, 13), (9, 12), (12, 9), (9, 4), (4, 9),
    (14, 15), (15, 14), (16, 17), (17, 16),
]  # fmt: skip
TRACKS = [
    (
        [(1.658898, 0.250989), (1.654944, 0.701836), (2.493362, 1.765678), (3.549294, 1.888277), (4.13065, 2.457768)],
        [2, 2, 13, 14, 23],
        [2, 5, 13, 14, 23],
    ),
    (
        [
            (4.150424, 1.603531), (3.470198, 0.923305), (2.406356, 0.923305), (2.145339, 1.532345),
            (2.086017, 2.576412), (2.497316, 2.987712),
        ],
        [25, 4, 3, 5, 17, 19],
        [25, 4, 3, 5, 17, 19],
    ),
    (
        [
            (0.200812, 2.14089), (1.44262, 2.148799), (3.064089, 2.160664), (3.064089, 2.710381),
            (3.708722, 2.979308), (4.116066, 2.623376),
        ],
        [8, 11, 18, 18, 20, 24],
        [8, 11, 13, 18, 20, 24],
    ),
]  # fmt: skip
FMM = MatchingConfig(
    kind="hidden_markov", radius_m=0.4, candidates=4, sigma_m=0.5,
    hidden_markov={"beta_m": 0.5, "heading_sigma_deg": None, "backward_m": 0.0, "detour_m": 100.0},
)  # fmt: skip


def fmm_map() -> RoadMap:
    nodes, ends = np.array(NODES), [(a - 1, b - 1) for a, b in LINKS]
    return RoadMap.of_lines(nodes, ends, [nodes[[a, b]] for a, b in ends], identity=range(1, 31), limit_mps=1.0)


def crossing() -> RoadMap:
    """Two streets that cross at the origin, 100 m arms: links 0-3 towards it, 4-7 away, twins 0-4, 1-5, 2-6, 3-7."""
    nodes = np.array([(0.0, 0.0), (0.0, 100.0), (100.0, 0.0), (0.0, -100.0), (-100.0, 0.0)])
    ends = [(k, 0) for k in range(1, 5)] + [(0, k) for k in range(1, 5)]
    return RoadMap.of_lines(nodes, ends, [nodes[[a, b]] for a, b in ends])


@pytest.mark.parametrize(("track", "links", "route"), TRACKS)
@pytest.mark.parametrize("beta", [0.1, 0.5, 2.0])
def test_published_tracks_have_their_published_routes(track, links, route, beta) -> None:
    road_map = fmm_map()
    found = viterbi(road_map, track, FMM.replace(hidden_markov={"beta_m": beta}))
    assert road_map.identity[found.link].tolist() == links
    assert road_map.identity[found.route].tolist() == route


def test_near_links_are_those_of_a_search_through_all_pieces() -> None:
    road_map, rng = fmm_map(), np.random.default_rng(1)
    points = rng.uniform(-1.0, 5.0, (200, 2))
    near, s = road_map.near(points, 0.8, 30), road_map.segments
    for p, row in zip(points, range(200), strict=True):
        along = np.clip(((p - s.start_en_m) * s.unit).sum(-1), 0.0, s.length_m)
        away = np.linalg.norm(s.start_en_m + along[:, None] * s.unit - p, axis=-1)
        inside = np.flatnonzero(away <= 0.8)
        assert set(near.link[row][near.there[row]]) == set(s.link[inside])
        kept = near.distance_m[row][near.there[row]]
        np.testing.assert_allclose(kept, np.sort(away[inside]), atol=1e-12)


def test_the_filter_sums_and_viterbi_maximises_over_all_sequences() -> None:
    road_map, config = fmm_map(), FMM
    track = np.array(TRACKS[0][0])[:4]
    near = road_map.near(track, config.radius_m, config.candidates)
    seen = emission(near, MatchInputs.of(track, sigma_m=config.sigma_m))
    moved = np.linalg.norm(np.diff(track, axis=0), axis=-1)
    steps = [
        transition(road_map, near.rows(k), near.rows(k + 1), moved[k : k + 1], config.hidden_markov)[0]
        for k in range(3)
    ]
    columns = range(near.link.shape[1])
    weight = {
        way: seen[0, way[0]] + sum(steps[k][way[k], way[k + 1]] + seen[k + 1, way[k + 1]] for k in range(3))
        for way in itertools.product(columns, repeat=4)
    }
    best = max(weight, key=weight.__getitem__)
    assert viterbi(road_map, track, config).link.tolist() == [near.link[k, best[k]] for k in range(4)]
    last = np.array([logsumexp([w for way, w in weight.items() if way[3] == k]) for k in columns])
    matcher = HiddenMarkovMatcher(road_map, config, 1)
    for k, place in enumerate(track):
        match = matcher.step(MatchInputs.of(place[None], moved_m=0.0 if k == 0 else moved[k - 1], sigma_m=0.5))
    expected = np.exp(last - logsumexp(last))
    assert match.link[0] == near.link[3, np.argmax(expected)]
    assert match.probability[0] == pytest.approx(expected.max(), abs=1e-12)


def test_route_distances_of_a_crossing() -> None:
    road_map = crossing()
    distance = road_map.route_distance_m(
        np.zeros(4, int), np.full(4, 90.0), np.array([5, 0, 0, 4]), np.array([5.0, 95.0, 80.0, 0.0])
    )
    np.testing.assert_allclose(distance, [15.0, 5.0, 190.0, 10.0])  # back: round by the node
    back = road_map.route_distance_m(np.array([0]), np.array([90.0]), np.array([0]), np.array([80.0]), backward_m=15.0)
    assert back[0] == 10.0


def test_direction_and_connection_decide_where_distance_does_not() -> None:
    road_map = crossing()
    config = MatchingConfig(kind="topological")
    matcher = make_matcher(road_map, config, 1)
    south = MatchInputs.of([[1.0, 40.0]], heading_rad=np.pi, speed_mps=10.0)
    assert matcher.step(south).link[0] == 0  # to the origin, not away from it
    astray = MatchInputs.of([[6.0, 5.0]], heading_rad=0.75 * np.pi, speed_mps=10.0)  # between two arms
    assert matcher.step(astray).link[0] in (0, 5)
    nearest = make_matcher(road_map, MatchingConfig(kind="nearest"), 1)
    assert nearest.step(south).link[0] in (0, 4)  # the line alone has no direction
    assert connectivity(road_map, np.array([0, NO_LINK]), np.array([[0, 4, 5, 1], [0, 1, 2, 3]])).tolist() == [
        [1.0, -1.0, 1.0, -1.0], [0.0] * 4
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["topological", "hidden_markov"])
def test_a_heading_that_is_not_known_is_no_heading_to_the_north(kind) -> None:
    road_map, found = crossing(), {}
    for headed in (True, False):
        matcher = make_matcher(road_map, MatchingConfig(kind=kind), 1)
        for k in range(4):  # to the South at 10 m/s; a missing velocity reads 0, and so an azimuth of 0
            inputs = MatchInputs.of([[0.5, 80.0 - 10.0 * k]], speed_mps=10.0, moved_m=10.0, headed=headed)
            found[headed] = int(matcher.step(inputs).link[0])
    assert found[True] == 4  # away from the origin
    assert found[False] == 0 if kind == "hidden_markov" else found[False] in (0, 4)  # only routes tell the direction


def test_a_vehicle_at_rest_stays_on_its_link() -> None:
    road_map = crossing()
    matcher = make_matcher(road_map, MatchingConfig(kind="topological"), 1)
    matcher.step(MatchInputs.of([[0.0, 6.0]], heading_rad=np.pi, speed_mps=10.0))
    rng = np.random.default_rng(3)
    for _ in range(20):
        place = rng.normal([[0.0, 4.0]], 5.0)
        noisy = MatchInputs.of(place, heading_rad=rng.uniform(-3, 3), speed_mps=0.0)
        assert matcher.step(noisy).link[0] == 0


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_rows_do_not_depend_on_each_other(kind) -> None:
    road_map, rng = crossing(), np.random.default_rng(2)
    together = make_matcher(road_map, MatchingConfig(kind=kind), 6)
    alone = [make_matcher(road_map, MatchingConfig(kind=kind), 1) for _ in range(6)]
    for k in range(12):
        usable = rng.random(6) < 0.8
        inputs = MatchInputs.of(
            rng.normal([0.0, 60.0 - 10.0 * k], 8.0, (6, 2)), heading_rad=np.pi, speed_mps=rng.uniform(0, 12, 6),
            moved_m=10.0, usable=usable,
        )  # fmt: skip
        found = together.step(inputs)
        for v, matcher in enumerate(alone):
            own = matcher.step(MatchInputs(*(value[v : v + 1] for value in inputs)))
            for a, b in zip(found, own, strict=True):
                np.testing.assert_array_equal(a[v : v + 1], b)
        assert (found.link[~usable] == NO_LINK).all()
        assert (found.probability[~usable] == 0.0).all()
        assert ((found.probability >= 0.0) & (found.probability <= 1.0)).all()


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_far_from_every_link_there_is_no_match(kind) -> None:
    matcher = make_matcher(crossing(), MatchingConfig(kind=kind, radius_m=30.0), 2)
    found = matcher.step(MatchInputs.of([[400.0, 400.0], [1e6, 0.0]]))
    assert (found.link == NO_LINK).all()
    assert np.isinf(found.distance_m).all()
    assert (found.probability == 0.0).all()


def test_the_probability_of_the_filter_is_calibrated_on_its_own_model() -> None:
    """Two parallel roads 12 m apart with sigma 6 m: the share of right links follows the stated probability."""
    nodes = np.array([(0.0, 0.0), (0.0, 2000.0), (12.0, 0.0), (12.0, 2000.0)])
    road_map = RoadMap.of_lines(nodes, [(0, 1), (2, 3)], [nodes[:2], nodes[2:]])
    batch, rng = 4000, np.random.default_rng(5)
    config = MatchingConfig(kind="hidden_markov", hidden_markov={"beta_m": 1000.0, "detour_m": 1000.0})
    matcher = HiddenMarkovMatcher(road_map, config, batch)
    true = rng.integers(0, 2, batch)
    for k in range(3):
        place = np.column_stack([12.0 * true, np.full(batch, 100.0 + 10.0 * k)])
        found = matcher.step(MatchInputs.of(place + rng.normal(0.0, 6.0, (batch, 2)), sigma_m=6.0, moved_m=10.0))
    right = found.link == true
    z = (right - found.probability).sum() / np.sqrt((found.probability * (1.0 - found.probability)).sum())
    assert abs(z) < 3.3  # 0.1 % by chance; the prior of both roads is equal, as is their transition


def test_maps_without_links_or_length_are_refused() -> None:
    with pytest.raises(InputError, match="a map must have a link"):
        RoadMap.of_lines(np.zeros((1, 2)), [], [])
    with pytest.raises(InputError, match="none twice in a row"):
        RoadMap.of_lines(np.zeros((2, 2)), [(0, 1)], [np.zeros((2, 2))])
    nodes = np.array([(0.0, 0.0), (1.0, 0.0)])
    one_way = RoadMap.of_lines(nodes, [(0, 1)], [nodes])
    with pytest.raises(InputError, match="must be reachable"):
        one_way.route_between(1, 0)
