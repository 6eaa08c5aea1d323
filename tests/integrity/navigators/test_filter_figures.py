"""What a filter declares: literal figures, the reference's own formulas, simulated sums, and constant biases."""

import numpy as np
import plain_filter_figures as plain
import pytest
from scipy.stats import chi2, norm

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.vehicle_filter.navigator import blank_state, run_filters
from lanebound.integrity.navigators.vehicle_filter.parameters import correlation_factor, filter_parameters, level_cases
from lanebound.integrity.navigators.vehicle_filter.records_kernel import MEASURED, POSITION, SLOW_ERROR, PositionFix
from lanebound.integrity.navigators.vehicle_filter.start_kernel import give_headings, place_vehicles
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES

OTHER = {
    "filter": "ekf", "models": ["curved"], "chassis": {"fitted": True}, "compass": {"fitted": True},
    "position": {"bias_m": 0.7, "fast_tau_s": 8.0, "rest_interval_s": 4.0, "codes": {"source": "differential"}},
    "motion": {"wheel_scale": 0.02, "creep_tau_s": 7.0, "speed_tau_s": 0.5, "steering_tau_s": 10.0,
               "compass_tau_s": 3.0, "accelerometer_bias_mps2": 0.2, "compass_deviation_deg": 3.0},
    "positioning": {"dead_reckoning": {"heading_bias_deg": 0.9, "odometer_bias_mps": 0.05}},
    "gate": {"gnss": 1e-2, "motion": 1e-5},
}  # fmt: skip


def config(**more):
    return NavigatorConfig.load({"kind": "filter", **more})


def test_the_default_figures_are_these():
    """Literal numbers, beside the fields that they come from."""
    par = filter_parameters(config())[0]
    np.testing.assert_allclose(par["bounds"], [0.1, 0.1, 0.0034906585, 0.01, 0.15], rtol=1e-7)
    for name, value in {
        "fast_factor": 10.0333111, "rest_factor": 120.0027778, "speed_factor": 4.0829882, "creep_factor": 100.0033333,
        "steering_factor": 1200.0002778, "compass_factor": 200.0016667, "gate_gnss": 13.8155106,
        "gate_compass": 10.8275662, "gate_motion": 32.8412534, "misfit_alert": 9.0,
    }.items():  # fmt: skip
        assert par[name] == pytest.approx(value, rel=1e-7), name
    p = blank_state(config(), 1, 3).models["p"][0, 0]
    sigma = {3: 0.2, 4: 3.0, 5: 0.0349065850, 6: 0.00174532925, 7: 0.05, 8: 0.007, 9: 0.0038, 11: 0.003, 12: 0.08,
             13: 0.0209439510}  # fmt: skip
    np.testing.assert_allclose(np.sqrt(np.diag(p)), [sigma.get(k, 0.0) for k in range(STATES)], rtol=1e-7)


@pytest.mark.parametrize("change", [{}, OTHER, {"sensor_errors": False}])
def test_the_figures_equal_the_reference(change):
    c = config(**change)
    par, motion = filter_parameters(c)[0], c.motion
    np.testing.assert_allclose(par["bounds"], plain.bounds_of(c), rtol=1e-12)
    found = par["fast_factor"], par["rest_factor"]
    np.testing.assert_allclose(found, plain.position_factors(c), rtol=1e-9)
    for name in ("speed", "creep", "steering", "compass"):
        expected = plain.lasting(getattr(motion, f"{name}_tau_s"), 0.1)
        assert par[f"{name}_factor"] == pytest.approx(expected, rel=1e-9)
    for name, share, size in (("gnss", c.gate.gnss, 2), ("compass", c.gate.gnss, 1), ("motion", c.gate.motion, 1)):
        assert par[f"gate_{name}"] == pytest.approx(plain.threshold(share, size), rel=1e-9)
    p, expected = blank_state(c, 2, 3).models["p"], np.zeros(STATES)
    for place, sigma in plain.priors_of(c).items():
        expected[place] = sigma**2
    np.testing.assert_allclose(p, np.broadcast_to(np.diag(expected), p.shape), rtol=1e-12)


@pytest.mark.parametrize("tau_steps", [2.0, 10.0])
def test_white_noise_of_that_factor_bounds_sums_of_a_lasting_error(tau_steps):
    """Variance of sums of simulated Gauss-Markov errors, over that of white ones times the factor: 1 for long sums, as
    3,000 draws say within 0.9999 of the chi-square law, and never more."""
    rng, phi, draws = np.random.default_rng(3), np.exp(-1.0 / tau_steps), 3000
    error, total, seen = rng.standard_normal(draws), np.zeros(draws), {}
    steps = round(200 * tau_steps)
    for k in range(1, steps + 1):
        total += error
        error = phi * error + np.sqrt(1.0 - phi**2) * rng.standard_normal(draws)
        if k in (3, round(tau_steps), steps):
            seen[k] = np.mean(total**2) / (k * correlation_factor(tau_steps, 1.0))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], draws) / draws
    assert all(ratio < high for ratio in seen.values())
    short = 1.0 - phi**2 / (tau_steps * 200 * (1 - phi**2) / 2.0)  # a sum of n steps has not all of it
    assert low * min(short, 0.99) < seen[steps]
    assert correlation_factor(0.0, 1.0) == 1.0


