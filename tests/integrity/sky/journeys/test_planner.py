"""The choice of routes on small graphs, against all ways that there are."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.journeys.planner import Planner, Route, StreetPlace, StreetsAhead, energy_kwh, place_on
from lanebound.integrity.sky.journeys.streets import EdgeStations
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.records import MapFrame, Restriction, StreetMap, StreetWay

SIZE = 3
STEP_M = 100.0


class Decaying:
    """A model whose probability is 1 with ten satellites and falls with the gap without them."""

    def probability(self, satellites: Any, gap_s: Any) -> Any:
        return np.where(np.asarray(satellites) >= 10.0, 1.0, np.exp(-np.asarray(gap_s) / 20.0))

    def quantiles(self, probability: Any) -> Any:
        return np.stack([1.0 - probability, 2.0 - probability], -1)


def street_grid(seed: int, restrictions: tuple[Restriction, ...] = ()) -> StreetMap:
    """Streets between SIZE x SIZE junctions, of random speeds."""
    rng = np.random.default_rng(seed)
    ways = []
    for a in range(SIZE * SIZE):
        for b in (a + 1, a + SIZE):
            if b >= SIZE * SIZE or (b == a + 1 and b % SIZE == 0):
                continue
            points = np.array([divmod(a, SIZE), divmod(b, SIZE)], dtype=float) * STEP_M
            ways.append(StreetWay(len(ways), (a, b), points, "residential", 1, 1, None, float(rng.uniform(5.0, 15.0))))
    return StreetMap(MapFrame(35.0, 139.0), tuple(ways), restrictions)


def ahead_of(streets: StreetMap, seed: int, dark: float = 0.5) -> StreetsAhead:
    """Half of the streets have no satellites."""
    graph = StreetGraph.of(streets)
    stations = EdgeStations.along(graph.edges)
    light = np.random.default_rng(seed).random(len(graph.edges)) >= dark
    number = np.repeat(np.where(light, 20.0, 0.0), np.diff(stations.first))
    model: Any = Decaying()
    return StreetsAhead(graph, stations, model, number, number >= 10.0)


def all_ways(ahead: StreetsAhead, origin: StreetPlace, destination: StreetPlace) -> Iterator[Route]:
    """Every way that uses no edge twice."""
    onward: dict[int, list[int]] = {}
    for a, b in ahead.graph.turns:
        onward.setdefault(a, []).append(b)
    goals = dict(zip(destination.edges, destination.shares, strict=True))

    def extended(way: tuple[int, ...], begin: float) -> Iterator[Route]:
        for b in onward.get(way[-1], ()):
            if b in way:
                continue
            if b in goals:
                yield ahead.described((*way, b), begin, goals[b])
            yield from extended((*way, b), begin)

    for edge, share in zip(origin.edges, origin.shares, strict=True):
        yield from extended((edge,), share)


@pytest.mark.parametrize("seed", range(4))
def test_routes_are_the_best_of_all_ways(seed: int) -> None:
    ahead = ahead_of(street_grid(seed), seed)
    ends = place_on(ahead.graph, (40.0, 0.0)), place_on(ahead.graph, (200.0, 170.0))
    planner, ways = Planner(ahead, *ends), list(all_ways(ahead, *ends))
    assert len(ways) > 20
    assert planner.shortest().length_m == pytest.approx(min(way.length_m for way in ways))
    assert planner.fastest().time_s == pytest.approx(min(way.time_s for way in ways))

    def cost(route: Route) -> float:
        return route.time_s + 5.0 * route.unusable_s

    best = min(map(cost, ways))
    assert cost(planner.weighted(5.0)) <= 1.05 * best + 1.0  # gaps are classes in the search
    front = planner.front()
    assert all(a.time_s < b.time_s and a.unusable_s > b.unusable_s for a, b in itertools.pairwise(front))
    assert front[0].time_s == pytest.approx(planner.fastest().time_s)
    assert front[-1].unusable_s <= min(way.unusable_s for way in ways) + 1.5
    bounded = planner.bounded(0.2)
    least = [min(way.unusable_s for way in ways if way.time_s <= one.time_s) for one in ways]
    fitting = [  # a longer way with as much loss has a smaller share, and is no choice
        way.time_s
        for way, lost in zip(ways, least, strict=True)
        if way.unusable_share <= 0.18 and way.unusable_s <= lost
    ]
    if fitting:
        assert bounded.time_s <= min(fitting) + 1e-6
    assert bounded.unusable_share <= 0.2 or not fitting


def test_without_loss_the_weight_changes_nothing_and_with_loss_it_buys_integrity_with_time() -> None:
    streets = street_grid(2)
    light, dark = ahead_of(streets, 1, dark=0.0), ahead_of(streets, 1)
    ends = place_on(light.graph, (40.0, 0.0)), place_on(light.graph, (200.0, 170.0))
    planner = Planner(light, *ends)
    assert planner.weighted(50.0) == planner.fastest()
    assert planner.fastest().unusable_s == 0.0
    planner = Planner(dark, *ends)
    assert planner.weighted(50.0).unusable_s < planner.fastest().unusable_s
    assert planner.weighted(0.0).time_s == pytest.approx(planner.fastest().time_s)


def test_forbidden_turns_are_not_taken() -> None:
    free = ahead_of(street_grid(0), 0)
    ends = place_on(free.graph, (40.0, 0.0)), place_on(free.graph, (200.0, 170.0))
    route = Planner(free, *ends).shortest()
    a, b = (free.graph.edges[k] for k in route.edges[:2])
    barred = ahead_of(street_grid(0, (Restriction(a.way.number, a.end, b.way.number, only=False),)), 0)
    other = Planner(barred, *ends).shortest()
    assert other.edges[:2] != route.edges[:2]
    assert set(zip(other.edges, other.edges[1:], strict=False)) <= set(barred.graph.turns)


def test_along_one_street_the_route_is_its_part() -> None:
    ahead = ahead_of(street_grid(0), 0)
    route = Planner(ahead, place_on(ahead.graph, (20.0, 0.0)), place_on(ahead.graph, (80.0, 0.0))).fastest()
    assert len(route.edges) == 1
    assert route.length_m == pytest.approx(60.0)


def test_refusals() -> None:
    ahead = ahead_of(street_grid(0), 0)
    here = place_on(ahead.graph, (20.0, 0.0))
    with pytest.raises(InputError, match="must differ"):
        Planner(ahead, here, place_on(ahead.graph, (20.2, 0.0)))
    with pytest.raises(InputError, match="outside of the map"):
        place_on(ahead.graph, (1000.0, 1000.0))
    one_way = StreetMap(
        MapFrame(35.0, 139.0),
        (
            StreetWay(0, (0, 1), np.array([(0.0, 0.0), (100.0, 0.0)]), "residential", 1, 0, None, 10.0),
            StreetWay(1, (1, 2), np.array([(100.0, 0.0), (200.0, 0.0)]), "residential", 1, 0, None, 10.0),
        ),
    )
    with pytest.raises(InputError, match="a way must lead"):
        Planner(ahead_of(one_way, 0), StreetPlace((1,), (0.5,)), StreetPlace((0,), (0.5,)))


def test_gaps_of_a_route_go_on_from_street_to_street() -> None:
    """One street of 100 m at 10 m/s without satellites, twice: the second part is entered with 10 s of gap."""
    points = np.array([(0.0, 0.0), (100.0, 0.0), (200.0, 0.0)])
    streets = StreetMap(
        MapFrame(35.0, 139.0),
        tuple(StreetWay(k, (k, k + 1), points[k : k + 2], "residential", 1, 0, None, 10.0) for k in (0, 1)),
    )
    ahead = ahead_of(streets, 0, dark=2.0)
    part_s = np.ones(20)
    part_s[0] += 0.5 * 10.0 / 1.5  # starting
    part_s[-1] += 0.5 * 10.0 / 2.0  # stopping
    gap = np.cumsum(part_s) - 0.5 * part_s
    lost = float((part_s * (1.0 - np.exp(-gap / 20.0))).sum())
    route = ahead.described((0, 1), 0.0, 1.0)
    assert route.time_s == pytest.approx(part_s.sum())
    assert route.unusable_s == pytest.approx(lost)
    assert ahead.exit_gap_s(np.arange(10), 3.0) == pytest.approx(13.0)


def test_energy_is_rolling_resistance_and_drag() -> None:
    assert float(energy_kwh(1000.0, 0.0)) == pytest.approx(1500.0 * 9.81 * 0.01 * 1000.0 / 0.9 / 3.6e6)
    assert energy_kwh(1000.0, 20.0) > energy_kwh(1000.0, 10.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_search_counts_long_gaps_over_short_streets(seed: int) -> None:
    """Sixty streets of 1 to 3 s without satellites: what the search adds up is what the route loses."""
    along = np.cumsum(np.random.default_rng(seed).uniform(10.0, 30.0, 61))
    points = along[:, None] * np.array([1.0, 0.0])
    ways = (StreetWay(k, (k, k + 1), points[k : k + 2], "residential", 1, 0, None, 10.0) for k in range(60))
    ahead = ahead_of(StreetMap(MapFrame(35.0, 139.0), tuple(ways)), 0, dark=2.0)
    first, last = (
        next(k for k, e in enumerate(ahead.graph.edges) if e.points_en_m[0, 0] == along[at]) for at in (0, 59)
    )
    planner = Planner(ahead, StreetPlace((first,), (0.1,)), StreetPlace((last,), (0.9,)))
    nodes = planner._search((0.0, 1.0, 1.0))
    assert nodes is not None
    steps = [next(arc for arc in planner._arcs[a] if arc.node == b) for a, b in itertools.pairwise(nodes)]
    route = planner.fastest()
    lost = sum(arc.unusable_s for arc in steps)
    assert route.unusable_s > 80.0
    assert lost / sum(arc.time_s for arc in steps) == pytest.approx(route.unusable_share, rel=0.03)
