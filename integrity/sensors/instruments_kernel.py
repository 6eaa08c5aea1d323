"""All instruments of a run of vehicles over one epoch, in one call: sky mask, link, receiver, gyros, wheels."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.sensors import corrections_kernel as links
from lanebound.integrity.sensors import imu_kernel as inertial
from lanebound.integrity.sensors import odometer_kernel as wheels
from lanebound.integrity.sensors.gnss_kernel import observe_serial
from lanebound.integrity.sky.raytrace_kernel import look_up


@jit
def sense_some(  # type: ignore[no-untyped-def]
    a, b, dt, los, elevation, azimuth, above, system, index,
    table_path, table_excess, spacing, length, closed, azimuths, elevations,
    position, velocity, turn, delta_v, distance, arc, lane,
    link, now, message, fresh, link_u, link_z, lost, network_up, until, newest, outage_left, up, sent, held,
    receiver, wavelength, dispersion, spoof, reference, reference_fault, code_bias, phase_bias, rate_bias,
    cn0_drop, slips, clock, z_clock, station_clock, z, u, area, oscillator, memory, ambiguity,
    imu, moving_m, warm_up_mps, imu_z, turn_on, scale, instability, walk, moving_bias, gyro_fault,
    odometer, odometer_z, odometer_scale, wheel_fault, frozen, odometer_noise, carry, last_distance, last_true,
    age, tracked, code, phase, range_rate, cn0, lock_lost, theta_out, delta_v_out, distance_out, speed_out,
):  # fmt: skip
    """Vehicles ``a`` to ``b - 1``: states advance in place, the last eleven arrays, (B, ...) of zeros, are filled.

    The arguments are those of :func:`look_up`, of ``advance`` of the link, :func:`observe_serial` and of ``measure`` of
    gyros and wheels; ``link_u`` and ``link_z`` are empty where the link has no outages.
    """
    path, excess = look_up(
        table_path, table_excess, arc[a:b], lane[a:b], azimuth, elevation, index[a:b], spacing, length, closed,
        azimuths, elevations,
    )  # fmt: skip
    first, last = (0, 1) if area.shape[0] == 1 else (a, b)  # one area for all, or one for each
    links.advance(
        link, now[first:last], dt, message[first:last], fresh[first:last], link_u[a:b], link_z[a:b], lost[a:b],
        network_up[first:last], until[first:last], newest[a:b], outage_left[a:b], up[a:b], sent[first:last], held[a:b],
        age[a:b],
    )  # fmt: skip
    observe_serial(
        receiver, wavelength, dispersion, los, above, system, index[a:b], path, excess,
        position[a:b] + spoof[a:b], velocity[a:b], reference[first:last] + reference_fault[a:b], age[a:b],
        code_bias[a:b], phase_bias[a:b], rate_bias[a:b], cn0_drop[a:b], slips[a:b], clock[a:b], z_clock[a:b],
        station_clock[first:last], z[a:b], u[a:b], area[first:last], held[a:b], oscillator[a:b], memory[a:b],
        ambiguity[a:b], tracked[a:b], code[a:b], phase[a:b], range_rate[a:b], cn0[a:b], lock_lost[a:b],
    )  # fmt: skip
    inertial.measure(
        imu, dt, moving_m, warm_up_mps[a:b], imu_z[a:b], turn_on[a:b], scale[a:b], instability[a:b], walk[a:b],
        moving_bias[a:b], gyro_fault[a:b], distance[a:b], turn[a:b], delta_v[a:b], theta_out[a:b], delta_v_out[a:b],
    )  # fmt: skip
    wheels.measure(
        odometer, dt, odometer_z[a:b], odometer_scale[a:b], wheel_fault[a:b], frozen[a:b], odometer_noise[a:b],
        carry[a:b], last_distance[a:b], last_true[a:b], distance[a:b], distance_out[a:b], speed_out[a:b],
    )  # fmt: skip
