"""Generated maps, their routes, and the errors of maps."""

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.map_matching.generators import DriveEnvironment, MapBuilder, generate_map
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, LinkKind


@pytest.mark.parametrize(("environment", "length_m"), [("urban", 6400.0), ("rural", 6500.0), ("mixed", 8600.0)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_routes_are_connected_and_of_the_length_asked_for(environment, length_m, seed) -> None:
    found = generate_map(DriveEnvironment(environment), length_m, np.random.default_rng(seed))
    road_map, route = found.road_map, found.route
    assert (road_map.link_to[route[:-1]] == road_map.link_from[route[1:]]).all()
    assert (road_map.twin[route[:-1]] != route[1:]).all()  # no turn back
    if found.closed:
        assert road_map.link_to[route[-1]] == road_map.link_from[route[0]]
    assert length_m * 0.9 < found.length_m < length_m * 1.15
    assert np.isfinite(road_map.node_distance_m).all()  # one connected network
    ends = np.stack([road_map.line(i)[[0, -1]] for i in range(road_map.links)])
    np.testing.assert_allclose(ends[:, 0], road_map.node_en_m[road_map.link_from], atol=1e-9)
    np.testing.assert_allclose(ends[:, 1], road_map.node_en_m[road_map.link_to], atol=1e-9)
    twins = np.flatnonzero(road_map.twin != NO_LINK)
    assert (road_map.twin[road_map.twin[twins]] == twins).all()


@pytest.mark.parametrize("environment", list(DriveEnvironment))
def test_maps_have_what_misleads_matchers(environment) -> None:
    kinds = set(generate_map(environment, 6500.0, np.random.default_rng(4)).road_map.kind)
    assert {LinkKind.ROUNDABOUT, LinkKind.SERVICE} <= kinds
    assert (LinkKind.CARRIAGEWAY in kinds) == (environment is not DriveEnvironment.URBAN)


def test_the_same_seed_gives_the_same_map() -> None:
    a, b = (generate_map(DriveEnvironment.MIXED, 3000.0, np.random.default_rng(9)) for _ in range(2))
    np.testing.assert_array_equal(a.road_map.vertex_en_m, b.road_map.vertex_en_m)
    np.testing.assert_array_equal(a.route, b.route)


def test_a_roundabout_leads_around_against_the_clock() -> None:
    builder = MapBuilder()
    centre = builder.node(0.0, 0.0)
    for east, north in ((0.0, 100.0), (100.0, 0.0), (0.0, -100.0), (-100.0, 0.0)):
        builder.street(builder.node(east, north), centre, limit_mps=10.0)
    builder.roundabout(centre, 20.0)
    road_map = builder.build()
    ring = np.flatnonzero(road_map.kind == LinkKind.ROUNDABOUT)
    assert ring.size == 4
    assert road_map.length_m[ring].sum() == pytest.approx(2.0 * np.pi * 20.0, rel=0.02)
    for i in ring:
        a, b = road_map.line(int(i))[[0, -1]]
        assert a[0] * b[1] - a[1] * b[0] > 0.0  # against the clock
    np.testing.assert_allclose(np.linalg.norm(road_map.line(int(ring[0])), axis=-1), 20.0, atol=1e-9)
    north = int(np.flatnonzero((road_map.node_en_m == (0.0, 100.0)).all(-1))[0])
    west = int(np.flatnonzero((road_map.node_en_m == (-100.0, 0.0)).all(-1))[0])
    quarter = 0.5 * np.pi * 20.0
    assert road_map.node_distance_m[north, west] == pytest.approx(160.0 + quarter, rel=0.01)
    assert road_map.node_distance_m[west, north] == pytest.approx(160.0 + 3.0 * quarter, rel=0.01)


def test_errors_shift_remove_and_disconnect_as_configured() -> None:
    true = generate_map(DriveEnvironment.URBAN, 3000.0, np.random.default_rng(1)).road_map
    same = with_errors(true, MapErrorsConfig(), np.random.default_rng(2))
    np.testing.assert_allclose(same.vertex_en_m, true.vertex_en_m)
    np.testing.assert_array_equal(same.twin, true.twin)
    shifted = with_errors(true, MapErrorsConfig(shift_m=5.0), np.random.default_rng(2))
    off = np.array([np.linalg.norm(shifted.line(i)[0] - true.line(i)[0]) for i in range(true.links)])
    assert 3.5 < np.sqrt(np.square(off).mean()) < 6.5
    twins = np.flatnonzero(true.twin != NO_LINK)
    for i in twins[:20]:
        np.testing.assert_allclose(shifted.line(int(i)), shifted.line(int(true.twin[i]))[::-1], atol=1e-9)
    gone = with_errors(true, MapErrorsConfig(missing=0.2), np.random.default_rng(2))
    lost = set(true.identity) - set(gone.identity)
    assert 0.1 < len(lost) / true.links < 0.3
    assert all(true.twin[i] in lost for i in lost if true.twin[i] != NO_LINK)
    loose = with_errors(true, MapErrorsConfig(wrong_topology=0.1), np.random.default_rng(2))
    assert np.isinf(loose.node_distance_m).any()
    assert loose.links == true.links
    datum = with_errors(true, MapErrorsConfig(datum_m=4.0), np.random.default_rng(2))
    np.testing.assert_allclose(np.linalg.norm(datum.vertex_en_m - true.vertex_en_m, axis=-1), 4.0)


def test_too_short_routes_and_streets_are_refused() -> None:
    with pytest.raises(InputError, match="length_m must be at least 1000"):
        generate_map(DriveEnvironment.RURAL, 10.0, np.random.default_rng(0))
    builder = MapBuilder()
    centre = builder.node(0.0, 0.0)
    builder.street(centre, builder.node(5.0, 0.0), limit_mps=10.0)
    builder.roundabout(centre, 20.0)
    with pytest.raises(InputError, match="longer than the radius"):
        builder.build()
