"""The kind ``filter``: it locates, bounds, rejects, begins, resumes, and treats vehicles alone as in a batch."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from plain_filter_figures import bounds_of
from scipy.optimize import brentq
from scipy.stats import binom, norm

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import one_record
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.vehicle_filter.levels_kernel import major_axis, mixture_level
from lanebound.integrity.navigators.vehicle_filter.navigator import FilterNavigator
from lanebound.integrity.positioning.filters.code_position import locate_by_codes
from lanebound.integrity.positioning.filters.mixing_kernel import mixing_weights
from lanebound.integrity.positioning.filters.odometry_kernel import CAR, from_front_wheel, rolling_slip
from lanebound.integrity.positioning.filters.vehicle_states_kernel import MODEL
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.road import Road

BEND = Road.through(np.array([[0.0, 0.0], [120.0, 0.0], [120.0, 200.0], [300.0, 200.0]]))


def config(**more):
    return NavigatorConfig.load({"kind": "filter", **more})


def drives(seeds, start=True, **more):
    """A navigator under an open sky and the truth of vehicles that follow a road with two bends."""
    c = config(**more)
    navigator = Navigator.nominal(c, seeds, duration_s=120.0)
    traffic = Streams(seeds)
    car = CityDrive(BEND, DriveConfig(red_share=0.0), c.dt_s)
    state = car.start(traffic)
    if start:
        navigator.place(state.position_m.copy(), state.heading_rad.copy(), 0.05, np.deg2rad(0.5))
    return navigator, (car.step(state, traffic) for _ in range(10_000))


def errors(navigator, truths, epochs, change=lambda m, k: m):
    """Horizontal errors (K, B) [m] and solutions of so many epochs; ``change`` alters the measurements."""
    found, solutions = [], []
    for k, truth in zip(range(epochs), truths, strict=False):
        solution = navigator.locate(change(navigator.measure(truth), k))
        solutions.append(solution)
        found.append(np.linalg.norm(solution.position_en_m - truth.position_enu_m[:, :2], axis=-1))
    return np.array(found), solutions


def without_gnss(m, k):
    """No satellites."""
    return replace(m, gnss=replace(m.gnss, tracked=np.zeros_like(m.gnss.tracked)))


@pytest.mark.parametrize("kind", ["ekf", "ukf", "imm"])
def test_each_filter_locates_within_its_levels(kind):
    navigator, truths = drives([1, 2, 3], filter=kind)
    assert isinstance(navigator, FilterNavigator)
    error, solutions = errors(navigator, truths, 130)
    level = np.array([np.hypot(s.pl_at_m, s.pl_ct_m) for s in solutions])
    assert (error <= level).all()
    assert error.max() < 3.0
    assert all(np.isfinite(s.pl_cases_m).all() for s in solutions)
    assert (solutions[-1].mode != Mode.NONE).all()


def test_chassis_and_compass_are_read():
    navigator, truths = drives([1, 2], chassis={"fitted": True}, compass={"fitted": True})
    error, _ = errors(navigator, truths, 80)
    assert error.max() < 3.0
    m = navigator.measure(next(truths))
    assert m.chassis is not None
    assert m.compass is not None


def test_the_level_of_several_models_is_the_root_of_their_mixture():
    """Beside an independent root, one model's closed form, and the share of draws beyond the level."""
    mu, far, sigma = (
        np.array([[0.97, 0.03]]),
        np.array([[[0.1, 0.0], [1.5, 0.0]]]),
        np.array([[[0.4, 0.4], [1.2, 1.2]]]),
    )
    budgets = np.array([[1e-2, 5e-3], [1e-7, 1e-7], [0.0, 1e-3]])

    def levels(mu, far, sigma):
        rows = [[mixture_level(mu[0], far[0, :, q], sigma[0, :, q], 0.5 * b[q], norm.isf(0.5 * b[q]))
                 for q in range(2)] for b in budgets]  # fmt: skip
        return np.array(rows)[None]

    found = levels(mu, far, sigma)
    for k, q in np.ndindex(2, 2):
        tail = brentq(
            lambda x, k=k, q=q: mu[0] @ norm.sf((x - far[0, :, q]) / sigma[0, :, q]) - 0.5 * budgets[k, q], 0.0, 50.0
        )
        assert found[0, k, q] == pytest.approx(tail, rel=1e-6)
    assert np.isinf(found[0, 2, 0])
    mean, spread = mu[0] @ far[0, :, 0], np.sqrt(mu[0] @ (sigma[0, :, 0] ** 2 + far[0, :, 0] ** 2))
    assert found[0, 1, 0] > 1.5 * (mean + norm.isf(0.5e-7) * spread)  # a normal law of the same moments is too small
    same = levels(mu, far[:, :1].repeat(2, 1), sigma[:, :1].repeat(2, 1))
    alone = levels(mu[:, :1] / mu[:, :1], far[:, :1], sigma[:, :1])
    np.testing.assert_allclose(same, alone, rtol=1e-9)
    assert alone[0, 1, 0] == pytest.approx(0.1 + norm.isf(0.5e-7) * 0.4)
    rng = np.random.default_rng(1)
    which = (rng.random(200_000) > mu[0, 0]).astype(int)
    error = rng.choice([-1.0, 1.0], which.size) * far[0, which, 0] + sigma[0, which, 0] * rng.standard_normal(
        which.size
    )
    assert np.sum(np.abs(error) > found[0, 0, 0]) <= binom.isf(1e-3, which.size, 1e-2)


