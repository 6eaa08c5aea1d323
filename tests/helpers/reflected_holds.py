"""How often a carrier that RTK holds is tracked on a reflection, and how often a detector flags signals.

    .venv/bin/python tests/helpers/reflected_holds.py urban dense --streets 2
    .venv/bin/python tests/helpers/reflected_holds.py dense skies/plaza --seed 91 --detector antenna_array

Streets and vehicles are those of ``lanebound assess bounding --in-the-loop``. Counts the epochs in mode RTK by the
number of held satellites whose receiver tracks a reflection and not the direct or diffracted ray, and those among them
whose carrier is off by more than 3 cm from what it was when the satellite was first held. With a detector: the shares
that it flags of the received codes that are tracked on a reflection, and of those on the direct or diffracted ray.
"""

from __future__ import annotations

import argparse

import numpy as np

from lanebound.agents.studies.in_the_loop import InTheLoopConfig
from lanebound.agents.studies.street_drives import street_of
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.arrival_kernel import UNKNOWN_FACE

MOST, OFF_M = 4, 0.03


def count_holds(config: InTheLoopConfig, sky: str, number: int) -> tuple[np.ndarray, np.ndarray, int]:
    """RTK epochs of a street by the number of held reflections (MOST + 1,), the same off by 3 cm, held carriers."""
    navigator, drive = street_of(config, sky, number)
    first, epochs = (round(s / navigator.config.dt_s) for s in (config.warm_up_s, config.span_s))
    by_number, by_number_off, held_carriers, began = np.zeros(MOST + 1, int), np.zeros(MOST + 1, int), 0, None
    for k, truth in zip(range(epochs), drive, strict=False):
        solution, tracked = navigator.step(truth), navigator.state.gnss.signals["tracked"]
        held, carrier = np.asarray(solution.held), tracked["carrier"][..., 0]
        began = carrier.copy() if began is None else np.where(held, began, carrier)
        rtk = solution.mode == Mode.RTK
        if k < first or not rtk.any():
            continue
        arrival = tracked["arrival"]
        reflected = held & ((arrival >= 0) | (arrival == UNKNOWN_FACE))
        off = reflected & (np.abs(carrier - began) > OFF_M)
        held_carriers += int(held[rtk].sum())
        for found, into in ((reflected, by_number), (off, by_number_off)):
            into += np.bincount(np.minimum(found[rtk].sum(1), MOST), minlength=MOST + 1)
    return by_number, by_number_off, held_carriers


def count_flags(config: InTheLoopConfig, sky: str, number: int) -> np.ndarray:
    """Received codes of a street, (2, 2): by whether a reflection is tracked, and whether it is flagged."""
    navigator, drive = street_of(config, sky, number)
    first, epochs = (round(s / navigator.config.dt_s) for s in (config.warm_up_s, config.span_s))
    found = np.zeros((2, 2), int)
    for k, truth in zip(range(epochs), drive, strict=False):
        navigator.step(truth)
        signals = navigator.state.gnss.signals
        there = signals["code_s"] >= navigator.config.gnss.code_delay_s
        arrival = signals["tracked"]["arrival"][there]
        if k >= first:
            kinds = 2 * ((arrival >= 0) | (arrival == UNKNOWN_FACE)) + signals["flagged"][there]
            found += np.bincount(kinds, minlength=4).reshape(2, 2)
    return found


def main() -> None:
    """Print a row for each sky."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("skies", nargs="+")
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--streets", type=int, default=1)
    parser.add_argument("--navigator", default=None, help="a preset")
    parser.add_argument("--detector", default=None, help="a kind of gnss.reflection_detector")
    given = parser.parse_args()
    for sky in given.skies:
        data = {"skies": [sky], "seed": given.seed, **({"navigator": given.navigator} if given.navigator else {})}
        if given.detector:
            data["navigator"] = {"gnss": {"reflection_detector": {"kind": given.detector}}}
        config = InTheLoopConfig.load(data)
        if given.detector:
            flags = sum(count_flags(config, sky, number) for number in range(given.streets))
            (direct, found), (of_direct, of_reflected) = flags[:, 1] / flags.sum(1), flags.sum(1)
            print(f"{sky}: flags {found:.3f} of {of_reflected:,} reflected codes, {direct:.3f} of {of_direct:,} others")
            continue
        parts = [count_holds(config, sky, number) for number in range(given.streets)]
        counts, off, held = sum(p[0] for p in parts), sum(p[1] for p in parts), sum(p[2] for p in parts)
        reflected = int(np.arange(MOST + 1) @ counts)
        print(
            f"{sky}: {counts.sum():,} RTK epochs; with 1, 2, 3, {MOST} or more held reflections {counts[1:]}, "
            f"off by 3 cm {off[1:]}; {reflected} of {held:,} held carriers ({reflected / max(held, 1):.2g})"
        )


if __name__ == "__main__":
    main()
