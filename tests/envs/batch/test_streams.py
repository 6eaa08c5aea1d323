"""Streams of many environments side by side draw what as many single ones do."""

from __future__ import annotations

from functools import partial

import numpy as np

from lanebound.envs.batch.streams import CrewStreams
from lanebound.integrity.core import streams_kernel as sk
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.streams import ZIGGURAT, Streams, named_states
from lanebound.integrity.sensors.draws_kernel import draw_normals, draw_uniforms

THERE = np.ones((2, 2), dtype=np.bool_)
USED = np.array([[True, True, False, True], [False, True, True, False]])
SEEDS, FLEETS, VEHICLES = [3, 9], [14, 15], 3


def test_they_draw_as_single_ones() -> None:
    crew = CrewStreams(SEEDS, FLEETS, THERE, USED)
    egos, fleets = [Streams([seed]) for seed in SEEDS], [Streams(seed, VEHICLES - 1) for seed in FLEETS]
    for name, shape in (("gnss", (4, 2)), ("imu", (2, 3)), ("odometer", ()), ("clock", (4,)), ("gnss", (4, 1))):
        for law in ("normal", "uniform"):
            drawn = getattr(crew, law)(name, *shape)
            assert drawn.shape == (6, *shape)
            for row, (ego, fleet) in enumerate(zip(egos, fleets, strict=True)):
                by_satellite = name == "gnss"
                own = (int(USED[row].sum()), *shape[1:]) if by_satellite else shape
                alone = np.concatenate([getattr(one, law)(name, *own) for one in (ego, fleet)])
                mine = drawn[3 * row : 3 * row + 3]
                np.testing.assert_array_equal(mine[:, USED[row]] if by_satellite else mine, alone)
                assert not by_satellite or not mine[:, ~USED[row]].any()


def test_many_draw_side_by_side_as_one_after_another() -> None:
    used = np.random.default_rng(7).random((20, 5)) < 0.7
    found = []
    for run in (sk.normals_at, partial(run_rows, sk.normals_at, row_us=40.0)):
        states, out = named_states(range(20), "gnss"), np.zeros((20, 5, 3))
        for _ in range(2):
            run(*((0, 20) if run is sk.normals_at else (20,)), states, used, ZIGGURAT, out)
        found.append(out)
    np.testing.assert_array_equal(*found)
    assert found[0][used].all()
    assert not found[0][~used].any()


def test_empty_places_of_vehicles_take_no_draws() -> None:
    there = np.array([[True, False, False], [True, True, False]])
    crew = CrewStreams(SEEDS, FLEETS, there, USED)
    fleets = [Streams(seed, int(own.sum())) for seed, own in zip(FLEETS, there, strict=True)]
    for name, shape in (("gnss", (4, 2)), ("imu", (2, 3)), ("odometer", ()), ("gnss", (4, 1))):
        for law in ("normal", "uniform"):
            drawn = getattr(crew, law)(name, *shape).reshape(2, 4, *shape)[:, 1:]
            for row, fleet in enumerate(fleets):
                own = (int(USED[row].sum()), *shape[1:]) if name == "gnss" else shape
                mine = drawn[row][:, USED[row]] if name == "gnss" else drawn[row]
                np.testing.assert_array_equal(mine[there[row]], getattr(fleet, law)(name, *own))
                assert not drawn[row][~there[row]].any()


def test_vehicles_of_an_environment_share_their_area() -> None:
    crew = CrewStreams(SEEDS, FLEETS, THERE, USED)
    areas = [Streams([seed]) for seed in SEEDS]
    for name, shape in (("atmosphere", (4,)), ("station", (2,)), ("station", (4, 5)), ("network", (3,))):
        drawn = crew.normal(name, *shape).reshape(2, VEHICLES, *shape)
        for row, area in enumerate(areas):
            by_satellite = shape[0] == 4
            alone = area.normal(name, *((int(USED[row].sum()), *shape[1:]) if by_satellite else shape))[0]
            for mine in drawn[row]:
                np.testing.assert_array_equal(mine[USED[row]] if by_satellite else mine, alone)


def test_they_go_on_with_those_of_others() -> None:
    crew = CrewStreams([1, 2, 3], [4, 5, 6], np.ones((3, 1), dtype=np.bool_), np.ones((3, 2), dtype=np.bool_))
    other = CrewStreams([8], [9], THERE[:1, :1], USED[:1, 1:3])
    crew.normal("imu")
    crew.adopt(np.array([1]), other, np.array([0]))
    same = CrewStreams([8], [9], THERE[:1, :1], USED[:1, 1:3])
    np.testing.assert_array_equal(crew.normal("imu")[2:4], same.normal("imu"))
    np.testing.assert_array_equal(crew.normal("gnss", 2, 3)[2:4], same.normal("gnss", 2, 3))


def test_kernels_draw_for_the_places_taken_what_the_streams_of_egos_draw() -> None:
    nobody = np.ones((2, 0), dtype=np.bool_)
    crew, same = CrewStreams(SEEDS, FLEETS, nobody, USED), CrewStreams(SEEDS, FLEETS, nobody, USED)
    assert crew.draws_by_row
    assert not CrewStreams(SEEDS, FLEETS, THERE, USED).draws_by_row
    normals, uniforms = np.full((2, 4 * 3), 7.0), np.full((2, 4 * 2), 7.0)
    for used in (USED, ~USED):  # of another hour: places that were taken are empty now
        for streams in (crew, same):
            streams.places[:] = used
        for v, generator in enumerate(crew.together(("imu", "gnss"))[1]):
            draw_normals(generator, v, crew.places, ZIGGURAT, normals[v])
            draw_uniforms(generator, v, crew.places, uniforms[v])
        np.testing.assert_array_equal(normals.reshape(2, 4, 3), same.normal("gnss", 4, 3))
        np.testing.assert_array_equal(uniforms.reshape(2, 4, 2), same.uniform("gnss", 4, 2))
        assert normals.reshape(2, 4, 3)[used].all()


def test_without_places_kernels_draw_for_all_satellites() -> None:
    streams, same = Streams(SEEDS), Streams(SEEDS)
    assert streams.draws_by_row
    normals, uniforms = np.empty((2, 12)), np.empty((2, 8))
    for v, generator in enumerate(streams.states("gnss")):
        draw_normals(generator, v, streams.places, ZIGGURAT, normals[v])
        draw_uniforms(generator, v, streams.places, uniforms[v])
    np.testing.assert_array_equal(normals, same.normal("gnss", 12))
    np.testing.assert_array_equal(uniforms, same.uniform("gnss", 8))
