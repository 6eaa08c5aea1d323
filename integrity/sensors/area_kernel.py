"""What the vehicles of an area share, over one epoch: slow errors, noise of the station, and its clock."""

from __future__ import annotations

from lanebound.integrity.accel import jit


@jit
def advance(memory, clock, dt, column, decay, gain, z_slow, fresh, z_noise, l11, l21, l22, z_clock):  # type: ignore[no-untyped-def]
    """In place: memory (A, S, M), one ``column`` of it a Gauss-Markov step, the last ones white; clock (A, 2)."""
    slow = memory.shape[2] - z_noise.shape[2]
    for a in range(memory.shape[0]):
        for s in range(memory.shape[1]):
            memory[a, s, column] = decay * memory[a, s, column] + gain * z_slow[a, s]
        if fresh:
            memory[a, :, slow:] = z_noise[a]
        clock[a, 0] += dt * clock[a, 1] + l11 * z_clock[a, 0]
        clock[a, 1] += l21 * z_clock[a, 0] + l22 * z_clock[a, 1]
