"""How far the best wrong integers move a position, and how well they fit its carriers, by the number of satellites.

.venv/bin/python tests/helpers/wrong_candidates.py
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2
from signal_records import records_of, rows_of

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters
from lanebound.integrity.positioning.rtk_kernel import SATELLITE, Carriers
from lanebound.integrity.positioning.wrong_fix_kernel import displacement_of, next_best_integers
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import WAVELENGTH_M
from lanebound.integrity.sky.track import SkyTrack

TRIALS, SPAN_S, MASK_DEG, ALPHA = 60, 20_000.0, 15.0, 0.005
RULES = epoch_parameters(RtkReckoningConfig())["rtk"][0]


def residual_norm(carriers: Carriers, integers: np.ndarray) -> tuple[float, int]:
    """Squared norm of what integers leave beside position and clocks [sigma^2], and its degrees of freedom."""
    system = carriers.satellites["system"]
    design = np.column_stack([carriers.signals["e"], *((system == s) * 1.0 for s in np.unique(system))])
    root = 1.0 / np.sqrt(carriers.variance * RULES["sigma_phase"] ** 2 / 2.0)
    y = root * (integers * carriers.satellites["wavelength"]).mean(1)
    left = y - root[:, None] * design @ np.linalg.lstsq(root[:, None] * design, y, rcond=None)[0]
    return float(left @ left), len(y) - design.shape[1]


def main() -> None:
    """Print a row for each number of satellites and rank."""
    rng, sky = np.random.default_rng(1), NavigatorConfig().sky
    track = SkyTrack.from_config(sky, SPAN_S + 60.0)
    for count in (8, 10, 12, 16, 20):
        found: dict[int, list[tuple[float, float, bool]]] = {1: [], 5: [], 20: []}
        for _ in range(TRIALS):
            view = track.at(track.start_s + rng.uniform(0.0, SPAN_S), np.zeros(1, dtype=np.int64))
            up = np.flatnonzero(view.elevation_rad[0] > np.deg2rad(MASK_DEG))
            chosen = np.sort(rng.choice(up, count, replace=False))
            los, satellites = np.ascontiguousarray(view.los_enu[0, chosen]), np.zeros(count, SATELLITE)
            satellites["system"] = view.system[chosen]
            satellites["wavelength"] = WAVELENGTH_M[view.system[chosen], :2]
            signals, used = records_of(OBSERVED_SIGNAL, count, e=los), rows_of(los, satellites["system"], True)
            carriers = Carriers(satellites, signals, 0.5 * (1.0 + 1.0 / los[:, 2] ** 2))
            for rank, rows in found.items():
                integers, moved = np.zeros((count, 2), np.int64), np.zeros(3)
                if next_best_integers(carriers, used, rank, 0.0, RULES, integers):
                    displacement_of(integers, carriers, used, 2, moved)
                    norm, freedom = residual_norm(carriers, integers)
                    passes = freedom > 0 and norm < chi2.isf(ALPHA, max(freedom, 1))
                    rows.append((float(np.hypot(moved[0], moved[1])), norm**0.5, passes))
        for rank, rows in found.items():
            off, norm, passes = np.array(rows).T
            print(
                f"{count} satellites, rank {rank}: pass {passes.mean():.0%}, off by {np.median(off):.2f} m and "
                f"residuals of {np.median(norm):.1f} sigma in the median",
                flush=True,
            )


if __name__ == "__main__":
    main()