def test_an_outage_grows_the_levels_and_ends():
    navigator, truths = drives([4, 5])
    errors(navigator, truths, 30)
    before = navigator.report.htl_m.copy()
    error, solutions = errors(navigator, truths, 80, without_gnss)
    assert (solutions[-1].mode == Mode.IMU_ODOMETER).all()
    assert (navigator.report.htl_m > before).all()
    assert (error <= np.array([np.hypot(s.pl_at_m, s.pl_ct_m) for s in solutions])).all()


def test_rows_are_independent_and_the_state_resumes():
    navigator, truths = drives([7, 8, 9])
    alone, own = drives([8])
    for k in range(30):
        together, single = navigator.step(next(truths)), alone.step(next(own))
        assert np.array_equal(together.position_en_m[1], single.position_en_m[0])
        assert np.array_equal(together.pl_cases_m[1], single.pl_cases_m[0])
        if k == 20:
            kept = navigator.snapshot()
    ahead = [next(truths) for _ in range(5)]
    navigator.restore(kept)
    first = [navigator.step(t).position_en_m for t in ahead]
    navigator.restore(kept)
    again = [navigator.step(t).position_en_m for t in ahead]
    assert np.array_equal(first, again)


def test_a_vehicle_is_placed_without_touching_others():
    navigator, truths = drives([1, 2])
    errors(navigator, truths, 20)
    before = navigator.state.belief.models["x"][0].copy()
    bias = navigator.state.belief.models["p"][1, 0, 8, 8]
    navigator.place(np.array([[5.0, 6.0]]), np.array([0.3]), 0.1, 0.01, rows=np.array([1]))
    b = navigator.state.belief
    assert np.array_equal(b.models["x"][0], before)
    np.testing.assert_allclose(b.models["x"][1, :, :3], [[5.0, 6.0, 0.3]] * 2)
    assert b.models["p"][1, 0, 8, 8] == bias  # what is known of the gyro stays


def test_a_cold_start_ends_with_levels():
    """No level before the heading is known: by the Doppler velocity of a moving car."""
    navigator, truths = drives([1, 2], start=False)
    error, solutions = errors(navigator, truths, 100)
    assert np.isinf(solutions[0].pl_at_m).all()
    assert (solutions[0].reason == AlertReason.INITIALISING.code).all()
    assert np.isfinite(solutions[-1].pl_at_m).all()
    assert (error[-1] < np.hypot(solutions[-1].pl_at_m, solutions[-1].pl_ct_m)).all()
    known = np.array([np.isfinite(s.pl_at_m) for s in solutions])
    assert (np.diff(known.astype(int), axis=0) >= 0).all()


