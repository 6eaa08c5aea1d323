import hashlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import STREAM_NAMES, Streams, named_generator, named_states

NAMES = st.sampled_from(STREAM_NAMES)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    watched=NAMES,
    others=st.lists(st.tuples(NAMES, st.integers(1, 9)), max_size=6),
    seed=st.integers(0, 2**63),
    joint=st.booleans(),
)
def test_draws_of_one_stream_never_move_another(watched, others, seed, joint):
    seeds, batch = (seed, 2) if joint else ([seed, 7], None)
    alone, among = Streams(seeds, batch), Streams(seeds, batch)
    expected = [alone.normal(watched, 3), alone.uniform(watched), alone.normal(watched, 2, 2)]
    found = []
    for draw in (lambda: among.normal(watched, 3), lambda: among.uniform(watched), lambda: among.normal(watched, 2, 2)):
        for name, size in others:
            if name != watched:
                among.normal(name, size)
        among.uniform("a stream added later", 4)
        found.append(draw())
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_array_equal(a, b)


def test_same_bits_in_another_process():
    code = (
        "from lanebound.integrity.core.streams import Streams; s = Streams([3, 2**40]);"
        "print(s.normal('gnss', 2, 3).tobytes().hex(), s.uniform('faults').tobytes().hex())"
    )
    fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    streams = Streams([3, 2**40])
    assert fresh == [streams.normal("gnss", 2, 3).tobytes().hex(), streams.uniform("faults").tobytes().hex()]


def test_a_stream_is_sfc64_seeded_by_seed_and_hashed_name():
    key = int.from_bytes(hashlib.blake2b(b"imu", digest_size=8).digest(), "little")
    expected = np.random.SFC64(np.random.SeedSequence([11, key])).random_raw(4)
    np.testing.assert_array_equal(named_generator(11, "imu").bit_generator.random_raw(4), expected)
    np.testing.assert_array_equal(named_generator(np.int64(11), "imu").bit_generator.random_raw(4), expected)


def test_seeds_of_one_or_two_words_and_beyond_are_those_of_numpy():
    """Seeds at the bounds of words of 32 and 64 bits, and a hundred others."""
    seeds = [0, 1, 2**32 - 1, 2**32, 2**63, 2**64 - 1, *np.random.default_rng(3).integers(2**62, size=100).tolist()]
    for name in STREAM_NAMES:
        for chosen in (seeds, [2**64, 5]):
            expected = [named_generator(seed, name).bit_generator.state["state"]["state"] for seed in chosen]
            np.testing.assert_array_equal(named_states(chosen, name), expected)


def test_compiled_draws_are_those_of_numpy_bit_by_bit():
    """A million draws reach all layers of the ziggurat, and its tail 260 times."""
    generator, streams = named_generator(11, "imu"), Streams([11])
    for _ in range(4):
        np.testing.assert_array_equal(streams.normal("imu", 250_000)[0], generator.standard_normal(250_000))
        np.testing.assert_array_equal(streams.uniform("imu", 7)[0], generator.random(7))


def test_a_stream_is_drawn_from_in_one_way():
    streams = Streams([11, 12])
    assert streams.generator("scene").random() == named_generator(11, "scene").random()
    with pytest.raises(InputError, match="stream 'scene' must be drawn from in one way"):
        streams.normal("scene")
    streams.normal("imu")
    with pytest.raises(InputError, match="use another stream"):
        streams.generator("imu")


def test_every_pair_of_seed_and_name_gives_other_bits():
    seeds = [0, 1, 2, 2**32, 2**64 + 1, (1, 2), (2, 1)]
    first = {int(named_generator(s, name).bit_generator.random_raw()) for s in seeds for name in STREAM_NAMES}
    assert len(first) == len(seeds) * len(STREAM_NAMES)


@pytest.mark.parametrize("kind", ["normal", "uniform"])
@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize("args", [(5, 4), ([5, 6, 7, 8],)])
def test_draws_have_the_batch_first(kind, shape, args):
    found = getattr(Streams(*args), kind)("gnss", *shape)
    assert found.shape == (4, *shape)
    assert found.dtype == np.float64


