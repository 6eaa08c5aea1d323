"""NEES and NIS of the product where true and declared errors are the same: 300 cars that move as a model says.

The kernels are those of the navigator (``run_filters``); the test draws truth and measurements by the declared laws.
The bands hold a mean that is 1 with probability 0.999 each (chi-square, 300 cars).
"""

import numpy as np
import pytest
from scipy.stats import chi2

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.vehicle_filter.navigator import blank_state, run_filters
from lanebound.integrity.navigators.vehicle_filter.parameters import filter_parameters, level_cases
from lanebound.integrity.navigators.vehicle_filter.records_kernel import MEASURED, POSITION, SLOW_ERROR, PositionFix
from lanebound.integrity.navigators.vehicle_filter.start_kernel import give_headings, place_vehicles
from lanebound.integrity.positioning.filters.vehicle_models import S

CARS, DT, EPOCHS = 300, 0.1, 200
FAST_M, SLOW_M, SLOW_S = 1.0, 1.5, 300.0  # of positions
MATCHED = {
    "compass": {"fitted": True},
    "gate": {"enabled": False},
    "straight": {"yaw_acceleration": 0.05, "slip": 1e-6, "slide": 0.0},
    "curved": {"yaw_acceleration": 0.05, "slip": 1e-6, "slide": 0.0},
    "position": {"fast_tau_s": 0.0, "excess_tau_s": 0.0, "slow_tau_s": SLOW_S},
    "motion": {"speed_tau_s": 0.0, "compass_tau_s": 0.0, "slip_sigma_deg": 1e-3, "slide_sigma_deg": 0.0,
               "accelerometer_density": 0.05},
    "positioning": {"heading": {"gyro_scale": 0.0}, "dead_reckoning": {"heading_bias_deg": 0.0}},
}  # fmt: skip


def band(dimension=1, share=1e-3):
    """Of the mean over cars of a quantity whose expectation is 1."""
    n = CARS * dimension
    return chi2.ppf([0.5 * share, 1.0 - 0.5 * share], n) / n


class World:
    """Truth of cars without slip, and what their sensors show by the declared laws."""

    def __init__(self, c):
        self.c, self.rng = c, np.random.default_rng(8)
        n, h, m = self.normal, c.positioning.heading, c.motion
        self.place, self.heading = 2.0 * n(2), 0.03 * n()
        self.rate, self.speed = 0.05 * n(), 12.0 + 0.0 * n()
        self.bias, self.scale = h.bias_initial_radps * n(), c.wheel_scale * n()
        self.force = m.accelerometer_bias_mps2 * n()
        self.deviation, self.slow = np.deg2rad(m.compass_deviation_deg) * n(), SLOW_M * n(2)

    def normal(self, *shape):
        return self.rng.standard_normal((CARS, *shape))

    def step(self, k):
        """One epoch: a yaw acceleration and an acceleration that are white."""
        c, n, m, h = self.c, self.normal, self.c.motion, self.c.positioning.heading
        white, own = c.straight.yaw_acceleration / np.sqrt(DT) * n(2).T
        a = 0.3 * n()
        noise, shaken = m.accelerometer_density / np.sqrt(DT) * n(2).T
        course = self.heading
        along, across = DT * self.speed + 0.5 * DT**2 * a, 0.5 * DT**2 * self.speed * self.rate
        drawn = DT**2 / np.sqrt(12.0) * shaken
        east, north = np.sin(course), np.cos(course)
        self.place = self.place + np.stack([east * (along + drawn) + north * across,
                                            north * (along + drawn) - east * across], -1)  # fmt: skip
        turned = DT * self.rate + 0.5 * DT**2 * white + DT**2 / np.sqrt(12.0) * own
        self.heading, self.rate, self.speed = self.heading + turned, self.rate + DT * white, self.speed + DT * a
        gyro = turned + DT * self.bias + h.angle_random_walk_rad * np.sqrt(DT) * n()
        self.bias = self.bias + h.bias_walk_radps * np.sqrt(DT) * n()
        push = a + self.force - noise
        self.force = self.force + m.accelerometer_walk * np.sqrt(DT) * n()
        # the wheels show v (1 - s) and noise, as the linear observation says; the odometer half an epoch before
        shown = (self.speed + m.speed_sigma_mps * n()) / (1.0 - self.scale) - 0.5 * DT * push
        compass = self.heading + self.deviation + np.deg2rad(m.compass_sigma_deg) * n()
        motion = np.zeros(CARS, MEASURED)
        motion["turn"][:, 2], motion["delta_v"][:, 0] = gyro, DT * push
        motion["speed"], motion["distance"], motion["compass"] = shown, shown * DT, compass
        return motion, self.fix(k % 10 == 9)

    def fix(self, due):
        """A position each second, with a slow error that is a Markov process."""
        found, eye = np.zeros(CARS, POSITION), np.eye(2)
        if due:
            found["position"][:, :2] = self.place + self.slow + FAST_M * self.normal(2)
            decay = np.exp(-1.0 / SLOW_S)
            self.slow = decay * self.slow + np.sqrt(1.0 - decay**2) * SLOW_M * self.normal(2)
        found["fast"], found["slow"], found["velocity_m2"] = FAST_M**2 * eye, SLOW_M**2 * eye, eye
        found["valid"], found["common"] = due, SLOW_M * eye
        return PositionFix(found, np.zeros((CARS, 1), SLOW_ERROR))

    def errors(self, x):
        """Estimate less truth of what both know, (CARS, 9)."""
        true = np.column_stack([self.place, self.heading, self.rate, self.speed, self.bias, self.scale, self.force,
                                self.deviation])  # fmt: skip
        return x[:, KNOWN] - true