def shifted(m, k):
    """All codes of a position 40 m to the East from 6 s on: consistent among themselves, so no residual shows it."""
    if not k >= 60:
        return m
    shift = -(m.sky.los_enu[m.sky.index] @ np.array([40.0, 0.0, 0.0]))
    there = m.gnss.raw_code_m != 0.0
    return replace(m, gnss=replace(m.gnss, raw_code_m=m.gnss.raw_code_m + np.where(there, shift[..., None], 0.0)))


def test_the_gate_rejects_spurious_positions():
    """S4 scenarios 5 and 6: with the gate a spurious position does nothing, without it the position follows."""
    navigator, truths = drives([1, 2])
    error, _ = errors(navigator, truths, 130, shifted)
    assert error.max() < 3.0
    assert (navigator.state.belief.vehicles["rejected"][:, 0] > 5.0).all()
    open_gate, truths = drives([1, 2], gate={"enabled": False}, position={"excess_tau_s": 0.0})
    wrong, _ = errors(open_gate, truths, 130, shifted)
    assert wrong.max() > 2.0 * error.max()


def test_the_noise_of_positions_grows_with_their_innovations():
    """Without the gate, a filter that remembers innovations follows a spurious position less, with larger levels."""
    forgetful, truths = drives([1, 2], gate={"enabled": False}, position={"excess_tau_s": 0.0})
    follows, _ = errors(forgetful, truths, 130, shifted)
    mindful, truths = drives([1, 2], gate={"enabled": False})
    holds, _ = errors(mindful, truths, 130, shifted)
    assert holds.max() < 0.7 * follows.max()
    assert (mindful.state.belief.vehicles["excess"] > 3.0).all()
    quiet, truths = drives([1, 2])
    errors(quiet, truths, 130)
    assert (quiet.state.belief.vehicles["excess"] < 2.0).all()


def test_levels_grow_by_the_misfit_of_positions():
    """By the root of the mean NIS / 2; the published level does not."""
    cases = {"more_levels": [{"integrity_risk": 1e-3}, {"integrity_risk": 1e-7, "variant": "published"}]}
    navigator, truths = drives([1, 2], **cases)
    solution = errors(navigator, truths, 70, shifted)[1][-1]
    excess = navigator.state.belief.vehicles["excess"]
    assert (excess > 3.0).all()
    b, heading = navigator.state.belief, solution.heading_rad
    t = np.stack([np.sin(heading), np.cos(heading)], -1)[:, None]  # along
    far = np.abs((t * (b.models["x"][..., :2] - solution.position_en_m[:, None])).sum(-1))
    moved = (t[..., None] * b.influence[:, :, :2]).sum(2)
    far += np.abs(moved[..., :5]) @ bounds_of(navigator.config)
    own, every = b.models["p"][..., :2, :2], t + 0 * far[..., None]
    sigma = np.sqrt(np.einsum("bri,brij,brj->br", every, own, every) + np.square(moved[..., 5:]).sum(-1))
    least = np.min(far + norm.isf(0.5e-3) * sigma, -1)  # of one model, at no less than the budget of one side
    assert (solution.pl_cases_m[:, 1, 0] >= np.sqrt(excess) * 0.9 * least).all()
    np.testing.assert_allclose(solution.pl_cases_m[:, 2], np.repeat(navigator.report.htl_m[:, None], 2, 1))


