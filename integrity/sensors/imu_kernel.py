"""Inertial increments of one vehicle as a linear map of its error state and the draws of the epoch."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit

# coefficients of a triad: rows of ``coef`` (2, NC), gyro first
TURN_ON, WHITE, DECAY, END_1, INTEGRAL, INTEGRAL_1, INTEGRAL_2, WALK_END_1, WALK_1, WALK_2 = range(10)
NC = 10


@jit
def measure_triad(v, t, coef, z, turn_on, scale, instability, walk, truth, out):  # type: ignore[no-untyped-def]
    """Increments ``out`` of triad t of vehicle v; ``instability`` and ``walk`` advance in place, z are the draws."""
    for i in range(3):
        error = coef[t, TURN_ON] * (turn_on[v, t, i] + walk[v, t, i]) + coef[t, WHITE] * z[v, t, i, 0]
        error += coef[t, INTEGRAL] * instability[v, t, i]
        error += coef[t, INTEGRAL_1] * z[v, t, i, 1] + coef[t, INTEGRAL_2] * z[v, t, i, 2]
        error += coef[t, WALK_1] * z[v, t, i, 3] + coef[t, WALK_2] * z[v, t, i, 4]
        instability[v, t, i] = coef[t, DECAY] * instability[v, t, i] + coef[t, END_1] * z[v, t, i, 1]
        walk[v, t, i] += coef[t, WALK_END_1] * z[v, t, i, 3]
        out[v, i] = truth[v, i] * (1.0 + scale[v, t, i]) + error


@jit
def measure(  # type: ignore[no-untyped-def]
    coef, dt, moving_m, warm_up_mps, z, turn_on, scale, instability, walk, moving_bias, fault, distance, theta, delta_v,
    theta_out, delta_v_out,
):  # fmt: skip
    """All vehicles: ``theta``, ``delta_v`` (B, 3) true, z (B, 2, 3, 5), states (B, 2, 3), yaw gyro biases (B,)."""
    for v in range(theta.shape[0]):
        measure_triad(v, 0, coef, z, turn_on, scale, instability, walk, theta, theta_out)
        measure_triad(v, 1, coef, z, turn_on, scale, instability, walk, delta_v, delta_v_out)
        theta_out[v, 2] += fault[v] * dt
        if abs(distance[v]) > moving_m:
            theta_out[v, 2] += moving_bias[v] * dt
        for i in range(3):
            delta_v_out[v, i] += warm_up_mps[v]
