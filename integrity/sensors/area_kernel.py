"""What the vehicles of an area share, over one epoch: slow errors, noise of the station, and its clock."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit


@jit
def advance(  # type: ignore[no-untyped-def]
    memory, message, clock, dt, columns, decay, gain, z_slow, fresh, z_noise, l11, l21, l22, z_clock
):  # fmt: skip
    """In place: memory (A, S, M), one of its ``columns`` (A,) a Gauss-Markov step; message (A, S, K); clock (A, 2).

    decay, gain (M,). A ``fresh`` message (A,) holds the last columns of the memory as they now are, the station's
    multipath, and white noise.
    """
    taken = message.shape[2] - z_noise.shape[2]
    first = memory.shape[2] - taken
    for a in range(memory.shape[0]):
        column = columns[a]
        for s in range(memory.shape[1]):
            memory[a, s, column] = decay[column] * memory[a, s, column] + gain[column] * z_slow[a, s]
        if fresh[a]:
            message[a, :, :taken] = memory[a, :, first:]
            message[a, :, taken:] = z_noise[a]
        clock[a, 0] += dt * clock[a, 1] + l11 * z_clock[a, 0]
        clock[a, 1] += l21 * z_clock[a, 0] + l22 * z_clock[a, 1]