KNOWN = [S.EAST, S.NORTH, S.HEADING, S.YAW_RATE, S.SPEED, S.GYRO_BIAS, S.WHEEL_SCALE, S.ACCEL_BIAS, S.COMPASS]


@pytest.mark.parametrize("kind", ["ekf", "ukf", "imm"])
def test_nees_and_nis_are_in_their_bands(kind):
    c = NavigatorConfig.load({"kind": "filter", "filter": kind, **MATCHED})
    world, state, par, cases = World(c), blank_state(c, CARS, 1), filter_parameters(c), level_cases(c)
    rows = np.arange(CARS)
    place_vehicles(state, rows, np.zeros((CARS, 2)), 4.0)
    give_headings(state, rows, np.zeros(CARS), 0.03)
    for k, sigma in ((S.YAW_RATE, 0.05), (S.SPEED, 1e-6), (S.SLIP, 1e-6), (S.SLIP_RATE, 0.0)):
        p = state.models["p"]
        state.models["x"][..., k] = 12.0 if k == S.SPEED else 0.0
        p[..., k, :] = p[..., :, k] = 0.0
        p[..., k, k] = sigma**2
    nis = np.zeros((2, CARS))
    for k in range(EPOCHS):
        out, _ = run_filters(par, cases, state, *world.step(k))
        nis += [out["nis"][:, 0] / 2.0, out["nis"][:, 1]]
        if k in (9, 99, EPOCHS - 1):
            x = np.einsum("bj,bjk->bk", state.probability, state.models["x"])
            error, p = world.errors(x), state.models["p"][:, 0][:, KNOWN][:, :, KNOWN]
            single = np.square(error).mean(0) / np.einsum("bii->i", p) * CARS
            low, high = band()
            assert ((low < single) & (single < high)).all(), (k, single)
            whole = np.einsum("bi,bij,bj->b", error, np.linalg.inv(p), error).mean() / len(KNOWN)
            low, high = band(len(KNOWN))
            assert low < whole < high, (k, whole)
    for mean, count in ((nis[0].mean() / (EPOCHS / 10), EPOCHS / 10 * 2), (nis[1].mean() / EPOCHS, EPOCHS)):
        low, high = chi2.ppf([5e-4, 1.0 - 5e-4], CARS * count) / (CARS * count)
        assert low < mean < high