def test_the_levels_grow_by_the_misfit_only_where_configured():
    """One drive with spurious positions, with and without level_misfit: the same states, levels larger by sqrt(m)."""
    (with_it, truths), (plain, others) = drives([1, 2]), drives([1, 2], position={"level_misfit": False})
    wide, small = errors(with_it, truths, 70, shifted)[1][-1], errors(plain, others, 70, shifted)[1][-1]
    assert np.array_equal(wide.position_en_m, small.position_en_m)
    m = with_it.state.belief.vehicles["excess"]
    np.testing.assert_allclose(wide.pl_at_m, np.sqrt(m) * small.pl_at_m, rtol=1e-12)


def test_a_misfit_beyond_its_limit_raises_an_alert():
    """40 m off, rejected: the mean NIS shows it within some seconds; limits are wide, so that nothing else alerts."""
    limits = {"limits": {"al_at_m": 1e4, "al_ct_m": 1e4, "accuracy_at_m": None, "accuracy_ct_m": None}}
    (navigator, truths), (silent, others) = (
        drives([1, 2], alert=limits),
        drives([1, 2], alert=limits, gate={"misfit_alert": None}),
    )
    seen, quiet = errors(navigator, truths, 130, shifted)[1], errors(silent, others, 130, shifted)[1]
    failed = AlertReason.INTEGRITY_TEST_FAILED.code
    assert all((s.reason != failed).all() for s in seen[:60])
    assert not any(s.alert.any() for s in seen[30:60])
    assert (seen[-1].reason == failed).all()
    assert seen[-1].alert.all()
    assert not seen[-1].available.any()
    assert all((s.reason != failed).all() for s in quiet)


def test_a_filter_that_rejects_for_long_doubts_itself():
    """After 3 s of rejections it begins anew, 40 m off; exact levels hold the distance, the published one does not."""
    published = [{"integrity_risk": 1e-7, "variant": "published"}]
    change = {"gate": {"lost_s": 3.0, "misfit_alert": None}, "compass": {"fitted": True}, "more_levels": published}
    navigator, truths = drives([1, 2], **change)
    _, solutions = errors(navigator, truths, 160, shifted)
    reasons = np.array([s.reason for s in solutions])
    assert (reasons == AlertReason.INTEGRITY_TEST_FAILED.code).any(0).all()
    doubt, last = navigator.state.belief.vehicles["doubt"], solutions[-1]
    assert (doubt > 30.0).all()
    assert np.isfinite(last.pl_at_m).all()
    assert (np.minimum(last.pl_at_m, last.pl_ct_m) > doubt).all()
    np.testing.assert_allclose(last.pl_cases_m[:, 1], np.repeat(last.trust_m[:, None], 2, 1))


def test_the_mode_is_code_only_while_positions_are_used():
    """Rejected positions are no positions: two seconds after the last used one the vehicle reckons."""
    navigator, truths = drives([1, 2])
    _, solutions = errors(navigator, truths, 110, shifted)
    modes = np.array([s.mode for s in solutions])
    assert (modes[40:60] == Mode.CODE).all()
    assert (modes[-25:] == Mode.IMU_ODOMETER).all()
    assert (navigator.state.belief.vehicles["fix_age"] < 1.05).all()  # positions were due each second
    assert (navigator.state.belief.vehicles["used_age"] > 3.0).all()


def test_the_trust_level_is_six_sigma_of_the_longer_axis():
    covariance = np.array([[[4.0, 0.0], [0.0, 1.0]], [[2.5, 1.5], [1.5, 2.5]]])
    for p in covariance:
        assert major_axis(p[0, 0], p[1, 1], p[0, 1]) == pytest.approx(2.0)
    navigator, truths = drives([1], more_levels=[{"integrity_risk": 1e-7, "variant": "published"}])
    solution = errors(navigator, truths, 30)[1][-1]
    np.testing.assert_allclose(solution.pl_cases_m[:, 1], np.repeat(navigator.report.htl_m[:, None], 2, 1))


