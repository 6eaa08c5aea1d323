"""Which wrong integers mislead the default navigator.

    PYTHONPATH=. .venv/bin/python tests/helpers/wrong_fixes.py

Vehicles drive straight under an open sky with some satellite systems only. RTK accepts the wrong candidate of a rank
from the first epoch on, where nothing is known that it could contradict, or after 15 s of right positions.
"""

from __future__ import annotations

import numpy as np

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from tests.helpers.tunnel_drives import drive

VEHICLES, SECONDS, HOURS = 16, 25.0, (0, 3, 6, 9)
SYSTEMS = {"gps": 31, "galileo": 24, "glonass": 24, "beidou": 24, "qzss": 4}
SKIES = {"GPS": ("gps",), "GPS, Galileo": ("gps", "galileo"), "all": tuple(SYSTEMS)}


def main() -> None:
    """Print a row for each sky, onset and rank; four hours of a day."""
    for sky, systems in SKIES.items():
        base = NavigatorConfig().replace(sky={name: SYSTEMS[name] if name in systems else 0 for name in SYSTEMS})
        for start_s, rank in ((0.0, 0), (0.0, 1), (0.0, 5), (15.0, 1), (15.0, 5)):
            used, misled, beyond, largest = 0, 0, 0, 0.0
            for hour in HOURS:
                config = base.replace(sky={"week_second_s": base.sky.week_second_s + 3600 * hour})
                fault = Fault(kind="wrong_fix", magnitude_rank=max(rank, 1), start_s=start_s, duration_s=SECONDS)
                faults = FaultSchedule((fault,) if rank else ())
                run = drive(config, np.zeros(round(SECONDS / 0.1)), 1e3, VEHICLES, from_s=start_s, faults=faults)
                rtk = run.mode == Mode.RTK
                out = rtk & (run.error_m > run.levels_m[:, :, 0]).any(-1)
                used, beyond, misled = used + int(rtk.sum()), beyond + int(out.sum()), misled + int(out.any(0).sum())
                largest = max(largest, float(run.error_m[rtk].max(initial=0.0)))
            total = VEHICLES * len(HOURS)
            print(
                f"{sky}; from {start_s:g} s, rank {rank}: RTK in {used / (10.0 * (SECONDS - start_s) * total):.1%} of "
                f"epochs, beyond the level of 1e-5 in {beyond} epochs of {misled} of {total} vehicles, largest error "
                f"of RTK {largest:.2f} m",
                flush=True,
            )


if __name__ == "__main__":
    main()