def moved(speed_mps, dt, batch):
    """Sensors of a car that drives North."""
    found = np.zeros(batch, MEASURED)
    found["speed"], found["distance"] = speed_mps, speed_mps * dt
    return found


def no_fix(batch, place=None, fast_m2=1e-6):
    """No position, or one (B, 2) without slow errors."""
    found = np.zeros(batch, POSITION)
    found["fast"], found["velocity_m2"] = fast_m2 * np.eye(2), np.eye(2)
    if place is not None:
        found["position"][:, :2], found["valid"] = place, True
    return PositionFix(found, np.zeros((batch, 1), SLOW_ERROR))


QUIET = {
    "filter": "ekf", "models": ["straight"],
    "straight": {"yaw_acceleration": 1e-5, "acceleration": 1e-5, "slip": 1e-6, "slide": 0.0},
    "motion": {"accelerometer": "off", "speed_sigma_mps": 1e-3, "speed_tau_s": 0.0, "slip_sigma_deg": 1e-3,
               "slide_sigma_deg": 0.0, "wheel_scale": 0.0, "accelerometer_bias_mps2": 0.0},
    "positioning": {"heading": {"bias_initial_radps": 1e-9, "bias_walk_radps": 1e-12, "gyro_scale": 0.0,
                                "angle_random_walk_rad": 1e-9},
                    "dead_reckoning": {"odometer_scale": 0.0}},
}  # fmt: skip


def quiet(**bounds):
    """A filter whose sensors are all but perfect beside these bounds of constant errors."""
    c = config(**QUIET)
    dead = c.positioning.dead_reckoning.replace(
        heading_bias_deg=bounds.get("course_deg", 0.0), odometer_bias_mps=bounds.get("speed_mps", 0.0)
    )
    return c.replace(
        positioning=c.positioning.replace(dead_reckoning=dead.to_dict()).to_dict(),
        position=c.position.replace(bias_m=bounds.get("position_m", 0.0)).to_dict(),
    )


def levels_after(c, speed_mps, seconds, place=lambda k: None):
    """Position and levels at 1e-3 along and across of a car that has reckoned North from a known pose."""
    c = c.replace(more_levels=[{"integrity_risk": 1e-3}])
    state, par, cases = blank_state(c, 1, 1), filter_parameters(c), level_cases(c)
    place_vehicles(state, np.zeros(1, np.int64), np.zeros((1, 2)), 1e-8)
    give_headings(state, np.zeros(1, np.int64), np.zeros(1), 1e-5)
    for k in range(round(seconds / c.dt_s)):
        out, levels = run_filters(par, cases, state, moved(speed_mps, c.dt_s, 1), no_fix(1, place(k)))
    return out["position"][0], levels[0, 1]


def test_a_constant_error_of_speed_is_within_the_level():
    """Wheels that show 0.2 m/s too much for 30 s: 6 m along, all but 1 % of the level; without the bound 0.1 m."""
    position, level = levels_after(quiet(speed_mps=0.2), 10.2, 30.0)
    error = position[1] - 300.0
    assert error == pytest.approx(6.0, rel=0.01)
    assert error < level[0] < 1.1 * error
    assert levels_after(quiet(), 10.2, 30.0)[1][0] < 0.1 * error


def test_a_constant_error_of_the_course_is_within_the_level():
    """A car that slips by 1 degree, which its geometry does not see, for 30 s at 10 m/s: 5.2 m across, but for
    the first epoch, in which the prior of the slip holds it."""
    error = 300.0 * np.sin(np.deg2rad(1.0))
    level = levels_after(quiet(course_deg=1.0), 10.0, 30.0)[1]
    assert 0.996 * error < level[1] < 1.2 * error
    assert levels_after(quiet(), 10.0, 30.0)[1][1] < 0.2 * error


def test_a_constant_error_of_positions_is_within_the_level_on_each_axis():
    """Precise positions 2 m off on both axes draw the filter there; the level says so."""
    c = quiet(position_m=2.0).replace(gate={"enabled": False})
    c = c.replace(position=c.position.replace(excess_tau_s=0.0, fast_tau_s=0.0, slow_tau_s=1.0).to_dict())

    def place(k):
        return np.array([2.0, 2.0 + k + 1.0]) if k > 20 else np.array([0.0, k + 1.0])

    c = c.replace(straight={**QUIET["straight"], "slip": 0.3, "acceleration": 3.0})
    position, level = levels_after(c, 10.0, 30.0, place)
    error = np.abs(position - [0.0, 300.0])[::-1]
    assert (error > 1.5).all()
    assert (error < level).all()


def test_a_prior_of_a_sensor_error_is_in_the_level():
    """A gyro bias of 1e-3 rad/s and a wheel scale of 1 %, 1 sigma, for 20 s at 10 m/s: 2 m each, times the quantile."""
    c = quiet()
    heading = c.positioning.heading.replace(bias_initial_radps=1e-3)
    c = c.replace(positioning=c.positioning.replace(heading=heading.to_dict()).to_dict(),
                  motion=c.motion.replace(wheel_scale=0.01).to_dict())  # fmt: skip
    level = levels_after(c, 10.0, 20.0)[1]
    budget = c.risk.axis_budgets([1e-3], c.risk.unmonitored_risk)[0]
    np.testing.assert_allclose(level, 2.0 * norm.isf(0.5 * budget), rtol=0.03)
    assert S.GYRO_BIAS in plain.priors_of(c)