def test_own_seeds_make_a_vehicle_independent_of_its_company():
    together, alone = Streams([4, 9, 4]), Streams([9])
    for _ in range(3):
        draw = together.normal("imu", 5)
        np.testing.assert_array_equal(draw[1], alone.normal("imu", 5)[0])
        np.testing.assert_array_equal(draw[0], draw[2])


def test_joint_rows_come_from_one_generator_in_order():
    draw = Streams(12, batch=3).uniform("v2v", 2)
    np.testing.assert_array_equal(draw.ravel(), named_generator(12, "v2v").random(6))
    np.testing.assert_array_equal(Streams(12, batch=1).uniform("v2v", 6), Streams([12]).uniform("v2v", 6))


def test_reseeding_starts_one_vehicle_anew_and_leaves_the_others():
    streams, untouched = Streams([1, 2, 3]), Streams([1, 2, 3])
    for s in (streams, untouched):
        s.normal("gnss", 4)
        s.uniform("imu", 2)
    streams.reseed(1, 77)
    fresh = Streams([77])
    for name in ("gnss", "imu", "faults"):
        found, others = streams.normal(name, 3), untouched.normal(name, 3)
        np.testing.assert_array_equal(found[1], fresh.normal(name, 3)[0])
        np.testing.assert_array_equal(found[[0, 2]], others[[0, 2]])


def test_a_refused_reseed_changes_nothing():
    streams, untouched = Streams([1, 2]), Streams([1, 2])
    streams.normal("gnss")
    untouched.normal("gnss")
    with pytest.raises(InputError, match="non-negative"):
        streams.reseed(0, -1)
    for name in ("gnss", "imu"):
        np.testing.assert_array_equal(streams.normal(name), untouched.normal(name))


@pytest.mark.parametrize("args", [(5, 2), ([5, 6],)])
def test_a_snapshot_replays_and_is_independent(args):
    streams = Streams(*args)
    streams.normal("gnss", 3)
    snapshot = streams.snapshot()
    expected = [streams.normal("gnss", 2), streams.uniform("odometer", 2)]
    np.testing.assert_array_equal(snapshot.normal("gnss", 2), expected[0])
    np.testing.assert_array_equal(snapshot.uniform("odometer", 2), expected[1])
    snapshot.normal("gnss", 50)
    twin = streams.snapshot()
    np.testing.assert_array_equal(streams.normal("gnss"), twin.normal("gnss"))


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((5,), "batch must be a positive int"),
        ((5, 0), "batch must be a positive int"),
        ((-1, 2), "non-negative"),
        (([3, -1],), "non-negative"),
        (([],), "one seed for each vehicle"),
        (([1, 2], 3), "one seed for each vehicle"),
    ],
)
def test_unusable_seeds_are_refused(args, message):
    with pytest.raises(InputError, match=message):
        Streams(*args)


def test_jointly_seeded_vehicles_cannot_be_reseeded():
    with pytest.raises(InputError, match="cannot reseed one vehicle"):
        Streams(1, batch=2).reseed(0, 3)


@pytest.mark.parametrize("args", [(1, 40), (list(range(40)),)])
def test_normal_draws_have_unit_variance_and_no_correlation(args):
    draws = Streams(*args).normal("gnss", 250)
    tail = 5e-4  # each of the two bounds fails by chance once in 1000 seeds
    low, high = chi2.ppf([tail, 1.0 - tail], df=draws.size)
    assert low < np.sum(draws**2) < high
    means = np.sqrt(draws.shape[1]) * draws.mean(axis=1)
    low, high = chi2.ppf([tail, 1.0 - tail], df=len(means))
    assert low < np.sum(means**2) < high


def test_streams_taken_together_go_on_as_they_would_apart() -> None:
    apart, together = Streams([1, 2]), Streams([1, 2])
    for streams in (apart, together):
        streams.normal("gnss", 3)
    block = together.together(("clock", "gnss"))
    assert block.shape == (2, 2, 4)
    assert together.together(("clock", "gnss")) is block
    twin = together.snapshot()
    for streams in (together, twin):  # a copy has rows of its own
        for k, name in enumerate(("clock", "gnss")):
            np.testing.assert_array_equal(streams.normal(name, 5), apart.snapshot().normal(name, 5))
            np.testing.assert_array_equal(streams.together(("clock", "gnss"))[k], streams.states(name))
