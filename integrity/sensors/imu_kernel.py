"""Inertial increments of one vehicle as a linear map of its error state and the draws of the epoch."""

from __future__ import annotations

from lanebound.integrity.accel import jit

# coefficients of a triad: rows of ``coef`` (2, NC), gyro first
TURN_ON, WHITE, DECAY, END_1, INTEGRAL, INTEGRAL_1, INTEGRAL_2, WALK_END_1, WALK_1, WALK_2 = range(10)
NC = 10


@jit
def measure_triad(coef, z, turn_on, scale, instability, walk, truth, out):  # type: ignore[no-untyped-def]
    """Increments ``out`` (3,) of one triad; ``instability``, ``walk`` (3,) advance in place, z (3, 5) are the draws."""
    for i in range(3):
        error = coef[TURN_ON] * (turn_on[i] + walk[i]) + coef[WHITE] * z[i, 0]
        error += coef[INTEGRAL] * instability[i] + coef[INTEGRAL_1] * z[i, 1] + coef[INTEGRAL_2] * z[i, 2]
        error += coef[WALK_1] * z[i, 3] + coef[WALK_2] * z[i, 4]
        instability[i] = coef[DECAY] * instability[i] + coef[END_1] * z[i, 1]
        walk[i] += coef[WALK_END_1] * z[i, 3]
        out[i] = truth[i] * (1.0 + scale[i]) + error


@jit
def measure(  # type: ignore[no-untyped-def]
    coef, dt, moving_m, warm_up_mps, z, turn_on, scale, instability, walk, moving_bias, fault, distance, theta, delta_v,
    theta_out, delta_v_out,
):  # fmt: skip
    """All vehicles: ``theta``, ``delta_v`` (B, 3) true, z (B, 2, 3, 5), states (B, 2, 3), yaw gyro biases (B,)."""
    for v in range(theta.shape[0]):
        measure_triad(
            coef[0], z[v, 0], turn_on[v, 0], scale[v, 0], instability[v, 0], walk[v, 0], theta[v], theta_out[v]
        )
        measure_triad(
            coef[1], z[v, 1], turn_on[v, 1], scale[v, 1], instability[v, 1], walk[v, 1], delta_v[v], delta_v_out[v]
        )
        theta_out[v, 2] += fault[v] * dt
        if abs(distance[v]) > moving_m:
            theta_out[v, 2] += moving_bias[v] * dt
        for i in range(3):
            delta_v_out[v, i] += warm_up_mps[v]