def test_a_code_position_has_no_larger_error_than_it_states():
    """300 vehicles without slow errors under the open sky: 0.16 of the stated variance, which holds reflections too."""
    quiet = {"orbit_sigma_m": 0.0, "clock_sigma_m": 0.0, "iono_zenith_m": 0.0, "tropo_zenith_m": 0.0}
    c = config(gnss={"broadcast": quiet, "undifferenced": True})
    navigator = Navigator.nominal(c, 3, 300, duration_s=20.0)
    car = CityDrive(BEND, DriveConfig(), c.dt_s)
    traffic = Streams(3, 300)
    state = car.start(traffic)
    for _ in range(5):
        truth = car.step(state, traffic)
        m = navigator.measure(truth)
    fix = locate_by_codes(navigator.config.position.codes, m)
    error = fix.position_m[:, :2] - truth.position_enu_m[:, :2]
    assert fix.valid.all()
    ratio = np.square(error).sum(-1) / np.trace(fix.fast_m2, axis1=1, axis2=2)
    assert 0.08 < ratio.mean() < 0.3


def test_a_wrong_first_heading_has_no_level():
    """Doppler across the heading, as long as that of the wheels: the positions that must confirm it do not fit."""

    def turned_doppler(m, k):
        wrong = m.odometer.speed_mps[:, None] * m.sky.los_enu[m.sky.index][..., 1]  # as if driving South
        return replace(m, gnss=replace(m.gnss, range_rate_mps=np.where(m.gnss.tracked, wrong, 0.0))) if k < 40 else m

    navigator, truths = drives([1, 2, 3, 4], start=False)
    error, solutions = errors(navigator, truths, 160, turned_doppler)
    level = np.array([np.hypot(s.pl_at_m, s.pl_ct_m) for s in solutions])
    assert (error <= level).all()
    wrong = np.array([np.abs(s.heading_rad - np.pi / 2) > 1.0 for s in solutions[:50]])
    assert wrong.any(0).all()
    assert np.isfinite(level[-1]).all()


def test_odometry_inverts_the_geometry_of_the_car():
    """A right turn of radius 20 m: yaw rate, speed and slip from the front left wheel (S4 eq 3)."""
    car = one_record(CAR, wheelbase=3.0, track=1.6, axle=1.5)[0]
    rate, radius = 0.4, 20.0
    angle = np.arctan(3.0 / (radius + 0.8))
    wheel = rate * np.hypot(radius + 0.8, 3.0)
    found = from_front_wheel(car, wheel, angle, 0.05, 0.002)
    assert found.rate == pytest.approx(rate, rel=1e-12)
    assert found.speed == pytest.approx(rate * np.hypot(radius, 1.5), rel=1e-12)
    assert found.slip == pytest.approx(np.arctan(1.5 / radius), rel=1e-12)
    assert rolling_slip(1.5, rate, found.speed) == pytest.approx(found.slip, rel=1e-12)


def test_wrong_configurations_are_refused():
    with pytest.raises(ConfigError, match="rows of sum 1"):
        config(transition=[[0.7, 0.2], [0.4, 0.6]])
    with pytest.raises(ConfigError, match="name each one once"):
        config(models=["curved", "curved"])


@pytest.mark.parametrize("preset", ["imm_differential", "imm_s4", "imm_sbas"])
def test_the_engine_navigates_as_a_single_environment(preset):
    """Presets drive environments and the vector engine, bit for bit alike in the same episode."""
    settings = {"navigator": preset, "duration_s": 2.0, "sky": "open", "observation": {"form": "flat"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=settings)
    env.reset(seed=1)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=2, config=settings)
    engine.reset(seed=1)
    for _ in range(8):
        seen, _, _, _, info = env.step(np.zeros(2, np.float32))
        rows, _, _, _, infos = engine.step(np.zeros((2, 2), np.float32))
    for name in ("pl_at_m", "pl_ct_m", "err_at_m", "err_ct_m"):
        assert info[name] == infos[name][0]
    assert np.array_equal(seen, rows[0])
    assert info["mode"] in (Mode.CODE, Mode.IMU_ODOMETER)
    assert abs(info["err_ct_m"]) < info["pl_ct_m"] < 20.0
    env.close()
    engine.close()


