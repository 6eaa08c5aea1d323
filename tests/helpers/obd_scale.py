"""How constant the scale of a recorded vehicle speed is.

    .venv/bin/python tests/helpers/obd_scale.py Speed_StereoVO_OBDII_Reference_*.csv.gz

Files have columns of time, reference speed and the speed of the OBD-II port [s, m/s, m/s], at 5 Hz; those of Kingston
and Toronto are public (github.com/hanymragab/plans2025-resources).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

MOVING_MPS, WINDOW_S, LEAST_M = 3.0, 200.0, 500.0


def figures(path: Path) -> str:
    """Scale of the whole drive, scale with an offset, and scales of windows of 200 s with their trend."""
    time, reference, speed = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(0, 1, 2)).T
    moving = reference > MOVING_MPS
    r, s = reference[moving], speed[moving]
    slope, offset = np.polyfit(r, s, 1)
    number, scales, when = ((time - time[0]) // WINDOW_S).astype(int), [], []
    for k in range(number[-1] + 1):
        own = moving & (number == k)
        if reference[own].sum() * np.median(np.diff(time)) > LEAST_M:
            scales.append(speed[own].sum() / reference[own].sum())
            when.append(k * WINDOW_S)
    trend = np.polyfit(when, scales, 1)[0]
    return (
        f"{path.name}: scale {s @ r / (r @ r):.4f}; with an offset {slope:.4f} and {offset:.3f} m/s; {len(scales)} "
        f"windows {np.mean(scales):.4f} +- {np.std(scales, ddof=1):.4f}, trend {trend:.1e} /s"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    for file in parser.parse_args().files:
        print(figures(file))