def test_a_model_that_none_leads_to_is_refused():
    with pytest.raises(ConfigError, match=r"transition must reach each model, got the column \[0\.0, 0\.0\] of curved"):
        config(transition=[[1.0, 0.0], [1.0, 0.0]])
    models = np.zeros(2, MODEL)
    mixing_weights(models, np.array([0.5, 0.5]), np.array([[1.0, 0.0], [1.0, 0.0]]), True)
    assert np.isfinite(models["weight"]).all()


def few_satellites(m, count):
    """The first satellites that are tracked, for each vehicle."""
    rank = np.cumsum(m.gnss.tracked, -1)
    return replace(m, gnss=replace(m.gnss, tracked=m.gnss.tracked & (rank <= count)))


def test_a_known_height_counts_beside_a_redundant_code_alone():
    """Three codes of one system and a height: solvable, and nothing would show a wrong one of them."""
    more = {"sky": {"gps": 24, "galileo": 0, "glonass": 0, "beidou": 0}}
    navigator, truths = drives([1, 2], **more)
    for _ in range(10):
        m = navigator.measure(next(truths))
    plain = navigator.config.position.codes
    known = plain.replace(height_sigma_m=0.5)
    three = locate_by_codes(known, few_satellites(m, 3))
    assert (three.satellites == 3).all()
    assert (three.hdop > 0.0).all()
    assert not three.valid.any()
    assert np.isinf(locate_by_codes(plain, few_satellites(m, 3)).hdop).all()
    every = locate_by_codes(known, m)
    assert every.valid.all()
    assert (every.hdop <= locate_by_codes(plain, m).hdop + 1e-9).all()


def test_a_first_position_has_the_constant_error_of_positions():
    navigator, truths = drives([1, 2], start=False)
    for _ in range(100):
        m = navigator.measure(next(truths))
        navigator.locate(m)
        b = navigator.state.belief
        begun = b.vehicles["known"] & (b.vehicles["fix_age"] == 0.0) & (b.vehicles["unconfirmed"] == 3)
        if begun.any():
            break
    assert begun.any()
    np.testing.assert_allclose(b.influence[begun][:, :, [0, 1], [0, 1]], 1.0)
    fix = locate_by_codes(navigator.config.position.codes, m)  # its fast error lasts: variance by root 2
    began = np.sqrt(2.0) * fix.fast_m2[begun] + fix.slow_m2[begun]
    np.testing.assert_allclose(b.models["p"][begun][:, 0, :2, :2], began, rtol=1e-9)
    navigator.place(np.zeros((2, 2)), np.zeros(2), 0.1, 0.01)
    assert not navigator.state.belief.influence[:, :, :2].any()


def test_a_creep_that_the_odometer_shows_as_rest_is_within_the_levels():
    """60 s at 0.1 m/s along a straight road: the odometer shows 0 throughout."""
    c = config()
    navigator = Navigator.nominal(c, [1, 2], duration_s=80.0)
    car = CityDrive(BEND, DriveConfig(), c.dt_s)
    traffic = Streams([1, 2])
    state = car.start(traffic)
    navigator.place(state.position_m.copy(), state.heading_rad.copy(), 0.05, np.deg2rad(0.5))
    truth = car.step(state, traffic)
    start, still = truth.position_enu_m.copy(), np.zeros_like(truth.velocity_enu_mps)
    along = np.array([1.0, 0.0, 0.0])
    for k in range(600):
        position = start + 0.1 * c.dt_s * (k + 1) * along
        t = replace(truth, position_enu_m=position, velocity_enu_mps=still + 0.1 * along)
        m = navigator.measure(t)
        m = replace(m, odometer=replace(m.odometer, speed_mps=np.zeros(2), distance_m=np.zeros(2)),
                    imu=replace(m.imu, delta_v_mps=np.zeros((2, 3)), delta_theta_rad=np.zeros((2, 3))))  # fmt: skip
        s = navigator.locate(m)
        error = np.abs(s.position_en_m - position[:, :2])
        assert (error[:, 0] <= s.pl_at_m).all()
        assert (error[:, 1] <= s.pl_ct_m).all()
    assert (s.pl_at_m < 20.0).all()  # positions at rest bound it


SBAS = {"position": {"codes": {"source": "sbas"}}, "gnss": {"augmentation": {"warm": True}}}


def test_sbas_corrects_codes_as_its_service_does():
    """64 vehicles of as many skies: SBAS takes a part of the errors, its sigmas hold the rest, HPL_SBAS is theirs."""
    found = {}
    for source in ("undifferenced", "sbas"):
        c = config(position={"codes": {"source": source}})
        navigator = Navigator.nominal(c, list(range(64)), duration_s=20.0)
        car, traffic = CityDrive(BEND, DriveConfig(), c.dt_s), Streams(list(range(64)))
        state = car.start(traffic)
        for _ in range(5):
            truth = car.step(state, traffic)
            m = navigator.measure(truth)
        fix = locate_by_codes(c.position.codes, m)
        assert fix.valid.all()
        error = fix.position_m[:, :2] - truth.position_enu_m[:, :2]
        found[source] = np.sqrt(np.square(error).sum(-1).mean())
        ratio = np.square(error).sum(-1) / np.trace(fix.fast_m2 + fix.slow_m2, axis1=1, axis2=2)
    assert ratio.mean() < 0.6  # of SBAS, which declares 2.3 sigma
    assert found["sbas"] < 0.75 * found["undifferenced"]
    held = m.gnss.corrections["sbas_l1"]
    corrected = np.isfinite(held.declared_m)
    assert (fix.own_m2[:, ~corrected] == 0.0).all()
    sine = m.sky.los_enu[m.sky.index][..., 2]
    slant2 = 1.0 / (1.0 - (6378136.3 / 6728136.3) ** 2 * (1.0 - sine**2))
    declared = held.declared_m**2 + slant2 * held.zenith_declared_m**2
    grown = declared + 1e-3 * held.age_s[:, None] + slant2 * 0.006 * held.zenith_age_s[:, None]
    used = fix.own_m2 > 0.0
    np.testing.assert_allclose(fix.own_m2[used], grown[used], rtol=1e-9)
    navigator.locate(m)
    q = fix.fast_m2 + fix.slow_m2
    hpl = np.sqrt([np.linalg.eigvalsh(v)[-1] for v in q]) * 6.18  # K_H en route, DO-229D
    np.testing.assert_allclose(navigator.report.hpl_sbas_m, hpl, rtol=1e-9)


def test_sbas_that_is_too_old_gives_no_position():
    navigator, truths = drives([1, 2], **SBAS)
    for _ in range(5):
        m = navigator.measure(next(truths))
    assert locate_by_codes(navigator.config.position.codes, m).valid.all()
    held = m.gnss.corrections["sbas_l1"]
    for late in ({"age_s": np.array([18.1, 0.0])}, {"zenith_age_s": np.array([np.inf, 0.0])}):
        old = replace(m, gnss=replace(m.gnss, corrections={"sbas_l1": replace(held, **late)}))
        fix = locate_by_codes(navigator.config.position.codes, old)
        assert not fix.valid[0]
        assert np.isfinite(fix.position_m).all()
        assert np.isfinite(fix.slow_m2).all()
    with pytest.raises(ConfigError, match=r"gnss\.bands must begin with 0"):
        config(position={"codes": {"source": "sbas"}}, gnss={"bands": [2]})


def test_a_filter_by_sbas_is_within_its_levels():
    navigator, truths = drives([1, 2, 3], **SBAS)
    error, solutions = errors(navigator, truths, 130)
    assert (error <= np.array([np.hypot(s.pl_at_m, s.pl_ct_m) for s in solutions])).all()
    assert navigator.state.belief.vehicles["biased"].all()  # positions were used
